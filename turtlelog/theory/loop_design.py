"""A loop whose gains are to be found: its steps, its margins, and its largest P without overshoot.

P has no overshoot up to the Kp at which its two slowest poles meet on the real axis: the maximum of
-1 / L1(z) between the slowest lag's pole and 1, with the open loop L1 at Kp = 1. For an integrator,
`sampled_loop` has this Kp in closed form. With limits, no simulated step may overshoot.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, reduce
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import TheoryError
from turtlelog.theory.continuous_loop import SETTLING_TIME_CONSTANTS
from turtlelog.theory.pid_loop import find_stable_gains
from turtlelog.theory.pid_stability import (
    LoopShape,
    Margins,
    PidGains,
    build_shape,
    find_margins,
    find_maximum,
    is_stable,
)
from turtlelog.theory.process import Process, SampledProcess, sample_process
from turtlelog.theory.step_motion import (
    LONGEST_MOTION,
    StepLimits,
    StepMotion,
    measure_step_motion,
)

_Array = NDArray[np.float64]
_Ranges = tuple[tuple[float, float], ...]

_MOST_SAMPLES: Final = 2000
"""Largest sum of lag, low-pass, dead time and a step's duration under limits [samples] for which
overshoots are measured. Beyond this sum, the 10 to 40 responses of some ten thousand samples each
take several seconds."""

TOO_SLOW: Final = (
    f"lag, dead time and the duration of a limited step are longer than {_MOST_SAMPLES} samples, so"
    " no overshoot is measured"
)
"""Reason why a slow loop has no gains for an overshoot."""

CLOSE_PERCENT: Final = 1e-6
"""Tolerance of an overshoot [% of the step]; a smaller overshoot counts as none."""

_CLOSE_PHASE: Final = 1e-9  # tolerance of a phase margin [rad]; rounding leaves 1e-12

_LARGEST_OVERSHOOT: Final = 1e3
"""Overshoot of a response that diverges [%]: every wanted overshoot is below 100 %."""

_TRACE: Final = 1e-3
"""Overshoot that counts as none in a search with limits [%]: the accuracy of limited motions."""

_SPARSE: Final = 7
"""A search of gains simulates every seventh step. The step that overshoots most joins them, until
no step overshoots more than is wanted."""

_CLOSE_GAIN: Final = 1e-3
"""Tolerance of the largest gain without overshoot under limits, as a share of the gain."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopDesign:
    """A loop whose gains are to be found.

    Attributes:
        process: Plant that the command drives, with all dead time.
        period_s: Sampling period T [s].
        filter_s: Time constant of the derivative's filter [s].
        limits: Limits of command and rate with the largest step; None: no limits.
        searched: Steps that a search of gains simulates, beside some of all steps.
    """

    process: Process
    period_s: float
    filter_s: float = 0.0
    limits: StepLimits | None = None
    searched: tuple[StepLimits, ...] = ()

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
        return CLOSE_PERCENT if self.limits is None else _TRACE

    @property
    def is_slow(self) -> bool:
        """Whether the responses of the loop are too long to measure."""
        process = self.process
        slow_s = process.lag_s + process.low_pass_s + process.dead_time_s
        if self.limits is not None:
            slow_s += self.limits.compute_duration(process.gain)
        return slow_s > _MOST_SAMPLES * self.period_s

    def build_shape(self, gains: PidGains) -> LoopShape:
        """Return the loop in dimensionless form."""
        return build_shape(gains, self.sampled, self.period_s)

    def measure(self, gains: PidGains, *, must_rest: bool = False) -> StepMotion | None:
        """Return the motion after a step; None if the loop is slow with limits, or diverges.

        With limits, the motion has the largest overshoot and the latest rest of all steps. If the
        motion must come to rest, the first step that does not is the answer.
        """
        if self.limits is not None and self.is_slow:
            return None
        found = []
        for limits in self._list_steps():
            motion = self._follow(gains, limits, to_rest=True)
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

    def measure_overshoot(self, gains: PidGains) -> float:
        """Return the overshoot as a number that can be compared, also for a loop that diverges."""
        return max(self._measure_step(gains, limits) for limits in self._list_searched())

    def overshoots(self, gains: PidGains) -> bool:
        """Return whether any step overshoots visibly."""
        return any(self._measure_step(gains, limits) > _TRACE for limits in self._list_searched())

    def add_worst_step(self, gains: PidGains, percent: float) -> "LoopDesign":
        """Return the design with the step that overshoots most, if it exceeds an overshoot [%]."""
        found = [(self._measure_step(gains, limits), limits) for limits in self._list_steps()]
        worst, limits = max(found, key=lambda one: one[0])
        if limits is None or limits in self.searched or worst <= percent + self.close:
            return self
        return replace(self, searched=(*self.searched, limits))

    def _measure_step(self, gains: PidGains, limits: StepLimits | None) -> float:
        motion = self._follow(gains, limits, to_rest=False)
        overshoot = _LARGEST_OVERSHOOT if motion is None else motion.overshoot_percent
        return min(overshoot, _LARGEST_OVERSHOOT)

    def _list_steps(self) -> list[StepLimits | None]:
        # The largest step first; a step without limits last.
        return [*([] if self.limits is None else self.limits.list_steps(self.process.gain)), None]

    def _list_searched(self) -> list[StepLimits | None]:
        steps = self._list_steps()
        return [*self.searched, *steps[:-1:_SPARSE], steps[-1]]

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

    def has_margin(self, gains: PidGains, margin_rad: float) -> bool:
        """Return whether the loop has a phase margin."""
        margins = self.read_margins(gains)
        if margins is None or margins.phase_margin_rad is None:
            return False
        return abs(margins.phase_margin_rad - margin_rad) < _CLOSE_PHASE

    def find_crossover(self, gains: PidGains) -> float:
        """Return the angle w T of the crossover of a loop with a phase margin."""
        margins = self.read_margins(gains)
        if margins is None or margins.crossover_rad_s is None:
            raise AssertionError(gains)
        return margins.crossover_rad_s * self.period_s

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

    _, largest = find_maximum(compute_loop_gain, min([1.0, *sampled.gaps]))
    return largest * design.unit_gain


