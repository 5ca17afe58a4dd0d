"""Run -> the topics by which other programs know a robot: /odom, /tf and /path."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.log.alike_messages import PackedItems, lay_out_alike
from turtlelog.log.engine.message_types import read_type
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.recording.topics import ODOMETRY, PATH, SCHEMAS, TRANSFORMS, Topic
from turtlelog.run import PoseColumns, Run

WORLD: Final = "world"
ROBOT: Final = "turtle1"
"""Frames as in the tutorials of tf2, where a broadcaster sends turtlesim's poses."""

MOST_SHARED: Final = 100_000
"""Poses that are written once more: an odometry has 720 bytes, most of them covariances, and with
the transforms so many take 160 MB while they are written. At 62.5 Hz it is a drive of 27 minutes.
"""

_LATEST_NS: Final = 2**31 * 1_000_000_000
"""Seconds of a stamp have 32 bits."""


def build_shared_messages(run: Run) -> tuple[TopicColumns, ...]:
    """Return the poses as odometry, as transforms and, at the last one's time, as one path.

    None where there are more than `MOST_SHARED` poses, or times beyond those of stamps.
    """
    poses = run.poses
    if not can_share(run):
        return ()
    stamp = divmod(poses.time_ns, 1_000_000_000)
    half_rad = poses.heading_rad / 2.0
    place = dict(zip("xy", poses.xy_m.T, strict=True))
    turn = {"z": np.sin(half_rad), "w": np.cos(half_rad)}
    head = _list_head(stamp)
    child = np.full(len(poses), ROBOT, dtype=object)
    rates = zip(("twist.twist.linear.x", "twist.twist.angular.z"), read_rates(run), strict=True)
    odometry = {
        **head,
        "child_frame_id": child,
        **_prefix("pose.pose.position.", place),
        **_prefix("pose.pose.orientation.", turn),
        **dict(rates),
    }
    transform = {
        **head,
        "child_frame_id": child,
        **_prefix("transform.translation.", place),
        **_prefix("transform.rotation.", turn),
    }
    pose = {**head, **_prefix("pose.position.", place), **_prefix("pose.orientation.", turn)}
    path = {name: values[-1:] for name, values in head.items()}
    path["poses"] = np.array([_pack_poses(pose, len(poses))], dtype=object)
    return (
        _collect(ODOMETRY, poses.time_ns, odometry),
        _collect(TRANSFORMS, poses.time_ns, _prefix("transforms.0.", transform)),
        _collect(PATH, poses.time_ns[-1:], path),
    )


def _list_head(stamp: tuple[NDArray[np.int64], NDArray[np.int64]]) -> dict[str, NDArray[Any]]:
    return {
        "header.stamp.sec": stamp[0],
        "header.stamp.nanosec": stamp[1],
        "header.frame_id": np.full(len(stamp[0]), WORLD, dtype=object),
    }


def _prefix(prefix: str, columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    return {prefix + name: values for name, values in columns.items()}


def _pack_poses(columns: Mapping[str, NDArray[Any]], rows: int) -> PackedItems:
    """Return stamped poses as the items of one message."""
    kind = "geometry_msgs/msg/PoseStamped"
    layout = lay_out_alike(read_type(kind, SCHEMAS[kind]).fields, columns)
    assert layout is not None
    assert not layout.size % 8  # the next one begins as the first
    codes = {name: f"<{code}" for name, code, *_ in layout.numbers}
    numbers = {name: columns[name].astype(codes[name]) for name in columns.keys() & codes.keys()}
    return PackedItems(rows, layout.fill(rows, numbers).tobytes())


def can_share(run: Run) -> bool:
    """Return whether the poses of a run are few enough, and its times fit stamps."""
    count = len(run.poses)
    return 0 < count <= MOST_SHARED and int(run.poses.time_ns[-1]) < _LATEST_NS


def list_unshared(run: Run) -> list[str]:
    """Return why poses are not written once more, in one sentence or none."""
    if can_share(run) or not len(run.poses):
        return []
    reason = (
        f"{len(run.poses):,} poses are more than {MOST_SHARED:,}"
        if len(run.poses) > MOST_SHARED
        else "the times do not fit the stamps of ROS"
    )
    return [f"/odom, /tf and /path are left out: {reason}"]


def read_rates(run: Run) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return forward speed [m/s] and turn rate [rad/s] of every pose, NaN where nobody knows them.

    As the robot measured them, else as turtlesim applied them. It publishes the magnitude of its
    speed: the sign is that of the motion along the heading.
    """
    poses = run.poses
    unknown = np.full(len(poses), np.nan)
    speed, turn_rate = poses.measured_speed_m_s, poses.measured_turn_rate_rad_s
    if speed is None and poses.speed_m_s is not None and not run.commands.lateral_speed_m_s.any():
        speed = poses.speed_m_s * _find_signs(poses)
    if turn_rate is None:
        turn_rate = poses.turn_rate_rad_s
    return (unknown if speed is None else speed), (unknown if turn_rate is None else turn_rate)


def _find_signs(poses: PoseColumns) -> NDArray[np.float64]:
    """Return -1 where the robot came to a pose backward, otherwise 1."""
    step_m = np.diff(poses.xy_m, axis=0, prepend=poses.xy_m[:1])
    along_m = (
        step_m * np.column_stack([np.cos(poses.heading_rad), np.sin(poses.heading_rad)])
    ).sum(axis=1)
    return np.where(along_m < 0.0, -1.0, 1.0)


def _collect(
    topic: Topic, time_ns: NDArray[np.int64], fields: dict[str, NDArray[Any]]
) -> TopicColumns:
    return TopicColumns(
        topic=topic.name,
        type=topic.schema,
        log_time_ns=time_ns,
        publish_time_ns=time_ns,
        sequence=np.arange(len(time_ns), dtype=np.uint32),
        fields=fields,
    )
