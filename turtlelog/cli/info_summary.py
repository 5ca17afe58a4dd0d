"""Summary of a file in one sentence, and the use of its missing data."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import turtlelog as tl
from turtlelog.cli.work import TRANSFORMS, find_large
from turtlelog.display import describe_count, join_words
from turtlelog.errors import LogError, TurtlelogError
from turtlelog.run.stop_reasons import GoalEnd, find_goal_end

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from turtlelog.cli.info import InfoAnswer


_FEWEST_RATED: Final = 20
"""Smallest number of messages for which a rate is given."""

_SHORTEST_NS: Final = 1_000
"""Shortest step between messages that counts [ns]; shorter steps are between poses of the same
time."""

_STEADY: Final = 3.0
"""Ratio of slow to quick steps (10 % quantiles) above which no rate is given."""

NOTHING_LEFT: Final = "truncated: no message can be recovered"
"""Description of an incomplete file without messages."""

_TURTLESIM: Final = "turtlesim"
_ROBOT: Final = "a robot"
_IMU_ALONE: Final = "an IMU, which turns in one place"
_CONTROLLER: Final = "a log of a controller"
_TABLE: Final = "poses in a table"
_NO_POSES: Final = "commands without poses"

_NO_ROBOTS: Final = frozenset({_TURTLESIM, _IMU_ALONE, _CONTROLLER, _TABLE, _NO_POSES})
"""Kinds of runs other than robots; a robot's kind may name the type of its poses."""

_SHOWN_TOPICS: Final = 3

CONTROL: Final = "turtlelog_msgs/msg/ControlSample"


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadRun:
    """Summary of the run in a file.

    Attributes:
        kind: Kind of robot that the poses belong to.
        duration_s: The metric `run.duration` [s].
        poses: Topic, rate (if steady) and number of the poses; empty without poses.
        commands: Topic of the commands; empty without commands.
        samples: Number of samples of a controller.
    """

    kind: str
    duration_s: float
    poses: str
    commands: str
    samples: int

    @property
    def is_robot(self) -> bool:
        """Whether the poses are those of a robot other than turtlesim."""
        return self.kind not in _NO_ROBOTS

    @property
    def first_row(self) -> str:
        """Row at time zero of the duration: the first `sample`, or else `pose` or `command`."""
        return "sample" if self.samples else "pose" if self.poses else "command"


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """Description of a file.

    Attributes:
        text: One sentence without a full stop.
        end: How the run ended at its goal; None if unknown.
        run: Summary of the run in the file; None if the run was not read.
        missing: Missing data, each with its use.
        needs: What the file needs to be measured.
        was_clock_set: Whether the recorder's clock was set while it recorded.
        clock: Clock that times the poses; None if there is only one clock, or poses were not read.
        notes: Notes on the poses, by name.
    """

    text: str
    end: GoalEnd | None = None
    run: ReadRun | None = None
    missing: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    was_clock_set: bool = False
    clock: "tl.run.Clock | None" = None
    notes: Mapping[str, str] = field(default_factory=dict)


def summarise(
    path: Path, info: "tl.log.RecordingInfo", choice: "tl.log.ReadChoice", *, is_asked: bool = False
) -> Summary:
    """Return the description of a file; of a bag, from poses and commands unless it is large."""
    is_lost = holds_nothing(info)
    if info.format_version is not None:
        text = f"a recording of turtlelog's, {NOTHING_LEFT}" if is_lost else _summarise_own(info)
        return Summary(text=text, end=_find_end(path, info, is_asked=is_asked))
    if not info.complete and (is_lost or not choice.allow_partial):
        text = NOTHING_LEFT if is_lost else _summarise_topics(info, "it is not complete")
        return Summary(text=text)
    if not is_asked and (large := find_large(path, info)):
        note = f"not looked at, {large}: info --clock does"
        return Summary(text=_summarise_topics(info, ""), notes={"clock": note})
    try:
        run = tl.log.read_as_chosen(path, replace(choice, allow_no_poses=True))
    except TurtlelogError as err:
        if replace(choice, allow_partial=False) != tl.log.ReadChoice():
            raise  # the requested data do not exist
        reason = str(err).removeprefix(f"{path}: ")
        others = tl.log.ros2.describe_other_places(info.topics)
        return Summary(
            text=_summarise_topics(info, reason),
            needs=_list_needs(info),
            notes={"not_poses": others} if others else {},
        )
    return _summarise_run(run, info)


