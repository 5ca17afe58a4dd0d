"""A path to track, as a chain of straight pieces and arcs of circles.

Every piece has a constant curvature. Therefore closed forms exist for the point at an arc length,
the nearest point and the point at the lookahead distance.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any, Final, Literal, NamedTuple, get_args

from turtlelog.errors import PathError
from turtlelog.run import path_pieces
from turtlelog.run.angles import wrap_angle
from turtlelog.run.path_pieces import REACH_M, PathNumbers, PathPiece, PathPoint

PathKind = Literal["line", "polygon", "waypoints", "circle", "figure-eight"]

MOST_POINTS: Final = 3000
"""Largest number of points of a path. Each takes up to 56 bytes of the scenario's text: 164 KiB of
the 256 KiB allowed for a recording's scenario. The rest is for lists of the law."""

CORNER_RAD: Final = math.radians(1.0)
"""Smallest change of direction between two pieces that counts as a corner: smaller bends belong to
a circle given by 360 points or more."""

TURN_BACK_RAD: Final = math.radians(179.9)
"""Change of direction from which a path leads back over itself: the nearest point could be on
either leg, and neither side is the outer side."""

LEAST_M: Final = 0.001
"""Smallest radius, and smallest length of a path [m]: far less than the 0.5 m width of a turtle,
and as much as the tolerance of a run."""

FASTEST_M_S: Final = 1e6
"""Largest speed of a reference [m/s], far below the limits of floating-point numbers."""


class PathPlace(NamedTuple):
    """Place of a robot relative to a path.

    Attributes:
        arc_m: Arc length of the nearest point from the beginning of the path [m].
        offset_m: Distance from that point, positive on the left of the path [m].
    """

    arc_m: float
    offset_m: float


class Corner(NamedTuple):
    """A point where the direction of a path jumps.

    Attributes:
        arc_m: Arc length of the corner [m].
        turn_rad: Change of direction, positive to the left [rad].
        leg_m: Length of the path from the corner to the next corner, or to the end [m].
    """

    arc_m: float
    turn_rad: float
    leg_m: float


def closes_by_itself(kind: str) -> bool:
    """Return whether a path of this kind is closed by default."""
    return kind not in {"line", "waypoints"}


