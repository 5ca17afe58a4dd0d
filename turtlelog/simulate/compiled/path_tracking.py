"""Laws that track a path; as `laws.path_tracking`, `laws.kanayama` and `laws.pure_pursuit`."""

import math
from typing import Any

from turtlelog.paths import REACH_M
from turtlelog.simulate.compiled.functions import call, inline, least, wrap_angle
from turtlelog.simulate.compiled.law_fields import KANAYAMA
from turtlelog.simulate.compiled.memory import PATH_END
from turtlelog.simulate.compiled.paths import (
    find_ahead,
    find_nearest,
    find_on_first_lap,
    locate,
)

_TRACK = 0  # its phase by number


@call
def decide_tracking(
    settings: Any,
    state: Any,
    memory: Any,
    sample: Any,
    time_ns: int,
    pose: tuple[float, float, float],
) -> tuple[int, float, float]:
    """Enter what the law decides; return 0, for it never blocks, speed and turn rate."""
    x_m, y_m, heading_rad = pose
    if state.phase < 0:
        state.phase, state.first_ns = _TRACK, time_ns
        state.arc_m = state.begin_m = math.nan
    if settings.path_has_speed:
        speed_m_s = settings.path_speed_m_s
        target_m, nearest_m, is_over = _find_due(settings, state, memory, (x_m, y_m), time_ns)
        behind_m = target_m - nearest_m
    else:
        speed_m_s = settings.law_speed_m_s
        nearest_m, is_over = _find_nearest(settings, state, memory, (x_m, y_m))
        behind_m = 0.0
        target_m = nearest_m if is_over else find_on_first_lap(settings, nearest_m)
    point = locate(settings, memory, target_m)
    speed = turn_rate = 0.0
    if is_over:
        state.stop_reason = PATH_END
    elif settings.law == KANAYAMA:
        speed, turn_rate = _steer_to_point(settings, pose, point, speed_m_s)
    else:
        ahead = find_ahead(settings, memory, (x_m, y_m), settings.law_lookahead_m, nearest_m)
        speed = speed_m_s + settings.law_kp_along * behind_m
        turn_rate = _steer_ahead(pose, ahead, speed)
    if not math.isfinite(point[0] + point[1] + point[2]):
        state.has_failed = 1
    sample.phase = _TRACK
    sample.heading_error_rad = wrap_angle(point[2] - heading_rad)
    sample.bearing_rad = sample.error_x_m = sample.error_y_m = sample.distance_m = math.nan
    sample.world_v_x_m_s = sample.world_v_y_m_s = math.nan
    sample.reference_x_m, sample.reference_y_m, sample.reference_heading_rad = point[:3]
    return 0, speed, turn_rate


@inline
def _find_due(
    settings: Any, state: Any, memory: Any, position: tuple[float, float], time_ns: int
) -> tuple[float, float, bool]:
    """Return the arc lengths of the point that is due and of the nearest [m], and if it is over."""
    since_s = (time_ns - state.first_ns) / 1e9
    due_m = least(settings.path_speed_m_s * since_s, settings.path_length_m)
    nearest_m = _follow(settings, state, memory, position, due_m)
    return due_m, nearest_m, due_m >= settings.path_length_m


@inline
def _find_nearest(
    settings: Any, state: Any, memory: Any, position: tuple[float, float]
) -> tuple[float, bool]:
    """Return the arc length of the nearest point [m] of a path without a speed, and if it is over.

    A closed path is over after a whole lap.
    """
    nearest_m = _follow(settings, state, memory, position, 0.0)
    if math.isnan(state.begin_m) and not math.isnan(state.arc_m):
        state.begin_m = nearest_m if settings.path_is_closed else 0.0
    begin_m = 0.0 if math.isnan(state.begin_m) else state.begin_m
    end_m = begin_m + settings.path_length_m - settings.law_end_tolerance_m
    return nearest_m, not math.isnan(state.begin_m) and nearest_m >= end_m


@inline
def _follow(
    settings: Any, state: Any, memory: Any, position: tuple[float, float], due_m: float
) -> float:
    """Return the arc length of the point that is nearest to a robot [m]; as a `PathFollower`.

    `due_m` is how far the reference is by time [m]; 0 on a path without a speed.
    """
    if math.isnan(state.arc_m):
        joins_anywhere = settings.path_is_closed and not settings.path_has_speed
        last_m = settings.path_length_m if joins_anywhere else due_m
        arc_m, offset_m = find_nearest(settings, memory, position, 0.0, last_m)
        if not (joins_anywhere or abs(offset_m) <= REACH_M):
            return arc_m  # type: ignore[no-any-return]
        state.arc_m = arc_m
    low_m, high_m = state.arc_m - settings.path_reach_m, state.arc_m + settings.path_reach_m
    state.arc_m, _ = find_nearest(settings, memory, position, low_m, high_m)
    return state.arc_m  # type: ignore[no-any-return]


@inline
def _steer_to_point(
    settings: Any,
    pose: tuple[float, float, float],
    point: tuple[float, float, float, float],
    speed_m_s: float,
) -> tuple[float, float]:
    """Return speed and turn rate by Kanayama's law."""
    x_m, y_m = point[0] - pose[0], point[1] - pose[1]
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    ahead_m, left_m = x_m * cos + y_m * sin, y_m * cos - x_m * sin
    error_rad = wrap_angle(point[2] - pose[2])
    turn_rate = speed_m_s * (
        point[3] + settings.law_ky * left_m + settings.law_ktheta * math.sin(error_rad)
    )
    return speed_m_s * math.cos(error_rad) + settings.law_kx * ahead_m, turn_rate


@inline
def _steer_ahead(
    pose: tuple[float, float, float], ahead: tuple[float, float, float, float], speed: float
) -> float:
    """Return the turn rate of pure pursuit."""
    x_m, y_m = ahead[0] - pose[0], ahead[1] - pose[1]
    left_m = y_m * math.cos(pose[2]) - x_m * math.sin(pose[2])
    square = x_m * x_m + y_m * y_m
    return speed * 2.0 * left_m / square if square != 0.0 else 0.0
