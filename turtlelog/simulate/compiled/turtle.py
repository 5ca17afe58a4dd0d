"""A turtle, pushed or not; as `plants.turtlesim` and its drives in `simulate.drives`."""

from typing import Any

import numpy as np

from turtlelog.plants.turtlesim import _PI, _TWO_PI, WORLD_SIZE_M
from turtlelog.simulate.compiled.commands import take
from turtlelog.simulate.compiled.drives import find_push, publish_pose
from turtlelog.simulate.compiled.functions import find_direction, inline, least, most
from turtlelog.simulate.compiled.memory import OF_TURTLE


@inline
def step_turtle(settings: Any, state: Any, memory: Any, tick: int) -> None:
    """Move the turtle for one step: watchdog, push, turn, move along the new heading, clamp."""
    sample = take(settings, state, memory, tick)
    if sample >= 0:
        state.speed_m_s, state.turn_rate_rad_s = (
            memory.samples[sample].speed,
            memory.samples[sample].turn_rate,
        )
        state.idle_ns = 0
    else:
        state.idle_ns += settings.period_ns
    if state.idle_ns > settings.watchdog_ns:
        state.speed_m_s = state.turn_rate_rad_s = 0.0
    forward, turn_rate = state.speed_m_s, state.turn_rate_rad_s
    if settings.is_pushed:
        push, turn_push = find_push(settings, memory, tick, tick * settings.period_ns)
        forward, turn_rate = forward + push, turn_rate + turn_push
    period_s = settings.period_s
    left = 0.0  # The lateral speed of every law; its products decide the sign of a 0.
    heading_rad = state.heading_rad + turn_rate * period_s
    heading_rad -= _TWO_PI * np.floor((heading_rad + _PI) / _TWO_PI)
    cosine, sine = find_direction(memory.directions[OF_TURTLE], heading_rad)
    x_m = state.x_m + (cosine * forward * period_s - sine * left * period_s)
    down_m = state.down_m - (cosine * left * period_s + sine * forward * period_s)
    state.hit_wall = not (0.0 <= x_m <= WORLD_SIZE_M and 0.0 <= down_m <= WORLD_SIZE_M)
    if state.hit_wall:
        x_m = least(most(x_m, 0.0), WORLD_SIZE_M)
        down_m = least(most(down_m, 0.0), WORLD_SIZE_M)
    state.x_m, state.down_m, state.heading_rad = x_m, down_m, heading_rad
    rates = abs(forward), turn_rate
    publish_pose(settings, state, memory, tick, (x_m, WORLD_SIZE_M - down_m, heading_rad), rates)
