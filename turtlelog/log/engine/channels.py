"""The topics of a file from its channels, the decoding of their messages, and known definitions."""

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding

from turtlelog.display import join_words
from turtlelog.errors import LogError
from turtlelog.log.engine.limits import FIELDS, Allowance
from turtlelog.log.engine.message_types import (
    LONGEST_TEXT,
    NUMBER_SIZE,
    ROW_HEAD,
    TEXT_SIZE,
    Field,
    Layout,
    read_type,
    shorten_type,
)
from turtlelog.log.engine.object_messages import JsonField, read_json_schema, read_protobuf_type
from turtlelog.log.file_access import DamageError, LimitError

_SCHEMAS: Final[Mapping[str, tuple[str, ...]]] = {
    # A message type without a schema encoding has no text; its name must suffice.
    MessageEncoding.CDR: (SchemaEncoding.ROS2, "ros2idl", "omgidl", ""),
    MessageEncoding.JSON: (SchemaEncoding.JSONSchema,),
    MessageEncoding.ROS1: (SchemaEncoding.ROS1,),
    MessageEncoding.Protobuf: (SchemaEncoding.Protobuf,),
}
"""Encodings of schemas by the encoding of their messages; each belongs to one."""

_NUMBERS: Final = frozenset({"boolean", "integer", "number"})

