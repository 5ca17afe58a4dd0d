"""What a plant recorded tick by tick, where that breaks off, and which command each tick took.

A recording tells when a command was published, not when it was taken: queues and transport lie
between. The applied velocity of each pose tells it. What is integrated is the COMMAND, in double
precision; the recorded velocity, which is rounded to 32 bits and has no sign, only where no
recorded command explains it.
"""

import re
from array import array
from collections.abc import Iterable
from dataclasses import dataclass
from math import hypot
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.angles import subtract_headings
from turtlelog.errors import ReplayError
from turtlelog.plants.turtlesim import SPAWN_XY_M, TICK_NS, TICK_S, WORLD_SIZE_M
from turtlelog.run import CommandColumns, Run

_NEAR_TICK_NS: Final = 2_000_000
"""How far the usual time between the poses of a real turtlesim may be from a tick [ns]."""


_OBEYS: Final = 0.5
"""Share of the moving steps that must be turtlesim's for a bag to be of it: of one that is, all
are but where it was set elsewhere, ran into a wall or lost poses; of another robot's, next to none.
"""

_FEWEST_MOVING: Final = 10
"""Steps in motion from which this can be told: fewer may all be at a wall."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedMotion:
    """Poses, one per tick, and the steps that lead to them; row i of a step ends at pose i + 1.

    Attributes:
        time_ns: Of each pose [ns], shape (n,).
        xy_m: World frame [m], shape (n, 2).
        heading_rad: Shape (n,).
        speed_m_s: Magnitude of what the tick applied [m/s], shape (n,).
        turn_rate_rad_s: What the tick applied [rad/s], shape (n,).
        step_ns: Time between poses [ns], shape (n - 1,).
        step_xy_m: How far the pose moved [m], shape (n - 1, 2).
        step_rad: How far it turned, the shorter way [rad], shape (n - 1,).
        is_simulated: Whether time stamps are exact multiples of a tick; a wall clock jitters.
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
    """Return whether poses with applied velocities come and go on as turtlesim's do.

    Another robot may publish the same type: at another rate, or with velocities that do not lead
    from one pose to the next. A run that names its scenario is taken at its word.
    """
    try:
        motion = read_motion(run)
    except ReplayError:
        return False
    if run.parameters:
        return True
    turned, gone = TICK_S * motion.turn_rate_rad_s[1:], TICK_S * np.abs(motion.speed_m_s[1:])
    moves = (np.abs(turned) > _SLACK) | (gone > _SLACK)
    off_rad = np.abs(subtract_headings(motion.step_rad, turned))
    off_m = np.abs(np.hypot(*motion.step_xy_m.T) - gone)
    obeys = (off_rad <= _SLACK) & (off_m <= _SLACK)
    count = int(np.count_nonzero(moves))
    return count < _FEWEST_MOVING or bool(np.count_nonzero(obeys & moves) >= _OBEYS * count)


_OTHERS: Final = "of another robot's, turtlelog explain and turtlelog metrics say what can be told"
"""What the replay of a robot's own recording is refused with."""


def advise_other_mode(run: Run) -> str:
    """Return what can be asked of a run that holds neither ticks nor samples."""
    if run.poses.speed_m_s is None:
        return _OTHERS
    return "--plant drives recorded commands through the plant"


def read_motion(run: Run) -> RecordedMotion:
    """Return the motion in a run of turtlesim's.

    Raises:
        ReplayError: Where it lacks the applied velocities, or its poses are no ticks.
    """
    poses = run.poses
    speed, turn_rate = poses.speed_m_s, poses.turn_rate_rad_s
    if speed is None or turn_rate is None:
        raise ReplayError(
            f"{run.name}: expected poses with the applied velocities, as turtlesim publishes them,"
            f" found none: {run.source}; {_OTHERS}"
        )
    step_ns = np.diff(poses.time_ns)
    usual_ns = float(np.median(step_ns)) if len(step_ns) else TICK_NS
    if abs(usual_ns - TICK_NS) > _NEAR_TICK_NS:
        raise ReplayError(
            f"{run.name}: expected a pose per tick of {TICK_NS / 1e6:g} ms,"
            f" found one per {usual_ns / 1e6:.3g} ms: {run.source}"
        )
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


_SLACK: Final = 1e-5
"""What the 32-bit rounding of two poses cannot explain [m, rad]."""

