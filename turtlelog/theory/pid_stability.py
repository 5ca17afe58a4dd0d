"""Stability of a PID controller with a process, by counting poles; stability margins.

The open loop at the frequency w is L(exp(j w T)), with the hold, the fractional dead time and the
controller as programmed. L is exact up to pi / T, and periodic above. The margins are read where L
crosses the unit circle and the negative real axis.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from turtlelog.errors import TheoryError
from turtlelog.theory.process import (
    SampledProcess,
    require_gain,
    require_not_negative,
    require_period,
)

_Array = NDArray[np.float64]

NEAREST: Final = 1e-10
"""Distance |1 + L| of the open loop from -1 below which rounding could decide: with 1000 ticks of
dead time the phase of L is accurate to some 1e-12. A nearer loop counts as unstable."""

_NO_POWER: Final = 1e-20
"""Share of the other coefficients below which a highest coefficient changes no sign for x up to
2."""

_SMALLEST_X: Final = 1e-60
"""Smallest x = 1 - cos(w T), below every crossover: crossovers are above (Kp T)^2 / 8, at least
1e-19."""


@dataclass(frozen=True, slots=True)
class LoopShape:
    """A PID loop in dimensionless form.

    Attributes:
        p, i, b: K Kp T, K Ki T^2 and K Kd T / (Tf + T), with the gain K of the process.
        a: Tf / (Tf + T), from 0 up to 1; None: no derivative.
        delay: Dead time d [samples]; with a low-pass one sample less, so the value may be -1.
        gaps: 1 - e for each pole e of lag and low-pass.
        ahead, behind: Weights w1 and w2, see `process`.
    """

    p: float
    i: float
    b: float
    a: float | None
    delay: int
    gaps: tuple[float, ...] = ()
    ahead: float = 0.0
    behind: float = 0.0

    @property
    def integrators(self) -> int:
        """Number of open-loop poles at z = 1."""
        return 2 if self.i > 0.0 else 1

    @property
    def lift(self) -> int:
        """Power of z, 0 or 1, by which z^d A(z) + B(z) is multiplied to become a polynomial."""
        return int(self.behind > 0.0 or self.delay < 0)

    @property
    def degree(self) -> int:
        """Number of poles of the closed loop."""
        own = self.integrators + (self.a is not None) + len(self.gaps)
        return self.delay + own + self.lift

    @property
    def numerator(self) -> tuple[float, float, float]:
        """B in powers of z - 1: constant, linear, quadratic."""
        if self.a is None:
            return (self.i, self.p, 0.0) if self.i > 0.0 else (self.p, 0.0, 0.0)
        gap = 1.0 - self.a
        if self.i > 0.0:
            return self.i * gap, self.p * gap + self.i, self.p + self.b
        return self.p * gap, self.p + self.b, 0.0


def is_stable(shape: LoopShape) -> bool:
    """Return whether all poles lie inside the unit circle by more than rounding."""
    return _count_unstable(shape) == 0


def _count_unstable(shape: LoopShape) -> int | None:
    """Return the number of poles outside the unit circle; None if rounding could decide."""
    c0, c1, c2 = shape.numerator
    last = (-1.0) ** shape.delay * (-2.0) ** shape.integrators
    last *= 1.0 if shape.a is None else -1.0 - shape.a
    at_end = (c0 - 2.0 * c1 + 4.0 * c2) / last * _weigh_end(shape)  # L at z = -1
    crossings = _find_crossovers(shape)
    halves = [0.5 * _compute_phase(shape, x) for x in crossings]
    # |1 + L| = 2 cos(half the phase) where |L| = 1.
    if any(2.0 * math.cos(half) < NEAREST for half in halves) or abs(1.0 + at_end) < NEAREST:
        return None
    edges, halves = [0.0, *crossings, 2.0], [0.0, *halves, 0.0]
    phase = 0.0
    for number, (low, high) in enumerate(pairwise(edges)):
        change = halves[number + 1] - halves[number]
        if _compare(shape, 0.5 * (low + high)) > 0.0:
            phase += _turn_poles(shape, high) - _turn_poles(shape, low) + change
        else:
            phase += _turn_zeros(shape, high) - _turn_zeros(shape, low) - change
    return shape.degree - shape.lift - round(phase / math.pi)


def find_stable_intervals(
    build: Callable[[float], LoopShape], held: LoopShape
) -> tuple[tuple[float, float], ...]:
    """Return the intervals of Kp T in which `build(Kp T)` is stable; `held` has the other gains."""
    edges = sorted({0.0, *(p for p in _list_boundaries(held) if p > 0.0)})
    found: list[tuple[float, float]] = []
    for low, high in pairwise(edges):
        if high - low > NEAREST * high and is_stable(build(0.5 * (low + high))):
            joined = bool(found) and found[-1][1] == low
            found[-1:] = [(found[-1][0], high)] if joined else [*found[-1:], (low, high)]
    return tuple(found)


def _find_crossovers(shape: LoopShape) -> list[float]:
    """Return the points with |L| = 1 as x = 1 - cos(w T), strictly between 0 and 2, rising."""
    coefficients = _list_coefficients(shape)
    slope = [power * value for power, value in enumerate(coefficients)][1:]
    while len(slope) > 1 and abs(slope[-1]) < _NO_POWER * max(map(abs, slope[:-1])):
        slope.pop()
    turns = [root.real for root in np.roots(slope[::-1]) if abs(root.imag) <= 1e-6 * abs(root)]
    edges = [_SMALLEST_X, *sorted(x for x in turns if _SMALLEST_X < x < 2.0), 2.0]
    return [
        _bisect(shape, low, high)
        for low, high in pairwise(edges)
        if (_compare(shape, low) > 0.0) != (_compare(shape, high) > 0.0)
    ]


def _bisect(shape: LoopShape, low: float, high: float) -> float:
    """Return the x between two x at which |A| = |B|, to the last digit at any magnitude."""
    is_above = _compare(shape, low) > 0.0
    for _ in range(64):  # 8 halvings of the exponent, 52 of the digits, some to spare
        middle = math.sqrt(low * high)
        if (_compare(shape, middle) > 0.0) == is_above:
            low = middle
        else:
            high = middle
    return math.sqrt(low * high)


def _list_coefficients(shape: LoopShape) -> list[float]:
    """Return |A|^2 - |B|^2 on the unit circle in rising powers of x, up to a factor."""
    from numpy.polynomial.polynomial import polyadd, polymul  # few theories need it

    c0, c1, c2 = shape.numerator
    found = [-c0 * c0, 2.0 * (c1 * c0 + 2.0 * c2 * c0 - c1 * c1), 4.0 * c2 * (c1 - c2 - c0), 0.0]
    gap = 1.0 if shape.a is None else 1.0 - shape.a
    both, apart = shape.ahead + shape.behind, shape.ahead - shape.behind
    # |W|^2 on the unit circle in rising powers of x.
    weights = [1.0, 2.0 * (apart * apart - both), 4.0 * shape.ahead * shape.behind]
    zeros: Any = polymul(found, weights)
    own = [gap * gap, 2.0 * (shape.a or 0.0)]
    poles: Any = np.array([*[0.0] * shape.integrators, *own]) * 2.0**shape.integrators
    for gap in shape.gaps:
        poles = polymul(poles, [gap * gap, 2.0 * (1.0 - gap)])
        zeros = zeros * (gap * gap)
    values: list[float] = polyadd(zeros, poles).tolist()
    largest = max(map(abs, values))
    return [value / largest for value in values]


def _compare(shape: LoopShape, x: float) -> float:
    """Return a number with the sign of |A| - |B|."""
    c0, c1, c2 = shape.numerator
    gap = 1.0 if shape.a is None else 1.0 - shape.a
    poles = (2.0 * x) ** shape.integrators * (gap * gap + 2.0 * (shape.a or 0.0) * x)
    # The real and imaginary part of B / z, whose squares lose no digits near z = 1.
    real, imaginary = c0 - x * (2.0 * c2 - c1 + c0), (c1 - c0) * math.sqrt(x * (2.0 - x))
    weight, apart = 1.0 - (shape.ahead + shape.behind) * x, shape.ahead - shape.behind
    lift = weight * weight + apart * apart * x * (2.0 - x)
    for gap in shape.gaps:
        poles *= gap * gap + 2.0 * (1.0 - gap) * x
        lift *= gap * gap
    return poles - real * real * lift - imaginary * imaginary * lift


def _turn_zeros(shape: LoopShape, x: float) -> float:
    """Return the phase of B at x, continuous along the half circle.

    The imaginary part of B / z, (c1 - c0) sin(w T), has one sign, as has the imaginary part of W.
    """
    c0, c1, c2 = shape.numerator
    sine = math.sqrt(x * (2.0 - x))
    turn = math.atan2((c1 - c0) * sine, c0 - x * (2.0 * c2 - c1 + c0))
    weight = 1.0 - (shape.ahead + shape.behind) * x
    return _find_angle(x) + turn + math.atan2((shape.ahead - shape.behind) * sine, weight)


def _turn_poles(shape: LoopShape, x: float) -> float:
    """Return the phase of z^d A at x, continuous along the half circle."""
    angle = _find_angle(x)
    turn = shape.delay * angle + shape.integrators * 0.5 * (angle + math.pi)
    gaps = shape.gaps if shape.a is None else (1.0 - shape.a, *shape.gaps)
    for gap in gaps:
        turn += math.atan2(math.sqrt(x * (2.0 - x)), gap - x)
    return turn


def _compute_phase(shape: LoopShape, x: float) -> float:
    """Return the phase of L at x, in [-pi, pi]."""
    return math.remainder(_turn_zeros(shape, x) - _turn_poles(shape, x), 2.0 * math.pi)


def _find_angle(x: float) -> float:
    """Return w T for x = 1 - cos(w T)."""
    return 2.0 * math.asin(math.sqrt(0.5 * x))


def _weigh_end(shape: LoopShape) -> float:
    """Return the factor of lag, low-pass and fractional dead time in the open loop at z = -1."""
    factors = [gap / (gap - 2.0) for gap in shape.gaps]
    return math.prod(factors, start=1.0 - 2.0 * (shape.ahead + shape.behind))


def _list_boundaries(held: LoopShape) -> list[float]:
    """Return every Kp T at which a pole lies on the unit circle, and 0 if no pole lies there at 0.

    At such a pole Kp T = -(z^d (z - 1) V + Ki T^2 / (z - 1) + b (z - 1) / (z - a)), which must be
    real; V is the product of (z - e) / (1 - e) over the poles e, divided by W.
    """
    d, a = held.delay, held.a or 0.0

    def split(angle: _Array) -> tuple[_Array, _Array]:
        """Return the real part of Kp T, and the imaginary part divided by -sin(angle)."""
        sine, cosine = np.sin(0.5 * angle), np.cos(0.5 * angle)
        x = 2.0 * sine * sine
        # Magnitude and phase of V.
        sines, apart = np.sin(angle), held.ahead - held.behind
        weight = 1.0 - (held.ahead + held.behind) * x
        size = 1.0 / np.hypot(weight, apart * sines)
        turn = -np.arctan2(apart * sines, weight)
        for gap in held.gaps:
            size *= np.hypot(gap - x, sines) / gap
            turn += np.arctan2(sines, gap - x)
        turn += (d + 0.5) * angle
        filtered = (1.0 - a) ** 2 + 2.0 * a * x
        real = 2.0 * np.sin(turn) * sine * size + 0.5 * held.i
        real -= held.b * (1.0 + a) * x / filtered
        rest = np.cos(turn) * size / cosine - held.i / (4.0 * sine * sine)
        return real, rest + held.b * (1.0 - a) / filtered

    angles = find_sign_changes(lambda angle: split(angle)[1], list_angles(held))
    found: list[float] = split(angles)[0].tolist()
    end = _weigh_end(held)
    if end != 0.0:  # at z = -1
        found.append(2.0 * (-1.0) ** d / end + 0.5 * held.i - 2.0 * held.b / (1.0 + a))
    return found


def list_angles(shape: LoopShape) -> _Array:
    """Return angles w T between 0 and pi, 64 per half wave of the phase, denser towards 0."""
    waves = shape.delay + 2 + 2 * len(shape.gaps)
    even = np.linspace(0.0, math.pi - 1e-7, 64 * waves)[1:]
    return np.union1d(np.geomspace(1e-12, 0.1, 3000), even)


def find_sign_changes(compute: Callable[[_Array], _Array], angles: _Array) -> _Array:
    """Return the angles at which a function changes its sign."""
    is_above = compute(angles) > 0.0
    at = np.flatnonzero(is_above[1:] != is_above[:-1])
    low, high, rises = angles[at], angles[at + 1], is_above[at + 1]
    for _ in range(60):  # more than the 52 digits of a double
        middle = 0.5 * (low + high)
        beyond = (compute(middle) > 0.0) == rises
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    found: _Array = 0.5 * (low + high)
    return found


def find_maximum(compute: Callable[[_Array], _Array], high: float) -> tuple[float, float]:
    """Return the place and value of the only maximum of a function between 0 and another end."""
    low = 0.0
    for _ in range(9):  # a 50th each time: 1e-15 of the interval
        places = np.linspace(low, high, 102)[1:-1]
        values = compute(places)
        best = int(np.argmax(values))
        low, high = (low, *places, high)[best], (low, *places, high)[best + 2]
    return float(places[best]), float(values[best])


_LARGEST_FACTOR: Final = 1e12
"""Largest factor; its reciprocal is the smallest. Beyond these, crossings are rounding: L is 0 at
pi, or grows without bound towards 0 with a phase that goes to -180 deg."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Margins:
    """Stability margins of a loop.

    Attributes:
        gain_margin: Smallest factor above 1 on all gains that makes the loop unstable; None if no
            factor does.
        gain_reduction: Largest factor below 1 on all gains that makes the loop unstable; None if no
            factor does.
        gain_frequency_rad_s: Frequency at which the open loop has the phase -180 deg for
            `gain_margin` [rad/s]; None without a gain margin.
        phase_margin_rad: Smallest loss of phase, at an open-loop magnitude of 1, that makes the
            loop unstable [rad]; None if the magnitude is never 1.
        crossover_rad_s: Frequency of the phase margin [rad/s]; None without a phase margin.
        delay_margin_s: Additional dead time up to which the loop is stable [s], exact for whole
            periods. None without a crossover.
    """

    gain_margin: float | None
    gain_reduction: float | None
    gain_frequency_rad_s: float | None
    phase_margin_rad: float | None
    crossover_rad_s: float | None
    delay_margin_s: float | None


