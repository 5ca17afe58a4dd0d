"""A sample of each answer, shaped and limited; as `simulate.law_driver` and `simulate.shaping`."""

import math
from typing import Any

from turtlelog.simulate.compiled.functions import clip, inline, least, most, round_to_step
from turtlelog.simulate.compiled.memory import SPEED, TURN
from turtlelog.simulate.law_driver import LARGEST_FLOAT


@inline
def answer_pose(
    settings: Any, state: Any, memory: Any, time_ns: int, pose: int, decide: Any
) -> int:
    """Make the sample of a pose; return for how many ticks the law blocks."""
    sample, read = memory.samples[state.samples], memory.ticks[pose]
    state.samples += 1
    x_m, y_m, heading_rad = read.x_m, read.y_m, read.heading_rad
    if settings.has_sensor:
        x_m, y_m, heading_rad = read.sensed_x_m, read.sensed_y_m, read.sensed_heading_rad
    found = decide(settings, state, memory, sample, time_ns, (x_m, y_m, heading_rad))
    blocks, speed, turn_rate = found
    if not (abs(speed) < LARGEST_FLOAT and abs(turn_rate) < LARGEST_FLOAT):
        state.has_failed = 1
    sample.time_ns, sample.pose_sequence = time_ns, pose
    sample.published_ns = time_ns + blocks * settings.tick_ns
    sample.wanted_speed, sample.wanted_turn_rate = speed, turn_rate
    dt_s = settings.first_s if state.last_ns < 0 else (time_ns - state.last_ns) / 1e9
    state.last_ns = time_ns
    sample.shaped_speed, sample.speed = _limit(settings, memory.axes[SPEED], speed, dt_s)
    sample.shaped_turn_rate, sample.turn_rate = _limit(settings, memory.axes[TURN], turn_rate, dt_s)
    return blocks  # type: ignore[no-any-return]


@inline
def _limit(settings: Any, axis: Any, wanted: float, dt_s: float) -> tuple[float, float]:
    """Return a command after shaping, and after the limits."""
    if settings.low_pass_s:
        axis.low_pass -= math.expm1(-dt_s / settings.low_pass_s) * (wanted - axis.low_pass)
        wanted = axis.low_pass
    wanted = 0.0 if abs(wanted) < axis.dead_zone else round_to_step(wanted, axis.quantum)
    clipped = clip(wanted, axis.limit)
    if math.isfinite(axis.jerk):
        return wanted, _follow_with_jerk(axis, clipped, dt_s)
    if not math.isfinite(axis.acceleration):
        return wanted, clipped
    step = axis.acceleration * dt_s
    if abs(clipped - axis.value) <= step:
        axis.value = clipped
    else:
        axis.value += math.copysign(step, clipped - axis.value)
    return wanted, axis.value


@inline
def _follow_with_jerk(axis: Any, wanted: float, dt_s: float) -> float:
    if dt_s <= 0.0 or (axis.value == wanted and axis.rate == 0.0):
        return axis.value  # type: ignore[no-any-return]
    jerk = axis.jerk
    rest = axis.value + axis.rate * abs(axis.rate) / (2.0 * jerk)
    side = math.copysign(1.0, wanted - rest)
    way, now = side * (wanted - axis.value), side * axis.rate
    top = least(math.sqrt(most(jerk * way + 0.5 * now * now, 0.0)), axis.acceleration)
    top = most(top, now)
    held_s = 0.0
    if top > 0.0:
        held_s = most(way - (2.0 * top * top - now * now) / (2.0 * jerk), 0.0) / top
    left_s = dt_s
    for part in range(3):
        part_jerk = side * jerk if part == 0 else 0.0 if part == 1 else -side * jerk
        duration_s = (top - now) / jerk if part == 0 else held_s if part == 1 else top / jerk
        part_s = least(duration_s, left_s)
        axis.value += (axis.rate + 0.5 * part_jerk * part_s) * part_s
        axis.rate += part_jerk * part_s
        left_s -= part_s
        if left_s <= 0.0:
            break
    else:
        axis.value, axis.rate = wanted, 0.0
    axis.value = clip(axis.value, axis.limit)
    return axis.value  # type: ignore[no-any-return]
