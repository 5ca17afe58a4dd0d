"""Ticks of a running loop -> the message records of a chunk: one packing call per message."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from struct import Struct
from typing import Any, Final

import numpy as np
from mcap.opcode import Opcode

from turtlelog.laws import Decision
from turtlelog.log.channels import describe_topics
from turtlelog.log.container import ChunkRows
from turtlelog.log.encode import CODES, encode_fields
from turtlelog.log.recording.messages import describe_event, describe_goal
from turtlelog.log.recording.schemas import SCHEMAS
from turtlelog.log.recording.topics import (
    COMMAND,
    CONTROL,
    EVENT,
    GOAL,
    PHASE,
    POSE,
    POSE64,
    TOPICS,
    Topic,
)
from turtlelog.log.records import ENCAPSULATION, HEAD, UNCOUNTED, read_type
from turtlelog.run import Phase
from turtlelog.scenario import Scenario
from turtlelog.simulate import Tick

_MESSAGE: Final = int(Opcode.MESSAGE)
_CUT_SHORT: Final = frozenset({"max_duration", "interrupted"})
_ROTATE: Final = Phase.ROTATE


def _build_struct(topic: Topic) -> Struct:
    """Return what packs a whole record of a type of fixed size; CDR's gaps become zeros."""
    _, layout = read_type(topic.schema, SCHEMAS[topic.schema])
    if layout is None or layout.little.fields is None:
        raise TypeError(f"{topic.schema}: expected messages of one size")
    end, codes = HEAD.size, []
    for name, kind in layout.kinds.items():
        column, start = layout.little.fields[name][:2]
        codes.append(f"{start - end}x{CODES[kind]}")
        end = start + column.itemsize
    return Struct(HEAD.format + "".join(codes))


_STRUCTS: Final = {topic: _build_struct(topic) for topic in (POSE, POSE64, CONTROL, COMMAND)}
_POSE_SIZE, _CONTROL_SIZE, _COMMAND_SIZE = (
    _STRUCTS[topic].size for topic in (POSE, CONTROL, COMMAND)
)


def measure_tick(tick: Tick) -> int:
    """Return about how many bytes the messages of a tick take."""
    return (
        _POSE_SIZE
        + _CONTROL_SIZE * len(tick.computed)
        + _COMMAND_SIZE * len(tick.published)
        + HEAD.size * len(tick.events)
    )


@dataclass(slots=True, eq=False)
class _Messages:
    """The messages of one topic.

    Attributes:
        topic: Its name and type.
        number: Of its channel.
        pack: Makes a record, where the type has a fixed size.
        length: Of such a record, as it says itself.
        count: Messages so far.
        entries: Log time and place of those in the chunk at hand, in turn.
    """

    topic: Topic
    number: int
    pack: Callable[..., bytes]
    length: int
    count: int = 0
    entries: list[int] = field(default_factory=list)


class TickRecords:
    """Numbers and packs what ticks bring, as `build_messages` does for a whole run.

    The message of a pause comes with the sample that begins it, where the law blocks and says that
    its phase ends; otherwise the next sample tells, and the message carries the earlier time. Poses
    in double precision are recorded where the scenario asks for them.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._goal_values = (scenario.goal.x_m, scenario.goal.y_m), scenario.goal.heading_rad
        self._is_exact = scenario.loop.pose_precision == "float64"
        self._channels = describe_topics([(topic.name, topic.schema) for topic in TOPICS], SCHEMAS)
        self._messages = {topic: _begin_topic(topic) for topic in TOPICS}
        self._pose, self._pose64 = self._messages[POSE], self._messages[POSE64]
        self._control, self._command = self._messages[CONTROL], self._messages[COMMAND]
        self._phase: Phase | None = None
        self._is_paused = self._is_blocked = False
        self._sample_ns = 0
        self._records = bytearray()

    def encode(self, ticks: Iterable[Tick]) -> ChunkRows:
        """Return the messages of the next ticks, of which there is at least one."""
        for tick in ticks:
            time_ns = tick.time_ns
            self._add_pose(time_ns, tick)
            for sample in tick.computed:
                self._add(self._control, time_ns, sample.sequence, *sample.row)
            for sample in tick.published:
                values = sample.speed_m_s, 0.0, 0.0, 0.0, 0.0, sample.turn_rate_rad_s
                self._add(self._command, time_ns, sample.sequence, *values)
            for sample in tick.computed:
                self._follow_phase(time_ns, sample.decision)
            if tick.stop_reason is not None and self._phase is not None:
                self._end_phase(time_ns, tick.stop_reason)
            for event in tick.events:
                self._add_varied(EVENT, event.time_ns, describe_event(event))
        return self._collect()

    def _add_pose(self, time_ns: int, tick: Tick) -> None:
        pose, number = tick.pose, self._pose.count
        self._pose.count = number + 1
        if not number:
            self._add_varied(GOAL, time_ns, describe_goal(time_ns, *self._goal_values))
        values = pose.x_m, pose.y_m, pose.heading_rad
        self._add(self._pose, time_ns, number, *values, tick.speed_m_s, tick.turn_rate_rad_s)
        if self._is_exact:
            self._add(self._pose64, time_ns, number, *values)

    def _follow_phase(self, time_ns: int, decision: Decision) -> None:
        if decision.phase is not self._phase:
            if self._phase is _ROTATE:
                self._add_pause()
            self._phase, self._is_paused = decision.phase, False
            self._add_phase(time_ns, decision.phase)
        self._sample_ns, self._is_blocked = time_ns, decision.blocks_ticks > 0
        if self._is_blocked and decision.ends_phase and self._phase is _ROTATE:
            self._add_pause()

    def _end_phase(self, time_ns: int, stop_reason: str) -> None:
        if self._is_blocked and self._phase is _ROTATE:
            self._add_pause()
        if stop_reason not in _CUT_SHORT:
            self._add_phase(time_ns, Phase.DONE)

    def _add_pause(self) -> None:
        if not self._is_paused:
            self._add_phase(self._sample_ns, Phase.PAUSE)
        self._is_paused = True

    def _add_phase(self, time_ns: int, phase: Phase) -> None:
        self._add_varied(PHASE, time_ns, {"data": phase.label})

    def _add(self, messages: _Messages, time_ns: int, sequence: int, *values: float) -> None:
        messages.entries += (time_ns, len(self._records))
        head = messages.length, messages.number, sequence, time_ns, time_ns, ENCAPSULATION
        self._records += messages.pack(_MESSAGE, *head, *values)

    def _add_varied(self, topic: Topic, time_ns: int, values: Mapping[str, Any]) -> None:
        messages = self._messages[topic]
        fields, _ = read_type(topic.schema, SCHEMAS[topic.schema])
        body = encode_fields(fields, values)
        messages.entries += (time_ns, len(self._records))
        length, sequence = HEAD.size - UNCOUNTED + len(body), messages.count
        head = length, messages.number, sequence, time_ns, time_ns, ENCAPSULATION
        self._records += HEAD.pack(_MESSAGE, *head) + body
        messages.count = sequence + 1

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


def _begin_topic(topic: Topic) -> _Messages:
    packer = _STRUCTS.get(topic, HEAD)
    number, length = TOPICS.index(topic) + 1, packer.size - UNCOUNTED
    return _Messages(topic=topic, number=number, pack=packer.pack, length=length)
