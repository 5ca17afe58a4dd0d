"""Motion in a recording of turtlesim: its jumps and gaps, and the command taken in each tick.

A recording shows when a command was published, not when the plant took it. The applied velocity in
each pose shows which command the plant took, and the replay integrates this command in double
precision. If no command explains the velocity of a pose, the replay integrates the recorded
velocity, which is rounded to 32 bits and has no sign.
"""

import re
from array import array
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import hypot
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import ReplayError
from turtlelog.plants import TURTLESIM, find_plant
from turtlelog.plants.turtlesim import SPAWN_XY_M, TICK_NS, TICK_S, WORLD_SIZE_M
from turtlelog.replay.differences import has_all_commands, has_ticks
from turtlelog.run import CommandColumns, Run
from turtlelog.run.angles import subtract_headings
from turtlelog.run.loops import find_disturbance

_NEAR_TICK_NS: Final = 2_000_000
"""Largest difference between a tick and the usual time between poses of a real turtlesim [ns]."""

_OBEYS: Final = 0.5
"""Smallest share of moving steps that must fit turtlesim for a bag to count as turtlesim's. In a
bag of turtlesim, all steps fit except at teleports, walls and lost poses; in a bag of another
robot, hardly any."""

_FEWEST_MOVING: Final = 10
"""Smallest number of moving steps for this decision: fewer steps may all be at a wall."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedMotion:
    """Poses, one per tick, and the steps between them; step i ends at pose i + 1.

    The rates are those applied in the tick before the pose. A turn is the shorter way. Time stamps
    are exact multiples of a tick (`is_simulated`), or those of a wall clock, which have jitter.
    """

    time_ns: NDArray[np.int64]
    xy_m: NDArray[np.float64]
    heading_rad: NDArray[np.float64]
    speed_m_s: NDArray[np.float64]
    turn_rate_rad_s: NDArray[np.float64]
    step_ns: NDArray[np.int64]
    step_xy_m: NDArray[np.float64]
    step_rad: NDArray[np.float64]
    is_simulated: bool


def moves_as_turtlesim(run: Run) -> bool:
    """Return whether poses with applied velocities move like turtlesim's, at turtlesim's rate.

    Another robot may publish the same message type. If a run names its scenario, the plant decides.
    """
    try:
        motion = read_motion(run)
    except ReplayError:
        return False
    if run.parameters:
        return find_plant(run) == TURTLESIM
    turned, gone = TICK_S * motion.turn_rate_rad_s[1:], TICK_S * np.abs(motion.speed_m_s[1:])
    moves = (np.abs(turned) > _SLACK) | (gone > _SLACK)
    off_rad = np.abs(subtract_headings(motion.step_rad, turned))
    off_m = np.abs(np.hypot(*motion.step_xy_m.T) - gone)
    obeys = (off_rad <= _SLACK) & (off_m <= _SLACK)
    count = int(np.count_nonzero(moves))
    return count < _FEWEST_MOVING or bool(np.count_nonzero(obeys & moves) >= _OBEYS * count)


_OTHERS: Final = "for another robot use turtlelog metrics and turtlelog identify"


def advise_other_mode(run: Run) -> str:
    """Return advice for a run that contains neither ticks nor samples."""
    own = "--plant drives recorded commands through the plant"
    return _OTHERS if run.poses.speed_m_s is None else own


def read_motion(run: Run) -> RecordedMotion:
    """Return the motion in a run of turtlesim, or raise ReplayError if its poses are not ticks."""
    poses = run.poses
    speed, turn_rate = poses.speed_m_s, poses.turn_rate_rad_s
    if speed is None or turn_rate is None:
        raise ReplayError(
            f"{run.name}: no poses with the applied velocities, which turtlesim publishes"
            f" ({run.source}); {_OTHERS}"
        )
    step_ns = np.diff(poses.time_ns)
    usual_ns = float(np.median(step_ns)) if len(step_ns) else TICK_NS
    if abs(usual_ns - TICK_NS) > _NEAR_TICK_NS:
        found = f"found one per {usual_ns / 1e6:.3g} ms: {run.source}"
        raise ReplayError(f"{run.name}: expected a pose per tick of {TICK_NS / 1e6:g} ms, {found}")
    return RecordedMotion(
        time_ns=poses.time_ns,
        xy_m=poses.xy_m,
        heading_rad=poses.heading_rad,
        speed_m_s=speed,
        turn_rate_rad_s=turn_rate,
        step_ns=step_ns,
        step_xy_m=np.diff(poses.xy_m, axis=0),
        step_rad=np.asarray(subtract_headings(poses.heading_rad[1:], poses.heading_rad[:-1])),
        is_simulated=not (step_ns % TICK_NS).any(),
    )


def require_whole(run: Run) -> None:
    """Require the whole scenario, the commands, and poses at the ticks from the start on."""
    plant = find_plant(run)
    driven = "a robot model" if plant.dynamics == "first-order" else plant.name
    expected = f"to drive {driven} with the recorded commands"
    if not run.scenario_is_complete:
        why = "it tells when each command reaches the robot"
        raise ReplayError(f"{run.name}: expected a whole scenario {expected}, found a part: {why}")
    if not has_ticks(run) or run.poses.time_ns[0] != 0:
        raise ReplayError(
            f"{run.name}: expected a pose per tick of exactly {plant.period_ns / 1e6:g} ms from 0 s"
            f" on {expected}, found the first at {run.poses.time_ns[0] / 1e9:g} s: a robot's rates"
            " before that are not recorded"
        )
    if not len(run.commands) or not has_all_commands(run):
        count = int(run.samples.sequence[-1]) + 1 if len(run.samples) else 0
        found = f"expected a command per sample {expected}, found {len(run.commands)} of {count}"
        raise ReplayError(f"{run.name}: {found if count else f'no commands {expected}'}")


_MOST_S: Final = 3600.0  # longest simulated time [s], as for a replay in closed loop


def require_driveable(run: Run) -> None:
    """Require commands along the heading that do not last too long for a simulation."""
    commands = run.commands
    if not len(commands):
        raise ReplayError(f"{run.name}: no commands to drive a plant with")
    if commands.lateral_speed_m_s.any():
        number = int(np.flatnonzero(commands.lateral_speed_m_s)[0]) + 1
        raise ReplayError(
            f"{run.name}: expected commands along the heading, found one to the side"
            f" (command {number}): a plant that drives sideways is not known"
        )
    length_s = float(commands.time_ns[-1] - commands.time_ns[0]) / 1e9
    if length_s > _MOST_S:
        most = f"expected commands for {_MOST_S:g} s at most"
        raise ReplayError(f"{run.name}: {most}, found {length_s:g} s")


_SLACK: Final = 1e-5
"""Displacement and turn that the 32-bit rounding of two poses cannot explain [m, rad]."""

_STALL_TICKS: Final = 10
"""Largest silence without lost poses [ticks]: a real turtlesim under load misses its timer for up
to six ticks. At standstill, a longer silence counts as a gap; in motion, the motion shows how many
poses are missing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Jump:
    """A step that the applied velocity does not explain, because the turtle was moved elsewhere.

    Attributes:
        at_ns: Time of the first pose after the jump [ns].
        kind: `spawn` if the turtle is at the spawn pose after the jump (reset, kill and spawn), or
            `teleport`.
        from_pose: x, y [m] and heading [rad] before the jump.
        to_pose: x, y [m] and heading [rad] after the jump.
    """

    at_ns: int
    kind: str
    from_pose: tuple[float, float, float]
    to_pose: tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Gap:
    """A segment of time whose poses are missing.

    Attributes:
        start_ns: Time of the last pose before the gap [ns].
        end_ns: Time of the first pose after the gap [ns].
        missing_ticks: Number of missing ticks, computed from the time stamps.
    """

    start_ns: int
    end_ns: int
    missing_ticks: int


