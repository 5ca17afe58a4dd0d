"""Comparisons of two numbers, and how far each is from its other verdict."""

import math
import operator as operators
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final

from turtlelog.errors import CheckError

OPERATORS: Final[Mapping[str, Callable[[float, float], bool]]] = MappingProxyType(
    {
        "<": operators.lt,
        "<=": operators.le,
        ">": operators.gt,
        ">=": operators.ge,
        "==": operators.eq,
        "!=": operators.ne,
    }
)


def compare_numbers(value: float, operator: str, limit: float) -> bool:
    """Return the truth of `value operator limit`.

    Raises:
        CheckError: Where the limit is no number, so that nothing could be compared.
    """
    if math.isnan(limit):
        raise CheckError(f"limit: expected a number after {operator}, found nan")
    return OPERATORS[operator](value, limit)


def measure_margin(value: float, operator: str, limit: float) -> float:
    """Return how far the value is from the other verdict, positive where it passes."""
    if operator in {"==", "!="}:
        return abs(value - limit) * (-1.0 if operator == "==" else 1.0) + 0.0
    return limit - value if operator in {"<", "<="} else value - limit
