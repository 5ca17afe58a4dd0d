"""Motion of a sampled loop after a step, also between samples.

Without limits the loop is linear, and the size of the step does not matter. With limits, the motion
is that of one step:

    command   low-pass, then clipped, then with limited acceleration and jerk, as a run's commands
    rate'     clip((clip(K command, +-bound) - rate) / tau, +-acceleration), as a robot model's rate
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.arithmetic import SETTLING_BAND, clip
from turtlelog.effects.acceleration import Follower, follow_with_acceleration, follow_with_jerk
from turtlelog.run import Parameter
from turtlelog.run.loops import PLANT_KEYS, ControlLoop, read_number
from turtlelog.theory.pid_stability import PidGains
from turtlelog.theory.process import (
    INTEGRATOR,
    Process,
    SampledProcess,
    require_period,
    sample_process,
)
from turtlelog.theory.sampled_loop import LARGEST_DEVIATION

_Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class StepMotion:
    """Motion of a loop after a reference step, also between samples.

    Attributes:
        overshoot_percent: Overshoot [% of the step]; 0: no overshoot.
        settling_time_s: Time of the first sample from which the motion stays within 2 % of the step
            [s]; None if the motion was not followed to rest.
    """

    overshoot_percent: float
    settling_time_s: float | None


_BETWEEN: Final = 1.05
"""Largest ratio of two neighbouring steps that are simulated with limits. The overshoot has peaks a
tenth of a step wide; between two such steps it may still be larger by half."""

_SMALLEST: Final = 0.25
"""Smallest step that is simulated with limits, as a share of the smaller one of the largest step
and the step that just reaches the largest rate. Still smaller steps overshoot less, down to
the step without limits, which is simulated too."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StepLimits:
    """Limits of a loop's command and rate, in a step of a size.

    Attributes:
        step: Size of the step, the largest of several [m or rad].
        also: Size of a smaller step that is measured too [m or rad]; 0: none.
        command: Largest command [m/s or rad/s].
        acceleration: Largest change of the command per second.
        jerk: Largest change of the command's acceleration per second.
        bound: Largest rate of the plant [m/s or rad/s].
        rate_acceleration: Largest change of the plant's rate per second.
    """

    step: float
    also: float = 0.0
    command: float = math.inf
    acceleration: float = math.inf
    jerk: float = math.inf
    bound: float = math.inf
    rate_acceleration: float = math.inf

    def list_steps(self, gain: float = 1.0) -> "list[StepLimits]":
        """Return the limits for the steps that are measured, the largest step first.

        Args:
            gain: Gain of the plant.
        """
        low = _SMALLEST * min(self.find_reach(gain), self.step)
        count = 1 + math.ceil(math.log(self.step / low) / math.log(_BETWEEN))
        sizes = np.geomspace(self.step, low, count).tolist()
        return [replace(self, step=size) for size in (*sizes, self.also) if size > 0.0]

    def find_reach(self, gain: float) -> float:
        """Return the step that just reaches the largest rate; infinite without a largest rate."""
        most = min(gain * self.command, self.bound)
        if most == math.inf:
            return most
        slope = min(self.acceleration, self.rate_acceleration, math.sqrt(most * self.jerk))
        return most * (most / slope + slope / self.jerk)

    def compute_duration(self, gain: float) -> float:
        """Return about how long the limits make the largest step last [s], with both its ramps."""
        most = min(gain * self.command, self.bound)
        slope = min(self.acceleration, self.rate_acceleration)
        ramp_s = min(most / slope, math.sqrt(self.step / slope)) if slope < math.inf else 0.0
        return self.step / most + 2.0 * (ramp_s + math.cbrt(self.step / self.jerk))


SLOPE_KEYS: Final[Mapping[str, str]] = {
    "turn_rate": "limits.turn_acceleration_rad_s2",
    "speed": "limits.acceleration_m_s2",
}
"""Keys of the limits on the rate of change, by command."""

JERK_KEYS: Final[Mapping[str, str]] = {
    "turn_rate": "limits.turn_jerk_rad_s3",
    "speed": "limits.jerk_m_s3",
}
"""Keys of the limits on the change of the acceleration, by command."""


def find_step_limits(loop: ControlLoop, parameters: Mapping[str, Parameter]) -> StepLimits | None:
    """Return the limits of a loop with its largest step; None if nothing limits the acceleration.

    A limit within the robot's loop has no effect on rates that change more slowly by the lag. The
    largest step is the step from start to goal, or the step in which the rate reaches its largest
    value and overshoots most, if that step is larger.
    """
    key = PLANT_KEYS[loop.command]
    inf = math.inf
    step = _find_step(loop, parameters)
    found = StepLimits(
        step=step,
        command=read_number(parameters, loop.limit_key, inf),
        acceleration=read_number(parameters, SLOPE_KEYS[loop.command], inf),
        jerk=read_number(parameters, JERK_KEYS[loop.command], inf),
        bound=read_number(parameters, f"{key}bound", inf),
        rate_acceleration=read_number(parameters, f"{key}acceleration", inf),
    )
    most = min(read_number(parameters, f"{key}gain", 1.0) * found.command, found.bound)
    is_own = most > found.rate_acceleration * read_number(parameters, f"{key}lag_s")
    if not is_own and min(found.acceleration, found.jerk) == inf:
        return None
    gain = read_number(parameters, f"{key}gain", 1.0)
    reach = found.find_reach(gain)
    if loop.signal == "heading":
        reach = min(reach, math.pi)
    return replace(found, step=reach, also=step) if step < reach < inf else found


