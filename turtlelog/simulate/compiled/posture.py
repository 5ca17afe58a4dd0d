"""The posture law; as `laws.posture`."""

import math
from typing import Any

from turtlelog.laws.posture import SERIES_BELOW
from turtlelog.simulate.compiled.functions import call, find_hypot, inline, most, wrap_angle
from turtlelog.simulate.compiled.memory import TIMEOUT, WITHIN_TOLERANCE

_DRIVE, _TURN = 0, 1  # its phases by number


@call
def decide_posture(
    settings: Any, state: Any, sample: Any, time_ns: int, pose: tuple[float, float, float]
) -> tuple[int, float, float]:
    """Enter what the law decides; return 0, for it never blocks, speed and turn rate."""
    x_m, y_m, heading_rad = pose
    error_x_m, error_y_m = settings.goal_x_m - x_m, settings.goal_y_m - y_m
    bearing_rad = math.atan2(error_y_m, error_x_m)
    if state.phase < 0:
        state.phase, state.first_ns = _DRIVE, time_ns
        state.bearing_rad = settings.arrival_rad if settings.has_goal_heading else bearing_rad
    arrival_rad = state.bearing_rad
    rho = find_hypot(error_x_m, error_y_m)
    alpha = wrap_angle(bearing_rad - heading_rad)
    phi = wrap_angle(bearing_rad - arrival_rad)
    turn_rad = wrap_angle(arrival_rad - heading_rad)
    lyapunov = 0.5 * (rho * rho + alpha * alpha + settings.law_h * phi * phi)
    speed = turn_rate = 0.0
    if most(abs(error_x_m), abs(error_y_m)) > settings.law_position_tolerance_m:
        state.phase = _DRIVE
        speed = settings.law_gamma * math.cos(alpha) * rho
        turn_rate = _compute_turn_rate(settings, alpha, phi)
    elif settings.has_goal_heading and abs(turn_rad) > settings.law_heading_tolerance_rad:
        state.phase = _TURN
        turn_rate = _compute_turn_rate(settings, turn_rad, 0.0)
    else:
        state.stop_reason = WITHIN_TOLERANCE
    if state.stop_reason == 0 and time_ns - state.first_ns > settings.law_timeout_s * 1e9:
        state.stop_reason = TIMEOUT
    if not math.isfinite(bearing_rad + alpha + error_x_m + error_y_m + lyapunov):
        state.has_failed = 1
    sample.phase = state.phase
    sample.bearing_rad, sample.heading_error_rad = bearing_rad, alpha
    sample.error_x_m, sample.error_y_m, sample.distance_m = error_x_m, error_y_m, rho
    sample.world_v_x_m_s = sample.world_v_y_m_s = math.nan
    sample.lyapunov = lyapunov
    return 0, speed, turn_rate


@inline
def _compute_turn_rate(settings: Any, alpha: float, phi: float) -> float:
    sine_ratio = 1.0 - alpha * alpha / 6.0
    if abs(alpha) >= SERIES_BELOW:
        sine_ratio = math.sin(alpha) / alpha
    swing = settings.law_gamma * math.cos(alpha) * sine_ratio
    return settings.law_k * alpha + swing * (alpha + settings.law_h * phi)  # type: ignore[no-any-return]
