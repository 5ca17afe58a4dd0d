"""Contents of turtlelog recordings, complete or not, with notes on losses."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any, BinaryIO, Final

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment, Metadata
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.blocks import walk_blocks
from turtlelog.log.engine.channels import Catalogue, TopicPlan
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
from turtlelog.log.engine.walk import Loss
from turtlelog.log.file_access import DamageError
from turtlelog.log.recording import topics
from turtlelog.log.recording.head import HEAD, Head, describe_recovery, parse_head
from turtlelog.run.loops import Declaration

_MOST_PLANS: Final = 64
"""Number of cached topic layouts: those of every recording, and of the states of some laws."""

_OWN: Final = Selection(topics=topics.TOPIC_NAMES, is_lenient=True, is_flat=True, is_counted=True)
_USED: Final = replace(
    _OWN,
    kept={
        name: frozenset((LOG_TIME, SEQUENCE, *fields))
        for name, fields in topics.USED_FIELDS.items()
    },
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Contents:
    """Contents of a recording.

    Attributes:
        head: Metadata of the recording.
        attachments: Attached bytes by name.
        topics: Columns of every expected topic by name, empty without messages. Declaration and
            effects determine the topics. In a complete file, fields that no run needs are omitted,
            and log times replace publish times.
        damages: Segments that could not be read; empty if the file is complete.
        recovered: Note on earlier losses, if the file was recovered.
    """

    head: Head
    attachments: Mapping[str, bytes]
    topics: dict[str, TopicColumns]
    damages: tuple[Loss, ...] = ()
    recovered: Mapping[str, str] = field(default_factory=dict)


class ForeignFileError(LogError):
    """A third-party file."""


class PartialRecordingWarning(UserWarning):
    """Warning that only a part of a recording could be read, as allowed by the caller."""


def read_contents(stream: BinaryIO, *, may_be_foreign: bool = False) -> Contents:
    """Return the contents of a recording, after checking all available checksums.

    Args:
        stream: The file.
        may_be_foreign: Whether the file may be a third-party file, so that damage is not suspected.

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
    allowance, damages = Allowance(measure_stored(stream)), list[Loss]()
    catalogue = Catalogue(allowance)
    parts: dict[str, list[Rows]] = {}
    found: list[Any] = []
    summary = salvage_summary(stream)
    if summary is not None:
        catalogue.add((*summary.schemas, *summary.channels), 0)
    for block in walk_blocks(stream, catalogue, allowance, damages=damages):
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
    for topic in topics.list_topics(head.declaration, more={*head.more_topics, *parts}):
        own = states if topic.name == topics.LAW_STATE else ()
        if topic.name in catalogue.topics:
            _check_type(_plan(topic, own), catalogue.find_plan(topic.name))
        rows = parts.get(topic.name) or [dict(_make_empty_rows(topic, own))]
        tables |= build_columns({topic.name: rows}, {topic.name: topic.schema})
    return Contents(
        head=head,
        attachments={found.name: found.data for found in records if isinstance(found, Attachment)},
        topics=tables,
        damages=tuple(damages),
        recovered=describe_recovery(records),
    )


def _find_head(records: Collection[Any]) -> Head:
    """Return the last metadata record: a live recording adds one with its stop reason."""
    heads = [found for found in records if isinstance(found, Metadata) and found.name == HEAD]
    if not heads:
        raise ForeignFileError(f"not a recording of turtlelog: it has no metadata record {HEAD}")
    return parse_head(heads[-1].metadata)


def _check_type(expected: TopicPlan, found: TopicPlan) -> None:
    is_state = expected.topic == topics.LAW_STATE
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
def _plan(topic: topics.Topic, states: tuple[str, ...]) -> TopicPlan:
    definition = topics.define_states(states) if states else topics.SCHEMAS[topic.schema]
    kind = read_type(topic.schema, definition)
    return TopicPlan(topic=topic.name, type=topic.schema, fields=kind.fields, layout=kind.layout)


@lru_cache(maxsize=_MOST_PLANS)
def _make_empty_rows(topic: topics.Topic, states: tuple[str, ...]) -> Rows:
    return make_empty_rows(_plan(topic, states))


def reconcile_contents(contents: Contents) -> tuple[Contents, str]:
    """Return contents with consistent rows, and a clause on the changes; empty without changes.

    Poses are numbered from 0, and each sample contains the number of its pose. Poses with a missing
    column are dropped. Samples are dropped if their pose, states, reference, sensed pose or shaped
    command is missing. The remaining poses are numbered anew. If no sample read a pose, it is
    unknown whether the pose dropped out or its sensed values are lost.
    """
    tables, declaration = dict(contents.topics), contents.head.declaration
    exact = topics.POSE64.name, topics.VELOCITY64.name, topics.MEASURED.name
    pose_topics = [name for name in exact if name in tables and len(tables[name])]
    pose_topics.insert(0, topics.POSE.name)
    numbers = _intersect({name: tables[name] for name in pose_topics})
    for name in pose_topics:
        tables[name] = tables[name].select(np.isin(tables[name].sequence, numbers))
    clauses, read = _reconcile_sensed(tables, numbers)
    samples = tables[topics.CONTROL.name]
    kept = samples.select(np.isin(samples.fields["pose_sequence"], read))
    if declaration is not None:
        kept = _take_described(kept, tables, declaration)
    rows = np.searchsorted(numbers, kept.fields["pose_sequence"]).astype(np.uint32)
    fields = MappingProxyType({**kept.fields, "pose_sequence": rows})
    tables[topics.CONTROL.name] = replace(kept, fields=fields)
    lost = len(samples) - len(kept)
    if lost:
        more = [name for topic, name in _MORE_OF_SAMPLES.items() if topic in tables]
        whats = ", ".join(["pose", *more, "states or reference"])
        clauses.insert(0, f"{lost} samples without their {whats} are dropped")
    return replace(contents, topics=tables), "".join(f"; {clause}" for clause in clauses)


_MORE_OF_SAMPLES: Final = {topics.SENSED.name: "sensed pose", topics.SHAPED.name: "shaped command"}
"""Other messages of each sample, in runs with these topics."""


def _reconcile_sensed(
    tables: dict[str, TopicColumns], numbers: NDArray[np.uint32]
) -> tuple[list[str], NDArray[np.uint32]]:
    """Drop the sensed values of lost poses, and number the rest like the remaining poses.

    Returns:
        Clauses on the losses, and the numbers of poses that a sample may have read.
    """
    if topics.SENSED.name not in tables:
        return [], numbers
    names = [name for name in (topics.SENSED.name, topics.SENSED64.name) if len(tables[name])]
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
    for name in (topics.LAW_STATE, topics.SHAPED.name):
        if name in tables:
            is_there = np.isin(samples.fields["sequence"], tables[name].sequence)
            samples = samples.select(is_there)
    if declaration.has_reference:
        # In these phases every sample has a reference pose.
        moved = {loop.name for loop in declaration.loops if loop.moves}
        phases = enumerate(declaration.phases.values())
        numbers = [number for number, loops in phases if not moved.isdisjoint(loops)]
        due = np.isin(samples.fields["phase"], numbers)
        is_there = np.isin(samples.fields["sequence"], tables[topics.REFERENCE64.name].sequence)
        samples = samples.select(is_there | ~due)
    references = topics.REFERENCE.name, topics.REFERENCE64.name
    for name in (topics.LAW_STATE, *references, topics.SHAPED.name):
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