Decode = Callable[[bytes], dict[str, Any]]
"""A function from the bytes of a message to an object."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicPlan:
    """The decoding of a topic's messages.

    Attributes:
        topic: Name of the topic.
        type: Message type; empty if there is no schema.
        reason: Why the messages cannot be decoded; empty if they can be decoded.
        fields: Fields of the type.
        layout: Layout of the type; None if its messages differ in size.
        sequence: Dotted name of a sequence of texts or messages in the type; None without one.
        json: Fields of each message in JSON or protobuf; None for CDR.
        decode: Function that decodes a protobuf message into an object; None for JSON.
        is_ros1: Whether messages are in the ROS 1 format and are converted to CDR first.
        row_size: Memory per message [bytes]; long texts and sequences need more.
    """

    topic: str
    type: str
    reason: str = ""
    fields: tuple[Field, ...] = ()
    layout: Layout | None = None
    sequence: str | None = None
    json: tuple[JsonField, ...] | None = None
    decode: Decode | None = None
    is_ros1: bool = False
    row_size: int = 0

    def describe_reason(self) -> str:
        """Return the topic with the reason why its messages cannot be decoded, for errors."""
        return describe_unread(self.topic, self.reason)

    @property
    def meaning(self) -> object:
        """Properties that all channels of one topic must share."""
        return self.type, self.fields, self.json, self.is_ros1, self.reason


def measure_object(fields: Iterable[JsonField]) -> int:
    """Return the memory per message of these fields [bytes]; long texts and sequences need more."""
    sizes = (NUMBER_SIZE if field.kind in _NUMBERS else TEXT_SIZE for field in fields)
    return ROW_HEAD + sum(sizes)


def describe_unread(topic: str, reason: str) -> str:
    """Return the sentence about a topic whose messages cannot be decoded."""
    return f"topic {topic}: not understood: {reason}"


class Catalogue:
    """The schemas and channels of a file, in the order of discovery.

    Attributes:
        allowance: Remaining limits for reading the file.
    """

    def __init__(self, allowance: Allowance) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.allowance = allowance
        self._plans: dict[str, TopicPlan] = {}
        self._of_topics: dict[str, list[Channel]] = {}
        self._readings: dict[tuple[int, str], dict[str, Any]] = {}

    @property
    def topics(self) -> Collection[str]:
        """Names of the topics, unordered."""
        return self._of_topics.keys()

    @property
    def types(self) -> dict[str, str]:
        """Message type by topic, from the first channel of the topic."""
        first = {topic: channels[0].schema_id for topic, channels in self._of_topics.items()}
        names = {number: schema.name for number, schema in self.schemas.items()}
        return {topic: names.get(number, "") for topic, number in first.items()}

    def __contains__(self, channel: int) -> bool:
        return channel in self.channels

    def add(self, records: Collection[Any], byte: int) -> None:
        """Add schemas and channels; other records are ignored.

        Raises:
            DamageError: If a record at `byte` differs from another record with the same id.
        """
        for record in map(_name_type, records):
            if not isinstance(record, Schema | Channel):
                continue
            if self._find_known(record) is not None:
                self.check((record,), byte)
                continue
            try:
                self.allowance.spend_description(record)
            except LogError as err:
                raise LimitError(f"byte {byte}: {err}") from err
            if isinstance(record, Schema):
                self.schemas[record.id] = record
            else:
                self.channels[record.id] = record
                self._of_topics.setdefault(record.topic, []).append(record)
                self._plans.pop(record.topic, None)

    def check(self, records: Collection[Any], byte: int) -> None:
        """Compare schemas and channels with the known ones, without changing anything."""
        for record in map(_name_type, records):
            known = self._find_known(record)
            if known is not None and known is not record and known != record:
                kind = type(record).__name__.lower()
                raise DamageError(f"byte {byte}: expected one {kind} {record.id}, found two")

    def _find_known(self, record: Any) -> Schema | Channel | None:
        known = self.schemas if isinstance(record, Schema) else self.channels
        return known.get(record.id) if isinstance(record, Schema | Channel) else None

    def list_reasons(self) -> dict[str, str]:
        """Return the reasons why topics cannot be decoded, by topic in order of names."""
        reasons = {}
        for topic, channels in sorted(self._of_topics.items()):
            if len(channels) == 1:  # a reading takes less time than a plan
                reason = self._find_reading(channels[0]).get("reason")
            else:
                reason = self.find_plan(topic).reason
            if reason:
                reasons[topic] = reason
        return reasons

    def find_plan(self, topic: str) -> TopicPlan:
        """Return the plan of a topic, which must be the topic of a channel."""
        if topic not in self._plans:
            self._plans[topic] = self._merge_plans(topic)
        return self._plans[topic]

    def group_channels(self, numbers: Collection[int], byte: int) -> Mapping[str, list[int]]:
        """Return channels by topic."""
        topics: dict[str, list[int]] = {}
        for number in numbers:
            if number not in self.channels:
                raise DamageError(
                    f"byte {byte}: channel {number}: expected its record, found messages only"
                )
            topics.setdefault(self.channels[number].topic, []).append(number)
        return topics

    def _merge_plans(self, topic: str) -> TopicPlan:
        first, *others = [
            TopicPlan(topic=topic, **self._find_reading(channel))
            for channel in self._of_topics[topic]
        ]
        for plan in others:
            if plan.meaning != first.meaning:
                kinds = " and ".join(sorted({plan.type or "none" for plan in (first, *others)}))
                reason = f"channels of one type expected, found different ones: {kinds}"
                return TopicPlan(topic=topic, type=first.type, reason=reason)
        return first

    def _find_reading(self, channel: Channel) -> Mapping[str, Any]:
        """Return the fields of a topic's plan except its topic, from schema and encoding."""
        key = channel.schema_id, channel.message_encoding
        reading = self._readings.get(key)
        if reading is None:
            reading = self._choose_reading(*key)
            if channel.schema_id in self.schemas:  # a missing schema may still follow
                self._readings[key] = reading
        return reading

    def _choose_reading(self, number: int, encoding: str) -> dict[str, Any]:
        schema = self.schemas.get(number)
        found: dict[str, Any] = {"type": "" if schema is None else schema.name}
        if encoding not in _SCHEMAS:
            named = f"are in the encoding {encoding}" if encoding else "name no encoding"
            reason = (
                f"its messages {named}, and turtlelog reads {join_words([*_SCHEMAS])}; record the"
                " topic in one of these"
            )
        elif schema is None:
            reason = "it has no schema"
        elif schema.encoding not in _SCHEMAS[encoding]:
            expected = " or ".join(filter(None, _SCHEMAS[encoding][:2]))
            reason = f"a schema in {expected} expected, found {schema.encoding!r}"
        else:
            try:
                return found | _read_schema(schema, self.allowance)
            except (LogError, UnicodeDecodeError) as err:
                reason = str(err)
        return {**found, "reason": reason}


def _name_type(record: Any) -> Any:
    """Return a schema record; a ROS 1 schema gets the ROS 2 name of its type."""
    if not isinstance(record, Schema) or record.encoding != SchemaEncoding.ROS1:
        return record
    from turtlelog.log.ros1 import name_as_ros2  # only files of ROS 1 need it

    name = name_as_ros2(record.name)
    return Schema(id=record.id, name=name, encoding=record.encoding, data=record.data)


