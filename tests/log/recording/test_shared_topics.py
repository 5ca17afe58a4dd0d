"""The poses once more, by which other programs know a robot."""

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader
from rosbags.highlevel import AnyReader

import turtlelog as tl
from tests.log.runs import assert_same, simulate_preset
from turtlelog.log.recording import run_writer
from turtlelog.log.recording.run_writer import build_shared_messages, export_rosbag2, list_unshared
from turtlelog.run import Run


@pytest.fixture(scope="module")
def run() -> Run:
    return simulate_preset("paper-kp4")


@pytest.fixture(scope="module")
def bag(run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "kp4"
    export_rosbag2(run, path, shares_poses=True)
    return path


def read_all(bag: Path) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    with AnyReader([bag]) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            found.setdefault(connection.topic, []).append(message)
    return found


def test_what_is_read_back_is_the_same_run(bag: Path, run: Run) -> None:
    assert_same(tl.read_run(bag), run)
    assert_same(tl.read_run(bag / "kp4_0.mcap"), run)


def test_rosbags_reads_the_poses_of_all_three_topics(bag: Path, run: Run) -> None:
    found = read_all(bag)
    odometry, (path,) = found["/odom"], found["/path"]
    transforms = [message.transforms[0] for message in found["/tf"]]
    assert {len(odometry), len(transforms), len(path.poses)} == {len(run.poses)}
    places = [[one.pose.pose.position.x, one.pose.pose.position.y] for one in odometry]
    assert places == run.poses.xy_m.tolist()
    assert [[one.pose.position.x, one.pose.position.y] for one in path.poses] == places
    moves = [one.transform.translation for one in transforms]
    assert [[one.x, one.y] for one in moves] == places
    turns = [one.transform.rotation for one in transforms]
    headings = [2.0 * math.atan2(one.z, one.w) for one in turns]
    assert headings == pytest.approx(run.poses.heading_rad.tolist(), abs=1e-15)
    stamps = [one.header.stamp.sec * 10**9 + one.header.stamp.nanosec for one in transforms]
    assert stamps == run.poses.time_ns.tolist()
    assert {(one.header.frame_id, one.child_frame_id) for one in transforms} == {
        ("world", "turtle1")
    }
    speed_m_s = run.poses.speed_m_s
    assert speed_m_s is not None
    assert [abs(one.twist.twist.linear.x) for one in odometry] == speed_m_s.tolist()


def test_each_topic_stands_once(bag: Path) -> None:
    names = [topic.topic for topic in tl.read_info(bag / "kp4_0.mcap").topics]
    assert len(names) == len({*names})
    assert {"/odom", "/tf", "/path", "/turtle1/pose"} <= {*names}


def test_one_who_records_them_again_is_read_by_turtlesims_own_topic(bag: Path, run: Run) -> None:
    again = tl.log.read_bag(bag)
    assert again.notes["pose_topic"] == "/turtle1/pose (turtlesim/msg/Pose)"
    assert again.path is None
    assert again.poses.xy_m.tolist() == run.poses.xy_m.tolist()


def test_rerun_shows_the_transforms_of_its_own_reading(bag: Path, tmp_path: Path) -> None:
    rrd = tmp_path / "kp4.rrd"
    program = Path(sys.executable).with_name("rerun")
    words = [str(program), "mcap", "convert", str(bag / "kp4_0.mcap"), "-o", str(rrd)]
    subprocess.run(words, check=True, capture_output=True, timeout=60)
    columns = {
        name
        for chunk in RrdReader(rrd).stream()
        if chunk.entity_path == "/tf"
        for name in chunk.to_record_batch().schema.names
    }
    assert {"Transform3D:translation", "Transform3D:quaternion"} <= columns


def test_speeds_of_motion_backward_are_negative_and_unknown_ones_are_nan(run: Run) -> None:
    back = replace(run.poses, xy_m=run.poses.xy_m[::-1].copy())
    (odometry, *_) = build_shared_messages(replace(run, poses=back))
    speeds = odometry.fields["twist.twist.linear.x"]
    assert speeds.min() == pytest.approx(-1.0)
    bare = replace(run.poses, speed_m_s=None, turn_rate_rad_s=None)
    (odometry, *_) = build_shared_messages(replace(run, poses=bare))
    assert np.isnan(odometry.fields["twist.twist.linear.x"]).all()
    assert np.isnan(odometry.fields["twist.twist.angular.z"]).all()


def test_a_drive_of_too_many_poses_is_not_written_twice(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_writer, "MOST_SHARED", len(run.poses))
    assert not list_unshared(run)
    assert len(build_shared_messages(run)) == 3
    monkeypatch.setattr(run_writer, "MOST_SHARED", len(run.poses) - 1)
    assert "are more than" in list_unshared(run)[0]
    assert not build_shared_messages(run)


def test_times_that_no_stamp_holds_are_not_written_twice(run: Run) -> None:
    for latest_s, count in ((2**31 - 1, 3), (2**31, 0)):
        time_ns = run.poses.time_ns.copy()
        time_ns[-1] = latest_s * 10**9
        late = replace(run, poses=replace(run.poses, time_ns=time_ns))
        assert len(build_shared_messages(late)) == count
        assert len(list_unshared(late)) == (count == 0)
