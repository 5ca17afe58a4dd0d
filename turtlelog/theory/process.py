"""The process from command to signal: K exp(-L s) / ((tau s + 1) s), with an optional low-pass.

The process is sampled every T with zero-order hold. Dead time may include any fraction of a sample:
L = d T + m with 0 <= m < T. Between two samples the plant then receives one command for m and the
next for T - m. The response is therefore exact, without a Pade approximation (K. J. Astrom and B.
Wittenmark, Computer-Controlled Systems, 3rd edition, section 2.6 and the modified z transform of
chapter 2). With a = T / tau, c = m / tau and e = exp(-a):

    y / u = K T / (z - 1)  (1 - e) / (z - e)  z^-d (w1 z + w0 + w2 / z)

    w1 = G(c - a) / (a (1 - e)),  w2 = e G(c) / (a (1 - e)),  w0 = 1 - w1 - w2,
    G(v) = exp(v) - 1 - v

Without lag, e = 0, and (w1 z + w0 + w2 / z) / z is (T - m) / T + m / (T z).

The low-pass acts in the controller, before the plant: v += (1 - exp(-T / Tl)) (u - v), once per
sample.

The end of the file has the valid ranges of theory's inputs: gains, periods, dead times and levels.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from turtlelog.errors import TheoryError
from turtlelog.libraries import load_library

if TYPE_CHECKING:
    from turtlelog.theory.pid_stability import LoopShape


_WHOLE: Final = 1e-9
"""Largest distance from a whole number of samples, as a share of a sample, at which a dead time
counts as whole. 0.688 / 0.016 is not exactly 43 in binary: 7e-15 are missing."""

_LONGEST_LAG: Final = 1e9
"""Longest lag or low-pass [samples]: gaps 1 - e of 1e-9 and their squares keep their digits beside
a gain of the same size."""

_SHORTEST_LAG: Final = 1e-3
"""Shortest lag [samples]: exp(-1000) is 0 in double precision, so a shorter lag changes no
sample."""

_SERIES_BELOW: Final = 0.5
"""Magnitude of v below which exp(v) - 1 - v loses digits, and a series of 14 terms is used
instead."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Process:
    """Process between a law's command and the signal: a delayed and lagged rate, integrated.

    Attributes:
        gain: Gain K, rate divided by command [1].
        lag_s: Time constant tau of the rate [s]; 0: no lag.
        dead_time_s: Time until a command begins to act [s], which is added to dead times in whole
            samples.
        low_pass_s: Time constant of a first-order filter of the command in the controller [s]; 0:
            no filter.

    Raises:
        TheoryError: If the gain is not positive, or a time is negative or not finite.
    """

    gain: float = 1.0
    lag_s: float = 0.0
    dead_time_s: float = 0.0
    low_pass_s: float = 0.0

    def __post_init__(self) -> None:
        require_positive("gain", self.gain)
        for name in ("lag_s", "dead_time_s", "low_pass_s"):
            require_not_negative(name, getattr(self, name))

    def to_control(self, pade_order: int = 4) -> Any:
        """Return a continuous `control.TransferFunction` from the command to the signal.

        Args:
            pade_order: Order of the rational function that approximates the dead time; 0: the dead
                time is left out.

        Raises:
            TheoryError: If the order is negative.
            LibraryError: If python-control is not installed.
        """
        lags = (self.lag_s * self.low_pass_s, self.lag_s + self.low_pass_s, 1.0, 0.0)
        return build_delayed([self.gain], lags, self.dead_time_s, pade_order)


def build_delayed(
    numerator: Sequence[float], denominator: Sequence[float], dead_time_s: float, pade_order: int
) -> Any:
    """Return a continuous `control.TransferFunction` with a dead time.

    Coefficients are in falling powers of s. `pade_order` is the order of the Pade approximation of
    the dead time; 0: the dead time is left out.

    Raises:
        TheoryError: If the order is negative.
        LibraryError: If python-control is not installed.
    """
    if pade_order < 0:
        raise TheoryError(f"must be at least 0, not {pade_order}", quantity="pade_order")
    control = load_library("control")
    system = control.tf(list(numerator), list(denominator))
    if not pade_order or not dead_time_s:
        return system
    return control.tf(*control.pade(dead_time_s, pade_order)) * system


