"""Several robots in one bag: which there are, and which is read."""

from pathlib import Path

import pytest

import turtlelog as tl
from tests.cli.conftest import Call
from tests.cli.test_commands_alone import say_twist
from tests.log.ros2.bags import Said
from tests.log.ros2.robots import say_odometry, say_transform, turn, write_robot
from turtlelog.log.file_info import TopicInfo
from turtlelog.log.ros2.bag_topics import find_robots

ODOMETRY, TWIST = "nav_msgs/msg/Odometry", "geometry_msgs/msg/Twist"


def say_robots(*names: str, has_poses: bool = True, has_commands: bool = True) -> list[Said]:
    """Return robots of which the n-th begins at x = n and is told to drive n / 10 m/s."""
    said: list[Said] = []
    for number, name in enumerate(names, start=1):
        said += say_odometry(f"/{name}/odom", count=5, x_m=number) if has_poses else []
        topic = f"/{name}/cmd_vel"
        rows = range(4) if has_commands else ()
        said += [say_twist(number / 10, row=row, topic=topic) for row in rows]
    return said


def test_info_lists_all_robots_and_says_which_is_read(call: Call, tmp_path: Path) -> None:
    bag = write_robot(tmp_path, say_robots("robot1", "robot2", "robot10"))
    answer = call("info", bag)
    assert "robot robot10 poses /robot10/odom, 5 messages; commands /robot10/cmd_vel" in answer.flat
    assert "robots robot1 of robot1, robot2, robot10: --robot NAME chooses" in answer.flat
    (found,) = call("info", bag, "--json").json
    assert [robot["name"] for robot in found["robots"]] == ["robot1", "robot2", "robot10"]
    assert found["robots"][1]["commands"] == "/robot2/cmd_vel"


def test_a_robot_is_chosen_with_its_own_commands(call: Call, tmp_path: Path) -> None:
    bag = write_robot(tmp_path, say_robots("robot1", "robot2"))
    run = tl.read_run(bag, robot="robot2")
    assert (run.poses.xy_m[0, 0], run.commands.speed_m_s[0]) == (2.0, 0.2)
    assert tl.read_run(bag).poses.xy_m[0, 0] == 1.0
    line = call("metrics", bag, "--robot", "robot2").err.splitlines()[0]
    assert "poses from /robot2/odom" in line
    assert "robots robot2 of robot1, robot2: --robot NAME chooses" in line
    wrong = call("metrics", bag, "--robot", "robot3")
    assert (wrong.code, wrong.err.count("\n")) == (2, 1)
    assert "robot robot3: no topic below that name; found robot1, robot2" in wrong.err


def test_robots_with_names_are_a_question_that_names_them(call: Call, tmp_path: Path) -> None:
    bag = write_robot(tmp_path, say_robots("alpha", "bravo"))
    answer = call("metrics", bag)
    assert (answer.code, answer.out) == (2, "")
    assert (
        answer.err == f"turtlelog: error: {bag}: 2 robots, alpha, bravo: choose with --robot NAME\n"
    )
    told = call("info", bag)
    assert told.code == 0
    assert told.out.startswith("robot.mcap: 2 robots, alpha, bravo: choose with --robot NAME\n")
    assert "robot bravo poses /bravo/odom, 5 messages; commands /bravo/cmd_vel" in told.flat
    assert call("metrics", bag, "--robot", "bravo").code == 0
    # A topic that is named says it, too.
    assert tl.read_run(f"{bag}:bravo/odom").poses.xy_m[0, 0] == 2.0


def test_robots_that_are_only_told_to_drive_are_robots(call: Call, tmp_path: Path) -> None:
    bag = write_robot(tmp_path, say_robots("robot1", "robot2", has_poses=False))
    chosen = tl.read_run(bag, allow_no_poses=True, robot="robot2")
    assert chosen.commands.speed_m_s[0] == 0.2
    assert "robots robot1 of robot1, robot2: --robot NAME chooses" in call("metrics", bag).err


def test_poses_of_nobody_leave_the_question_whose_commands_are_meant(tmp_path: Path) -> None:
    bag = write_robot(
        tmp_path, say_odometry(count=5), say_robots("robot1", "robot2", has_poses=False)
    )
    with pytest.raises(
        tl.errors.LogError, match="found /robot1/cmd_vel, /robot2/cmd_vel: choose with"
    ):
        tl.read_run(bag)


@pytest.mark.parametrize("sign", ["/", "_"])
def test_a_robot_is_chosen_by_its_frames(tmp_path: Path, sign: str) -> None:
    said = [
        say_transform(
            f"bot{number}{sign}odom",
            f"bot{number}{sign}base_link",
            number + row,
            at_s=row,
            by=turn(0),
        )
        for row in range(4)
        for number in (1, 2)
    ]
    said = [one for one in said if sign == "/"] or [
        say_transform("odom", f"bot{number}", number + row, at_s=row)
        for row in range(4)
        for number in (1, 2)
    ]
    bag = write_robot(tmp_path, said)
    assert tl.read_run(bag, robot="bot2").poses.xy_m[0, 0] == 2.0


def test_a_robot_without_frames_of_its_name_is_refused(tmp_path: Path) -> None:
    said = [
        say_transform(f"{name}/odom", f"{name}/base_link", row, at_s=row)
        for row in range(4)
        for name in ("red", "blue")
    ]
    bag = write_robot(tmp_path, said)
    assert len(tl.read_run(bag, robot="red").poses) == 4
    with pytest.raises(tl.errors.LogError, match="robot up: no frame begins with that name; found"):
        tl.read_run(bag, robot="up")
    with pytest.raises(tl.errors.LogError, match=r"red/odom -> red/base_link.* with --robot NAME"):
        tl.read_run(bag)


@pytest.mark.parametrize(
    ("topics", "names"),
    [
        ({"/odom": ODOMETRY, "/cmd_vel": TWIST}, []),
        ({"/robot1/odom": ODOMETRY, "/robot1/cmd_vel": TWIST}, []),
        ({"/wheel/odom": ODOMETRY, "/visual/odom": ODOMETRY}, []),
        ({"/camera1/odom": ODOMETRY, "/camera2/odom": ODOMETRY}, []),
        ({"/a/odom": ODOMETRY, "/b/odom": ODOMETRY, "/a/cmd_vel": TWIST}, []),
        (
            {
                f"/{name}/{end}": kind
                for name in "ab"
                for end, kind in (("odom", ODOMETRY), ("cmd_vel", TWIST))
            },
            ["a", "b"],
        ),
        ({f"/fleet/tb{number}/odom": ODOMETRY for number in (2, 1)}, ["tb1", "tb2"]),
        ({f"/marker{number}/pose": ODOMETRY for number in (1, 2)}, []),
        ({f"/goal/{number}/pose": ODOMETRY for number in (1, 2)}, []),
        (
            {f"/robot{number}/odom": ODOMETRY for number in (1, 2)} | {"/odom": ODOMETRY},
            ["robot1", "robot2"],
        ),
    ],
)
def test_robots_are_told_from_their_parts_and_sources(
    topics: dict[str, str], names: list[str]
) -> None:
    held = [TopicInfo(topic=topic, type=kind, count=9) for topic, kind in topics.items()]
    assert [robot.name for robot in find_robots(held)] == names