@lru_cache(maxsize=64)
def find_p_without_any_overshoot(design: LoopDesign) -> float:
    """Return the largest Kp [1/s] of P without overshoot of any step, also with limits."""
    high = find_p_without_overshoot(design)
    if design.limits is None or not design.overshoots(PidGains(kp=high)):
        return high
    low, slowest = 0.5 * high, SETTLING_TIME_CONSTANTS * design.unit_gain / LONGEST_MOTION
    while design.overshoots(PidGains(kp=low)):
        if low < slowest:
            raise TheoryError("no P without overshoot comes to rest while a step is simulated")
        low, high = 0.5 * low, low
    while high - low > _CLOSE_GAIN * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if design.overshoots(PidGains(kp=middle)) else (middle, high)
    return low


GAIN_STEP: Final = 1.25  # factor from one gain to the next while the overshoot is too small


def find_first_gain(
    measure: Callable[[float], float], none: float, first: float, percent: float, close: float
) -> float:
    """Return the first gain with an overshoot, searching upward from a gain without it.

    At the limit of stability the overshoot is 100 %, so every smaller overshoot occurs below it.
    """
    low, below, high = none, 0.0, first
    while (value := measure(high)) < percent:
        low, below, high = high, value, GAIN_STEP * high
    return solve_between(measure, (low, below), (high, value), percent, close)


def solve_between(
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


def find_lasting_gains(
    gains: PidGains, *, period_s: float, process: Process, least_dead_time_s: float
) -> _Ranges:
    """Return the ranges of Kp [1/s] that are stable at all dead times up to that of the process.

    Between two samples, a longer dead time may be stable with a larger Kp.

    Args:
        gains: Gains of the controller; Ki and Kd keep their values.
        period_s: Sampling period T [s].
        process: Plant that the command drives, with the largest dead time.
        least_dead_time_s: Smallest dead time [s].
    """
    found = [
        find_stable_gains(gains, period_s=period_s, process=replace(process, dead_time_s=late_s))
        for late_s in np.linspace(least_dead_time_s, process.dead_time_s, _DEAD_TIMES).tolist()
    ]
    return reduce(_intersect, found)


_DEAD_TIMES: Final = 5
"""Number of dead times, from the least to the most, at which stability is examined."""


def _intersect(first: _Ranges, second: _Ranges) -> _Ranges:
    common = [(max(a, c), min(b, d)) for a, b in first for c, d in second]
    return tuple((low, high) for low, high in common if low < high)
