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
from turtlelog.loops import Declaration
from turtlelog.measure import find_metric_kind, list_metrics, list_signals


@dataclass(frozen=True, slots=True, kw_only=True)
class Sides:
    """Value and limit of a comparison; None where it has no such numbers."""

    value: float | None = None
    limit: float | None = None
    unit: str = ""


def read_sides(
    expression: Expression, node: Node, values: Mapping[str, Any], declaration: Declaration
) -> Sides:
    """Return the sides of a comparison of two.

    Args:
        expression: That it is part of.
        node: The comparison; of anything else the sides are None.
        values: What its names stand for.
        declaration: Of the law, which says the units of its loops' metrics.
    """
    if not isinstance(node, Comparison):
        return Sides()
    names = {part.name for part in iterate_nodes(node) if isinstance(part, Name)}
    units = {name: unit for name in names if (unit := find_unit(name, declaration)) is not None}
    measured, limit = node.operands
    if _is_measured(limit, units) and not _is_measured(measured, units):
        measured, limit = limit, measured
    sides = [evaluate_node(expression, side, values) for side in (measured, limit)]
    if any(side.kind is not Kind.NUMBER for side in sides):
        return Sides()
    return Sides(
        value=float(sides[0].data), limit=float(sides[1].data), unit=_find_unit(measured, units)
    )


def find_unit(name: str, declaration: Declaration) -> str | None:
    """Return the unit of a signal or metric, None where the name is of neither.

    Empty for a metric of a loop that is not declared, whose unit depends on what it controls.
    """
    if name in list_signals(declaration):
        return list_signals(declaration)[name].unit
    if name in list_metrics(declaration):
        return list_metrics(declaration)[name].unit
    other = find_metric_kind(name)
    return None if other is None else "" if " or " in other.unit else other.unit


def _is_measured(node: Node, units: Mapping[str, str]) -> bool:
    return any(isinstance(part, Name) and part.name in units for part in iterate_nodes(node))


def _find_unit(node: Node, units: Mapping[str, str]) -> str:
    """Return the unit of what is measured, empty where it is not plain."""
    if isinstance(node, Call) and node.function in {"abs", "min", "max"}:
        found = {_find_unit(argument, units) for argument in node.arguments}
        return found.pop() if len(found) == 1 else ""
    if isinstance(node, Call) and node.function == "deg":
        return "deg"
    return units.get(node.name, "") if isinstance(node, Name) else ""
