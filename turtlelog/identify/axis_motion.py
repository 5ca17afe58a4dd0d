"""The recorded motion of one axis of a run: displacements and commands.

A stop of the robot without a command counts as a command of 0: otherwise it would seem slow.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from turtlelog.identify.held_response import HeldInput, Values, hold_commands
from turtlelog.identify.silent_stops import (
    SILENCE_S,
    SilentStop,
    find_silent_stops,
    hold_with_stops,
)
from turtlelog.measure.pose_noise import find_spacing
from turtlelog.measure.pose_quality import find_travel_direction
from turtlelog.measure.rates import STEADY, find_changing_rows
from turtlelog.run import PoseColumns, Run
from turtlelog.run.angles import subtract_headings, wrap_angle
from turtlelog.run.columns import take_rows
from turtlelog.run.loops import COMMAND_UNITS, COMMAND_WORDS

Axis = Literal["speed", "turn_rate"]
AXES: Final[tuple[Axis, ...]] = ("speed", "turn_rate")
UNITS: Final = COMMAND_UNITS

OTHER: Final[Mapping[Axis, Axis]] = {"speed": "turn_rate", "turn_rate": "speed"}
NAMES: Final = COMMAND_WORDS
"""Names of the axes in sentences."""

LARGEST_DEAD_TIME_S: Final = 1.5
"""Largest dead time that is searched [s]: ten times the usual one. A larger dead time means that
the clocks disagree."""

_CLOSEST_S: Final = 1e-3
"""Distance in time below which a pose was received late, if it is also below half the usual step
[s]. The later pose is left out."""

_LONGEST_STEP_S: Final = 1.0
"""Longest step that is used [s]: in a longer step, a heading may turn by a full turn."""

_MOST_TURN_RAD: Final = 1.0
"""Largest turn of a step [rad]. At this turn an arc differs from its chord by 4 %, which is
corrected; a larger turn has no single direction."""

MEMORY_S: Final = 2.0 * LARGEST_DEAD_TIME_S
"""Time for which an earlier command matters [s]: the largest dead time plus as long for the
response of the robot."""

AT_ONCE_S: Final = 0.1
"""Time within which changes of commands count as one [s]: a usual robot's delay. A program that
sends both axes apart needs 10 ms."""

STANDING: Final = 0.02
"""Mean rate below which a robot is at rest, as a share of the largest command."""

RESTED_S: Final = 1.0
"""Shortest rest that shows noise or a drift [s]: thirty poses of a usual robot."""

_FEWEST_WAITING, _BY_NOISE = 8, 2.0
"""Number of steps whose scatter shows the noise of their sum, and the standard deviations that are
noise. The sum of eight equal steps has 2.8."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AxisMotion:
    """The steps of one axis of a run that commands can explain.

    Attributes:
        time_s: Times of the poses at the ends of the steps [s], shape (m,).
        first: Row of the pose at the beginning of each step, shape (n,); the step ends at the next
            pose.
        moved: Displacement or turn in each step [m or rad], shape (n,).
        direction_rad: Direction in which each displacement is measured [rad], shape (n,); 0 for
            turns.
        commands: Commands of this axis, with a 0 if the robot stops by itself.
        stops: Stops of the robot without a command.
        beside: Commands of the other axis; None if they are unknown.
        rounding: Standard deviation of a pose's rounding to 32 bits [m or rad]; 0 for more bits.
        waited: Known time before the first command of this axis that is not 0 [s], and the
            displacement in that time [m or rad].
        rested: The same before the first command of either axis that is not 0.
    """

    time_s: Values
    first: NDArray[np.int64]
    moved: Values
    direction_rad: Values
    commands: HeldInput
    stops: tuple[SilentStop, ...] = ()
    beside: HeldInput | None = None
    rounding: float = 0.0
    waited: tuple[float, float] = (0.0, 0.0)
    rested: tuple[float, float] = (0.0, 0.0)

    @property
    def seen_stops(self) -> tuple[SilentStop, ...]:
        """Stops whose rest the poses show."""
        return tuple(stop for stop in self.stops if stop.is_seen)

    @property
    def duration_s(self) -> Values:
        """Duration of each step [s]."""
        return np.asarray(self.time_s[self.first + 1] - self.time_s[self.first])

    @property
    def follows(self) -> NDArray[np.bool_]:
        """Whether each step begins where the previous one ended."""
        return np.asarray(np.diff(self.first, prepend=-2) == 1)

    @property
    def shared(self) -> Values:
        """Share of the error of the pose before each step by which the step before it is longer.

        1 for turns; less if the robot turns, because the two steps are measured in two directions.
        """
        bends_rad = np.diff(self.direction_rad, prepend=0.0)
        return np.asarray(np.where(self.follows, np.cos(bends_rad), 0.0))

    def is_alone(self, dead_time_s: float, settled_s: float = 0.0) -> NDArray[np.bool_]:
        """Return whether the command of the other axis is 0 in each step, for some time [s]."""
        if self.beside is None:
            return np.ones(len(self.moved), dtype=bool)
        return _is_idle(self, self.beside, dead_time_s, settled_s)

    def take(self, steps: slice | NDArray[np.bool_]) -> "AxisMotion":
        """Return some of the steps, with the poses between which they lie."""
        first, is_used = self.first[steps], np.zeros(len(self.time_s), dtype=bool)
        is_used[first], is_used[first + 1] = True, True
        place = np.cumsum(is_used) - 1
        return replace(
            self,
            time_s=self.time_s[is_used],
            first=place[first],
            moved=self.moved[steps],
            direction_rad=self.direction_rad[steps],
        )


