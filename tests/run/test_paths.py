import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, strategies as st
from numpy.typing import NDArray

from turtlelog.errors import PathError
from turtlelog.run.path_pieces import REACH_M, find_on_first_lap, locate_on
from turtlelog.run.paths import MOST_POINTS, Path, PathFollower, restore_path

SQUARE = Path(kind="polygon", points=((3.0, 3.0), (8.0, 3.0), (8.0, 8.0), (3.0, 8.0)))
HEXAGON_M = 2.0
HEXAGON = Path(
    kind="polygon",
    points=tuple(
        (5.0 + HEXAGON_M * math.cos(turn), 5.0 + HEXAGON_M * math.sin(turn))
        for turn in np.arange(6) * math.pi / 3.0
    ),
)
LINE = Path(kind="line", points=((1.0, 1.0), (4.0, 5.0)))
CIRCLE = Path(kind="circle", center_x_m=5.0, center_y_m=5.0, size_m=2.0)
EIGHT = Path(kind="figure-eight", center_x_m=5.0, center_y_m=5.0, size_m=1.5)
BENT = Path(kind="waypoints", points=((1.0, 1.0), (2.0, 1.0), (2.5, 2.0), (1.0, 3.0)))
PATHS = {"line": LINE, "square": SQUARE, "circle": CIRCLE, "eight": EIGHT, "bent": BENT}


@pytest.mark.parametrize(
    ("path", "length_m"),
    [
        (LINE, 5.0),
        (SQUARE, 20.0),
        (CIRCLE, 4.0 * math.pi),
        (EIGHT, 6.0 * math.pi),
        (BENT, 1.0 + math.hypot(0.5, 1.0) + math.hypot(1.5, 1.0)),
    ],
    ids=PATHS,
)
def test_length_is_that_of_lines_and_circles(path: Path, length_m: float) -> None:
    assert path.length_m == pytest.approx(length_m, rel=1e-14)


@pytest.mark.parametrize(
    ("path", "arc_m", "point"),
    [
        (LINE, 2.5, (2.5, 3.0, math.atan2(4.0, 3.0), 0.0)),
        (SQUARE, 5.0, (8.0, 3.0, math.pi / 2.0, 0.0)),
        (SQUARE, 17.0, (3.0, 6.0, -math.pi / 2.0, 0.0)),
        (CIRCLE, math.pi, (5.0, 7.0, -math.pi, 0.5)),
        (EIGHT, 1.5 * math.pi, (5.0, 8.0, -math.pi, 1 / 1.5)),
        (EIGHT, 4.5 * math.pi, (5.0, 2.0, -math.pi, -1 / 1.5)),
    ],
)
def test_point_at_an_arc_length_is_the_closed_form(
    path: Path, arc_m: float, point: tuple[float, ...]
) -> None:
    found = path.locate(arc_m)
    turn = math.remainder(found.heading_rad - point[2], 2.0 * math.pi)
    assert (found.x_m, found.y_m) == pytest.approx(point[:2], abs=1e-12)
    assert turn == pytest.approx(0.0, abs=1e-12)
    assert found.curvature_1_m == pytest.approx(point[3], rel=1e-14)


def test_open_path_goes_straight_on_and_a_closed_one_round_again() -> None:
    before, behind = LINE.locate(-5.0), LINE.locate(10.0)
    assert (before.x_m, before.y_m) == pytest.approx((-2.0, -3.0))
    assert (behind.x_m, behind.y_m) == pytest.approx((7.0, 9.0))
    assert SQUARE.locate(22.0) == SQUARE.locate(2.0)
    assert SQUARE.locate(-1.0)[:2] == pytest.approx((3.0, 4.0))


def test_end_of_a_closed_path_is_its_beginning_in_the_direction_of_the_last_leg() -> None:
    end = SQUARE.locate(20.0)
    assert (end.x_m, end.y_m) == pytest.approx((3.0, 3.0))
    assert end.heading_rad == pytest.approx(-math.pi / 2.0)