def evaluate_open_loop(shape: LoopShape, angle: ArrayLike) -> NDArray[np.complex128]:
    """Return L at angles w T above 0 and up to pi, in the shape of `angle`."""
    angles = np.asarray(angle, dtype=np.float64)
    sine = np.sin(0.5 * angles)
    from_one = -2.0 * sine * sine + 1j * np.sin(angles)  # z - 1, whose digits z has lost near 1
    z = np.exp(1j * angles)
    c0, c1, c2 = shape.numerator
    found = c0 + from_one * (c1 + from_one * c2)
    found = found * (1.0 + shape.ahead * from_one + shape.behind * (1.0 / z - 1.0))
    found = found / from_one**shape.integrators * z**-shape.delay
    if shape.a is not None:
        found = found / (from_one + (1.0 - shape.a))
    for gap in shape.gaps:
        found = found * gap / (from_one + gap)
    return np.asarray(found, dtype=np.complex128)


def find_margins(shape: LoopShape, period_s: float) -> Margins:
    """Return the margins of a stable loop."""
    found = [(math.pi + _compute_phase(shape, x), _find_angle(x)) for x in _find_crossovers(shape)]
    phases = [(phase % (2.0 * math.pi), angle) for phase, angle in found]
    phase, crossover = min(phases, default=(None, None))
    # Each factor for which L passes through -1, with the angle w T of the crossing.
    reals = find_sign_changes(
        lambda angle: evaluate_open_loop(shape, angle).imag, list_angles(shape)
    )
    angles = np.append(reals, math.pi)
    values = evaluate_open_loop(shape, angles).real
    kept = (values > -_LARGEST_FACTOR) & (values < -1.0 / _LARGEST_FACTOR)
    factors = [*zip((-1.0 / values[kept]).tolist(), angles[kept].tolist(), strict=True)]
    above = min(((factor, angle) for factor, angle in factors if factor > 1.0), default=None)
    delay = min((phase / angle for phase, angle in phases), default=None)
    return Margins(
        gain_margin=None if above is None else above[0],
        gain_reduction=max((factor for factor, _ in factors if factor < 1.0), default=None),
        gain_frequency_rad_s=None if above is None else above[1] / period_s,
        phase_margin_rad=phase,
        crossover_rad_s=None if crossover is None else crossover / period_s,
        delay_margin_s=None if delay is None else delay * period_s,
    )


