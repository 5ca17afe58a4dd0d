"""Encoding of live ticks as the message records of a chunk: one packing call per message."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from math import isnan, nan
from operator import attrgetter
from struct import Struct
from typing import Any, Final

import numpy as np
from mcap.opcode import Opcode

from turtlelog.log.engine.cursor import CODES
from turtlelog.log.engine.message_types import read_type
from turtlelog.log.engine.records import RECORD
from turtlelog.log.mcap_writer import ChunkRows
from turtlelog.log.message_encoding import ENCAPSULATION, HEAD, encode_message
from turtlelog.log.recording import topics
from turtlelog.log.recording.run_writer import describe_pose, tabulate_event
from turtlelog.run import CUT_SHORT
from turtlelog.run.loops import DONE, PAUSE, Declaration
from turtlelog.scenario import Scenario
from turtlelog.simulate import SampleRow, Tick, TickRow

_MESSAGE: Final = int(Opcode.MESSAGE)
_REFERENCE_BYTES: Final = 160
"""Approximate size of the two messages of a reference pose [bytes]."""

_FIELDS: Final = [field for fields in topics.CONTROL_COLUMNS.values() for field in fields]
_PLACES: Final = {
    name: [_FIELDS.index(field) for field in topics.CONTROL_COLUMNS[name]]
    for name in ("bearing_rad", "heading_error_rad", "error_xy_m", "distance_m")
}
"""Indices of the values in a sample's row that are missing without a goal."""

_LIST: Final = attrgetter(
    *("sequence", "pose_sequence", "phase", "bearing_rad", "heading_error_rad"),
    *("error_x_m", "error_y_m", "distance_m", "wanted_speed_m_s", "wanted_turn_rate_rad_s"),
    *("speed_m_s", "turn_rate_rad_s", "world_v_x_m_s", "world_v_y_m_s"),
)
"""Getter of a sample's recorded values, in the order of ControlSample's fields."""

_WORLD: Final = slice(_FIELDS.index("world_v_x"), _FIELDS.index("world_v_y") + 1)


def _build_struct(topic: topics.Topic, definitions: Mapping[str, str] = topics.SCHEMAS) -> Struct:
    """Return a packer of complete records of a fixed-size type. CDR's padding becomes zeros."""
    layout = read_type(topic.schema, definitions[topic.schema]).layout
    if layout is None or layout.little.fields is None:
        raise TypeError(f"{topic.schema}: expected messages of one size")
    end, codes = HEAD.size, []
    for name, kind in layout.kinds.items():
        column, start = layout.little.fields[name][:2]
        codes.append(f"{start - end}x{CODES[kind]}")
        end = start + column.itemsize
    return Struct(HEAD.format + "".join(codes))


_FIXED: Final = (
    *(topics.POSE, topics.POSE64, topics.SENSED, topics.SENSED64),
    *(topics.CONTROL, topics.SHAPED, topics.COMMAND, topics.REFERENCE64),
)
_STRUCTS: Final = {topic: _build_struct(topic) for topic in _FIXED}
_POSE_SIZE, _POSE64_SIZE, _CONTROL_SIZE, _COMMAND_SIZE = (
    _STRUCTS[topic].size for topic in (topics.POSE, topics.POSE64, topics.CONTROL, topics.COMMAND)
)


def measure_tick(tick: Tick) -> int:
    """Return the approximate size of a tick's messages [bytes]."""
    sensed = 0 if isnan(tick.row.sensed_x_m) else _POSE_SIZE + _POSE64_SIZE
    return (
        _POSE_SIZE
        + sensed
        + sum(map(_measure_sample, tick.computed))
        + sum(HEAD.size + 8 * len(states) for states in tick.states)
        + _COMMAND_SIZE * len(tick.published)
        + HEAD.size * len(tick.events)
    )


def _measure_sample(sample: SampleRow) -> int:
    size = _CONTROL_SIZE + (0 if isnan(sample.shaped_speed_m_s) else _COMMAND_SIZE)
    return size + (0 if isnan(sample.reference_x_m) else _REFERENCE_BYTES)


@dataclass(slots=True, eq=False)
class _Messages:
    """The messages of one topic.

    Attributes:
        topic: Name and type of the topic.
        number: Number of its channel.
        pack: Function that packs a record, if the type has a fixed size.
        length: Length of such a record, as in its length field.
        count: Number of messages so far.
        entries: Log times and offsets of the messages in the present chunk, alternating.
    """

    topic: topics.Topic
    number: int
    pack: Callable[..., bytes]
    length: int
    count: int = 0
    entries: list[int] = field(default_factory=list)


