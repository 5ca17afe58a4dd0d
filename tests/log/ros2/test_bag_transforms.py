import math
import time
from pathlib import Path

import numpy as np
import pytest

from tests.log.ros2.bags import Said, make_command
from tests.log.ros2.robots import say_transform, turn, write_robot
from turtlelog.errors import LogError
from turtlelog.log import TopicColumns, read_run
from turtlelog.log.ros2.bag_transforms import FrameChoice, collect_links, trace_frame


def drive(parent: str, child: str, count: int = 3, topic: str = "/tf") -> list[Said]:
    """Return a frame that moves ahead by a metre a second."""
    return [say_transform(parent, child, float(k), at_s=k, topic=topic) for k in range(count)]


def mount(parent: str, child: str, x_m: float = 0.0, y_m: float = 0.0) -> Said:
    return say_transform(parent, child, x_m, y_m, topic="/tf_static")


def spin_wheels(count: int = 3) -> list[Said]:
    return [
        say_transform("base_link", "wheel_left", at_s=k, by=turn(float(k))) for k in range(count)
    ]


def test_a_robot_is_found_among_its_wheels_and_sensors(tmp_path: Path) -> None:
    run = read_run(
        write_robot(
            tmp_path,
            drive("odom", "base_footprint"),
            spin_wheels(9),
            mount("base_footprint", "base_link"),
            mount("base_link", "lidar", 0.2),
        )
    )
    assert run.poses.xy_m[:, 0].tolist() == [0.0, 1.0, 2.0]
    assert run.notes["pose_topic"] == "/tf (tf2_msgs/msg/TFMessage): odom -> base_footprint"


def test_a_correction_that_moves_is_held_and_poses_before_it_are_counted(tmp_path: Path) -> None:
    corrections = [
        say_transform("map", "odom", 0.0, 10.0, at_s=0.5, by=turn(math.pi / 2)),
        say_transform("map", "odom", 0.0, 20.0, at_s=1.5, by=turn(math.pi / 2)),
    ]
    run = read_run(write_robot(tmp_path, drive("odom", "base_link", 4), corrections))
    # Ahead in odom is to the left in map.
    assert run.poses.xy_m.ravel().tolist() == pytest.approx([0.0, 11.0, 0.0, 22.0, 0.0, 23.0])
    assert run.poses.heading_rad.tolist() == pytest.approx([math.pi / 2] * 3)
    assert run.notes["pose_topic"].endswith("map -> base_link")
    assert run.notes["held_transforms"].startswith("map -> odom: the newest")
    assert run.notes["dropped_before_transforms"] == "1 pose before the first of map -> odom"


def test_frames_that_are_asked_for_are_joined_up_and_down(tmp_path: Path) -> None:
    file = write_robot(
        tmp_path,
        drive("odom", "base_link"),
        mount("odom", "beacon", 5.0, 1.0),
        mount("base_link", "camera", 0.5),
    )
    run = read_run(file, pose_frame="camera", world_frame="beacon")
    assert run.poses.xy_m.tolist() == [[-4.5, -1.0], [-3.5, -1.0], [-2.5, -1.0]]
    assert read_run(file, pose_frame="camera").poses.xy_m[0].tolist() == [0.5, 0.0]
    with pytest.raises(LogError, match=r"pose_frame: .* found arm among base_link"):
        read_run(file, pose_frame="arm")
    with pytest.raises(LogError, match=r"odom -> beacon: expected transforms .* static ones alone"):
        read_run(file, pose_frame="beacon", world_frame="odom")


def test_a_joint_is_never_taken_for_a_robot(tmp_path: Path) -> None:
    file = write_robot(tmp_path, spin_wheels())
    with pytest.raises(LogError, match="found those that move: base_link -> wheel_left: --pose-"):
        read_run(file)


def test_the_one_link_that_moves_is_taken_whatever_its_names(tmp_path: Path) -> None:
    run = read_run(write_robot(tmp_path, drive("lab", "cart7"), mount("cart7", "lamp")))
    assert run.notes["pose_topic"].endswith("lab -> cart7")