_STALL_TICKS: Final = 10
"""A real turtlesim under load misses its timer for up to six ticks without losing a pose. While
it stands, longer silence counts as a gap; while it moves, the motion tells how many are missing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Jump:
    """A step that the applied velocity does not explain: somebody set the turtle elsewhere.

    Attributes:
        at_ns: Time of the first pose after it [ns].
        kind: `spawn` where it stands at the spawn pose afterwards (reset, kill and spawn), or
            `teleport`.
        from_pose: x, y [m], heading [rad] before.
        to_pose: The same after.
    """

    at_ns: int
    kind: str
    from_pose: tuple[float, float, float]
    to_pose: tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Gap:
    """A stretch of time whose poses are missing: after start_ns, before end_ns.

    Attributes:
        start_ns: Time of the last pose before it [ns].
        end_ns: Time of the first pose after it [ns].
        missing_ticks: How many, by the time stamps.
    """

    start_ns: int
    end_ns: int
    missing_ticks: int


def find_breaks(motion: RecordedMotion) -> tuple[tuple[Jump, ...], tuple[Gap, ...], list[int]]:
    """Return jumps, gaps, and the rows at which the motion starts again."""
    if not len(motion.step_ns):
        return (), (), []
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
    if motion.is_simulated:
        is_gap = ticks > 1
    else:
        tells_nothing = is_jump | ((moved == 0.0) & (turned == 0.0))
        is_gap = np.where(tells_nothing, ticks > _STALL_TICKS, is_beyond_tick)
    jumps = tuple(_build_jump(motion, int(row) + 1) for row in np.flatnonzero(is_jump))
    gaps = tuple(
        Gap(
            start_ns=int(motion.time_ns[row]),
            end_ns=int(motion.time_ns[row + 1]),
            missing_ticks=max(int(ticks[row]) - 1, 1),
        )
        for row in np.flatnonzero(is_gap)
    )
    return jumps, gaps, (np.flatnonzero(is_jump | is_gap) + 1).tolist()


def _build_jump(motion: RecordedMotion, row: int) -> Jump:
    after = _get_pose(motion, row)
    return Jump(
        at_ns=int(motion.time_ns[row]),
        kind="spawn" if after == (SPAWN_XY_M, SPAWN_XY_M, 0.0) else "teleport",
        from_pose=_get_pose(motion, row - 1),
        to_pose=after,
    )


def _get_pose(motion: RecordedMotion, row: int) -> tuple[float, float, float]:
    x_m, y_m = motion.xy_m[row].tolist()
    return x_m, y_m, float(motion.heading_rad[row])


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
        disturbed_ticks: Those of them in which the recording's scenario pushes the plant: its
            velocity is no command's there, and shows none.
        never_arrived: Commands that the transport lost, by the recording's events.
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
    """Return what the plant held in the tick of each pose, and what became of the commands.

    At the rows `starts` the step from the pose before tells nothing.
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
    """Return what the plant held in each tick, and whether it is a recorded velocity."""
    bodies = _compute_body_velocities(motion, starts)
    rows = zip(
        motion.time_ns.tolist(),
        _round(motion.speed_m_s),
        _round(motion.turn_rate_rad_s),
        bodies,
        strict=True,
    )
    velocities, is_unexplained = [], []
    for number, row in enumerate(rows):
        velocities.append(placer.place(number, *row))
        is_unexplained.append(placer.is_recorded)
    return velocities, is_unexplained


def follow_commands(run: Run) -> NDArray[np.int64]:
    """Return which pose first shows which command: rows of both, shape (n, 2).

    Of the commands that were taken those that changed what the plant held: no pose tells when one
    was taken that equals the one before. Nor does a pose behind a jump or gap.

    Raises:
        ReplayError: As `read_motion` does.
    """
    motion = read_motion(run)
    _, _, starts = find_breaks(motion)
    placer = _Placer(motion, run.commands)
    _place_all(placer, motion, frozenset(starts))
    shown = np.array(placer.shown, dtype=np.int64).reshape(-1, 2)
    return shown[~np.isin(shown[:, 1], starts)]


def _find_disturbed(run: Run, time_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return the ticks in which the scenario of a recording pushes the plant."""
    sizes = [run.parameters.get(f"disturbance.{name}", 0.0) for name in _PUSHES]
    if not any(sizes):
        return np.zeros(len(time_ns), dtype=bool)
    # It acts from the first tick at its start on, and no longer in that at its end.
    from_s, to_s = (
        float(run.parameters.get(f"disturbance.{name}", default))  # type: ignore[arg-type]
        for name, default in (("from_s", 0.0), ("to_s", np.inf))
    )
    return np.asarray((time_ns >= round(from_s * 1e9)) & (time_ns < np.rint(to_s * 1e9)))


_PUSHES: Final = ("speed_m_s", "turn_rate_rad_s", "noise_speed", "noise_turn_rate")

_LOST: Final = re.compile(r"The transport lost (\d+) ")


def _count_lost(run: Run) -> int:
    """Return how many commands never arrived, as the events tell."""
    texts = (event.text for event in run.events if event.kind == "commands_lost")
    return sum(int(found[1]) for found in map(_LOST.match, texts) if found)


class _Placer:
    """Walks over ticks and commands together.

    Attributes:
        is_recorded: Whether what the plant holds is a recorded velocity, and no command.
        taken: As in `CommandUse`, so far.
        stops: Likewise.
        shown: Rows of the commands that changed what the plant held, and of the poses that show it.
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
        """Return what the tick applied that published this pose."""
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
