"""The value and the limit in a comparison: what is measured, and what it is held to."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from turtlelog.expressions import (
    Call,
    Comparison,
    Expression,
    Kind,
    Name,
    Node,
    evaluate_node,
    iterate_nodes,
)
from turtlelog.measure import METRICS, SIGNALS

_UNITS = {name: kind.unit for name, kind in SIGNALS.items()}
_UNITS |= {name: kind.unit for name, kind in METRICS.items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class Sides:
    """Value and limit of a comparison; None where it has no such numbers."""

    value: float | None = None
    limit: float | None = None
    unit: str = ""


def read_sides(expression: Expression, node: Node, values: Mapping[str, Any]) -> Sides:
    """Return the sides of a comparison of two.

    Args:
        expression: That it is part of.
        node: The comparison; of anything else the sides are None.
        values: What its names stand for.
    """
    if not isinstance(node, Comparison):
        return Sides()
    measured, limit = node.operands
    if _is_measured(limit) and not _is_measured(measured):
        measured, limit = limit, measured
    sides = [evaluate_node(expression, side, values) for side in (measured, limit)]
    if any(side.kind is not Kind.NUMBER for side in sides):
        return Sides()
    return Sides(value=float(sides[0].data), limit=float(sides[1].data), unit=_find_unit(measured))


def _is_measured(node: Node) -> bool:
    return any(isinstance(part, Name) and part.name in _UNITS for part in iterate_nodes(node))


def _find_unit(node: Node) -> str:
    """Return the unit of what is measured, empty where it is not plain."""
    if isinstance(node, Call) and node.function in {"abs", "min", "max"}:
        units = {_find_unit(argument) for argument in node.arguments}
        return units.pop() if len(units) == 1 else ""
    if isinstance(node, Call) and node.function == "deg":
        return "deg"
    return _UNITS.get(node.name, "") if isinstance(node, Name) else ""
