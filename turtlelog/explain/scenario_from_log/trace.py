"""Samples of a log one by one: pose read, command published, and time; breaks of the log."""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import ExplainError
from turtlelog.measure.pose_noise import find_coarse_step, find_common_step, find_spacing
from turtlelog.plants import find_plant
from turtlelog.run import Run
from turtlelog.run.angles import subtract_headings
from turtlelog.run.loops import PLANT_KEYS, read_number

Values = NDArray[np.float64]

_FIRST_DIGITS: Final = 9
"""Number of decimals to which a goal is rounded that the log shows only as position plus error."""

_FEWEST_ANSWERS: Final = 10
"""Smallest number of answers to single poses that shows the usual delay: a run may end while its
initial queue lasts."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trace:
    """The samples of a run, one row each, and the properties of their clock.

    Attributes:
        run: Run of the samples.
        number: Number of each sample in the run, from 0; numbers of lost rows are missing. Without
            sample numbers in the log, row numbers until `mark_breaks` is applied.
        jumps: Rows whose pose the robot cannot have reached from the pose before, if marked.
        time_ns: Time of each answer.
        xy_m, heading_rad: Pose read, as the plant published it.
        read_xy_m, read_heading_rad: Pose as the controller read it, if logged, otherwise the same.
        speed_m_s, turn_rate_rad_s: Published command.
        rotating: Number of samples in the first phase; all samples if the phases are unknown.
        translating: Number of samples in the next phase.
        goal_xy_m: Goal; None if the log does not show it.
        period_ticks: Number of ticks between answered poses.
        has_exact_clock: Whether times are simulated, in whole ticks.
        has_ticks: Whether there is a pose for every tick, answered or not.
    """

    run: Run
    number: NDArray[np.int64]
    jumps: tuple[int, ...]
    time_ns: NDArray[np.int64]
    xy_m: Values
    heading_rad: Values
    read_xy_m: Values
    read_heading_rad: Values
    speed_m_s: Values
    turn_rate_rad_s: Values
    rotating: int
    translating: int
    goal_xy_m: tuple[float, float] | None
    period_ticks: int
    has_exact_clock: bool
    has_ticks: bool

    def __len__(self) -> int:
        return len(self.time_ns)

    @property
    def tick_ns(self) -> int:
        """Length of a tick, the period of the run's plant [ns]."""
        return find_plant(self.run).period_ns

    @property
    def pose_time_ns(self) -> NDArray[np.int64]:
        """Publication time of each pose that was read [ns], shape (n,)."""
        return self.run.poses.time_ns[self.run.samples.pose_sequence]

    @property
    def ended_rotation(self) -> bool:
        """Whether the rotation ended with a command of 0."""
        return self.rotating > 1 and float(self.turn_rate_rad_s[self.rotating - 1]) == 0.0

    @property
    def shows_pause(self) -> bool:
        """Whether there is a sample after the rotation's end."""
        return self.ended_rotation and self.translating > 0

    @property
    def bearing_rad(self) -> float:
        """The goal bearing as logged [rad]; NaN if the log does not contain it.

        Noise may hide the pose from which the bearing was computed.
        """
        logged = self.run.samples.bearing_rad
        return math.nan if logged is None else float(logged[0])

    @property
    def grain_m(self) -> float:
        """Quantisation step of logged positions [m]."""
        return max(find_pose_resolution(self.xy_m[:, 0]), find_pose_resolution(self.xy_m[:, 1]))

    @property
    def grain_rad(self) -> float:
        """Quantisation step of logged headings [rad]."""
        return find_pose_resolution(self.heading_rad)

    @property
    def coarse_steps(self) -> tuple[float, float, float]:
        """Quantisation steps of x, y [m] and heading [rad]; 0 if not coarse."""
        x_m, y_m = (find_coarse_step(self.xy_m[:, axis]) for axis in (0, 1))
        return x_m, y_m, find_coarse_step(self.heading_rad)

    @property
    def answered_after_s(self) -> float:
        """Usual time from a pose to its answer outside bursts [s]; 0 if almost all are bursts.

        In a burst, all poses but the newest have waited.
        """
        is_other = np.diff(self.time_ns) != 0
        alone = np.r_[True, is_other] & np.r_[is_other, True]
        if alone.sum() <= _FEWEST_ANSWERS:
            return 0.0
        return float(np.median((self.time_ns - self.pose_time_ns)[alone])) / 1e9

    @property
    def missing(self) -> list[tuple[int, int]]:
        """Rows before which other rows are missing, with their numbers."""
        steps = np.diff(self.number)
        return [(row + 1, int(steps[row]) - 1) for row in np.flatnonzero(steps > 1).tolist()]


