"""Gains that give a sampled loop exactly a wanted overshoot or phase margin.

Let L1 be the open loop in z at Kp = 1, G the process and W the phase margin:

    P    overshoot     the smallest Kp whose motion overshoots by as much
    P    phase margin  Kp = 1 / |L1| where L1 has the phase W - pi
    PI   overshoot     Kp the largest of P without overshoot, then the smallest such Ki
    PI   phase margin  the largest Ki among C = exp(j (W - pi)) / G at all frequencies
    PD   phase margin  Kd puts the controller's zero on the pole of the slowest lag
    PD   overshoot     both at once: the first on the way from that PD to P

C = Kp + Ki T / (z - 1) gives one Kp and one Ki at each frequency. The largest Ki gives the smallest
integrated error, 1 / Ki, after a constant disturbance. K. J. Astrom, H. Panagopoulos and T.
Hagglund maximise Ki under another constraint (Automatica 34 (1998) 585-601). Kp + Kd / (Tf + T) (z
- 1) / (z - a) has its zero at e = exp(-T / tau) if Kd = Kp (Tf + T) (e - a) / (1 - e); this also
gives one Kp and one Kd at each frequency.

P has no overshoot up to the Kp at which its two slowest poles meet on the real axis: the maximum of
-1 / L1(z) between the slowest lag's pole and 1. For an integrator, `sampled_loop` has this Kp in
closed form. The overshoot is measured on the motion, also between samples; with limits of the
acceleration, on the motions of all steps up to the largest.
"""

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.theory.pid_loop import find_stable_gains
from turtlelog.theory.pid_stability import (
    LoopShape,
    Margins,
    PidGains,
    build_shape,
    evaluate_open_loop,
    find_margins,
    find_sign_changes,
    is_stable,
    list_angles,
)
from turtlelog.theory.process import Process, SampledProcess, sample_process
from turtlelog.theory.step_motion import StepLimits, StepMotion, measure_step_motion

_Array = NDArray[np.float64]

_MOST_SAMPLES: Final = 2000
"""Largest sum of lag, low-pass and dead time [samples] for which overshoots are measured. Beyond
this sum, the 10 to 40 responses of some ten thousand samples each take several seconds."""

_CLOSE: Final = 1e-6
"""Tolerance of an overshoot [% of the step]; a smaller overshoot counts as none."""

_CLOSE_PHASE: Final = 1e-9
"""Tolerance of a phase margin [rad]; rounding leaves 1e-12."""

_CLOSE_GAIN: Final = 1e-3
"""Tolerance of the largest gain without overshoot under limits, as a share of the gain."""

_STEP: Final = 1.25
"""Factor from one gain to the next while the overshoot is too small."""

_LARGEST_OVERSHOOT: Final = 1e3
"""Overshoot of a response that diverges [%]: every wanted overshoot is below 100 %."""

_TRACE: Final = 1e-3
"""Overshoot that counts as none in a search with limits [%]: the accuracy of limited motions."""

