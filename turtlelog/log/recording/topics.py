"""Topics of a recording: types with text and hash, and the contents of a file, complete or not."""

import json
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from itertools import chain
from typing import Any, BinaryIO, Final

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema

from turtlelog.errors import LogError
from turtlelog.log.engine.blocks import build_walked_block, walk_through
from turtlelog.log.engine.channels import Catalogue, TopicPlan, find_definition
from turtlelog.log.engine.decode import (
    LOG_TIME,
    PUBLISH_TIME,
    SEQUENCE,
    Rows,
    Selection,
    make_empty_rows,
    read_piece,
)
from turtlelog.log.engine.limits import Allowance, measure_stored
from turtlelog.log.engine.message_types import read_type
from turtlelog.log.engine.source import Source, salvage_summary
from turtlelog.log.engine.topic_columns import TopicColumns, build_columns, collect_parts
from turtlelog.log.file_access import DamageError, Loss
from turtlelog.log.recording.head import HEAD, Head, describe_recovery, parse_head
from turtlelog.run import Lost
from turtlelog.run.loops import Declaration
from turtlelog.scenario import DEFAULT_LAW


@dataclass(frozen=True, slots=True)
class Topic:
    """The ROS name of a topic, and its message type, a key of `SCHEMAS`."""

    name: str
    schema: str


# The turtle's goal, with one message.
GOAL: Final = Topic("/turtle1/goal", "geometry_msgs/msg/PoseStamped")

# One message per pose. Exact topics, if 32-bit floats would lose digits, are preferred by readers.
POSE: Final = Topic("/turtle1/pose", "turtlesim/msg/Pose")
POSE64: Final = Topic("/turtle1/pose64", "geometry_msgs/msg/Pose2D")
VELOCITY64: Final = Topic("/turtle1/velocity64", "geometry_msgs/msg/Twist")

# Sensed poses with the numbers of their poses. A pose that dropped out has no message.
SENSED: Final = Topic("/turtle1/sensed_pose", "turtlesim/msg/Pose")
SENSED64: Final = Topic("/turtle1/sensed_pose64", "geometry_msgs/msg/Pose2D")

# The motion reported by the robot: one message per pose, with the pose's number and time.
MEASURED: Final = Topic("/turtle1/measured", "geometry_msgs/msg/Twist")

# One message per sample, at the time when the sample's pose was answered.
CONTROL: Final = Topic("/turtle1/control", "turtlelog_msgs/msg/ControlSample")

CONTROL_COLUMNS: Final[Mapping[str, tuple[str, ...]]] = {
    "sequence": ("sequence",),
    "pose_sequence": ("pose_sequence",),
    "phase": ("phase",),
    "bearing_rad": ("bearing",),
    "heading_error_rad": ("heading_error",),
    "error_xy_m": ("error_x", "error_y"),
    "distance_m": ("distance",),
    "wanted_speed_m_s": ("wanted_speed",),
    "wanted_turn_rate_rad_s": ("wanted_turn_rate",),
    "speed_m_s": ("speed",),
    "turn_rate_rad_s": ("turn_rate",),
    "world_velocity_m_s": ("world_v_x", "world_v_y"),
}
"""Columns of `SampleColumns`, each with the fields of the message that contain it, in order."""

# The law's own numbers, with one message per sample. The law determines the type.
LAW_STATE: Final = "/turtle1/law_state"

# Reference poses of samples, for other tools as quaternions, and exact for readers.
REFERENCE: Final = Topic("/turtle1/reference", "geometry_msgs/msg/PoseStamped")
REFERENCE64: Final = Topic("/turtle1/reference64", "geometry_msgs/msg/Pose2D")

# The shaped command of each sample before the limits; each command at the time of publication.
SHAPED: Final = Topic("/turtle1/shaped", "geometry_msgs/msg/Twist")
COMMAND: Final = Topic("/turtle1/cmd_vel", "geometry_msgs/msg/Twist")

