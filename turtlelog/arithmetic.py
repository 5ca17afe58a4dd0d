"""Functions and numbers of loops: what laws, plants and effects may call, plain and compiled.

Compiled loops run the same source, except for the functions that `simulate/compiled_twins.py`
replaces by others with the same values.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from struct import Struct
from typing import Any, Final, TypeVar

_TURN_RAD: Final = 2.0 * math.pi
_FLOATS: Final = Struct("<5f")
_pack, _unpack = _FLOATS.pack, _FLOATS.unpack
_Function = TypeVar("_Function", bound=Callable[..., Any])

hypot = math.hypot
"""The double nearest to the hypotenuse. The libm function, which compiled code would call, is less
exact."""

fmod = math.fmod


floor, ceil = math.floor, math.ceil
"""Whole numbers. In compiled code, whole numbers are floats, so that no large value overflows."""

SETTLING_BAND: Final = 0.02
"""Half-width of the settling band, as a share of the step: the textbooks' 2 %, which an exponential
reaches after 3.91 time constants."""

GAUSS_LEGENDRE: Final = (
    (0.019855071751231912, 0.05061426814518853),
    (0.10166676129318664, 0.11119051722668721),
    (0.2372337950418355, 0.15685332293894344),
    (0.4082826787521751, 0.18134189168918083),
    (0.5917173212478248, 0.18134189168918083),
    (0.7627662049581645, 0.15685332293894344),
    (0.8983332387068134, 0.11119051722668721),
    (0.9801449282487681, 0.05061426814518853),
)
"""Nodes and weights of Gauss-Legendre quadrature on [0, 1]."""


def called(function: _Function) -> _Function:
    """Mark a long function that compiled code calls instead of inlining."""
    function.is_called = True  # type: ignore[attr-defined]
    return function


def inlined(function: _Function) -> _Function:
    """Mark a function that returns an array; compiled code inlines it into its caller."""
    function.is_inlined = True  # type: ignore[attr-defined]
    return function


def compiled_as(twin: Callable[..., Any]) -> Callable[[_Function], _Function]:
    """Let compiled code call another function, a loop over rows, instead of this numpy function."""

    def mark(function: _Function) -> _Function:
        function.twin = twin  # type: ignore[attr-defined]
        return function

    return mark


@dataclass(slots=True)
class Direction:
    """The last angle with its cosine and sine: most calls repeat the last angle."""

    angle_rad: float = math.nan
    cosine: float = 0.0
    sine: float = 0.0


def find_direction(direction: Any, angle_rad: float) -> tuple[float, float]:
    """Return the cosine and sine of an angle; for the same angle as before, the stored values."""
    if angle_rad != direction.angle_rad or angle_rad == 0.0:  # there are two zeros
        direction.angle_rad = angle_rad
        direction.cosine, direction.sine = math.cos(angle_rad), math.sin(angle_rad)
    return direction.cosine, direction.sine


def least(left: float, right: float) -> float:
    """Return the smaller number, the left one of equal numbers."""
    return right if right < left else left


def most(left: float, right: float) -> float:
    """Return the larger number, the left one of equal numbers."""
    return right if right > left else left


def clip(value: float, limit: float) -> float:
    """Return a value clipped to a magnitude."""
    return limit if value > limit else -limit if value < -limit else value


def rub(command: float, deadband: float, friction: float) -> float:
    """Return what deadband and friction leave of a command."""
    if abs(command) <= deadband:
        return 0.0
    return command - clip(command, friction)


def want_rate(command: float, gain: float, reverse_gain: float, bound: float) -> float:
    """Return the rate that a command leads to; a reverse gain of NaN means the normal gain."""
    if command < 0.0 and not math.isnan(reverse_gain):
        gain = reverse_gain
    return clip(gain * command, bound)


def wrap_angle(angle_rad: float) -> float:
    """Return the same direction in [-pi, pi) [rad]. Angles in this range do not change by a bit."""
    if -math.pi <= angle_rad < math.pi:
        return angle_rad
    rest = fmod(angle_rad, _TURN_RAD)
    rest -= _TURN_RAD * floor((rest + math.pi) / _TURN_RAD)
    # Just below -pi the sum rounds up to pi itself, which is the same direction as -pi.
    return -math.pi if rest >= math.pi else rest


def count_begun(table: Any, rows: int, place: float) -> int:
    """Return how many rows begin at or before a place, by their first column, which rises."""
    low, high = 0, rows
    while low < high:
        middle = (low + high) // 2
        if place < table[middle][0]:
            high = middle
        else:
            low = middle + 1
    return low


def round_to_step(value: float, step: float) -> float:
    """Return the nearest multiple of a step, in a tie the even one.

    Without a step, return the value.
    """
    if step == 0.0:
        return value
    steps = value / step
    # Of a step far below the digits of a double there is no whole number: nothing is rounded.
    return step * nearest(steps) if math.isfinite(steps) else value


def nearest(value: float) -> float:
    """Return the nearest whole number, in a tie the even one; never -0.0."""
    return round(value)


def nearest_int(value: float) -> int:
    """Return the nearest whole number as an int, in a tie the even one."""
    return round(value)


def to_ns(time_s: float) -> int:
    """Return a time [s] in whole nanoseconds."""
    return nearest_int(time_s * 1e9)


def to_float32(value: float) -> float:
    """Return the nearest 32-bit float."""
    found: float = _unpack(_pack(value, 0.0, 0.0, 0.0, 0.0))[0]
    return found


def pose_to_float32(x_m: float, y_m: float, heading_rad: float) -> tuple[float, float, float]:
    """Return a pose of 32-bit floats."""
    x_m, y_m, heading_rad, _, _ = _unpack(_pack(x_m, y_m, heading_rad, 0.0, 0.0))
    return x_m, y_m, heading_rad


def message_to_float32(
    x_m: float, y_m: float, heading_rad: float, speed: float, turn_rate: float
) -> tuple[float, float, float, float, float]:
    """Return the contents of a pose message as 32-bit floats."""
    found: tuple[float, float, float, float, float]
    found = _unpack(_pack(x_m, y_m, heading_rad, speed, turn_rate))
    return found


def begin_row(rows: Any, new: Any, number: int) -> Any:
    """Return the row of a number, with defaults.

    Plain code makes the row with `new`; compiled code copies the row.
    """
    row = rows[number] = new()
    return row
