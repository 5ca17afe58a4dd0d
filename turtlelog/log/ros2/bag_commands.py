"""Commands of a bag, and samples if the bag contains turtlelog's topics."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import describe_count, format_utc
from turtlelog.errors import LogError
from turtlelog.laws.sequential_p import DECLARATION as SEQUENTIAL_P
from turtlelog.log.engine.opening import strip_suffixes
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.file_info import TopicInfo
from turtlelog.log.read_choice import ReadChoice, parse_wheelbase
from turtlelog.log.recording.head import MAY_BE_ABSENT, lacks_values
from turtlelog.log.recording.topics import CONTROL, CONTROL_COLUMNS, PHASE, POSE
from turtlelog.log.ros2.bag import Bag
from turtlelog.log.ros2.bag_clock import time_rows
from turtlelog.log.ros2.bag_poses import note_pick
from turtlelog.log.ros2.bag_rows import (
    Fields,
    Held,
    OrderedRows,
    Values,
    drop_not_finite,
    order_topic,
)
from turtlelog.log.ros2.bag_topics import (
    ACKERMANN_TYPES,
    COMMAND_TYPES,
    NEEDS_WHEELBASE,
    TWIST_TYPES,
    NoPosesError,
    Pick,
    choose_command_topic,
)
from turtlelog.log.ros2.pose_types import read_twist, widen
from turtlelog.run import CommandColumns, PoseColumns, Run, SampleColumns
from turtlelog.run.loops import DONE, PAUSE, Declaration

NEVER_IN_BAGS: Final = (
    *("samples", "goal_xy_m", "goal_heading_rad", "parameters", "stop_reason", "events"),
)
"""Fields of `Run` that no bag of a robot contains."""


def read_commands_alone(
    bag: Bag, topics: Sequence[TopicInfo], choice: ReadChoice, err: NoPosesError
) -> tuple[Run, str]:
    """Return the run of a bag that contains commands but no poses, and the topic's name."""
    pick, lack = choose_commands(topics, choice, pose_topic="")
    if pick is None:
        raise NoPosesError(f"no poses; {lack}") if lack else err
    if not choice.allow_no_poses:
        if err.is_unread:  # the reason of unreadable poses is more helpful
            raise err
        raise NoPosesError(
            f"no poses, only commands on {pick.describe()}: info, metrics, check, plot and replay"
            " take commands alone, and what was asked for needs poses"
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
    no_time_ns = np.zeros(0, dtype=np.int64)
    run = Run(
        name=name,
        source=source,
        poses=PoseColumns(time_ns=no_time_ns, xy_m=np.zeros((0, 2)), heading_rad=none),
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
    return run, pick.topic.topic


def name_bag(path: Path) -> tuple[str, str]:
    """Return the name and the source of a run from a bag."""
    name = path.resolve().name
    storage = {".mcap": "mcap", ".bag": "rosbag1"}.get(path.suffix, "rosbag2")
    return (name if path.is_dir() else strip_suffixes(path)), f"{storage}: {name}"


def choose_commands(
    topics: Sequence[TopicInfo], choice: ReadChoice, *, pose_topic: str
) -> tuple[Pick | None, str]:
    """Return the topic of the commands, or the reason why there is none, which may be empty.

    Ackermann commands have priority if a wheelbase is given. Without a wheelbase, they give no turn
    rate.
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
    """Return finite commands and the number of dropped ones; None if no command is finite."""
    extract = partial(_extract_commands, wheelbase_m=choice.wheelbase)
    ordered = order_topic(found, topic, extract)
    rows, dropped = drop_not_finite(ordered, [*ordered.columns])
    return (rows if len(rows.time_ns) else None), dropped


def _extract_commands(
    kind: str, fields: Fields, *, wheelbase_m: float | None = None
) -> dict[str, Values]:
    """Return forward and lateral speed [m/s] and turn rate [rad/s].

    Ackermann commands need the distance between the axles: a car turns with speed * tan(steering
    angle) / wheelbase. The turn rate is NaN from 90 deg on.
    """
    if kind in ACKERMANN_TYPES and wheelbase_m is not None:
        drive = "drive." if kind.endswith("Stamped") else ""
        speed_m_s = widen(fields[f"{drive}speed"])
        steering_rad = widen(fields[f"{drive}steering_angle"])
        is_aside = np.abs(steering_rad) >= np.pi / 2.0  # No car turns with a wheel at 90 deg.
        steering_rad = np.where(is_aside, np.nan, steering_rad)
        return {
            "speed": speed_m_s,
            "lateral_speed": np.zeros_like(speed_m_s),
            "turn_rate": speed_m_s * np.tan(steering_rad) / wheelbase_m,
        }
    return read_twist(fields, "twist." if kind == "geometry_msgs/msg/TwistStamped" else "")


def build_commands(rows: OrderedRows | None, start_ns: int) -> CommandColumns:
    """Return commands as columns of a run, with times from its start."""
    none = np.zeros(0)
    columns = rows.columns if rows else dict.fromkeys(("speed", "lateral_speed", "turn_rate"), none)
    return CommandColumns(
        time_ns=rows.time_ns - start_ns if rows else np.zeros(0, dtype=np.int64),
        speed_m_s=columns["speed"],
        lateral_speed_m_s=columns["lateral_speed"],
        turn_rate_rad_s=columns["turn_rate"],
    )


Times = NDArray[np.int64]


def add_samples(run: Run, bag: Bag, start_ns: int) -> Run:
    """Return a run with the samples of its bag if they fit its poses. A note describes the result.

    The run has the poses of `/turtle1/pose`; its time 0 is `start_ns` on the recorder's clock.
    """
    kinds = {(topic.topic, topic.type) for topic in bag.topics if topic.count}
    if (CONTROL.name, CONTROL.schema) not in kinds:
        return run
    names = {CONTROL.name, *({PHASE.name} if (PHASE.name, PHASE.schema) in kinds else ())}
    files = bag.read(names)
    found = [of_file[CONTROL.name] for of_file in files if CONTROL.name in of_file]
    phases = [of_file[PHASE.name] for of_file in files if PHASE.name in of_file]
    try:
        time_ns, columns = _join(found)
        written = sum(topic.count for topic in bag.topics if topic.topic == POSE.name)
        _require_fit(run, written, time_ns - start_ns, columns)
    except LogError as err:
        return replace(run, notes={**run.notes, "samples": f"not read: {err}"})
    told = _read_names(phases, time_ns, columns["phase"])
    highest = int(columns["phase"].max())
    samples = SampleColumns(time_ns=time_ns - start_ns, **columns)
    named = "by /turtle1/phase"
    if told is None:
        named = "as those of sequential-p, as nothing else names them"
    note = (
        f"from {CONTROL.name}; phases are named {named}; the law, its loops and its parameters are"
        " not known"
    )
    return replace(
        run,
        samples=samples,
        declaration=_declare(told, highest),
        absent=("declaration", *(name for name in run.absent if name != "samples")),
        notes={**run.notes, "samples": note},
    )


def _join(found: list[TopicColumns]) -> tuple[Times, dict[str, Any]]:
    """Return times and columns of the samples of all files, sorted by sample number."""
    names = [name for parts in CONTROL_COLUMNS.values() for name in parts]
    try:
        fields = {
            name: np.concatenate([columns.fields[name] for columns in found]) for name in names
        }
    except KeyError as err:
        raise LogError(f"the field {err.args[0]} is missing") from err
    order = np.argsort(fields["sequence"], kind="stable")
    time_ns = np.concatenate([columns.log_time_ns for columns in found])[order]
    numbers = fields["sequence"][order].astype(np.int64)
    if (np.diff(numbers) <= 0).any() or (np.diff(time_ns) < 0).any():
        raise LogError("expected numbers and times that rise together, found others")
    columns: dict[str, Any] = {}
    for name, parts in CONTROL_COLUMNS.items():
        values = np.column_stack([fields[part][order] for part in parts])
        kind = np.float64 if values.dtype.kind == "f" else np.int64
        columns[name] = (values if len(parts) > 1 else values[:, 0]).astype(kind)
    return time_ns, {
        name: None if name in MAY_BE_ABSENT and lacks_values(name, values) else values
        for name, values in columns.items()
    }


def _require_fit(run: Run, written: int, time_ns: Times, columns: Mapping[str, Any]) -> None:
    """Refuse samples whose pose numbers are not rows of the run's poses.

    The file has `written` poses; `time_ns` is when each sample was answered, on the run's clock.
    """
    read, poses = columns["pose_sequence"], run.poses
    if written != len(poses):
        raise LogError(f"expected the {written} poses as they are numbered, found {len(poses)}")
    if int(read.max()) >= len(poses):
        raise LogError(f"expected pose {read.max()}, which a sample read, found {len(poses)} poses")
    early = time_ns < poses.time_ns[read]
    if early.any() or (np.diff(read) < 0).any():
        row = int(early.argmax())
        raise LogError(f"expected pose {read[row]} before the sample that read it, found it later")
    speeds = columns["speed_m_s"], columns["turn_rate_rad_s"]
    if not np.isfinite(speeds).all():
        raise LogError("expected commands that are numbers, found nan or infinity")


def _read_names(
    phases: list[TopicColumns], time_ns: Times, phase: NDArray[np.int64]
) -> dict[int, str] | None:
    """Return the phase names by number; None if the phase messages contradict the samples."""
    named: dict[int, str] = {}
    for columns in phases:
        pairs = zip(columns.log_time_ns.tolist(), columns.fields["data"].tolist(), strict=True)
        for at_ns, name in pairs:
            row = int(np.searchsorted(time_ns, at_ns))
            if name in {PAUSE, DONE} or row >= len(time_ns) or time_ns[row] != at_ns:
                continue
            if named.setdefault(int(phase[row]), name) != name:
                return None
    is_whole = {*phase.tolist()} <= {*named}
    return named if is_whole and len({*named.values()}) == len(named) else None


def _declare(named: Mapping[int, str] | None, highest: int) -> Declaration:
    """Return phases without loops, by number. An unnamed phase gets its number as name."""
    usual = dict(enumerate(SEQUENTIAL_P.phase_names))
    if named is None or all(usual.get(number) == name for number, name in named.items()):
        named = usual
    names = [named.get(number, f"phase_{number}") for number in range(max(highest, *named) + 1)]
    return Declaration(phases=dict.fromkeys(names, ()))