def _is_idle(
    motion: AxisMotion, commands: HeldInput, dead_time_s: float, settled_s: float
) -> NDArray[np.bool_]:
    begins, ends = (
        commands.place(motion.time_s[rows] - dead_time_s)
        for rows in (motion.first, motion.first + 1)
    )
    is_held = (begins.held == ends.held) & (begins.since_s >= settled_s)
    return np.asarray(is_held & (begins.value == 0.0))


def read_axis_motion(run: Run, axis: Axis) -> AxisMotion:
    """Return the steps of an axis in which commands act, all of which are known."""
    command, poses = get_commands(run, axis), _drop_repetitions(turn_to_travel(run))
    time_s, moved, is_sound = measure_axis_steps(poses, axis)
    command_s = run.commands.time_ns / 1e9
    first = np.arange(len(moved))
    if not len(command):
        none, held = moved[:0], hold_commands(command_s, command)
        return AxisMotion(
            time_s=none, first=first[:0], moved=none, direction_rad=none, commands=held
        )
    begins_s, ends_s = time_s[:-1], time_s[1:]
    stops = find_silent_stops(command_s, command, time_s, moved, memory_s=MEMORY_S)
    commands = hold_with_stops(command_s, command, [stop.zero_s for stop in stops])
    for stop in stops:  # the time of a stop is uncertain
        begin_s = min(stop.begin_s + SILENCE_S, stop.zero_s)
        is_sound &= (ends_s <= begin_s) | (begins_s >= stop.end_s)
    first_s = command_s[np.argmax(command != 0.0)]
    # A recording that starts with the commands shows a rest in its first step.
    earlier = ends_s <= max(first_s, ends_s.min(initial=np.inf))
    most = STANDING * np.abs(command).max() * float((ends_s - begins_s)[earlier].sum())
    if np.count_nonzero(earlier) >= _FEWEST_WAITING:
        most = max(most, _BY_NOISE * float(np.sqrt((moved[earlier] ** 2).sum())))
    stands = most > 0.0 and abs(float(moved[earlier].sum())) <= most
    known = is_sound & (begins_s >= (-np.inf if stands else command_s[0] + MEMORY_S))
    used = known & _find_active(commands, begins_s, ends_s)
    other = get_commands(run, OTHER[axis])
    begun_s = min(first_s, command_s[np.argmax(other != 0.0)] if other.any() else first_s)
    waited, rested = (
        (float((ends_s - begins_s)[waits].sum()), float(moved[waits].sum()))
        for waits in (known & (ends_s <= one) for one in (first_s, begun_s))
    )
    direction_rad = 0.0 * moved
    if axis == "speed":
        heading_rad = np.unwrap(poses.heading_rad)
        direction_rad = np.interp(0.5 * (begins_s + ends_s), poses.time_ns / 1e9, heading_rad)
    motion = AxisMotion(
        time_s=time_s,
        first=first,
        moved=moved,
        direction_rad=direction_rad,
        commands=commands,
        stops=tuple(stops),
        beside=hold_commands(command_s, other),
        rounding=find_spacing(poses.xy_m if axis == "speed" else run.poses.heading_rad) / 12**0.5,
        waited=waited,
        rested=rested,
    )
    return motion.take(used)


_STEADILY: Final = 0.8
"""Share of the times between changes that must be near their median if a program repeats poses.
Quantised poses of a slow robot also repeat, but change at the rate of its motion."""


