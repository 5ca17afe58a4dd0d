"""What to read of a file: topics, frames, times and wheels; and where notes on it are shown."""

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Literal, TypedDict

from turtlelog.display import join_words
from turtlelog.errors import LogError
from turtlelog.files.urls import RemotePath, make_path

if TYPE_CHECKING:
    from turtlelog.run import SourceTopic

TimeSource = Literal["auto", "log", "stamp"]
"""Source of pose times: the recorder's clock, stamps mapped to it, or chosen from the bag
(`auto`)."""


class ReadOptions(TypedDict, total=False):
    """The fields of a `ReadChoice`, as arguments by name."""

    pose_topic: str | None
    command_topic: str | None
    path_topic: str | None
    pose_frame: str | None
    world_frame: str | None
    goal: tuple[float, ...] | None
    time: TimeSource
    robot: str | None
    wheel_joints: str | None
    wheels: tuple[float, ...] | None
    wheelbase: float | None
    columns: Mapping[str, str]
    allow_partial: bool
    allow_no_poses: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadChoice:
    """Topics, frames and times to read from third-party files; options for incomplete files.

    Attributes:
        pose_topic: Topic of the poses. Default of all topics: chosen by types and names.
        command_topic: Topic of the commands.
        path_topic: Topic of the path to follow.
        pose_frame: The robot's frame, for poses from transforms.
        world_frame: Reference frame, for poses from transforms.
        goal: Goal x, y [m] and optionally heading [rad]. Default: the goal in the file.
        time: Clock that times the poses.
        robot: Name of one of several robots, as in the topic `/robot2/odom` or column `robot2_x`.
        wheel_joints: Names of the left and the right wheel in sensor_msgs/JointState, as in
            `wheel_left_joint,wheel_right_joint`: poses are the odometry of these wheels.
        wheels: Radius of the wheels and track between them [m].
        wheelbase: Distance between the axles [m], for converting Ackermann commands to turn rates.
        columns: Columns of a plain table, by quantity (`t`, `x`, `y`, `heading` ...). Each value is
            the column name, with a unit in brackets if the name has no unit (`yaw [deg]`).
        allow_partial: Whether to read the intact part of an unfinished or damaged recording.
        allow_no_poses: Whether to read a bag that contains only commands as a run without poses.
    """

    pose_topic: str | None = None
    command_topic: str | None = None
    path_topic: str | None = None
    pose_frame: str | None = None
    world_frame: str | None = None
    goal: tuple[float, ...] | None = None
    time: TimeSource = "auto"
    robot: str | None = None
    wheel_joints: str | None = None
    wheels: tuple[float, ...] | None = None
    wheelbase: float | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    allow_partial: bool = False
    allow_no_poses: bool = False

    def override(self, other: "ReadChoice") -> "ReadChoice":
        """Return this choice with the settings of another choice added; columns are merged."""
        asked = {name: getattr(other, name) for name in other.list_given()}
        return replace(self, **asked | {"columns": {**self.columns, **other.columns}})

    def list_given(self) -> list[str]:
        """Return the names of the options that differ from their defaults."""
        return [name for name, usual in _USUAL.items() if getattr(self, name) != usual]


FileKind = Literal["table", "recording", "bag"]

_USUAL: Final = {name: getattr(ReadChoice(), name) for name in ReadOptions.__annotations__}

_OF_TABLES: Final = ("columns",)
_OF_EVERY_FILE: Final = ("goal", "allow_partial", "allow_no_poses")
_OF_BAGS: Final = tuple(name for name in _USUAL if name not in {*_OF_TABLES, *_OF_EVERY_FILE})


