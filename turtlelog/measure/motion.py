"""Motion and command of each plant step, and the error cumulated over steps."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.arithmetic import rub, want_rate
from turtlelog.measure.pose_noise import find_coarse_step
from turtlelog.measure.rates import GAP_STEPS
from turtlelog.measure.reductions import Values, compute_median, subtract_neighbours
from turtlelog.measure.response import find_loop_samples
from turtlelog.plants import Plant, find_plant
from turtlelog.run import PoseColumns, Run
from turtlelog.run.angles import find_heading_steps, subtract_headings
from turtlelog.run.loops import PLANT_KEYS, ControlLoop, find_disturbance, read_number

_NEAR_TICK: Final = 0.15
"""Largest difference of a wall clock's usual step from turtlesim's tick, as a share of the tick."""

_NEAR_TICKS: Final = 0.02
"""The same for several ticks, if a controller answers and logs every n-th pose."""

_MOST_STEP_TICKS: Final = 60

_LOST_ROWS: Final = 1000
"""Number of rows for a gap of unknown length: more than any dead time."""

_EXACT: Final = 2e-8
"""Error of a step in double precision [m, rad]: pi has eight decimals in turtlesim."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopMotion:
    """The steps of the first segment of a loop, along the coordinate that its command drives.

    Attributes:
        time_ns: Time of the pose at the beginning of each step [ns], shape (n,).
        tick: Tick of the pose at the beginning of each step, shape (n,); rows with an unknown tick
            are far apart.
        moved: Turn [rad] or motion along the heading [m] in the step, without the disturbances in
            the scenario, shape (n,).
        rounding: Largest effect of the rounding of the two poses [rad or m], shape (n,).
        step_ticks: Number of ticks in a step: 1 if there is a pose per tick.
        tick_s: Length of a tick [s].
        poses: Poses of the run.
        loop: The loop.
        way: Length of the whole motion, with steps that are left out [rad or m].
        sample_tick: Tick of the pose that each sample of the run read, shape (m,), rising.
        apart: Usual distance between these poses [ticks], at least 1.
        command: Steady-state response of the plant to each sample's command [rad/s or m/s], shape
            (m,): for the robot model, gain times command, within its limits.
    """

    time_ns: NDArray[np.int64]
    tick: NDArray[np.int64]
    moved: Values
    rounding: Values
    step_ticks: int
    tick_s: float
    poses: PoseColumns
    loop: ControlLoop
    way: float
    sample_tick: NDArray[np.int64]
    apart: float
    command: Values

    @cached_property
    def grain(self) -> float:
        """Largest error of the cumulated motion due to the resolution of the logged poses.

        In rad or m; 0 for full resolution. For a heading it is one coarse step. For a position it
        includes the heading: a wrong heading makes the motion along it shorter.
        """
        heading_rad, xy_m = find_coarse_step(self.poses.heading_rad), self.poses.xy_m
        if self.loop.command == "turn_rate":
            return heading_rad
        place_m = max(find_coarse_step(xy_m[:, 0]), find_coarse_step(xy_m[:, 1]))
        return math.sqrt(2.0) * place_m + self.way * (1.0 - math.cos(0.5 * heading_rad))

    def predict(
        self, dead_times_ticks: range, rows: slice = slice(None)
    ) -> tuple[Values, NDArray[np.bool_]]:
        """Return the motion of steps for each dead time [rad or m], and whether it is certain.

        Both results have the shape (dead times, steps). The last command is held; before the first
        command, the command is 0. If two samples are further apart than usual, samples between them
        may be lost.
        """
        if self.step_ticks == 1:
            answered = self.tick[rows] - np.array(dead_times_ticks)[:, None]
            command, is_sure = self._find_commands(answered)
            return command * self.tick_s, is_sure
        inside = self.tick[rows, None] + np.arange(self.step_ticks)
        answered = inside - np.array(dead_times_ticks)[:, None, None]
        command, is_sure = self._find_commands(answered)
        return command.sum(axis=2) * self.tick_s, np.asarray(is_sure.all(axis=2))

    def _find_commands(self, answered: NDArray[np.int64]) -> tuple[Values, NDArray[np.bool_]]:
        """Return the command that acts in each tick [rad/s or m/s], and whether it is certain."""
        # `answered` are the ticks of the poses whose answers act.
        latest = self._find_latest(answered)
        is_known = latest >= 0
        is_sure = is_known & (answered - self.sample_tick[latest] < self.apart)
        return np.where(is_known, self.command[latest], 0.0), np.asarray(is_sure)

    def _find_latest(self, ticks: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the last sample that read a pose at or before each tick; -1 if no sample did."""
        first, last = int(ticks.min()), int(ticks.max())
        if last - first > ticks.size:  # gaps make ticks far apart, so a table would be too large
            return np.searchsorted(self.sample_tick, ticks, side="right") - 1
        every = np.arange(first, last + 1)
        latest = np.searchsorted(self.sample_tick, every, side="right") - 1
        return np.asarray(latest[ticks - first])


def read_loop_motion(run: Run, loop: ControlLoop) -> LoopMotion | None:
    """Return the steps between the poses that the samples of a loop's first segment read.

    The result is None if the loop never acts. Steps across a gap or against a wall are left out.
    """
    samples, poses, plant = run.samples, run.poses, find_plant(run)
    stretch = find_loop_samples(run, loop)
    if stretch is None:
        return None
    first, last = samples.pose_sequence[[stretch.start, stretch.stop - 1]]
    tick, step_ticks, tick_s = _count_ticks(poses.time_ns, plant)
    # Each pose may be answered only once, and in order.
    sample_tick = np.maximum.accumulate(tick[samples.pose_sequence])
    steps = slice(first, max(first, last))
    is_kept = subtract_neighbours(tick)[steps] == step_ticks
    ends = slice(first, steps.stop + 1)
    heading_rad, xy_m = poses.heading_rad[ends], poses.xy_m[ends]
    if loop.command == "turn_rate":
        moved = subtract_headings(heading_rad[1:], heading_rad[:-1])
        moves = find_heading_steps(poses)
        is_kept &= ~moves.is_lost[steps]
        fast = np.flatnonzero(moves.is_fast[steps])
        moved[fast] = (heading_rad[1:] - heading_rad[:-1] + moves.added_rad[steps])[fast]
        half = _find_half_steps(poses.heading_rad)[ends]
        rounding = half[:-1] + half[1:] + _EXACT
        command = samples.turn_rate_rad_s
    else:
        is_kept &= ((xy_m[1:] > plant.low_m) & (xy_m[1:] < plant.high_m)).all(axis=1)  # no wall
        half = _find_half_steps(poses.xy_m)[ends]
        moved, rounding = _measure_moves(xy_m, heading_rad, half, is_arc=not plant.turns_first)
        command = samples.speed_m_s
    rows = first + np.flatnonzero(is_kept)
    usual_ticks = compute_median(subtract_neighbours(sample_tick)) if len(sample_tick) > 1 else 1.0
    return LoopMotion(
        time_ns=poses.time_ns[rows],
        tick=tick[rows],
        moved=moved[is_kept] - _compute_pushed(run, loop, rows),
        rounding=rounding[is_kept],
        step_ticks=step_ticks,
        tick_s=tick_s,
        poses=poses,
        loop=loop,
        way=float(np.abs(moved).sum()),
        sample_tick=sample_tick,
        apart=max(usual_ticks, 1.0),
        command=_find_wanted(run, loop, command),
    )


def _compute_pushed(run: Run, loop: ControlLoop, rows: NDArray[np.int64]) -> Values:
    """Return the motion caused by the scenario's disturbances in each step [rad or m]."""
    unit = "rad_s" if loop.command == "turn_rate" else "m_s"
    rate = read_number(run.parameters, f"disturbance.{loop.command}_{unit}", 0.0)
    window_ns = find_disturbance(run.parameters)
    if not rate or window_ns is None:
        return np.zeros(len(rows))
    from_ns, to_ns = window_ns
    start_ns, end_ns = run.poses.time_ns[rows], run.poses.time_ns[rows + 1]
    if find_plant(run).acts_in_steps:  # the value at the end of a step acts on the whole step
        pushed_ns = np.where((end_ns >= from_ns) & (end_ns < to_ns), end_ns - start_ns, 0)
    else:
        pushed_ns = np.minimum(end_ns, to_ns) - np.maximum(start_ns, from_ns)
    return np.asarray(rate * np.maximum(pushed_ns, 0.0) / 1e9)


def _find_wanted(run: Run, loop: ControlLoop, command: Values) -> Values:
    """Return the steady-state rates of the plant for the commands of a loop."""
    gain = _read_plant(run, loop, "gain", 1.0)
    defaults = {"deadband": 0.0, "friction": 0.0, "reverse_gain": math.nan, "bound": math.inf}
    if all(f"{PLANT_KEYS[loop.command]}{name}" not in run.parameters for name in defaults):
        return command * gain
    own = (_read_plant(run, loop, name, value) for name, value in defaults.items())
    deadband, friction, reverse_gain, bound = own
    left = (rub(one, deadband, friction) for one in command.tolist())
    return np.array([want_rate(one, gain, reverse_gain, bound) for one in left])


def describe_follower(run: Run, loop: ControlLoop) -> str:
    """Return why the plant follows a loop's command slowly; empty if the plant follows at once."""
    key = PLANT_KEYS[loop.command]
    lag_s = _read_plant(run, loop, "lag_s", 0.0)
    if lag_s > 0.0:
        return f"the robot's time constant ({key}lag_s = {lag_s:g})"
    acceleration = _read_plant(run, loop, "acceleration", math.inf)
    if acceleration < math.inf:
        return f"the limit of the robot's acceleration ({key}acceleration = {acceleration:g})"
    return ""


def _read_plant(run: Run, loop: ControlLoop, name: str, default: float) -> float:
    if find_plant(run).dynamics != "first-order":
        return default
    return read_number(run.parameters, f"{PLANT_KEYS[loop.command]}{name}", default)


def _count_ticks(time_ns: NDArray[np.int64], plant: Plant) -> tuple[NDArray[np.int64], int, float]:
    """Return the tick of each pose, the usual ticks in a step, and the tick length [s]."""
    step_ns, tick_ns, tick_s = subtract_neighbours(time_ns), plant.period_ns, plant.period_s
    if not plant.has_live_logs:
        return (time_ns - time_ns[0]) // tick_ns, 1, tick_s
    if not len(step_ns):
        return np.zeros(len(time_ns), dtype=np.int64), 1, tick_s
    usual_ns = compute_median(step_ns)
    if not (step_ns % tick_ns).any() and usual_ns == tick_ns:
        return (time_ns - time_ns[0]) // tick_ns, 1, tick_s
    # A wall clock jitters, and a late callback is not a lost pose.
    steps = np.where(step_ns > GAP_STEPS * usual_ns, _LOST_ROWS, 1)
    ticks = min(max(round(usual_ns / tick_ns), 1), _MOST_STEP_TICKS)
    if abs(usual_ns / tick_ns / ticks - 1.0) < (_NEAR_TICK if ticks == 1 else _NEAR_TICKS):
        return np.r_[0, np.cumsum(steps * ticks)], ticks, tick_s
    return np.r_[0, np.cumsum(steps)], 1, usual_ns / 1e9


def _measure_moves(
    xy_m: Values, heading_rad: Values, half: Values, *, is_arc: bool
) -> tuple[Values, Values]:
    # A step that turns first moves along the new heading. The chord of an arc has the mean heading.
    half_rad = 0.5 * subtract_headings(heading_rad[1:], heading_rad[:-1])
    along_rad = heading_rad[:-1] + half_rad if is_arc else heading_rad[1:]
    x, y = np.cos(along_rad), np.sin(along_rad)
    ways_m = xy_m[1:] - xy_m[:-1]
    both = half[:-1] + half[1:]
    moved = ways_m[:, 0] * x + ways_m[:, 1] * y
    rounding = both[:, 0] * np.abs(x) + both[:, 1] * np.abs(y) + _EXACT
    return moved / np.sinc(half_rad / np.pi) if is_arc else moved, rounding


def _find_half_steps(values: Values) -> Values:
    """Return half the spacing of 32-bit floats at each value; 0 if values have more bits."""
    if (values != values.astype(np.float32)).any():
        return np.zeros_like(values)
    half: Values = 0.5 * np.abs(np.spacing(values.astype(np.float32))).astype(np.float64)
    return half


CERTAIN: Final = 10.0
"""Difference of log-likelihoods from which the better of two fits counts as certain: the other fit
is 20,000 times less likely. If rows are not quite independent, even a difference of 5 is a factor
of 150."""

_LAG_APART: Final = 0.25
_LAG_OFFSETS: Final = np.arange(-0.5, 1.01, _LAG_APART)
"""Offsets from the best dead time at which dead time and time constant are tried together
[ticks]."""

_LAG_ROUNDS: Final = 6
"""Number of halvings of the distance between tried time constants, down to 1/256 tick."""

_LEAST_LAG: Final = 0.01
"""Smallest time constant [ticks]. A smaller one has no effect in a double after one tick."""

COARSE: Final = 1.25
"""Largest residual of the right fit in rounding steps: one, plus the error of its offset."""

LIKE_THE_BEST: Final = 1.1
"""Largest ratio of the right fit's residual to the best residual, if there is also noise."""

WHITE: Final = 0.5
"""Largest deviation of noise's whiteness from 1. A time constant or a wrong setting leaves a curve
with less than 0.1. A delay between two ticks makes the error of a switching command alternate, with
up to 2."""

_TINY: Final = 1e-300


def measure_whiteness(*stretches: Values, fitted: int = 0) -> Values:
    """Return the mean square of the changes along rows by twice the mean square, for each column.

    It is 1 for noise, near 0 for a curve, up to 2 for values that alternate, and 1 for zeros.

    Args:
        stretches: Segments of what a fit leaves, shape (n,) or (n, columns); n is 2 or more.
        fitted: Number of fitted parameters, which make the mean square larger.
    """
    changes = sum(np.mean(subtract_neighbours(part) ** 2, axis=0) for part in stretches)
    squares = sum(np.sum(part**2, axis=0) / (len(part) - fitted) for part in stretches)
    return np.where(squares > 0.0, changes / np.maximum(2.0 * squares, _TINY), 1.0)


def is_within_steps(spans: Values, best: int, grain: float) -> NDArray[np.bool_]:
    """Return which fits have errors within those of coarse poses, or of the best fit.

    `spans` are the ranges of the errors of each fit, `grain` is the coarse step; 0: full
    resolution, and only the best fit counts. Rounding errors are not noise: neighbouring rows share
    them, so their squares are not informative.
    """
    if not grain:
        return np.asarray(np.arange(len(spans)) == best)
    most = max(COARSE * grain, LIKE_THE_BEST * float(spans[best]))
    return np.asarray(spans <= most)


def fit_way(motion: LoopMotion, errors: Values, rows: NDArray[np.int64]) -> tuple[Values, Values]:
    """Return the cumulated errors of steps and their root mean square, one row for each fit."""
    # The initial value of each segment between gaps is not exact, so its mean is subtracted.
    bounds = np.flatnonzero(subtract_neighbours(motion.tick[rows]) > motion.step_ticks) + 1
    with np.errstate(over="ignore", invalid="ignore"):
        parts = np.split(np.cumsum(errors, axis=1)[:, rows], bounds, axis=1)
        offsets = [part - part.mean(axis=1, keepdims=True) for part in parts]
        left = np.concatenate(offsets, axis=1)
        return left, np.nan_to_num(np.sqrt(np.mean(left**2, axis=1)), nan=np.inf)


def find_lags(
    motion: LoopMotion, errors: Values, rows: NDArray[np.int64], best: int, size: float
) -> tuple[int, bool]:
    """Return the least dead time that fits as well with a time constant, and if one fits better.

    `errors` are those of each dead time in each step, shape (dead times, steps); `rows` are the
    steps that count; `size` is the error of the fit without a time constant [rad or m].
    """
    predicted = motion.moved - errors
    gained = np.empty(best + 1)
    is_alike = np.zeros(best + 1, dtype=bool)
    for ticks in range(best + 1):
        left = _fit_lag(motion, predicted[ticks], rows, best - ticks)
        its_size = max(float(np.sqrt(np.mean(left**2))), _TINY)
        gained[ticks] = len(rows) * np.log(max(size, _TINY) / its_size)
        is_alike[ticks] = np.ptp(left) <= COARSE * motion.grain
    is_alike |= gained > -CERTAIN
    is_alike[best] = True
    return int(np.argmax(is_alike)), bool(gained.max() > CERTAIN)


def _fit_lag(
    motion: LoopMotion, predicted: Values, rows: NDArray[np.int64], near_ticks: int
) -> Values:
    """Return the remaining cumulated error with the best time constant near one [ticks]."""
    tried: dict[float, Values] = {}

    def measure(lag_ticks: float) -> float:
        if lag_ticks not in tried:
            steps = _lag_steps(motion, predicted, lag_ticks)
            tried[lag_ticks] = fit_way(motion, (motion.moved - steps)[None], rows)[0][0]
        return float(np.mean(tried[lag_ticks] ** 2))

    offsets = near_ticks + _LAG_OFFSETS
    best = min(offsets[offsets > 0.0].tolist(), key=measure)
    apart = _LAG_APART
    for _ in range(_LAG_ROUNDS):
        apart *= 0.5
        best = min((max(best + apart * way, _LEAST_LAG) for way in (-1.0, 0.0, 1.0)), key=measure)
    return tried[best]


def _lag_steps(motion: LoopMotion, predicted: Values, lag_ticks: float) -> Values:
    """Return predicted steps after a first-order lag, in closed form for held commands."""
    from scipy.signal import lfilter

    lag = lag_ticks / motion.step_ticks
    kept = float(np.exp(-1.0 / lag))
    now, before = 1.0 - lag * (1.0 - kept), lag * (1.0 - kept) - kept
    bounds = np.flatnonzero(subtract_neighbours(motion.tick) > motion.step_ticks) + 1
    parts = np.split(predicted, bounds)
    return np.concatenate([lfilter([now, before], [1.0, -kept], part) for part in parts])