def list_absent(recording: "tl.log.RecordingInfo", summary: Summary) -> tuple[str, ...]:
    """Return the absent fields. Topics of commands are known only if the run was read."""
    run = summary.run
    more = [] if run is None or run.poses else ["poses"]
    more += [] if run is None or run.commands else ["commands"]
    if summary.run is None and recording.format_version is None:
        held = {topic.type for topic in recording.topics if topic.count}
        kinds = {"poses": tl.log.POSE_TYPES, "commands": tl.log.COMMAND_TYPES}
        more += [name for name, types in kinds.items() if not held.intersection(types)]
    return tuple(dict.fromkeys([*more, *recording.absent]))


def holds_nothing(info: "tl.log.RecordingInfo | InfoAnswer") -> bool:
    """Return whether a file was not finished and has no messages."""
    return not info.complete and not any(topic.count for topic in info.topics)


class FileKind(NamedTuple):
    """Kind of a file as text that can be counted."""

    noun: str
    rest: str = ""  # what follows the noun, also in the plural


def name_kind(answer: "InfoAnswer") -> FileKind:
    """Return the kind of a file."""
    if answer.format_version is not None:
        return FileKind("recording")
    if answer.run is None:
        return FileKind("file", " without a run")
    return FileKind(name_bag(answer) if answer.topics else "table")


def name_bag(answer: "InfoAnswer") -> str:
    """Return the kind of a bag; a file without types of ROS is none."""
    if answer.source == "mcap" and not any("/msg/" in topic.type for topic in answer.topics):
        return "MCAP file"
    return f"ROS {1 if answer.source == 'ros1' else 2} bag"


def _summarise_own(info: "tl.log.RecordingInfo") -> str:
    law, plant = info.parameters.get("law.kind"), info.parameters.get("plant.kind", "turtlesim")
    is_simulated = tl.run.find_source_kind(info.source) is tl.run.SourceKind.SIMULATION
    origin = "" if is_simulated else f", from {info.source}"
    counts = {
        noun: sum(topic.count for topic in info.topics if topic.type == kind)
        for kind, noun in ((CONTROL, "sample"), ("turtlesim/msg/Pose", "pose"))
    }
    rows = join_words([describe_count(count, noun) for noun, count in counts.items() if count])
    length = "" if info.duration_s is None else f" in {info.duration_s:.1f} s"
    parts = [f"{law} on {plant}" if law and info.scenario else str(law or ""), f"{rows}{length}"]
    state = "" if info.complete else ", not complete"
    return f"a recording of turtlelog's{state}{origin}: {', '.join(filter(None, parts)) or 'empty'}"


def _find_end(path: Path, info: "tl.log.RecordingInfo", *, is_asked: bool) -> GoalEnd | None:
    """Return how a turtlelog recording's run ended at its goal, unless the file is large."""
    if not info.complete or (not is_asked and find_large(path, info)):
        return None
    try:
        run = tl.log.read_run(path)
    except TurtlelogError:
        return None  # the readable part is described, and `metrics` reports the rest
    return find_goal_end(run)


def _summarise_topics(info: "tl.log.RecordingInfo", reason: str) -> str:
    """Return a description from the topics alone, and why poses could not be read."""
    try:
        tl.log.ros2.select_robot(info.topics, None)
    except LogError as err:
        return str(err)
    try:
        chosen = tl.log.ros2.choose_pose_topic(info.topics, None).topic
    except tl.log.ros2.NoPosesError as err:
        if err.is_unread:
            return f"no poses that can be read: {err}"
        is_undecided = _is_undecided(info, "")
        return f"commands without poses; {reason}" if is_undecided else _summarise_others(info)
    except LogError as err:
        return f"poses, of which none is chosen: {reason or err}"
    if reason and not _is_undecided(info, chosen.topic):
        fault = "give no poses" if chosen.type == TRANSFORMS else "cannot be read"
        noun = "transforms" if chosen.type == TRANSFORMS else "poses"
        return f"{noun} on {chosen.topic}, which {fault}: {reason}"
    is_turtlesim = chosen.type.startswith("turtlesim")
    kind = _TURTLESIM if is_turtlesim else _ROBOT
    rate = ""
    if info.duration_s and chosen.count >= _FEWEST_RATED:
        rate = f", {_format_hz(chosen.count / info.duration_s)} on the average"
    parts = [f"{kind}: {describe_count(chosen.count, 'pose')} on {chosen.topic}{rate}"]
    parts += [] if is_turtlesim else ["not turtlesim"]
    return "; ".join(filter(None, [*parts, reason]))


def _is_undecided(info: "tl.log.RecordingInfo", pose_topic: str) -> bool:
    """Return whether the topic of the commands is ambiguous."""
    try:
        tl.log.ros2.choose_command_topic(info.topics, None, pose_topic=pose_topic)
    except LogError:
        return True
    return False