class TickRecords:
    """Encoder of ticks as numbered messages, like `build_messages` for a complete run.

    If the law blocks and declares the end of its phase, the message of the pause comes with the
    sample that begins the pause. Otherwise the next sample shows the pause, and the message gets
    the earlier time. Poses are recorded in double precision if the scenario requests it.

    Attributes:
        more_topics: Optional topics of this recording.
    """

    def __init__(self, scenario: Scenario, declaration: Declaration) -> None:
        goal, kind = scenario.goal, scenario.law.kind
        self._goal = (goal.x_m, goal.y_m, goal.heading_rad) if declaration.uses_goal else None
        self._is_exact = scenario.loop.pose_precision == "float64"
        is_sensed = scenario.has_action("sense", "lose_pose")
        more = {topics.SENSED.name: is_sensed, topics.SHAPED.name: scenario.has_action("shape")}
        self.more_topics = frozenset(name for name, is_there in more.items() if is_there)
        listed = topics.list_topics(declaration, kind, self.more_topics)
        definitions = topics.define_types(declaration, kind)
        named = [(topic.name, topic.schema) for topic in listed]
        self._channels = topics.describe_topics(named, definitions)
        self._messages = {
            topic.name: _begin_topic(topic, number, definitions)
            for number, topic in enumerate(listed, start=1)
        }
        self._pose, self._pose64, self._control, self._command = (
            self._messages[topic.name]
            for topic in (topics.POSE, topics.POSE64, topics.CONTROL, topics.COMMAND)
        )
        self._sensed, self._sensed64 = (
            self._messages.get(topic.name) for topic in (topics.SENSED, topics.SENSED64)
        )
        self._shaped = self._messages.get(topics.SHAPED.name)
        self._states = self._messages.get(topics.LAW_STATE)
        self._reference64 = self._messages.get(topics.REFERENCE64.name)
        self._phases = declaration.phase_names
        self._phase: int | None = None
        self._lacking: set[str] = set()
        self._has_samples = self._has_world = False
        self._is_paused = self._is_blocked = False
        self._sample_ns = 0
        self._records = bytearray()

    @property
    def nan_columns(self) -> frozenset[str]:
        """Columns of the run so far that are None, and NaN in the messages."""
        worldless = {"world_velocity_m_s"} if self._has_samples and not self._has_world else set()
        return frozenset(f"samples.{name}" for name in self._lacking | worldless)

    def encode(self, ticks: Iterable[Tick]) -> ChunkRows:
        """Return the messages of the next ticks, at least one tick."""
        for tick in ticks:
            time_ns = tick.time_ns
            self._add_pose(time_ns, tick)
            for number, sample in enumerate(tick.computed):
                states = tick.states[number] if tick.states else ()
                self._add_sample(sample.time_ns, sample, states)
            for sample in tick.published:
                values = sample.speed_m_s, 0.0, 0.0, 0.0, 0.0, sample.turn_rate_rad_s
                self._add(self._command, sample.published_ns, sample.sequence, *values)
            for sample in tick.computed:
                self._follow_phase(sample.time_ns, sample)
            if tick.stop_reason is not None and self._phase is not None:
                later_ns = [sample.time_ns for sample in tick.computed]
                later_ns += [sample.published_ns for sample in tick.published]
                self._end_phase(max([time_ns, *later_ns]), tick.stop_reason)
            for event in tick.events:
                self._add_varied(topics.EVENT, event.time_ns, tabulate_event(event))
        return self._collect()

    def _add_pose(self, time_ns: int, tick: Tick) -> None:
        row, number = tick.row, self._pose.count
        self._pose.count = number + 1
        if not number and self._goal is not None:
            self._add_varied(topics.GOAL, time_ns, describe_pose(time_ns, *self._goal))
        values = row.x_m, row.y_m, row.heading_rad
        self._add(self._pose, time_ns, number, *values, row.speed_m_s, row.turn_rate_rad_s)
        if self._is_exact:
            self._add(self._pose64, time_ns, number, *values)
        if not isnan(row.sensed_x_m):
            self._add_sensed(time_ns, number, row)

    def _add_sensed(self, time_ns: int, number: int, row: TickRow) -> None:
        """Add a sensed pose with the pose's number and time, without velocity."""
        values = row.sensed_x_m, row.sensed_y_m, row.sensed_heading_rad
        if self._sensed is not None:
            self._add(self._sensed, time_ns, number, *values, nan, nan)
        if self._sensed64 is not None and self._is_exact:
            self._add(self._sensed64, time_ns, number, *values)

    def _add_sample(self, time_ns: int, sample: SampleRow, states: tuple[float, ...]) -> None:
        row, sequence = _LIST(sample), sample.sequence
        self._add(self._control, time_ns, sequence, *row)
        if self._states is not None:
            self._add(self._states, time_ns, sequence, *states)
        if not isnan(sample.reference_x_m) and self._reference64 is not None:
            values = sample.reference_x_m, sample.reference_y_m, sample.reference_heading_rad
            self._add_varied(topics.REFERENCE, time_ns, describe_pose(time_ns, *values), sequence)
            self._add(self._reference64, time_ns, sequence, *values)
        if self._shaped is not None:
            shaped = sample.shaped_speed_m_s, 0.0, 0.0, 0.0, 0.0, sample.shaped_turn_rate_rad_s
            self._add(self._shaped, time_ns, sequence, *shaped)
        self._has_samples = True
        if not self._has_world:
            self._has_world = not all(map(isnan, row[_WORLD]))
        if self._goal is None:
            self._lacking |= {
                name for name, places in _PLACES.items() if any(isnan(row[at]) for at in places)
            }

    def _follow_phase(self, time_ns: int, sample: SampleRow) -> None:
        if sample.phase != self._phase:
            if self._phase is not None:
                self._add_pause()
            self._phase, self._is_paused = sample.phase, False
            self._add_phase(time_ns, self._phases[sample.phase])
        self._sample_ns, self._is_blocked = time_ns, sample.blocks_ticks > 0
        if self._is_blocked and sample.ends_phase:
            self._add_pause()

    def _end_phase(self, time_ns: int, stop_reason: str) -> None:
        if self._is_blocked:
            self._add_pause()
        if stop_reason not in CUT_SHORT:
            self._add_phase(time_ns, DONE)

    def _add_pause(self) -> None:
        if not self._is_paused:
            self._add_phase(self._sample_ns, PAUSE)
        self._is_paused = True

    def _add_phase(self, time_ns: int, phase: str) -> None:
        self._add_varied(topics.PHASE, time_ns, {"data": phase})

    def _add(self, messages: _Messages, time_ns: int, sequence: int, *values: float) -> None:
        messages.entries += (time_ns, len(self._records))
        head = messages.length, messages.number, sequence, time_ns, time_ns, ENCAPSULATION
        self._records += messages.pack(_MESSAGE, *head, *values)

    def _add_varied(
        self,
        topic: topics.Topic,
        time_ns: int,
        values: Mapping[str, Any],
        number: int | None = None,
    ) -> None:
        """Add a message. Without a given number, messages are numbered from 0."""
        messages = self._messages[topic.name]
        kind = read_type(topic.schema, topics.SCHEMAS[topic.schema])
        stamp = messages.count if number is None else number, time_ns, time_ns
        record = encode_message(kind.fields, values, messages.number, stamp)
        messages.entries += (time_ns, len(self._records))
        self._records += record
        messages.count += 1

    def _collect(self) -> ChunkRows:
        index = {
            messages.number: np.array(messages.entries, dtype=np.uint64).reshape(-1, 2)
            for messages in self._messages.values()
            if messages.entries
        }
        for messages in self._messages.values():
            messages.entries = []
        records, self._records = self._records, bytearray()
        return ChunkRows(
            channels=[self._channels[number - 1] for number in index],
            records=records,
            index=index,
            start_ns=min(int(entries[:, 0].min()) for entries in index.values()),
            end_ns=max(int(entries[:, 0].max()) for entries in index.values()),
        )


def _begin_topic(topic: topics.Topic, number: int, definitions: Mapping[str, str]) -> _Messages:
    packer = _STRUCTS.get(topic, HEAD)
    if topic.name == topics.LAW_STATE:
        packer = _build_struct(topic, definitions)
    length = packer.size - RECORD.size
    return _Messages(topic=topic, number=number, pack=packer.pack, length=length)
