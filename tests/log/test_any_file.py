from pathlib import Path
from typing import BinaryIO

import pytest

from tests.log.ros2.bags import make_poses, make_stamped_pose, write_mcap, write_metadata
from tests.log.ros2.robots import say_odometry, write_robot
from tests.log.runs import assert_same, find_shared, simulate_short_run
from turtlelog.errors import LogError
from turtlelog.log import read_file_info, split_topic, write_recording
from turtlelog.log.any_file import read_run
from turtlelog.log.engine import opening
from turtlelog.log.file_access import open_file
from turtlelog.log.recording.run_writer import export_rosbag2


def test_a_recording_of_turtlelogs_is_read_whole(tmp_path: Path) -> None:
    run = simulate_short_run()
    write_recording(run, tmp_path / "run.log")
    assert_same(read_run(tmp_path / "run.log"), run)


def test_a_bag_around_a_recording_of_turtlelogs_is_that_recording(tmp_path: Path) -> None:
    run = simulate_short_run()
    export_rosbag2(run, tmp_path / "bag")
    assert_same(read_run(tmp_path / "bag"), run)


def test_a_topic_asked_for_reads_a_recording_of_turtlelogs_as_a_bag(tmp_path: Path) -> None:
    write_recording(simulate_short_run(), tmp_path / "run.mcap")
    assert read_run(tmp_path / "run.mcap", pose_topic="/turtle1/goal").poses.xy_m.tolist() == [
        [2.0, 10.0]
    ]


def test_other_peoples_files_and_folders_are_read_as_bags(tmp_path: Path) -> None:
    write_mcap(tmp_path / "a.mcap", [*make_poses(4), make_stamped_pose("/other")])
    assert read_run(tmp_path / "a.mcap").source == "mcap: a.mcap"
    folder = write_metadata(tmp_path, ["a.mcap"])
    assert read_run(folder).source == f"rosbag2: {tmp_path.name}"
    assert len(read_run(folder, pose_topic="/other").poses) == 1


def test_a_log_of_the_papers_is_imported() -> None:
    assert len(read_run(find_shared("paper", "kp1_210.json")).samples) == 1265


@pytest.mark.parametrize(
    ("name", "content", "line"),
    [
        (
            "a.db3",
            b"SQLite format 3\0" + bytes(100),
            "expected a SQLite file of pages of 65536 bytes, found 116 bytes: cut short",
        ),
        ("a.mcap", bytes(100), "only zero bytes; copy the file again from its source"),
        (
            "a.db3",
            bytes(100),
            r"only zero bytes; copy the file again from its source",
        ),
        ("a.db3", b"text, text", r"byte 0: not a bag in SQLite: it begins with 0x746578742c"),
        ("a.db3", b"", "expected a bag in SQLite, found an empty file"),
        ("a.log", b"timestamp,time", ".* it is text; names of logs and tables end in"),
        ("a.json", b"{", r"expected JSON, found"),
    ],
)
def test_what_cannot_be_read_is_named(name: str, content: bytes, line: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(LogError, match=rf"{name}: {line}"):
        read_run(tmp_path / name)


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"a\.mcap: no such file"):
        read_run(tmp_path / "a.mcap")


def test_a_damaged_recording_says_where(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write_recording(simulate_short_run(), path)
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(LogError, match=r"run\.mcap: .*no end of an MCAP file"):
        read_run(path)


def test_a_recording_is_opened_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, opened = tmp_path / "run.mcap", list[Path]()
    write_recording(simulate_short_run(), path)

    def count(place: Path) -> BinaryIO:
        opened.append(place)
        return open_file(place)

    monkeypatch.setattr(opening, "open_file", count)
    read_run(path)
    assert opened == [path]


def test_a_file_and_a_topic_are_one_word(tmp_path: Path) -> None:
    file = write_robot(tmp_path, say_odometry("/odom"), say_odometry("/a/kf", x_m=5.0))
    run = read_run(f"{file}:/a/kf")
    assert (run.name, run.poses.xy_m[0, 0]) == ("robot:/a/kf", 5.0)
    folder = write_metadata(tmp_path, ["robot.mcap"])
    assert read_run(f"{folder}:/a/kf").name == f"{tmp_path.name}:/a/kf"
    # It says more than what is asked of all files.
    assert read_run(f"{file}:/a/kf", pose_topic="/odom").poses.xy_m[0, 0] == 5.0
    assert {topic.topic for topic in read_file_info(f"{file}:/a/kf").topics} == {"/odom", "/a/kf"}


def test_a_file_of_the_whole_name_comes_first(tmp_path: Path) -> None:
    write_robot(tmp_path, say_odometry())
    bag = tmp_path / "robot.mcap:"
    bag.mkdir()
    write_robot(bag, say_odometry(x_m=5.0), name="odom")
    assert split_topic(bag / "odom.mcap") == (bag / "odom.mcap", None)
    assert split_topic(f"{tmp_path}/robot.mcap:/odom") == (tmp_path / "robot.mcap", "/odom")
    assert split_topic("nothing.mcap:/odom") == (Path("nothing.mcap:/odom"), None)


def test_a_topic_of_a_recording_of_turtlelogs_loses_nothing_where_it_is_the_poses(
    tmp_path: Path,
) -> None:
    run = simulate_short_run()
    write_recording(run, tmp_path / "run.mcap")
    assert_same(read_run(f"{tmp_path}/run.mcap:/turtle1/pose"), run)
    assert read_run(f"{tmp_path}/run.mcap:/turtle1/goal").name.endswith(":/turtle1/goal")


def test_a_topic_that_is_not_there_and_one_of_a_log_are_one_line(tmp_path: Path) -> None:
    file = write_robot(tmp_path, say_odometry())
    with pytest.raises(LogError, match=r"robot\.mcap: pose_topic: .* found /nothing among /odom"):
        read_run(f"{file}:/nothing")
    with pytest.raises(LogError, match=r"robot\.mcap: expected a topic /nothing, found /odom"):
        read_file_info(f"{file}:/nothing")
    (tmp_path / "a.json").write_text("{}")
    with pytest.raises(LogError, match="expected a bag, of which /odom is read, found a log"):
        read_run(f"{tmp_path}/a.json:/odom")


def test_a_goal_is_asked_of_a_robot_but_not_of_a_controllers_recording(tmp_path: Path) -> None:
    write_recording(simulate_short_run(), tmp_path / "run.mcap")
    with pytest.raises(LogError, match="goal: expected none beside the samples of a controller"):
        read_run(tmp_path / "run.mcap", goal=(1.0, 2.0))
