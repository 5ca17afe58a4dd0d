from dataclasses import replace
from pathlib import Path

import pytest

from tests.cli.conftest import Call
from tests.log.ros2.bags import make_command, make_poses, make_stamped_pose, write_mcap
from tests.log.runs import find_shared

EXACT = {"x": 0.0, "y": 0.0, "heading": 0.0}


def test_replay_answers_in_json(call: Call) -> None:
    path = find_shared("ros2", "turtlesim_jazzy")
    answer = call("replay", path, "--plant", "--json").json
    assert (answer["file"], answer["mode"], answer["samples"]) == (str(path), "plant", 2501)
    assert (answer["max_abs_error"], answer["first_difference"]) == (EXACT, None)
    first, second = answer["stretches"]
    assert (first["start_s"], first["ticks"], first["max_abs_error"]) == (0.0, 877, EXACT)
    assert (answer["within_rounding"], answer["heading_bits"]) == (True, 64)
    assert (first["within_rounding"], second["within_rounding"]) == (True, True)
    assert (second["end_s"], second["rounding"]["heading"]) == (42.066412176, 2.0**-22)
    assert [(gap["start_s"], gap["missing_ticks"]) for gap in answer["gaps"]] == [
        (14.032113878, 99)
    ]
    assert [(jump["at_s"], jump["kind"]) for jump in answer["jumps"]] == [(15.632487045, "spawn")]


def test_replay_prints_stretches_and_what_lies_between(call: Call) -> None:
    bag = find_shared("ros2", "turtlesim_jazzy")
    answer = call("replay", bag, "--plant")
    chosen = "poses from /turtle1/pose (turtlesim/msg/Pose), commands from /turtle1/cmd_vel"
    line = f"{bag}: {chosen} (geometry_msgs/msg/Twist)\n"
    assert (answer.code, answer.err) == (0, line)
    rows = [line.split()[:3] for line in answer.out.splitlines()]
    assert ["15.632", "42.066", "1622"] in rows
    assert "14.032 s: gap of 1.600 s: 99 ticks\n15.632 s: jump (spawn) to x = 5.544 m" in answer.out


@pytest.mark.parametrize(
    ("off_m", "sentence"),
    [
        (0.0, "a.mcap: the plant reproduces every pose."),
        (5e-7, "a.mcap: the largest difference is within what 32-bit poses can tell."),
        (2e-6, "a.mcap: the largest difference is 1.42 times what 32-bit poses can tell."),
    ],
)
def test_replay_says_whether_rounding_explains_the_differences(
    call: Call, tmp_path: Path, off_m: float, sentence: str
) -> None:
    poses = make_poses(9, linear_velocity=0.0, angular_velocity=0.0)
    poses[4] = replace(poses[4], values={**poses[4].values, "x": poses[4].values["x"] + off_m})
    path = write_mcap(tmp_path / "a.mcap", poses)
    assert call("replay", path, "--plant").out.splitlines()[0] == sentence
    answer = call("replay", path, "--plant", "--json").json
    assert answer["within_rounding"] is answer["stretches"][0]["within_rounding"] is (off_m < 1e-6)


def test_replay_counts_time_from_the_first_sample(call: Call, kp4: Path) -> None:
    [stretch] = call("replay", kp4, "--plant", "--json").json["stretches"]
    assert (stretch["start_s"], stretch["end_s"], stretch["max_abs_error"]) == (
        -0.08,
        11.184,
        EXACT,
    )


def test_replay_says_where_no_command_explains_the_motion(call: Call, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", make_poses(5))
    assert "No recorded command explains 5 ticks" in call("replay", path, "--plant").out
    assert call("replay", path, "--plant", "--json").json["commands"]["taken"] == 0


def test_topics_of_a_bag_are_chosen_by_option(call: Call, tmp_path: Path) -> None:
    turtles = [pose for name in "ab" for pose in make_poses(3, topic=f"/{name}/pose", x=ord(name))]
    path = write_mcap(tmp_path / "a.mcap", [*turtles, make_command(topic="/a/cmd_vel")])
    # That there are commands beside them tells whose poses are meant.
    answer = call("metrics", path)
    assert (answer.code, "also there: /b/pose: --pose-topic" in answer.err) == (0, True)
    for command in (["metrics"], ["replay", "--plant"], ["compare", path]):
        assert call(*command, path, "--pose-topic", "/b/pose").code == 0


def test_commands_take_a_run_of_bare_poses(call: Call, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", [make_stamped_pose()])
    (answer,) = call("metrics", path, "--json").json
    values = {metric["id"]: metric["value"] for metric in answer["metrics"]}
    known = {name: value for name, value in values.items() if value is not None}
    names = ["duration", "path_length", "net_displacement", "total_turning"]
    names += ["duplicates", "disorder"]
    assert known == {f"run.{name}": 0.0 for name in names}
    assert call("view", path, "--save", tmp_path / "a.rrd").code == 0
    assert call("info", path).code == 0
    assert call("check", "--init", path, "-o", tmp_path / "a.toml").code == 0


def test_info_tells_a_bag_by_its_folder(call: Call) -> None:
    path = find_shared("ros2", "turtlesim_jazzy")
    (answer,) = call("info", path, "--json").json
    assert (answer["source"], answer["duration_s"]) == ("rosbag2: turtlesim_jazzy", 42.066412176)
    assert [topic["count"] for topic in answer["topics"]] == [18, 2501]


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["replay", "a.mcap", "--plant"], "a.mcap: no poses with the applied velocities"),
        (["metrics", "empty"], "empty: no recordings in this folder"),
        (["metrics", "a.mcap", "--pose-topic", "/b"], "pose_topic: expected a topic with messages"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_bad_input_is_one_line(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], line: str
) -> None:
    monkeypatch.chdir(tmp_path)
    write_mcap(Path("a.mcap"), [make_stamped_pose()])
    Path("empty").mkdir()
    answer = call(*words)
    assert (answer.code, answer.out) == (2, "")
    *read, last = answer.err.splitlines()
    assert line in last
    assert not [text for text in read if "error" in text]
