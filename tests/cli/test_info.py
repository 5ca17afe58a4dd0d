"""The sentence that `info` begins with, and what it says of clocks and of what is missing."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer

import turtlelog as tl
from tests.cli.conftest import Call
from tests.log.ros2.bags import START_NS, Said, make_command, make_odometry, make_poses, write_mcap
from tests.log.ros2.robots import say_goal
from tests.log.runs import find_shared
from turtlelog.cli import work

MS = 1_000_000


def make_drive(count: int = 40, *, commands: int = 0, late_ms: int = 0) -> list[Said]:
    """Return odometry at 20 Hz, with stamps of a robot's clock, and commands at 10 Hz."""
    odometry = make_odometry(yaw_rad=0.5, speed=(1.0, 0.0), turn_rate=0.0)
    messages = []
    for row in range(count):
        time_ns = START_NS + row * 50 * MS
        stamp = {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}
        values = odometry.values | {"header": {"stamp": stamp, "frame_id": "odom"}}
        messages.append(replace(odometry, values=values, time_ns=time_ns + late_ms * MS))
    return messages + [
        make_command(topic="/cmd_vel", time_ns=START_NS + row * 100 * MS, number=row)
        for row in range(commands)
    ]


@pytest.mark.parametrize(
    ("parts", "summary", "ratio"),
    [
        (
            ("robots", "tb3"),
            "a robot: /odom at 20 Hz, commands on /cmd_vel at 9.88 Hz; not turtlesim",
            1.0,
        ),
        (
            ("robots", "sim_time"),
            "a robot: /odom at 29.4 Hz, no commands; not turtlesim",
            0.2227,
        ),
        (
            ("robots", "tf_only"),
            "a robot: /tf (odom -> base_footprint) at 29.6 Hz, commands on /controller/cmd_vel at"
            " 10 Hz; not turtlesim",
            1.0,
        ),
        (
            ("robots", "turtlesim_sqlite"),
            "turtlesim: /turtle1/pose at 62.5 Hz, 8 commands on /turtle1/cmd_vel",
            None,
        ),
        (
            ("ros2", "rosbag2_talker.mcap"),
            "no poses, nothing to measure: messages on /rosout (rcl_interfaces/msg/Log) and /topic"
            " (std_msgs/msg/String)",
            None,
        ),
    ],
)
def test_real_files_are_called_what_they_are(
    parts: tuple[str, ...], summary: str, ratio: float | None, call: Call
) -> None:
    (answer,) = call("info", find_shared(*parts), "--json").json
    assert answer["summary"] == summary
    assert (answer["clock"] is None) == (ratio is None)
    if ratio is not None:
        assert answer["clock"]["ratio"] == pytest.approx(ratio, abs=1e-4)
        assert set(answer["clock"]) == {"used", "ratio", "offset_s", "jitter_s"}


def test_what_a_real_robot_did_wrong_is_noted(call: Call) -> None:
    out = call("info", find_shared("robots", "tb3")).out
    assert "  measured turn rate  1 outlier, -143.6 rad/s at 31.7 s\n" in out
    assert "  jumps               1 jump, 0.00726 m back at 31.7 s, 0.0112 m more than it\n" in out


@pytest.mark.parametrize(("share", "is_told"), [(0.3, True), (0.03, True), (0.0, False)])
def test_rows_that_are_missing_from_an_even_rate_are_told(
    call: Call, share: float, tmp_path: Path, *, is_told: bool
) -> None:
    kept = np.flatnonzero(np.random.default_rng(1).random(1000) >= share)
    rows = [f"{row / 50},{row / 100},0,0" for row in kept.tolist()]
    path = tmp_path / "drive.csv"
    path.write_text("\n".join(["t,x,y,yaw", *rows]), "utf-8")
    lost = 100.0 * (1.0 - len(kept) / 1000)
    mean = 50.0 * (len(kept) - 1) / (kept[-1] - kept[0])
    told = f", {lost:.0f} % fewer rows than at an even rate ({mean:.3g} Hz on average)"
    poses = call("info", path, "--json").json[0]["run"]["poses"]
    assert poses == f"50 Hz, {len(kept)} rows{told if is_told else ''}"


