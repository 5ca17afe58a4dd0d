"""In which tick the plant took which command.

A recording tells when a command was published, not when it was taken: queues and transport lie
between. The applied velocity of each pose tells it. What is integrated is the COMMAND, in double
precision; the recorded velocity, which is rounded to 32 bits and has no sign, only where no
recorded command explains it.
"""

from array import array
from collections.abc import Iterable
from dataclasses import dataclass
from math import hypot
from typing import Final

import numpy as np

from turtlelog.plants.turtlesim import TICK_NS, TICK_S, WORLD_SIZE_M
from turtlelog.replay.discontinuities import RecordedMotion
from turtlelog.run import CommandColumns

Velocity = tuple[float, float, float]
"""Forward [m/s], left [m/s], counter-clockwise [rad/s]."""

_STANDING: Final[Velocity] = (0.0, 0.0, 0.0)

_DIRECTION: Final = 2e-4
"""How exactly a step between two 32-bit poses tells its velocity [m/s]: each is off by 4.8e-7 m at
most, in 16 ms 3e-5 m/s, on either axis; several times that."""

_LATE_NS: Final = 2 * TICK_NS
"""A recorder may stamp a command this much later than the pose that shows it [ns]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandUse:
    """What became of the recorded commands.

    Attributes:
        taken: How many the plant took.
        unseen: How many no pose shows: dropped by a queue, or published too late.
        stops: How often the plant stopped by itself, no command having come for a second.
        unexplained_ticks: Ticks whose velocity no recorded command explains; the recorded velocity
            was integrated.
    """

    taken: int
    unseen: int
    stops: int
    unexplained_ticks: int


def place_commands(
    motion: RecordedMotion, commands: CommandColumns, starts: frozenset[int]
) -> tuple[tuple[Velocity, ...], CommandUse]:
    """Return what the plant held in the tick of each pose, and what became of the commands.

    At the rows `starts` the step from the pose before tells nothing.
    """
    placer = _Placer(motion, commands)
    bodies = _compute_body_velocities(motion, starts)
    rows = zip(
        motion.time_ns.tolist(),
        _round(motion.speed_m_s),
        _round(motion.turn_rate_rad_s),
        bodies,
        strict=True,
    )
    velocities = tuple(placer.place(*row) for row in rows)
    use = CommandUse(
        taken=placer.taken,
        unseen=len(commands) - placer.taken,
        stops=placer.stops,
        unexplained_ticks=placer.unexplained_ticks,
    )
    return velocities, use


class _Placer:
    """Walks over ticks and commands together."""

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
        self._is_recorded = False
        self.taken = self.stops = self.unexplained_ticks = 0

    def place(
        self, time_ns: int, speed: float, turn_rate: float, body: tuple[float, float] | None
    ) -> Velocity:
        """Return what the tick applied that published this pose."""
        while self._published < len(self._times_ns) and self._times_ns[self._published] < time_ns:
            self._published += 1
        applied = speed, turn_rate
        found = self._find(applied, body, time_ns)
        if found is not None:
            self._next = found + 1
            self.taken += 1
            self._hold(self._commands[found], applied)
        elif not (applied == self._held_applied and _agrees(self._held, body)):
            if applied == (0.0, 0.0):
                self.stops += 1
                self._hold(_STANDING, applied)
            else:
                self._hold((*_direct(speed, body), turn_rate), applied)
                self._is_recorded = True
        self.unexplained_ticks += self._is_recorded
        return self._held

    def _hold(self, velocity: Velocity, applied: tuple[float, float]) -> None:
        self._held, self._held_applied, self._is_recorded = velocity, applied, False

    def _find(
        self, applied: tuple[float, float], body: tuple[float, float] | None, time_ns: int
    ) -> int | None:
        """Return the command that was taken: at most one per tick, in order, some dropped."""
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
    motion: RecordedMotion, starts: frozenset[int]
) -> list[tuple[float, float] | None]:
    """Return the velocity along and left of the heading that the step to each pose shows [m/s].

    None where it shows none: in the first row, after a break, at a wall, and where nothing moved.
    """
    cosine, sine = np.cos(motion.heading_rad[1:]), np.sin(motion.heading_rad[1:])
    dx, dy = motion.step_xy_m.T / TICK_S
    forward, left = cosine * dx + sine * dy, cosine * dy - sine * dx
    shown = np.hypot(dx, dy) > _DIRECTION
    shown &= ((motion.xy_m[1:] > 0.0) & (motion.xy_m[1:] < WORLD_SIZE_M)).all(axis=1)
    bodies: list[tuple[float, float] | None] = [None]
    for row, (along, across, is_shown) in enumerate(
        zip(forward.tolist(), left.tolist(), shown.tolist(), strict=True), start=1
    ):
        bodies.append((along, across) if is_shown and row not in starts else None)
    return bodies


def _agrees(velocity: Velocity, body: tuple[float, float] | None) -> bool:
    return body is None or hypot(velocity[0] - body[0], velocity[1] - body[1]) < _DIRECTION


def _direct(speed: float, body: tuple[float, float] | None) -> tuple[float, float]:
    """Return a speed along the direction of the step: forwards where that is not known."""
    if body is None or (body[0] > 0.0 and abs(body[1]) < _DIRECTION):
        return speed, 0.0
    if abs(body[1]) < _DIRECTION:
        return -speed, 0.0
    scale = speed / hypot(*body)
    return body[0] * scale, body[1] * scale


def _round(values: Iterable[float]) -> list[float]:
    return array("f", values).tolist()