@dataclass(frozen=True, slots=True, kw_only=True)
class SampledProcess:
    """A sampled process.

    Attributes:
        gain: Gain K.
        whole, part: Dead time as whole samples d, and the remaining fraction m / T of a sample.
        ahead, behind: Weights w1 and w2; 0 and m / T without lag.
        lag_gap: 1 - e of the lag; None without lag.
        filter_gap: 1 - exp(-T / Tl) of the low-pass; None without low-pass.
    """

    gain: float
    whole: int
    part: float
    ahead: float
    behind: float
    lag_gap: float | None
    filter_gap: float | None

    @property
    def delay(self) -> int:
        """Number of poles at z = 0: d, or one less with a low-pass, whose zero cancels one pole."""
        return self.whole - (self.filter_gap is not None)

    @property
    def gaps(self) -> tuple[float, ...]:
        """1 - e for each pole e of lag and low-pass."""
        return tuple(gap for gap in (self.lag_gap, self.filter_gap) if gap is not None)

    @property
    def is_integrator(self) -> bool:
        """Whether the process is an integrator whose dead time is a whole number of samples."""
        return not (self.gaps or self.behind)


def sample_process(process: Process, period_s: float, dead_time_ticks: int = 0) -> SampledProcess:
    """Return a process sampled with a period, and an additional dead time, up to 1000 samples."""
    period_s = require_period(period_s)
    ticks = require_dead_time(dead_time_ticks)
    samples = ticks + process.dead_time_s / period_s
    if not samples <= MAX_DEAD_TIME_TICKS + _WHOLE:
        longest_s = (MAX_DEAD_TIME_TICKS - ticks) * period_s
        most = f"at most {longest_s:.6g} s ({MAX_DEAD_TIME_TICKS} samples in all)"
        raise _refuse_time("dead_time_s", process.dead_time_s, most)
    whole = math.floor(samples + _WHOLE)
    part = samples - whole if samples - whole > _WHOLE else 0.0
    lag = _scale_time("lag_s", process.lag_s, period_s)
    low_pass = _scale_time("low_pass_s", process.low_pass_s, period_s)
    ahead, behind = _weigh(1.0 / lag, part) if lag else (0.0, part)
    return SampledProcess(
        gain=process.gain,
        whole=whole,
        part=part,
        ahead=ahead,
        behind=behind,
        lag_gap=-math.expm1(-1.0 / lag) if lag else None,
        filter_gap=-math.expm1(-1.0 / low_pass) if low_pass else None,
    )


def _scale_time(name: str, time_s: float, period_s: float) -> float:
    """Return a time constant in samples; 0 if it is too short to change a sample."""
    samples = time_s / period_s
    if samples > _LONGEST_LAG:
        most = f"at most {_LONGEST_LAG * period_s:.6g} s ({_LONGEST_LAG:g} sampling periods)"
        raise _refuse_time(name, time_s, most)
    return samples if samples >= _SHORTEST_LAG else 0.0


def _refuse_time(name: str, time_s: float, most: str) -> TheoryError:
    """Return an error on a time that is too long for the sampling period."""
    problem = f"expected {most}, found {time_s:.6g} s"
    return TheoryError(problem, quantity=name, value=time_s, must=most)


def _weigh(a: float, part: float) -> tuple[float, float]:
    """Return w1 and w2 for T / tau = a and m = part T."""
    c = a * part
    whole = a * -math.expm1(-a)
    if c < _SERIES_BELOW:
        late = math.exp(-a) * _rest(c)
    else:  # exp(c) alone could overflow
        late = math.exp(c - a) - math.exp(-a) * (1.0 + c)
    return _rest(c - a) / whole, late / whole


def _rest(value: float) -> float:
    """Return exp(v) - 1 - v to full precision."""
    if abs(value) > _SERIES_BELOW:
        return math.expm1(value) - value
    term = total = 0.5 * value * value
    for power in range(3, 17):
        term *= value / power
        total += term
    return total


def build_open_loop(shape: "LoopShape", period_s: float) -> Any:
    """Return the open loop of a sampled PID as a discrete, exact `control.TransferFunction`."""
    from numpy.polynomial import polynomial  # few theories need it

    numerator = np.zeros(1)  # in rising powers of z, from powers of z - 1
    for power, value in enumerate(shape.numerator):
        numerator = polynomial.polyadd(numerator, value * polynomial.polypow((-1.0, 1.0), power))
    weights = [shape.behind, 1.0 - shape.ahead - shape.behind, shape.ahead]
    delay = shape.delay + 1  # the weights of the process, times z
    if not shape.behind:
        weights, delay = weights[1:], shape.delay
    above: list[Any] = [numerator, weights, *((gap,) for gap in shape.gaps)]
    below: list[Any] = [
        *[(-1.0, 1.0)] * shape.integrators,
        *([(-shape.a, 1.0)] if shape.a is not None else []),
        *((gap - 1.0, 1.0) for gap in shape.gaps),
    ]
    (above if delay < 0 else below).append((0.0,) * abs(delay) + (1.0,))
    multiply: Any = polynomial.polymul
    products = [reduce(multiply, factors, np.ones(1)) for factors in (above, below)]
    sides = [np.trim_zeros(product[::-1], "f") for product in products]
    return load_library("control").tf(*sides, period_s)


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


INTEGRATOR: Final = Process()
"""The plant of turtlesim, 1/s."""