def test_a_robot_that_publishes_at_two_rates_lacks_none(call: Call, tmp_path: Path) -> None:
    steps = np.repeat(np.resize([1, 5], 40), np.resize([50, 10], 40))
    rows = [f"{row / 50},{row / 100},0,0" for row in np.cumsum(steps).tolist()]
    path = tmp_path / "drive.csv"
    path.write_text("\n".join(["t,x,y,yaw", *rows]), "utf-8")
    assert "missing" not in call("info", path, "--json").json[0]["run"]["poses"]


def test_what_a_file_is_comes_first_and_then_what_is_in_it_and_missing(
    call: Call, tmp_path: Path
) -> None:
    path = write_mcap(tmp_path / "bag.mcap", make_drive(commands=20, late_ms=5))
    lines = call("info", path).out.splitlines()
    assert lines[0] == "bag.mcap: ROS 2 bag of a robot (not turtlesim), 2.0 s"
    assert [" ".join(line.split()) for line in lines[2:4]] == [
        "poses /odom, 20 Hz, 40 messages",
        "commands /cmd_vel, 10 Hz, 20 messages",
    ]
    text = " ".join(" ".join(lines).split())
    assert "missing goal: --goal X,Y adds final.position_error and run.time_to_goal" in text
    assert "missing samples of a controller: only recordings of turtlelog have them" in text
    assert lines[1] == "You can: metrics, identify, check, compare, view, plot"
    (answer,) = call("info", path, "--json").json
    expected = {"used": "stamp", "ratio": 1.0, "offset_s": 0.005, "jitter_s": 0.0}
    assert answer["clock"] == expected
    assert answer["notes"]["clock"].startswith("poses are timed by their stamps + 0.005 s")


@pytest.mark.parametrize(("commands", "words"), [(19, "19 commands on /cmd_vel"), (0, "no")])
def test_few_commands_are_counted(commands: int, words: str, call: Call, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "bag.mcap", make_drive(commands=commands))
    (answer,) = call("info", path, "--json").json
    assert answer["summary"].startswith(f"a robot: /odom at 20 Hz, {words}")
    assert any("no commands" in text for text in answer["missing"]) == (commands == 0)


