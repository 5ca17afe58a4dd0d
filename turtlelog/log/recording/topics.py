"""Topics of a recording: types with text and hash, packed messages, and rows that fit together."""

import json
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import chain
from operator import attrgetter
from struct import Struct
from types import MappingProxyType
from typing import Final

import numpy as np
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.cdr import CODES
from turtlelog.log.engine.channels import TopicPlan, find_definition
from turtlelog.log.engine.decode import (
    Rows,
    make_empty_rows,
)
from turtlelog.log.engine.message_types import read_type
from turtlelog.log.engine.records import FRONT
from turtlelog.log.engine.topic_columns import TopicColumns
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


def check_type(expected: TopicPlan, found: TopicPlan) -> None:
    """Refuse a topic of a recording with another type or other fields."""
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
def plan_topic(topic: Topic, states: tuple[str, ...]) -> TopicPlan:
    """Return how the messages of a topic are read; `states` are those of the law, for its topic."""
    definition = define_states(states) if states else SCHEMAS[topic.schema]
    kind = read_type(topic.schema, definition)
    return TopicPlan(topic=topic.name, type=topic.schema, fields=kind.fields, layout=kind.layout)


@lru_cache(maxsize=_MOST_PLANS)
def make_empty_topic(topic: Topic, states: tuple[str, ...]) -> Rows:
    """Return the columns of a topic without messages."""
    return make_empty_rows(plan_topic(topic, states))


def reconcile_tables(
    topics: Mapping[str, TopicColumns], declaration: Declaration | None
) -> tuple[dict[str, TopicColumns], str]:
    """Return topics with consistent rows, and a clause on the changes; empty without changes.

    Poses are numbered from 0, and each sample contains the number of its pose. Rows that lack a
    part are dropped, and the remaining poses are numbered anew. If no sample read a pose, it is
    unknown whether the pose dropped out or its sensed values are lost.
    """
    tables = dict(topics)
    exact = POSE64.name, VELOCITY64.name, MEASURED.name
    pose_topics = [name for name in exact if name in tables and len(tables[name])]
    pose_topics.insert(0, POSE.name)
    numbers = _intersect({name: tables[name] for name in pose_topics})
    for name in pose_topics:
        tables[name] = tables[name].select(np.isin(tables[name].sequence, numbers))
    clauses, read = _reconcile_sensed(tables, numbers)
    samples = tables[CONTROL.name]
    kept = samples.select(np.isin(samples.fields["pose_sequence"], read))
    if declaration is not None:
        kept = _take_described(kept, tables, declaration)
    rows = np.searchsorted(numbers, kept.fields["pose_sequence"]).astype(np.uint32)
    fields = MappingProxyType({**kept.fields, "pose_sequence": rows})
    tables[CONTROL.name] = replace(kept, fields=fields)
    lost = len(samples) - len(kept)
    if lost:
        more = [name for topic, name in _MORE_OF_SAMPLES.items() if topic in tables]
        whats = ", ".join(["pose", *more, "states or reference"])
        clauses.insert(0, f"{lost} samples without their {whats} are dropped")
    return tables, "".join(f"; {clause}" for clause in clauses)


_MORE_OF_SAMPLES: Final = {SENSED.name: "sensed pose", SHAPED.name: "shaped command"}
"""Other messages of each sample, in runs with these """


def _reconcile_sensed(
    tables: dict[str, TopicColumns], numbers: NDArray[np.uint32]
) -> tuple[list[str], NDArray[np.uint32]]:
    """Drop the sensed values of lost poses, and number the rest like the remaining poses.

    Returns:
        Clauses on the losses, and the numbers of poses that a sample may have read.
    """
    if SENSED.name not in tables:
        return [], numbers
    names = [name for name in (SENSED.name, SENSED64.name) if len(tables[name])]
    sensed = _intersect({name: tables[name] for name in names}) if names else numbers[:0]
    both = np.intersect1d(sensed, numbers)
    for name in names:
        found = tables[name].select(np.isin(tables[name].sequence, both))
        places = np.searchsorted(numbers, found.sequence).astype(np.uint32)
        tables[name] = replace(found, sequence=places)
    clauses = []
    if lost := len(sensed) - len(both):
        clauses.append(f"{lost} sensed poses without their pose are dropped")
    if unknown := len(numbers) - len(both):
        clauses.append(f"of {unknown} poses none was sensed, or what was sensed is lost")
    return clauses, both