def find_breaks(motion: RecordedMotion) -> tuple[tuple[Jump, ...], tuple[Gap, ...], list[int]]:
    """Return jumps, gaps, and the rows at which the motion starts again."""
    ticks = np.maximum(np.rint(motion.step_ns / TICK_NS).astype(np.int64), 1)
    moved = np.hypot(motion.step_xy_m[:, 0], motion.step_xy_m[:, 1])
    turned = np.abs(motion.step_rad)
    # What held between two poses may be what either tells.
    speed = np.maximum(motion.speed_m_s[1:], motion.speed_m_s[:-1])
    turn_rate = np.maximum(*np.abs([motion.turn_rate_rad_s[1:], motion.turn_rate_rad_s[:-1]]))
    is_beyond_tick = (moved > motion.speed_m_s[1:] * TICK_S + _SLACK) | (
        turned > np.abs(motion.turn_rate_rad_s[1:]) * TICK_S + _SLACK
    )
    # A wall clock's jitter may hide one tick more.
    within = ticks if motion.is_simulated else ticks + 1
    is_jump = is_beyond_tick & (
        (moved > speed * within * TICK_S + _SLACK) | (turned > turn_rate * within * TICK_S + _SLACK)
    )
    tells_nothing = is_jump | ((moved == 0.0) & (turned == 0.0))
    is_gap = np.where(tells_nothing, ticks > _STALL_TICKS, is_beyond_tick)
    is_gap = ticks > 1 if motion.is_simulated else is_gap
    jumps = []
    for row in (np.flatnonzero(is_jump) + 1).tolist():
        before, after = _get_pose(motion, row - 1), _get_pose(motion, row)
        kind = "spawn" if after == (SPAWN_XY_M, SPAWN_XY_M, 0.0) else "teleport"
        at_ns = int(motion.time_ns[row])
        jumps.append(Jump(at_ns=at_ns, kind=kind, from_pose=before, to_pose=after))
    gaps = list_gaps(motion.time_ns, ticks, is_gap)
    return tuple(jumps), gaps, (np.flatnonzero(is_jump | is_gap) + 1).tolist()