_SENSORS: Final[Mapping[str, str]] = {
    "sensor_msgs/msg/Imu": "an IMU",
    "sensor_msgs/msg/MagneticField": "a magnetometer",
    "sensor_msgs/msg/LaserScan": "a laser scanner",
    "sensor_msgs/msg/PointCloud2": "a scanner of points",
    "sensor_msgs/msg/Image": "a camera",
    "sensor_msgs/msg/CompressedImage": "a camera",
    "sensor_msgs/msg/Range": "a range sensor",
    "sensor_msgs/msg/NavSatFix": "a satellite receiver",
    "sensor_msgs/msg/JointState": "joints",
    "geometry_msgs/msg/Twist": "commands",
    "geometry_msgs/msg/TwistStamped": "commands",
    "geometry_msgs/msg/PoseStamped": "goals",
    "tf2_msgs/msg/TFMessage": "fixed transforms",
}
"""Descriptions of topics without poses of a robot, by their types."""


def _summarise_others(info: "tl.log.RecordingInfo") -> str:
    present = sorted((topic for topic in info.topics if topic.count), key=lambda one: -one.count)
    if not present:
        return "no poses, nothing to measure: there are no messages"
    shown = present[:_SHOWN_TOPICS]
    names = [f"{topic.topic} ({topic.type or 'no type'})" for topic in shown]
    if any(topic.type in _SENSORS for topic in shown):
        kinds = (_SENSORS.get(topic.type, "messages") for topic in shown)
        names = [f"{kind} on {name}" for kind, name in zip(kinds, names, strict=True)]
    else:
        names[0] = f"messages on {names[0]}"
    names += [f"{len(present) - len(shown)} more"] if len(present) > len(shown) else []
    return f"no poses, nothing to measure: {join_words(names)}"


def _list_needs(info: "tl.log.RecordingInfo") -> tuple[str, ...]:
    try:
        tl.log.ros2.choose_pose_topic(info.topics, None)
    except tl.log.ros2.NoPosesError as err:
        if not err.is_unread and not _is_undecided(info, ""):
            needed = "nav_msgs/msg/Odometry, geometry_msgs/msg/PoseStamped or /tf"
            held = {topic.type for topic in info.topics if topic.count}
            # Options that derive poses and commands from other messages.
            wheels = [tl.log.NEEDS_WHEELS] if tl.log.JOINTS in held else []
            is_car = not held.isdisjoint(tl.log.ACKERMANN_TYPES)
            base = [tl.log.NEEDS_WHEELBASE] if is_car else []
            return (f"to be measured it needs {needed}", *wheels, *base)
    except LogError:
        pass  # there are several
    return ()


def _summarise_run(run: "tl.Run", info: "tl.log.RecordingInfo") -> Summary:
    read = ReadRun(
        kind=_describe_kind(run),
        duration_s=run.duration_s,
        poses=_describe_rows(run.origin.poses, run.poses.time_ns),
        commands=_describe_rows(run.origin.commands, run.commands.time_ns),
        samples=len(run.samples),
    )
    return Summary(
        text=_describe_run(run, read),
        end=find_goal_end(run),
        run=read,
        missing=tuple(_list_missing(run, info)),
        was_clock_set=run.origin.was_clock_set,
        clock=run.clock,
        notes=tl.measure.describe_source(run),
    )


def _describe_rows(source: "tl.run.SourceTopic | None", time_ns: "NDArray[Any]") -> str:
    if not len(time_ns):
        return ""
    rate, topic = _describe_rate(time_ns).removeprefix("at "), _name_topic(source)
    noun = "message" if topic else "row"
    lost = _describe_lost(time_ns, noun) if rate else ""
    return ", ".join(filter(None, (topic, rate, describe_count(len(time_ns), noun), lost)))


def _describe_kind(run: "tl.Run") -> str:
    """Return the source of poses, or the kind of a file without topics."""
    if not len(run.poses):
        return _NO_POSES
    source = run.origin.poses
    if source is None:
        return _CONTROLLER if len(run.samples) else _TABLE
    if not source.type.startswith("turtlesim"):
        is_named = _IMU.search(_name_topic(source)) is not None
        has_moved = bool(len(run.commands)) or (run.poses.xy_m != run.poses.xy_m[0]).any()
        return _IMU_ALONE if is_named and not has_moved else _ROBOT
    return (
        _TURTLESIM
        if tl.replay.moves_as_turtlesim(run)
        else f"{_ROBOT} that publishes {source.type}"
    )


_IMU: Final = re.compile(r"(?i)(?:^|[/_ ])imu(?=$|[/_\d)])")


