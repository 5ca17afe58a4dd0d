"""How much of what a file holds: from its summary where that tells, else counted."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, BinaryIO, Final

from mcap.opcode import Opcode

from turtlelog.log.engine.blocks import MESSAGE_HEAD, Block
from turtlelog.log.engine.catalogue import Catalogue
from turtlelog.log.engine.ends import DamageError, UnfinishedError
from turtlelog.log.engine.gather import gather_bytes
from turtlelog.log.engine.rows import LOG_TIME, MESSAGE_HEADER
from turtlelog.log.engine.source import Source, walk_blocks
from turtlelog.log.engine.walk import Damage

_LONE: Final = (Opcode.METADATA, Opcode.ATTACHMENT)


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
    damages: tuple[Damage, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class _Tally:
    counts: Mapping[int, int]
    span_ns: tuple[int, int] | None
    records: tuple[Any, ...]


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
    catalogue, damages = Catalogue(), list[Damage]()
    blocks = walk_blocks(stream, catalogue, damages=damages)
    survey = _add_up(catalogue, map(_tally_block, blocks), (), is_finished=False)
    return replace(survey, damages=tuple(damages))


def _survey_source(stream: BinaryIO) -> Survey:
    source = Source(stream)
    lone = () if source.index is None else tuple(source.read_lone(_LONE))
    statistics = source.statistics
    if (
        source.index is None
        or statistics is None
        or (statistics.message_count and not statistics.channel_message_counts)
    ):
        return _add_up(source.catalogue, source.map_blocks(_tally_block), lone, is_finished=True)
    span_ns = statistics.message_start_time, statistics.message_end_time
    return Survey(
        catalogue=source.catalogue,
        counts=statistics.channel_message_counts,
        span_ns=span_ns if statistics.message_count else None,
        records=lone,
        is_finished=True,
    )


def _add_up(
    catalogue: Catalogue, tallies: Iterable[_Tally], lone: tuple[Any, ...], *, is_finished: bool
) -> Survey:
    counts: Counter[int] = Counter()
    spans, records = [], [*lone]
    for tally in tallies:
        counts.update(tally.counts)
        spans += [] if tally.span_ns is None else [tally.span_ns]
        records += tally.records
    firsts, lasts = zip(*spans, strict=True) if spans else ((), ())
    return Survey(
        catalogue=catalogue,
        counts=counts,
        span_ns=(min(firsts), max(lasts)) if spans else None,
        records=tuple(records),
        is_finished=is_finished,
    )


def _tally_block(block: Block) -> _Tally:
    spans = []
    for starts in block.offsets.values():
        heads = gather_bytes(block.data, starts, MESSAGE_HEAD).view(MESSAGE_HEADER)
        if len(heads):
            spans.append((int(heads[LOG_TIME].min()), int(heads[LOG_TIME].max())))
    span_ns = (min(first for first, _ in spans), max(last for _, last in spans)) if spans else None
    counts = {channel: len(starts) for channel, starts in block.offsets.items()}
    return _Tally(counts=counts, span_ns=span_ns, records=block.rest)
