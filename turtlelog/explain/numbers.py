"""From measured figures to the round ones that somebody typed."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]

_DIGITS: Final = 17
"""This many significant digits tell every double."""

_ROUNDING: Final = 1e-13
"""What another platform's cosine may make of a command, as a share of the largest."""

_TYPED_DIGITS: Final = 8
_NEIGHBOURS: Final = 16
"""Doubles on either side of a ratio that rounding may have come from."""

_LEADING: Final = "1528346790"
"""First digits, the more usual first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GainFit:
    """A gain, as the commands tell it.

    Attributes:
        value: The shortest decimal that reproduces every command, or else that of least squares.
        is_exact: Whether it reproduces every command, bit for bit or else to rounding.
        is_bitwise: Whether bit for bit.
        standard_error: Of the fit, 0 where exact.
        residual: Root mean square of what is left of the commands.
        rows: Commands used.
    """

    value: float
    is_exact: bool
    is_bitwise: bool
    standard_error: float
    residual: float
    rows: int


def fit_gain(command: Values, reproduce: Callable[[float], Values]) -> GainFit:
    """Return the gain for which `reproduce` gives the commands; both have shape (n,), n >= 1."""
    per_unit = reproduce(1.0)
    square = float(per_unit @ per_unit)
    fitted = float(per_unit @ command) / square if square > 0.0 else 0.0
    left = command - fitted * per_unit
    residual = float(np.sqrt(np.mean(left**2)))
    exact = _find_exact_gain(command, reproduce, per_unit, fitted)
    if exact is not None:
        return GainFit(
            value=exact,
            is_exact=True,
            is_bitwise=np.array_equal(reproduce(exact), command),
            standard_error=0.0,
            residual=0.0,
            rows=len(command),
        )
    spread = residual / np.sqrt(square) if square > 0.0 else float("inf")
    return GainFit(
        value=fitted,
        is_exact=False,
        is_bitwise=False,
        standard_error=float(spread),
        residual=residual,
        rows=len(command),
    )


def _find_exact_gain(
    command: Values, reproduce: Callable[[float], Values], per_unit: Values, fitted: float
) -> float | None:
    largest = int(np.abs(per_unit).argmax())
    if per_unit[largest] == 0.0:
        return None
    ratio = float(command[largest] / per_unit[largest])
    slack = _ROUNDING * float(np.abs(command).max())
    if (np.abs(reproduce(ratio) - command) > slack).any():
        return None
    # Two commands any gain could fit; one that somebody typed has few digits.
    digits = _DIGITS if len(np.unique(per_unit)) > 2 else _TYPED_DIGITS
    decimals = [float(f"{ratio:.{count}g}") for count in range(1, digits + 1)]
    steps = sorted(range(-_NEIGHBOURS, _NEIGHBOURS + 1), key=abs) if digits == _DIGITS else []
    near = [base + step * math.ulp(base) for step in steps for base in (ratio, fitted)]
    for gain in (*decimals, *near):
        if np.array_equal(reproduce(gain), command):
            return gain
    return fitted if steps else None


def find_round_number(low: float, high: float) -> float:
    """Return the roundest number in [low, high), 0 < high: fewest digits, then the usual ones."""
    if low <= 0.0:
        return _find_power_below(high)
    for digits in range(1, _DIGITS + 1):
        exponent = int(np.floor(np.log10(high))) - digits + 1
        found = [
            number
            for place in range(exponent - 1, exponent + 1)
            for number in _list_multiples(low, high, place)
        ]
        if found:
            return min(found, key=lambda number: _rank(number))
    return low


def _list_multiples(low: float, high: float, place: int) -> list[float]:
    first = int(np.ceil(low / 10.0**place))
    numbers = [float(f"{multiple}e{place}") for multiple in range(first, first + 20)]
    return [number for number in numbers if low <= number < high]


def _rank(number: float) -> tuple[int, int]:
    digits = f"{number:.16e}".split("e")[0].rstrip("0").replace(".", "")
    return len(digits), _LEADING.index(digits[0])


def _find_power_below(high: float) -> float:
    exponent = int(np.ceil(np.log10(high))) - 1
    return float(f"1e{exponent}")