@cache
def locate_densely(name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return arcs half a millimetre apart, from before a path to behind it, and their points."""
    path = PATHS[name]
    arcs_m = np.arange(-0.1 * path.length_m, 1.1 * path.length_m + 3.0, 5e-4)
    return arcs_m, np.array([path.locate(float(arc))[:2] for arc in arcs_m])


@pytest.mark.parametrize("name", PATHS)
@given(x_m=st.floats(0.0, 11.0), y_m=st.floats(0.0, 11.0), share=st.floats(0.0, 1.0))
def test_nearest_point_is_that_of_a_dense_search(
    name: str, x_m: float, y_m: float, share: float
) -> None:
    path = PATHS[name]
    low_m = (1.2 * share - 0.1) * path.length_m if path.is_closed else share * path.length_m
    high_m = low_m + 1.0 if path.is_closed else min(low_m + 1.0, path.length_m)
    arcs_m, points = locate_densely(name)
    ends = [path.locate(arc_m)[:2] for arc_m in (low_m, high_m)]
    points = np.vstack([points[(arcs_m >= low_m) & (arcs_m <= high_m)], ends])
    away_m = np.hypot(points[:, 0] - x_m, points[:, 1] - y_m)
    found = path.find_nearest(x_m, y_m, low_m, high_m)
    assert abs(found.offset_m) == pytest.approx(away_m.min(), abs=1e-3)
    assert abs(found.offset_m) <= away_m.min() + 1e-9
    assert low_m - 1e-12 <= found.arc_m <= high_m + 1e-12


@pytest.mark.parametrize("name", PATHS)
@given(
    share=st.floats(0.0, 0.99),
    lap=st.integers(-2, 3),
    aside_m=st.floats(-0.2, 0.2),
    lookahead_m=st.floats(0.25, 1.0),
)
def test_point_ahead_is_a_lookahead_away_and_no_point_before_it_is(
    name: str, share: float, lap: int, aside_m: float, lookahead_m: float
) -> None:
    path = PATHS[name]
    from_m = share * path.length_m
    near = path.locate(from_m)
    x_m = near.x_m - aside_m * math.sin(near.heading_rad)
    y_m = near.y_m + aside_m * math.cos(near.heading_rad)
    laps_m = lap * path.length_m if path.is_closed else 0.0
    ahead = path.find_ahead(x_m, y_m, lookahead_m, from_m + laps_m)
    assert math.hypot(ahead.x_m - x_m, ahead.y_m - y_m) == pytest.approx(lookahead_m, rel=1e-8)
    arcs_m, points = locate_densely(name)
    points = points[arcs_m >= from_m]
    away_m = np.hypot(points[:, 0] - x_m, points[:, 1] - y_m)
    outside = np.flatnonzero(away_m > lookahead_m + 1e-9)
    assume(len(outside))
    first = points[outside[0]]
    assert math.hypot(first[0] - ahead.x_m, first[1] - ahead.y_m) <= 2e-3


@pytest.mark.parametrize("path", [HEXAGON, CIRCLE, EIGHT], ids=["hexagon", "circle", "eight"])
@given(from_m=st.floats(-0.5, 0.5), lap=st.integers(0, 2), lookahead_m=st.floats(0.1, 1.0))
def test_point_ahead_moves_over_the_seam_without_a_jump(
    path: Path, from_m: float, lap: int, lookahead_m: float
) -> None:
    arcs_m = [from_m + lap * path.length_m + step_m for step_m in (0.0, 1e-6)]
    found = [path.find_ahead(*path.locate(arc_m)[:2], lookahead_m, arc_m)[:2] for arc_m in arcs_m]
    # The sharper the bend, the faster the point ahead: behind 60 deg twice as fast as the robot.
    assert math.dist(*found) <= 5e-6


@given(from_m=st.floats(0.3, 0.6), aside_m=st.floats(0.01, 0.2), corner=st.integers(1, 6))
def test_point_ahead_is_the_corner_that_is_a_lookahead_away(
    from_m: float, aside_m: float, corner: int
) -> None:
    near, end = (HEXAGON.locate(corner * HEXAGON_M - way_m) for way_m in (from_m, 0.0))
    x_m = near.x_m - aside_m * math.sin(near.heading_rad)
    y_m = near.y_m + aside_m * math.cos(near.heading_rad)
    lookahead_m = math.dist((x_m, y_m), end[:2])
    ahead = HEXAGON.find_ahead(x_m, y_m, lookahead_m, corner * HEXAGON_M - from_m)
    assert ahead[:2] == pytest.approx(end[:2], abs=1e-8)


def test_point_ahead_of_a_robot_far_away_is_the_nearest() -> None:
    assert LINE.find_ahead(0.0, 9.0, 0.3, from_m=2.0) == LINE.locate(2.0)


def test_lookahead_that_no_point_of_a_small_circle_has_goes_on_along_it() -> None:
    small = Path(kind="circle", center_x_m=5.0, center_y_m=5.0, size_m=0.1)
    assert small.find_ahead(5.1, 5.0, 0.3, from_m=0.0) == small.locate(0.3)


@pytest.mark.parametrize(
    ("place", "offset_m"),
    [
        ((5.0, 3.2), 0.2),
        ((5.0, 2.9), -0.1),
        ((8.3, 2.6), -0.5),  # outside of the corner
        ((8.5, 3.0), -0.5),  # straight on from the first leg
        ((8.0, 2.5), -0.5),
    ],
)
def test_offset_is_positive_on_the_left(place: tuple[float, float], offset_m: float) -> None:
    assert SQUARE.find_nearest(*place, 0.0, 10.0).offset_m == pytest.approx(offset_m)


@given(corner=st.integers(1, 9), past_m=st.floats(0.01, 0.4))
def test_straight_on_from_a_corner_is_outside_of_it_on_every_lap(
    corner: int, past_m: float
) -> None:
    triangle = Path(kind="polygon", points=((3.1, 3.2), (8.3, 3.7), (5.3, 8.1)))
    lap, leg = divmod(corner - 1, 3)
    piece = triangle.pieces[leg]
    corner_m = lap * triangle.length_m + piece.start_m + piece.length_m
    x_m, y_m = locate_on(piece, piece.length_m + past_m)[:2]
    found = triangle.find_nearest(x_m, y_m, corner_m - 0.2, corner_m + 0.2)
    assert (found.arc_m, found.offset_m) == pytest.approx((corner_m, -past_m))


@pytest.mark.parametrize("lap", [-1, 0, 1, 7])
def test_on_every_lap_a_corner_has_the_direction_of_the_next_leg(lap: int) -> None:
    for piece in HEXAGON.pieces:
        corner_m = find_on_first_lap(HEXAGON.numbers, piece.start_m + lap * HEXAGON.length_m)
        assert HEXAGON.locate(corner_m).heading_rad == piece.heading_rad


def test_a_seam_is_a_corner_where_a_lap_ends_in_another_direction_than_it_begins() -> None:
    assert SQUARE.seam_rad == pytest.approx(math.pi / 2)
    assert CIRCLE.seam_rad == EIGHT.seam_rad == LINE.seam_rad == 0.0


def test_corners_are_jumps_of_the_direction() -> None:
    assert [(corner.arc_m, corner.leg_m) for corner in SQUARE.corners] == [(5, 5), (10, 5), (15, 5)]
    assert [corner.turn_rad for corner in SQUARE.corners] == pytest.approx([math.pi / 2] * 3)
    assert CIRCLE.corners == EIGHT.corners == LINE.corners == ()


@pytest.mark.parametrize(("bend_deg", "count"), [(0.9, 0), (1.1, 1)])
def test_slight_bend_is_no_corner(bend_deg: float, count: int) -> None:
    bend = math.radians(bend_deg)
    end = (2.0 + math.cos(bend), 1.0 + math.sin(bend))
    assert len(Path(kind="waypoints", points=((1.0, 1.0), (2.0, 1.0), end)).corners) == count


def test_follower_stays_on_its_branch_where_the_path_meets_itself() -> None:
    follower, found = PathFollower(EIGHT), []
    for arc_m in np.linspace(0.0, EIGHT.length_m, 2000):
        point = EIGHT.locate(float(arc_m))
        found.append(follower.advance(point.x_m, point.y_m).arc_m - arc_m)
    assert np.abs(found).max() < 1e-7


@pytest.mark.parametrize(("factor", "arc_m"), [(0.9, 0.9 * REACH_M), (1.1, REACH_M)])
def test_follower_looks_no_further_than_its_reach(factor: float, arc_m: float) -> None:
    point = LINE.locate(factor * REACH_M)
    assert PathFollower(LINE, 0.0).advance(point.x_m, point.y_m).arc_m == pytest.approx(arc_m)


@pytest.mark.parametrize(("factor", "has_come"), [(0.9, True), (1.1, False)])
def test_robot_comes_to_an_open_path_at_its_beginning(factor: float, *, has_come: bool) -> None:
    follower = PathFollower(LINE)
    place = follower.advance(1.0, 1.0 - factor * REACH_M)
    assert (follower.arc_m is not None) is has_come
    assert (place.arc_m, abs(place.offset_m)) == pytest.approx((0.0, factor * REACH_M))


def test_robot_that_comes_by_time_comes_to_the_stretch_that_the_reference_has_passed() -> None:
    follower, point = PathFollower(LINE), LINE.locate(3.0)
    assert follower.advance(point.x_m, point.y_m, 2.0).arc_m == 2.0
    assert follower.arc_m is None
    assert follower.advance(point.x_m, point.y_m, 3.5).arc_m == pytest.approx(3.0)
    assert follower.arc_m == pytest.approx(3.0)


@pytest.mark.parametrize("size_m", [0.001, 0.05])
def test_follower_of_a_small_circle_stays_on_its_side(size_m: float) -> None:
    small = Path(kind="circle", center_x_m=5.0, center_y_m=5.0, size_m=size_m)
    follower = PathFollower(small, 0.0)
    for share in np.linspace(0.0, 3.0, 100):
        point = small.locate(float(share) * small.length_m)
        place = follower.advance(point.x_m, point.y_m)
        assert place.arc_m == pytest.approx(share * small.length_m, abs=1e-9)


def test_direction_tells_branches_apart() -> None:
    cross = Path(
        kind="waypoints", points=((1.0, 3.0), (5.0, 3.0), (5.0, 5.0), (3.0, 5.0), (3.0, 1.0))
    )
    assert cross.find_point((3.0, 3.0, 0.0)) == pytest.approx(2.0)
    assert cross.find_point((3.0, 3.0, -math.pi / 2.0)) == pytest.approx(10.0)


def test_bounds_hold_every_point() -> None:
    for path in PATHS.values():
        points = [path.locate(float(arc)) for arc in np.linspace(0.0, path.length_m, 999)]
        low_x, high_x, low_y, high_y = path.bounds_m
        assert low_x - 1e-9 <= min(point.x_m for point in points) <= low_x + 0.02
        assert high_x - 0.02 <= max(point.x_m for point in points) <= high_x + 1e-9
        assert low_y - 1e-9 <= min(point.y_m for point in points) <= low_y + 0.02
        assert high_y - 0.02 <= max(point.y_m for point in points) <= high_y + 1e-9


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "kind": ({"kind": "spiral"}, "kind: expected one of line, polygon, waypoints, circle"),
    "no points": ({"kind": "line"}, "points: missing; a path of kind line needs it"),
    "one point": ({"points": ((1.0, 1.0),)}, "points: expected 2 to 3000 points, found 1"),
    "many": (
        {"points": tuple((float(n), 0.0) for n in range(MOST_POINTS + 1))},
        "points: expected 2 to 3000 points, found 3001",
    ),
    "line of three": (
        {"kind": "line", "points": ((1.0, 1.0), (2.0, 1.0), (3.0, 1.0))},
        "points: expected 2 points, found 3",
    ),
    "two corners": (
        {"kind": "polygon", "points": ((1.0, 1.0), (2.0, 1.0))},
        "points: expected 3 to 3000 points, found 2",
    ),
    "nan": (
        {"points": ((1.0, 1.0), (2.0, math.nan))},
        r"points\[1\]: expected a finite number, found nan",
    ),
    "text": ({"points": ((1.0, 1.0), (2.0, "3"))}, r"points\[1\]: expected a finite number"),
    "three": ({"points": ((1.0, 1.0), (2.0, 1.0, 3.0))}, r"points\[1\]: expected \[x, y\] in m"),
    "twice": (
        {"points": ((1.0, 1.0), (1.0, 1.0))},
        r"points\[1\]: expected another point than the one before, found \(1.0, 1.0\)",
    ),
    "closed twice": (
        {"closed": True, "points": ((1.0, 1.0), (2.0, 1.0), (1.0, 1.0))},
        r"points\[2\]: expected another point than the first, for the path is closed",
    ),
    "size of a line": ({"size_m": 1.0}, "size_m: expected none, for kind is waypoints, found 1.0"),
    "closed circle": (
        {"kind": "circle", "center_x_m": 1.0, "center_y_m": 1.0, "size_m": 1.0, "closed": True},
        "points: expected none, for kind is circle",
    ),
    "way back": (
        {"points": ((1.0, 1.0), (2.0, 1.0), (1.5, 1.0))},
        r"points\[1\]: expected a path that does not turn back on itself, found a turn of 180 deg",
    ),
    "closed way back": ({"closed": True}, r"points\[1\]: expected a path that does not turn back"),
    "no length": (
        {"points": ((1.0, 1.0), (1.0, 1.0009))},
        "points: expected a path of 0.001 m or more, found 0.0009 m",
    ),
    "speed": ({"speed_m_s": 0.0}, "speed_m_s: expected a speed > 0 and up to 1e.06, found 0.0"),
    "fast": (
        {"speed_m_s": 1.1e6},
        "speed_m_s: expected a speed > 0 and up to 1e.06, found 1100000",
    ),
    "endless speed": ({"speed_m_s": math.inf}, "speed_m_s: expected a finite number, found inf"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_makes_no_path_is_refused(name: str) -> None:
    changes, line = WRONG[name]
    values = {"kind": "waypoints", "points": ((1.0, 1.0), (2.0, 1.0))}
    if changes.get("kind") == "line" and "points" not in changes:
        del values["points"]
    with pytest.raises(PathError, match=line):
        Path(**(values | changes))


@pytest.mark.parametrize("size_m", [0.0, 0.0009, 1e-320, -1.0, math.nan])
def test_circle_without_a_radius_is_refused(size_m: float) -> None:
    with pytest.raises(PathError, match="size_m: expected"):
        Path(kind="circle", center_x_m=5.0, center_y_m=5.0, size_m=size_m)


def test_parameters_of_a_run_give_the_path_back() -> None:
    values = {"path.kind": "line", "path.points": [[1.0, 1.0], [4.0, 5.0]], "law.kind": "kanayama"}
    assert restore_path(values) == LINE
    assert restore_path({"law.kind": "kanayama"}) is None


@pytest.mark.parametrize(
    "values",
    [{"path.size_m": 1.0}, {"path.kind": ["line"]}, {"path.kind": "line", "path.points": 3}],
)
def test_parameters_that_make_no_path_are_refused(values: dict[str, Any]) -> None:
    with pytest.raises(PathError, match="expected"):
        restore_path(values)
