"""What a robot measured, kept in recordings and tables."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from tests.log.runs import assert_same, find_shared, simulate_short_run
from turtlelog.errors import LogError
from turtlelog.log import (
    export_csv,
    export_parquet,
    export_rosbag2,
    read_columns,
    read_recording,
    read_run,
    write_columns,
    write_recording,
)
from turtlelog.log.recording.head import parse_head
from turtlelog.run import Clock, Run

CLOCK = Clock(used="stamp", ratio=1.00001, offset_s=-0.78, jitter_s=None)


def make_robot(**columns: Any) -> Run:
    run = simulate_short_run()
    rows = np.arange(len(run.poses)) / 3.0
    measured = {"measured_speed_m_s": rows, "measured_turn_rate_rad_s": -rows} | columns
    return replace(run, poses=replace(run.poses, **measured), clock=CLOCK)


def test_measured_rates_and_the_clock_come_back(tmp_path: Path) -> None:
    run = make_robot()
    write_recording(run, tmp_path / "robot.mcap")
    found = read_recording(tmp_path / "robot.mcap")
    assert_same(found.poses, run.poses)
    assert_same(found.samples, run.samples)
    assert found.clock == CLOCK
    measured = read_columns(tmp_path / "robot.mcap", topics=["/turtle1/measured"])
    (columns,) = measured.values()
    assert columns.type == "geometry_msgs/msg/Twist"
    assert columns.log_time_ns.tolist() == run.poses.time_ns.tolist()
    assert columns.sequence.tolist() == [*range(len(run.poses))]


@pytest.mark.parametrize("name", ["measured_speed_m_s", "measured_turn_rate_rad_s"])
def test_one_rate_may_be_measured_alone(name: str, tmp_path: Path) -> None:
    run = make_robot(**{name: None})
    write_recording(run, tmp_path / "robot.mcap")
    poses = read_recording(tmp_path / "robot.mcap").poses
    assert getattr(poses, name) is None
    assert_same(poses, run.poses)


def test_a_recording_without_them_says_nothing_of_them(tmp_path: Path) -> None:
    run = simulate_short_run()
    write_recording(run, tmp_path / "run.mcap")
    found = read_recording(tmp_path / "run.mcap")
    assert found.clock is None
    assert found.poses.measured_speed_m_s is None
    with (tmp_path / "run.mcap").open("rb") as stream:
        reader = make_reader(stream)
        (record,) = reader.iter_metadata()
        summary = reader.get_summary()
    assert not {"clock", "more_topics"} & {*record.metadata}
    assert "measured" not in record.metadata["nan_columns"]
    assert summary is not None
    assert "/turtle1/measured" not in {found.topic for found in summary.channels.values()}
    assert parse_head(record.metadata).clock is None


def test_measurements_that_are_not_of_the_poses_are_refused(tmp_path: Path) -> None:
    write_recording(make_robot(), tmp_path / "robot.mcap")
    with (tmp_path / "robot.mcap").open("rb") as stream:
        (record,) = make_reader(stream).iter_metadata()
    columns = read_columns(tmp_path / "robot.mcap")
    names = [name for name in columns if name not in {"/rosout", "/turtle1/goal"}]
    kept = {name: columns[name] for name in names}
    kept["/turtle1/measured"] = kept["/turtle1/measured"].select(np.arange(5))
    path, metadata = tmp_path / "cut.mcap", {"turtlelog": record.metadata}
    write_columns([*kept.values()], path, metadata=metadata)
    with pytest.raises(LogError, match=r"topic /turtle1/measured: expected .* found 5 others"):
        read_recording(path)


def test_tables_and_bags_keep_what_was_measured(tmp_path: Path) -> None:
    run = make_robot()
    export_csv(run, tmp_path / "csv")
    export_rosbag2(run, tmp_path / "bag")
    for path in ("csv", "bag"):
        assert_same(read_run(tmp_path / path).poses, run.poses)
    assert read_run(tmp_path / "bag").clock == CLOCK
    pytest.importorskip("pyarrow")
    export_parquet(run, tmp_path / "parquet")
    found = read_run(tmp_path / "parquet")
    assert_same(found.poses, run.poses)
    assert found.clock == CLOCK


def test_a_real_robots_bag_is_converted_whole(tmp_path: Path) -> None:
    run = read_run(find_shared("robots", "tb3"))
    write_recording(run, tmp_path / "tb3.mcap")
    found = read_recording(tmp_path / "tb3.mcap")
    assert_same(found.poses, run.poses)
    assert_same(found.commands, run.commands)
    assert found.clock == run.clock
    assert found.poses.measured_turn_rate_rad_s is not None
    assert found.poses.measured_turn_rate_rad_s.min() == pytest.approx(-143.6, abs=0.1)
