"""The functions of the language, by name: how many numbers each takes."""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

ARGUMENTS: Final[Mapping[str, tuple[int, float]]] = MappingProxyType(
    {
        "abs": (1, 1),
        "min": (2, math.inf),
        "max": (2, math.inf),
        "sqrt": (1, 1),
        "sin": (1, 1),
        "cos": (1, 1),
        "atan2": (2, 2),
        "hypot": (2, 2),
        "deg": (1, 1),
        "rad": (1, 1),
        "log": (1, 1),
    }
)
"""Smallest and largest number of arguments. Angles are in rad; `log` is the natural logarithm."""


def describe_arguments(function: str) -> str:
    """Return how many arguments a function takes, for messages."""
    least, most = ARGUMENTS[function]
    count = f"{least} or more" if least != most else f"{least}"
    return f"{function} to have {count} argument{'s' if count != '1' else ''}"
