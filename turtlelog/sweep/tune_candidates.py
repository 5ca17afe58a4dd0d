"""The goal and keys of a search, and its candidates: many simulated at a time and none twice."""

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any, Final

from turtlelog.errors import ScenarioError, TuneError
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
from turtlelog.laws import WorkWithLaws, is_given
from turtlelog.measure import find_metric_kind, list_metrics
from turtlelog.processes import CAN_FORK, LONG_S, count_cores, map_in_processes, start_pool
from turtlelog.scenario import Scenario, flatten_scenario, format_scenario, resolve_scenario
from turtlelog.simulate import declare_scenario
from turtlelog.simulate.step_budget import STEP_BUDGET_S
from turtlelog.sweep.sweep_plan import KP, build_row_scenario
from turtlelog.sweep.sweep_rows import RowChunk, RowResults, is_batch, simulate_rows

Point = tuple[float | int, ...]

_CUTS: Final = 8
"""Smallest number of parts of a generation: several parts for each of a few processes."""

_CHUNK_S: Final = 0.5
"""Duration of a unit of work [s]: long beside its distribution, short for a waiting user."""

Values = Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class ConstraintFinding:
    """Result of a constraint for a candidate.

    The margin has the unit of the compared values. It is inf or -inf if there is no distance, as
    for words, and -inf if a value is missing.
    """

    expression: str  # constraint as typed
    value: float | None  # left side of a comparison of numbers; None if missing, or for others
    margin: float  # distance to the other verdict, negative if the constraint does not hold
    holds: bool  # whether the constraint holds; False if a value is missing