def _take_described(
    samples: TopicColumns, tables: dict[str, TopicColumns], declaration: Declaration
) -> TopicColumns:
    """Return the complete samples, and drop all rows of the other samples."""
    for name in (LAW_STATE, SHAPED.name):
        if name in tables:
            is_there = np.isin(samples.fields["sequence"], tables[name].sequence)
            samples = samples.select(is_there)
    if declaration.has_reference:
        # In these phases every sample has a reference pose.
        moved = {loop.name for loop in declaration.loops if loop.moves}
        phases = enumerate(declaration.phases.values())
        numbers = [number for number, loops in phases if not moved.isdisjoint(loops)]
        due = np.isin(samples.fields["phase"], numbers)
        is_there = np.isin(samples.fields["sequence"], tables[REFERENCE64.name].sequence)
        samples = samples.select(is_there | ~due)
    references = REFERENCE.name, REFERENCE64.name
    for name in (LAW_STATE, *references, SHAPED.name):
        if name in tables:
            is_kept = np.isin(tables[name].sequence, samples.fields["sequence"])
            tables[name] = tables[name].select(is_kept)
    return samples


def _intersect(tables: Mapping[str, TopicColumns]) -> NDArray[np.uint32]:
    numbers = next(iter(tables.values())).sequence
    for name, columns in tables.items():
        if (columns.sequence[1:] <= columns.sequence[:-1]).any():
            raise LogError(f"topic {name}: expected poses numbered in order, found others")
        numbers = np.intersect1d(numbers, columns.sequence)
    return numbers


_CONTROL_FIELDS: Final = [field for fields in CONTROL_COLUMNS.values() for field in fields]
GOAL_PLACES: Final = {
    name: [_CONTROL_FIELDS.index(field) for field in CONTROL_COLUMNS[name]]
    for name in ("bearing_rad", "heading_error_rad", "error_xy_m", "distance_m")
}
"""Indices of the values in a sample's row that are missing without a goal."""


REFERENCE_BYTES: Final = 160
"""Approximate size of the two messages of a reference pose [bytes]."""

LIST_SAMPLE: Final = attrgetter(
    *("sequence", "pose_sequence", "phase", "bearing_rad", "heading_error_rad"),
    *("error_x_m", "error_y_m", "distance_m", "wanted_speed_m_s", "wanted_turn_rate_rad_s"),
    *("speed_m_s", "turn_rate_rad_s", "world_v_x_m_s", "world_v_y_m_s"),
)
"""Getter of a sample's recorded values, in the order of ControlSample's fields."""

WORLD_PLACES: Final = slice(
    _CONTROL_FIELDS.index("world_v_x"), _CONTROL_FIELDS.index("world_v_y") + 1
)


def build_packer(topic: Topic, definitions: Mapping[str, str] = SCHEMAS) -> Struct:
    """Return a packer of complete records of a fixed-size type. CDR's padding becomes zeros."""
    layout = read_type(topic.schema, definitions[topic.schema]).layout
    if layout is None or layout.little.fields is None:
        raise TypeError(f"{topic.schema}: expected messages of one size")
    end, codes = FRONT.size, []
    for name, kind in layout.kinds.items():
        column, start = layout.little.fields[name][:2]
        codes.append(f"{start - end}x{CODES[kind]}")
        end = start + column.itemsize
    return Struct(FRONT.format + "".join(codes))