@dataclass(frozen=True, kw_only=True)
class Path:
    """A path to track: the table `[path]` of a scenario.

    Attributes:
        kind: `line`: two points. `polygon`: corners, closed. `waypoints`: points, open. `circle`:
            counter-clockwise from its rightmost point. `figure-eight`: two circles that touch at
            the center, first the upper counter-clockwise, then the lower clockwise.
        points: Points of a line, a polygon or waypoints, world frame [m].
        center_x_m: Center x of a circle or a figure eight, world frame [m].
        center_y_m: Center y of a circle or a figure eight, world frame [m].
        size_m: Radius of the circle, or of both circles of a figure eight [m].
        closed: Whether the path returns to its first point; None: polygons do, waypoints do not.
        speed_m_s: Speed at which the reference moves along the path from its beginning [m/s]. If
            None, the reference is the path point nearest to the robot.

    Raises:
        PathError: One line with the key, what was expected and what was found.
    """

    kind: PathKind
    points: tuple[tuple[float, float], ...] | None = None
    center_x_m: float | None = None
    center_y_m: float | None = None
    size_m: float | None = None
    closed: bool | None = None
    speed_m_s: float | None = None

    def __post_init__(self) -> None:
        if self.kind not in get_args(PathKind):
            known = ", ".join(get_args(PathKind))
            raise PathError(f"kind: expected one of {known}, found {self.kind!r:.40}")
        if self.kind in _ROUND:
            self._require_keys("center_x_m", "center_y_m", "size_m")
            self._refuse_keys("points", "closed")
            if not _require_finite("size_m", self.size_m) >= LEAST_M:
                raise PathError(f"size_m: expected a radius >= {LEAST_M}, found {self.size_m!r}")
            _require_finite("center_x_m", self.center_x_m)
            _require_finite("center_y_m", self.center_y_m)
        else:
            self._require_keys("points")
            self._refuse_keys("center_x_m", "center_y_m", "size_m")
            self._require_points(self.points or ())
        speed_m_s = self.speed_m_s
        if speed_m_s is None:
            return
        if not 0.0 < _require_finite("speed_m_s", speed_m_s) <= FASTEST_M_S:
            expected = f"a speed > 0 and up to {FASTEST_M_S:g}"
            raise PathError(f"speed_m_s: expected {expected}, found {speed_m_s!r}")

    def _require_keys(self, *names: str) -> None:
        for name in names:
            if getattr(self, name) is None:
                raise PathError(f"{name}: missing; a path of kind {self.kind} needs it")

    def _refuse_keys(self, *names: str) -> None:
        for name in names:
            if (value := getattr(self, name)) is not None:
                found = f"{len(value)} points" if name == "points" else repr(value)
                raise PathError(f"{name}: expected none, for kind is {self.kind}, found {found}")

    def _require_points(self, points: tuple[tuple[float, float], ...]) -> None:
        if self.kind == "line":
            self._refuse_keys("closed")
        least, most = {"line": (2, 2), "polygon": (3, MOST_POINTS)}.get(self.kind, (2, MOST_POINTS))
        if not least <= len(points) <= most:
            expected = f"{least}" if least == most else f"{least} to {most}"
            raise PathError(f"points: expected {expected} points, found {len(points)}")
        for number, point in enumerate(points):
            if not isinstance(point, tuple) or len(point) != 2:
                raise PathError(f"points[{number}]: expected [x, y] in m, found {point!r:.40}")
            for value in point:
                _require_finite(f"points[{number}]", value)
            if number and point == points[number - 1]:
                raise PathError(
                    f"points[{number}]: expected another point than the one before, found {point}"
                )
        if self.is_closed and points[0] == points[-1]:
            expected = "another point than the first, for the path is closed"
            raise PathError(f"points[{len(points) - 1}]: expected {expected}, found {points[-1]}")
        self._require_ways()

    def _require_ways(self) -> None:
        """Refuse pieces without length, and a path that turns back over itself."""
        if self.length_m < LEAST_M:
            found = f"{self.length_m:.3g} m"
            raise PathError(f"points: expected a path of {LEAST_M} m or more, found {found}")
        pieces = [*self.pieces, *(self.pieces[:1] if self.is_closed else ())]
        for before, piece in pairwise(pieces):
            if abs(_find_turn(before, piece)) > TURN_BACK_RAD:
                expected = "a path that does not turn back on itself"
                found = "a turn of 180 deg"
                raise PathError(f"points[{piece.number}]: expected {expected}, found {found}")

    @property
    def is_closed(self) -> bool:
        """Whether the path ends where it begins."""
        return closes_by_itself(self.kind) if self.closed is None else self.closed

    @cached_property
    def length_m(self) -> float:
        """Length of the path; of one lap if the path is closed [m]."""
        last = self.pieces[-1]
        return last.start_m + last.length_m

    @cached_property
    def corners(self) -> tuple[Corner, ...]:
        """Corners of the first lap, in order; the end of the path is not a corner."""
        found = [
            (piece.start_m, turn)
            for before, piece in pairwise(self.pieces)
            if abs(turn := _find_turn(before, piece)) >= CORNER_RAD
        ]
        ends_m = [*(arc_m for arc_m, _ in found[1:]), self.length_m]
        return tuple(
            Corner(arc_m, turn, end_m - arc_m)
            for (arc_m, turn), end_m in zip(found, ends_m, strict=False)
        )

    @cached_property
    def seam_rad(self) -> float:
        """Change of direction between two laps of a closed path; 0 if it is no corner [rad]."""
        turn_rad = _find_turn(self.pieces[-1], self.pieces[0]) if self.is_closed else 0.0
        return turn_rad if abs(turn_rad) >= CORNER_RAD else 0.0

    @property
    def bounds_m(self) -> tuple[float, float, float, float]:
        """Smallest and largest x, smallest and largest y of the path [m]."""
        if self.points is not None:
            xs, ys = zip(*self.points, strict=True)
            return min(xs), max(xs), min(ys), max(ys)
        x_m, y_m, size_m = (self.center_x_m or 0.0), (self.center_y_m or 0.0), (self.size_m or 0.0)
        high_m = size_m if self.kind == "circle" else 2.0 * size_m
        return x_m - size_m, x_m + size_m, y_m - high_m, y_m + high_m

    def locate(self, arc_m: float) -> PathPoint:
        """Return the point at an arc length [m].

        Beyond the ends, a closed path is repeated, and an open path goes straight on.
        """
        return PathPoint(*path_pieces.locate(self.numbers, self.ways, arc_m))

    def find_nearest(self, x_m: float, y_m: float, low_m: float, high_m: float) -> PathPlace:
        """Return the place of a position relative to the segment between two arc lengths.

        The segment of an open path is limited to its ends. A closed path is repeated: an arc length
        may be negative or beyond the length. If several points are equally near, the first is used.
        """
        return PathPlace(
            *path_pieces.find_nearest(self.numbers, self.ways, (x_m, y_m), low_m, high_m)
        )

    def find_point(self, point: tuple[float, float, float]) -> float:
        """Return the arc length [m] of a path point given by x [m], y [m] and direction [rad].

        If the path crosses itself, the direction selects the branch.
        """
        x_m, y_m, heading_rad = point
        best_m, best = math.inf, 0.0
        for piece in self.pieces:
            way_m = path_pieces.find_nearest_on(piece, x_m, y_m, 0.0, piece.length_m)
            found = PathPoint(*path_pieces.locate_on(piece, way_m))
            away_m = math.hypot(x_m - found.x_m, y_m - found.y_m)
            away_m += abs(wrap_angle(heading_rad - found.heading_rad))  # 1 m for 1 rad
            if away_m < best_m:
                best_m, best = away_m, piece.start_m + way_m
        return best

    def find_ahead(self, x_m: float, y_m: float, lookahead_m: float, from_m: float) -> PathPoint:
        """Return the first point from an arc length on at the lookahead distance from a position.

        If the path at `from_m` is further away than the lookahead, the result is the point at
        `from_m`. If no point of a closed path is that far away, the result is the point one
        lookahead further along the path.
        """
        return PathPoint(
            *path_pieces.find_ahead(self.numbers, self.ways, (x_m, y_m), lookahead_m, from_m)
        )

    @cached_property
    def pieces(self) -> tuple[PathPiece, ...]:
        """Pieces of the path, in order."""
        if self.points is None:
            return tuple(_build_round(self))
        points = (*self.points, self.points[0]) if self.is_closed else self.points
        return tuple(path_pieces.join_points(points))

    @cached_property
    def ways(self) -> tuple[PathPiece, ...]:
        """Pieces of the path, then the tangents at the end and at the beginning of the path."""
        first, last = self.pieces[0], self.pieces[-1]
        return (*self.pieces, last.go_straight(last.length_m), first.go_straight(0.0))

    @cached_property
    def numbers(self) -> PathNumbers:
        """Numbers that functions of paths and loops read, in addition to the pieces."""
        # A quarter of a short closed path: the way round the other side is further.
        reach_m = min(REACH_M, self.length_m / 4.0) if self.is_closed else REACH_M
        return PathNumbers(
            count=len(self.pieces),
            is_closed=self.is_closed,
            length_m=self.length_m,
            reach_m=reach_m,
            has_speed=self.speed_m_s is not None,
            speed_m_s=self.speed_m_s or 0.0,
        )