def _drop_repetitions(poses: PoseColumns) -> PoseColumns:
    """Return poses without repetitions by a program, which show each motion too late."""
    changing = find_changing_rows(poses)
    if len(changing) == len(poses):
        return poses
    apart = np.diff(changing)
    period = int(np.median(apart))
    is_near = (apart <= STEADY * period) & (period <= STEADY * apart)
    turns = np.flatnonzero(np.diff(poses.heading_rad)) + 1
    if np.mean(is_near) < _STEADILY or not np.isin(turns, changing).all():
        return poses
    rows = np.arange(len(poses))
    since = rows - changing[np.searchsorted(changing, rows, side="right") - 1]
    # A robot at rest repeats its pose by itself.
    return take_rows(poses, since % period == 0)


def turn_to_travel(run: Run) -> PoseColumns:
    """Return poses with headings in the direction of travel, if that is at an angle to the heading.

    A robot of which no sideways speed is commanded does not drive sideways: its heading is measured
    at an angle, as by a marker that is mounted turned.
    """
    found = find_travel_direction(run) if len(run.commands) else None
    if found is None:
        return run.poses
    return replace(run.poses, heading_rad=wrap_angle(run.poses.heading_rad + found.angle_rad))


def get_commands(run: Run, axis: Axis) -> Values:
    """Return the commands of an axis."""
    return run.commands.speed_m_s if axis == "speed" else run.commands.turn_rate_rad_s


def measure_axis_steps(poses: PoseColumns, axis: Axis) -> tuple[Values, Values, NDArray[np.bool_]]:
    """Return the times of poses, the displacement of each step, and whether it is reliable."""
    time_s = poses.time_ns / 1e9
    apart_s = np.diff(time_s)
    closest_s = min(_CLOSEST_S, 0.5 * float(np.median(apart_s))) if len(apart_s) else 0.0
    rows = np.flatnonzero(np.concatenate([[True], apart_s >= closest_s]))
    time_s, heading_rad, xy_m = time_s[rows], poses.heading_rad[rows], poses.xy_m[rows]
    turned = np.asarray(subtract_headings(heading_rad[1:], heading_rad[:-1]))
    is_sound = np.diff(time_s) <= _LONGEST_STEP_S
    if axis == "turn_rate":
        return time_s, turned, is_sound
    middle_rad = heading_rad[:-1] + 0.5 * turned
    step_m = np.diff(xy_m, axis=0)
    chord_m = step_m[:, 0] * np.cos(middle_rad) + step_m[:, 1] * np.sin(middle_rad)
    arc_m = chord_m / np.sinc(turned / (2.0 * np.pi))
    return time_s, arc_m, is_sound & (np.abs(turned) <= _MOST_TURN_RAD)


def _find_active(commands: HeldInput, begins_s: Values, ends_s: Values) -> NDArray[np.bool_]:
    """Return the steps in which a nonzero command acts, or acted recently."""
    ends_at = np.append(commands.time_s[1:], np.inf)
    moving = np.flatnonzero(commands.value)
    if not len(moving):
        return np.zeros(len(begins_s), dtype=bool)
    latest = np.searchsorted(commands.time_s[moving], ends_s, side="right") - 1
    over_s = ends_at[moving[np.maximum(latest, 0)]]
    return np.asarray((latest >= 0) & (begins_s <= over_s + MEMORY_S))


_SETTLES: Final = 3.0
"""Time constants after which a robot counts as at rest: 5 % of its rate is left, which the model
explains to a tenth."""


def find_rests(
    motions: Sequence[AxisMotion], dead_time_s: float, lag_s: float
) -> NDArray[np.bool_]:
    """Return the steps of runs in which both commands are 0, and earlier ones have faded."""
    delays = dead_time_s, _SETTLES * lag_s
    return np.concatenate(
        [_is_idle(one, one.commands, *delays) & one.is_alone(*delays) for one in motions]
    )


_FITTED: Final = 2 / 3
"""Share of each log that is fitted; the rest of the log is predicted, once its end, once its
beginning."""

Parts = tuple[list[AxisMotion], list[AxisMotion]]
"""Some steps of each run, which are fitted, and its other steps, which are predicted."""


