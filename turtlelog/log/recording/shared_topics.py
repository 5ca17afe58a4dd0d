"""Run -> the topics by which other programs know a robot: /odom, /tf and /path."""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.recording.topics import ODOMETRY, PATH, TRANSFORMS, Topic
from turtlelog.run import PoseColumns, Run

WORLD: Final = "world"
ROBOT: Final = "turtle1"
"""Frames as in the tutorials of tf2, where a broadcaster sends turtlesim's poses."""

MOST_SHARED: Final = 200_000
"""Poses that are written once more: an odometry has 720 bytes, most of them covariances, so these
take 150 MB while they are written. At 62.5 Hz it is a drive of 53 minutes."""


_LATEST_NS: Final = 2**31 * 1_000_000_000
"""Seconds of a stamp have 32 bits."""


def build_shared_messages(run: Run) -> tuple[TopicColumns, ...]:
    """Return the poses as odometry, as transforms and, at the last one's time, as one path.

    None where there are more than `MOST_SHARED` poses, or times beyond those of stamps.
    """
    poses = run.poses
    if not can_share(run):
        return ()
    stamps = divmod(poses.time_ns, 1_000_000_000)
    x_m, y_m = poses.xy_m.T
    half_rad = poses.heading_rad / 2.0
    place = {"x": x_m, "y": y_m}
    turn = {"z": np.sin(half_rad), "w": np.cos(half_rad)}
    head = {"header.stamp.sec": stamps[0], "header.stamp.nanosec": stamps[1]}
    odometry = {
        **head,
        **_name_all("header.frame_id", WORLD, poses),
        **_name_all("child_frame_id", ROBOT, poses),
        **{f"pose.pose.position.{name}": values for name, values in place.items()},
        **{f"pose.pose.orientation.{name}": values for name, values in turn.items()},
        **dict(
            zip(("twist.twist.linear.x", "twist.twist.angular.z"), read_rates(run), strict=True)
        ),
    }
    rows = [*_list_poses(head, place, turn)]
    transforms = np.empty(len(rows), dtype=object)
    transforms[:] = [[_describe_transform(row)] for row in rows]
    path = np.empty(1, dtype=object)
    path[0] = [_describe_pose(row) for row in rows]
    last = {name: values[-1:] for name, values in head.items()}
    return (
        _collect(ODOMETRY, poses.time_ns, odometry),
        _collect(TRANSFORMS, poses.time_ns, {"transforms": transforms}),
        _collect(
            PATH,
            poses.time_ns[-1:],
            {**last, "header.frame_id": np.array([WORLD], dtype=object), "poses": path},
        ),
    )


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


def _name_all(field: str, text: str, poses: PoseColumns) -> dict[str, NDArray[Any]]:
    return {field: np.full(len(poses), text, dtype=object)}


def _list_poses(*parts: dict[str, NDArray[Any]]) -> Iterator[tuple[Any, ...]]:
    """Yield seconds, nanoseconds, x, y and the quaternion's z and w of each pose."""
    yield from zip(*(values.tolist() for part in parts for values in part.values()), strict=True)


def _describe_head(row: tuple[Any, ...]) -> dict[str, Any]:
    sec, nanosec = row[:2]
    return {"header.stamp.sec": sec, "header.stamp.nanosec": nanosec, "header.frame_id": WORLD}


def _describe_transform(row: tuple[Any, ...]) -> dict[str, Any]:
    names = ("translation.x", "translation.y", "rotation.z", "rotation.w")
    values = dict(zip((f"transform.{name}" for name in names), row[2:], strict=True))
    return {**_describe_head(row), "child_frame_id": ROBOT, **values}


def _describe_pose(row: tuple[Any, ...]) -> dict[str, Any]:
    names = ("position.x", "position.y", "orientation.z", "orientation.w")
    values = dict(zip((f"pose.{name}" for name in names), row[2:], strict=True))
    return {**_describe_head(row), **values}


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
