"""What a robot saw stands below its path, at its time, and can be left out."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import turtlelog as tl
from tests.draw.rerun.rrds import (
    list_entities,
    make_foreign_run,
    read_rows,
    read_static,
    read_times,
)
from turtlelog.draw.rerun.plane import Bounds, widen_plane
from turtlelog.log import Surroundings
from turtlelog.log.ros2.bag_surroundings import UNKNOWN, OccupancyMap

POSITIONS = "Points2D:positions"


def make_map(*, is_costmap: bool = False) -> OccupancyMap:
    """Return a map of 3 x 2 cells of 0.5 m that is turned by a quarter to the left."""
    return OccupancyMap(
        topic="/map",
        is_costmap=is_costmap,
        cells=np.array([[0, 100, 50], [UNKNOWN, 0, 100]], dtype=np.uint8),
        corner_xy_m=np.array([1.0, 2.0]),
        column_xy_m=np.array([0.0, 0.5]),
        row_xy_m=np.array([-0.5, 0.0]),
    )


@pytest.mark.parametrize("is_costmap", [False, True])
def test_a_map_is_one_picture_in_its_place(tmp_path: Path, *, is_costmap: bool) -> None:
    path, place = tmp_path / "a.rrd", make_map(is_costmap=is_costmap)
    seen = replace(make_seen(), maps=(place,))
    tl.write_run_rrd(make_foreign_run(10), path, surroundings=seen)
    entity = "/plane/costmap" if is_costmap else "/plane/map"
    assert {"/plane/costmap", "/plane/map"} & list_entities(path) == {entity}
    (picture,) = read_static(path, entity, "SegmentationImage:buffer")
    assert bytes(np.array(picture, dtype=np.uint8)) == place.cells.tobytes()
    (form,) = read_static(path, entity, "SegmentationImage:format")
    assert (form["width"], form["height"]) == (3, 2)
    (corner,) = read_static(path, entity, "Transform3D:translation")
    assert corner == [1.0, 2.0, 0.0]
    (turn,) = read_static(path, entity, "Transform3D:mat3x3")  # by columns
    assert turn == [0.0, 0.5, 0.0, -0.5, 0.0, 0.0, 0.0, 0.0, 1.0]
    (names,) = read_static(path, entity, "AnnotationContext:context")
    shown = {one["class_id"]: one["class_description"]["info"]["color"] & 255 for one in names}
    # Unknown cells have no colour, nor have those that cost nothing.
    assert shown[UNKNOWN] == 0
    assert shown[0] == (0 if is_costmap else 255)
    assert len(shown) == 102


def make_seen(*walls: tuple[float, float]) -> Surroundings:
    return Surroundings(
        time_ns=np.array([10_000, 20_000], dtype=np.int64),
        scans_xy_m=(np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[5.0, 6.0]])),
        walls_xy_m=np.array(walls).reshape(-1, 2),
    )


def test_each_scan_appears_when_it_was_taken(tmp_path: Path) -> None:
    run, path = make_foreign_run(10), tmp_path / "a.rrd"
    tl.write_run_rrd(run, path, surroundings=make_seen((1.0, 1.0), (2.0, 2.0)))
    assert read_static(path, "/plane/walls", POSITIONS) == [[1.0, 1.0], [2.0, 2.0]]
    assert read_rows(path, "/plane/scan", POSITIONS) == [[[1.0, 2.0], [3.0, 4.0]], [[5.0, 6.0]]]
    assert [*read_times(path, "/plane/scan")] == [10_000 - run.start_ns, 20_000 - run.start_ns]
    assert "/plane/map" not in list_entities(path)


@pytest.mark.parametrize(("reach_m", "half_m"), [(0.5, 1.0), (2.0, 2.1), (50.0, 3.0)])
def test_the_plane_grows_for_walls_but_the_path_stays_large(reach_m: float, half_m: float) -> None:
    bounds = Bounds(center_xy_m=(1.0, 1.0), half_size_m=1.0)
    seen = make_seen((1.0 + reach_m, 1.0), (1.0, 1.0 - reach_m))
    assert widen_plane(bounds, seen, np.zeros(2)).half_size_m == pytest.approx(half_m)


def test_the_plane_stays_where_there_is_no_wall() -> None:
    bounds = Bounds(center_xy_m=(1.0, 1.0), half_size_m=1.0)
    assert widen_plane(bounds, make_seen(), np.zeros(2)) == bounds
