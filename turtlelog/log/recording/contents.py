"""File -> what a recording of ours consists of: its head, attachments, columns of its topics."""

import os
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, BinaryIO, Final

from mcap.opcode import Opcode
from mcap.records import Attachment, Metadata

from turtlelog.errors import LogError
from turtlelog.log.engine.blocks import walk_blocks
from turtlelog.log.engine.channels import Catalogue, TopicPlan
from turtlelog.log.engine.columns import TopicColumns, build_columns
from turtlelog.log.engine.decode import Rows, make_empty_rows
from turtlelog.log.engine.integrity import DamageError
from turtlelog.log.engine.limits import Allowance
from turtlelog.log.engine.message_types import read_type
from turtlelog.log.engine.source import Selection, Source, iterate_pieces, read_piece
from turtlelog.log.engine.summary import salvage_summary
from turtlelog.log.engine.walk import Loss
from turtlelog.log.recording.head import HEAD, Head, parse_head
from turtlelog.log.recording.losses import describe_recovery, reconcile_topics
from turtlelog.log.recording.topics import (
    LAW_STATE,
    SCHEMAS,
    TOPIC_NAMES,
    Topic,
    define_states,
    list_topics,
)

_OWN: Final = Selection(topics=TOPIC_NAMES, is_lenient=True, is_flat=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Contents:
    """What a recording holds.

    Attributes:
        head: What it says of itself.
        attachments: Bytes by name.
        topics: The columns of every topic that its declaration asks for, by name; empty ones
            without messages.
        damages: What could not be read; empty where the file is whole.
        recovered: A note of what was lost before, where the file is one that was recovered.
    """

    head: Head
    attachments: Mapping[str, bytes]
    topics: Mapping[str, TopicColumns]
    damages: tuple[Loss, ...] = ()
    recovered: Mapping[str, str] = field(default_factory=dict)


class ForeignFileError(LogError):
    """A file that turtlelog did not write."""


def read_contents(stream: BinaryIO, *, may_be_foreign: bool = False) -> Contents:
    """Return what a recording holds; every byte is checked by a checksum, where it has them.

    Args:
        stream: The file.
        may_be_foreign: Do not look for damage that may have made it somebody else's.

    Raises:
        LogError: Where the file is no MCAP, or a topic of ours has another type.
        ForeignFileError: Where it is somebody else's.
        DamageError: Where it was never finished, or is damaged.
    """
    source = Source(stream)
    try:
        contents = _read_source(source)
    except DamageError:
        raise
    except LogError as err:
        if may_be_foreign and isinstance(err, ForeignFileError):
            raise
        source.check_data()  # where a byte is wrong, that is the reason
        raise
    if source.is_indexed:  # last: it names no place
        source.check_data()
    return contents


def reconcile_contents(contents: Contents) -> tuple[Contents, str]:
    """Return contents whose rows belong together, and a clause on what that took."""
    topics, dropped = reconcile_topics(contents.topics, contents.head.declaration)
    return replace(contents, topics=topics), dropped


def _read_source(source: Source) -> Contents:
    parts: dict[str, list[Rows]] = {}
    found: list[Any] = list(source.read_lone((Opcode.METADATA, Opcode.ATTACHMENT)))
    if source.is_indexed:
        # First: what others wrote, or a newer turtlelog, may hold messages unlike ours.
        _find_head(found)
    for piece in iterate_pieces(source, _OWN):
        found += _keep_notes(piece.rest)
        for topic, rows in piece.rows.items():
            parts.setdefault(topic, []).append(rows)
    return build_contents(found, source.catalogue, parts, ())


def _keep_notes(records: Iterable[Any]) -> list[Any]:
    return [found for found in records if isinstance(found, Metadata | Attachment)]


def salvage_contents(stream: BinaryIO) -> Contents:
    """Return what a damaged or unfinished recording still holds.

    Raises:
        LogError: Where the file is no MCAP, or a topic of ours has another type.
    """
    allowance, damages = Allowance(stream.seek(0, os.SEEK_END)), list[Loss]()
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
) -> Contents:
    """Return what records outside chunks, and the rows of topics in parts, make together.

    Raises:
        LogError: Where they are no recording of ours, or a topic of ours has another type.
    """
    head, topics = _find_head(records), {}
    states = () if head.declaration is None else head.declaration.states
    for topic in list_topics(head.declaration):
        plan = _plan(topic, states if topic.name == LAW_STATE else ())
        if topic.name in catalogue.topics:
            _check_type(plan, catalogue.find_plan(topic.name))
        rows = parts.get(topic.name) or [make_empty_rows(plan)]
        topics[topic.name] = build_columns({topic.name: rows}, {topic.name: topic.schema})
    return Contents(
        head=head,
        attachments={found.name: found.data for found in records if isinstance(found, Attachment)},
        topics={name: columns[name] for name, columns in topics.items()},
        damages=tuple(damages),
        recovered=describe_recovery(records),
    )


def _find_head(records: Collection[Any]) -> Head:
    """Return the last one: a live recording says at its end how it ended."""
    heads = [found for found in records if isinstance(found, Metadata) and found.name == HEAD]
    if not heads:
        raise ForeignFileError(
            f"expected a metadata record {HEAD}, found none: not a recording by turtlelog"
        )
    return parse_head(heads[-1].metadata)


def _check_type(expected: TopicPlan, found: TopicPlan) -> None:
    topic, is_state = expected.topic, expected.topic == LAW_STATE
    # The type of the states may have any name: what matters is what the law declares.
    if found.type != expected.type and not is_state:
        kind = found.type or "no type"
        raise LogError(f"topic {topic}: expected {expected.type}, found {kind}")
    if found.reason:
        raise LogError(f"topic {topic}: not understood: {found.reason}")
    if found.fields != expected.fields:
        wanted = f"{expected.type} as ROS 2 defines it"
        wanted = "the declared states, each a float64" if is_state else wanted
        raise LogError(f"topic {topic}: expected {wanted}, found other fields")


def _plan(topic: Topic, states: tuple[str, ...]) -> TopicPlan:
    definition = define_states(states) if states else SCHEMAS[topic.schema]
    kind = read_type(topic.schema, definition)
    return TopicPlan(topic=topic.name, type=topic.schema, fields=kind.fields, layout=kind.layout)