def test_links_that_say_equally_much_are_a_question(tmp_path: Path) -> None:
    file = write_robot(tmp_path, drive("lab", "cart"), drive("lab", "box"))
    line = "expected one robot, found lab -> cart, lab -> box: choose with --pose-frame"
    with pytest.raises(LogError, match=line):
        read_run(file)
    assert read_run(file, pose_frame="box").notes["pose_topic"].endswith("lab -> box")


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (("world", "turtle1"), ("world", "turtle2")),
        (("r1/odom", "r1/base"), ("r2/odom", "r2/base")),
    ],
)
def test_of_several_robots_the_first_is_read_with_its_commands(
    first: tuple[str, str], second: tuple[str, str], tmp_path: Path
) -> None:
    prefixes = [frames[1].partition("/")[0] for frames in (first, second)]
    commands = [make_command(k, topic=f"/{name}/cmd_vel") for k, name in enumerate(prefixes)]
    run = read_run(write_robot(tmp_path, drive(*second), drive(*first), commands))
    assert run.notes["pose_topic"].endswith(" -> ".join(first))
    assert run.notes["other_frames"] == " -> ".join(second)
    assert run.commands.speed_m_s.tolist() == [0.0]


def test_a_robot_may_have_transforms_of_its_own(tmp_path: Path) -> None:
    file = write_robot(
        tmp_path,
        drive("odom", "base_link", 3, "/r1/tf"),
        drive("odom", "base_link", 5, "/r2/tf"),
        *(make_command(k, topic=f"/r{k}/cmd_vel") for k in (1, 2)),
    )
    assert len(read_run(file).poses) == 3
    second = read_run(f"{file}:/r2/tf")
    assert (len(second.poses), second.commands.speed_m_s.tolist()) == (5, [2.0])


def test_frames_beside_a_topic_that_has_none_are_refused(tmp_path: Path) -> None:
    file = write_robot(tmp_path, drive("odom", "base_link"), make_command())
    with pytest.raises(LogError, match=r"no transforms \(/tf\)"):
        read_run(write_robot(tmp_path, make_command(), name="other"), pose_frame="base_link")
    with pytest.raises(LogError, match="pose_topic /turtle1/cmd_vel: expected turtlesim"):
        read_run(file, pose_topic="/turtle1/cmd_vel", world_frame="odom")


def test_many_transforms_take_seconds() -> None:
    names = ("odom", "base_link")
    transform = {
        "header.stamp.sec": 0,
        "header.stamp.nanosec": 0,
        "header.frame_id": names[0],
        "child_frame_id": names[1],
        **{f"transform.translation.{axis}": 1.0 for axis in "xyz"},
        **{f"transform.rotation.{axis}": 0.5 for axis in "xyzw"},
    }
    count = 20_000
    lists = np.empty(count, dtype=object)
    lists[:] = [[transform, {**transform, "child_frame_id": f"w{k % 4}"}] for k in range(count)]
    whole = np.arange(count)
    columns = TopicColumns(
        topic="/tf",
        type="tf2_msgs/msg/TFMessage",
        log_time_ns=whole,
        publish_time_ns=whole,
        sequence=np.zeros(count, dtype=np.uint32),
        fields={"transforms": lists},
    )
    began_s = time.perf_counter()
    tree = collect_links([columns], is_static=False)
    link, _ = trace_frame(tree, FrameChoice(world="odom", robot="base_link"))
    # 100,000 take less than 2 s on one core; a row by row search of all frames took minutes.
    assert time.perf_counter() - began_s < 2.0
    assert len(link.time_ns) == count


@pytest.mark.parametrize(("world", "other"), [(None, "odom"), ("odom", "vicon")])
def test_a_second_parent_is_named_and_can_be_chosen(
    world: str | None, other: str, tmp_path: Path
) -> None:
    moving = [*drive("odom", "base_link"), *drive("vicon", "base_link")]
    run = read_run(write_robot(tmp_path, moving), world_frame=world)
    assert run.notes["other_frames"] == f"{other} -> base_link"
    assert (
        f"also there: {other} -> base_link: --pose-frame and --world-frame" in run.notes["chosen"]
    )