PATH_KEYS: Final = tuple(f"path.{one.name}" for one in fields(Path))
"""Scenario keys of a path, which are absent without a path."""


class PathFollower:
    """Tracker of the point of a path that is nearest to a robot, pose by pose, as in `follow`.

    Attributes:
        arc_m: Arc length of the nearest point [m]; None until the robot reaches the path.
        reach_m: Largest distance along the path from one nearest point to the next, either way [m].
    """

    __slots__ = ("_path", "arc_m", "reach_m")

    def __init__(self, path: Path, arc_m: float | None = None) -> None:
        """Start at an arc length [m], or off the path if the arc length is None."""
        self._path, self.arc_m, self.reach_m = path, arc_m, path.numbers.reach_m

    def advance(self, x_m: float, y_m: float, due_m: float | None = None) -> PathPlace:
        """Return the robot's place; `due_m` is the arc length of the moving reference [m]."""
        path, before_m = self._path, math.nan if self.arc_m is None else self.arc_m
        due_m = math.nan if due_m is None else due_m
        arc_m, offset_m, next_m = path_pieces.follow_piece(
            path.numbers, path.ways, before_m, (x_m, y_m), due_m
        )
        self.arc_m = None if math.isnan(next_m) else next_m
        return PathPlace(arc_m, offset_m)


def restore_path(parameters: Mapping[str, Any]) -> Path | None:
    """Return the path among a run's parameters; None without one, PathError if it is none."""
    found = [key for key in PATH_KEYS if key in parameters]
    values = {key.removeprefix("path."): parameters[key] for key in found}
    if not values:
        return None
    points = values.get("points")
    if isinstance(points, list | tuple):
        values["points"] = tuple(tuple(one) if isinstance(one, list) else one for one in points)
    try:
        return _build_path(tuple(values.items()))
    except TypeError as err:  # a list where a number belongs, or no kind
        raise PathError(f"expected a path, found {values!r:.60}") from err


@lru_cache(maxsize=16)
def _build_path(values: tuple[tuple[str, Any], ...]) -> Path:
    # Kept, as a run asks for its path again and again: its pieces are found once.
    return Path(**dict(values))


_ROUND: Final = ("circle", "figure-eight")


def _require_finite(place: str, value: Any) -> float:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not math.isfinite(value):
        raise PathError(f"{place}: expected a finite number, found {value!r:.40}")
    return float(value)


def _find_turn(before: PathPiece, after: PathPiece) -> float:
    end = before.heading_rad + before.curvature_1_m * before.length_m
    return wrap_angle(after.heading_rad - end)


def _build_round(path: Path) -> Iterator[PathPiece]:
    x_m, y_m, size_m = path.center_x_m or 0.0, path.center_y_m or 0.0, path.size_m or 0.0
    turn_m = 2.0 * math.pi * size_m
    if path.kind == "circle":
        yield PathPiece(0, 0.0, turn_m, x_m + size_m, y_m, math.pi / 2.0, 1.0 / size_m)
        return
    yield PathPiece(0, 0.0, turn_m, x_m, y_m, 0.0, 1.0 / size_m)
    yield PathPiece(1, turn_m, turn_m, x_m, y_m, 0.0, -1.0 / size_m)
