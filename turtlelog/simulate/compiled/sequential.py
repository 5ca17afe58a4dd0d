"""The sequential laws; as `laws.sequential_p` and `laws.sequential_pid`."""

import math
from typing import Any

from turtlelog.simulate.compiled.functions import (
    call,
    clip,
    find_direction,
    find_hypot,
    inline,
    least,
    wrap_angle,
)
from turtlelog.simulate.compiled.memory import (
    OF_LAW,
    REORIENT,
    ROTATE,
    SETTLED,
    SPEED,
    STANDSTILL,
    TIMEOUT,
    TRANSLATE,
    TURN,
    WITHIN_TOLERANCE,
)


@inline
def decide_sequential(
    settings: Any,
    state: Any,
    memory: Any,
    sample: Any,
    time_ns: int,
    pose: tuple[float, float, float],
) -> tuple[int, float, float]:
    """Enter what the law decides; return for how many ticks it blocks, speed and turn rate."""
    x_m, y_m, heading_rad = pose
    error_x_m, error_y_m = settings.goal_x_m - x_m, settings.goal_y_m - y_m
    sample.error_x_m, sample.error_y_m = error_x_m, error_y_m
    sample.integral_angular = sample.derivative_angular = 0.0
    sample.integral_linear = sample.derivative_linear = 0.0
    phase, blocks, speed, turn_rate = state.phase, 0, 0.0, 0.0
    if settings.finds_distance:
        sample.distance_m = find_hypot(error_x_m, error_y_m)
    if settings.schedule_entries > 0 and phase >= 0:
        _follow_schedule(settings, state, memory, sample.distance_m, heading_rad)
    axis = memory.axes[TURN]
    if phase == TRANSLATE:
        speed = _translate(settings, state, memory, sample, time_ns, heading_rad)
        world_x, world_y = state.world_v_x_m_s, state.world_v_y_m_s
    else:
        world_x = world_y = 0.0
        if phase < 0:
            state.bearing_rad = math.atan2(error_y_m, error_x_m)
            state.phase, state.first_ns = ROTATE, time_ns
        elif phase == ROTATE:
            turn_rate = _rotate(settings, state, sample, axis, time_ns, heading_rad)
            blocks = settings.law_pause_ticks if state.phase == TRANSLATE else 0
        else:
            turn_rate = _reorient(settings, state, sample, axis, time_ns, heading_rad)
        phase = max(phase, ROTATE)
    sample.phase = phase
    sample.bearing_rad, sample.heading_error_rad = state.bearing_rad, state.heading_error_rad
    sample.world_v_x_m_s, sample.world_v_y_m_s = world_x, world_y
    if not _is_finite(sample):
        state.has_failed = 1
    return blocks, speed, turn_rate


@inline
def _is_finite(sample: Any) -> bool:
    """Whether all numbers that the law has entered are finite."""
    total = sample.bearing_rad + sample.heading_error_rad + sample.error_x_m + sample.error_y_m
    total += sample.world_v_x_m_s + sample.world_v_y_m_s
    total += sample.integral_angular + sample.derivative_angular
    return math.isfinite(total + (sample.integral_linear + sample.derivative_linear))


@call
def _follow_schedule(
    settings: Any, state: Any, memory: Any, distance_m: float, heading_rad: float
) -> None:
    """Take the gains of a distance, or of the error of the heading loop that acts or acted last."""
    place = distance_m
    if not settings.has_distances:
        wanted_rad = settings.goal_heading_rad if state.phase == REORIENT else state.bearing_rad
        place = wanted_rad - heading_rad
        if settings.law_wrap_error:
            place = wrap_angle(place)
        place = abs(place)
    table, speed, turn = memory.schedule, memory.axes[SPEED], memory.axes[TURN]
    after, end = 0, settings.schedule_entries
    while after < end:
        middle = (after + end) // 2
        if place < table[middle, 0]:
            end = middle
        else:
            after = middle + 1
    last = settings.schedule_entries - 1
    speed.kp = _find_gain(table, 1, place, after, last, speed.kp)
    turn.kp = _find_gain(table, 2, place, after, last, turn.kp)
    speed.ki = _find_gain(table, 3, place, after, last, speed.ki)
    turn.ki = _find_gain(table, 4, place, after, last, turn.ki)
    speed.kd = _find_gain(table, 5, place, after, last, speed.kd)
    turn.kd = _find_gain(table, 6, place, after, last, turn.kd)


@inline
def _find_gain(
    table: Any, column: int, place: float, after: int, last: int, constant: float
) -> float:
    """Return a gain at a place; `after` is the first entry beyond it."""
    if math.isnan(table[0, column]):
        return constant
    if after == 0 or after > last:
        return table[min(after, last), column]  # type: ignore[no-any-return]
    before = after - 1
    share = (place - table[before, 0]) / (table[after, 0] - table[before, 0])
    return table[before, column] + share * (table[after, column] - table[before, column])  # type: ignore[no-any-return]


@inline
def _rotate(
    settings: Any, state: Any, sample: Any, axis: Any, time_ns: int, heading_rad: float
) -> float:
    """Return the turn rate; the phase is the next one where the rotation ends."""
    error_rad = state.bearing_rad - heading_rad
    if settings.law_wrap_error:
        error_rad = wrap_angle(error_rad)
    state.heading_error_rad = error_rad
    if abs(error_rad) > settings.law_heading_tolerance_rad:
        return _turn(settings, state, sample, axis, time_ns, heading_rad)  # type: ignore[no-any-return]
    state.phase = TRANSLATE
    return 0.0


