"""Pieces of constant curvature that a path is made of: straight lines and arcs of circles."""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final, NamedTuple

from turtlelog.angles import wrap_angle

ROUNDING_M: Final = 1e-9
"""How far a way may be wrong by rounding [m]: where two pieces meet, a circle may seem to be left
behind the end of the one and before the start of the other."""


class PathPoint(NamedTuple):
    """A point of a path.

    Attributes:
        x_m: World frame [m].
        y_m: World frame [m].
        heading_rad: Direction of the path there, counter-clockwise from +x, in [-pi, pi).
        curvature_1_m: Positive where the path bends to the left [1/m].
    """

    x_m: float
    y_m: float
    heading_rad: float
    curvature_1_m: float


class PathPiece(NamedTuple):
    """A straight piece, or an arc where the curvature is not 0.

    What its methods call a way is a length along it, from its own start.

    Attributes:
        number: Its place in the path, from 0.
        start_m: Arc length of its start from the beginning of the path [m].
        length_m: Its own length [m].
        x_m: Of its start, world frame [m].
        y_m: Of its start, world frame [m].
        heading_rad: Its direction at the start, counter-clockwise from +x.
        curvature_1_m: Positive where it bends to the left [1/m].
    """

    number: int
    start_m: float
    length_m: float
    x_m: float
    y_m: float
    heading_rad: float
    curvature_1_m: float

    def locate(self, way_m: float) -> PathPoint:
        """Return the point at a way, also beyond the ends of the piece."""
        heading, curvature = self.heading_rad, self.curvature_1_m
        if curvature == 0.0:
            x_m = self.x_m + way_m * math.cos(heading)
            y_m = self.y_m + way_m * math.sin(heading)
            return PathPoint(x_m, y_m, wrap_angle(heading), 0.0)
        end = heading + curvature * way_m
        x_m = self.x_m + (math.sin(end) - math.sin(heading)) / curvature
        y_m = self.y_m - (math.cos(end) - math.cos(heading)) / curvature
        return PathPoint(x_m, y_m, wrap_angle(end), curvature)

    def go_straight(self, way_m: float) -> "PathPiece":
        """Return the tangent at a way as a straight piece without an end."""
        start = self.locate(way_m)
        return PathPiece(
            self.number,
            self.start_m + way_m,
            math.inf,
            start.x_m,
            start.y_m,
            start.heading_rad,
            0.0,
        )

    def find_nearest(self, x_m: float, y_m: float, low_m: float, high_m: float) -> float:
        """Return the way to the point between two ways that is nearest to a position [m]."""
        curvature = self.curvature_1_m
        if curvature == 0.0:
            cos, sin = math.cos(self.heading_rad), math.sin(self.heading_rad)
            way_m = (x_m - self.x_m) * cos + (y_m - self.y_m) * sin
            return min(max(way_m, low_m), high_m)
        middle_m = (low_m + high_m) / 2.0
        turned = self._turn_to(x_m, y_m)
        # The same direction is met once a turn: that nearest to the middle of the stretch.
        turn_m = 2.0 * math.pi / abs(curvature)
        way_m = turned / curvature
        way_m += turn_m * round((middle_m - way_m) / turn_m)
        return min(max(way_m, low_m), high_m)

    def find_exit(self, x_m: float, y_m: float, radius_m: float, low_m: float) -> float | None:
        """Return the first way from `low_m` on at which the piece leaves a circle [m].

        None if it does not within its length. Both ends count by `ROUNDING_M` more.
        """
        curvature = self.curvature_1_m
        if curvature == 0.0:
            cos, sin = math.cos(self.heading_rad), math.sin(self.heading_rad)
            ahead_m, left_m = x_m - self.x_m, y_m - self.y_m
            way_m = ahead_m * cos + left_m * sin
            aside_m = left_m * cos - ahead_m * sin
            square = radius_m * radius_m - aside_m * aside_m
            if square < 0.0:
                return None
            way_m += math.sqrt(square)
        else:
            way_m = self._find_exit_of_arc(x_m, y_m, radius_m, low_m)
        if not low_m - ROUNDING_M <= way_m <= self.length_m + ROUNDING_M:
            return None
        return min(max(way_m, low_m), self.length_m)

    def _find_exit_of_arc(self, x_m: float, y_m: float, radius_m: float, low_m: float) -> float:
        """Return the first way from `low_m` on at which the circle of an arc leaves another [m].

        Infinite if it never does.
        """
        curvature = self.curvature_1_m
        arc_radius_m = 1.0 / abs(curvature)
        center_x_m, center_y_m = self._find_center()
        center_away_m = math.hypot(x_m - center_x_m, y_m - center_y_m)
        if center_away_m == 0.0:
            return math.inf
        squares = arc_radius_m * arc_radius_m + center_away_m * center_away_m
        cosine = (squares - radius_m * radius_m) / (2.0 * arc_radius_m * center_away_m)
        if not -1.0 <= cosine <= 1.0:
            return math.inf
        way_m = (self._turn_to(x_m, y_m) + math.copysign(math.acos(cosine), curvature)) / curvature
        turn_m = 2.0 * math.pi * arc_radius_m
        return way_m + turn_m * math.ceil((low_m - ROUNDING_M - way_m) / turn_m)

    def _find_center(self) -> tuple[float, float]:
        x_m = self.x_m - math.sin(self.heading_rad) / self.curvature_1_m
        return x_m, self.y_m + math.cos(self.heading_rad) / self.curvature_1_m

    def _turn_to(self, x_m: float, y_m: float) -> float:
        """Return by how much an arc has turned where it is nearest to a position [rad]."""
        center_x_m, center_y_m = self._find_center()
        away = math.atan2(y_m - center_y_m, x_m - center_x_m)
        return away + math.copysign(math.pi / 2.0, self.curvature_1_m) - self.heading_rad


def join_points(points: Sequence[tuple[float, float]]) -> Iterator[PathPiece]:
    """Yield the straight pieces from point to point [m]."""
    start_m = 0.0
    for number, ((x_m, y_m), (end_x_m, end_y_m)) in enumerate(pairwise(points)):
        length_m = math.hypot(end_x_m - x_m, end_y_m - y_m)
        heading = math.atan2(end_y_m - y_m, end_x_m - x_m)
        yield PathPiece(number, start_m, length_m, x_m, y_m, heading, 0.0)
        start_m += length_m
