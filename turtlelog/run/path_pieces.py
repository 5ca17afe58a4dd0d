"""Pieces of constant curvature that form a path, and the position of a robot on them.

The functions run in ordinary Python and compiled: they read the fields of `PathPiece` and
`PathNumbers`. `pieces` are the pieces of a path in order; for an open path, the tangents at the end
and at the beginning of the path follow. A `way` is a length along a piece, measured from the start
of the piece. On a closed path, the arc length continues to grow with every lap.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final, NamedTuple

from turtlelog.arithmetic import called, ceil, fmod, hypot, least, most, nearest, wrap_angle

ROUNDING_M: Final = 1e-9
"""Rounding error of a way [m]. Where two pieces meet, a circle may seem to lie behind the end of
the first piece and before the start of the second."""

REACH_M: Final = 0.5
"""Distance along the path, either way, within which the next nearest point is searched [m].

The distance is far longer than a robot's motion between two poses. The distance is shorter than a
loop of a path as large as the world. Thus the robot stays on its branch at a crossing."""

Position = tuple[float, float]
Point = tuple[float, float, float, float]
"""x [m], y [m], heading [rad] and curvature [1/m], as in `PathPoint`."""


class PathPoint(NamedTuple):
    """A point of a path.

    Attributes:
        x_m: x in the world frame [m]; likewise `y_m`.
        heading_rad: Direction of the path, counter-clockwise from +x [rad], in [-pi, pi).
        curvature_1_m: Curvature, positive if the path bends to the left [1/m].
    """

    x_m: float
    y_m: float
    heading_rad: float
    curvature_1_m: float


class PathPiece(NamedTuple):
    """A straight piece, or an arc if the curvature is not 0.

    Attributes:
        number: Index of the piece in the path, from 0.
        start_m: Arc length at the start of the piece, from the beginning of the path [m].
        length_m: Length of the piece [m].
        x_m: x at the start of the piece, world frame [m]; likewise `y_m`.
        heading_rad: Direction at the start, counter-clockwise from +x [rad].
        curvature_1_m: Curvature, positive if the piece bends to the left [1/m].
    """

    number: int
    start_m: float
    length_m: float
    x_m: float
    y_m: float
    heading_rad: float
    curvature_1_m: float

    def go_straight(self, way_m: float) -> "PathPiece":
        """Return the tangent at a length along the piece as a straight piece without an end."""
        x_m, y_m, heading_rad, _ = locate_on(self, way_m)
        return PathPiece(self.number, self.start_m + way_m, math.inf, x_m, y_m, heading_rad, 0.0)


@dataclass(slots=True)
class PathNumbers:
    """Numbers that describe a path, apart from its pieces.

    Attributes:
        count: Number of pieces; 0 if there is no path.
        is_closed: Whether the path ends where it begins.
        length_m: Length of the path; of one lap if the path is closed [m].
        reach_m: Largest distance along the path from one nearest point to the next [m].
        has_speed: Whether the reference moves with time.
        speed_m_s: Speed of the reference [m/s].
    """

    count: int = 0
    is_closed: bool = False
    length_m: float = 0.0
    reach_m: float = 0.0
    has_speed: bool = False
    speed_m_s: float = 0.0


def join_points(points: Sequence[tuple[float, float]]) -> Iterator[PathPiece]:
    """Yield the straight pieces from point to point [m]."""
    start_m = 0.0
    for number, ((x_m, y_m), (end_x_m, end_y_m)) in enumerate(pairwise(points)):
        length_m = math.hypot(end_x_m - x_m, end_y_m - y_m)
        heading = math.atan2(end_y_m - y_m, end_x_m - x_m)
        yield PathPiece(number, start_m, length_m, x_m, y_m, heading, 0.0)
        start_m += length_m


@called
def locate_on(piece: Any, way_m: float) -> Point:
    """Return the point at a length along the piece, also beyond its ends."""
    heading, curvature = piece.heading_rad, piece.curvature_1_m
    if curvature == 0.0:
        x_m = piece.x_m + way_m * math.cos(heading)
        return x_m, piece.y_m + way_m * math.sin(heading), wrap_angle(heading), 0.0
    end = heading + curvature * way_m
    x_m = piece.x_m + (math.sin(end) - math.sin(heading)) / curvature
    y_m = piece.y_m - (math.cos(end) - math.cos(heading)) / curvature
    return x_m, y_m, wrap_angle(end), curvature


@called
def find_nearest_on(piece: Any, x_m: float, y_m: float, low_m: float, high_m: float) -> float:
    """Return the length along the piece, within two bounds, that is nearest to a position [m]."""
    curvature = piece.curvature_1_m
    if curvature == 0.0:
        cos, sin = math.cos(piece.heading_rad), math.sin(piece.heading_rad)
        way_m = (x_m - piece.x_m) * cos + (y_m - piece.y_m) * sin
    else:
        middle_m = (low_m + high_m) / 2.0
        # The same direction is met once a turn: that nearest to the middle of the stretch.
        turn_m = 2.0 * math.pi / abs(curvature)
        way_m = _turn_to(piece, x_m, y_m) / curvature
        way_m += turn_m * nearest((middle_m - way_m) / turn_m)
    return least(most(way_m, low_m), high_m)


def _find_center(piece: Any) -> Position:
    x_m = piece.x_m - math.sin(piece.heading_rad) / piece.curvature_1_m
    return x_m, piece.y_m + math.cos(piece.heading_rad) / piece.curvature_1_m


def _turn_to(piece: Any, x_m: float, y_m: float) -> float:
    """Return the turn of an arc from its start to the point nearest to a position [rad]."""
    center_x_m, center_y_m = _find_center(piece)
    away = math.atan2(y_m - center_y_m, x_m - center_x_m)
    turned: float = away + math.copysign(math.pi / 2.0, piece.curvature_1_m) - piece.heading_rad
    return turned


@called
def find_exit(piece: Any, x_m: float, y_m: float, radius_m: float, low_m: float) -> float:
    """Return the first length from `low_m` on at which the piece leaves a circle [m].

    The result is NaN if the piece does not leave the circle. Both ends of the piece are extended by
    `ROUNDING_M`.
    """
    if piece.curvature_1_m == 0.0:
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
    return least(most(way_m, low_m), piece.length_m)


@called
def _find_exit_of_arc(piece: Any, x_m: float, y_m: float, radius_m: float, low_m: float) -> float:
    """Return the first length from `low_m` on at which the circle of an arc leaves another [m]."""
    # The result is infinite if the arc never leaves the other circle.
    curvature = piece.curvature_1_m
    arc_radius_m = 1.0 / abs(curvature)
    center_x_m, center_y_m = _find_center(piece)
    center_away_m = hypot(x_m - center_x_m, y_m - center_y_m)
    if center_away_m == 0.0:
        return math.inf
    squares = arc_radius_m * arc_radius_m + center_away_m * center_away_m
    cosine = (squares - radius_m * radius_m) / (2.0 * arc_radius_m * center_away_m)
    if not -1.0 <= cosine <= 1.0:
        return math.inf
    turned = _turn_to(piece, x_m, y_m) + math.copysign(math.acos(cosine), curvature)
    way_m: float = turned / curvature
    turn_m = 2.0 * math.pi * arc_radius_m
    way_m += turn_m * ceil((low_m - ROUNDING_M - way_m) / turn_m)
    return way_m


@called
def find_piece(path: Any, pieces: Any, arc_m: float) -> int:
    """Return the number of the last piece that starts at or before an arc length."""
    low, high = 0, path.count
    while low < high:
        middle = (low + high) // 2
        if arc_m < pieces[middle].start_m:
            high = middle
        else:
            low = middle + 1
    return max(low - 1, 0)


def find_on_first_lap(path: Any, arc_m: float) -> float:
    """Return the arc length of the same point on the first lap of a closed path [m].

    The end of a lap is the beginning of the next. An open path has one lap, without an end.
    """
    length_m = path.length_m
    if not path.is_closed or 0.0 <= arc_m < length_m:
        return arc_m
    arc_m = fmod(arc_m, length_m)
    arc_m += length_m if arc_m < 0.0 else 0.0
    return 0.0 if arc_m > length_m - ROUNDING_M else arc_m


@called
def locate(path: Any, pieces: Any, arc_m: float) -> Point:
    """Return the point at an arc length [m], as `Path.locate` describes it."""
    length_m, count = path.length_m, path.count
    if arc_m == length_m:  # the end, in the direction in which it is reached
        last = pieces[count - 1]
        return locate_on(last, last.length_m)
    if not 0.0 <= arc_m < length_m:
        if not path.is_closed:
            tangent = pieces[count + 1 if arc_m < 0.0 else count]
            beyond = pieces[0 if arc_m < 0.0 else count - 1]
            end_m = 0.0 if arc_m < 0.0 else beyond.length_m
            return locate_on(tangent, arc_m - beyond.start_m - end_m)
        arc_m = find_on_first_lap(path, arc_m)
    # At a corner the next leg counts, also where a later lap is rounded to just before it.
    piece = pieces[find_piece(path, pieces, arc_m + ROUNDING_M)]
    return locate_on(piece, arc_m - piece.start_m)


@called
def _find_side(path: Any, pieces: Any, position: Position, way_m: float, number: int) -> float:
    """Return a number that is positive if a position is on the left of the path."""
    # `number` is the first piece with the nearest point, `way_m` the length along this piece to the
    # point.
    piece, count = pieces[number], path.count
    point = locate_on(piece, way_m)
    cos, sin = math.cos(point[2]), math.sin(point[2])
    if way_m == 0.0 or way_m == piece.length_m:  # noqa: PLR1714  (a set is no number)
        # At a corner both directions count: outside of it either may point at the position.
        is_end = way_m > 0.0
        other = number + (1 if is_end else -1)
        if not path.is_closed and not 0 <= other < count:
            heading = locate_on(piece, piece.length_m if is_end else 0.0)[2]
        else:
            beside = pieces[other % count]
            heading = locate_on(beside, 0.0 if is_end else beside.length_m)[2]
        cos, sin = cos + math.cos(heading), sin + math.sin(heading)
    side: float = cos * (position[1] - point[1]) - sin * (position[0] - point[0])
    return side


@called
def find_nearest(
    path: Any, pieces: Any, position: Position, low_m: float, high_m: float
) -> tuple[float, float]:
    """Return arc length and offset of a position, as `Path.find_nearest` describes them [m]."""
    x_m, y_m = position
    length_m = path.length_m
    if not path.is_closed:
        low_m, high_m = most(low_m, 0.0), least(high_m, length_m)
    best_m, best_way_m, best, best_start_m = math.inf, low_m, 0, pieces[0].start_m
    first, after, from_lap, to_lap = 0, path.count, 0, 0
    is_part = not path.is_closed or 0.0 < low_m <= high_m < length_m
    if is_part:
        first = find_piece(path, pieces, low_m)
        # A stretch that begins at a corner belongs to the piece before it, too.
        first -= 1 if first > 0 and pieces[first].start_m == low_m else 0
        after = find_piece(path, pieces, high_m) + 1
    else:
        from_lap, to_lap = math.floor(low_m / length_m), math.floor(high_m / length_m)
    for lap in range(from_lap, to_lap + 1):
        for number in range(first, after):
            piece = pieces[number]
            start_m = piece.start_m + lap * length_m
            if not is_part and not (start_m <= high_m and start_m + piece.length_m >= low_m):
                continue
            begin_m, end_m = most(low_m - start_m, 0.0), least(high_m - start_m, piece.length_m)
            way_m = find_nearest_on(piece, x_m, y_m, begin_m, end_m)
            point = locate_on(piece, way_m)
            away_m = hypot(x_m - point[0], y_m - point[1])
            if away_m < best_m:
                best_m, best_way_m, best, best_start_m = away_m, way_m, number, start_m
    side = _find_side(path, pieces, position, best_way_m, best)
    return best_start_m + best_way_m, math.copysign(best_m, side)


@called
def find_ahead(
    path: Any, pieces: Any, position: Position, lookahead_m: float, from_m: float
) -> Point:
    """Return the point that `Path.find_ahead` describes."""
    x_m, y_m = position
    near = locate(path, pieces, from_m)
    if hypot(x_m - near[0], y_m - near[1]) >= lookahead_m:
        return near
    from_m, count = find_on_first_lap(path, from_m), path.count
    first = find_piece(path, pieces, from_m)
    # Behind the last piece of an open path stands its tangent; of a closed one the first is next.
    after = count + first + 1 if path.is_closed else count + 1
    for place in range(first, after):
        wraps = path.is_closed and place >= count
        piece = pieces[place - count if wraps else place]
        start_m = piece.start_m + path.length_m if wraps else piece.start_m
        way_m = find_exit(piece, x_m, y_m, lookahead_m, most(from_m - start_m, 0.0))
        if not math.isnan(way_m):
            return locate_on(piece, way_m)
    return locate(path, pieces, from_m + lookahead_m)


@called
def follow_piece(
    path: Any, pieces: Any, arc_m: float, position: Position, due_m: float
) -> tuple[float, float, float]:
    """Return the place of a robot on a path.

    The robot first has to reach the path: an open path without a speed at its beginning, a path
    with a speed on the segment that the reference has passed, a closed path anywhere. From then on
    the nearest point is searched within `REACH_M` of the previous nearest point, so that a path
    that crosses itself is followed in order.

    Args:
        path: `PathNumbers`.
        pieces: Pieces of the path.
        arc_m: Arc length at the previous position [m]; NaN: not on the path yet.
        position: Position x, y [m].
        due_m: Arc length that the moving reference has reached [m]; NaN: the path has no speed.

    Returns:
        Arc length of the nearest point, its distance as in `find_nearest`, and `arc_m` for the next
        position [m].
    """
    if math.isnan(arc_m):
        joins_anywhere = path.is_closed and math.isnan(due_m)
        last_m = due_m
        if math.isnan(due_m):
            last_m = path.length_m if joins_anywhere else 0.0
        arc_m, offset_m = find_nearest(path, pieces, position, 0.0, last_m)
        if not (joins_anywhere or abs(offset_m) <= REACH_M):
            return arc_m, offset_m, math.nan
    # It may stand ahead of the reference.
    low_m, high_m = arc_m - path.reach_m, arc_m + path.reach_m
    arc_m, offset_m = find_nearest(path, pieces, position, low_m, high_m)
    return arc_m, offset_m, arc_m


@called
def follow_pieces(  # noqa: PLR0913, PLR0917  (compiled code knows no keyword-only arguments)
    path: Any,
    pieces: Any,
    arc_m: float,
    x_m: Any,
    y_m: Any,
    dues_m: Any,
    arcs_m: Any,
    offsets_m: Any,
) -> None:
    """Enter the arc lengths and offsets of positions in order, as `follow_piece` finds them [m]."""
    for row in range(len(arcs_m)):
        arcs_m[row], offsets_m[row], arc_m = follow_piece(
            path, pieces, arc_m, (x_m[row], y_m[row]), dues_m[row]
        )
