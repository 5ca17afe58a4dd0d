"""The value and the limit in a formula: the two sides of the comparison that decides it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from turtlelog.check.operators import MIRRORED, measure_margin
from turtlelog.expressions import (
    Call,
    Comparison,
    Expression,
    Kind,
    Logic,
    Name,
    Node,
    Temporal,
    evaluate_node,
    iterate_nodes,
)
from turtlelog.measure import METRICS, SIGNALS

_UNITS = {**{name: kind.unit for name, kind in SIGNALS.items()}}
_UNITS |= {name: kind.unit for name, kind in METRICS.items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class Sides:
    """Value and limit of a comparison; None where it has no such number."""

    value: float | None = None
    limit: float | None = None
    unit: str = ""


def read_sides(expression: Expression, values: Mapping[str, Any], margin: float | None) -> Sides:
    """Return the sides of the comparison that a formula's margin comes from.

    Args:
        expression: Temporal or not.
        values: What its names stand for: of metrics and parameters, their values.
        margin: Of the whole.
    """
    if any(isinstance(node, Temporal) for node in iterate_nodes(expression.root)):
        return _read_over_time(expression, values, margin)
    for node in _find_comparisons(expression.root):
        for pair in _list_pairs(node):
            sides = _evaluate(expression, pair, values)
            if sides is None:
                continue
            value, operator, limit, measured = sides
            if margin is None or measure_margin(value, operator, limit) == margin:
                return Sides(value=value, limit=limit, unit=_find_unit(measured))
    return Sides()


Pair = tuple[Node, str, Node]


def _read_over_time(
    expression: Expression, values: Mapping[str, Any], margin: float | None
) -> Sides:
    """Return the sides at the moment that decides, where there is but one comparison.

    The limit is a number or parameter; the value is as far from it as the margin says.
    """
    found = [pair for node in _find_comparisons(expression.root) for pair in _list_pairs(node)]
    if len(found) != 1 or sum(isinstance(n, Comparison) for n in _iterate(expression)) != 1:
        return Sides()
    left, operator, right = _order(found[0])
    unit = _find_unit(left)
    if any(isinstance(node, Name) and node.name in SIGNALS for node in iterate_nodes(right)):
        return Sides(unit=unit)
    operand = evaluate_node(expression, right, values)
    if operand.kind is not Kind.NUMBER:
        return Sides()
    limit = float(operand.data)
    if margin is None or operator in {"==", "!="}:
        return Sides(limit=limit, unit=unit)
    return Sides(
        value=limit - margin if operator in {"<", "<="} else limit + margin, limit=limit, unit=unit
    )


def _iterate(expression: Expression) -> Iterator[Node]:
    return iterate_nodes(expression.root)


def _find_comparisons(node: Node) -> Iterator[Comparison]:
    """Yield the comparisons that count as they stand: not those below `not` or left of implies."""
    if isinstance(node, Comparison):
        yield node
    elif isinstance(node, Logic):
        for part in node.operands[1:] if node.operator == "implies" else node.operands:
            yield from _find_comparisons(part)
    elif isinstance(node, Temporal):
        yield from _find_comparisons(node.operand)


def _list_pairs(node: Comparison) -> list[Pair]:
    return list(zip(node.operands, node.operators, node.operands[1:], strict=False))


def _order(pair: Pair) -> Pair:
    """Return a pair with what is measured on the left."""
    left, operator, right = pair
    if _is_measured(right) and not _is_measured(left):
        return right, MIRRORED[operator], left
    return pair


def _is_measured(node: Node) -> bool:
    return any(isinstance(part, Name) and part.name in _UNITS for part in iterate_nodes(node))


def _evaluate(
    expression: Expression, pair: Pair, values: Mapping[str, Any]
) -> tuple[float, str, float, Node] | None:
    left, operator, right = _order(pair)
    operands = [evaluate_node(expression, node, values) for node in (left, right)]
    if any(operand.kind is not Kind.NUMBER for operand in operands):
        return None
    return float(operands[0].data), operator, float(operands[1].data), left


def _find_unit(node: Node) -> str:
    """Return the unit of what is measured, empty where it is not plain."""
    if isinstance(node, Call) and node.function in {"abs", "min", "max"}:
        units = {_find_unit(argument) for argument in node.arguments}
        return units.pop() if len(units) == 1 else ""
    if isinstance(node, Call) and node.function == "deg":
        return "deg"
    return _UNITS.get(node.name, "") if isinstance(node, Name) else ""