def describe_unused(
    choice: ReadChoice, kind: FileKind, commands: "SourceTopic | None" = None
) -> str:
    """Return one line on the options that a file does not use, and why; empty without such options.

    Recordings have one clock and turn rates as commands; `commands` are the topic of a bag.
    """
    given = choice.list_given()
    of_recording = (*_OF_TABLES, "time", "wheelbase")
    never = {"table": _OF_BAGS, "recording": of_recording, "bag": _OF_TABLES}[kind]
    reasons = {"table": "this is a table", "recording": "this is a turtlelog recording"}
    parts = []
    if names := [name for name in given if name in never]:
        texts = [
            f"--column {', '.join(choice.columns)}"
            if name == "columns"
            else f"--{name.replace('_', '-')}"
            for name in names
        ]
        verb = "is" if len(texts) == 1 else "are"
        reason = reasons.get(kind, "this is no table")
        parts.append(f"{join_words(texts)} {verb} not used: {reason}")
    if kind == "bag" and "wheelbase" in given:
        if commands is None:
            parts.append("--wheelbase is not used: no commands were read")
        elif not commands.type.startswith("ackermann_msgs"):
            said = f"the commands on {commands.describe()} are turn rates"
            parts.append(f"--wheelbase is not used: {said}")
    return "; ".join(parts)


def split_topic(path: str | Path) -> tuple[Path, str | None]:
    """Return the file and the topic of its poses in FILE:TOPIC, as in `bag:/odom_kf`.

    An existing file with the whole name has priority. The slash of the topic is optional.
    """
    path = make_path(path)
    if isinstance(path, RemotePath):
        return path.split_topic()
    text = path.as_posix()
    head, colon, _ = text.rpartition(":")
    while colon and not path.exists():
        topic = text[len(head) + 1 :]
        if head and topic and Path(head).exists():
            return Path(head), topic
        head, colon, _ = head.rpartition(":")
    return path, None


def match_topic(asked: str, names: Collection[str]) -> str:
    """Return the topic with a name, with or without leading slash; or else the name itself."""
    other = asked.removeprefix("/") if asked.startswith("/") else f"/{asked}"
    return other if asked not in names and other in names else asked


def parse_goal_option(goal: tuple[float, ...]) -> tuple[tuple[float, float], float | None]:
    """Return position [m] and heading [rad] of a requested goal; None for a missing heading."""
    if len(goal) not in {2, 3} or not all(map(math.isfinite, goal)):
        raise LogError(f"goal: expected x, y [m] and perhaps a heading [rad], found {goal!r:.60}")
    x_m, y_m, *heading_rad = map(float, goal)
    return (x_m, y_m), heading_rad[0] if heading_rad else None


NEEDS_WHEELS: Final = "joints give poses with --wheel-joints LEFT,RIGHT --wheels RADIUS,TRACK, in m"
NEEDS_WHEELBASE: Final = "steering gives turn rates with --wheelbase L, in m"


def parse_joints(text: str) -> tuple[str, str]:
    """Return the names of the left and the right wheel."""
    names = [name.strip() for name in text.split(",")]
    if len(names) != 2 or not all(names) or names[0] == names[1]:
        raise LogError(f"wheel_joints: expected LEFT,RIGHT, two joints, found {text[:60]}")
    return names[0], names[1]


def parse_wheels(values: tuple[float, ...]) -> tuple[float, float]:
    """Return the radius of wheels and the distance between them [m]."""
    if len(values) != 2 or not all(0.0 < value < math.inf for value in values):
        raise LogError(
            f"wheels: expected radius and track above 0 in m, as in (0.033, 0.16), found"
            f" {values!r:.60}"
        )
    return float(values[0]), float(values[1])


def parse_wheelbase(value: float) -> float:
    """Return the distance between the axles [m]."""
    if not 0.0 < value < math.inf:
        raise LogError(f"wheelbase: expected a length above 0 in m, found {value!r:.60}")
    return float(value)


CHOSEN: Final = "chosen"
"""Name of the note on the chosen topics or columns. Only runs read from their source have it."""

CLOCK_SET: Final = "clock_set"
"""Name of the note on steps of the recorder's clock."""

RESTARTS: Final = "restarts"
"""Name of the note on times that start again, as of two runs one below the other."""

UNREAD_COMMANDS: Final = "unread_commands"
"""Name of the note on columns of a table that look like commands and are not read."""

