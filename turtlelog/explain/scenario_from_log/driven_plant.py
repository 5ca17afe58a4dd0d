"""The plant driven by the log's own commands, to find queues, delays and pauses.

No law is used, and the commands are known exactly. Therefore noise in the logged poses, or in the
poses that the controller read, does not matter. The residual between logged and driven poses is
either noise, or shows that the settings are wrong.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, ClassVar, Final

import numpy as np

from turtlelog.explain.scenario_from_log.gain_fit import find_quantile, widen_for_runs
from turtlelog.explain.scenario_from_log.resimulation import number_poses
from turtlelog.explain.scenario_from_log.trace import Trace, Values, list_trace_breaks
from turtlelog.laws import Decision, Goal, Pose
from turtlelog.measure.motion import COARSE, WHITE, measure_whiteness
from turtlelog.measure.pose_noise import FEWEST_DIFFERENT, OFF_GRID
from turtlelog.plants.turtlesim import TICK_S, WORLD_SIZE_M
from turtlelog.run.angles import subtract_headings, wrap_angle
from turtlelog.run.paths import Path
from turtlelog.scenario import LawChoice, Limits, LoopSettings, Scenario, Start, Target
from turtlelog.simulate import iterate_ticks

_UNKNOWN_TICKS: Final = 20
"""Number of ticks after missing rows in which unknown commands may still act."""

FLOOR: Final = 1e-7
"""Residual up to which all settings count as equal [m, rad]: the rounding of a 32-bit pose at a few
metres."""

_MOST_STEPS: Final = 4.0
"""Search range of a start around the least-squares start, in steps of rounding."""

_SOLVED: Final = 1e-9  # tolerance of the solver, in steps of rounding
_REFITS: Final = 3  # number of rounds until the weights of position and heading converge

_SMALLER: Final = 16.0
"""Factor by which the motion is scaled down. After a jump, the driven plant is not at the robot's
place, and must not meet a wall. The scaled motion around the middle of the world has 88 m to every
side. The factor is a power of two, so that commands are rounded in the same way."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaybackParameters:
    """Speed [m/s] and turn rate [rad/s] to send, one pair per pose; -1: no sample blocks."""

    commands: tuple[tuple[float, float], ...]
    pauses_at: int
    pause_ticks: int


