"""Valid ranges of inputs to theory: gains, periods, dead times and levels."""

import math
from numbers import Integral, Real
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from turtlelog.errors import TheoryError

SMALLEST: Final = 1e-100
LARGEST: Final = 1e100
"""Largest magnitude of a number, in its own unit. A product or quotient of two such numbers is
within 1e-200 to 1e200, so that it neither overflows a double (1.8e308) nor loses digits
(2.2e-308)."""

MAX_DEAD_TIME_TICKS: Final = 1000
"""Largest dead time [samples]: 16 s at turtlesim's tick of 16 ms."""

MAX_COUNT: Final = 100_000_000
"""Largest number of samples of a response: 800 MB as doubles."""


def require_gain(kp: Any) -> float:
    """Return a gain [1/s] as float; raise an error if it is not a positive number."""
    return require_positive("kp", kp, expected="a gain")


def require_period(period_s: Any) -> float:
    """Return a sampling period [s] as float; raise an error if it is not a positive number."""
    return require_positive("period_s", period_s, expected="a sampling period")


def require_dead_time(ticks: Any) -> int:
    """Return a dead time [ticks]; raise an error if it is not a whole number from 0 to 1000."""
    return _require_whole("dead_time_ticks", ticks, 0, MAX_DEAD_TIME_TICKS)


def require_count(count: Any) -> int:
    """Return a number of samples; raise an error if it is not a whole number from 1 to 1e8."""
    return _require_whole("count", count, 1, MAX_COUNT)


def require_level(name: str, value: Any) -> float:
    """Return a level of a signal as float; raise an error if it is not within +-1e100."""
    if not _is_real(value) or not abs(value) <= LARGEST:
        raise _refuse(name, "a number", value)
    return float(value)


def require_positive(name: str, value: Any, *, expected: str = "a number") -> float:
    """Return a magnitude as float; raise an error if it is not a positive number."""
    if not _is_real(value) or not value > 0.0:
        raise _refuse(name, f"{expected} > 0", value, low="greater than 0")
    if not SMALLEST <= value <= LARGEST:
        raise _refuse(name, f"{expected} from {SMALLEST:g} to {LARGEST:g}", value)
    return float(value)


def require_not_negative(name: str, value: Any) -> float:
    """Return a magnitude as float; raise an error if it is not a number from 0 to 1e100."""
    if not _is_real(value) or not 0.0 <= value <= LARGEST:
        raise _refuse(name, f"a number from 0 to {LARGEST:g}", value, low="0 or greater")
    return float(value)


def require_array(name: str, expected: str, values: Any) -> NDArray[np.float64]:
    """Return numbers as an array; raise an error for anything else."""
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as err:
        raise TheoryError(f"expected {expected}, found {err}", quantity=name) from err


def require_gains(kp: ArrayLike) -> NDArray[np.float64]:
    """Return gains [1/s] as an array of one axis; raise an error if any is negative."""
    gains = np.atleast_1d(require_array("kp", "an array of gains", kp))
    if gains.ndim != 1 or not len(gains):
        problem = f"expected a list of gains, found an array of shape {gains.shape}"
        raise TheoryError(problem, quantity="kp")
    is_outside = ~((gains >= 0.0) & (gains <= LARGEST))
    if is_outside.any():
        index = int(np.argmax(is_outside))
        problem = f"expected gains from 0 to {LARGEST:g}, found {gains[index]} at index {index}"
        raise TheoryError(problem, quantity="kp")
    return gains


def require_times(time_s: ArrayLike) -> NDArray[np.float64]:
    """Return times [s] as an array; raise an error if any is not finite."""
    times = require_array("time_s", "an array of times", time_s)
    if not np.isfinite(times).all():
        raise TheoryError("expected finite times, found nan or inf", quantity="time_s")
    return times


def require_even_times(time_s: ArrayLike) -> NDArray[np.float64]:
    """Return times [s] at which python-control can simulate; raise an error for other times."""
    times = require_times(time_s)
    if times.ndim != 1:
        problem = f"expected a list of times, found an array of shape {times.shape}"
        raise TheoryError(problem, quantity="time_s")
    if len(times) < 2 or times[0] != 0.0:
        found = f"{len(times)}, the first {times[0]}" if len(times) else "none"
        problem = f"times must start at 0 and have at least 2 values, found {found}"
        raise TheoryError(problem, quantity="time_s")
    steps = np.diff(times)
    if not steps.min() > 0.0 or not np.allclose(steps, steps[0], rtol=1e-6, atol=0.0):
        raise TheoryError("expected even steps forward, found uneven ones", quantity="time_s")
    return times


def _require_whole(name: str, value: Any, lowest: int, highest: int) -> int:
    is_whole = isinstance(value, Integral) and not isinstance(value, bool)
    if not is_whole or not lowest <= value <= highest:
        low = "0 or greater" if lowest == 0 else ""
        raise _refuse(name, f"a whole number from {lowest} to {highest}", value, low=low)
    return int(value)


def _refuse(name: str, expected: str, value: Any, *, low: str = "") -> TheoryError:
    """Return an error on a value; `low` says in short what a finite number up to 0 must be."""
    is_low = low and _is_real(value) and math.isfinite(value) and value <= 0
    problem = f"expected {expected}, found {value!r}"
    return TheoryError(problem, quantity=name, value=value, must=low if is_low else expected)


def _is_real(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool | np.bool_)