@inline
def _reorient(
    settings: Any, state: Any, sample: Any, axis: Any, time_ns: int, heading_rad: float
) -> float:
    error_rad = settings.goal_heading_rad - heading_rad
    if settings.law_wrap_error:
        error_rad = wrap_angle(error_rad)
    state.heading_error_rad = error_rad
    if abs(error_rad) <= settings.law_heading_tolerance_rad:
        state.stop_reason = WITHIN_TOLERANCE
        return 0.0
    if time_ns - state.first_ns > settings.law_timeout_s * 1e9:
        state.stop_reason = TIMEOUT
    return _turn(settings, state, sample, axis, time_ns, heading_rad)  # type: ignore[no-any-return]


@inline
def _turn(
    settings: Any, state: Any, sample: Any, axis: Any, time_ns: int, heading_rad: float
) -> float:
    """Return the turn rate of a heading error, with integral and derivative where there are."""
    error_rad = state.heading_error_rad
    turn_rate = axis.kp * error_rad
    if not axis.has_terms:
        return turn_rate  # type: ignore[no-any-return]
    turned_rad = wrap_angle(heading_rad - state.heading_before_rad)
    state.heading_before_rad = heading_rad
    _advance_terms(settings, state, axis, time_ns, turned_rad)
    sample.integral_angular, sample.derivative_angular = axis.integral, axis.derivative
    return _add_terms(settings, axis, turn_rate, error_rad)  # type: ignore[no-any-return]


@inline
def _translate(
    settings: Any, state: Any, memory: Any, sample: Any, time_ns: int, heading_rad: float
) -> float:
    """Return the speed; the stop reason where the translation ends, or the next phase."""
    x_m, y_m = sample.error_x_m, sample.error_y_m
    tolerance_m = settings.law_position_tolerance_m
    axis = memory.axes[SPEED]
    stop_reason, speed = WITHIN_TOLERANCE, 0.0
    if abs(x_m) > tolerance_m or abs(y_m) > tolerance_m:
        kp = axis.kp
        state.world_v_x_m_s, state.world_v_y_m_s = kp * x_m, kp * y_m
        along_rad = heading_rad if settings.law_projection else state.bearing_rad
        cos, sin = find_direction(memory.directions[OF_LAW], along_rad)
        speed = state.world_v_x_m_s * cos + state.world_v_y_m_s * sin
        if axis.has_terms:
            way_m = (state.error_before_x_m - x_m) * cos + (state.error_before_y_m - y_m) * sin
            state.error_before_x_m, state.error_before_y_m = x_m, y_m
            _advance_terms(settings, state, axis, time_ns, way_m)
            sample.integral_linear, sample.derivative_linear = axis.integral, axis.derivative
            speed = _add_terms(settings, axis, speed, x_m * cos + y_m * sin)
        stop_reason = _find_stop_reason(settings, state, time_ns, speed, max(abs(x_m), abs(y_m)))
    if stop_reason in (0, TIMEOUT) or not settings.law_reorient:
        state.stop_reason = stop_reason
    else:
        state.phase = REORIENT
    return speed


@inline
def _find_stop_reason(settings: Any, state: Any, time_ns: int, speed: float, error_m: float) -> int:
    still = abs(speed) < settings.law_standstill_below
    state.still_samples = state.still_samples + 1 if still else 0
    if state.still_samples > settings.law_standstill_samples:
        return STANDSTILL
    if error_m >= settings.law_settled_within_m:
        state.close_since_ns = -1
    elif state.close_since_ns < 0:
        state.close_since_ns = time_ns
    elif time_ns - state.close_since_ns > settings.law_settled_for_s * 1e9:
        return SETTLED
    return TIMEOUT if time_ns - state.first_ns > settings.law_timeout_s * 1e9 else 0


@inline
def _advance_terms(settings: Any, state: Any, axis: Any, time_ns: int, moved: float) -> None:
    """Begin integral and derivative with a phase, or go on to a sample."""
    if state.begun != state.phase:
        state.begun = state.phase
        axis.integral = axis.derivative = axis.error_rate = axis.excess = 0.0
        axis.last_ns = time_ns
        return
    step_s = (time_ns - axis.last_ns) / 1e9
    axis.last_ns = time_ns
    if step_s <= 0.0:
        return
    back = least(step_s / settings.law_tracking_time_s, 1.0)
    axis.integral += step_s * axis.error_rate - back * axis.excess
    filter_s = settings.law_derivative_filter_s
    axis.derivative = (filter_s * axis.derivative - axis.kd * moved) / (filter_s + step_s)


@inline
def _add_terms(settings: Any, axis: Any, proportional: float, error: float) -> float:
    """Return the command, and keep how the integral goes on from here."""
    command = proportional + axis.integral + axis.derivative
    if not axis.has_integral:
        return command  # type: ignore[no-any-return]
    excess = command - clip(command, axis.limit)
    error_rate = axis.ki * error
    if settings.law_anti_windup == 1 and excess * error_rate > 0.0:
        error_rate = 0.0
    axis.error_rate = error_rate
    axis.excess = excess if settings.law_anti_windup == 2 else 0.0
    return command  # type: ignore[no-any-return]
