"""How much of what a file holds: from its summary where that tells, else counted."""

import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, BinaryIO, Final

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment, Metadata
from numpy.typing import NDArray

from turtlelog.log.engine.blocks import Block, parse_others, take_walked, walk_through
from turtlelog.log.engine.channels import Catalogue
from turtlelog.log.engine.integrity import DamageError, UnfinishedError
from turtlelog.log.engine.limits import Allowance
from turtlelog.log.engine.parsing import HEADING, MESSAGE_HEAD, gather_bytes
from turtlelog.log.engine.source import Source
from turtlelog.log.engine.walk import Loss, Section

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
    damages: tuple[Loss, ...] = ()


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
