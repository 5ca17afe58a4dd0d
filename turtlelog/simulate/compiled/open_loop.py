"""Commands over time; as `laws.open_loop`."""

import math
from typing import Any

from turtlelog.simulate.compiled.functions import call, inline
from turtlelog.simulate.compiled.law_fields import IMPULSE, RAMP, SEQUENCE, STEP
from turtlelog.simulate.compiled.memory import END_OF_SIGNAL


@call
def decide_open_loop(
    settings: Any, state: Any, memory: Any, sample: Any, time_ns: int
) -> tuple[int, float, float]:
    """Enter what the law decides; return 0, for it never blocks, speed and turn rate."""
    if state.phase < 0:
        state.phase, state.first_ns = 0, time_ns
    since_ns = time_ns - state.first_ns
    sample.bearing_rad = sample.heading_error_rad = sample.distance_m = math.nan
    sample.error_x_m = sample.error_y_m = math.nan
    sample.world_v_x_m_s = sample.world_v_y_m_s = math.nan
    sample.phase, speed, turn_rate = settings.excite_phase, 0.0, 0.0
    if settings.signal == SEQUENCE:
        return _send_row(settings, state, memory, sample, since_ns)  # type: ignore[no-any-return]
    since_ns -= settings.signal_start_ns
    if since_ns < 0:
        sample.phase = 0
    elif since_ns >= settings.signal_duration_ns:
        state.stop_reason = END_OF_SIGNAL
    else:
        if settings.moves_speed:
            speed = _compute_value(settings, memory, since_ns, settings.signal_shift)
        if settings.moves_turn:
            turn_rate = _compute_value(settings, memory, since_ns, 0)
    return 0, speed, turn_rate


@inline
def _send_row(
    settings: Any, state: Any, memory: Any, sample: Any, since_ns: int
) -> tuple[int, float, float]:
    """Return what `decide_open_loop` does, of the last row that has begun."""
    low, high = 0, settings.signal_rows
    while low < high:
        middle = (low + high) // 2
        if since_ns < memory.signal[middle, 0]:
            high = middle
        else:
            low = middle + 1
    if low == 0:
        sample.phase = 0
        return 0, 0.0, 0.0
    if low == settings.signal_rows:
        state.stop_reason = END_OF_SIGNAL
    return 0, memory.signal[low - 1, 1], memory.signal[low - 1, 2]


@inline
def _compute_value(settings: Any, memory: Any, since_ns: int, shift: int) -> float:
    """Return the signal at a time since its start."""
    amplitude = settings.signal_amplitude
    if settings.signal == IMPULSE:
        return settings.signal_height if since_ns < settings.signal_width_ns else 0.0
    if settings.signal == RAMP:
        return amplitude * (since_ns / 1e9)  # type: ignore[no-any-return]
    if settings.signal == STEP:
        return amplitude  # type: ignore[no-any-return]
    bit = (since_ns // settings.signal_bit_ns - shift) % settings.signal_rows
    return amplitude if memory.signal[bit, 0] != 0.0 else -amplitude  # type: ignore[no-any-return]