UNUSED: Final = "unused"
"""Name of the note on options that a file does not use."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NoteKind:
    """Where a note on the reading of a file is shown.

    Attributes:
        after: Files whose notes follow an answer: a run's own `source`, not a recording that was
            converted from it, or `any` file. None: the note does not follow an answer.
        in_info: Whether `info` shows it.
        has_label: Whether its name precedes it after an answer.
        doubt: Clause about an end whose numbers the note puts in doubt; empty without doubt.
        is_recorded: Whether recordings store it.
    """

    after: Literal["source", "any"] | None = None
    in_info: bool = False
    has_label: bool = True
    doubt: str = ""
    is_recorded: bool = True


_IN_INFO: Final = NoteKind(in_info=True)
_OF_SOURCE: Final = NoteKind(after="source", in_info=True)

NOTES: Final[Mapping[str, NoteKind]] = MappingProxyType(
    {
        "preset": NoteKind(after="any", has_label=False),
        CHOSEN: NoteKind(after="source", has_label=False, is_recorded=False),
        UNREAD_COMMANDS: NoteKind(after="source"),
        "mixed_topics": _OF_SOURCE,
        "goal": _IN_INFO,
        "path": _IN_INFO,
        UNUSED: NoteKind(after="any", in_info=True, has_label=False, is_recorded=False),
        "crowded": replace(_OF_SOURCE, doubt=", but the times of most poses are wrong"),
        "clock": _OF_SOURCE,
        CLOCK_SET: _OF_SOURCE,
        "silence": _OF_SOURCE,
        "plane": replace(_OF_SOURCE, has_label=False),
        "quaternion_order": NoteKind(after="source"),
        "dropped_nan": _OF_SOURCE,
        "rows_without_pose": NoteKind(after="source"),
        "held_transforms": _OF_SOURCE,
        "dropped_before_transforms": _OF_SOURCE,
        "robots": _IN_INFO,
        "other_robot": replace(_OF_SOURCE, has_label=False),
        "heading": _OF_SOURCE,
        "origin": _IN_INFO,
        "wheels": _OF_SOURCE,
        "reported_rates": _OF_SOURCE,
        "leaps": _OF_SOURCE,
        "path_by_speed": _OF_SOURCE,
        "still": _OF_SOURCE,
        "other_pose_topics": _IN_INFO,
        "not_poses": _IN_INFO,
        "other_frames": _IN_INFO,
        RESTARTS: _OF_SOURCE,
        "unlikely_units": replace(_OF_SOURCE, doubt=", in units that are unlikely"),
        "heading_and_travel": _OF_SOURCE,
        "turning_by_rate": _OF_SOURCE,
        "repeated_headers": NoteKind(after="source"),
        "other_command_topics": _IN_INFO,
        "recovered": NoteKind(after="any"),
        "partial": NoteKind(after="any"),
        # Shown by commands that list all notes of a run.
        **dict.fromkeys(
            (
                *("original_timestamp", "pose_topic", "command_topic", "path_topic", "frame"),
                *("goal_set_ns", "path_set_ns", "other_path_topics", "robot", "columns"),
                *("poses", "commands", "samples", "not_read", "not_understood", "bag_files"),
                *("sorted_rows", "dropped_duplicates", "moved_rows", "wrapped_headings"),
                *("close_rows", "height", "rows_without_command"),
                *("measured_speed", "measured_turn_rate", "pose_times", "scenario", "slice"),
            ),
            NoteKind(),
        ),
    }
)
"""Every note of a run, in the order in which answers show them."""


def label_note(name: str) -> str:
    """Return the words that precede a note."""
    return name.replace("_", " ")


def list_notes_after(notes: Mapping[str, str]) -> Iterator[str]:
    """Yield the notes that follow an answer, those on a run's own source first."""
    for after in ("source", "any") if CHOSEN in notes else ("any",):
        for name, kind in NOTES.items():
            if kind.after == after and name in notes:
                yield f"{label_note(name)}: {notes[name]}" if kind.has_label else notes[name]
