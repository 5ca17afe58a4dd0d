"""Trajectories (.tum) that are read and written."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.log.plain_tables import write
from tests.log.runs import simulate_short_run
from turtlelog.errors import LogError
from turtlelog.log import export_tum
from turtlelog.log.any_file import read_run, read_trajectory
from turtlelog.log.table_files import require_same_poses
from turtlelog.run import Clock, Origin, build_planar_trajectory


def test_a_tum_trajectory_is_read(tmp_path: Path) -> None:
    rows = ["1700000000.5 1 2 0 0 0 0 1", "1700000001.5 1.5 2 0.2 0 0 1 1"]
    for suffix in ("tum", "txt"):
        run = read_run(write(tmp_path, "# made by hand", *rows, suffix=suffix))
        assert run.source == f"tum: drive.{suffix}"
        assert run.poses.time_ns.tolist() == [0, 1_000_000_000]
        assert run.poses.xy_m.tolist() == [[1.0, 2.0], [1.5, 2.0]]
        assert run.poses.heading_rad.tolist() == [0.0, math.pi / 2]
        assert run.notes["columns"].startswith("t from timestamp [s], x from tx [m], y from ty [m]")
        assert "height varies by 0.2 m" in run.notes["plane"]
        assert run.notes["original_timestamp"] == "2023-11-14T22:13:20.500000000Z"


def test_rotations_too_long_for_a_heading_are_refused_in_one_line(tmp_path: Path) -> None:
    rows = (f"{row} 0 0 0 1e308 1e308 1e308 1e308" for row in range(3))
    path = write(tmp_path, *rows, suffix="tum")
    with pytest.raises(LogError, match="no row has x, y and heading"):
        read_run(path)


def test_a_tum_trajectory_comes_back_to_the_last_bit(tmp_path: Path) -> None:
    run = simulate_short_run()
    (path,) = export_tum(run, tmp_path / "kp4.tum")
    lines = path.read_text(encoding="ascii").splitlines()
    assert {len(line.split(" ")) for line in lines} == {8}
    assert lines[1].startswith("0.016000000 ")
    found = read_run(path).poses
    assert found.time_ns.tolist() == run.poses.time_ns.tolist()
    assert found.xy_m.tolist() == run.poses.xy_m.tolist()
    assert np.abs(found.heading_rad - run.poses.heading_rad).max() < 1e-15
    require_same_poses(path, run)


@pytest.mark.parametrize(
    ("old", "new", "column"),
    [("0.016000000", "0.016000001", "time_ns"), (" 5.5", " 5.6", "xy_m"), ("1.0\n", "0.9\n", "")],
)
def test_a_trajectory_that_is_not_what_was_written_is_refused(
    old: str, new: str, column: str, tmp_path: Path
) -> None:
    run = simulate_short_run()
    (path,) = export_tum(run, tmp_path / "kp4.tum")
    path.write_text(path.read_text().replace(old, new))
    if not column:  # a quaternion of another length is the same rotation
        require_same_poses(path, run)
        return
    with pytest.raises(LogError, match=rf"kp4\.tum: .* found other values in {column}"):
        require_same_poses(path, run)


@pytest.mark.parametrize("turned", [1.5e-15, 3e-15])
def test_headings_may_be_rounded_but_no_more(turned: float, tmp_path: Path) -> None:
    run = simulate_short_run()
    poses = replace(run.poses, heading_rad=np.full(len(run.poses), 1.5))
    other = replace(run, poses=replace(poses, heading_rad=poses.heading_rad + turned))
    (path,) = export_tum(other, tmp_path / "kp4.tum")
    if turned < 2e-15:
        require_same_poses(path, replace(run, poses=poses))
    else:
        with pytest.raises(LogError, match="other values in heading_rad"):
            require_same_poses(path, replace(run, poses=poses))


@pytest.mark.parametrize(
    ("start_ns", "offset_s", "first"),
    [
        (1_700_000_000_500_000_001, None, "1700000000.500000001"),
        (1_700_000_000_500_000_001, 0.003, "1700000000.497000001"),  # times are stamps
        (-100_000_000, None, "-0.100000000"),
        (None, None, "0.000000000"),  # as in the paper's logs, whose date is not of the first pose
    ],
)
def test_a_trajectory_has_the_times_of_its_source(
    start_ns: int | None, offset_s: float | None, first: str, tmp_path: Path
) -> None:
    clock = None if offset_s is None else Clock(used="stamp", ratio=1.0, offset_s=offset_s)
    origin = Origin(began_ns=1_700_000_000_000_000_000, start_ns=start_ns)
    run = replace(simulate_short_run(), origin=origin, clock=clock)
    (path,) = export_tum(run, tmp_path / "kp4.tum")
    assert path.read_text().startswith(f"{first} ")
    require_same_poses(path, run)
    assert read_trajectory(path).time_ns[0] == build_planar_trajectory(run).time_ns[0]


@pytest.mark.parametrize("rows", [-1, 1])
def test_a_trajectory_of_more_or_fewer_poses_is_refused(rows: int, tmp_path: Path) -> None:
    run = simulate_short_run()
    (path,) = export_tum(run, tmp_path / "kp4.tum")
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:-1] if rows < 0 else [*lines, "9.5 0 0 0 0 0 0 1\n"]))
    with pytest.raises(LogError, match="other values in time_ns"):
        require_same_poses(path, run)