def split_motions(motions: Sequence[AxisMotion]) -> list[Parts]:
    """Return the steps of each run that are fitted, and those predicted: the last, then the first.

    A part without small commands cannot confirm a deadband, but it can be fitted.
    """
    splits = []
    for is_first in (True, False):
        pairs = []
        for motion in motions:
            count = len(motion.moved)
            cut = int((_FITTED if is_first else 1.0 - _FITTED) * count)
            sides = motion.take(slice(cut)), motion.take(slice(cut, None))
            if 0 < cut < count:
                pairs.append(sides if is_first else sides[::-1])
        splits.append(([known for known, _ in pairs], [ahead for _, ahead in pairs]))
    return splits


OVER_TIME: Final = "earlier and later commands"
"""Parts that differ if something besides the commands acts on the robot for a time."""


def divide_steps(
    motions: Sequence[AxisMotion], axis: Axis, dead_time_s: float
) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Yield divisions of the steps by one criterion: whether the first of two commands acts."""
    acting, before, beside = [], [], []
    for motion in motions:
        end_s = motion.time_s[motion.first + 1] - dead_time_s
        held = motion.commands.place(end_s).held
        acting.append(motion.commands.value[held])
        before.append(motion.commands.value[np.maximum(held - 1, 0)])
        other = motion.beside
        beside.append(0.0 * end_s if other is None else other.value[other.place(end_s).held])
    value, earlier = np.concatenate(acting), np.concatenate(before)
    change = np.abs(value - earlier)
    yield "small and large commands", change <= float(np.median(change))
    yield "positive and negative commands", value + earlier > 0.0
    yield "rising and falling commands", np.abs(value) > np.abs(earlier)
    yield OVER_TIME, np.arange(len(value)) < len(value) // 2
    yield f"commands with and without a {NAMES[OTHER[axis]]}", np.concatenate(beside) != 0.0


_SAMPLE_S: Final = 0.01  # sampling time for the comparison of commands with earlier ones [s]
_MOST_S: Final = 120.0  # length of each run that is compared [s]

_ALIKE: Final = 0.8
"""Correlation from which commands repeat: a switch that is 5 % of a period early or late reduces
the correlation to this value. The motion decides whether another delay explains as much."""

_DIPS: Final = 0.5
"""Correlation below which commands must fall before they count as repeated, because slow commands
resemble the commands shortly before."""


def find_repetition(motions: Sequence[AxisMotion]) -> tuple[float, int] | None:
    """Return the time after which commands repeat [s], and their sign; None if they do not repeat.

    Only times up to the largest dead time count, because a later repetition causes no ambiguity.
    """
    moving = [motion for motion in motions if len(motion.moved) and motion.commands.value.any()]
    commands = [_sample(motion) for motion in moving]
    if not any(map(len, commands)):
        return None
    mean = float(np.concatenate(commands).mean())
    lags = np.arange(1, round(LARGEST_DEAD_TIME_S / _SAMPLE_S) + 1)
    plain = np.array([_correlate(commands, 0.0, lag) for lag in lags.tolist()])
    centred = np.array([_correlate(commands, mean, lag) for lag in lags.tolist()])
    has_dipped = np.maximum.accumulate(centred < _DIPS)
    # Mean values of opposite sign go the other way.
    for alike, sign in ((-plain, -1), (np.where(has_dipped, centred, 0.0), 1)):
        if alike.max() >= _ALIKE:
            begin = int(np.argmax(alike >= _ALIKE))
            length = int(np.argmin(np.append(alike[begin:], -1.0) >= _ALIKE))
            best = begin + int(np.argmax(alike[begin : begin + length]))
            return float(lags[best]) * _SAMPLE_S, sign
    return None


def _sample(motion: AxisMotion) -> Values:
    """Return held commands at equal times, from the first nonzero one to the end of the last."""
    time_s, value = motion.commands.time_s, motion.commands.value
    moving = np.flatnonzero(value)
    ends_s = np.append(time_s[1:], motion.time_s[-1])
    begin_s, end_s = float(time_s[moving[0]]), float(ends_s[moving[-1]])
    at_s = np.arange(begin_s, min(end_s, begin_s + _MOST_S), _SAMPLE_S)
    return np.asarray(value[np.searchsorted(time_s, at_s, side="right") - 1])


def _correlate(commands: Sequence[Values], mean: float, lag: int) -> float:
    pairs = [(one[lag:] - mean, one[:-lag] - mean) for one in commands if len(one) > lag]
    along = sum(float(one @ other) for one, other in pairs)
    sizes = [sum(float(pair[row] @ pair[row]) for pair in pairs) for row in (0, 1)]
    size = float(np.sqrt(sizes[0] * sizes[1]))
    return along / size if size > 0.0 else 0.0