# The name of the phase at each change, for people: readers use the samples. Events.
PHASE: Final = Topic("/turtle1/phase", "std_msgs/msg/String")
EVENT: Final = Topic("/rosout", "rcl_interfaces/msg/Log")

# Poses for other programs: odometry, transforms from the world to the robot, and one path.
ODOMETRY: Final = Topic("/odom", "nav_msgs/msg/Odometry")
TRANSFORMS: Final = Topic("/tf", "tf2_msgs/msg/TFMessage")
PATH: Final = Topic("/path", "nav_msgs/msg/Path")

_POSES: Final = (GOAL, POSE, POSE64, VELOCITY64)
_AFTER_SAMPLES: Final = (COMMAND, PHASE, EVENT)
"""Topics of every recording: topics before `CONTROL`, then topics after the optional ones."""

OF_SENSING: Final[tuple[Topic, ...]] = (SENSED, SENSED64)
"""Topics of a recording whose controller reads poses through a sensor."""

TOPIC_NAMES: Final = frozenset(
    {
        *(topic.name for topic in (*_POSES, *OF_SENSING, CONTROL, SHAPED, *_AFTER_SAMPLES)),
        *(MEASURED.name, LAW_STATE, REFERENCE.name, REFERENCE64.name),
    }
)
"""Names of all topics that a recording may contain."""

_PLANAR: Final = "x", "y", "theta"
_TWIST: Final = "linear.x", "angular.z"
USED_FIELDS: Final[Mapping[str, tuple[str, ...]]] = {
    POSE.name: (*_PLANAR, "linear_velocity", "angular_velocity"),
    **dict.fromkeys((POSE64.name, SENSED.name, SENSED64.name, REFERENCE64.name), _PLANAR),
    **dict.fromkeys((VELOCITY64.name, MEASURED.name, SHAPED.name), _TWIST),
    COMMAND.name: ("linear.x", "linear.y", "angular.z"),
    CONTROL.name: ("sequence", "pose_sequence", *chain(*CONTROL_COLUMNS.values())),
    **dict.fromkeys((PHASE.name, REFERENCE.name), ()),
}
"""Fields needed for a run, for topics with many messages; other topics need all fields."""

_CONTROL_SAMPLE: Final = """\
# One callback of the controller. NaN: not recorded.

# Number of the sample, and of the pose that it read, from 0.
uint32 sequence
uint32 pose_sequence
# Phase in which the command was computed: its place, from 0, among the phases of the declaration
# in the metadata record turtlelog, then pause and done where these are not among them.
uint8 phase
# Goal bearing, and bearing minus heading [rad].
float64 bearing
float64 heading_error
# Goal minus position in the world frame [m].
float64 error_x
float64 error_y
float64 distance
# Command before clipping [m/s, rad/s].
float64 wanted_speed
float64 wanted_turn_rate
# Command as published [m/s, rad/s].
float64 speed
float64 turn_rate
# Gain times error before projection, world frame [m/s].
float64 world_v_x
float64 world_v_y
"""


_STATES: Final = """\
# Numbers of the law's own, one message per sample: that of the same sequence number, which both
# messages carry, on /turtle1/control.
"""

_DIGESTS: Final = """\
geometry_msgs/msg/Pose2D d68efa5b46e70f7b16ca23085474fdac5a44b638783ec42f661da64da4724ccc
geometry_msgs/msg/PoseStamped 10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8
geometry_msgs/msg/Twist 9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a
nav_msgs/msg/Odometry 3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0
nav_msgs/msg/Path 1957a5bb3cee5da65c4e52e52b65a93df227efce4c20f8458b36e73066ca334b
rcl_interfaces/msg/Log e28ce254ca8abc06abf92773b74602cdbf116ed34fbaf294fb9f81da9f318eac
std_msgs/msg/String df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18
tf2_msgs/msg/TFMessage e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087
turtlelog_msgs/msg/ControlSample 53260607615135d6bf11cc8adaf06aa06e43587b77f3f4c4e3b507e39c602cb9
turtlesim/msg/Pose 739beba26bcba6920404ba722b7b8321348512f92ea5be235c47251940dd8aa9
"""