@dataclass(frozen=True, slots=True, kw_only=True)
class TuningGoal:
    """The goal of tuning."""

    objective: Expression  # formula of metrics and keys with a number as result
    is_maximised: bool = False  # whether to maximise the objective instead of minimising it
    constraints: tuple[Expression, ...] = ()  # conditions on metrics and keys

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

    @property
    def sign(self) -> float:
        """1 if smaller objectives are better, -1 if larger ones are."""
        return -1.0 if self.is_maximised else 1.0

    def compute_objective(self, values: Values) -> float | None:
        """Return the value of the objective; None if the objective has no value.

        Some metrics have a floor: an overshoot below 0 is no better than 0. If such a metric is
        minimised, the floor replaces all values below it. TuneError if the result is not a number.
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


def parse_goal(
    objective: str, constraints: Sequence[str] = (), *, is_maximised: bool = False
) -> TuningGoal:
    """Return the goal from the texts of its expressions; ExpressionError for others."""
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


def _compare(left: Any, operator: str, right: Any) -> float:
    if not (_is_number(left) and _is_number(right)):
        return math.inf if (left == right) == (operator == "==") else -math.inf
    distance: float = 0.0 if left == right else right - left  # also of equal infinite sides
    if operator in {"<", "<=", ">", ">="}:
        return distance if operator in {"<", "<="} else 0.0 - distance
    return 0.0 - abs(distance) if operator == "==" else abs(distance)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchedKey:
    """A key and its search range."""

    key: str  # dotted scenario key
    low: float  # smallest value
    high: float  # largest value
    is_whole: bool = False  # whether only whole numbers are allowed
    steps: Sequence[float] = ()  # allowed values; empty if any value is allowed

    def round(self, value: float) -> float | int:
        """Return the nearest allowed value."""
        value = min(max(value, self.low), self.high)
        if self.steps:
            return min(self.steps, key=lambda step: abs(step - value))
        return round(value) if self.is_whole else float(value)


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """Values of the keys, with the results."""

    point: Point  # A value for each key
    objective: float | None  # value of the objective; None if the objective has no value
    constraints: tuple[ConstraintFinding, ...]  # result of each constraint
    failed: str = ""  # reason of a failed run; empty if the run did not fail
    missing: str = ""  # the metric's reason for a missing objective; empty if there is a value

    @property
    def is_feasible(self) -> bool:
        """Whether the objective has a value and every constraint holds."""
        return self.objective is not None and all(one.holds for one in self.constraints)

    @property
    def violation(self) -> float:
        """Sum of the violations of all constraints."""
        # Not `sum`, which rounds differently from Python 3.12 on.
        total = 0.0
        for one in self.constraints:
            total += 0.0 if one.holds else max(-one.margin, 0.0)
        return total


def _require_goal(goal: TuningGoal, values: Values, law: str) -> None:
    """Refuse a goal that no candidate can have, by values of all keys and metrics of a law."""
    unknown = [name for name in goal.metrics if name not in values]
    if unknown:
        raise TuneError(f"{unknown[0]}: expected a metric of the law {law}, which has no such loop")
    goal.compute_objective(values)
    goal.judge(values)
    if not goal.metrics:
        raise TuneError(
            f"{goal.objective.source}: expected a metric such as final.position_error, found"
            f" none in {goal.objective.text[:60]!r}"
        )


class Candidates:
    """Evaluated candidates of a scenario."""

    def __init__(  # noqa: PLR0913  (all but the first three have defaults)
        self,
        base: Scenario,
        keys: Sequence[str],
        goal: TuningGoal,
        *,
        jobs: "int | Executor | None" = None,
        expected: int = 1000,
        watch: Callable[[int], None] | None = None,
        trust_law: bool = False,
        step_budget_s: float = STEP_BUDGET_S,
        tell: Callable[[str], None] | None = None,
        source: str = "grid",
    ) -> None:
        """Set the scenario and keys that the candidates vary.

        Args:
            base: Base scenario; its law may run.
            keys: Dotted scenario keys.
            goal: Objective and constraints.
            jobs: Number of processes, or an executor. Default: one per core if that is faster.
            expected: Approximate number of candidates.
            watch: Function that is called with the number of evaluated candidates.
            trust_law: Whether a law named in a recording may run too.
            step_budget_s: Longest computing time of the law per step [s].
            tell: Function that is called once, with the first candidate whose law exceeds this
                time.
            source: Prefix of error messages about the values of a candidate.

        Raises:
            ScenarioError: If the base is not a valid scenario, or its law may not run.
            ExpressionError: If the goal contains an unknown name.
            TuneError: If the goal is invalid.
        """
        self.keys = tuple(keys)
        self.evaluations = 0  # number of different candidates that were simulated
        resolved = resolve_scenario(base, trust_law=trust_law)
        self._parameters: Mapping[str, Any] = flatten_scenario(resolved)
        self._source = source
        self.goal, self._base = goal, format_scenario(base)
        self._jobs, self._expected = jobs, expected
        self._watch = watch or (lambda _: None)
        self._step_budget_s, self._tell = step_budget_s, tell
        self._known: dict[Point, Candidate] = {}
        self._row_s: float | None = None
        self._is_batch = False
        declared = declare_scenario(resolved)
        self._spreads = spread_keys(self.keys, declared.list_gains(), source=source)
        self._set_keys = tuple(key for keys in self._spreads for key in keys)
        self._scenario, self._trusts = base, trust_law
        known = [*self.keys, *list_metrics(declared)]
        _require_goal(goal, {**self._parameters, **dict.fromkeys(known, 1.0)}, resolved.law.kind)

    def build_scenario(self, point: Point) -> Scenario:
        """Return the scenario of a candidate under the name of the base scenario."""
        trusted = True if self._trusts else None
        keys = [*self._set_keys, "name"]
        values = [*self._spread(point), self._scenario.name]
        return build_row_scenario(
            self._scenario, keys, values, 0, source=self._source, trust_law=trusted
        )

    def require_bounds(self, points: Sequence[Point]) -> None:
        """Raise ScenarioError, with the reason at the first, if no bound forms a valid scenario."""
        errors = []
        for point in points:
            try:
                resolve_scenario(self.build_scenario(point), trust_law=self._trusts)
            except ScenarioError as err:
                errors.append(err)
        if len(errors) == len(points):
            raise errors[0]

    def evaluate(self, points: Sequence[Point]) -> list[Candidate]:
        """Return the result of each point. Known results are not simulated again."""
        new = [point for point in dict.fromkeys(points) if point not in self._known]
        for first, results in self._simulate(new):
            for place, point in enumerate(new[first : first + len(results)]):
                self._known[point] = self._judge(point, results, place)
                self.evaluations += 1
            late = results.find_late()
            if late is not None and self._tell is not None:
                self._tell(f"{self._source}: {late[1]}")
                self._tell = None
            self._watch(len(self._known))
        return [self._known[point] for point in points]

    def list_known(self) -> list[Candidate]:
        """Return all candidates in the order of simulation."""
        return [*self._known.values()]

    def _simulate(self, points: Sequence[Point]) -> Iterator[tuple[int, RowResults]]:
        """Yield results of segments of the points. The first point alone measures the time."""
        if not points:
            return
        done = 0
        if self._row_s is None:
            self._is_batch = is_batch(self._cut(points[:1]))
            begun = time.perf_counter()
            results = simulate_rows(self._cut(points[:1]))
            self._row_s = time.perf_counter() - begun
            yield 0, results
            done = 1
        jobs = self._choose_jobs()
        if isinstance(jobs, int) and self._is_batch:
            jobs, threads, size = 1, jobs, len(points)
        else:
            # A generation is divided among all processes, in parts so that early ones get more
            # work.
            threads, size = 1, -(-len(points) // _CUTS)
            size = max(1, min(size, int(_CHUNK_S / self._row_s)))
        law = self._scenario.law.kind
        work = WorkWithLaws(simulate_rows, () if isinstance(jobs, int) else (law,))
        chunks = [
            self._cut(points[first : first + size], threads=threads)
            for first in range(done, len(points), max(size, 1))
        ]
        name, is_own = _name_chunk, is_given(law)
        for results in map_in_processes(work, chunks, jobs, name=name, is_forked=is_own):
            yield done, results
            done += len(results)

    def _choose_jobs(self) -> "int | Executor":
        if self._jobs is None:
            rest_s = (self._expected - self.evaluations) * (self._row_s or 0.0)
            self._jobs = count_cores() if rest_s > LONG_S else 1
        if is_given(self._scenario.law.kind):
            # Pool processes are spawned, and would not find a law of this session.
            return self._jobs if CAN_FORK or not isinstance(self._jobs, int) else 1
        if isinstance(self._jobs, int) and self._jobs > 1 and not self._is_batch:
            self._jobs = start_pool(self._jobs)
        return self._jobs

    def _cut(self, points: Sequence[Point], *, threads: int = 1) -> RowChunk:
        return RowChunk(
            base=self._base,
            keys=self._set_keys,
            first=0,
            values=tuple(map(self._spread, points)),
            metrics=self.goal.metrics,
            ahead=max(self._expected - self.evaluations, 0),
            threads=threads,
            step_budget_s=self._step_budget_s,
            source=self._source,
        )

    def _spread(self, point: Point) -> Point:
        """Return a value for each key of the scenario; the value of `kp` is used for all gains."""
        return tuple(value for keys, value in zip(self._spreads, point, strict=True) for _ in keys)

    def _judge(self, point: Point, results: RowResults, place: int) -> Candidate:
        found = {name: cells.values[place] for name, cells in results.metrics.items()}
        values = {
            **self._parameters,
            **dict(zip(self.keys, point, strict=True)),
            **dict(zip(self._set_keys, self._spread(point), strict=True)),
            **dict.fromkeys(self.goal.metrics),
            **found,
        }
        failed = results.failed[place] or ""
        objective = None if failed else self.goal.compute_objective(values)
        if objective is not None and not math.isfinite(objective):
            objective = None
        missing = ""
        if objective is None and not failed:
            reasons = [
                f"{name}: {cells.statuses[place]}"
                for name, cells in results.metrics.items()
                if name in self.goal.objective.names and cells.values[place] is None
            ]
            missing = ", ".join(reasons) or "it has no finite value"
        return Candidate(
            point=point,
            objective=objective,
            constraints=self.goal.judge(values),
            failed=failed,
            missing=missing,
        )


def spread_keys(
    keys: Sequence[str], gains: Sequence[str], *, source: str
) -> tuple[tuple[str, ...], ...]:
    """Return the scenario's keys that each searched key sets: `kp` sets all gains of the law."""
    if KP not in keys:
        return tuple((key,) for key in keys)
    if not gains:
        raise TuneError(f"{source}: kp: the law declares no gain; name its keys instead")
    twice = [key for key in keys if key in gains]
    if twice:
        raise TuneError(f"{source}: kp sets {twice[0]} too; leave one of them out")
    return tuple(tuple(gains) if key == KP else (key,) for key in keys)


def _name_chunk(chunk: RowChunk) -> str:
    return f"{len(chunk.values)} candidates"
