"""The goal of tuning: an objective to minimise or maximise, and constraints."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from turtlelog.errors import TuneError
from turtlelog.expressions import (
    Comparison,
    Expression,
    Logic,
    Node,
    Prefix,
    evaluate_expression,
    evaluate_node,
    parse_expression,
)
from turtlelog.measure import find_metric_kind

Values = Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class ConstraintFinding:
    """Result of a constraint for a candidate.

    Attributes:
        expression: Constraint as typed.
        value: Value of the left side of a comparison of numbers. None if the value is missing, or
            for other constraints.
        margin: Distance to the other verdict, in the unit of the compared values: positive if the
            constraint holds, negative if it does not. inf or -inf if there is no distance, as for
            words; -inf if a value is missing.
        holds: Whether the constraint holds; False if a value is missing.
    """

    expression: str
    value: float | None
    margin: float
    holds: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class TuningGoal:
    """The goal of tuning.

    Attributes:
        objective: Formula of metrics and keys with a number as result.
        is_maximised: Whether to maximise the objective instead of minimising it.
        constraints: Conditions on metrics and keys.
    """

    objective: Expression
    is_maximised: bool = False
    constraints: tuple[Expression, ...] = ()

    @property
    def metrics(self) -> tuple[str, ...]:
        """Ids of the metrics that the goal needs."""
        names = [name for one in (self.objective, *self.constraints) for name in one.names]
        return tuple(dict.fromkeys(name for name in names if find_metric_kind(name) is not None))

    @property
    def metric(self) -> str | None:
        """Id of the metric that is the objective; None if the objective is a formula."""
        name = self.objective.text.strip()
        return None if find_metric_kind(name) is None else name

    def compute_objective(self, values: Values) -> float | None:
        """Return the value of the objective; None if the objective has no value.

        Some metrics have a floor: an overshoot below 0 is no better than 0. If such a metric is
        minimised, the floor replaces all values below it.

        Raises:
            ExpressionError: If the objective contains an unknown name.
            TuneError: If the result is not a number.
        """
        found = evaluate_expression(self.objective, values)
        if found is None:
            return None
        if isinstance(found, bool) or not isinstance(found, int | float):
            raise TuneError(f"{self.objective.source}: expected a number, found {found!r}")
        kind = None if self.metric is None else find_metric_kind(self.metric)
        if kind is None or kind.floor is None or self.is_maximised:
            return float(found)
        return max(float(found), kind.floor)

    def judge(self, values: Values) -> tuple[ConstraintFinding, ...]:
        """Return the result of each constraint.

        Raises:
            ExpressionError: If an expression contains an unknown name.
            TuneError: If a constraint is not a condition.
        """
        return tuple(_judge(one, values) for one in self.constraints)

    def require_sound(self, known: Values) -> None:
        """Refuse an expression that cannot be evaluated for any candidate.

        Args:
            known: Values of keys, and a number for every metric.

        Raises:
            ExpressionError: If an expression contains an unknown name.
            TuneError: If the objective is not a number, or a constraint is not a condition.
        """
        self.compute_objective(known)
        self.judge(known)
        if not self.metrics:
            raise TuneError(
                f"{self.objective.source}: expected a metric such as final.position_error, found"
                f" none in {self.objective.text[:60]!r}"
            )


def parse_goal(
    objective: str, constraints: Sequence[str] = (), *, is_maximised: bool = False
) -> TuningGoal:
    """Return the goal from the texts of its expressions.

    Raises:
        ExpressionError: If an expression cannot be parsed.
    """
    source = "--maximise" if is_maximised else "--minimise"
    return TuningGoal(
        objective=parse_expression(objective, source=source),
        is_maximised=is_maximised,
        constraints=tuple(parse_expression(text, source="--subject-to") for text in constraints),
    )


def _judge(expression: Expression, values: Values) -> ConstraintFinding:
    truth = evaluate_expression(expression, values)
    if truth is not None and not isinstance(truth, bool):
        raise TuneError(f"{expression.source}: expected a condition, found {truth!r}")
    value, root = None, expression.root
    if isinstance(root, Comparison):
        found = evaluate_node(expression, root.operands[0], values).unpack()
        value = float(found) if _is_number(found) else None
    margin = _measure_margin(expression, root, values)
    return ConstraintFinding(
        expression=expression.text,
        value=value,
        margin=-math.inf if margin is None else margin,
        holds=truth is True,
    )


def _measure_margin(expression: Expression, node: Node, values: Values) -> float | None:
    """Return the distance of a condition to the other verdict; None if a value is missing.

    The distance is the robustness of a formula (A. Donze and O. Maler, "Robust satisfaction of
    temporal logic over real-valued signals", FORMATS 2010), without time.
    """
    if isinstance(node, Comparison):
        sides = [evaluate_node(expression, one, values).unpack() for one in node.operands]
        if None in sides:
            return None
        return min(map(_compare, sides, node.operators, sides[1:]))
    parts = [_measure_margin(expression, part, values) for part in node.list_children()]
    if isinstance(node, Logic):
        if node.operator == "implies":
            parts[0] = None if parts[0] is None else -parts[0]
        known = [part for part in parts if part is not None]
        if node.operator == "and":
            return min(known) if len(known) == len(parts) else None
        return max(known, default=None)
    if isinstance(node, Prefix) and node.operator == "not":
        return None if parts[0] is None else -parts[0]
    return math.inf if evaluate_node(expression, node, values).unpack() is True else -math.inf


_ORDER: Final = {"<": 1.0, "<=": 1.0, ">": -1.0, ">=": -1.0}


def _compare(left: Any, operator: str, right: Any) -> float:
    if not (_is_number(left) and _is_number(right)):
        return math.inf if (left == right) == (operator == "==") else -math.inf
    if operator in _ORDER:
        # Equal infinite sides have distance 0.
        return 0.0 if left == right else _ORDER[operator] * (right - left)
    distance = 0.0 if left == right else abs(left - right)
    return 0.0 - distance if operator == "==" else distance


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