def _read_schema(schema: Schema, allowance: Allowance) -> dict[str, Any]:
    """Return the fields of a plan that follow from a schema alone."""
    allowance.spend(FIELDS, int(not allowance.count_left(FIELDS)))
    if schema.encoding in {SchemaEncoding.JSONSchema, SchemaEncoding.Protobuf}:
        _require_short(schema)
        if schema.encoding == SchemaEncoding.JSONSchema:
            objects, decode = read_json_schema(schema.name, schema.data), None
        else:
            kind = read_protobuf_type(schema.name, schema.data)
            objects, decode = tuple(kind.list_fields()), kind.decode
        allowance.spend(FIELDS, len(objects))
        return {"json": objects, "decode": decode, "row_size": measure_object(objects)}
    is_ros1 = schema.encoding == SchemaEncoding.ROS1
    if is_ros1:
        from turtlelog.log.ros1 import read_ros1_type  # only ROS 1 files need it

        found = read_ros1_type(schema.name, _read_text(schema, None))
    else:
        known = find_definition(schema.name)
        try:
            found = read_type(schema.name, _read_text(schema, known))
        except (LogError, UnicodeDecodeError):
            if known is None:
                raise
            found = read_type(schema.name, known)
    allowance.spend(FIELDS, found.size)
    return {
        "fields": found.fields,
        "layout": found.layout,
        "sequence": found.sequence,
        "is_ros1": is_ros1,
        "row_size": found.row_size,
    }


def _require_short(schema: Schema) -> None:
    if (size := len(schema.data)) > LONGEST_TEXT:
        raise LogError(f"schema {schema.name}: expected up to {LONGEST_TEXT} bytes, found {size}")


def _read_text(schema: Schema, known: str | None) -> str:
    """Return a definition in `ros2msg`: that of the schema, or else a known definition."""
    _require_short(schema)
    # In ros2msg the text of a type without fields is empty.
    plain = (SchemaEncoding.ROS2, SchemaEncoding.ROS1)
    if not schema.data and (known is not None or schema.encoding not in plain):
        if known is None:
            raise LogError(f"its type {schema.name} is not known and the file holds no definition")
        return known
    text = schema.data.decode()
    if schema.encoding in plain:
        return text
    from turtlelog.log.engine.idl import convert_idl

    return convert_idl(schema.name, text)


