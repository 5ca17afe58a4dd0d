"""What a plant says of itself: its poses, and what it applied in each tick."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.angles import subtract_headings
from turtlelog.errors import ReplayError
from turtlelog.plants.turtlesim import TICK_NS
from turtlelog.run import Run

_NEAR_TICK_NS: Final = 2_000_000
"""How far the usual time between the poses of a real turtlesim may be from a tick [ns]."""


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
            f" found none: {run.source}"
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
