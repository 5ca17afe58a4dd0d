"""Rates of a robot, their outliers, and its commands, one axis at a time.

Rates are reported by the robot. turtlesim and some robots report speeds without a sign, which comes
from the poses. Otherwise they are differences of poses: the forward speed is the displacement along
the mean heading divided by the time. Of fast poses, every n-th is used: 1 mm over 1 ms is 1 m/s.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from turtlelog.measure.reductions import Values, compute_median, subtract_neighbours
from turtlelog.measure.signals import find_no_commands, sign_speeds
from turtlelog.plants import find_plant
from turtlelog.run import PoseColumns, Run
from turtlelog.run.angles import unwrap_headings

Axis = Literal["speed", "turn_rate"]

AXES: Final[Mapping[Axis, str]] = MappingProxyType({"speed": "m/s", "turn_rate": "rad/s"})
"""Units of the rates of the axes."""

SHORTEST_S: Final = 0.05
"""Approximate time over which poses are differenced [s]. Odometry at the usual 20 Hz is used pose
by pose."""

NEAR: Final = 1.01
"""Factor by which the usual time between poses may exceed the largest allowed time [1]. Clocks and
times with few digits make a rate of 5 Hz appear up to a hundredth lower."""

_LEAST_STEP: Final = 0.5
"""Share of the usual time between poses below which a pose is left out. Pairs 0.1 ms apart give
arbitrary speeds."""

_SAME_TIME_NS: Final = 1_000
"""Time between poses below which only the first is used [ns]. Such poses had equal times in their
file, and were moved by 1 ns each; no robot publishes at 1 MHz."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rates:
    """The rate of one axis over time; times count from time zero of the run.

    Attributes:
        time_s: Time of each value [s], shape (n,), strictly increasing.
        values: Rate [m/s or rad/s], shape (n,); backward and clockwise negative.
        edges_s: Boundaries of the intervals of `means` [s], shape (m + 1,).
        means: Mean rate of each interval, shape (m,); reported rates are linearly interpolated.
        is_seen: Whether the poses show the motion in each interval, shape (m,): no pose is missing
            and none jumps.
        outliers: Number of values that were left out.
    """

    time_s: Values
    values: Values
    edges_s: Values
    means: Values
    is_seen: NDArray[np.bool_]
    outliers: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SpacedPoses:
    """Poses far enough apart in time for differences, at least two.

    Attributes:
        time_s: Times of these rows of the poses, from time zero of the run [s], shape (n,).
        heading_rad: Their headings without jumps at full turns [rad], shape (n,).
        is_seen: Whether the poses show the motion from each row to the next, shape (n - 1,).
    """

    rows: NDArray[np.int64]
    time_s: Values
    heading_rad: Values
    is_seen: NDArray[np.bool_]


def space_poses(run: Run, jumps: Sequence[int] = ()) -> SpacedPoses:
    """Return the poses of a run that are used for differences; at least two are given.

    `jumps` are the rows of the first poses after jumps, in order.
    """
    poses = run.poses
    rows = _find_shown_rows(poses) if poses.speed_m_s is None else np.arange(len(poses))
    rows = rows[thin_poses(poses.time_ns[rows])]
    is_seen = find_seen(poses.time_ns, rows) & ~_find_leaps(poses, rows)
    is_seen[np.searchsorted(rows, [row for row in jumps if row <= rows[-1]]) - 1] = False
    time_s = (poses.time_ns[rows] - run.start_ns) / 1e9
    heading_rad = unwrap_headings(poses)[rows]
    return SpacedPoses(rows=rows, time_s=time_s, heading_rad=heading_rad, is_seen=is_seen)