TYPE_HASHES: Final[Mapping[str, str]] = {
    name: f"RIHS01_{digest}" for name, digest in map(str.split, _DIGESTS.splitlines())
}
"""Hash by message type, for every key of `SCHEMAS`. Text and hash must change together.

RIHS01 is the SHA-256 of a type's description (REP 2011), which ROS 2 compares."""

_FLOAT64: Final = {"type_id": 11, "capacity": 0, "string_capacity": 0, "nested_type_name": ""}
"""Description of a float64 field's type (REP 2011)."""

_PACKAGE: Final = "turtlelog_msgs/msg"
_LONGEST_TYPE: Final = 60
"""Longest name of a type [letters]. A class may have a name of any length."""


def define_states(names: Iterable[str]) -> str:
    """Return the `ros2msg` text of the type for a law's states."""
    return _STATES + "".join(f"# The law's state {name}.\nfloat64 {name}\n" for name in names)


_KNOWN: Final = (
    *("geometry_msgs/msg/PoseStamped", "turtlesim/msg/Pose", "geometry_msgs/msg/Pose2D"),
    *("geometry_msgs/msg/Twist", "std_msgs/msg/String", "rcl_interfaces/msg/Log"),
    *("nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Path"),
)

SCHEMAS: Final[Mapping[str, str]] = {
    kind: text for kind in _KNOWN if (text := find_definition(kind))
} | {"turtlelog_msgs/msg/ControlSample": _CONTROL_SAMPLE}
"""Definition by message type. Dependencies follow a line of 80 equals signs."""


def find_type_hash(kind: str, definition: str) -> str | None:
    """Return the hash of a type of turtlelog; None for types defined by others."""
    if definition == SCHEMAS.get(kind):
        return TYPE_HASHES[kind]
    # Only the definition contains the names of a law's states.
    states = re.findall(r"^float64 (\w+)$", definition, flags=re.MULTILINE)
    if definition != define_states(states):
        return None
    from hashlib import sha256

    fields = [{"name": name, "type": dict(_FLOAT64)} for name in states]
    description = {
        "type_description": {"type_name": kind, "fields": fields},
        "referenced_type_descriptions": [],
    }
    return f"RIHS01_{sha256(json.dumps(description).encode()).hexdigest()}"


def list_topics(
    declaration: Declaration | None, kind: object = DEFAULT_LAW, more: Collection[str] = ()
) -> tuple[Topic, ...]:
    """Return the topics of a recording. Messages with equal times have this order.

    In format 1 there is no declaration. The type of the law's states is named after its `kind`;
    `more` are names of optional topics.
    """
    sensed = OF_SENSING if SENSED.name in more else ()
    sensed += (MEASURED,) if MEASURED.name in more else ()
    shaped = (SHAPED,) if SHAPED.name in more else ()
    if declaration is None:
        return (*_POSES, *sensed, CONTROL, *shaped, *_AFTER_SAMPLES)
    states = (Topic(LAW_STATE, name_state_type(kind)),) if declaration.states else ()
    references = (REFERENCE, REFERENCE64) if declaration.has_reference else ()
    return (*_POSES, *sensed, CONTROL, *states, *references, *shaped, *_AFTER_SAMPLES)


def define_types(declaration: Declaration, kind: object = DEFAULT_LAW) -> Mapping[str, str]:
    """Return the `ros2msg` text of every type that a recording may contain."""
    if not declaration.states:
        return SCHEMAS
    return {**SCHEMAS, name_state_type(kind): define_states(declaration.states)}


def name_state_type(kind: object) -> str:
    """Return the type name of a law's states: `file.py:TurnAndDrive` gives `TurnAndDriveState`."""
    words = re.findall(r"[A-Za-z0-9]+", str(kind).rpartition(":")[2])
    name = "".join(word[0].upper() + word[1:] for word in words)[:_LONGEST_TYPE]
    return f"{_PACKAGE}/{name if name[:1].isalpha() else f'Law{name}'}State"