def _find_step(loop: ControlLoop, parameters: Mapping[str, Parameter]) -> float:
    """Return the size of a loop's step from start to goal [m or rad].

    Without such a step, the size is 1 m or a quarter turn.
    """
    names = ("start.x_m", "start.y_m", "goal.x_m", "goal.y_m", "start.heading_rad")
    x_m, y_m, goal_x_m, goal_y_m, heading_rad = (
        read_number(parameters, name, math.nan) for name in names
    )
    step = math.nan
    if loop.signal == "heading" and loop.reference in {"goal_bearing", "bearing_now"}:
        step = math.atan2(goal_y_m - y_m, goal_x_m - x_m) - heading_rad
    elif loop.reference == "goal_heading":
        step = read_number(parameters, "goal.heading_rad", math.nan) - heading_rad
    elif loop.reference == "goal_distance" or loop.signal == "distance":
        step = math.hypot(goal_x_m - x_m, goal_y_m - y_m)
    if loop.signal == "heading":
        step = abs(math.remainder(step, math.tau))
    usual = 0.5 * math.pi if loop.signal == "heading" else 1.0
    return step if step > 0.0 else usual


class _Limiter:
    """The command behind its limits, divided by the step."""

    __slots__ = ("_acceleration", "_jerk", "_most", "_period_s", "_state")

    def __init__(self, limits: StepLimits, period_s: float) -> None:
        self._most = limits.command / limits.step
        self._acceleration = limits.acceleration / limits.step
        self._jerk = limits.jerk / limits.step
        self._period_s, self._state = period_s, Follower()

    def clips(self, command: float, error: float) -> bool:
        """Return whether a command is clipped while the error drives it further."""
        return abs(command) > self._most and command * error > 0.0

    def step(self, command: float) -> float:
        """Return the command of the next sample."""
        command = clip(command, self._most)
        if math.isfinite(self._jerk):
            rates = self._acceleration, self._jerk
            return follow_with_jerk(self._state, self._most, rates, command, self._period_s)
        if math.isfinite(self._acceleration):
            return follow_with_acceleration(
                self._state, self._acceleration, command, self._period_s
            )
        return command


LONGEST_MOTION: Final = 200_000
"""Longest motion that is followed between samples [samples]: about 0.3 s of computing."""

_MOST_TURNS: Final = 20
"""Largest number of times that a motion with limits passes its goal: 10 oscillations. A motion that
is not yet within 2 % loses less than a fifth of its amplitude each time, and may never rest."""

_SETTLED: Final = 1e-9
"""Remaining motion that counts as settled, as a share of the step: 1e-7 % of overshoot."""

_SETTLED_LIMITED: Final = 1e-5  # same with limits: 1e-3 % of overshoot, in half of the time