def list_gaps(
    time_ns: NDArray[np.int64], ticks: NDArray[np.int64], is_gap: NDArray[np.bool_]
) -> tuple[Gap, ...]:
    """Return the steps between poses that are gaps; `ticks` is the number of each step."""
    rows = np.flatnonzero(is_gap)
    found = zip(
        time_ns[rows].tolist(), time_ns[rows + 1].tolist(), ticks[rows].tolist(), strict=True
    )
    return tuple(Gap(start_ns=a, end_ns=b, missing_ticks=max(n - 1, 1)) for a, b, n in found)


def _get_pose(motion: RecordedMotion, row: int) -> tuple[float, float, float]:
    x_m, y_m = motion.xy_m[row].tolist()
    return x_m, y_m, float(motion.heading_rad[row])


Velocity = tuple[float, float, float]
"""Forward [m/s], left [m/s], counter-clockwise [rad/s]."""

_Body = tuple[float, float] | None
"""Velocity along and left of the heading that a step shows [m/s]; None: not shown."""

_Row = tuple[int, float, float, _Body]

_ROWS: Final = 4096
"""Number of poses converted to Python numbers at once; Python numbers take five times their
bytes."""

_STANDING: Final[Velocity] = (0.0, 0.0, 0.0)

_DIRECTION: Final = 2e-4
"""Accuracy of a velocity read from a step between two 32-bit poses [m/s], with a margin. Each pose
is off by at most 4.8e-7 m, which is 3e-5 m/s in 16 ms on either axis."""

UNSIGNED_M_S: Final = 2.0 * _DIRECTION
"""Speed below which a step may not show whether it leads forward [m/s]; twice the accuracy, because
the step itself is off by as much."""

