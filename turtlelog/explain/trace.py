"""A log sample by sample: pose read, command published, time; and where it is interrupted."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import ExplainError
from turtlelog.measure.motion import find_coarse_step, find_common_step, find_spacing
from turtlelog.plants import find_plant
from turtlelog.run import Run

Values = NDArray[np.float64]

_FIRST_DIGITS: Final = 9
"""A goal that is only logged as position plus error is rounded to this many decimals."""


_FEWEST_ANSWERS: Final = 10
"""Answers of fewer single poses say nothing of the usual delay: a run may end in its start."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trace:
    """The samples of a run, one row each, and what is known of their clock.

    Attributes:
        run: Where they come from.
        number: Of each sample in the run, from 0, shape (n,); some are left out where rows are
            lost. A log that has no such numbers counts its rows until `mark_breaks`.
        jumps: Rows whose pose the robot cannot have reached from the one before; none until
            `mark_breaks`.
        time_ns: Of each answer [ns], shape (n,).
        xy_m: Of the pose read, as the plant published it [m], shape (n, 2).
        heading_rad: Of the pose read, as the plant published it [rad], shape (n,).
        read_xy_m: As the controller read it, where that is logged; else the same [m].
        read_heading_rad: As the controller read it, where that is logged; else the same [rad].
        speed_m_s: Published [m/s], shape (n,).
        turn_rate_rad_s: Published [rad/s], shape (n,).
        rotating: How many samples the first phase has, from the first one: of sequential-p the
            rotation. All of a law whose phases are not known.
        translating: How many samples the phase after it has: of sequential-p the translation.
        goal_xy_m: Goal position [m], None where the log does not show.
        period_ticks: Ticks between the poses that are answered.
        has_exact_clock: Whether times are simulated: whole ticks.
        has_ticks: Whether there is a pose per tick, whether it was answered or not.
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
        """Length of a tick: the period of the plant that the run is of [ns]."""
        return find_plant(self.run).period_ns

    @property
    def pose_time_ns(self) -> NDArray[np.int64]:
        """When the pose read was published [ns], shape (n,)."""
        return self.run.poses.time_ns[self.run.samples.pose_sequence]

    @property
    def ended_rotation(self) -> bool:
        """Whether the rotation came to its end, with a command of 0."""
        return self.rotating > 1 and float(self.turn_rate_rad_s[self.rotating - 1]) == 0.0

    @property
    def shows_pause(self) -> bool:
        """Whether there is a sample after the rotation's end."""
        return self.ended_rotation and self.translating > 0

    @property
    def bearing_rad(self) -> float:
        """The goal bearing, as logged [rad]: noise may have hidden the pose that gave it.

        NaN where the log holds none.
        """
        logged = self.run.samples.bearing_rad
        return math.nan if logged is None else float(logged[0])

    @property
    def grain_m(self) -> float:
        """Step in which positions are logged [m]."""
        return max(find_resolution(self.xy_m[:, 0]), find_resolution(self.xy_m[:, 1]))

    @property
    def grain_rad(self) -> float:
        """Step in which headings are logged [rad]."""
        return find_resolution(self.heading_rad)

    @property
    def coarse_steps(self) -> tuple[float, float, float]:
        """Steps of x, y [m] and heading [rad] in which poses are logged; 0 where not coarse."""
        x_m, y_m = (find_coarse_step(self.xy_m[:, axis]) for axis in (0, 1))
        return x_m, y_m, find_coarse_step(self.heading_rad)

    @property
    def answered_after_s(self) -> float:
        """Usual time from a pose to its answer [s], bursts left out; 0 where there is little else.

        Of a burst all but the newest pose have waited.
        """
        is_other = np.diff(self.time_ns) != 0
        alone = np.r_[True, is_other] & np.r_[is_other, True]
        if alone.sum() <= _FEWEST_ANSWERS:
            return 0.0
        return float(np.median((self.time_ns - self.pose_time_ns)[alone])) / 1e9

    @property
    def missing(self) -> list[tuple[int, int]]:
        """Rows before which others are missing, and how many."""
        steps = np.diff(self.number)
        return [(row + 1, int(steps[row]) - 1) for row in np.flatnonzero(steps > 1).tolist()]


def trace_run(run: Run, phases: tuple[str, str] | None = None) -> Trace:
    """Return the samples of a run, one after the other.

    Args:
        run: With samples.
        phases: The two that follow each other in it; None: of a law whose phases are not known.

    Raises:
        ExplainError: Where it holds none.
    """
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
    has_ticks, tick_ns = _has_ticks(run), find_plant(run).period_ns
    poses = run.poses
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
        period_ticks=_find_period(run),
        has_exact_clock=not (np.r_[samples.time_ns, run.poses.time_ns] % tick_ns).any(),
        has_ticks=has_ticks,
    )


def find_resolution(values: Values) -> float:
    """Return the step that all values are multiples of, or the spacing of their 32-bit floats.

    0 where they have more bits and no common step.
    """
    return find_common_step(values) or find_spacing(values)


def estimate_trace_noise(values: Values, order: int = 2) -> float:
    """Return the standard deviation of noise, from what neighbours do not have in common.

    The median of second differences of normal noise is 0.6745 times the root of 6 of it. Of a
    higher order the motion itself leaves less.
    """
    if len(values) <= order:
        return 0.0
    bends = np.abs(np.diff(values, n=order, axis=0))
    return float(np.median(bends)) / (0.6745 * math.sqrt(math.comb(2 * order, order)))


def count_leading(holds: NDArray[np.bool_]) -> int:
    """Return how many hold from the first one on."""
    return len(holds) if holds.all() else int(holds.argmin())


def _find_goal(run: Run) -> tuple[float, float] | None:
    """Return the goal as recorded, or the one that position plus error and the bearing agree on."""
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


def _has_ticks(run: Run) -> bool:
    """Tell a recording, with a pose per tick, from a log with a pose per sample."""
    if not np.array_equal(run.samples.pose_sequence, np.arange(len(run.poses))):
        return True
    # What the plant itself publishes holds the applied velocity; a controller does not see it.
    is_plants = run.poses.speed_m_s is not None
    return is_plants and bool((np.diff(run.poses.time_ns) == find_plant(run).period_ns).all())


def _find_period(run: Run) -> int:
    """Return the usual distance of the poses answered, in ticks."""
    read = run.samples.pose_sequence
    if len(read) < 2:
        return 1
    step_ns = float(np.median(np.diff(run.poses.time_ns[read])))
    return max(round(step_ns / find_plant(run).period_ns), 1)