def trace_run(run: Run, phases: tuple[str, str] | None = None) -> Trace:
    """Return the samples of a run, and the lengths of two phases; ExplainError without samples."""
    samples = run.samples
    if not len(samples):
        raise ExplainError(
            f"{run.name}: no samples that tell which pose a command answers: {run.source}"
        )
    read = samples.pose_sequence
    rotating, translating = len(samples), 0
    if phases is not None:
        names = np.array(run.phase_names)[samples.phase]
        rotating = count_leading(names == phases[0])
        translating = count_leading(names[rotating:] == phases[1])
    poses, tick_ns = run.poses, find_plant(run).period_ns
    # A log has a pose per tick, like a recording, or only a pose per sample. The applied velocity
    # is published by the plant; a controller does not know it.
    has_ticks = not np.array_equal(read, np.arange(len(poses)))
    if not has_ticks and poses.speed_m_s is not None:
        has_ticks = bool((np.diff(poses.time_ns) == tick_ns).all())
    answered_ns = np.diff(poses.time_ns[read])
    usual_ns = float(np.median(answered_ns)) if len(answered_ns) else 0.0
    return Trace(
        run=run,
        number=samples.sequence if has_ticks else np.arange(len(samples)),
        jumps=(),
        time_ns=samples.time_ns,
        xy_m=poses.xy_m[read],
        heading_rad=poses.heading_rad[read],
        read_xy_m=poses.read_xy_m[read],
        read_heading_rad=poses.read_heading_rad[read],
        speed_m_s=samples.speed_m_s,
        turn_rate_rad_s=samples.turn_rate_rad_s,
        rotating=rotating,
        translating=translating,
        goal_xy_m=_find_goal(run),
        period_ticks=max(round(usual_ns / tick_ns), 1),
        has_exact_clock=not (np.r_[samples.time_ns, poses.time_ns] % tick_ns).any(),
        has_ticks=has_ticks,
    )


def find_pose_resolution(values: Values) -> float:
    """Return the common step of all values, or the spacing of their 32-bit floats.

    The result is 0 if the values have more bits and no common step.
    """
    return find_common_step(values) or find_spacing(values)


def estimate_trace_noise(values: Values, order: int = 2) -> float:
    """Return the standard deviation of noise, from differences of neighbouring values.

    For normal noise, the median of absolute second differences is 0.6745 sqrt(6) times the standard
    deviation. Higher orders contain less of the motion itself.
    """
    if len(values) <= order:
        return 0.0
    bends = np.abs(np.diff(values, n=order, axis=0))
    return float(np.median(bends)) / (0.6745 * math.sqrt(math.comb(2 * order, order)))


def count_leading(holds: NDArray[np.bool_]) -> int:
    """Return how many values are true before the first false value."""
    return len(holds) if holds.all() else int(holds.argmin())


