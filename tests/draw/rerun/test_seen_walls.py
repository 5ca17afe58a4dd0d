"""What a robot saw stands below its path, at its time, and can be left out."""

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
from turtlelog.draw.rerun.world import Bounds, widen_plane
from turtlelog.log import Surroundings

POSITIONS = "Points2D:positions"


def make_seen(*walls: tuple[float, float]) -> Surroundings:
    return Surroundings(
        time_ns=np.array([10_000, 20_000], dtype=np.int64),
        scans_xy_m=(np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[5.0, 6.0]])),
        walls_xy_m=np.array(walls).reshape(-1, 2),
        map_xy_m=np.zeros((0, 2)),
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
