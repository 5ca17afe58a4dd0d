"""What is in a file: from its summary where that tells, else its messages are counted."""

import os
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment, Metadata
from numpy.typing import NDArray

from turtlelog.display import count
from turtlelog.escapes import escape_controls
from turtlelog.log.engine.blocks import Block, parse_others, take_walked, walk_through
from turtlelog.log.engine.channels import Catalogue
from turtlelog.log.engine.integrity import DamageError, UnfinishedError
from turtlelog.log.engine.limits import Allowance
from turtlelog.log.engine.parsing import HEADING, MESSAGE_HEAD, gather_bytes
from turtlelog.log.engine.source import Source
from turtlelog.log.engine.walk import Loss, Section
from turtlelog.log.error_boundary import name_file, open_file
from turtlelog.log.recording.head import HEAD, parse_head, parse_scenario_file
from turtlelog.log.recording.losses import describe_damages, describe_recovery
from turtlelog.log.recording.topics import CONTROL, EVENT, GOAL
from turtlelog.run import Parameter
from turtlelog.scenario import flatten_tables

_LONE: Final = (Opcode.METADATA, Opcode.ATTACHMENT)


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicInfo:
    """One topic of a file: its name, the type of its messages, how many there are."""

    topic: str
    type: str
    count: int


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingInfo:
    """What is in a file.

    Attributes:
        file: Its path, as given.
        format_version: Of the recording, None where turtlelog did not write it.
        source: As in `Run`; `mcap` where turtlelog did not write it.
        name: As in `Run`; otherwise the file's name.
        complete: Whether the file was finished; of one that was not, what a walk finds is listed.
        stop_reason: As in `Run`.
        duration_s: First to last message [s], None where there is no message.
        scenario: The tables of the whole scenario, None where it is not known.
        parameters: What is known of the scenario, by dotted key.
        topics: By name.
        absent: As in `Run`; of somebody else's file what no topic in it holds.
        notes: As in `Run`; of a recovered file `recovered`, of a damaged one `partial`.
        not_understood: Topics whose messages cannot become columns, each with the reason.
    """

    file: str
    format_version: int | None
    source: str
    name: str
    complete: bool
    stop_reason: str | None = None
    duration_s: float | None
    scenario: Mapping[str, Any] | None = None
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    topics: tuple[TopicInfo, ...]
    absent: tuple[str, ...] = ()
    notes: Mapping[str, str] = field(default_factory=dict)
    not_understood: tuple[str, ...] = ()

    def __repr__(self) -> str:
        length = "no messages" if self.duration_s is None else f"{self.duration_s:.1f} s"
        whole = "complete" if self.complete else "incomplete"
        return escape_controls(
            f"<RecordingInfo {self.file}: {count(len(self.topics), 'topic')}, {length}, {whole}>"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Survey:
    """What a file holds.

    Attributes:
        catalogue: Its channels and schemas.
        counts: Messages by channel.
        span_ns: Least and greatest log time, None where there is no message.
        records: Its metadata and attachments, among others.
        is_finished: Whether its writer came to its end, and it is not damaged.
        damages: What could not be read, where the file was walked in spite of that.
    """

    catalogue: Catalogue
    counts: Mapping[int, int]
    span_ns: tuple[int, int] | None
    records: tuple[Any, ...]
    is_finished: bool
    damages: tuple[Loss, ...] = ()


def read_info(path: str | Path, *, allow_partial: bool = False) -> RecordingInfo:
    """Return what is in an MCAP file, whoever wrote it, from its summary where it has one.

    Args:
        path: The file.
        allow_partial: Say what a damaged file still holds; one that was never finished is
            described in any case. The note `partial` says what is lost.

    Raises:
        LogError: Where it cannot be read, is no MCAP file, or is damaged.
    """
    with name_file(path, expected="an MCAP file"):
        with open_file(path) as stream:
            survey = survey_file(stream, allow_partial=allow_partial)
        span_ns = survey.span_ns
        plans = survey.catalogue.iterate_plans()
        info = RecordingInfo(
            file=str(path),
            format_version=None,
            source="mcap",
            name=Path(path).stem,
            complete=survey.is_finished,
            duration_s=None if span_ns is None else (span_ns[1] - span_ns[0]) / 1e9,
            topics=_list_topics(survey),
            not_understood=tuple(f"{plan.topic}: {plan.reason}" for plan in plans if plan.reason),
            notes=_describe_losses(survey),
        )
        return _add_head(info, survey)


def _add_head(info: RecordingInfo, survey: Survey) -> RecordingInfo:
    """Return the info with what a recording of ours says of itself."""
    metadata = {found.name: found for found in survey.records if isinstance(found, Metadata)}
    if HEAD not in metadata:
        return replace(info, absent=list_absent(info.topics))
    head = parse_head(metadata[HEAD].metadata)
    attachments = {
        found.name: found.data for found in survey.records if isinstance(found, Attachment)
    }
    tables, is_complete = parse_scenario_file(attachments)
    return replace(
        info,
        format_version=head.format_version,
        source=head.source,
        name=head.name,
        stop_reason=head.stop_reason,
        scenario=tables if is_complete else None,
        parameters=flatten_tables(tables),
        absent=head.absent,
        notes={**head.notes, **info.notes},
    )


def list_absent(topics: Iterable[TopicInfo]) -> tuple[str, ...]:
    """Return what somebody else's file does not hold, by the names of `Run`.

    Its scenario and why it ended stand in turtlelog's own record alone.
    """
    held = {found.topic for found in topics if found.count}
    places = {
        "samples": CONTROL,
        "goal_xy_m": GOAL,
        "goal_heading_rad": GOAL,
        "parameters": None,
        "stop_reason": None,
        "events": EVENT,
    }
    return tuple(name for name, topic in places.items() if topic is None or topic.name not in held)


def _describe_losses(survey: Survey) -> dict[str, str]:
    notes = describe_recovery(survey.records)
    if not survey.is_finished:
        notes["partial"] = describe_damages(survey.damages)
    return notes


def _list_topics(survey: Survey) -> tuple[TopicInfo, ...]:
    """Return the topics by name; channels of one topic and type are one."""
    schemas, found = survey.catalogue.schemas, list[TopicInfo]()
    for number, channel in survey.catalogue.channels.items():
        schema, count = schemas.get(channel.schema_id), survey.counts.get(number, 0)
        kind = schema.name if schema else ""
        found.append(TopicInfo(topic=channel.topic, type=kind, count=count))
    return sort_topics(merge_topics(found))


def merge_topics(topics: Iterable[TopicInfo]) -> list[TopicInfo]:
    """Return topics of one name and type as one, in the order in which they first stand."""
    counts = Counter[tuple[str, str]]()
    for found in topics:
        counts[found.topic, found.type] += found.count
    return [
        TopicInfo(topic=topic, type=kind, count=count) for (topic, kind), count in counts.items()
    ]


def sort_topics(topics: Iterable[TopicInfo]) -> tuple[TopicInfo, ...]:
    """Return topics by name, and those of one name by type."""
    return tuple(sorted(topics, key=lambda found: (found.topic, found.type)))


def survey_file(stream: BinaryIO, *, allow_partial: bool = False) -> Survey:
    """Return what an MCAP file holds; one that was never finished is walked as far as it goes.

    Args:
        stream: The file.
        allow_partial: Walk a damaged one too.

    Raises:
        LogError: Where it is no MCAP.
        DamageError: Where it is finished but damaged, as far as it is read.
    """
    try:
        return _survey_source(stream)
    except UnfinishedError:
        return _survey_damaged(stream)
    except DamageError:
        if not allow_partial:
            raise
        return _survey_damaged(stream)


def _survey_damaged(stream: BinaryIO) -> Survey:
    allowance, damages = Allowance(stream.seek(0, os.SEEK_END)), list[Loss]()
    tally = _Tally(Catalogue(allowance), allowance)
    for _ in walk_through(stream, tally.take_section, damages=damages):
        pass
    return tally.sum_up((), damages, is_finished=False)


def _survey_source(stream: BinaryIO) -> Survey:
    source = Source(stream)
    lone = tuple(source.read_lone(_LONE))
    statistics, tally = source.statistics, _Tally(source.catalogue, source.allowance)
    if not source.is_indexed:
        for _ in walk_through(stream, tally.take_section):
            pass
        return tally.sum_up((), (), is_finished=True)
    if statistics is None or (statistics.message_count and not statistics.channel_message_counts):
        for found in source.map_blocks(_count_block):
            tally.add(*found)
        return tally.sum_up(lone, (), is_finished=True)
    span_ns = statistics.message_start_time, statistics.message_end_time
    return Survey(
        catalogue=source.catalogue,
        counts=statistics.channel_message_counts,
        span_ns=span_ns if statistics.message_count else None,
        records=lone,
        is_finished=True,
    )


class _Tally:
    """Counts messages, and keeps what is said of them."""

    def __init__(self, catalogue: Catalogue, allowance: Allowance) -> None:
        self._catalogue, self._allowance = catalogue, allowance
        self._counts = np.zeros(2**16, np.int64)
        self._times: list[int] = []
        self._records: list[Any] = []

    def take_section(self, section: Section) -> None:
        """Take a stretch of records, all of it or nothing.

        Raises:
            DamageError: Where it makes no sense.
        """
        byte, is_chunk = section.start, section.is_chunk
        stretch = take_walked(section.data, byte, self._allowance, is_chunk=is_chunk)
        others = parse_others(stretch, byte)
        self._catalogue.add(others, byte)
        self._records += [found for found in others if isinstance(found, Metadata | Attachment)]
        for _, heads in stretch.iterate_rows():
            self.add(np.bincount(heads["channel"]), heads["log_time"])

    def add(self, counts: NDArray[np.int64], times: NDArray[np.uint64]) -> None:
        """Take messages by channel, and some times among which are the least and the greatest."""
        self._counts[: len(counts)] += counts
        if len(times):
            known = [*self._times, int(times.min()), int(times.max())]
            self._times = [min(known), max(known)]

    def sum_up(
        self, lone: tuple[Any, ...], damages: Collection[Loss], *, is_finished: bool
    ) -> Survey:
        """Return what has come, and records that stand elsewhere."""
        present = np.flatnonzero(self._counts)
        return Survey(
            catalogue=self._catalogue,
            counts=dict(zip(present.tolist(), self._counts[present].tolist(), strict=True)),
            span_ns=(self._times[0], self._times[1]) if self._times else None,
            records=(*lone, *self._records),
            is_finished=is_finished,
            damages=tuple(damages),
        )


def _count_block(block: Block) -> tuple[NDArray[np.int64], NDArray[np.uint64]]:
    counts, times = np.zeros(2**16, np.int64), [np.empty(0, np.uint64)]
    for channel, starts in block.offsets.items():
        heads = gather_bytes(block.data, starts, MESSAGE_HEAD).view(HEADING)
        counts[channel] = len(starts)
        times.append(heads["log_time"])
    return counts, np.concatenate(times)
