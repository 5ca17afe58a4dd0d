"""A bag of commands without poses, in every command that reads bags."""

import math
from pathlib import Path

import pytest

import turtlelog as tl
from tests.cli.conftest import Call
from tests.log.ros2.bags import START_NS, Said, make_poses, make_vector, write_mcap
from tests.log.ros2.moved_robots import say_joints
from tests.log.ros2.robots import describe_head, say_goal, say_odometry, say_path

STEP_NS = 50_000_000


def say_twist(
    speed: float, turn_rate: float = 0.0, *, row: int, topic: str = "/cmd_vel", left: float = 0.0
) -> Said:
    values = {"linear": make_vector(speed, left), "angular": make_vector(0.0, 0.0, turn_rate)}
    time_ns = START_NS + row * STEP_NS
    return Said(topic=topic, type="geometry_msgs/msg/Twist", values=values, time_ns=time_ns)


@pytest.fixture
def bag(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Five seconds straight ahead with 0.2 m/s, then five of a left turn with 0.1 m/s."""
    monkeypatch.chdir(tmp_path)
    said = [say_twist(0.2 if row < 100 else 0.1, 0.5 * (row >= 100), row=row) for row in range(201)]
    return write_mcap(Path("drive.mcap"), said)


def test_info_says_that_there_are_no_poses_and_what_can_be_done(call: Call, bag: Path) -> None:
    answer = call("info", bag)
    assert answer.out.startswith("drive.mcap: ROS 2 bag of commands without poses, 10.0 s\n")
    assert "commands /cmd_vel, 20 Hz, 201 messages" in answer.flat
    assert "10.000 s, from the first command to the last one" in answer.flat
    assert "missing poses: a recorded Odometry, PoseStamped or /tf adds the path" in answer.flat
    assert "--goal" not in answer.out
    assert "You can: metrics, check, plot, replay" in answer.out
    (found,) = call("info", bag, "--json").json
    assert found["summary"] == "no poses, commands on /cmd_vel at 20 Hz"
    assert "poses" in found["absent"]
    assert "commands" not in found["absent"]


@pytest.mark.parametrize(
    ("other", "reason"),
    [
        (
            say_joints(["left", "right"], [0.0, 0.0], at_s=1.0),
            "/joint_states: joints give poses with --wheel-joints LEFT,RIGHT",
        ),
        (
            Said(
                topic="/particles",
                type="geometry_msgs/msg/PoseArray",
                time_ns=START_NS,
                values={"header": describe_head("map"), "poses": []},
            ),
            "/particles (geometry_msgs/msg/PoseArray) is not read, as its fields have other names",
        ),
    ],
    ids=["joints", "other fields"],
)
def test_topics_that_may_hold_poses_are_named(
    call: Call, tmp_path: Path, other: Said, reason: str
) -> None:
    path = write_mcap(tmp_path / "drive.mcap", [say_twist(0.2, row=0), other])
    assert f"missing poses: {reason}" in call("info", path).flat
    replayed = call("replay", path)
    assert "No poses were read" in replayed.flat
    assert f"; poses: {reason}" in replayed.err


def test_info_names_goal_and_path(call: Call, tmp_path: Path) -> None:
    plan = say_path((0.0, 0.0), (9.0, 0.0))
    path = write_mcap(tmp_path / "drive.mcap", [*say_odometry(), say_goal(9.0, 0.0), plan])
    text = call("info", path).flat
    assert "goal from /goal_pose, no heading path from /plan" in text


def test_metrics_of_commands_have_values_and_those_of_poses_the_reason(
    call: Call, bag: Path
) -> None:
    (answer,) = call("metrics", bag, "--json").json
    found = {one["id"]: one for one in answer["metrics"]}
    assert found["run.speed_effort"]["value"] == pytest.approx(5.0 * 0.04 + 5.0 * 0.01)
    assert found["run.turn_rate_largest_jump"]["value"] == 0.5
    assert found["run.speed_steps"]["value"] == 1.0
    assert found["run.sample_rate"]["value"] == pytest.approx(20.0)
    for name in ("run.path_length", "run.speed_lag", "run.pose_rate", "final.position_error"):
        reason = (found[name]["status"], found[name]["reason"])
        assert reason == ("absent", "the recording holds no poses")
    text = call("metrics", bag)
    assert text.out.startswith("drive.mcap: commands for 10 s, no poses.\n")
    assert "identify" not in text.out
    assert "turtlelog replay drive.mcap" in text.out


@pytest.mark.parametrize(
    ("formula", "code", "words"),
    [
        ("always(abs(speed) <= 0.2)", 0, "PASS"),
        ("always(abs(speed) <= 0.19)", 1, "value 0.2 m/s"),
        ("run.turn_rate_reversals == 0", 0, "PASS"),
        ("always(x <= 1)", 1, "x (the recording holds no poses)"),
        ("run.path_length < 1", 1, "the recording holds no poses"),
        ("robot.speed.gain > 0.5", 1, "the recording holds no poses"),
    ],
)
def test_checks_of_commands_need_no_poses(
    call: Call, bag: Path, formula: str, code: int, words: str
) -> None:
    answer = call("check", bag, "--expect", formula)
    assert answer.code == code
    assert words in answer.flat


def test_plot_draws_the_commands_and_does_not_say_that_they_rest(call: Call, bag: Path) -> None:
    answer = call("plot", bag, "-o", "panel.svg")
    assert answer.code == 0
    assert "drive: commands for 10 s, no poses." in answer.out
    assert "of drive: Path, errors and commands, as far as recorded." in answer.flat
    text = Path("panel.svg").read_text(encoding="utf-8")
    assert "time from the first command [s]" in text
    assert "at rest" not in text
    refused = call("plot", bag, "-o", "plane.svg", "--only", "plane")
    assert (refused.code, refused.err.splitlines()[-1]) == (
        2,
        "turtlelog: error: figure plane needs poses",
    )


def test_replay_drives_turtlesim_with_the_commands(call: Call, bag: Path) -> None:
    answer = call("replay", bag, "--json").json
    assert (answer["mode"], answer["plant"], answer["taken"]) == ("commands", "turtlesim", 201)
    # Straight ahead for 5 s, then 5 s of a circle of 0.2 m, and the second until the plant stops.
    turned_rad = 0.5 * (5.0 + 1.0)
    assert answer["path_length_m"] == pytest.approx(5.0 * 0.2 + 6.0 * 0.1, abs=0.01)
    assert answer["end"]["heading"] == pytest.approx(turned_rad, abs=0.02)
    start_m = 5.544444561004639
    assert answer["end"]["x"] == pytest.approx(start_m + 1.0 + 0.2 * math.sin(turned_rad), abs=0.01)
    assert answer["end"]["y"] == pytest.approx(start_m + 0.2 - 0.2 * math.cos(turned_rad), abs=0.01)
    assert answer["wall_s"] is None


def test_replay_drives_a_robot_model_and_keeps_its_path(call: Call, bag: Path) -> None:
    answer = call(
        "replay", bag, "--scenario", "lagged", "--set", "plant.speed_gain=2", "-o", "path.mcap"
    )
    assert "the commands drive the robot model" in answer.flat
    assert "nothing tells whether the robot went there" in answer.flat
    run = tl.read_recording("path.mcap")
    assert run.source == "replay of drive"
    length_m = tl.measure_run(run)["run.path_length"].value
    assert length_m == pytest.approx(2.0 * (5.0 * 0.2 + 5.0 * 0.1), abs=0.06)
    assert call("info", "path.mcap").flat.count("201 commands") == 1


def test_replay_says_when_the_turtle_runs_into_a_wall(call: Call, bag: Path) -> None:
    early = call("replay", bag, "--set", "start.x_m=10.5", "--time", "log")
    # 11.089 - 10.5 m at 0.2 m/s.
    assert "At 2.96 s it runs into a wall" in early.flat
    command = f"turtlelog replay {bag} --set=start.x_m=10.5 --time=log -o path.mcap"
    assert early.flat.endswith(f"Keep the path: {command}")
    assert "wall" not in call("replay", bag, "--set", "start.x_m=9").flat


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["replay", "drive.mcap", "--law"], "--law: leave it out, drive.mcap holds commands alone"),
        (["replay", "drive.mcap", "--expect-equal"], "--expect-equal: leave it out"),
        (["identify", "drive.mcap"], "no poses, only commands on /cmd_vel (geometry_msgs/msg/Twis"),
        (["view", "drive.mcap"], "info, metrics, check, plot and replay take commands alone"),
        (["metrics", "drive.mcap", "--goal", "1,2"], "goal: expected poses, found commands alone"),
        (["info", "drive.mcap", "--time", "stamp"], "time: expected commands with stamps"),
    ],
)
def test_what_needs_poses_says_so_in_one_line(
    call: Call, bag: Path, words: list[str], reason: str
) -> None:
    answer = call(*words)
    assert (answer.code, answer.out) == (2, "")
    assert reason in answer.err
    assert answer.err.count("error:") == 1
    assert "Traceback" not in answer.err


def test_what_a_check_writes_says_where_it_needs_poses(call: Call, bag: Path) -> None:
    formulas = ("always(abs(speed) <= 0.15)", "run.path_length < 1")
    for formula in formulas:
        words = ("--artifacts", "art", "--report", "report.html", "--junit", "junit.xml")
        answer = call("check", bag, "--expect", formula, *words)
        assert answer.code == 1
        assert "no artifacts of" in answer.err
        assert "report.html: drive.mcap has commands alone, and a report needs poses" in answer.err
        assert "Traceback" not in answer.err
    assert "the recording holds no poses" in Path("junit.xml").read_text("utf-8")


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["drive.mcap", "--movie", "a.gif"], "--movie: drive has commands alone"),
        (["drive.mcap", "poses.mcap", "-o", "a.svg"], "drive has commands alone, and other files"),
        (["drive.mcap", "-o", "a.svg", "--only", "rates"], "figure rates needs poses"),
        (["drive.mcap", "-o", "a.svg", "--only", "violation", "--expect", "speed < 1"], "needs"),
    ],
)
def test_pictures_that_need_poses_are_refused(
    call: Call, bag: Path, words: list[str], reason: str
) -> None:
    write_mcap(Path("poses.mcap"), make_poses(9))
    answer = call("plot", *words)
    assert answer.code == 2
    assert reason in answer.err
    assert "Traceback" not in answer.err


def test_two_logs_of_commands_are_drawn_and_measured_together(call: Call, bag: Path) -> None:
    write_mcap(Path("other.mcap"), [say_twist(0.1, row=row) for row in range(50)])
    assert call("plot", bag, "other.mcap", "-o", "two.svg").code == 0
    write_mcap(Path("poses.mcap"), make_poses(30))
    both = call("metrics", bag, "other.mcap", "poses.mcap")
    assert both.code == 0
    assert "3 runs" in both.out
    assert call("metrics", ".", "-o", "table.parquet").code == 0


def test_sideways_commands_are_refused_with_their_number(call: Call, bag: Path) -> None:
    write_mcap(bag, [say_twist(0.2, row=0), say_twist(0.2, row=1, left=0.1)])
    answer = call("replay", bag)
    assert answer.code == 2
    assert "found one to the side (command 2)" in answer.err


def test_commands_without_numbers_are_an_error(call: Call, bag: Path) -> None:
    write_mcap(bag, [say_twist(math.nan, row=row) for row in range(3)])
    answer = call("metrics", bag)
    assert (answer.code, answer.err.count("\n")) == (2, 1)
    assert "topic /cmd_vel: expected numbers, found nan or infinity in all 3 commands" in answer.err


def test_one_command_alone_is_read(call: Call, bag: Path) -> None:
    write_mcap(bag, [say_twist(0.5, row=0)])
    assert call("metrics", bag).code == 0
    assert call("plot", bag, "-o", "one.svg").code == 0
    # turtlesim drives until a second has passed without another one.
    assert call("replay", bag, "--json").json["path_length_m"] == pytest.approx(0.5, abs=0.02)


def test_a_bag_with_poses_is_read_with_them(call: Call, bag: Path) -> None:
    write_mcap(bag, [*make_poses(5), say_twist(0.5, row=0, topic="/turtle1/cmd_vel")])
    assert "without poses" not in call("info", bag).out


def test_python_reads_commands_alone_where_that_is_asked_for(bag: Path) -> None:
    with pytest.raises(tl.errors.LogError, match="no poses, only commands on /cmd_vel"):
        tl.read_run(bag)
    run = tl.read_run(bag, allow_no_poses=True)
    assert (len(run.poses), len(run.commands), run.first_row) == (0, 201, "command")
    assert run.duration_s == 10.0
    assert repr(run) == "<Run drive: 201 commands, 10.0 s, end not recorded>"
    with pytest.raises(tl.errors.RunError, match="found commands alone"):
        run.slice(1.0, 2.0)
