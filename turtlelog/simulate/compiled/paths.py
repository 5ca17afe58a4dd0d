"""Points of a path; as `path_pieces` and `paths`.

A piece is given by its row and by the arc length at which it starts, which grows by the length of a
closed path with every lap.
"""

import math
from typing import Any

import numpy as np

from turtlelog.path_pieces import ROUNDING_M
from turtlelog.simulate.compiled.functions import call, find_hypot, inline, least, most, wrap_angle

Point = tuple[float, float, float, float]
"""x [m], y [m], heading [rad], curvature [1/m]."""


@call
def _locate_on(piece: Any, way_m: float) -> Point:
    heading, curvature = piece.heading_rad, piece.curvature_1_m
    if curvature == 0.0:
        x_m = piece.x_m + way_m * math.cos(heading)
        return x_m, piece.y_m + way_m * math.sin(heading), wrap_angle(heading), 0.0
    end = heading + curvature * way_m
    x_m = piece.x_m + (math.sin(end) - math.sin(heading)) / curvature
    y_m = piece.y_m - (math.cos(end) - math.cos(heading)) / curvature
    return x_m, y_m, wrap_angle(end), curvature


@inline
def _find_center(piece: Any) -> tuple[float, float]:
    x_m = piece.x_m - math.sin(piece.heading_rad) / piece.curvature_1_m
    return x_m, piece.y_m + math.cos(piece.heading_rad) / piece.curvature_1_m


@inline
def _turn_to(piece: Any, x_m: float, y_m: float) -> float:
    center_x_m, center_y_m = _find_center(piece)
    away = math.atan2(y_m - center_y_m, x_m - center_x_m)
    side = math.copysign(math.pi / 2.0, piece.curvature_1_m)
    return away + side - piece.heading_rad  # type: ignore[no-any-return]


@call
def _find_nearest_on(piece: Any, x_m: float, y_m: float, low_m: float, high_m: float) -> float:
    """Return the way to the point between two ways that is nearest to a position."""
    curvature = piece.curvature_1_m
    if curvature == 0.0:
        cos, sin = math.cos(piece.heading_rad), math.sin(piece.heading_rad)
        way_m = (x_m - piece.x_m) * cos + (y_m - piece.y_m) * sin
    else:
        middle_m = (low_m + high_m) / 2.0
        turn_m = 2.0 * math.pi / abs(curvature)
        way_m = _turn_to(piece, x_m, y_m) / curvature
        way_m += turn_m * (np.rint((middle_m - way_m) / turn_m) + 0.0)
    return least(most(way_m, low_m), high_m)  # type: ignore[no-any-return]


@call
def _find_exit_of_arc(piece: Any, x_m: float, y_m: float, radius_m: float, low_m: float) -> float:
    """Return the first way from `low_m` on at which the circle of an arc leaves another."""
    curvature = piece.curvature_1_m
    arc_radius_m = 1.0 / abs(curvature)
    center_x_m, center_y_m = _find_center(piece)
    center_away_m = find_hypot(x_m - center_x_m, y_m - center_y_m)
    if center_away_m == 0.0:
        return math.inf
    squares = arc_radius_m * arc_radius_m + center_away_m * center_away_m
    cosine = (squares - radius_m * radius_m) / (2.0 * arc_radius_m * center_away_m)
    if not -1.0 <= cosine <= 1.0:
        return math.inf
    turned = _turn_to(piece, x_m, y_m) + math.copysign(math.acos(cosine), curvature)
    way_m = turned / curvature
    turn_m = 2.0 * math.pi * arc_radius_m
    turns = np.ceil((low_m - ROUNDING_M - way_m) / turn_m) + 0.0
    return way_m + turn_m * turns  # type: ignore[no-any-return]


@call
def _find_exit(piece: Any, x_m: float, y_m: float, radius_m: float, low_m: float) -> float:
    """Return the first way from `low_m` on at which a piece leaves a circle, NaN without one."""
    curvature = piece.curvature_1_m
    if curvature == 0.0:
        cos, sin = math.cos(piece.heading_rad), math.sin(piece.heading_rad)
        ahead_m, left_m = x_m - piece.x_m, y_m - piece.y_m
        way_m = ahead_m * cos + left_m * sin
        aside_m = left_m * cos - ahead_m * sin
        square = radius_m * radius_m - aside_m * aside_m
        if square < 0.0:
            return math.nan
        way_m += math.sqrt(square)
    else:
        way_m = _find_exit_of_arc(piece, x_m, y_m, radius_m, low_m)
    if not low_m - ROUNDING_M <= way_m <= piece.length_m + ROUNDING_M:
        return math.nan
    return least(most(way_m, low_m), piece.length_m)  # type: ignore[no-any-return]


@call
def _find_piece(settings: Any, memory: Any, arc_m: float) -> int:
    """Return the last piece that starts at an arc length or before it."""
    low, high = 0, settings.path_pieces
    while low < high:
        middle = (low + high) // 2
        if arc_m < memory.pieces[middle].start_m:
            high = middle
        else:
            low = middle + 1
    return max(low - 1, 0)