_SMALLEST_LOOP_GAIN: Final = 1e-9
_LARGEST_LOOP_GAIN: Final = 1e9
"""Largest K Kp T, K Ki T^2 and K Kd T / (Tf + T) of any loop except P on an integrator: squares and
fourth powers keep their digits. Stable loops stay far below this limit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PidGains:
    """Gains of a P, PI, PD or PID controller.

    Attributes:
        kp: Proportional gain [1/s].
        ki: Integral gain [1/s^2]; 0: no integral.
        kd: Derivative gain [1]; 0: no derivative.
        filter_s: Time constant Tf of the derivative's filter [s]; 0: the difference of two samples
            without a filter.

    Raises:
        TheoryError: If a gain is negative or not finite, or Kp is not positive.
    """

    kp: float
    ki: float = 0.0
    kd: float = 0.0
    filter_s: float = 0.0

    def __post_init__(self) -> None:
        require_gain(self.kp)
        for name in ("ki", "kd", "filter_s"):
            require_not_negative(name, getattr(self, name))

    @property
    def is_proportional(self) -> bool:
        """Whether the controller is P alone."""
        return self.ki == 0.0 and self.kd == 0.0

    def weigh_derivative(self, period_s: float) -> tuple[float, float]:
        """Return a = Tf / (Tf + T) and Kd / (Tf + T) [1/s]."""
        whole_s = self.filter_s + period_s
        return self.filter_s / whole_s, self.kd / whole_s


def build_shape(gains: PidGains, sampled: SampledProcess, period_s: float) -> LoopShape:
    """Return a loop in dimensionless form, or raise TheoryError if a number is out of its range."""
    period_s = require_period(period_s)
    keep, rate = gains.weigh_derivative(period_s)
    p, i, b = gains.kp * period_s, gains.ki * period_s * period_s, rate * period_s
    p, i, b = p * sampled.gain, i * sampled.gain, b * sampled.gain
    if not (gains.is_proportional and sampled.is_integrator):
        _require_loop_gain("Kp T", p, lowest=_SMALLEST_LOOP_GAIN)
        _require_loop_gain("Ki T^2", i, lowest=0.0)
        _require_loop_gain("Kd T / (Tf + T)", b, lowest=0.0)
    return LoopShape(
        p=p,
        i=i,
        b=b,
        a=keep if gains.kd > 0.0 else None,
        delay=sampled.delay,
        gaps=sampled.gaps,
        ahead=sampled.ahead,
        behind=sampled.behind,
    )


def _require_loop_gain(name: str, value: float, *, lowest: float) -> None:
    if not lowest <= value <= _LARGEST_LOOP_GAIN:
        expected = f"a loop gain from {lowest:g} to {_LARGEST_LOOP_GAIN:g}"
        raise TheoryError(f"{name}: expected {expected}, found {value!r}")