def _find_goal(run: Run) -> tuple[float, float] | None:
    """Return the recorded goal, or else the goal from position plus error that fits the bearing."""
    if run.goal_xy_m is not None:
        return run.goal_xy_m
    samples = run.samples
    if samples.error_xy_m is None or samples.bearing_rad is None:
        return None
    reached = np.median(run.poses.xy_m[samples.pose_sequence] + samples.error_xy_m, axis=0)
    x_m, y_m = np.round(reached, _FIRST_DIGITS).tolist()
    first_x_m, first_y_m = run.poses.xy_m[samples.pose_sequence[0]].tolist()
    bearing_rad = math.atan2(y_m - first_y_m, x_m - first_x_m)
    return (x_m, y_m) if abs(bearing_rad - samples.bearing_rad[0]) < 1e-6 else None


_NOISE_STEPS: Final = 8.0
"""Size of a jump in standard deviations of noise; noise alone exceeds it once in 1e15 steps."""

_ROUNDING: Final = 1e-5
"""Largest difference that the 32-bit rounding of two poses explains [m, rad]."""

_NEAR_ROWS: Final = 3  # number of steps on either side that give the robot's usual motion
_MOVES: Final = 4.0  # size of a motion, in standard deviations, that shows its number of steps
_CAUGHT_UP: Final = 0.5  # share of the usual step below which a step follows a late callback
_FAR_TICKS: Final = 1000  # ticks inserted for a gap of unknown length: longer than any dead time


def mark_breaks(trace: Trace) -> Trace:
    """Return the trace with its jumps marked, and with numbers that also count missing rows."""
    jumps = _find_jumps(trace)
    number = trace.number if trace.has_ticks else _number_rows(trace, jumps)
    return replace(trace, jumps=jumps, number=number)


def list_trace_breaks(trace: Trace) -> list[int]:
    """Return the rows at which a segment begins: after a jump, or after missing rows."""
    return sorted({*trace.jumps, *(row for row, _ in trace.missing)})


def describe_trace_breaks(trace: Trace) -> list[str]:
    """Return sentences on the first jump, the first missing rows, and misread poses."""
    found = []
    if trace.jumps:
        row = trace.jumps[0]
        moved, turned = _measure_steps(trace)
        way = f"{moved[row - 1]:.3g} m and {np.degrees(turned[row - 1]):.3g} deg"
        more = f", and {len(trace.jumps) - 1} more" * (len(trace.jumps) > 1)
        found.append(f"the pose jumps by {way} at {_find_time_s(trace, row):.3f} s{more}")
    if trace.missing:
        row, amount = trace.missing[0]
        noun = "sample is" if amount == 1 else "samples are"
        at_s = _find_time_s(trace, row - 1)
        length_s = _find_time_s(trace, row) - at_s
        more = f", and {len(trace.missing) - 1} more" * (len(trace.missing) > 1)
        found.append(f"{amount} {noun} missing after {at_s:.3f} s, for {length_s:.3f} s{more}")
    if not np.array_equal(trace.read_xy_m, trace.xy_m) or not np.array_equal(
        trace.read_heading_rad, trace.heading_rad
    ):
        off_m = float(np.hypot(*(trace.read_xy_m - trace.xy_m).T).max())
        off_rad = np.abs(subtract_headings(trace.read_heading_rad, trace.heading_rad)).max()
        off = f"{off_m:.3g} m and {np.degrees(off_rad):.3g} deg"
        found.append(f"the poses that the controller read are off the plant's by up to {off}")
    return found


def space_out(trace: Trace) -> Run:
    """Return the run with poses at the ticks of their numbers, and jumps far apart.

    In the result, motion is evaluated only across valid steps. If no row is missing and no pose
    jumps, the run itself is returned.
    """
    run = trace.run
    if not list_trace_breaks(trace):
        return run
    if trace.has_ticks:
        time_ns = run.poses.time_ns.copy()
        for row in trace.jumps:
            time_ns[run.samples.pose_sequence[row] :] += _FAR_TICKS * trace.tick_ns
        return replace(run, poses=replace(run.poses, time_ns=time_ns))
    ticks = trace.number * trace.period_ticks
    for row in (trace.rotating, *trace.jumps):
        ticks[row:] += _FAR_TICKS
    return replace(run, poses=replace(run.poses, time_ns=ticks * trace.tick_ns))