def find_seen(time_ns: NDArray[np.int64], rows: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return between which of two or more rows no poses are missing, shape (len(rows) - 1,)."""
    longest_ns = np.maximum.reduceat(subtract_neighbours(time_ns[: rows[-1] + 1]), rows[:-1])
    return np.asarray(longest_ns <= GAP_STEPS * find_usual_step(time_ns[rows]))


def read_rates(run: Run, axis: Axis, spaced: SpacedPoses | None = None) -> Rates | None:
    """Return the rate of an axis; None if there are fewer than two poses.

    `spaced` are the poses as from `space_poses`, if they are already known.
    """
    poses = run.poses
    reported = poses.measured_speed_m_s if axis == "speed" else poses.measured_turn_rate_rad_s
    if len(poses) < 2:
        return None
    if reported is None:
        applied = _read_applied(run, axis)
        rates = _difference_poses(run, axis, spaced or space_poses(run))
        if applied is None:
            return rates
        time_s = (poses.time_ns - run.start_ns) / 1e9
        return replace(rates, time_s=time_s, values=applied, outliers=0)
    if axis == "speed" and (signed := sign_speeds(run)) is not None:
        reported = signed
    kept = np.delete(np.arange(len(poses)), find_outliers(poses.time_ns, reported))
    time_s, values = (poses.time_ns[kept] - run.start_ns) / 1e9, reported[kept]
    return Rates(
        time_s=time_s,
        values=values,
        edges_s=time_s,
        means=(values[:-1] + values[1:]) / 2.0,
        is_seen=find_seen(poses.time_ns, kept),
        outliers=len(poses) - len(kept),
    )


def _read_applied(run: Run, axis: Axis) -> Values | None:
    """Return the command that the plant applied before each pose; None if it is not recorded."""
    speed, rate = run.poses.speed_m_s, run.poses.turn_rate_rad_s
    if axis == "turn_rate" or speed is None:
        return rate if axis == "turn_rate" else None
    return np.asarray(speed * np.sign(measure_forward_steps(run.poses)))


def measure_forward_steps(poses: PoseColumns) -> Values:
    """Return the way along the heading before each pose [m], negative backward; 0 at the first."""
    x_m, y_m = np.diff(poses.xy_m, axis=0, prepend=poses.xy_m[:1]).T
    return np.asarray(x_m * np.cos(poses.heading_rad) + y_m * np.sin(poses.heading_rad))


def thin_poses(time_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the rows of poses used for differences, including the first, of at least two poses.

    The last row is left out if it is less than a whole stride after the previous one.
    """
    rows = np.flatnonzero(np.append(True, subtract_neighbours(time_ns) >= _SAME_TIME_NS))
    if len(rows) > 1:
        usual_s = compute_median(subtract_neighbours(time_ns[rows])) / 1e9
        rows = rows[:: max(round(SHORTEST_S / usual_s), 1)]
    if len(rows) < 2:
        return np.array([0, len(time_ns) - 1])
    step_ns = subtract_neighbours(time_ns[rows])
    is_far = np.concatenate([[True], step_ns >= _LEAST_STEP * compute_median(step_ns)])
    return np.asarray(rows[is_far])


def _difference_poses(run: Run, axis: Axis, spaced: SpacedPoses) -> Rates:
    edges_s, heading_rad, is_seen = spaced.time_s, spaced.heading_rad, spaced.is_seen
    if axis == "turn_rate":
        moved = subtract_neighbours(heading_rad)
    else:
        mean_rad = (heading_rad[:-1] + heading_rad[1:]) / 2.0
        ways_m = np.diff(run.poses.xy_m[spaced.rows], axis=0)
        moved = ways_m[:, 0] * np.cos(mean_rad) + ways_m[:, 1] * np.sin(mean_rad)
    means = moved / subtract_neighbours(edges_s)
    middle_s = (edges_s[:-1] + edges_s[1:]) / 2.0
    wrong = find_outliers(np.asarray(np.round(middle_s * 1e9), dtype=np.int64), means)
    # The intervals stay in order: an outlier's interval gets the values of its neighbours.
    means[wrong] = (means[wrong - 1] + means[wrong + 1]) / 2.0
    is_value = is_seen.copy()
    is_value[wrong] = False
    return Rates(
        time_s=middle_s[is_value],
        values=means[is_value],
        edges_s=edges_s,
        means=means,
        is_seen=is_seen,
        outliers=len(wrong),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldCommands:
    """The published commands of one axis under zero-order hold, at least one command.

    Attributes:
        time_s: Time from which each value is held, from time zero of the run [s], shape (n,); equal
            successive values are merged, and at equal times the last value is used.
        values: Rate [m/s or rad/s], shape (n,).
        end_s: Time when the last command was published [s]; the duration of its hold is unknown.
        before: Value assumed before the first command: 0 if the robot stood still, otherwise the
            first value.
        silences_s: Times without commands in which the robot stops by itself [s], shape (k, 2): the
            value is 0 there, and the time of the stop is unknown.
    """

    time_s: Values
    values: Values
    end_s: float
    before: float
    silences_s: Values

    def find_known(self, edges_s: Values) -> NDArray[np.bool_]:
        """Return which intervals between successive times are in no silence, shape (n - 1,)."""
        begins_s, ends_s = self.silences_s.T
        silent = np.searchsorted(begins_s, edges_s[1:]) - np.searchsorted(
            ends_s, edges_s[:-1], side="right"
        )
        return np.asarray(silent == 0)

    def integrate(self, time_s: Values) -> Values:
        """Return the integral of the commands up to each time [m or rad], shape of `time_s`."""
        first_s = min(float(time_s.min()), float(self.time_s[0])) - 1.0
        last_s = max(float(time_s.max()), self.end_s) + 1.0
        knots_s = np.concatenate([[first_s], self.time_s, [last_s]])
        ways = subtract_neighbours(knots_s) * np.append(self.before, self.values)
        return np.asarray(np.interp(time_s, knots_s, np.append(0.0, np.cumsum(ways))))


SAME: Final = 1e-6
"""Difference below which commands are equal [m/s or rad/s]: sums of steps of 0.1 miss 0 by 1e-17,
and 32 bits round a command of 5 by 5e-7."""


def read_held_commands(run: Run, axis: Axis, rates: Rates | None) -> HeldCommands | None:
    """Return the commands of an axis; None if no command of it was recorded.

    Without rates, the first command is assumed to act before its time.
    """
    commands = run.commands
    if find_no_commands(run, axis):
        return None
    values = commands.speed_m_s if axis == "speed" else commands.turn_rate_rad_s
    time_s = (commands.time_ns - run.start_ns) / 1e9
    # If commands have equal times, the last is held.
    is_last = np.append(subtract_neighbours(time_s) > 0.0, True)
    time_s, values = time_s[is_last], values[is_last]
    if run.poses.speed_m_s is not None:  # of turtlesim, or a simulation: its watchdog stops it
        holds_s = find_plant(run).watchdog_ns / 1e9
        late = np.append(subtract_neighbours(time_s) > holds_s, np.isfinite(holds_s))
        rows, stops_s = np.flatnonzero(late) + 1, time_s[late] + holds_s
        time_s, values = np.insert(time_s, rows, stops_s), np.insert(values, rows, 0.0)
    end_s = float(time_s[-1])
    silences_s = np.empty((0, 2))
    if rates is not None and run.poses.speed_m_s is None:
        silences_s = _find_silences(time_s, values, rates)
        rows = np.searchsorted(time_s, silences_s[:, 1])
        time_s = np.insert(time_s, rows, silences_s[:, 0])
        values = np.insert(values, rows, 0.0)
    is_new = np.concatenate([[True], subtract_neighbours(values) != 0.0])
    time_s, values = time_s[is_new], values[is_new]
    before = float(values[0])
    if rates is not None:
        row = min(max(int(np.searchsorted(rates.edges_s, time_s[0])) - 1, 0), len(rates.means) - 1)
        stood = abs(float(rates.means[row])) <= abs(before) / 2.0
        before = 0.0 if stood else before
    return HeldCommands(
        time_s=time_s, values=values, end_s=end_s, before=before, silences_s=silences_s
    )


_SILENT_PERIODS: Final = 4.0
_SILENT_S: Final = 0.3
"""Shortest silence of commands in which a robot may stop by itself, in usual periods and in s.
Watchdogs of commands are set to several periods, and seldom to less than half a second."""

_STOPPED: Final = 0.5
"""Largest mean rate in the last third of a silence, as a share of the held command, at which the
robot has stopped. In a silence a little longer than the watchdog's time, the robot still brakes."""

_MOSTLY: Final = 0.5
_FEWEST_STOPS: Final = 3
"""Share of the silences with a stop, and number of stops, from which a watchdog, and no obstacle,
stops the robot."""


def _find_silences(time_s: Values, values: Values, rates: Rates) -> Values:
    """Return begin and end of the silences of commands in which the robot stops, shape (k, 2)."""
    held_s = subtract_neighbours(time_s)
    if not len(held_s):
        return np.empty((0, 2))
    usual_s = compute_median(held_s)
    is_long = held_s > max(_SILENT_PERIODS * usual_s, _SILENT_S)
    rows = np.flatnonzero(is_long & (np.abs(values[:-1]) > SAME))
    has_stopped = list[bool]()
    for row in rows.tolist():
        late_s = [time_s[row + 1] - held_s[row] / 3.0, time_s[row + 1]]
        late = rates.values[slice(*np.searchsorted(rates.time_s, late_s))]
        whole = rates.values[slice(*np.searchsorted(rates.time_s, time_s[[row, row + 1]]))]
        # A robot that still speeds up is slow, too, but its rate does not fall.
        largest = min(abs(float(values[row])), float(np.abs(whole).max(initial=0.0)))
        has_stopped.append(len(late) > 0 and abs(float(late.mean())) < _STOPPED * largest)
    if sum(has_stopped) < _FEWEST_STOPS or np.mean(has_stopped) <= _MOSTLY:
        return np.empty((0, 2))
    return np.column_stack([time_s[rows] + usual_s, time_s[rows + 1]])


LONGEST_STEP_NS: Final = 250_000_000
"""Longest time to neighbours that can contradict a value [ns]: in this time a robot reaches 0.5 m/s
at 2 m/s2."""

_LEAST_ROWS: Final = 30
"""Smallest number of values that shows the usual scatter: of 20 normal values, one in 2,000
deviates this far."""

_MOST_SHARE: Final = 0.01
"""Share of rows above which deviating values belong to the signal."""

_APART: Final = 5.0
"""Ratio to the deviation of every other value from which a value is an outlier. In 2,000 values
with normal, uniform or Laplace noise, the largest deviation is less than 2 times the second."""

LOCAL_SPANS: Final = 3.0
"""Smallest ratio to the signal's range among its neighbours; a robot that speeds up or brakes needs
a larger one."""

NEIGHBOURS: Final = 5
"""Number of rows on either side that show the signal's range: half a second at 20 Hz."""

GRAINS: Final = 5.5
"""Smallest deviation in steps of a quantised signal: more than five steps, regardless of rounding.
An encoder at low speed shows single ticks."""

_ROUNDING: Final = 1e-6
"""Differences below this share of the largest value are 32-bit rounding instead of a quantisation
step."""

_LEAST_CHANGES: Final = 8
"""Number of changes, besides those of the outliers, that a signal needs: a single pulse in a
constant signal may be a test impulse."""


def find_outliers(time_ns: NDArray[np.int64], values: Values) -> NDArray[np.int64]:
    """Return the rows of single values that are outliers of a measured signal, in order.

    A value deviates if it lies on the same side of both neighbours; its deviation is the distance
    to the nearer one. Steps, ramps, limits and anything that lasts two rows have no deviation. A
    value is an outlier if no other value deviates nearly as far, its neighbours agree, and they are
    close in time. The first and last rows are never outliers, because they have one neighbour.

    Args:
        time_ns: Time [ns], shape (n,), not decreasing.
        values: Finite values of one unit, angles without jumps at a full turn, shape (n,).
    """
    none = np.empty(0, dtype=np.int64)
    if len(values) < _LEAST_ROWS:
        return none
    smooth, sides = np.array(values), (values[:-2], values[2:])
    smooth[1:-1] = np.clip(values[1:-1], np.minimum(*sides), np.maximum(*sides))  # median of three
    height = np.abs(values - smooth)
    rows = _find_apart(height)
    if not len(rows) or np.count_nonzero(np.diff(np.delete(values, rows))) < _LEAST_CHANGES:
        return none
    around = rows[:, None] + np.arange(-NEIGHBOURS, NEIGHBOURS + 1)
    spans = np.ptp(smooth[np.clip(around, 0, len(smooth) - 1)], axis=1)
    least = np.maximum(LOCAL_SPANS * spans, GRAINS * find_quantisation_step(values))
    step_ns = np.maximum(time_ns[rows] - time_ns[rows - 1], time_ns[rows + 1] - time_ns[rows])
    is_outlier = (height[rows] > least) & (step_ns <= LONGEST_STEP_NS)
    return np.asarray(rows[is_outlier])


def _find_apart(height: Values) -> NDArray[np.int64]:
    """Return the rows whose deviation is far larger than all others, in order."""
    most = max(int(_MOST_SHARE * len(height)), 1)
    order = np.argsort(-height, kind="stable")[: most + 1]
    is_apart = height[order[:-1]] > _APART * height[order[1:]]
    count = int(np.flatnonzero(is_apart)[-1]) + 1 if is_apart.any() else 0
    return np.sort(order[:count])


def find_quantisation_step(values: Values) -> float:
    """Return the quantisation step of a signal; a tiny number if it is not quantised."""
    steps = np.abs(subtract_neighbours(values))
    steps = steps[steps > _ROUNDING * float(np.abs(values).max())]
    return float(steps.min()) if len(steps) else 0.0


GAP_STEPS: Final = 4.0
"""Silence, in usual steps, from which poses may be lost. A wall clock under load makes steps of
three."""

_USUAL: Final = 0.95
"""Share of time steps that count as usual: some robots publish at two rates, or only while they
move."""


def find_usual_step(time_ns: NDArray[np.int64]) -> float:
    """Return the longest usual step between two or more times [ns]."""
    return float(np.quantile(np.diff(time_ns), _USUAL))


STEADY: Final = 1.5
_FEWEST_STEADY: Final = 10
"""Largest ratio of long to short times between changes of the position, and their least number,
that show a source with its own rate: a receiver at 1 Hz beside a compass at 20 Hz. A robot that
turns on the spot now and then has no such rate."""


def find_changing_rows(poses: PoseColumns) -> NDArray[np.int64]:
    """Return the rows of poses that differ from the previous pose, if most poses repeat it.

    If only positions repeat, at a steady rate, they decide.
    """
    # Some programs publish each pose several times. In other recordings, a repeated pose shows that
    # the robot is at rest, and it counts.
    moved = (np.diff(poses.xy_m, axis=0) != 0.0).any(axis=1)
    changing = np.flatnonzero(moved | (np.diff(poses.heading_rad) != 0.0)) + 1
    if len(changing) >= 2 and compute_median(np.diff(changing)) >= 2:
        return np.concatenate([[0], changing])
    moving = np.flatnonzero(moved) + 1
    if len(moving) >= _FEWEST_STEADY:
        few, usual, many = np.quantile(np.diff(moving), [0.1, 0.5, 0.9])
        if usual >= 2 and many <= STEADY * few:
            return np.concatenate([[0], moving])
    return np.arange(len(poses))


_LEAPS: Final = 3.0
"""Size of a change after a long repetition, in usual changes, above which poses were lost in it. A
robot that starts again moves less than usual."""


def _find_leaps(poses: PoseColumns, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return after which rows a pose is repeated for long, and then moves on at once."""
    time_ns, xy_m = poses.time_ns[rows], poses.xy_m[rows]
    is_long = subtract_neighbours(time_ns) > GAP_STEPS * find_usual_step(time_ns)
    return np.asarray(is_long & (np.diff(xy_m, axis=0) != 0.0).any(axis=1))


def _find_shown_rows(poses: PoseColumns) -> NDArray[np.int64]:
    """Return the rows of poses that are no repetitions, and the last row of each rest."""
    rows = find_changing_rows(poses)
    if len(rows) == len(poses):
        return rows
    time_ns = poses.time_ns
    held_ns = np.diff(time_ns[rows], append=time_ns[-1])
    usual_ns = compute_median(held_ns)
    ways_m = np.hypot(*np.diff(poses.xy_m[rows], axis=0, append=poses.xy_m[-1:]).T)
    is_rest = (held_ns > GAP_STEPS * usual_ns) & (ways_m <= _LEAPS * compute_median(ways_m))
    ends_ns = np.append(time_ns[rows[1:]] - round(usual_ns), time_ns[-1])[is_rest]
    ends = np.searchsorted(time_ns, ends_ns, side="right") - 1
    return np.sort(np.concatenate([rows, ends]))