def measure_step_motion(
    gains: PidGains,
    *,
    period_s: float,
    dead_time_ticks: int = 0,
    process: Process = INTEGRATOR,
    to_rest: bool = True,
    limits: StepLimits | None = None,
) -> StepMotion | None:
    """Return the motion of a loop after a reference step.

    Between two samples the plant receives one command and then the next. The motion is therefore
    known in closed form: its rate follows each command exponentially, and the motion reverses where
    the rate is 0.

    Args:
        gains: Gains of the controller.
        period_s: Sampling period T [s].
        dead_time_ticks: Dead time in addition to that of the process [samples].
        process: Plant that the command drives. Default: an integrator.
        to_rest: Whether to follow the motion to rest; otherwise the motion is followed only until
            the overshoot is known.
        limits: Limits of command and rate, with the size of the step. Default: no limits. An
            integral then waits while the command is clipped.

    Returns:
        The motion; None if it goes beyond 1e9 steps, or if after 200,000 samples it is neither at
        rest nor past its furthest point. With limits, a motion still outside the band of 2 % after
        10 oscillations has no settling time.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    period_s = require_period(period_s)
    sampled = sample_process(process, period_s, dead_time_ticks)
    motion = _Motion(process, sampled, period_s, limits)
    follow = None if limits is None else _Limiter(limits, period_s)
    keep, slope = gains.weigh_derivative(period_s)
    kp, per_error, filter_gap = gains.kp, gains.ki * period_s, sampled.filter_gap
    commands = [0.0] * (sampled.whole + 1)
    patience = 4 * (sampled.whole + 1)
    last = integral = derivative = filtered = 0.0
    quiet = outside = 0
    furthest_at, turns, is_below = -1, 0, True
    for k in range(LONGEST_MOTION):
        error = 1.0 - motion.y
        outside = k if abs(error) > SETTLING_BAND else outside
        derivative = keep * derivative - slope * (motion.y - last)
        command = kp * error + integral + derivative
        if filter_gap is not None:
            command = filtered = filtered + filter_gap * (command - filtered)
        if follow is None or not follow.clips(command, error):
            integral += per_error * error
        commands.append(command if follow is None else follow.step(command))
        last = motion.y
        before = motion.furthest
        motion.hold(commands[k], commands[k + 1])
        furthest_at = k if motion.furthest > before else furthest_at
        quiet = quiet + 1 if motion.is_settled() else 0
        is_known = furthest_at >= 0 and k > 2 * furthest_at + patience
        if quiet > patience or (is_known and not to_rest):
            settling_time_s = (outside + 1) * period_s if quiet else None
            return StepMotion(
                overshoot_percent=100.0 * (motion.furthest - 1.0), settling_time_s=settling_time_s
            )
        if abs(error) > LARGEST_DEVIATION:
            return None
        if follow is not None and is_below != (error > 0.0):
            turns, is_below = turns + 1, error > 0.0
            if turns > _MOST_TURNS:
                is_known = True
                break
    overshoot_percent = 100.0 * (motion.furthest - 1.0)
    settling_time_s = (outside + 1) * period_s if k > 2 * outside + patience else None
    found = StepMotion(overshoot_percent=overshoot_percent, settling_time_s=settling_time_s)
    return found if is_known else None


class _Motion:
    """Rate and signal `y` of a process between samples, from rest; `furthest` is at least 1."""

    __slots__ = (
        *("_acceleration", "_bound", "_gain", "_lag_s", "_pieces", "_settled"),
        *("_v", "_wait_s", "furthest", "y"),
    )

    def __init__(
        self,
        process: Process,
        sampled: SampledProcess,
        period_s: float,
        limits: StepLimits | None,
    ) -> None:
        self._gain = process.gain
        self._bound = math.inf if limits is None else limits.bound / limits.step
        self._acceleration = math.inf if limits is None else limits.rate_acceleration / limits.step
        self._lag_s = lag_s = process.lag_s if sampled.lag_gap is not None else 0.0
        parts = enumerate((sampled.part, 1.0 - sampled.part))
        times_s = ((number, part * period_s) for number, part in parts if part > 0.0)
        self._pieces = tuple(
            (number, time_s, -math.expm1(-time_s / lag_s) if lag_s else 1.0)
            for number, time_s in times_s
        )
        self._settled = _SETTLED if limits is None else _SETTLED_LIMITED
        self._wait_s = period_s + lag_s
        self._v, self.y, self.furthest = 0.0, 0.0, 1.0

    def is_settled(self) -> bool:
        """Return whether the process is at rest at 1, within a negligible overshoot."""
        within = self._settled
        return abs(self.y - 1.0) < within and abs(self._v) * self._wait_s < within

    def hold(self, *commands: float) -> None:
        """Advance by one sample, in which one command acts and then the next."""
        for number, time_s, gap in self._pieces:
            w = clip(self._gain * commands[number], self._bound)
            if self._acceleration < math.inf:
                ramp_s = (abs(w - self._v) - self._acceleration * self._lag_s) / self._acceleration
                if ramp_s > 0.0:
                    self._ramp(math.copysign(self._acceleration, w - self._v), min(ramp_s, time_s))
                    if ramp_s >= time_s:
                        continue
                    time_s -= ramp_s
                    gap = -math.expm1(-time_s / self._lag_s) if self._lag_s else 1.0
            self._decay(w, time_s, gap)

    def _ramp(self, slope: float, time_s: float) -> None:
        """Advance while the rate changes by its largest acceleration."""
        y, v = self.y, self._v
        if v > 0.0 > slope and -v / slope < time_s:  # it turns back on the way
            self.furthest = max(self.furthest, y - 0.5 * v * v / slope)
        self.y = y + (v + 0.5 * slope * time_s) * time_s
        self._v = v + slope * time_s
        self.furthest = max(self.furthest, self.y)

    def _decay(self, w: float, time_s: float, gap: float) -> None:
        """Advance while the rate approaches a rate by its lag."""
        y, v, furthest, lag_s = self.y, self._v, self.furthest, self._lag_s
        if v > 0.0 > w and y + lag_s * v > furthest:  # it may turn back on the way
            turn_s = lag_s * math.log1p(-v / w)
            if turn_s < time_s:
                furthest = max(furthest, y + lag_s * v + w * turn_s)
        y += w * time_s + lag_s * (v - w) * gap
        v += gap * (w - v)
        self.y, self._v, self.furthest = y, v, max(furthest, y)