def _find_jumps(trace: Trace) -> tuple[int, ...]:
    """Return the rows whose pose no command can have reached from the pose before."""
    if len(trace) < 2:
        return ()
    ticks = np.maximum(np.rint(np.diff(trace.pose_time_ns) / trace.tick_ns), 1.0) + 1.0
    moved, turned = _measure_steps(trace)
    run, reaches = trace.run, []
    for name, command, applied in (
        ("speed", trace.speed_m_s, run.poses.speed_m_s),
        ("turn_rate", trace.turn_rate_rad_s, run.poses.turn_rate_rad_s),
    ):
        fastest = float(np.abs(command).max())  # that the robot can have had
        if find_plant(run).dynamics != "integrator":
            key, seen = PLANT_KEYS[name], 0.0 if applied is None else float(np.abs(applied).max())
            backwards = read_number(run.parameters, f"{key}reverse_gain")
            gain = max(abs(read_number(run.parameters, f"{key}gain", 1.0)), abs(backwards))
            fastest = max(fastest * gain, seen)
        reaches.append(ticks * (trace.tick_ns / 1e9) * fastest)
    reach_m, reach_rad = reaches
    is_jump = moved > reach_m + _find_slack(trace.xy_m, trace.grain_m)
    unwrapped = np.unwrap(trace.heading_rad)[:, None]
    is_jump |= turned > reach_rad + _find_slack(unwrapped, trace.grain_rad)
    return tuple((np.flatnonzero(is_jump) + 1).tolist())


def _number_rows(trace: Trace, jumps: tuple[int, ...]) -> NDArray[np.int64]:
    """Return the number of each row among the rows that the controller must have had.

    A long clock step hides rows if the robot moved as far as in several steps, or did not move.
    """
    step_ns = np.diff(trace.time_ns)
    usual_ns = trace.period_ticks * trace.tick_ns
    steps = np.rint(step_ns / usual_ns).astype(np.int64)
    is_late = np.append(step_ns[1:] < _CAUGHT_UP * usual_ns, False)
    rows = set(np.flatnonzero((steps > 1) & ~is_late).tolist())
    rows -= {trace.rotating - 1, *(row - 1 for row in jumps)}
    number = np.ones(len(trace), dtype=np.int64)
    number[0] = 0
    moved, turned = _measure_steps(trace)
    least_m = _MOVES * np.sqrt(2.0) * estimate_trace_noise(trace.xy_m) + trace.grain_m
    unwrapped = np.unwrap(trace.heading_rad)[:, None]
    least_rad = _MOVES * np.sqrt(2.0) * estimate_trace_noise(unwrapped) + trace.grain_rad
    for row in sorted(rows):
        near = [
            step
            for step in range(max(row - _NEAR_ROWS, 0), min(row + _NEAR_ROWS + 1, len(steps)))
            if step not in rows and step != trace.rotating - 1
        ]
        shares = [
            float(done[row] / np.median(done[near]))
            for done, least in ((moved, least_m), (turned, least_rad))
            if near and np.median(done[near]) > least
        ]
        # The motion of one step in a long time: the callback was late, and no row is missing.
        if not shares or max(shares) > 1.5:
            number[row + 1] = steps[row]
    return np.cumsum(number)


def _find_time_s(trace: Trace, row: int) -> float:
    return float(trace.time_ns[row] - trace.run.start_ns) / 1e9


def _measure_steps(trace: Trace) -> tuple[Values, Values]:
    moved = np.hypot(*np.diff(trace.xy_m, axis=0).T)
    turned = np.abs(subtract_headings(trace.heading_rad[1:], trace.heading_rad[:-1]))
    return moved, turned


def _find_slack(values: Values, grain: float) -> float:
    step = float(np.sqrt(2.0)) * estimate_trace_noise(values)
    return _NOISE_STEPS * step + 2.0 * grain + _ROUNDING
