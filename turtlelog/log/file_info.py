"""Contents of a file: from its summary if possible, otherwise by counting its messages."""

import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment, Metadata
from mcap.well_known import SchemaEncoding
from numpy.typing import NDArray

from turtlelog.display import describe_count, fit_line
from turtlelog.errors import LogError, ScenarioError
from turtlelog.files.text_files import format_toml, parse_known_toml
from turtlelog.files.urls import make_path
from turtlelog.log.engine.blocks import parse_others, read_heads, take_walked, walk_through
from turtlelog.log.engine.channels import Catalogue, describe_unread
from turtlelog.log.engine.limits import Allowance, measure_stored
from turtlelog.log.engine.opening import open_storage, strip_suffixes
from turtlelog.log.engine.source import Source
from turtlelog.log.engine.sqlite_source import SqliteSource
from turtlelog.log.engine.walk import Section
from turtlelog.log.file_access import DamageError, Loss, UnfinishedError
from turtlelog.log.recording.head import (
    HEAD,
    LONGEST_TEXT,
    PARAMETER_FILE,
    SCENARIO_FILE,
    add_lost,
    describe_damages,
    describe_recovery,
    parse_head,
)
from turtlelog.log.recording.topics import COMMAND, CONTROL, EVENT, GOAL, POSE
from turtlelog.run import Lost, Parameter, Run
from turtlelog.scenario import flatten_tables, nest_parameters

_LONE: Final = (Opcode.METADATA, Opcode.ATTACHMENT)

METADATA_FILE: Final = "metadata.yaml"
METADATA_ROOT: Final = "rosbag2_bagfile_information"

