"""What is drawn of a path that a law tracks: its outline, the error along it, the worst place."""

import math
from dataclasses import replace

import numpy as np
import pytest

import turtlelog as tl
from tests.draw.laws import SQUARE, simulate_law, simulate_tracker, simulate_untimed
from turtlelog.charts.close_up import ON_PATH_M, find_worst_place
from turtlelog.charts.curves import read_along_error
from turtlelog.charts.plane_scene import (
    has_own_way,
    list_paths,
    outline_path,
    read_way_to_reference,
)
from turtlelog.measure import read_signal
from turtlelog.run.paths import Path, PathKind

KANAYAMA, PURSUIT = simulate_tracker("kanayama"), simulate_tracker("pure-pursuit")


def test_the_outline_of_straight_pieces_is_their_corners() -> None:
    closed = outline_path(Path(kind="polygon", points=SQUARE))
    assert closed.tolist() == [list(point) for point in (*SQUARE, SQUARE[0])]
    open_ = outline_path(Path(kind="waypoints", points=SQUARE))
    assert open_.tolist() == [list(point) for point in SQUARE]


@pytest.mark.parametrize(("kind", "turns"), [("circle", 1), ("figure-eight", 2)])
def test_the_outline_of_a_circle_is_no_further_from_it_than_poses_are_rounded(
    kind: PathKind, turns: int
) -> None:
    path = Path(kind=kind, center_x_m=5.0, center_y_m=5.0, size_m=2.0)
    points = outline_path(path)
    length_m = float(np.hypot(*np.diff(points, axis=0).T).sum())
    assert length_m == pytest.approx(turns * 2.0 * math.pi * 2.0, rel=1e-5)
    middles = (points[1:] + points[:-1]) / 2.0
    centers = [[5.0, 5.0]] if kind == "circle" else [[5.0, 7.0], [5.0, 3.0]]
    away_m = np.min([np.abs(np.hypot(*(middles - center).T) - 2.0) for center in centers], axis=0)
    assert 1e-6 < away_m.max() < 5e-6


def test_a_path_is_listed_once_and_only_where_a_law_tracks_it() -> None:
    ignores = tl.simulate_run(
        tl.override_scenario(
            tl.load_scenario("textbook"),
            {"path.kind": "line", "path.points": [[1.0, 1.0], [2.0, 2.0]]},
        )
    )
    assert ignores.parameters["path.kind"] == "line"
    assert list_paths([ignores]) == ()
    assert list_paths([KANAYAMA, ignores, PURSUIT]) == (Path(kind="polygon", points=SQUARE),)


def test_the_error_along_the_path_is_its_reference_minus_the_nearest_arc_length() -> None:
    curve, along = read_along_error(KANAYAMA), read_signal(KANAYAMA, "along_track")
    assert curve is not None
    assert along is not None
    due_m = 0.5 * (KANAYAMA.poses.time_ns - KANAYAMA.start_ns) / 1e9
    np.testing.assert_allclose(curve.values, np.minimum(due_m, 12.0) - along.values, atol=1e-9)
    assert read_along_error(simulate_untimed()) is None
    assert read_along_error(simulate_law("example")) is None


def test_the_way_to_the_reference_ends_at_the_recorded_one() -> None:
    ways_m, samples = read_way_to_reference(KANAYAMA), KANAYAMA.samples
    assert ways_m is not None
    assert samples.reference_xy_m is not None
    ends_m = (KANAYAMA.poses.xy_m + ways_m)[samples.pose_sequence]
    np.testing.assert_allclose(ends_m, samples.reference_xy_m, atol=1e-12)
    assert read_way_to_reference(simulate_law("example")) is None


def test_a_reference_on_the_path_has_no_way_of_its_own() -> None:
    assert not has_own_way(KANAYAMA)
    assert has_own_way(simulate_law("Follower"))


def test_the_worst_place_is_that_of_the_largest_error() -> None:
    worst = find_worst_place([PURSUIT, KANAYAMA])
    largest = tl.measure_run(KANAYAMA)["cross.largest_error"].value
    assert worst is not None
    assert worst.run == 1
    assert worst.offset_m == largest
    away_m = math.dist(worst.xy_m, worst.path_xy_m)
    assert away_m == pytest.approx(worst.offset_m, rel=1e-9)
    shown = np.abs(np.subtract([worst.xy_m, worst.path_xy_m], worst.center_xy_m)).max()
    assert shown < worst.half_m


def test_the_worst_place_shows_the_way_out_and_back() -> None:
    worst, offsets = find_worst_place([KANAYAMA]), read_signal(KANAYAMA, "cross_track")
    assert worst is not None
    assert offsets is not None
    near = np.abs(KANAYAMA.poses.xy_m - worst.center_xy_m).max(axis=1) <= worst.half_m
    at = int(np.abs(offsets.values).argmax())
    first = at - int(np.argmin(near[at::-1])) + 1
    last = at + int(np.argmin(near[at:])) - 1
    assert np.abs(offsets.values[[first, last]]).max() < 0.1 * worst.offset_m


def move_off(offset_m: float) -> tl.Run:
    """Return a run whose robot is beside the middle of the first side for a moment."""
    time_s = (PURSUIT.poses.time_ns - PURSUIT.start_ns) / 1e9
    path = Path(kind="polygon", points=SQUARE)
    xy_m = np.array([path.locate(min(0.5 * max(at_s, 0.0), 12.0))[:2] for at_s in time_s.tolist()])
    xy_m[np.abs(time_s - 3.0) < 0.1, 1] -= offset_m
    return replace(PURSUIT, poses=replace(PURSUIT.poses, xy_m=xy_m))


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_run_that_stays_on_its_path_has_no_worst_place(share: float) -> None:
    worst = find_worst_place([move_off(share * ON_PATH_M)])
    assert (worst is not None) == (share > 1.0)


def test_of_a_long_stretch_beside_the_path_the_worst_part_is_shown() -> None:
    xy_m = np.array(move_off(0.0).poses.xy_m)
    xy_m[:, 0] += 0.02
    worst = find_worst_place([replace(PURSUIT, poses=replace(PURSUIT.poses, xy_m=xy_m))])
    assert worst is not None
    assert worst.half_m == pytest.approx(10.0 * worst.offset_m)


def test_a_path_is_one_whatever_the_speed_along_it() -> None:
    assert simulate_untimed().path != KANAYAMA.path
    assert len(list_paths([KANAYAMA, simulate_untimed()])) == 1
    assert find_worst_place([simulate_untimed(), KANAYAMA]) is not None


def test_runs_along_several_paths_have_no_common_worst_place() -> None:
    moved = {**KANAYAMA.parameters, "path.points": [[3.0, 3.0], [6.0, 3.0], [6.0, 7.0]]}
    assert find_worst_place([KANAYAMA, replace(KANAYAMA, parameters=moved)]) is None
    assert find_worst_place([simulate_law("example")]) is None