class Playback:
    """A law that replays the commands of a log, independent of the pose."""

    Parameters: ClassVar[type[Any]] = PlaybackParameters

    def __init__(self, parameters: PlaybackParameters) -> None:
        """Store the commands."""
        self._parameters = parameters
        self._next = 0

    def reset(self, start: Pose, goal: Goal | None, path: Path | None) -> None:
        """Restart with the first command."""
        del start, goal, path
        self._next = 0

    def step(self, time_ns: int, pose: Pose) -> Decision:
        """Return the next command."""
        del time_ns, pose
        parameters, number = self._parameters, self._next
        self._next += 1
        speed_m_s, turn_rate_rad_s = parameters.commands[number]
        return Decision(
            speed_m_s=speed_m_s,
            turn_rate_rad_s=turn_rate_rad_s,
            phase="control",
            blocks_ticks=parameters.pause_ticks if number == parameters.pauses_at else 0,
            stop_reason="end" if self._next == len(parameters.commands) else None,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drive:
    """Comparison of a driven plant with the log, in x, y [m] and heading [rad].

    Attributes:
        rows: Number of compared rows.
        whiteness: Whiteness of the residuals.
        explains: Whether the residual is noise.
        is_rounding: Whether the residual of an axis is within the step of its poses.
        noise: Standard deviation of the residuals.
        start: Best-fitting start pose.
        reach: Half-width of the 95 % intervals of the start.
        left: Logged minus driven poses for this start, shape (rows, 3).
        slopes: Derivatives of these differences by the start, shape (rows, 3, 3).
    """

    rows: int
    whiteness: Values
    explains: bool
    is_rounding: bool
    noise: tuple[float, float, float]
    start: tuple[float, float, float]
    reach: tuple[float, float, float]
    left: Values
    slopes: Values

    @property
    def spans(self) -> Values:
        """Range (largest minus smallest) of the residuals of x, y [m] and heading [rad]."""
        return np.asarray(np.ptp(self.left, axis=0))

    def compute_misfit(self, whiteness: Values) -> float:
        """Return the negative log-likelihood, up to a constant, for noise of this whiteness."""
        weights = 1.0 / widen_for_runs(whiteness) ** 2
        return float((self.rows * weights * np.log(np.array(self.noise))).sum())


def drive_plant(
    trace: Trace, guess: Any, *, rows: int | None = None, reads_alike: bool = False
) -> Drive | None:
    """Drive the plant with the commands of the first `rows` samples; return None if impossible.

    With `reads_alike`, the samples must also read the same poses as in the log.
    """
    count = len(trace) if rows is None else rows
    driven = _drive(trace, guess, int(trace.number[count - 1]) + 1, reads_alike=reads_alike)
    if driven is None:
        return None
    read = driven[trace.number[:count]]
    left = np.column_stack(
        [trace.xy_m[:count] - read[:, :2], subtract_headings(trace.heading_rad[:count], read[:, 2])]
    )
    return _compare(trace, left, read, count)


def join_starts(drives: list[Drive]) -> Drive:
    """Return the first of several equally good fits, with intervals that cover all of them."""
    best = drives[0]
    edges = [abs(np.subtract(one.start, best.start)) + np.array(one.reach) for one in drives]
    return replace(best, reach=_as_pose(np.max(edges, axis=0).tolist()))


def _drive(trace: Trace, guess: Any, samples: int, *, reads_alike: bool) -> Values | None:
    """Return the pose that each sample would read, in double precision, shape (samples, 3)."""
    values = dict(guess)
    pause = int(values.pop("law.pause_ticks", 0))
    loop = {key.removeprefix("loop."): value for key, value in values.items()}
    smaller = _SMALLER if trace.jumps else 1.0
    speed = np.interp(np.arange(samples), trace.number, trace.speed_m_s) / smaller
    turn_rate = np.interp(np.arange(samples), trace.number, trace.turn_rate_rad_s)
    parameters = PlaybackParameters(
        commands=tuple(zip(speed.tolist(), turn_rate.tolist(), strict=True)),
        pauses_at=int(trace.number[trace.rotating - 1]) if trace.ended_rotation else -1,
        pause_ticks=pause,
    )
    first_xy_m = np.clip(trace.xy_m[0], 0.0, WORLD_SIZE_M)
    start_xy_m = np.full(2, 0.5 * WORLD_SIZE_M) if trace.jumps else first_xy_m
    x_m, y_m = start_xy_m.tolist()
    scenario = Scenario(
        name=trace.run.name,
        max_duration_s=(samples * trace.period_ticks + pause + 1000) * TICK_S,
        start=Start(x_m=x_m, y_m=y_m, heading_rad=float(trace.heading_rad[0])),
        goal=Target(),
        law=LawChoice(kind=f"{__name__}:{Playback.__name__}", parameters=parameters),
        limits=Limits(speed_m_s=float("inf"), turn_rate_rad_s=float("inf")),
        loop=LoopSettings(**{**loop, "pose_precision": "float64"}),
    )
    poses: list[tuple[float, float, float]] = []
    read: list[int] = []
    for tick in iterate_ticks(scenario):
        poses.append((tick.row.x_m, tick.row.y_m, tick.row.heading_rad))
        read += [sample.pose_sequence for sample in tick.computed]
    if len(read) != samples:
        return None
    if reads_alike and trace.has_ticks and trace.has_exact_clock:
        known = trace.number < samples
        if (np.array(read)[trace.number[known]] != number_poses(trace)[known]).any():
            return None
    driven = np.array(poses)[read]
    driven[:, :2] = first_xy_m + smaller * (driven[:, :2] - start_xy_m)
    return driven


def _compare(trace: Trace, left: Values, read: Values, count: int) -> Drive | None:
    # After a gap, rows begin where all commands are known.
    bounds = [0, *(row for row in list_trace_breaks(trace) if row < count), count]
    missing, skip = {row for row, _ in trace.missing}, _UNKNOWN_TICKS // trace.period_ticks
    starts = [row + skip if row in missing else row for row in bounds[:-1]]
    parts = zip(starts, bounds[1:], strict=True)
    stretches = [slice(first, last) for first, last in parts if last - first > 2]
    if not stretches:
        return None
    kept = np.zeros(count, dtype=bool)
    for stretch in stretches:
        kept[stretch] = True
    slopes = np.tile(np.eye(3), (count, 1, 1))
    offsets, spread = np.zeros(3), np.zeros(3)
    logged = np.column_stack([trace.xy_m[:count], trace.heading_rad[:count]])
    noise = np.ones(3)
    for stretch in stretches:
        # After a jump the path is the same, rotated by the turn of the jump.
        turned = float(np.median(left[stretch, 2])) if stretch.start else 0.0
        away = read[stretch, :2] - read[stretch][0, :2]
        way = away @ np.array([[np.cos(turned), np.sin(turned)], [-np.sin(turned), np.cos(turned)]])
        left[stretch] += np.column_stack([away - way, np.full(len(way), -turned)])
        slopes[stretch, 0, 2], slopes[stretch, 1, 2] = -way[:, 1], way[:, 0]
    after = left.copy()
    for _ in range(_REFITS):
        for number, stretch in enumerate(stretches):
            found, variance = _fit_offsets(left[stretch], slopes[stretch], noise, logged[stretch])
            after[stretch] = left[stretch] - slopes[stretch] @ found
            if number == 0:
                offsets, spread = found, variance
        noise = np.sqrt(np.mean(after[kept] ** 2, axis=0)) + FLOOR
    whiteness = measure_whiteness(*(after[stretch] for stretch in stretches))
    grains = np.array([trace.grain_m, trace.grain_m, trace.grain_rad])
    quantile = find_quantile(int(kept.sum()) - 2)
    reach = quantile * np.sqrt(spread) * widen_for_runs(whiteness)
    start = np.array([*trace.xy_m[0] - left[0, :2], trace.heading_rad[0] - left[0, 2]]) + offsets
    is_noise = np.abs(whiteness - 1.0) < WHITE
    is_rounding = noise < np.maximum(grains, 2.0 * FLOOR)
    # Coarse steps reduce the error of a wrong setting below a step, but not its range.
    steps = np.array(trace.coarse_steps)
    is_rounding &= (steps == 0.0) | (np.ptp(after[kept], axis=0) <= COARSE * steps)
    return Drive(
        rows=int(kept.sum()),
        whiteness=whiteness,
        explains=bool((is_noise | is_rounding).all()),
        is_rounding=bool(is_rounding.any()),
        noise=_as_pose(noise.tolist()),
        start=_as_pose(start.tolist()),
        reach=_as_pose(reach.tolist()),
        left=after,
        slopes=slopes,
    )


def _fit_offsets(
    left: Values, slopes: Values, noise: Values, logged: Values
) -> tuple[Values, Values]:
    """Return the best-fitting shift of the first pose and its variances, shape (3,).

    If a coordinate does not change in the log, for example at rest, its error is repeated.
    """
    weighted = slopes / noise[None, :, None]
    inverse = np.linalg.pinv(np.einsum("nij,nik->jk", weighted, weighted))
    estimator = np.einsum("jk,nik->ijn", inverse, weighted)
    variance = np.zeros(3)
    for axis in range(3):
        fresh = np.flatnonzero(np.diff(logged[:, axis], prepend=np.nan) != 0.0)
        variance += (np.add.reduceat(estimator[axis], fresh, axis=1) ** 2).sum(axis=1)
    return np.einsum("ijn,ni->j", estimator, left / noise), variance


@dataclass(frozen=True, slots=True, kw_only=True)
class StartBounds:
    """Bounds of the starts for which every pose rounds to the logged one, and their middle."""

    middle: tuple[float, float, float]
    low: tuple[float, float, float]
    high: tuple[float, float, float]


def join_bounds(found: Sequence[StartBounds | None]) -> StartBounds | None:
    """Return bounds that cover those of several equally good drives, around the first middle."""
    known = [bounds for bounds in found if bounds is not None]
    if not known or len(known) < len(found):
        return None
    return StartBounds(
        middle=known[0].middle,
        low=_as_pose(np.min([bounds.low for bounds in known], axis=0).tolist()),
        high=_as_pose(np.max([bounds.high for bounds in known], axis=0).tolist()),
    )


def bound_start(drive: Drive, trace: Trace) -> StartBounds | None:
    """Return the bounds of starts for which every pose rounds to the logged one, if any."""
    if not drive.explains or trace.missing or trace.jumps:
        return None
    poses = np.column_stack([trace.xy_m, trace.heading_rad])
    half_steps = 0.5 * np.abs(np.spacing(poses.astype(np.float32))).astype(np.float64)
    grains = 0.5 * np.array([trace.grain_m, trace.grain_m, trace.grain_rad])
    coarse = grains > 2.0 * half_steps.max(axis=0)
    # Coarse poses were rounded to 32 bits before, and again in the log.
    half_steps = np.where(coarse, grains * (1.0 + OFF_GRID) + 2.0 * half_steps, half_steps)
    # A coordinate with too few values does not show its quantisation step.
    columns = trace.xy_m[:, 0], trace.xy_m[:, 1], trace.heading_rad
    if coarse.any() and min(len(np.unique(one)) for one in columns) < FEWEST_DIFFERENT:
        return None
    if (np.array(drive.noise) > 2.0 * half_steps.max(axis=0) + FLOOR).any():
        return None
    return _solve_bounds(drive, half_steps)


def keep_in_world(pose: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return the nearest pose at which a scenario may start."""
    x_m, y_m = (min(max(value, 0.0), WORLD_SIZE_M) for value in pose[:2])
    return x_m, y_m, wrap_angle(pose[2])


def _solve_bounds(drive: Drive, half_steps: Values) -> StartBounds | None:
    """Return bounds from half the quantisation step of each value, shape (rows, 3)."""
    rows = drive.left.reshape(-1)
    slopes = drive.slopes.reshape(-1, 3)
    half = half_steps.reshape(-1)
    # In units of the largest step, to which the solver's tolerance refers.
    unit = float(half.max())
    within = np.block([[slopes, half[:, None] / unit], [-slopes, half[:, None] / unit]])
    sides = np.concatenate([half + rows, half - rows]) / unit
    middle = _solve([0.0, 0.0, 0.0, -1.0], within, sides)
    if middle is None:
        return None
    low, high = np.empty(3), np.empty(3)
    for axis, (ends, sign) in product(range(3), ((low, 1.0), (high, -1.0))):
        cost = [sign * (axis == column) for column in range(3)] + [0.0]
        found = _solve(cost, within, sides) or middle
        ends[axis] = drive.start[axis] + (found[axis] - sign * _SOLVED) * unit
    best = [drive.start[axis] + middle[axis] * unit for axis in range(3)]
    return StartBounds(
        middle=_as_pose(best), low=_as_pose(low.tolist()), high=_as_pose(high.tolist())
    )


def _solve(cost: list[float], within: Values, sides: Values) -> list[float] | None:
    from scipy.optimize import linprog

    bounds = [(-_MOST_STEPS, _MOST_STEPS)] * 3 + [(0.0, 1.0)]
    found = linprog(c=cost, A_ub=within, b_ub=sides, bounds=bounds, method="highs")
    return [float(value) for value in found.x] if found.success else None


def _as_pose(values: list[float]) -> tuple[float, float, float]:
    x_m, y_m, heading_rad = map(float, values)
    return x_m, y_m, heading_rad