_PLAIN: Final = re.compile(r"[\w/.][\w/.-]*", re.ASCII)
"""Text in names of topics and types that YAML can only read as text."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicInfo:
    """One topic of a file.

    Attributes:
        topic: Name of the topic.
        type: Message type, as named in the schema.
        count: Number of messages.
        reason: Why the messages cannot become columns; empty if they can.
    """

    topic: str
    type: str
    count: int
    reason: str = ""

    def describe_reason(self) -> str:
        """Return the topic with its reason, for errors and notes."""
        return describe_unread(self.topic, self.reason)


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingInfo:
    """Contents of a file.

    Attributes:
        file: Path of the file, as given.
        format_version: Format version of the recording; None for third-party files.
        source: Source, as in `Run`; for third-party files `mcap`, `sqlite3` or, for ROS 1 messages,
            `ros1`.
        name: Name, as in `Run`, or else the file's name.
        complete: Whether the file was finished. For an unfinished file, the readable contents are
            listed.
        stop_reason: Stop reason, as in `Run`.
        duration_s: Time from first to last message of any topic, or row of a table [s]; None
            without messages. The duration of the run is `Run.duration_s`, the metric
            `run.duration`.
        span_ns: Earliest and latest log time [ns]; None without messages.
        scenario: The tables of the complete scenario; None if unknown.
        parameters: Known values of the scenario, by dotted key.
        topics: Topics by name.
        simulated_by: Software, as in `Run`.
        absent: Missing fields, as in `Run`; for third-party files, the fields that no topic
            contains.
        notes: Notes, as in `Run`; also `recovered` for a recovered file and `partial` for a damaged
            one.
        not_understood: Topics whose messages cannot become columns, with the reason.
        lost: What the file had lost when it was recovered.
        was_clock_set: Whether the recorder's clock was set during the run of a recording.
    """

    file: str
    format_version: int | None
    source: str
    name: str
    complete: bool
    stop_reason: str | None = None
    duration_s: float | None
    span_ns: tuple[int, int] | None = None
    scenario: Mapping[str, Any] | None = None
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    topics: tuple[TopicInfo, ...]
    simulated_by: Mapping[str, str] = field(default_factory=dict)
    absent: tuple[str, ...] = ()
    notes: Mapping[str, str] = field(default_factory=dict)
    not_understood: tuple[str, ...] = ()
    lost: Lost = "nothing"
    was_clock_set: bool = False

    def __repr__(self) -> str:
        length = "no messages" if self.duration_s is None else f"{self.duration_s:.1f} s"
        topics = describe_count(len(self.topics), "topic")
        whole = "complete" if self.complete else "incomplete"
        return fit_line(f"<RecordingInfo {self.file}: {topics}, {length}, {whole}>")


@dataclass(slots=True, kw_only=True, eq=False)
class Survey:
    """Contents of a file.

    Attributes:
        catalogue: Channels and schemas of the file.
        is_finished: Whether the file was finished and is not damaged.
        records: Metadata, attachments and similar records.
        counts: Number of messages by channel.
        span_ns: Earliest and latest log time [ns]; None without messages.
        damages: Segments that could not be read, if a damaged file was read.
    """

    catalogue: Catalogue
    is_finished: bool
    records: list[Any] = field(default_factory=list)
    counts: Counter[int] = field(default_factory=Counter)
    span_ns: tuple[int, int] | None = None
    damages: list[Loss] = field(default_factory=list)

    @property
    def is_own(self) -> bool:
        """Whether the records show that turtlelog wrote the file."""
        return any(isinstance(found, Metadata) and found.name == HEAD for found in self.records)

    @property
    def is_ros1(self) -> bool:
        """Whether the messages are in the ROS 1 format."""
        kinds = self.catalogue.schemas.values()
        return any(schema.encoding == SchemaEncoding.ROS1 for schema in kinds)

    def count(self, channels: NDArray[np.uint16], times: NDArray[np.uint64]) -> None:
        """Count messages by their channels and log times."""
        if len(channels):
            counts = np.bincount(channels)
            present = np.flatnonzero(counts)
            self.counts.update(dict(zip(present.tolist(), counts[present].tolist(), strict=True)))
            known = [*(self.span_ns or ()), int(times.min()), int(times.max())]
            self.span_ns = min(known), max(known)


def read_info(path: str | Path, *, allow_partial: bool = False) -> RecordingInfo:
    """Return the contents of any MCAP or SQLite file, from its summary if it has one.

    Args:
        path: The file.
        allow_partial: Whether to describe the readable part of a damaged file, with the losses in
            the note `partial`. Unfinished files are described in any case.

    Raises:
        LogError: If the file cannot be read, is neither MCAP nor SQLite, or is damaged.
    """
    with open_storage(path) as opened:
        if isinstance(opened, SqliteSource):
            survey = Survey(catalogue=opened.catalogue, is_finished=True)
            survey.counts, survey.span_ns = opened.count_messages()
        else:
            survey = survey_file(opened, allow_partial=allow_partial)
        span_ns, reasons = survey.span_ns, survey.catalogue.list_reasons()
        notes, lost = describe_recovery(survey.records)
        if not survey.is_finished:
            notes["partial"] = describe_damages(survey.damages)
        storage = "sqlite3" if isinstance(opened, SqliteSource) else "mcap"
        info = RecordingInfo(
            file=str(path),
            format_version=None,
            source="ros1" if storage == "mcap" and survey.is_ros1 else storage,
            name=strip_suffixes(make_path(path)),
            complete=survey.is_finished,
            duration_s=None if span_ns is None else (span_ns[1] - span_ns[0]) / 1e9,
            span_ns=span_ns,
            topics=_list_topics(survey, reasons),
            not_understood=tuple(f"{topic}: {reason}" for topic, reason in reasons.items()),
            notes=notes,
            lost=lost,
        )
        return _add_head(info, survey)


def _add_head(info: RecordingInfo, survey: Survey) -> RecordingInfo:
    metadata = {found.name: found for found in survey.records if isinstance(found, Metadata)}
    if HEAD not in metadata:
        return replace(info, absent=list_absent(info.topics))
    head = parse_head(metadata[HEAD].metadata)
    attachments = {
        found.name: found.data for found in survey.records if isinstance(found, Attachment)
    }
    tables, is_complete = parse_scenario_file(attachments)
    is_whole = survey.is_finished and info.lost == "nothing"
    counts = {topic.topic: topic.count for topic in info.topics}
    places = {"poses": POSE, "commands": COMMAND, "samples": CONTROL, "goal_xy_m": GOAL}
    held = {name for name, topic in places.items() if counts.get(topic.name)}
    held |= {"parameters"} if tables else set()
    return replace(
        info,
        format_version=head.format_version,
        source=head.source,
        name=head.name,
        stop_reason=head.stop_reason,
        scenario=tables if is_complete else None,
        parameters=flatten_tables(tables),
        simulated_by=head.simulated_by,
        absent=head.absent if is_whole else add_lost(head, held),
        notes={**head.notes, **info.notes},
        was_clock_set=head.origin.was_clock_set,
    )


def format_scenario_file(run: "Run") -> dict[str, bytes]:
    """Return the attached TOML text by its name; nothing if no parameter is known."""
    if not run.parameters and not run.scenario_is_complete:
        return {}
    try:
        tables = nest_parameters(run.parameters)
    except ScenarioError as err:
        raise LogError(f"parameters: {err}") from err
    name = SCENARIO_FILE if run.scenario_is_complete else PARAMETER_FILE
    return {name: format_toml(tables).encode()}


def parse_scenario_file(attachments: Mapping[str, bytes]) -> tuple[dict[str, Any], bool]:
    """Return the attached tables, and whether they are a complete scenario. No law is loaded."""
    name = SCENARIO_FILE if SCENARIO_FILE in attachments else PARAMETER_FILE
    text = attachments.get(name, b"")
    if len(text) > LONGEST_TEXT:
        raise LogError(f"attachment {name}: expected up to {LONGEST_TEXT} bytes, found {len(text)}")
    try:
        tables = parse_known_toml(text.decode())
    except ValueError as err:
        raise LogError(f"attachment {name}: not TOML: {err}") from err
    return tables, name in attachments and name == SCENARIO_FILE


def list_absent(topics: Iterable[TopicInfo]) -> tuple[str, ...]:
    """Return the fields of `Run` that third-party files do not have, as far as topics show it."""
    present = [found for found in topics if found.count]
    held = {found.topic for found in present}
    places = {"samples": CONTROL, "goal_xy_m": GOAL, "goal_heading_rad": GOAL}
    absent = [name for name, topic in places.items() if topic.name not in held]
    absent += ["parameters", "stop_reason", *([] if EVENT.name in held else ["events"])]
    is_readable = any(not found.reason for found in present)
    return tuple(absent if is_readable else ["poses", "commands", *absent])


def _list_topics(survey: Survey, reasons: Mapping[str, str]) -> tuple[TopicInfo, ...]:
    """Return the topics by name; channels with the same topic and type are merged."""
    schemas, counts = survey.catalogue.schemas, Counter[tuple[str, str]]()
    for number, channel in survey.catalogue.channels.items():
        schema = schemas.get(channel.schema_id)
        counts[channel.topic, schema.name if schema else ""] += survey.counts.get(number, 0)
    return tuple(
        TopicInfo(topic=topic, type=kind, count=count, reason=reasons.get(topic, ""))
        for (topic, kind), count in sorted(counts.items())
    )


def merge_topics(topics: Iterable[TopicInfo]) -> list[TopicInfo]:
    """Merge topics with the same name and type, in the order of their first occurrence."""
    merged: dict[tuple[str, str], TopicInfo] = {}
    for found in topics:
        first = merged.setdefault((found.topic, found.type), replace(found, count=0))
        count, reason = first.count + found.count, first.reason or found.reason
        merged[found.topic, found.type] = replace(first, count=count, reason=reason)
    return [*merged.values()]


def survey_file(stream: BinaryIO, *, allow_partial: bool = False) -> Survey:
    """Return the contents of an MCAP file. An unfinished file is read as far as possible."""
    try:
        return _survey_source(stream)
    except DamageError as err:
        if not allow_partial and not isinstance(err, UnfinishedError):
            raise
    allowance = Allowance(measure_stored(stream))
    survey = Survey(catalogue=Catalogue(allowance), is_finished=False)
    _walk(stream, survey, allowance, survey.damages)
    return survey


def _survey_source(stream: BinaryIO) -> Survey:
    source = Source(stream)
    lone, statistics = [*source.read_lone(_LONE)], source.statistics
    survey = Survey(catalogue=source.catalogue, is_finished=True, records=lone)
    if not source.is_indexed:
        _walk(stream, survey, source.allowance, None)
    elif statistics is None or (statistics.message_count and not statistics.channel_message_counts):
        for found in source.map_blocks(read_heads):
            survey.count(*found)
    else:
        survey.counts.update(statistics.channel_message_counts)
        if statistics.message_count:
            survey.span_ns = statistics.message_start_time, statistics.message_end_time
    return survey


def _walk(
    stream: BinaryIO, survey: Survey, allowance: Allowance, damages: list[Loss] | None
) -> None:
    """Add the contents of all readable segments; segments with invalid records are skipped."""

    def take(section: Section) -> None:
        stretch = take_walked(section, allowance)
        others = parse_others(stretch, section.start)
        survey.catalogue.add(others, section.start)
        survey.records += [found for found in others if isinstance(found, Metadata | Attachment)]
        for _, heads in stretch.iterate_rows():
            survey.count(heads["channel"], heads["log_time"])

    for _ in walk_through(stream, take, damages=damages):
        pass


def describe_bag(files: Sequence[Path], compression: str = "") -> str:
    """Return the metadata.yaml of a bag of complete MCAP files, in order of time."""
    surveys = []
    for file in files:
        with file.open("rb") as stream:
            surveys.append((file.name, survey_file(stream)))
    return format_bag_metadata(surveys, compression)


def format_bag_metadata(files: Sequence[tuple[str, Survey]], compression: str = "") -> str:
    """Return the metadata.yaml of a bag of MCAP files.

    Version 8 is the newest with quality of service as text, which Humble and Jazzy both read. An
    empty text, as in the file's channels, lets the player choose. Readers of earlier format
    versions skip the keys that later versions added.
    """
    counts, hashes = Counter[tuple[str, str]](), dict[tuple[str, str], str]()
    spans_ns, parts = list[tuple[int, int]](), list[str]()
    for file, survey in files:
        schemas = survey.catalogue.schemas
        for number, channel in sorted(survey.catalogue.channels.items()):
            schema = schemas.get(channel.schema_id)
            topic = channel.topic, schema.name if schema else ""
            counts[topic] += survey.counts.get(number, 0)
            hashes.setdefault(topic, channel.metadata.get("topic_type_hash", ""))
        spans_ns.append(survey.span_ns or (0, 0))
        span = _format_span(spans_ns[-1:], survey.counts.total())
        parts += [f"  - path: {_quote(file)}", *(f"    {line}" for line in span)]
    lines = ["version: 8", "storage_identifier: mcap", *_format_span(spans_ns, counts.total())]
    lines.append("topics_with_message_count:")
    for (name, kind), count in counts.items():
        type_hash = hashes[name, kind] or '""'
        lines += [
            "  - topic_metadata:",
            f"      name: {_format_text(name)}",
            f"      type: {_format_text(kind)}",
            "      serialization_format: cdr",
            '      offered_qos_profiles: ""',
            f"      type_description_hash: {type_hash}",
            f"    message_count: {count}",
        ]
    codec, mode = ("zstd", compression.upper()) if compression else ('""', '""')
    lines += [f"compression_format: {codec}", f"compression_mode: {mode}"]
    lines += ["relative_file_paths:", *(f"  - {_quote(file)}" for file, _ in files)]
    lines += ["files:", *parts, "custom_data: ~", 'ros_distro: ""']
    return "\n".join([f"{METADATA_ROOT}:", *(f"  {line}" for line in lines), ""])


def _format_span(spans_ns: Sequence[tuple[int, int]], count: int) -> list[str]:
    start_ns = min(start for start, _ in spans_ns)
    return [
        "starting_time:",
        f"  nanoseconds_since_epoch: {start_ns}",
        "duration:",
        f"  nanoseconds: {max(end for _, end in spans_ns) - start_ns}",
        f"message_count: {count}",
    ]


def _format_text(value: str) -> str:
    return value if _PLAIN.fullmatch(value) else json.dumps(value, ensure_ascii=False)


def _quote(value: str) -> str:
    return "'" + value.replace("'", "''") + "'"
