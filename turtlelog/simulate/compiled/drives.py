"""What moves a plant, and what it publishes; as `simulate.drives` and `simulate.closed_loop`."""

import math
from typing import Any

from turtlelog.simulate.compiled.functions import inline, round_to_float32


@inline
def publish_pose(
    settings: Any,
    state: Any,
    memory: Any,
    tick: int,
    pose: tuple[float, float, float],
    rates: tuple[float, float],
) -> None:
    """Enter pose and rates of a tick as a message holds them."""
    x_m, y_m, heading_rad = pose
    if not settings.is_exact:
        x_m, y_m = round_to_float32(x_m), round_to_float32(y_m)
        heading_rad = round_to_float32(heading_rad)
    row = memory.ticks[tick]
    row.x_m, row.y_m, row.heading_rad = x_m, y_m, heading_rad
    speed, turn_rate = round_to_float32(rates[0]), round_to_float32(rates[1])
    row.applied_speed, row.applied_turn_rate = speed, turn_rate
    if math.isinf(speed) or math.isinf(turn_rate):
        state.has_failed = 1


@inline
def find_push(settings: Any, memory: Any, tick: int, time_ns: int) -> tuple[float, float]:
    """Return what a disturbance adds to speed [m/s] and turn rate [rad/s] in the step to a tick.

    Nothing where a time of the step [ns] is outside the interval of the disturbance.
    """
    if not settings.push_from_ns <= time_ns < settings.push_to_ns:
        return 0.0, 0.0
    speed, turn_rate = settings.disturbance_speed_m_s, settings.disturbance_turn_rate_rad_s
    if settings.push_scale or settings.turn_push_scale:
        speed += settings.push_scale * memory.ticks[tick].push
        turn_rate += settings.turn_push_scale * memory.ticks[tick].turn_push
    return speed, turn_rate
