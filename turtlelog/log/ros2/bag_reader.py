"""Bag -> Run: which of its topics, and what they hold."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, Unpack

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.opening import strip_suffixes
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.error_boundary import name_file
from turtlelog.log.info import RecordingInfo, TopicInfo
from turtlelog.log.read_choice import ReadChoice, ReadOptions
from turtlelog.log.recording.topics import (
    CONTROL,
    GOAL,
    LAW_STATE,
    POSE,
    REFERENCE64,
    SENSED,
    SHAPED,
)
from turtlelog.log.ros2.bag import open_bag
from turtlelog.log.ros2.bag_columns import (
    Fields,
    OrderedRows,
    Values,
    extract_commands,
    extract_poses,
    order_rows,
    separate_times,
    wrap_far_headings,
)
from turtlelog.log.ros2.bag_topics import choose_command_topic, choose_pose_topic
from turtlelog.run import CommandColumns, PoseColumns, Run, SampleColumns

NOT_READ: Final = "not_read"
"""Note on messages that are there and are not read."""

_NEVER_IN_BAGS: Final = (
    *("samples", "goal_xy_m", "goal_heading_rad", "parameters", "stop_reason", "events"),
)

_Found = Sequence[Mapping[str, TopicColumns]]
"""The columns of each file, by topic."""

_SENSED: Final = (SENSED.name, SENSED.schema)


def read_bag(path: str | Path, **options: Unpack[ReadOptions]) -> Run:
    """Return the run in a bag of ROS 2, or in an MCAP file by another recorder.

    Times count from the first pose or command. Rows are sorted by time and exact duplicates
    dropped; of several poses of one time the later ones move on by 1 ns each. The run's notes count
    all of it.

    Args:
        path: A folder with `metadata.yaml`, or a lone file.
        options: Fields of a `ReadChoice`: which topics to read, where more than one can be meant.

    Raises:
        LogError: One line with the file and the place, where it cannot be read, holds no poses, or
            more than one topic can be meant.
    """
    choice, bag = ReadChoice(**options), open_bag(path)
    distinct = bag.topics
    with name_file(bag.path, expected="a bag"):
        poses = choose_pose_topic(distinct, choice.pose_topic)
        commands = choose_command_topic(distinct, choice.command_topic, pose_topic=poses.topic)
    names = {topic.topic for topic in (poses, commands) if topic}
    if poses.topic == POSE.name:
        names |= {topic.topic for topic in distinct if (topic.topic, topic.type) == _SENSED}
    found = bag.read(names)
    with name_file(bag.path, expected="a bag"):
        run = _build_run(bag.path, found, poses, commands)
    rest = _note_rest(distinct, run)
    return replace(run, notes={**run.notes, **rest, **_join_notes(bag.infos.values())})


def _note_rest(topics: Iterable[TopicInfo], run: Run) -> dict[str, str]:
    """Return a note on the topics of a recording of ours, which only one of ours is read with."""
    sensed = (SENSED,) if run.poses.sensed_xy_m is None else ()
    own = {topic.name: topic.schema for topic in (CONTROL, GOAL, REFERENCE64, SHAPED, *sensed)}
    rest = [
        f"{topic.count} of {topic.topic}"
        for topic in topics
        if topic.count and (own.get(topic.topic) == topic.type or topic.topic == LAW_STATE)
    ]
    return {NOT_READ: ", ".join(rest)} if rest else {}


def _join_notes(infos: Iterable[RecordingInfo]) -> dict[str, str]:
    """Return what the files say of themselves: that they were recovered."""
    return {name: text for info in infos for name, text in info.notes.items()}


def _build_run(
    path: Path, found: _Found, pose_topic: TopicInfo, command_topic: TopicInfo | None
) -> Run:
    poses = _order(found, pose_topic, extract_poses)
    commands = None if command_topic is None else _order(found, command_topic, extract_commands)
    tables = [rows for rows in (poses, commands) if rows]
    start_ns = min(int(rows.time_ns[0]) for rows in tables)
    time_ns, moved = separate_times(poses.time_ns - start_ns)
    heading_rad, wrapped = wrap_far_headings(poses.columns["heading"])
    name = path.resolve().name
    columns = poses.columns
    absent = () if "speed" in columns else ("poses.speed_m_s", "poses.turn_rate_rad_s")
    sensed = _match_sensed(found, poses.time_ns, moved)
    notes = {
        "original_timestamp": _format_time(start_ns),
        "pose_topic": f"{pose_topic.topic} ({pose_topic.type})",
        "sorted_rows": str(sum(rows.late for rows in tables)),
        "dropped_duplicates": str(sum(rows.duplicates for rows in tables)),
        "moved_rows": str(moved),
        "wrapped_headings": str(wrapped),
    }
    if command_topic is not None:
        notes["command_topic"] = f"{command_topic.topic} ({command_topic.type})"
    return Run(
        name=name if path.is_dir() else strip_suffixes(path),
        source=f"{'mcap' if path.suffix == '.mcap' else 'rosbag2'}: {name}",
        poses=PoseColumns(
            time_ns=time_ns,
            xy_m=np.column_stack([poses.columns["x"], poses.columns["y"]]),
            heading_rad=heading_rad,
            speed_m_s=columns.get("speed"),
            turn_rate_rad_s=columns.get("turn_rate"),
            measured_speed_m_s=columns.get("measured_speed"),
            measured_turn_rate_rad_s=columns.get("measured_turn_rate"),
            sensed_xy_m=None if sensed is None else sensed[:, :2].copy(),
            sensed_heading_rad=None if sensed is None else sensed[:, 2].copy(),
        ),
        commands=_build_commands(commands, start_ns),
        samples=_build_no_samples(),
        absent=(*absent, *(() if commands else ("commands",)), *_NEVER_IN_BAGS),
        notes=notes,
    )


def _match_sensed(found: _Found, time_ns: NDArray[np.int64], moved: int) -> Values | None:
    """Return x, y and heading as sensed, beside the poses of the same times; NaN without one.

    None where there are none, or their times do not tell whose they are: those of a wall clock.
    """
    kind = TopicInfo(topic=SENSED.name, type=SENSED.schema, count=0)
    if moved or not any(SENSED.name in of_file for of_file in found):
        return None
    sensed = _order(found, kind, extract_poses)
    rows = np.searchsorted(time_ns, sensed.time_ns)
    is_known = np.isin(sensed.time_ns, time_ns).all()
    if not is_known or (np.diff(sensed.time_ns) == 0).any():
        return None
    values = np.full((len(time_ns), 3), np.nan)
    values[rows] = np.column_stack([sensed.columns[name] for name in ("x", "y", "heading")])
    return values


def _order(
    found: _Found, choice: TopicInfo, extract: Callable[[str, Fields], dict[str, Values]]
) -> OrderedRows:
    """Return the rows of a topic from all files."""
    messages = [of_file[choice.topic] for of_file in found if choice.topic in of_file]
    tables = []
    for columns in messages:
        if columns.type != choice.type:
            raise LogError(f"topic {choice.topic}: expected {choice.type}, found {columns.type}")
        try:
            tables.append(extract(choice.type, columns.fields))
        except LogError as err:
            raise LogError(f"topic {choice.topic}: {err}") from err
        except KeyError as err:
            raise LogError(
                f"topic {choice.topic}: expected {choice.type} with a field {err.args[0]},"
                f" found {', '.join(columns.fields)}"
            ) from err
    return order_rows(messages, tables)


def _build_commands(rows: OrderedRows | None, start_ns: int) -> CommandColumns:
    none = np.zeros(0)
    columns = rows.columns if rows else dict.fromkeys(("speed", "lateral_speed", "turn_rate"), none)
    return CommandColumns(
        time_ns=rows.time_ns - start_ns if rows else np.zeros(0, dtype=np.int64),
        speed_m_s=columns["speed"],
        lateral_speed_m_s=columns["lateral_speed"],
        turn_rate_rad_s=columns["turn_rate"],
    )


def _build_no_samples() -> SampleColumns:
    """Return a table without rows: what a controller computed stands in no bag."""
    none, whole = np.zeros(0), np.zeros(0, dtype=np.int64)
    return SampleColumns(
        time_ns=whole,
        sequence=whole,
        pose_sequence=whole,
        phase=whole,
        speed_m_s=none,
        turn_rate_rad_s=none,
    )


def _format_time(time_ns: int) -> str:
    """Return a time since the epoch as ISO 8601 in UTC, to the nanosecond."""
    seconds, nanoseconds = divmod(time_ns, 1_000_000_000)
    try:
        return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{nanoseconds:09d}Z"
    except (OverflowError, OSError, ValueError):
        return f"{time_ns} ns"
