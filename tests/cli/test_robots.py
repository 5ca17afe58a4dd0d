"""A robot's bag, in the commands that read it: which topics, whose goal, and what is said of it."""

from pathlib import Path

import pytest

from tests.cli.conftest import Call
from tests.log.ros2.bags import make_command
from tests.log.ros2.robots import say_goal, say_odometry, write_robot


@pytest.fixture
def robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    odometry = [say_odometry("/odom"), say_odometry("/odom_kf", x_m=5.0)]
    write_robot(
        Path(), *odometry, make_command(topic="/cmd_vel"), make_command(topic="/cmd_vel_nav")
    )
    return Path("robot.mcap")


def test_what_is_read_is_one_line(call: Call, robot: Path) -> None:
    line, *_ = call("metrics", robot).err.splitlines()
    assert line == (
        "robot.mcap: poses from /odom (nav_msgs/msg/Odometry), commands from /cmd_vel"
        " (geometry_msgs/msg/Twist); also there: /odom_kf: --pose-topic; also there: /cmd_vel_nav:"
        " --command-topic"
    )


def test_two_topics_of_one_bag_compare_in_one_command(call: Call, robot: Path) -> None:
    answer = call("compare", f"{robot}:/odom", f"{robot}:/odom_kf", "--json")
    assert [run["name"] for run in answer.json["runs"]] == ["robot:/odom", "robot:/odom_kf"]
    against = call("compare", "--reference", f"{robot}:/odom", f"{robot}:/odom_kf", "--json")
    (run,) = against.json["runs"]
    assert {"signal": "x", "unit": "m", "largest": 5.0, "at_s": 0.0} in run["signals"]


def test_a_topic_is_chosen_in_every_command(call: Call, robot: Path) -> None:
    poses = [say_goal(float(k), 0.0, topic="/tracker", at_s=k) for k in range(3)]
    write_robot(Path(), say_odometry(), poses, name="tracker")
    tracked = "tracker.mcap:/tracker"
    assert call("convert", tracked, "-o", "own.mcap").code == 0
    (answer,) = call("info", "own.mcap", "--json").json
    assert answer["name"] == "tracker:/tracker"
    assert "chosen" not in answer["notes"]
    # A recording made of a bag has no other topics to choose from.
    assert call("metrics", "own.mcap").err == ""
    drawn = call("plot", tracked, "-o", "kf.svg").out
    assert drawn.startswith(
        "tracker:/tracker: the path is 2 m long and takes 2 s.\n"
        "kf.svg shows the figure panel of tracker:/tracker: "
    )
    assert drawn.endswith("\nwrote kf.svg\n")
    assert call("explain", tracked).code == 1
    refused = call("convert", f"{robot}:/odom", "-o", robot)
    assert "robot.mcap: this is the input; name another file to write" in refused.err


def test_a_goal_is_given_with_its_heading_in_degrees(call: Call, robot: Path) -> None:
    (answer,) = call("metrics", robot, "--goal=2,-1,90", "--json").json
    values = {metric["id"]: metric["value"] for metric in answer["metrics"]}
    assert values["final.position_error"] == pytest.approx(1.0)
    assert values["final.heading_error"] == pytest.approx(90.0)
    refused = call("metrics", robot, "--goal", "2,x")
    assert refused.code == 2
    assert "--goal 2,x: must be X,Y in metres, or X,Y,DEG with a heading" in refused.err


def test_a_specification_chooses_for_runs_and_reference(call: Call, robot: Path) -> None:
    write_robot(Path(), say_odometry(x_m=5.0), say_goal(7.0, 0.0), name="other")
    Path("spec.toml").write_text(
        'format = 1\nreference = "other.mcap"\n[read]\npose_topic = "/odom_kf"\n'
        'goal = [7.0, 0.0]\n[checks.there]\nexpect = "final.position_error <= 0.001"\n'
        '[signals.x]\nabs = 0.001\nreason = "the same way"\n'
    )
    assert call("check", "spec.toml", robot).code == 0
    assert call("check", "spec.toml", robot, "--pose-topic", "/odom").code == 1
    assert call("check", "spec.toml", robot, "--reference", f"{robot}:/odom").code == 1
    assert call("check", "spec.toml", robot, "--reference", f"{robot}:/odom_kf").code == 0


def test_a_column_has_a_name_and_what_it_is(call: Call, robot: Path) -> None:
    refused = call("metrics", robot, "--column", "x")
    assert "--column x: must be NAME=COLUMN, as in x=pos_x" in refused.err
