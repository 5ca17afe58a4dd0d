"""Where a recorded motion is interrupted: jumps of the pose, and gaps without poses."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from turtlelog.plants.turtlesim import SPAWN_XY_M, TICK_NS, TICK_S
from turtlelog.replay.recorded import RecordedMotion

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
