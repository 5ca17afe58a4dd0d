"""What is in a file, without reading its messages."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mcap.records import Attachment, Metadata

from turtlelog.log.engine.survey import Survey, survey_file
from turtlelog.log.error_boundary import name_file, open_file
from turtlelog.log.recording.head import HEAD, parse_head, parse_scenario_file
from turtlelog.log.recording.losses import describe_damages, describe_recovery
from turtlelog.log.recording.topics import CONTROL, EVENT, GOAL
from turtlelog.run import Parameter
from turtlelog.scenario import flatten_tables


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
    schemas, merged = survey.catalogue.schemas, Counter[tuple[str, str]]()
    for number, channel in survey.catalogue.channels.items():
        schema = schemas.get(channel.schema_id)
        merged[channel.topic, schema.name if schema else ""] += survey.counts.get(number, 0)
    return tuple(
        TopicInfo(topic=topic, type=kind, count=count)
        for (topic, kind), count in sorted(merged.items())
    )