@inline
def find_on_first_lap(settings: Any, arc_m: float) -> float:
    """Return the arc length of the same point on the first lap of a closed path."""
    length_m = settings.path_length_m
    if not settings.path_is_closed or 0.0 <= arc_m < length_m:
        return arc_m
    arc_m = np.fmod(arc_m, length_m)
    arc_m += length_m if arc_m < 0.0 else 0.0
    return 0.0 if arc_m > length_m - ROUNDING_M else arc_m


@call
def locate(settings: Any, memory: Any, arc_m: float) -> Point:
    """Return the point at an arc length, also beyond the ends."""
    length_m, count = settings.path_length_m, settings.path_pieces
    if arc_m == length_m:
        last = memory.pieces[count - 1]
        return _locate_on(last, last.length_m)  # type: ignore[no-any-return]
    if not 0.0 <= arc_m < length_m:
        if not settings.path_is_closed:
            tangent = memory.pieces[count + 1 if arc_m < 0.0 else count]
            beyond = memory.pieces[0 if arc_m < 0.0 else count - 1]
            end_m = 0.0 if arc_m < 0.0 else beyond.length_m
            return _locate_on(tangent, arc_m - beyond.start_m - end_m)  # type: ignore[no-any-return]
        arc_m = find_on_first_lap(settings, arc_m)
    piece = memory.pieces[_find_piece(settings, memory, arc_m + ROUNDING_M)]
    return _locate_on(piece, arc_m - piece.start_m)  # type: ignore[no-any-return]


@call
def _find_side(
    settings: Any, memory: Any, x_m: float, y_m: float, way_m: float, number: int
) -> float:
    """Return a number that is positive where a position is on the left of the path."""
    piece, count = memory.pieces[number], settings.path_pieces
    point = _locate_on(piece, way_m)
    cos, sin = math.cos(point[2]), math.sin(point[2])
    if way_m in (0.0, piece.length_m):
        is_end = way_m > 0.0
        other = number + (1 if is_end else -1)
        if not settings.path_is_closed and not 0 <= other < count:
            beyond = _locate_on(piece, piece.length_m if is_end else 0.0)
        else:
            next_to = memory.pieces[other % count]
            beyond = _locate_on(next_to, 0.0 if is_end else next_to.length_m)
        cos, sin = cos + math.cos(beyond[2]), sin + math.sin(beyond[2])
    return cos * (y_m - point[1]) - sin * (x_m - point[0])  # type: ignore[no-any-return]


@call
def find_nearest(
    settings: Any, memory: Any, position: tuple[float, float], low_m: float, high_m: float
) -> tuple[float, float]:
    """Return where a position is with respect to the stretch between two arc lengths."""
    (x_m, y_m), length_m = position, settings.path_length_m
    if not settings.path_is_closed:
        low_m, high_m = most(low_m, 0.0), least(high_m, length_m)
    best_m, best_way_m, best, best_start_m = np.inf, low_m, 0, memory.pieces[0].start_m
    first, after = 0, settings.path_pieces
    from_lap, to_lap = 0, 0
    is_part = not settings.path_is_closed or 0.0 < low_m <= high_m < length_m
    if is_part:
        first = _find_piece(settings, memory, low_m)
        first -= first > 0 and memory.pieces[first].start_m == low_m
        after = _find_piece(settings, memory, high_m) + 1
    else:
        from_lap, to_lap = math.floor(low_m / length_m), math.floor(high_m / length_m)
    for lap in range(from_lap, to_lap + 1):
        for number in range(first, after):
            piece = memory.pieces[number]
            start_m = piece.start_m + lap * length_m
            if not is_part and not (start_m <= high_m and start_m + piece.length_m >= low_m):
                continue
            begin_m, end_m = most(low_m - start_m, 0.0), least(high_m - start_m, piece.length_m)
            way_m = _find_nearest_on(piece, x_m, y_m, begin_m, end_m)
            point = _locate_on(piece, way_m)
            away_m = find_hypot(x_m - point[0], y_m - point[1])
            if away_m < best_m:
                best_m, best_way_m, best, best_start_m = away_m, way_m, number, start_m
    side = _find_side(settings, memory, x_m, y_m, best_way_m, best)
    return best_start_m + best_way_m, math.copysign(best_m, side)


@call
def find_ahead(
    settings: Any, memory: Any, position: tuple[float, float], lookahead_m: float, from_m: float
) -> Point:
    """Return the first point from an arc length on that is a lookahead away from a position."""
    (x_m, y_m), count = position, settings.path_pieces
    near = locate(settings, memory, from_m)
    if find_hypot(x_m - near[0], y_m - near[1]) >= lookahead_m:
        return near  # type: ignore[no-any-return]
    from_m = find_on_first_lap(settings, from_m)
    first = _find_piece(settings, memory, from_m)
    # Behind the last piece of an open path stands its tangent; of a closed one the first is next.
    after = count + first + 1 if settings.path_is_closed else count + 1
    for place in range(first, after):
        wraps = settings.path_is_closed and place >= count
        piece = memory.pieces[place - count if wraps else place]
        start_m = piece.start_m + settings.path_length_m if wraps else piece.start_m
        way_m = _find_exit(piece, x_m, y_m, lookahead_m, most(from_m - start_m, 0.0))
        if not math.isnan(way_m):
            return _locate_on(piece, way_m)  # type: ignore[no-any-return]
    return locate(settings, memory, from_m + lookahead_m)  # type: ignore[no-any-return]