_PARTS: Final = 8
"""Number of PD gains tried between the crossovers of P and of the PD that cancels the lag."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopDesign:
    """A loop whose gains are to be found: its process with all dead time, its clock, its limits."""

    process: Process
    period_s: float
    filter_s: float = 0.0
    limits: StepLimits | None = None

    @property
    def sampled(self) -> SampledProcess:
        """The process sampled with the period."""
        return sample_process(self.process, self.period_s)

    @property
    def unit_gain(self) -> float:
        """The Kp [1/s] for which K Kp T = 1."""
        return 1.0 / (self.process.gain * self.period_s)

    @property
    def close(self) -> float:
        """Tolerance of an overshoot [% of the step]."""
        return _CLOSE if self.limits is None else _TRACE

    @property
    def is_slow(self) -> bool:
        """Whether the responses of the loop are too long to measure."""
        process = self.process
        slow_s = process.lag_s + process.low_pass_s + process.dead_time_s
        return slow_s > _MOST_SAMPLES * self.period_s

    def build_shape(self, gains: PidGains) -> LoopShape:
        """Return the loop in dimensionless form."""
        return build_shape(gains, self.sampled, self.period_s)

    def measure(
        self, gains: PidGains, *, to_rest: bool = True, must_rest: bool = False
    ) -> StepMotion | None:
        """Return the motion after a step; None if the loop is too slow or diverges.

        With limits, the motion has the largest overshoot and the latest rest of all steps. If the
        motion must come to rest, the first step that does not is the answer.
        """
        if self.is_slow:
            return None
        found = []
        for limits in self._list_steps():
            motion = self._follow(gains, limits, to_rest=to_rest)
            if motion is None:
                return None
            if must_rest and motion.settling_time_s is None:
                return motion
            found.append(motion)
        times_s = [motion.settling_time_s for motion in found]
        known_s = [time_s for time_s in times_s if time_s is not None]
        return StepMotion(
            overshoot_percent=max(motion.overshoot_percent for motion in found),
            settling_time_s=max(known_s) if len(known_s) == len(times_s) else None,
        )

    def overshoots(self, gains: PidGains) -> bool:
        """Return whether any step overshoots visibly."""
        motions = (self._follow(gains, limits, to_rest=False) for limits in self._list_steps())
        return any(one is None or one.overshoot_percent > _TRACE for one in motions)

    def _list_steps(self) -> "list[StepLimits | None]":
        """Return the limits of all steps to be measured, the largest step first."""
        if self.limits is None:
            return [None]
        return [*self.limits.list_steps(), None]

    def _follow(
        self, gains: PidGains, limits: StepLimits | None, *, to_rest: bool
    ) -> StepMotion | None:
        return measure_step_motion(
            gains, period_s=self.period_s, process=self.process, to_rest=to_rest, limits=limits
        )

    def read_margins(self, gains: PidGains) -> Margins | None:
        """Return the margins; None if the loop is unstable."""
        shape = self.build_shape(gains)
        return find_margins(shape, self.period_s) if is_stable(shape) else None

    def find_ultimate_gain(self) -> float:
        """Return the Kp [1/s] at which P becomes unstable."""
        gains = PidGains(kp=self.unit_gain)
        return find_stable_gains(gains, period_s=self.period_s, process=self.process)[-1][1]

    def find_lag_ratio(self) -> float | None:
        """Return the Kd / Kp that cancels the slowest lag; None if no such ratio exists."""
        gaps = self.sampled.gaps
        if not gaps:
            return None
        pole, whole_s = 1.0 - min(gaps), self.filter_s + self.period_s
        ratio_s = whole_s * (pole - self.filter_s / whole_s) / (1.0 - pole)
        return ratio_s if ratio_s > 0.0 else None


def find_p_without_overshoot(design: LoopDesign) -> float:
    """Return the largest Kp [1/s] of P without overshoot."""
    sampled = design.sampled

    def compute_loop_gain(gap: _Array) -> _Array:
        z = 1.0 - gap
        zeros = (1.0 - sampled.ahead * gap) * z + sampled.behind * gap
        found = z ** (sampled.delay + 1) * gap / zeros
        for lag in sampled.gaps:
            found *= (lag - gap) / lag
        return found

    _, largest = _maximise(compute_loop_gain, min([1.0, *sampled.gaps]))
    return largest * design.unit_gain


def find_p_of_overshoot(design: LoopDesign, percent: float) -> PidGains | str:
    """Return the P controller with an overshoot, or the reason why there is no such controller."""
    if design.is_slow:
        return _SLOW
    start = _find_p_without_any(design)
    if percent == 0.0:
        return PidGains(kp=start)
    ends = start, _STEP * start
    kp = _find_first(lambda kp: _rate(design, PidGains(kp=kp)), *ends, percent, design.close)
    return PidGains(kp=kp)


@lru_cache(maxsize=64)
def _find_p_without_any(design: LoopDesign) -> float:
    """Return the largest Kp [1/s] of P without overshoot of any step, also with limits."""
    high = find_p_without_overshoot(design)
    if design.limits is None or not design.overshoots(PidGains(kp=high)):
        return high
    low = 0.5 * high
    while design.overshoots(PidGains(kp=low)):
        low, high = 0.5 * low, low
    while high - low > _CLOSE_GAIN * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if design.overshoots(PidGains(kp=middle)) else (middle, high)
    return low


def find_pi_of_overshoot(design: LoopDesign, percent: float) -> PidGains | str:
    """Return the PI controller with an overshoot, or the reason why there is no such controller."""
    if percent == 0.0:
        return (
            "on a plant that integrates, an integral always overshoots: it comes to rest only when"
            " the errors have added up to 0"
        )
    if design.is_slow:
        return _SLOW
    kp = _find_p_without_any(design)
    # Without lag and dead time an overshoot of 5 % takes Ki = 0.055 K Kp^2.
    start = 0.5 * percent / 100.0 * design.process.gain * kp * kp

    def measure(ki: float) -> float:
        return _rate(design, PidGains(kp=kp, ki=ki))

    ki = _find_first(measure, 0.0, start, percent, design.close)
    return PidGains(kp=kp, ki=ki)


def find_pd_of_overshoot(design: LoopDesign, percent: float, margin_rad: float) -> PidGains | str:
    """Return the PD with an overshoot and a phase margin, or the reason for its absence."""
    whole = find_pd_of_margin(design, margin_rad)
    alone = find_p_of_margin(design, margin_rad)
    if isinstance(whole, str) or isinstance(alone, str):
        return whole if isinstance(whole, str) else alone
    if design.is_slow:
        return _SLOW
    shape = design.build_shape(PidGains(kp=design.unit_gain))
    keep, rate = PidGains(kp=1.0, kd=1.0, filter_s=design.filter_s).weigh_derivative(
        design.period_s
    )

    def follow(angle: float) -> PidGains:
        """Return the only PD whose open loop has the phase margin at an angle w T."""
        z = cmath.exp(1j * angle)
        wanted = cmath.exp(1j * (margin_rad - math.pi)) / complex(evaluate_open_loop(shape, angle))
        difference = (z - 1.0) / (z - keep)
        weight = max(wanted.imag / difference.imag, 0.0)
        kp = design.unit_gain * (wanted.real - weight * difference.real)
        return PidGains(kp=kp, kd=design.unit_gain * weight / rate, filter_s=design.filter_s)

    def measure(angle: float) -> float:
        return _rate(design, follow(angle))

    words = f"with a phase margin of {math.degrees(margin_rad):g} deg PD"
    lowest, high = (_find_crossover(design, gains) for gains in (alone, whole))
    value = measure(high)
    if value > percent + _CLOSE:
        return f"{words} overshoots by {value:.3g} % even where Kd cancels the lag"
    for low in np.linspace(high, lowest, _PARTS + 1)[1:].tolist():
        below = measure(low)
        if below > percent + _CLOSE:
            gains = follow(_solve(measure, (high, value), (low, below), percent, design.close))
            return gains if _has_margin(design, gains, margin_rad) else _tell_no_margin(margin_rad)
        high, value = low, below
    return f"{words} overshoots less"


def find_p_of_margin(design: LoopDesign, margin_rad: float) -> PidGains | str:
    """Return the P controller with a phase margin, or the reason why there is none."""
    return _find_pd(design, 0.0, margin_rad)


def find_pd_of_margin(design: LoopDesign, margin_rad: float) -> PidGains | str:
    """Return the PD with a phase margin whose Kd cancels the lag, or the reason for its absence."""
    ratio_s = design.find_lag_ratio()
    if ratio_s is not None:
        return _find_pd(design, ratio_s, margin_rad)
    if design.sampled.gaps:
        return "the derivative's filter is slower than the lag, so no Kd cancels it"
    return "there is no lag to cancel; of an integrator alone D only makes the gain smaller"


def find_pi_of_margin(design: LoopDesign, margin_rad: float) -> PidGains | str:
    """Return the PI with a phase margin and the largest Ki, or the reason for its absence."""
    alone = find_p_of_margin(design, margin_rad)
    if isinstance(alone, str):
        return alone
    shape = design.build_shape(PidGains(kp=design.unit_gain))

    def compute(angle: _Array) -> tuple[_Array, _Array]:
        """Return Kp divided by the unit gain, and Ki T divided by the unit gain."""
        wanted = cmath.exp(1j * (margin_rad - math.pi)) / evaluate_open_loop(shape, angle)
        integral = -2.0 * np.tan(0.5 * angle) * wanted.imag
        return wanted.real + 0.5 * integral, integral

    def compute_integral(angle: _Array) -> _Array:
        proportional, integral = compute(angle)
        return np.where(proportional > 0.0, integral, -1.0)

    # An integral takes phase away, so PI crosses over earlier than P alone.
    angle, _ = _maximise(compute_integral, _find_crossover(design, alone))
    proportional, integral = (float(value[0]) for value in compute(np.array([angle])))
    unit = design.unit_gain
    gains = PidGains(kp=unit * proportional, ki=unit * integral / design.period_s)
    return gains if _has_margin(design, gains, margin_rad) else _tell_no_margin(margin_rad)


_SLOW: Final = (
    f"lag and dead time are longer than {_MOST_SAMPLES} samples, so no overshoot is measured"
)


def _find_pd(design: LoopDesign, ratio_s: float, margin_rad: float) -> PidGains | str:
    """Return the largest P or PD with a phase margin and a Kd / Kp, or the reason for absence."""
    unit = PidGains(kp=design.unit_gain, kd=ratio_s * design.unit_gain, filter_s=design.filter_s)
    shape = design.build_shape(unit)
    turn = cmath.exp(1j * (math.pi - margin_rad))

    def read_imaginary(angle: _Array) -> _Array:
        return (turn * evaluate_open_loop(shape, angle)).imag

    for angle in find_sign_changes(read_imaginary, list_angles(shape)).tolist():
        value = turn * complex(evaluate_open_loop(shape, angle))
        if value.real > 0.0:
            kp = unit.kp / abs(value)
            gains = replace(unit, kp=kp, kd=ratio_s * kp)
            if _has_margin(design, gains, margin_rad):
                return gains
    return _tell_no_margin(margin_rad)


def _find_crossover(design: LoopDesign, gains: PidGains) -> float:
    """Return the angle w T of the crossover of a loop with a phase margin."""
    margins = design.read_margins(gains)
    if margins is None or margins.crossover_rad_s is None:
        raise AssertionError(gains)
    return margins.crossover_rad_s * design.period_s


def _has_margin(design: LoopDesign, gains: PidGains, margin_rad: float) -> bool:
    margins = design.read_margins(gains)
    if margins is None or margins.phase_margin_rad is None:
        return False
    return abs(margins.phase_margin_rad - margin_rad) < _CLOSE_PHASE


def _tell_no_margin(margin_rad: float) -> str:
    if margin_rad >= 0.5 * math.pi:
        return "the integrator alone lags by 90 deg, so a phase margin is below 90 deg"
    return f"no gains have a phase margin of {math.degrees(margin_rad):g} deg"


def _rate(design: LoopDesign, gains: PidGains) -> float:
    """Return the overshoot as a number that can be compared, also for a loop that diverges."""
    motion = design.measure(gains, to_rest=False)
    overshoot = _LARGEST_OVERSHOOT if motion is None else motion.overshoot_percent
    return min(overshoot, _LARGEST_OVERSHOOT)


def _find_first(
    measure: Callable[[float], float], none: float, first: float, percent: float, close: float
) -> float:
    """Return the first gain with an overshoot, searching upward from a gain without it.

    At the limit of stability the overshoot is 100 %, so every smaller overshoot occurs below it.
    """
    low, below, high = none, 0.0, first
    while (value := measure(high)) < percent:
        low, below, high = high, value, _STEP * high
    return _solve(measure, (low, below), (high, value), percent, close)


def _solve(
    measure: Callable[[float], float],
    start: tuple[float, float],
    end: tuple[float, float],
    target: float,
    close: float,
) -> float:
    """Return the point at which a measure meets its target, between two points on either side.

    The method is regula falsi in the Illinois variant, which halves the value at an end that does
    not move (M. Dowell and P. Jarratt, BIT 11 (1971) 168-174). If a step gets no nearer, bisection
    follows.
    """
    (at, value), (other, far) = (start[0], start[1] - target), (end[0], end[1] - target)
    for _ in range(80):
        middle = other - far * (other - at) / (far - value)
        found = measure(middle) - target
        if abs(found) < close or abs(other - at) <= 1e-13 * abs(other):
            return middle
        if (found > 0.0) == (far > 0.0):
            value *= 0.5
        else:
            at, value = other, far
        other, far = middle, found
    return middle


def _maximise(compute: Callable[[_Array], _Array], high: float) -> tuple[float, float]:
    """Return the place and value of the only maximum of a function between 0 and another end."""
    low = 0.0
    for _ in range(9):  # a 50th each time: 1e-15 of the interval
        places = np.linspace(low, high, 102)[1:-1]
        values = compute(places)
        best = int(np.argmax(values))
        low, high = (low, *places, high)[best], (low, *places, high)[best + 2]
    return float(places[best]), float(values[best])