def describe_topics(
    topics: Sequence[tuple[str, str]], definitions: Mapping[str, str]
) -> list[tuple[Schema, Channel]]:
    """Return schema and channel of topics, given by name and type. Ids begin at 1."""
    schemas: dict[str, Schema] = {}
    pairs = []
    for number, (topic, kind) in enumerate(topics, start=1):
        if kind not in definitions:
            raise LogError(f"topic {topic}: no definition of {kind}")
        if kind not in schemas:
            data = definitions[kind].encode()
            schemas[kind] = Schema(id=len(schemas) + 1, name=kind, encoding="ros2msg", data=data)
        # A hash is valid for one text only; that of a type defined by others is unknown.
        type_hash = find_type_hash(kind, definitions[kind])
        channel = Channel(
            id=number,
            topic=topic,
            message_encoding="cdr",
            schema_id=schemas[kind].id,
            # Without the QoS entry some versions of rosbag2 refuse the channel.
            metadata={"offered_qos_profiles": ""}
            | ({} if type_hash is None else {"topic_type_hash": type_hash}),
        )
        pairs.append((schemas[kind], channel))
    return pairs


_MOST_PLANS: Final = 64
"""Number of cached topic layouts: those of every recording, and of the states of some laws."""

_OWN: Final = Selection(topics=TOPIC_NAMES, is_lenient=True, is_flat=True, is_counted=True)
_USED: Final = replace(
    _OWN,
    kept={name: frozenset((LOG_TIME, SEQUENCE, *fields)) for name, fields in USED_FIELDS.items()},
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Contents:
    """Contents of a recording.

    Attributes:
        head: Metadata of the recording.
        attachments: Attached bytes by name.
        topics: Columns of every expected topic by name, empty without messages. In a complete file,
            fields that no run needs are omitted, and log times replace publish times.
        damages: Segments that could not be read; empty if the file is complete.
        recovered: Note on earlier losses, if the file was recovered.
        lost: What the file has lost.
    """

    head: Head
    attachments: Mapping[str, bytes]
    topics: dict[str, TopicColumns]
    damages: tuple[Loss, ...] = ()
    recovered: Mapping[str, str] = field(default_factory=dict)
    lost: Lost = "nothing"


class ForeignFileError(LogError):
    """A third-party file."""


class PartialRecordingWarning(UserWarning):
    """Warning that only a part of a recording could be read, as allowed by the caller."""


def read_contents(stream: BinaryIO, *, may_be_foreign: bool = False) -> Contents:
    """Return the contents of a recording, after checking all available checksums.

    Damage of a third-party file is not suspected if it `may_be_foreign`.

    Raises:
        LogError: If the file is not MCAP, or a topic of turtlelog has another type.
        ForeignFileError: If the file is a third-party file.
        DamageError: If the file is unfinished or damaged.
    """
    source = Source(stream)
    try:
        contents = _read_source(source)
    except DamageError:
        raise
    except LogError as err:
        if may_be_foreign and isinstance(err, ForeignFileError):
            raise
        source.check_data()  # a wrong byte is the actual reason
        raise
    if source.is_indexed:  # last, because its error names no place
        source.check_data()
    return contents


def _read_source(source: Source) -> Contents:
    found: list[Any] = list(source.read_lone((Opcode.METADATA, Opcode.ATTACHMENT)))
    head: Head | None = None
    if source.is_indexed:
        # First: messages of other programs or a newer turtlelog may have other types.
        head = _find_head(found)
    parts = collect_parts(source, _USED, lambda piece: found.extend(_keep_notes(piece.rest)))
    for rows in (rows for of_topic in parts.values() for rows in of_topic):
        rows[PUBLISH_TIME] = rows[LOG_TIME]
    return build_contents(found, source.catalogue, parts, (), head)


def _keep_notes(records: Iterable[Any]) -> list[Any]:
    return [found for found in records if isinstance(found, Metadata | Attachment)]


def salvage_contents(stream: BinaryIO) -> Contents:
    """Return the readable contents of a damaged or unfinished recording."""
    catalogue, damages = Catalogue(Allowance(measure_stored(stream))), list[Loss]()
    parts: dict[str, list[Rows]] = {}
    found: list[Any] = []
    summary = salvage_summary(stream)
    if summary is not None:
        catalogue.add((*summary.schemas, *summary.channels), 0)
    for block in walk_through(stream, partial(build_walked_block, catalogue), damages=damages):
        found += _keep_notes(block.rest)
        known = {number: block.offsets[number] for number in block.offsets if number in catalogue}
        try:
            piece = read_piece(catalogue, _OWN, block, known)
        except LogError as err:
            end = block.byte + len(block.data)
            damages.append(Loss(start=block.byte, end=end, reason=str(err)))
            continue
        for number in block.offsets.keys() - known.keys():
            reason = f"channel {number}: expected its record, found messages only"
            damages.append(Loss(start=block.byte, end=block.byte, reason=reason))
        for topic, rows in piece.rows.items():
            parts.setdefault(topic, []).append(rows)
    return build_contents(found, catalogue, parts, damages)


def build_contents(
    records: Collection[Any],
    catalogue: Catalogue,
    parts: Mapping[str, list[Rows]],
    damages: Collection[Loss],
    head: Head | None = None,
) -> Contents:
    """Return the contents from records outside chunks and the rows of topics in parts."""
    head, tables = head or _find_head(records), dict[str, TopicColumns]()
    states = () if head.declaration is None else head.declaration.states
    # For an unfinished recording, its topics show its effects.
    for topic in list_topics(head.declaration, more={*head.more_topics, *parts}):
        own = states if topic.name == LAW_STATE else ()
        if topic.name in catalogue.topics:
            _check_type(_plan(topic, own), catalogue.find_plan(topic.name))
        rows = parts.get(topic.name) or [dict(_make_empty_rows(topic, own))]
        tables |= build_columns({topic.name: rows}, {topic.name: topic.schema})
    recovered, lost = describe_recovery(records)
    return Contents(
        head=head,
        attachments={found.name: found.data for found in records if isinstance(found, Attachment)},
        topics=tables,
        damages=tuple(damages),
        recovered=recovered,
        lost=lost,
    )


def _find_head(records: Collection[Any]) -> Head:
    """Return the last metadata record: a live recording adds one with its stop reason."""
    heads = [found for found in records if isinstance(found, Metadata) and found.name == HEAD]
    if not heads:
        raise ForeignFileError(f"not a recording of turtlelog: it has no metadata record {HEAD}")
    return parse_head(heads[-1].metadata)


def _check_type(expected: TopicPlan, found: TopicPlan) -> None:
    is_state = expected.topic == LAW_STATE
    # The type of the states may have any name; only the declared fields matter.
    if found.type != expected.type and not is_state:
        kind = found.type or "no type"
        raise LogError(f"topic {expected.topic}: expected {expected.type}, found {kind}")
    if found.reason:
        raise LogError(found.describe_reason())
    if found.fields != expected.fields:
        wanted = f"{expected.type} as ROS 2 defines it"
        wanted = "the declared states, each a float64" if is_state else wanted
        raise LogError(f"topic {expected.topic}: expected {wanted}, found other fields")


@lru_cache(maxsize=_MOST_PLANS)
def _plan(topic: Topic, states: tuple[str, ...]) -> TopicPlan:
    definition = define_states(states) if states else SCHEMAS[topic.schema]
    kind = read_type(topic.schema, definition)
    return TopicPlan(topic=topic.name, type=topic.schema, fields=kind.fields, layout=kind.layout)


@lru_cache(maxsize=_MOST_PLANS)
def _make_empty_rows(topic: Topic, states: tuple[str, ...]) -> Rows:
    return make_empty_rows(_plan(topic, states))
