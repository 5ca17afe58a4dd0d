"""The tick-by-tick motion in a recording, and the places where the motion is interrupted."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import ReplayError
from turtlelog.plants.turtlesim import SPAWN_XY_M, TICK_NS, TICK_S
from turtlelog.run import Run
from turtlelog.run.angles import subtract_headings

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

    Attributes:
        time_ns: Time of each pose [ns], shape (n,).
        xy_m: Position in the world frame [m], shape (n, 2).
        heading_rad: Heading [rad], shape (n,).
        speed_m_s: Magnitude of the velocity applied in the tick [m/s], shape (n,).
        turn_rate_rad_s: Turn rate applied in the tick [rad/s], shape (n,).
        step_ns: Time between poses [ns], shape (n - 1,).
        step_xy_m: Displacement in each step [m], shape (n - 1, 2).
        step_rad: Turn in each step, the shorter way [rad], shape (n - 1,).
        is_simulated: Whether time stamps are exact multiples of a tick; stamps of a wall clock have
            jitter.
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

    Another robot may publish the same message type at another rate, or with velocities that do not
    lead from one pose to the next. If a run names its scenario, the scenario decides.
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


_OTHERS: Final = "for another robot use turtlelog metrics and turtlelog identify"
"""Reasons why the replay of a robot's own recording is refused."""


def advise_other_mode(run: Run) -> str:
    """Return advice for a run that contains neither ticks nor samples."""
    if run.poses.speed_m_s is None:
        return _OTHERS
    return "--plant drives recorded commands through the plant"


def read_motion(run: Run) -> RecordedMotion:
    """Return the motion in a run of turtlesim.

    Raises:
        ReplayError: If the run has no applied velocities, or its poses are not ticks.
    """
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
    """A segment of time whose poses are missing: after start_ns, before end_ns.

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
