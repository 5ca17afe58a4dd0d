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
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from turtlelog.errors import TheoryError
from turtlelog.libraries import load_library
from turtlelog.theory.inputs import (
    MAX_DEAD_TIME_TICKS,
    require_dead_time,
    require_not_negative,
    require_period,
    require_positive,
)

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


INTEGRATOR: Final = Process()
"""The plant of turtlesim, 1/s."""


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
    def at(self) -> float:
        """Weight w0; (T - m) / T without lag."""
        return 1.0 - self.ahead - self.behind

    @property
    def delay(self) -> int:
        """Number of poles at z = 0: d, or one less with a low-pass, whose zero cancels one pole."""
        return self.whole - (self.filter_gap is not None)

    @property
    def gaps(self) -> tuple[float, ...]:
        """1 - e for each pole e of lag and low-pass."""
        return tuple(gap for gap in (self.lag_gap, self.filter_gap) if gap is not None)

    def list_weights(self) -> tuple[float, float, float]:
        """Return the weights of commands d, d + 1 and d + 2 samples old in the input of the lag."""
        weights = (self.at, self.behind, 0.0)
        if self.lag_gap is not None:
            weights = (self.ahead, self.at, self.behind)
        return self.gain * weights[0], self.gain * weights[1], self.gain * weights[2]

    @property
    def is_integrator(self) -> bool:
        """Whether the process is an integrator whose dead time is a whole number of samples."""
        return not (self.gaps or self.behind)


def sample_process(process: Process, period_s: float, dead_time_ticks: int = 0) -> SampledProcess:
    """Return a process sampled with a period, and an additional dead time, up to 1000 samples."""
    period_s = require_period(period_s)
    whole, part = _split_dead_time(process, period_s, dead_time_ticks)
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


def _split_dead_time(process: Process, period_s: float, dead_time_ticks: int) -> tuple[int, float]:
    """Return the dead time as whole samples and the remaining fraction of a sample, below 1."""
    ticks = require_dead_time(dead_time_ticks)
    samples = ticks + process.dead_time_s / period_s
    if not samples <= MAX_DEAD_TIME_TICKS + _WHOLE:
        longest_s = (MAX_DEAD_TIME_TICKS - ticks) * period_s
        most = f"at most {longest_s:.6g} s ({MAX_DEAD_TIME_TICKS} samples in all)"
        raise _refuse_time("dead_time_s", process.dead_time_s, most)
    whole = math.floor(samples + _WHOLE)
    part = samples - whole
    return whole, part if part > _WHOLE else 0.0


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
    lags = [(gap, (gap - 1.0, 1.0)) for gap in shape.gaps]
    above: list[Any] = [
        _shift(shape.numerator),
        (shape.behind, 1.0 - shape.ahead - shape.behind, shape.ahead),
        *((gap,) for gap, _ in lags),
    ]
    below: list[Any] = [
        *[(-1.0, 1.0)] * shape.integrators,
        *([(-shape.a, 1.0)] if shape.a is not None else []),
        *(pole for _, pole in lags),
    ]
    delay = shape.delay + 1  # the weights of the process, times z
    if not shape.behind:
        above[1], delay = above[1][1:], shape.delay
    (above if delay < 0 else below).append((0.0,) * abs(delay) + (1.0,))
    tf = load_library("control").tf
    return tf(_expand(above), _expand(below), period_s)


def _shift(coefficients: Sequence[float]) -> Any:
    """Return a polynomial in z - 1 as a polynomial in z, in rising powers."""
    from numpy.polynomial import polynomial  # few theories need it

    total = np.zeros(1)
    for power, value in enumerate(coefficients):
        total = polynomial.polyadd(total, value * polynomial.polypow((-1.0, 1.0), power))
    return total


def _expand(factors: Sequence[Any]) -> Any:
    """Return a product of polynomials in falling powers."""
    from numpy.polynomial import polynomial  # few theories need it

    product = np.ones(1)
    for factor in factors:
        product = polynomial.polymul(product, factor)
    return np.trim_zeros(product[::-1], "f")
