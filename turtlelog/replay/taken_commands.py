"""Assignment of commands to the ticks in which a plant took them.

A recording shows when a command was published, but not when the plant took it, because queues and
transport lie between. The applied velocity in each pose shows which command the plant took. The
replay integrates this COMMAND, in double precision. If no recorded command explains the velocity of
a pose, the replay integrates the recorded velocity. This velocity is rounded to 32 bits and has no
sign.
"""

import re
from array import array
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import hypot
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.plants.turtlesim import TICK_NS, TICK_S, WORLD_SIZE_M
from turtlelog.replay.plant_ticks import RecordedMotion, find_breaks, read_motion
from turtlelog.run import CommandColumns, Run
from turtlelog.run.loops import PUSH_KEYS, read_number

Velocity = tuple[float, float, float]
"""Forward [m/s], left [m/s], counter-clockwise [rad/s]."""

_Row = tuple[int, float, float, tuple[float, float] | None]

_ROWS: Final = 4096
"""Number of poses converted to Python numbers at once; Python numbers take five times their
bytes."""

_STANDING: Final[Velocity] = (0.0, 0.0, 0.0)

_DIRECTION: Final = 2e-4
"""Accuracy of a velocity read from a step between two 32-bit poses [m/s], with a margin. Each pose
is off by at most 4.8e-7 m, which is 3e-5 m/s in 16 ms on either axis."""

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
    stops: int
    unexplained_ticks: int
    disturbed_ticks: int = 0
    never_arrived: int = 0


def place_commands(
    motion: RecordedMotion, run: Run, starts: frozenset[int]
) -> tuple[tuple[Velocity, ...], CommandUse]:
    """Return the velocity of the plant in the tick of each pose, and the use of the commands.

    At the rows `starts`, the step from the previous pose shows no velocity.
    """
    commands = run.commands
    placer = _Placer(motion, commands)
    velocities, is_unexplained = _place_all(placer, motion, starts)
    is_disturbed = _find_disturbed(run, motion.time_ns)
    use = CommandUse(
        taken=placer.taken,
        unseen=len(commands) - placer.taken,
        stops=placer.stops,
        unexplained_ticks=sum(is_unexplained),
        disturbed_ticks=int((np.array(is_unexplained, dtype=bool) & is_disturbed).sum()),
        never_arrived=_count_lost(run),
    )
    return tuple(velocities), use


def _place_all(
    placer: "_Placer", motion: RecordedMotion, starts: frozenset[int]
) -> tuple[list[Velocity], list[bool]]:
    """Return the velocity of the plant in each tick, and whether it is a recorded velocity."""
    velocities, is_unexplained = [], []
    for number, row in enumerate(_list_rows(motion, starts)):
        velocities.append(placer.place(number, *row))
        is_unexplained.append(placer.is_recorded)
    return velocities, is_unexplained


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
    _place_all(placer, motion, frozenset(starts))
    shown = np.array(placer.shown, dtype=np.int64).reshape(-1, 2)
    return shown[~np.isin(shown[:, 1], starts)]