@pytest.mark.parametrize(("pause_ms", "words"), [(180, "at "), (220, "30 commands on")])
def test_commands_that_come_unsteadily_have_no_rate(
    pause_ms: int, words: str, call: Call, tmp_path: Path
) -> None:
    # Three in a row 100 ms apart, then a pause: 100 ms and three times that are steady yet.
    times = [START_NS + (row * 100 + row // 3 * pause_ms) * MS for row in range(30)]
    commands = [
        make_command(topic="/cmd_vel", time_ns=time_ns, number=row)
        for row, time_ns in enumerate(times)
    ]
    path = write_mcap(tmp_path / "bag.mcap", [*make_drive(), *commands])
    (answer,) = call("info", path, "--json").json
    assert words in answer["summary"].partition(", ")[2]


def test_scheduled_gains_are_told_beside_the_constant_ones(call: Call, tmp_path: Path) -> None:
    file, table = tmp_path / "a.mcap", "law.schedule."
    keys = (f"{table}over=heading_error", f"{table}at=[0, 1]", f"{table}kp_linear=[4, 2]")
    call("run", "paper-kp4", *(word for key in keys for word in ("--set", key)), "-o", file)
    told = "sequential-p, Kp = 4 1/s (turning and driving), with gains scheduled over the heading"
    assert told in " ".join(call("info", file).out.split())


def test_a_recording_of_ours_is_told_from_its_summary(
    call: Call, kp4: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("turtlelog.log.ros2.read_bag", pytest.fail)
    lines = call("info", kp4).out.splitlines()
    assert lines[:6] == [
        "kp4.mcap: turtlelog recording, complete, 11.3 s",
        "  run         paper-kp4",
        "  robot       turtlesim, simulated",
        "  controller  sequential-p, Kp = 4 1/s (turning and driving)",
        "  goal        (2, 10) m",
        "  data        705 poses, 681 controller samples, 681 commands",
    ]
    ended = "ended standstill: missed the goal by 8.52 mm (allowed: 6.69 mm) after 11.2 s"
    assert " ".join(" ".join(lines[6:8]).split()) == ended
    (answer,) = call("info", kp4, "--json").json
    assert answer["summary"] == (
        "a recording of turtlelog's: sequential-p on turtlesim, 681 samples and 705 poses in 11.3 s"
    )
    assert (answer["clock"], answer["missing"]) == (None, [])
    assert answer["ending"] == "missed the goal by 8.52 mm (allowed: 6.69 mm) after 11.2 s"


def test_how_a_run_ended_is_told_of_what_is_quickly_read_and_had_a_goal(
    call: Call, kp4: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = call("run", "paper-kp4").out
    assert "missed the goal by 8.52 mm (allowed: 6.69 mm) after 11.2 s" in told
    monkeypatch.setattr(work, "LARGEST_BYTES", kp4.stat().st_size - 1)
    assert "  ended       standstill\n" in call("info", kp4).out
    square = tmp_path / "square.mcap"
    assert call("run", "track-square", "-o", square).code == 0
    (answer,) = call("info", square, "--json").json
    assert answer["ending"] is None
    assert "goal" not in call("info", square).out


def test_a_note_of_several_lines_is_counted_and_one_of_one_line_is_printed(
    call: Call, tmp_path: Path
) -> None:
    notes = {"law_source": "def law(time_ns, pose, goal):\n    return 0.5, 0.0\n", "place": "desk"}
    run = tl.simulate_run("textbook", changes={"max_duration_s": 0.1})
    path = tmp_path / "a.mcap"
    tl.write_recording(replace(run, notes=notes), path)
    text = call("info", path).out
    assert "  law source  2 lines: --json has them\n" in text
    assert "  place       desk\n" in text
    assert call("info", path, "--json").json[0]["notes"]["law_source"] == notes["law_source"]


def test_of_large_bags_the_poses_are_read_where_that_is_asked_for(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_mcap(tmp_path / "bag.mcap", make_drive())
    monkeypatch.setattr(work, "LARGEST_BYTES", path.stat().st_size)
    assert call("info", path, "--json").json[0]["clock"]["used"] == "stamp"
    monkeypatch.setattr(work, "LARGEST_BYTES", path.stat().st_size - 1)
    (answer,) = call("info", path, "--json").json
    assert answer["summary"] == "a robot: 40 poses on /odom, 20.5 Hz on the average; not turtlesim"
    assert answer["clock"] is None
    assert answer["notes"]["clock"] == "not looked at, 0 MiB: info --clock does"
    assert call("info", path, "--clock", "--json").json[0]["clock"]["used"] == "stamp"


def test_poses_that_cannot_be_read_are_described_all_the_same(call: Call, tmp_path: Path) -> None:
    broken = make_odometry(yaw_rad=0.0, speed=(0.0, 0.0), turn_rate=0.0)
    turn = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0}
    pose = {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": turn}
    broken.values["pose"] = {"pose": pose, "covariance": [0.0] * 36}
    path = write_mcap(tmp_path / "bag.mcap", [broken])
    answer = call("info", path)
    assert answer.code == 0
    told = "bag.mcap: poses on /odom, which cannot be read: topic /odom: message 0"
    assert answer.out.startswith(told)


def test_two_turtles_are_named(call: Call, tmp_path: Path) -> None:
    still: dict[str, Any] = {"linear_velocity": 0.0, "angular_velocity": 0.0}
    turtles = [*make_poses(30, **still), *make_poses(30, topic="/turtle2/pose", **still)]
    path = write_mcap(tmp_path / "bag.mcap", turtles)
    (answer,) = call("info", path, "--json").json
    assert answer["summary"] == "turtlesim: /turtle1/pose at 62.5 Hz, no commands"
    assert answer["notes"]["robots"].startswith("turtle1 of turtle1, turtle2: ")
    assert [robot["poses"] for robot in answer["robots"]] == ["/turtle1/pose", "/turtle2/pose"]


@pytest.mark.parametrize(
    ("tick_ms", "off", "kind"),
    [
        (16, 0.0, "turtlesim: "),
        (17.9, 0.0, "turtlesim: "),
        (18.1, 0.0, "a robot that publishes turtlesim/msg/Pose: "),
        (50, 0.0, "a robot that publishes turtlesim/msg/Pose: "),
        (16, 2e-4, "a robot that publishes turtlesim/msg/Pose: "),
    ],
)
def test_only_what_moves_as_turtlesim_does_is_called_so(
    call: Call, tmp_path: Path, tick_ms: float, off: float, kind: str
) -> None:
    rates: dict[str, Any] = {
        "linear_velocity": 1.0,
        "angular_velocity": 0.0,
        "y": 5.0,
        "theta": 0.0,
    }
    poses = [
        replace(
            make_poses(1, x=3.0 + row * (0.016 + off), **rates)[0],
            time_ns=START_NS + round(row * tick_ms * 1e6),
        )
        for row in range(30)
    ]
    path = write_mcap(tmp_path / "bag.mcap", poses)
    assert call("info", path, "--json").json[0]["summary"].startswith(kind)
    told = "a: turtlesim" if kind == "turtlesim: " else "poses as turtlesim does, not turtlesim"
    assert told.removeprefix("a: ") in call("explain", path).out
    assert ("was not driven" in call("explain", path).out) is False


def test_an_empty_file_has_nothing_to_measure(call: Call, tmp_path: Path) -> None:
    (answer,) = call("info", write_mcap(tmp_path / "bag.mcap", []), "--json").json
    assert answer["summary"] == "no poses, nothing to measure: there are no messages"
    (text,) = answer["missing"]
    assert text.startswith("to be measured it needs nav_msgs/msg/Odometry")


def test_a_goal_that_cannot_be_taken_is_there_with_the_reason(call: Call, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "bag.mcap", [*make_drive(), say_goal(1.0, 2.0, frame="map")])
    (answer,) = call("info", path, "--json").json
    assert answer["notes"]["goal"].startswith("/goal_pose: left out: it is in map")


def test_columns_and_topics_that_are_asked_for_are_looked_at(call: Call, tmp_path: Path) -> None:
    table = tmp_path / "drive.csv"
    table.write_text("Zeit,x,y,Winkel\n0,0,0,0\n1,1,0,90\n")
    columns = ("--column", "t=Zeit", "--column", "heading=Winkel [deg]")
    (answer,) = call("info", table, "--json", *columns).json
    assert answer["notes"]["columns"].startswith("t from Zeit [s, assumed]")
    bag = write_mcap(tmp_path / "bag.mcap", [*make_drive(), *make_poses(3)])
    (answer,) = call("info", bag, "--json", "--pose-topic", "/odom", *columns).json
    assert answer["summary"].startswith("a robot: /odom at 20 Hz")
    assert answer["notes"]["unused"] == "--column t, heading is not used: this is no table"
    failed = call("info", bag, "--pose-topic", "/odo")
    assert failed.code == 2
    assert "pose_topic: expected a topic with messages, found /odo" in failed.err


def test_what_a_table_is_taken_for_is_said(call: Call, tmp_path: Path) -> None:
    table = tmp_path / "drive.csv"
    table.write_text("t,x,y,yaw\n0,0,0,0\n1,1,0,90\n")
    answer = call("metrics", table, "--metric", "run.path_length")
    assert "heading from yaw [rad, assumed]; --column heading='yaw [UNIT]'" in answer.err
    bag = write_mcap(tmp_path / "bag.mcap", make_drive())
    answer = call(
        "metrics", bag, table, "--metric", "run.path_length", "--column", "heading=yaw [deg]"
    )
    assert answer.code == 0
    assert "heading from yaw [deg]" in answer.err
    assert "bag.mcap: --column heading is not used: this is no table" in answer.err


@pytest.mark.parametrize("name", ["kp10", "tb3", "cut"])
def test_the_answer_fits_a_screen(call: Call, kp10: Path, tmp_path: Path, name: str) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(kp10.read_bytes()[:60000])
    file = {"kp10": kp10, "cut": cut}.get(name) or find_shared("robots", name)
    *lines, _ = call("info", file).out.splitlines()
    assert lines[0].startswith(f"{file.name}: ")
    assert len(lines) <= 40
    assert max(len(line) for line in lines if str(file) not in line) <= 80


def test_topics_and_parameters_are_listed_where_they_are_asked_for(call: Call, kp4: Path) -> None:
    short = call("info", kp4).out
    long = call("info", kp4, "--topics", "--parameters").out
    assert short.endswith("Topics: --topics    Scenario: --parameters\n")
    for text in ("/turtle1/control  turtlelog_msgs/msg/ControlSample", "  law.kp_linear = 4.0\n"):
        assert (text in short, text in long) == (False, True)


@pytest.mark.parametrize(("step_ns", "rate"), [(1_000, "1e+06 Hz, "), (999, "")])
def test_poses_of_one_time_have_no_rate(
    call: Call, tmp_path: Path, step_ns: int, rate: str
) -> None:
    said = [replace(pose, time_ns=step_ns * row) for row, pose in enumerate(make_poses(40))]
    assert (
        f"/turtle1/pose, {rate}40 messages"
        in call("info", write_mcap(tmp_path / "a.mcap", said)).out
    )


def test_the_software_of_a_simulation_is_listed_with_its_scenario(
    call: Call, kp4: Path, tmp_path: Path
) -> None:
    software = tl.read_recording(kp4).simulated_by
    [told] = call("info", kp4, "--json").json
    assert told["simulated_by"] == dict(software)
    line = f"simulated by turtlelog {tl.__version__}, Python {software['python']}, NumPy "
    assert line in call("info", kp4, "--parameters").flat
    assert "simulated by" not in call("info", kp4).out
    tl.write_recording(replace(tl.read_recording(kp4), simulated_by={}), tmp_path / "a.mcap")
    assert "simulated by" not in call("info", tmp_path / "a.mcap", "--parameters").out


def test_topics_of_places_that_are_no_poses_are_listed_with_the_reason(
    call: Call, tmp_path: Path
) -> None:
    number = {"type": "number"}
    of_pose = dict.fromkeys(("x", "y", "theta"), number)
    kinds = {
        "/gps": ("foxglove.LocationFix", {"latitude": number}),
        "/gazebo/model_states": ("gazebo_msgs/msg/ModelStates", {"count": number}),
        "/place": ("mine", of_pose),
    }
    for chosen in (["/gps", "/gazebo/model_states"], ["/gps", "/place"]):
        file = tmp_path / "a.mcap"
        with file.open("wb") as stream:
            writer = Writer(stream)
            writer.start("", "test")
            for topic in chosen:
                kind, fields = kinds[topic]
                text = json.dumps({"type": "object", "properties": fields}).encode()
                schema = writer.register_schema(kind, "jsonschema", text)
                channel = writer.register_channel(topic, "json", schema)
                writer.add_message(channel, 10, json.dumps(dict.fromkeys(fields, 1.0)).encode(), 10)
            writer.finish()  # type: ignore[no-untyped-call]
        told = call("info", file).flat
        assert "/gps (foxglove.LocationFix): latitude and longitude, which are read" in told
        models = "/gazebo/model_states (gazebo_msgs/msg/ModelStates): poses of several models"
        assert (models in told) == ("/gazebo/model_states" in chosen)
        assert ("poses /place" in told) == ("/place" in chosen)