# Definitions of common ROS 2 types, for files that name a type without defining it.
_FIELDS: Final = """\
builtin_interfaces/Time: int32 sec, uint32 nanosec
builtin_interfaces/Duration: int32 sec, uint32 nanosec
std_msgs/Header: builtin_interfaces/Time stamp, string frame_id
std_msgs/Empty:
std_msgs/String: string data
std_msgs/Bool: bool data
std_msgs/Byte: byte data
std_msgs/Char: char data
std_msgs/Float32: float32 data
std_msgs/Float64: float64 data
std_msgs/Int8: int8 data
std_msgs/Int16: int16 data
std_msgs/Int32: int32 data
std_msgs/Int64: int64 data
std_msgs/UInt8: uint8 data
std_msgs/UInt16: uint16 data
std_msgs/UInt32: uint32 data
std_msgs/UInt64: uint64 data
geometry_msgs/Vector3: float64 x, float64 y, float64 z
geometry_msgs/Point: float64 x, float64 y, float64 z
geometry_msgs/Quaternion: float64 x 0, float64 y 0, float64 z 0, float64 w 1
geometry_msgs/Pose: geometry_msgs/Point position, geometry_msgs/Quaternion orientation
geometry_msgs/Pose2D: float64 x, float64 y, float64 theta
geometry_msgs/PoseStamped: std_msgs/Header header, geometry_msgs/Pose pose
geometry_msgs/PoseArray: std_msgs/Header header, geometry_msgs/Pose[] poses
geometry_msgs/PoseWithCovariance: geometry_msgs/Pose pose, float64[36] covariance
geometry_msgs/PoseWithCovarianceStamped: \
std_msgs/Header header, geometry_msgs/PoseWithCovariance pose
geometry_msgs/Transform: \
geometry_msgs/Vector3 translation, geometry_msgs/Quaternion rotation
geometry_msgs/TransformStamped: \
std_msgs/Header header, string child_frame_id, geometry_msgs/Transform transform
geometry_msgs/Twist: geometry_msgs/Vector3 linear, geometry_msgs/Vector3 angular
geometry_msgs/TwistStamped: std_msgs/Header header, geometry_msgs/Twist twist
geometry_msgs/TwistWithCovariance: geometry_msgs/Twist twist, float64[36] covariance
geometry_msgs/TwistWithCovarianceStamped: \
std_msgs/Header header, geometry_msgs/TwistWithCovariance twist
nav_msgs/Odometry: \
std_msgs/Header header, string child_frame_id, \
geometry_msgs/PoseWithCovariance pose, geometry_msgs/TwistWithCovariance twist
nav_msgs/Path: std_msgs/Header header, geometry_msgs/PoseStamped[] poses
tf2_msgs/TFMessage: geometry_msgs/TransformStamped[] transforms
sensor_msgs/Imu: \
std_msgs/Header header, \
geometry_msgs/Quaternion orientation, float64[9] orientation_covariance, \
geometry_msgs/Vector3 angular_velocity, float64[9] angular_velocity_covariance, \
geometry_msgs/Vector3 linear_acceleration, float64[9] linear_acceleration_covariance
sensor_msgs/JointState: \
std_msgs/Header header, string[] name, float64[] position, float64[] velocity, float64[] effort
sensor_msgs/LaserScan: \
std_msgs/Header header, float32 angle_min, float32 angle_max, float32 angle_increment, \
float32 time_increment, float32 scan_time, float32 range_min, float32 range_max, \
float32[] ranges, float32[] intensities
sensor_msgs/BatteryState: \
std_msgs/Header header, float32 voltage, float32 temperature, float32 current, float32 charge, \
float32 capacity, float32 design_capacity, float32 percentage, uint8 power_supply_status, \
uint8 power_supply_health, uint8 power_supply_technology, bool present, \
float32[] cell_voltage, float32[] cell_temperature, string location, string serial_number
sensor_msgs/NavSatStatus: int8 status, uint16 service
sensor_msgs/NavSatFix: \
std_msgs/Header header, sensor_msgs/NavSatStatus status, \
float64 latitude, float64 longitude, float64 altitude, \
float64[9] position_covariance, uint8 position_covariance_type
rcl_interfaces/Log: \
byte DEBUG=10, byte INFO=20, byte WARN=30, byte ERROR=40, byte FATAL=50, \
builtin_interfaces/Time stamp, uint8 level, string name, string msg, string file, \
string function, uint32 line
rosgraph_msgs/Clock: builtin_interfaces/Time clock
turtlesim/Pose: \
float32 x, float32 y, float32 theta, float32 linear_velocity, float32 angular_velocity
turtlesim_msgs/Pose: \
float32 x, float32 y, float32 theta, float32 linear_velocity, float32 angular_velocity
ackermann_msgs/AckermannDrive: \
float32 steering_angle, float32 steering_angle_velocity, float32 speed, float32 acceleration, \
float32 jerk
ackermann_msgs/AckermannDriveStamped: \
std_msgs/Header header, ackermann_msgs/AckermannDrive drive
"""

_TEXTS: Final[Mapping[str, str]] = {
    name: "".join(f"{field.strip()}\n" for field in fields.split(",") if field.strip())
    for name, _, fields in (line.partition(":") for line in _FIELDS.splitlines())
}
"""Fields of each type in `ros2msg`, by `package/Type`."""

KNOWN_TYPES: Final = tuple(name.replace("/", "/msg/") for name in _TEXTS)
"""ROS 2 names of the types with a known definition."""

_NESTED: Final = re.compile(r"^(\w+/\w+)", re.MULTILINE | re.ASCII)


@cache
def find_definition(type_name: str) -> str | None:
    """Return the `ros2msg` text of a common type and its nested types; None for other types."""
    name = shorten_type(type_name)
    if name not in _TEXTS:
        return None
    # Each type once, before the types that follow it in its fields.
    nested = dict.fromkeys(_iterate_nested(name))
    parts = [f"{'=' * 80}\nMSG: {other}\n{_TEXTS[other]}" for other in nested]
    return "".join([_TEXTS[name], *parts])


def _iterate_nested(name: str) -> Iterator[str]:
    for other in _NESTED.findall(_TEXTS[name]):
        yield other
        yield from _iterate_nested(other)
