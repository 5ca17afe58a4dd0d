"""Comparisons of two numbers, and how far each is from its other verdict."""

import operator as operators
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final

OPERATORS: Final[Mapping[str, Callable[[float, Any], bool]]] = MappingProxyType(
    {
        "<": operators.lt,
        "<=": operators.le,
        ">": operators.gt,
        ">=": operators.ge,
        "==": operators.eq,
        "!=": operators.ne,
    }
)

MIRRORED: Final[Mapping[str, str]] = MappingProxyType(
    {"<": ">", "<=": ">=", ">": "<", ">=": "<=", "==": "==", "!=": "!="}
)
"""What an operator becomes where its sides change places, or their signs."""


def measure_margin(value: float, operator: str, limit: float) -> float:
    """Return how far the value is from the other verdict, positive where it passes."""
    if operator in {"==", "!="}:
        return abs(value - limit) * (-1.0 if operator == "==" else 1.0) + 0.0
    return limit - value if operator in {"<", "<="} else value - limit