def _find_disturbed(run: Run, time_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return the ticks in which the scenario of a recording disturbs the plant."""
    if not any(read_number(run.parameters, key) for key in PUSH_KEYS):
        return np.zeros(len(time_ns), dtype=bool)
    # It acts from the first tick at its start on, and no longer in that at its end.
    from_s = read_number(run.parameters, "disturbance.from_s")
    to_s = read_number(run.parameters, "disturbance.to_s", np.inf)
    return np.asarray((time_ns >= round(from_s * 1e9)) & (time_ns < np.rint(to_s * 1e9)))


_LOST: Final = re.compile(r"The transport lost (\d+) ")


def _count_lost(run: Run) -> int:
    """Return the number of commands that never arrived, from the events."""
    texts = (event.text for event in run.events if event.kind == "commands_lost")
    return sum(int(found[1]) for found in map(_LOST.match, texts) if found)


class _Placer:
    """Search for the taken command, tick by tick.

    Attributes:
        is_recorded: Whether the plant's velocity is a recorded velocity instead of a command.
        taken: Number of commands taken so far.
        stops: Number of stops so far.
        shown: Rows of the commands that changed the plant's velocity, and of the poses that show
            the change.
    """

    def __init__(self, motion: RecordedMotion, commands: CommandColumns) -> None:
        columns = (commands.speed_m_s, commands.lateral_speed_m_s, commands.turn_rate_rad_s)
        self._commands: list[Velocity] = [
            *zip(*(column.tolist() for column in columns), strict=True)
        ]
        self._applied = [
            *zip(
                _round(hypot(forward, left) for forward, left, _ in self._commands),
                _round(commands.turn_rate_rad_s),
                strict=True,
            )
        ]
        self._times_ns = commands.time_ns.tolist()
        self._late_ns = 0 if motion.is_simulated else _LATE_NS
        self._next = 0
        self._published = 0
        self._held = _STANDING
        self._held_applied = (0.0, 0.0)
        self.is_recorded = False
        self.taken = self.stops = 0
        self.shown: list[tuple[int, int]] = []

    def place(
        self,
        row: int,
        time_ns: int,
        speed: float,
        turn_rate: float,
        body: tuple[float, float] | None,
    ) -> Velocity:
        """Return the velocity applied in the tick that published this pose."""
        while self._published < len(self._times_ns) and self._times_ns[self._published] < time_ns:
            self._published += 1
        applied = speed, turn_rate
        found = self._find(applied, body, time_ns)
        if found is not None:
            self._next = found + 1
            self.taken += 1
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

    def _find(
        self, applied: tuple[float, float], body: tuple[float, float] | None, time_ns: int
    ) -> int | None:
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

    def _fits(
        self, number: int, applied: tuple[float, float], body: tuple[float, float] | None
    ) -> bool:
        return self._applied[number] == applied and _agrees(self._commands[number], body)


def _compute_body_velocities(
    motion: RecordedMotion, starts: frozenset[int], rows: slice
) -> list[tuple[float, float] | None]:
    """Return the velocity along and left of the heading that the step to each pose shows [m/s].

    The result is None in the first row, after a break, at a wall, and if nothing moved.
    """
    first = max(rows.start, 1)
    heading_rad, xy_m = motion.heading_rad[first : rows.stop], motion.xy_m[first : rows.stop]
    cosine, sine = np.cos(heading_rad), np.sin(heading_rad)
    dx, dy = motion.step_xy_m[first - 1 : rows.stop - 1].T / TICK_S
    forward, left = cosine * dx + sine * dy, cosine * dy - sine * dx
    shown = np.hypot(dx, dy) > _DIRECTION
    shown &= ((xy_m > 0.0) & (xy_m < WORLD_SIZE_M)).all(axis=1)
    bodies: list[tuple[float, float] | None] = [None] * (first - rows.start)
    for row, (along, across, is_shown) in enumerate(
        zip(forward.tolist(), left.tolist(), shown.tolist(), strict=True), start=first
    ):
        bodies.append((along, across) if is_shown and row not in starts else None)
    return bodies


def _agrees(velocity: Velocity, body: tuple[float, float] | None) -> bool:
    return body is None or hypot(velocity[0] - body[0], velocity[1] - body[1]) < _DIRECTION


def _direct(speed: float, body: tuple[float, float] | None) -> tuple[float, float]:
    """Return a speed along the direction of the step; forward if the direction is unknown."""
    if body is None or (body[0] > 0.0 and abs(body[1]) < _DIRECTION):
        return speed, 0.0
    if abs(body[1]) < _DIRECTION:
        return -speed, 0.0
    scale = speed / hypot(*body)
    return body[0] * scale, body[1] * scale


def _round(values: Iterable[float]) -> list[float]:
    return array("f", values).tolist()