_LATE_NS: Final = 2 * TICK_NS
"""Largest delay of a recorder's stamp of a command after the pose that shows the command [ns]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandUse:
    """Use of the recorded commands by the plant.

    Attributes:
        taken: Number of commands that the plant took.
        unseen: Number of commands that no pose shows, because a queue dropped them or they were
            published too late.
        stops: Number of times that the plant stopped by itself, after a second without commands.
        unexplained_ticks: Number of ticks whose velocity no recorded command explains; the recorded
            velocity was integrated.
        disturbed_ticks: Number of these ticks in which the scenario disturbs the plant, so that the
            velocity shows no command.
        never_arrived: Number of commands that the transport lost, according to the recording's
            events.
    """

    taken: int
    unseen: int
    stops: int = 0
    unexplained_ticks: int = 0
    disturbed_ticks: int = 0
    never_arrived: int = 0


def place_commands(
    motion: RecordedMotion, run: Run, starts: frozenset[int]
) -> tuple[tuple[Velocity, ...], NDArray[np.bool_], CommandUse]:
    """Return the plant's velocity in each pose's tick, whether it is a recorded one, and a summary.

    At the rows `starts`, the step from the previous pose shows no velocity.
    """
    placer = _Placer(motion, run.commands)
    velocities, unexplained = placer.place_all(motion, starts)
    is_unexplained = np.array(unexplained, dtype=bool)
    from_ns, to_ns = find_disturbance(run.parameters) or (0, 0)
    is_disturbed = (motion.time_ns >= from_ns) & (motion.time_ns < to_ns)
    events = (event.text for event in run.events if event.kind == "commands_lost")
    lost = (re.search(r"\d+", text) for text in events)  # the event's text alone has the count
    use = CommandUse(
        taken=placer.taken,
        unseen=len(run.commands) - placer.taken,
        stops=placer.stops,
        unexplained_ticks=int(is_unexplained.sum()),
        disturbed_ticks=int((is_unexplained & is_disturbed).sum()),
        never_arrived=sum(int(found[0]) for found in lost if found),
    )
    return tuple(velocities), is_unexplained, use


def _list_rows(motion: RecordedMotion, starts: frozenset[int]) -> Iterator[_Row]:
    """Yield time, speed, turn rate and body velocity at each pose, with few rows in memory."""
    for first in range(0, len(motion.time_ns), _ROWS):
        rows = slice(first, first + _ROWS)
        yield from zip(
            motion.time_ns[rows].tolist(),
            _round(motion.speed_m_s[rows]),
            _round(motion.turn_rate_rad_s[rows]),
            _compute_body_velocities(motion, starts, rows),
            strict=True,
        )


def follow_commands(run: Run) -> NDArray[np.int64]:
    """Return which pose first shows which command: rows of commands and poses, shape (n, 2).

    The result contains only commands that changed the plant's velocity: no pose shows when an equal
    command was taken. Poses directly after a jump or gap show no command.

    Raises:
        ReplayError: If the run has no applied velocities, or its poses are not ticks.
    """
    motion = read_motion(run)
    _, _, starts = find_breaks(motion)
    placer = _Placer(motion, run.commands)
    placer.place_all(motion, frozenset(starts))
    shown = np.array(placer.shown, dtype=np.int64).reshape(-1, 2)
    return shown[~np.isin(shown[:, 1], starts)]


class _Placer:
    """Search for the taken command, tick by tick.

    `is_recorded`: the present velocity is a recorded one instead of a command. `shown` has the rows
    of commands that changed the plant's velocity, and of the poses that show the change.
    """

    def __init__(self, motion: RecordedMotion, commands: CommandColumns) -> None:
        columns = (commands.speed_m_s, commands.lateral_speed_m_s, commands.turn_rate_rad_s)
        self._commands: list[Velocity] = list(zip(*(one.tolist() for one in columns), strict=True))
        speeds = _round(hypot(forward, left) for forward, left, _ in self._commands)
        self._applied = list(zip(speeds, _round(commands.turn_rate_rad_s), strict=True))
        self._times_ns = commands.time_ns.tolist()
        self._late_ns = 0 if motion.is_simulated else _LATE_NS
        self._next = self._published = self.taken = self.stops = 0
        self._hold(_STANDING, (0.0, 0.0))
        self.shown: list[tuple[int, int]] = []

    def place_all(
        self, motion: RecordedMotion, starts: frozenset[int]
    ) -> tuple[list[Velocity], list[bool]]:
        """Return the velocity of the plant in each tick, and whether it is a recorded velocity."""
        velocities, is_unexplained = [], []
        for number, row in enumerate(_list_rows(motion, starts)):
            velocities.append(self._place(number, *row))
            is_unexplained.append(self.is_recorded)
        return velocities, is_unexplained

    def _place(
        self, row: int, time_ns: int, speed: float, turn_rate: float, body: _Body
    ) -> Velocity:
        """Return the velocity applied in the tick that published this pose."""
        while self._published < len(self._times_ns) and self._times_ns[self._published] < time_ns:
            self._published += 1
        applied = speed, turn_rate
        found = self._find(applied, body, time_ns)
        if found is not None:
            self._next, self.taken = found + 1, self.taken + 1
            if row and applied != self._held_applied:
                self.shown.append((found, row))
            self._hold(self._commands[found], applied)
        elif not (applied == self._held_applied and _agrees(self._held, body)):
            if applied == (0.0, 0.0):
                self.stops += 1
                self._hold(_STANDING, applied)
            else:
                self._hold((*_direct(speed, body), turn_rate), applied)
                self.is_recorded = True
        return self._held

    def _hold(self, velocity: Velocity, applied: tuple[float, float]) -> None:
        self._held, self._held_applied, self.is_recorded = velocity, applied, False

    def _find(self, applied: tuple[float, float], body: _Body, time_ns: int) -> int | None:
        """Return the number of the taken command: at most one per tick, in order, some dropped."""
        if self._next < self._published and self._fits(self._next, applied, body):
            return self._next
        if applied == self._held_applied and _agrees(self._held, body):
            return None
        for number in range(self._next, len(self._commands)):
            if self._times_ns[number] >= time_ns + self._late_ns and number >= self._published:
                return None
            if self._fits(number, applied, body):
                return number
        return None

    def _fits(self, number: int, applied: tuple[float, float], body: _Body) -> bool:
        return self._applied[number] == applied and _agrees(self._commands[number], body)


def _compute_body_velocities(
    motion: RecordedMotion, starts: frozenset[int], rows: slice
) -> list[_Body]:
    """Return what each step shows: nothing at first, after a break, at a wall, or at rest."""
    first = max(rows.start, 1)
    heading_rad, xy_m = motion.heading_rad[first : rows.stop], motion.xy_m[first : rows.stop]
    cosine, sine = np.cos(heading_rad), np.sin(heading_rad)
    dx, dy = motion.step_xy_m[first - 1 : rows.stop - 1].T / TICK_S
    forward, left = cosine * dx + sine * dy, cosine * dy - sine * dx
    shown = np.hypot(dx, dy) > _DIRECTION
    shown &= ((xy_m > 0.0) & (xy_m < WORLD_SIZE_M)).all(axis=1)
    found = zip(forward.tolist(), left.tolist(), shown.tolist(), strict=True)
    bodies: list[_Body] = [None] * (first - rows.start)
    for row, (along, across, is_shown) in enumerate(found, start=first):
        bodies.append((along, across) if is_shown and row not in starts else None)
    return bodies


def _agrees(velocity: Velocity, body: _Body) -> bool:
    return body is None or hypot(velocity[0] - body[0], velocity[1] - body[1]) < _DIRECTION


def _direct(speed: float, body: _Body) -> tuple[float, float]:
    """Return a speed along the direction of the step; forward if the direction is unknown."""
    if body is None or (body[0] > 0.0 and abs(body[1]) < _DIRECTION):
        return speed, 0.0
    if abs(body[1]) < _DIRECTION:
        return -speed, 0.0
    scale = speed / hypot(*body)
    return body[0] * scale, body[1] * scale


def _round(values: Iterable[float]) -> list[float]:
    return array("f", values).tolist()