def _describe_run(run: "tl.Run", read: ReadRun) -> str:
    if not len(run.poses):
        return f"no poses, {_describe_commands(run)}"
    pose_topic = _name_topic(run.origin.poses)
    rate = _describe_rate(run.poses.time_ns)
    amount = rate if rate and pose_topic else describe_count(len(run.poses), "pose")
    amount += f" {rate}" if rate and not pose_topic else ""
    parts = [f"{pose_topic} {amount}" if pose_topic and rate else f"{amount}{_on(pose_topic)}"]
    if len(run.samples):
        parts.append(describe_count(len(run.samples), "sample"))
    elif len(run.commands):
        parts.append(_describe_commands(run))
    else:
        parts.append("no commands")
    return f"{read.kind}: {', '.join(parts)}{'; not turtlesim' if read.is_robot else ''}"


def _on(topic: str) -> str:
    return f" on {topic}" if topic else ""


def _describe_commands(run: "tl.Run") -> str:
    topic, rate = _name_topic(run.origin.commands), _describe_rate(run.commands.time_ns)
    if rate:
        return f"commands{_on(topic)} {rate}"
    return f"{describe_count(len(run.commands), 'command')}{_on(topic)}"


def _name_topic(source: "tl.run.SourceTopic | None") -> str:
    """Return a topic, with the frames of transforms; empty if unknown."""
    if source is None or source.frames is None:
        return "" if source is None else source.name
    return f"{source.name} ({' -> '.join(source.frames)})"


def _describe_rate(time_ns: "NDArray[Any]") -> str:
    """Return the rate of messages; empty if the rate is not steady."""
    import numpy as np

    if len(time_ns) < _FEWEST_RATED:
        return ""
    step_ns = np.diff(time_ns)
    quick, slow = np.quantile(step_ns, [0.1, 0.9])
    if quick < _SHORTEST_NS or slow > _STEADY * quick:
        return ""
    if _find_lost(step_ns):
        return f"at {_format_hz(1e9 / float(np.median(step_ns)))}"
    # Without gaps and bursts; after a long step the next one is shorter.
    usual_ns = step_ns[(step_ns >= quick) & (step_ns <= slow)]
    return f"at {_format_hz(1e9 / float(usual_ns.mean()))}"


_NEAR_MULTIPLE: Final = 0.1
_MULTIPLES: Final = 0.95
"""Distance of a step from a multiple of the usual one, in usual steps, and share of the steps that
are as near: then the messages of a timer are lost, and its period does not vary."""

_LEAST_LOST: Final = 0.02
"""Smallest share of lost messages that is told."""

_MOST_LOST: Final = 10.0
"""Largest step in usual ones that counts: a longer one is a pause."""


def _find_lost(step_ns: "NDArray[Any]") -> float:
    """Return the share of messages that are lost from an even rate, one by one; 0 for few."""
    import numpy as np

    steps = step_ns / float(np.median(step_ns))
    steps = steps[steps <= _MOST_LOST]
    multiples = np.maximum(np.rint(steps), 1.0)
    is_even = np.mean(np.abs(steps - multiples) <= _NEAR_MULTIPLE) >= _MULTIPLES
    # A robot that publishes at two rates makes few steps of two.
    is_single = np.count_nonzero(multiples == 2.0) > np.count_nonzero(multiples > 2.0)
    lost = 1.0 - len(steps) / float(multiples.sum())
    return lost if is_even and is_single and lost >= _LEAST_LOST else 0.0


def _describe_lost(time_ns: "NDArray[Any]", noun: str) -> str:
    """Return how many messages an even rate would add, and the mean rate; empty if few."""
    import numpy as np

    if not (lost := _find_lost(np.diff(time_ns))):
        return ""
    mean = _format_hz((len(time_ns) - 1) / (float(time_ns[-1] - time_ns[0]) / 1e9))
    return f"{100.0 * lost:.0f} % fewer {noun}s than at an even rate ({mean} on average)"


def _format_hz(rate: float) -> str:
    """Return a rate with three digits: 62.5 Hz, 20 Hz."""
    return f"{float(f'{rate:.3g}'):g} Hz"


def _list_missing(run: "tl.Run", info: "tl.log.RecordingInfo") -> "Iterator[str]":
    """Yield the missing data of a file; of a table, commands only if columns look like them."""
    if len(run.samples):
        return
    if tl.log.UNREAD_COMMANDS in run.notes:
        yield f"commands: {run.notes[tl.log.UNREAD_COMMANDS]}"
    lacks = tl.compare.list_lacks(run)
    for lack in lacks:
        is_told = lack in tl.compare.UNLOCKS and tl.compare.can_unlock(lack, lacks)
        if lack in {"poses", "commands"} and lack in run.notes:
            yield run.notes[lack]
        elif is_told and (lack != "commands" or info.topics):
            yield tl.compare.UNLOCKS[lack]
