"""What the controller reads of the plant's poses; as `simulate.sensing`."""

import math
from typing import Any

import numpy as np

from turtlelog.simulate.compiled.commands import count_lost, end_stretch
from turtlelog.simulate.compiled.functions import (
    inline,
    round_to_float32,
    round_to_step,
    wrap_angle,
)
from turtlelog.simulate.compiled.memory import POSES_LOST


@inline
def sense(settings: Any, memory: Any, tick: int) -> bool:
    """Sense the pose of a tick; return whether it arrives at all."""
    sensed = memory.ticks[tick]
    if settings.sensing_dropout_probability and (
        memory.ticks[tick].dropout < settings.sensing_dropout_probability
    ):
        count_lost(memory.losses[POSES_LOST], tick * settings.period_ns)
        sensed.sensed_x_m = sensed.sensed_y_m = sensed.sensed_heading_rad = np.nan
        return False
    end_stretch(memory.losses[POSES_LOST])
    x_m = memory.ticks[tick].x_m + settings.sensing_bias_position_m
    y_m = memory.ticks[tick].y_m + settings.sensing_bias_position_m
    heading_rad = memory.ticks[tick].heading_rad + settings.sensing_bias_heading_rad
    noise_m, noise_rad = settings.sensing_noise_position_m, settings.sensing_noise_heading_rad
    if noise_m or noise_rad:
        x_m += noise_m * memory.ticks[tick].noise_x
        y_m += noise_m * memory.ticks[tick].noise_y
        heading_rad += noise_rad * memory.ticks[tick].noise_heading
    probability = settings.sensing_outlier_probability
    if probability and memory.ticks[tick].outlier_chance < probability:
        direction, side = memory.ticks[tick].outlier_direction, memory.ticks[tick].outlier_side
        x_m += settings.sensing_outlier_m * math.cos(2.0 * math.pi * direction)
        y_m += settings.sensing_outlier_m * math.sin(2.0 * math.pi * direction)
        far_rad = settings.sensing_outlier_rad
        heading_rad += far_rad if side < 0.5 else -far_rad
    x_m = round_to_step(x_m, settings.sensing_quantum_position_m)
    y_m = round_to_step(y_m, settings.sensing_quantum_position_m)
    heading_rad = round_to_step(heading_rad, settings.sensing_quantum_heading_rad)
    if heading_rad != memory.ticks[tick].heading_rad:
        heading_rad = wrap_angle(heading_rad)
    if not settings.is_exact:
        x_m, y_m = round_to_float32(x_m), round_to_float32(y_m)
        heading_rad = round_to_float32(heading_rad)
    sensed.sensed_x_m, sensed.sensed_y_m, sensed.sensed_heading_rad = x_m, y_m, heading_rad
    return True
