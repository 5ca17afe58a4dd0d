"""The commands of a bag: in order, as columns, and as a run where there are no poses."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from turtlelog.display import describe_count, format_utc
from turtlelog.errors import LogError
from turtlelog.log.engine.opening import strip_suffixes
from turtlelog.log.file_info import TopicInfo
from turtlelog.log.read_choice import ReadChoice, parse_wheelbase
from turtlelog.log.ros2.bag import Bag
from turtlelog.log.ros2.bag_clock import time_rows
from turtlelog.log.ros2.bag_columns import (
    Held,
    OrderedRows,
    drop_not_finite,
    extract_commands,
    order_topic,
)
from turtlelog.log.ros2.bag_poses import note_pick
from turtlelog.log.ros2.bag_topics import (
    ACKERMANN_TYPES,
    COMMAND_TYPES,
    NEEDS_WHEELBASE,
    TWIST_TYPES,
    NoPosesError,
    Pick,
    choose_command_topic,
)
from turtlelog.run import CommandColumns, PoseColumns, Run, SampleColumns

NEVER_IN_BAGS: Final = (
    *("samples", "goal_xy_m", "goal_heading_rad", "parameters", "stop_reason", "events"),
)
"""What no bag of a robot holds, by the names of `Run`."""


def read_commands_alone(
    bag: Bag, topics: Sequence[TopicInfo], choice: ReadChoice, err: NoPosesError
) -> Run:
    """Return the run of a bag that holds commands and no poses.

    Raises:
        LogError: Where there are no commands either, poses are needed, or something of poses was
            asked for.
    """
    pick, lack = choose_commands(topics, choice, pose_topic="")
    if pick is None:
        raise NoPosesError(f"no poses; {lack}") if lack else err
    if not choice.allow_no_poses:
        found = f"{pick.topic.topic} ({pick.topic.type})"
        # Poses that are there and cannot be read have a reason that says more.
        raise (
            err
            if err.is_unread
            else NoPosesError(
                f"no poses, only commands on {found}: info, metrics, check, plot and replay take"
                " commands alone, and what was asked for needs poses"
            )
        )
    for name in ("goal", "path_topic"):
        if getattr(choice, name) is not None:
            raise LogError(f"{name}: expected poses, found commands alone on {pick.topic.topic}")
    found_messages = [dict(of_file) for of_file in bag.read({pick.topic.topic})]
    rows, dropped = order_commands(found_messages, pick.topic, choice)
    if rows is None:
        raise LogError(
            f"topic {pick.topic.topic}: expected numbers, found nan or infinity in all"
            f" {dropped} commands"
        )
    times = time_rows(rows.stamps, None, choice.time, noun="commands")
    rows = rows.take(times.poses.rows, times.poses.time_ns)
    start_ns = int(rows.time_ns[0])
    none = np.zeros(0)
    name, source = name_bag(bag.path)
    return Run(
        name=name,
        source=source,
        poses=PoseColumns(
            time_ns=np.zeros(0, dtype=np.int64), xy_m=np.zeros((0, 2)), heading_rad=none
        ),
        commands=build_commands(rows, start_ns),
        samples=SampleColumns.build_empty(),
        clock=times.clock,
        absent=("poses", "poses.speed_m_s", "poses.turn_rate_rad_s", *NEVER_IN_BAGS),
        notes={
            "original_timestamp": format_utc(start_ns),
            "sorted_rows": str(rows.late),
            "dropped_duplicates": str(rows.duplicates),
            **({"dropped_nan": describe_count(dropped, "command")} if dropped else {}),
            **times.notes,
            **note_pick("command_topic", pick),
        },
    )


_STORAGES: Final = {".mcap": "mcap", ".bag": "rosbag1"}
"""How a run says what it was read of, by the ending of a lone file."""


def name_bag(path: Path) -> tuple[str, str]:
    """Return the name and the source of a run that is read of a bag."""
    name = path.resolve().name
    source = f"{_STORAGES.get(path.suffix, 'rosbag2')}: {name}"
    return (name if path.is_dir() else strip_suffixes(path)), source


def choose_commands(
    topics: Sequence[TopicInfo], choice: ReadChoice, *, pose_topic: str
) -> tuple[Pick | None, str]:
    """Return the topic of the commands, and why there is none that could be meant; may be empty.

    Ackermann commands come first where a wheelbase is given, and tell no turn rate without one.

    Raises:
        LogError: Where nothing tells which of several, or what was asked for cannot be read.
    """
    asked = choice.command_topic
    if choice.wheelbase is not None:
        parse_wheelbase(choice.wheelbase)
        pick = choose_command_topic(topics, asked, pose_topic=pose_topic, types=ACKERMANN_TYPES)
        if pick is not None:
            return pick, ""
        if asked is None and pose_topic == "":
            raise LogError(f"wheelbase: expected commands of {' or '.join(ACKERMANN_TYPES)}")
    types = COMMAND_TYPES if asked is not None else TWIST_TYPES
    pick = choose_command_topic(topics, asked, pose_topic=pose_topic, types=types)
    if pick is not None and pick.topic.type in ACKERMANN_TYPES:
        raise LogError(f"command_topic {pick.describe()}: {NEEDS_WHEELBASE}")
    if pick is not None:
        return pick, ""
    steered = choose_command_topic(topics, None, pose_topic=pose_topic, types=ACKERMANN_TYPES)
    return None, "" if steered is None else f"commands on {steered.describe()}: {NEEDS_WHEELBASE}"


def order_commands(
    found: Held, topic: TopicInfo, choice: ReadChoice
) -> tuple[OrderedRows | None, int]:
    """Return commands that are numbers, None without any, and how many are not."""
    extract = partial(extract_commands, wheelbase_m=choice.wheelbase)
    ordered = order_topic(found, topic, extract)
    rows, dropped = drop_not_finite(ordered, [*ordered.columns])
    return (rows if len(rows.time_ns) else None), dropped


def build_commands(rows: OrderedRows | None, start_ns: int) -> CommandColumns:
    """Return commands as a run holds them, with times from its start."""
    none = np.zeros(0)
    columns = rows.columns if rows else dict.fromkeys(("speed", "lateral_speed", "turn_rate"), none)
    return CommandColumns(
        time_ns=rows.time_ns - start_ns if rows else np.zeros(0, dtype=np.int64),
        speed_m_s=columns["speed"],
        lateral_speed_m_s=columns["lateral_speed"],
        turn_rate_rad_s=columns["turn_rate"],
    )
