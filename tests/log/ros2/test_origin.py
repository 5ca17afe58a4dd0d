"""The origin of a run: facts that later stages read, and that recordings store."""

from pathlib import Path
from typing import Any

import pytest

import turtlelog as tl
from tests.log.ros2.bags import START_NS, make_poses, write_mcap
from tests.log.ros2.robots import say_goal, say_odometry, say_path, write_robot
from tests.log.runs import find_shared
from turtlelog.errors import LogError, RunError
from turtlelog.log.recording.head import format_head, parse_head, sum_up_record
from turtlelog.log.recording.run_writer import describe_run
from turtlelog.run import Origin, Run, SourceTopic


def convert(run: Run, folder: Path) -> Run:
    tl.write_recording(run, folder / "converted.mcap")
    return tl.read_run(folder / "converted.mcap")


@pytest.mark.parametrize(
    "name", ["tb3", "sim_time", "turtlesim_sqlite", "tf_only", "neato_wall", "amcl_pose"]
)
def test_a_converted_bag_has_the_origin_of_the_bag(name: str, tmp_path: Path) -> None:
    run = tl.read_run(find_shared("robots", name))
    found = convert(run, tmp_path)
    assert found.origin == run.origin
    assert (found.source_start_ns, found.goal_row) == (run.source_start_ns, run.goal_row)
    metrics = [
        {id_: str(one) for id_, one in tl.measure_run(each).items()} for each in (run, found)
    ]
    for of_run in metrics:
        for id_ in ("run.path_length_in_space", "run.tilt_max", "run.height_range"):
            del of_run[id_]  # recordings are planar
    assert metrics[0] == metrics[1]


def test_topics_and_frames_are_fields() -> None:
    origin = tl.read_run(find_shared("robots", "tf_only")).origin
    tf = SourceTopic(name="/tf", type="tf2_msgs/msg/TFMessage", frames=("odom", "base_footprint"))
    assert (origin.poses, origin.frame) == (tf, "odom")
    assert origin.commands == SourceTopic(
        name="/controller/cmd_vel", type="geometry_msgs/msg/Twist"
    )


def test_a_topic_may_have_blanks_and_brackets_in_its_name(tmp_path: Path) -> None:
    bag = write_mcap(tmp_path / "bag.mcap", make_poses(topic="/left pose (raw)"))
    run = convert(tl.read_run(bag), tmp_path)
    assert run.origin.poses == SourceTopic(name="/left pose (raw)", type="turtlesim/msg/Pose")


def test_times_of_goal_and_path_are_kept(tmp_path: Path) -> None:
    rows, goal = say_odometry(count=9), say_goal(5.0, 0.0, at_s=3.0)
    run = tl.read_run(write_robot(tmp_path, rows, goal, say_path((0.0, 0.0), (5.0, 0.0), at_s=4.0)))
    found = convert(run, tmp_path)
    assert (run.goal_row, run.path_row) == (found.goal_row, found.path_row) == (3, 4)
    assert (run.origin.began_ns, run.origin.start_ns) == (START_NS, START_NS)


def test_repeated_rows_are_counted_after_conversion(tmp_path: Path) -> None:
    poses = make_poses(9)
    run = tl.read_run(write_mcap(tmp_path / "bag.mcap", [*poses, poses[-1]]))
    for one in (run, convert(run, tmp_path)):
        assert one.origin.dropped_duplicates == 1
        assert tl.measure_run(one)["run.duplicates"].value == 1.0


def test_a_bag_of_a_far_future_has_no_date() -> None:
    late = Origin(began_ns=2**62, start_ns=-(2**62))
    assert (late.began_ns, late.start_ns) == (None, None)
    assert Origin(began_ns=2**62 - 1).began_ns == 2**62 - 1


@pytest.mark.parametrize("name", ["sorted_rows", "dropped_duplicates"])
@pytest.mark.parametrize("count", [-1, 2**62, 10**400])
def test_a_number_of_rows_is_a_count(name: str, count: int) -> None:
    wrong: dict[str, Any] = {name: count}
    with pytest.raises(RunError, match=f"origin.{name}: expected a number of rows"):
        Origin(**wrong)
    largest: dict[str, Any] = {name: 2**62 - 1}
    assert getattr(Origin(**largest), name) == 2**62 - 1


def test_a_simulated_recording_stores_no_origin() -> None:
    run = tl.simulate_run(tl.load_scenario("paper-kp4"))
    assert "origin" not in format_head(describe_run(run))


@pytest.mark.parametrize(
    "entry",
    [
        *('{"poses": "/odom"}', '{"lost": "everything"}', '{"frame": 3}', "[", "7"),
        *('{"sorted_rows": -1}', f'{{"dropped_duplicates": {2**62}}}', '{"sorted_rows": 1e400}'),
    ],
)
def test_an_origin_that_turtlelog_does_not_write_is_an_error(entry: str) -> None:
    run = tl.simulate_run(tl.load_scenario("paper-kp4"))
    record = format_head(describe_run(run)) | {"origin": entry}
    with pytest.raises(LogError, match="metadata turtlelog: origin: "):
        parse_head(record | {"checksum": sum_up_record(record)})
