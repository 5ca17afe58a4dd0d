"""Gains from commands and errors, and the round numbers that somebody typed."""

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
"""What another platform's cosine may make of a command, as a share of the largest: its last bits,
2e-16 each, times the few operations that follow."""

_TYPED_DIGITS: Final = 8
"""Two commands any gain could fit; one that somebody typed has no more digits than this."""

_NEIGHBOURS: Final = 16
"""Doubles on either side of a ratio that rounding may have come from: the ratio of two products
of three roundings each is off by a few."""

_LEADING: Final = "1528346790"
"""First digits, the more usual first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GainFit:
    """A gain, as the commands tell it.

    Attributes:
        value: The shortest decimal that reproduces every command, or else that of least squares.
        is_exact: Whether it alone reproduces every command, bit for bit.
        is_close: Whether several doubles do, or it does to the rounding of another platform.
        interval: What the gain may be: all that reproduce the commands, or else 95 % of least
            squares.
        noise: Standard deviation of what is left of the error, in its unit; 0 where nothing is.
        whiteness: Mean square of the changes of what is left, by twice its mean square: 1 for
            noise, near 0 for what follows a curve.
        rows: Commands used.
    """

    value: float
    is_exact: bool
    is_close: bool
    interval: tuple[float, float]
    noise: float
    whiteness: float
    rows: int


def fit_gain(command: Values, reproduce: Callable[[float], Values]) -> GainFit:
    """Return the gain for which `reproduce` gives the commands; both have shape (n,), n >= 1."""
    error = reproduce(1.0)
    return _find_exact_gain(command, reproduce, error) or _fit_least_squares(command, error)


def _find_exact_gain(
    command: Values, reproduce: Callable[[float], Values], error: Values
) -> GainFit | None:
    largest = int(np.abs(error).argmax())
    if error[largest] == 0.0:
        return None
    ratio = float(command[largest] / error[largest])
    slack = _ROUNDING * float(np.abs(command).max())
    if (np.abs(reproduce(ratio) - command) > slack).any():
        return None
    digits = _DIGITS if len(np.unique(error)) > 2 else _TYPED_DIGITS
    decimals = [float(f"{ratio:.{count}g}") for count in range(1, digits + 1)]
    near = [ratio + step * math.ulp(ratio) for step in range(-_NEIGHBOURS, _NEIGHBOURS + 1)]
    fitting = [gain for gain in {*decimals, *near} if np.array_equal(reproduce(gain), command)]
    typed = [gain for gain in decimals if gain in fitting]
    if digits < _DIGITS and not typed:
        return None
    low, high = (min(fitting), max(fitting)) if fitting else _widen(ratio)
    inside = typed or fitting or [gain for gain in decimals if low <= gain <= high]
    return GainFit(
        value=[*inside, ratio][0],
        is_exact=len(fitting) == 1,
        is_close=len(fitting) != 1,
        interval=(low, high),
        noise=0.0,
        whiteness=1.0,
        rows=len(command),
    )


def _widen(ratio: float) -> tuple[float, float]:
    slack = _ROUNDING * abs(ratio)
    return ratio - slack, ratio + slack


def _fit_least_squares(command: Values, error: Values) -> GainFit:
    """Fit the errors by the commands: these are known exactly, and noise is in the errors only.

    The other way round noise in the errors makes every gain too small.
    """
    square = float(command @ command)
    rows = len(command)
    slope = float(error @ command) / square if square > 0.0 else 0.0
    left = error - slope * command
    noise = float(np.sqrt(left @ left / max(rows - 1, 1)))
    changes = np.diff(left)
    whiteness = float(changes @ changes / (2.0 * left @ left)) if noise > 0.0 else 1.0
    spread = noise / math.sqrt(square) if square > 0.0 else math.inf
    reach = find_quantile(rows) * spread * float(widen_for_runs(np.asarray(whiteness)))
    return GainFit(
        value=1.0 / slope if slope else 0.0,
        is_exact=False,
        is_close=False,
        # Both ends, turned over, are those of the gain.
        interval=(1.0 / (slope + reach), 1.0 / (slope - reach))
        if slope > reach
        else (0.0, math.inf),
        noise=noise,
        whiteness=whiteness,
        rows=rows,
    )


def find_quantile(rows: int) -> float:
    """Return how many standard errors an interval of 95 % reaches to either side."""
    from scipy.special import stdtrit

    return float(stdtrit(max(rows - 1, 1), 0.975))


def widen_for_runs(whiteness: Values) -> Values:
    """Return by how much errors that hang on the one before spread more than independent ones."""
    alike = np.clip(1.0 - whiteness, 0.0, 0.99)
    return np.asarray(np.sqrt((1.0 + alike) / (1.0 - alike)))


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
