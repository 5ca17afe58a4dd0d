"""One name has one value: how long a file lasts, and how long its run does."""

from pathlib import Path
from typing import Any

import pytest

import turtlelog as tl
from tests.cli.conftest import Call
from tests.cli.test_info import MS, make_drive
from tests.log.ros2.bags import START_NS, make_command, write_mcap
from tests.log.ros2.test_unread_encodings import write_encoded
from tests.log.runs import find_shared
from turtlelog.log.recording import recorder
from turtlelog.simulate.collect import run_live


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Poses from 0 to 1.95 s; a command 0.3 s before them, one 0.4 s after; a text still later."""
    early = make_command(topic="/cmd_vel", time_ns=START_NS - 300 * MS)
    late = make_command(topic="/cmd_vel", time_ns=START_NS + 2350 * MS, number=1)
    return write_mcap(tmp_path / "bag.mcap", [*make_drive(), early, late])


def measure_duration(call: Call, path: Path) -> float:
    ((metric,),) = [
        one["metrics"] for one in call("metrics", path, "--metric", "run.duration", "--json").json
    ]
    return float(metric["value"])


def test_info_tells_how_long_a_file_lasts_from_how_long_its_run_does(call: Call, bag: Path) -> None:
    (answer,) = call("info", bag, "--json").json
    assert answer["duration_s"] == 2.65
    assert answer["run_duration_s"] == measure_duration(call, bag) == 2.35
    text = call("info", bag).flat
    assert " duration 2.650 s, from the first to the last message of any topic " in text
    assert " run.duration 2.350 s, from the first pose to the last pose or command " in text


def test_explain_gives_the_duration_that_metrics_gives(call: Call, bag: Path) -> None:
    assert "A robot, not turtlesim, run.duration 2.350 s, of /odom" in call("explain", bag).out
    assert call("explain", bag, "--json").json["motion"]["run_duration_s"] == 2.35


def test_a_recording_names_the_first_message_and_the_first_sample(call: Call, kp10: Path) -> None:
    (answer,) = call("info", kp10, "--json").json
    assert (answer["duration_s"], answer["run_duration_s"]) == (12.672, None)
    text = call("info", kp10).out
    assert "  duration    12.672 s, from the first to the last message of any topic\n" in text
    assert measure_duration(call, kp10) == 12.608


def test_a_table_lasts_from_its_first_row_to_its_last(
    call: Call, kp4: Path, tmp_path: Path
) -> None:
    run = tl.read_recording(kp4)
    call("convert", kp4, "-o", tmp_path / "kp4.csv", "--table", "poses")
    (answer,) = call("info", tmp_path / "kp4.csv", "--json").json
    assert answer["duration_s"] == answer["run_duration_s"] == run.poses.time_ns[-1] / 1e9


@pytest.mark.parametrize("name", ["kp4", "bag"])
def test_a_run_has_the_duration_of_its_metric(name: str, request: Any) -> None:
    run = tl.read_run(request.getfixturevalue(name))
    assert run.duration_s == tl.measure_run(run)["run.duration"].value
    digits = 4 if run.goal_xy_m is None else 3
    assert f"{run.duration_s:.{digits}g} s, " in run._repr_html_()


@pytest.mark.parametrize("size", [800, 1294, 4000])
def test_a_recording_that_lost_everything_says_what_is_absent(
    size: int, call: Call, kp10: Path, tmp_path: Path
) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(kp10.read_bytes()[:size])
    (answer,) = call("info", cut, "--json").json
    lost = ["poses", "commands", "samples", "goal_xy_m"]
    assert answer["absent"] == [*lost, *([] if answer["scenario"] else ["parameters"])]
    assert answer["summary"].startswith("a recording of turtlelog's, truncated: no message can be")
    text = call("info", cut).out
    assert "Fix: copy the file again from its source\n" in text
    assert "absent poses, commands, samples, goal" in " ".join(text.split())


def test_a_recording_that_lost_its_end_lacks_nothing_else(
    call: Call, kp10: Path, tmp_path: Path
) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(kp10.read_bytes()[:-3000])
    (answer,) = call("info", cut, "--json").json
    assert answer["absent"] == []
    assert answer["summary"].startswith("a recording of turtlelog's, not complete: sequential-p")


def test_a_third_party_file_that_lost_everything_says_so(call: Call, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "bag.mcap", make_drive())
    path.write_bytes(path.read_bytes()[:60])
    (answer,) = call("info", path, "--json").json
    assert answer["absent"][:2] == ["poses", "commands"]
    assert answer["summary"] == "truncated: no message can be recovered"


def test_what_a_bag_lacks_is_absent_from_its_run(call: Call, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "bag.mcap", make_drive())
    (answer,) = call("info", path, "--json").json
    assert answer["absent"][:2] == ["commands", "samples"]
    assert "commands" in tl.read_run(path).absent


def test_a_bag_of_other_messages_lacks_poses_and_commands(call: Call) -> None:
    path = find_shared("ros2", "rosbag2_talker.mcap")
    assert call("info", path, "--json").json[0]["absent"][:2] == ["poses", "commands"]


def test_a_bag_of_commands_alone_lacks_poses(call: Call, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "bag.mcap", [make_command()])
    assert call("info", path, "--json").json[0]["absent"][:2] == ["poses", "samples"]


def test_poses_that_cannot_be_read_are_absent(call: Call, tmp_path: Path) -> None:
    path = write_encoded(tmp_path / "a.mcap", "cbor", "", "nav_msgs/Odometry")
    assert call("info", path, "--json").json[0]["absent"][:2] == ["poses", "commands"]


def test_a_part_of_a_recording_lacks_what_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder, "LIVE_CHUNK_BYTES", 2**13)
    path, scenario = tmp_path / "cut.mcap", tl.load_scenario("paper-kp4")
    with recorder.Recorder(path, scenario) as recording:
        run_live(scenario, [recording], realtime=False)
    data = bytearray(path.read_bytes())
    data[2500] ^= 255  # in the first chunk, which holds the goal
    path.write_bytes(data)
    with pytest.warns(tl.log.PartialRecordingWarning):
        run = tl.read_recording(path, allow_partial=True)
    assert (run.goal_xy_m, run.absent) == (None, ("goal_xy_m",))
