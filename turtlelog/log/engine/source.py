"""Reading of requested messages piece by piece, by the index or record by record."""

import os
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, BinaryIO, Final, TypeVar

import numpy as np

from turtlelog.errors import LogError
from turtlelog.files.urls import expect_reads
from turtlelog.log.engine.blocks import (
    Block,
    Offsets,
    build_indexed_block,
    count_indexed,
    walk_blocks,
)
from turtlelog.log.engine.channels import Catalogue, TopicPlan, measure_object
from turtlelog.log.engine.decode import (
    LOG_TIME,
    FixedColumns,
    Rows,
    decode_rows,
    pick_rows,
    rewrite_ros1,
    unpack_messages,
)
from turtlelog.log.engine.framing import RECORD
from turtlelog.log.engine.limits import COLUMNS, Allowance, measure_stored
from turtlelog.log.engine.parsing import gather_heads, read_record
from turtlelog.log.engine.sqlite_source import SqliteSource
from turtlelog.log.engine.summary import (
    ChunkEntry,
    Ends,
    check_data,
    find_lone_records,
    parse_summary,
    read_ends,
)
from turtlelog.log.file_access import DamageError, name_place

if TYPE_CHECKING:
    from concurrent.futures import Future


T = TypeVar("T")

_Job = tuple[ChunkEntry, bytes, Mapping[str, int]]

_THREADS: Final = min(os.cpu_count() or 1, 4)
_AHEAD: Final = 2**25  # bytes of chunks that are unpacked before they are needed

_MOST_REASONS: Final = 3
"""Largest number of topics that an error lists with their reasons."""

EVER: Final = 2**64
"""A log time after all others [ns]."""


class Source:
    """An open MCAP file with checked ends and summary.

    Attributes:
        catalogue: Channels and schemas. Without an index, the catalogue is filled while blocks are
            read.
        is_indexed: Whether the summary indexes the complete file.
        statistics: Statistics record; None if the file has none.
        ends: Offsets of the file's parts.
        allowance: Remaining limits of the file.
        size: Size of the file [bytes].
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self.ends: Ends = read_ends(stream)
        self.size = stream.seek(0, os.SEEK_END)
        self.allowance = Allowance(measure_stored(stream))
        summary = parse_summary(self.ends.summary, self.ends.summary_start, self.allowance)
        self.catalogue = Catalogue(self.allowance)
        self.catalogue.add((*summary.schemas, *summary.channels), self.ends.summary_start)
        lone = find_lone_records(stream, self.ends, summary, self.allowance)
        self.statistics, self.is_indexed = summary.statistics, lone is not None
        self._lone, self._summary = lone or (), summary

    def read_lone(self, opcodes: Collection[int]) -> Iterator[Any]:
        """Yield the records of several rare kinds outside chunks; none if the file has no index."""
        named = self._summary.named if self.is_indexed else {}
        named = {byte: of for byte, of in named.items() if of[0] in opcodes}
        for place in self._lone:
            if place.opcode not in opcodes:
                continue
            record, byte = read_record(self._stream, place), place.start - RECORD.size
            # Metadata has no checksum; the summary has one, and shows which metadata must exist.
            found = place.opcode, getattr(record, "name", "")
            if named.pop(byte, found) != found:
                raise DamageError(f"byte {byte}: expected what the summary names, found {found[1]}")
            yield record
        for byte, (_, name) in named.items():
            raise DamageError(f"byte {byte}: not the record named {name}")

    @property
    def summary_start(self) -> int:
        """The offset of the summary [bytes]."""
        return self.ends.summary_start

    @property
    def index_length(self) -> int:
        """The total size of all message indexes [bytes]."""
        return sum(entry.index_length for entry in self._summary.chunks)

    def check_data(self) -> None:
        """Check the checksum of the whole data section, in one pass over the file."""
        check_data(self._stream, self.ends)

    def map_blocks(
        self,
        work: Callable[[Block], T],
        channels: Collection[int] | None = None,
        start_ns: int = 0,
        end_ns: int = EVER,
    ) -> Iterator[T]:
        """Yield the result of `work` for each block, in file order.

        With an index, threads process the chunks that contain one of the channels and overlap the
        time interval. Without an index all blocks are processed, and the checksum of all data is
        checked at the end.
        """
        if not self.is_indexed:
            yield from map(work, self._walk_blocks())
            return
        wanted = [
            entry
            for entry in self._summary.chunks
            if (channels is None or not entry.channels.isdisjoint(channels))
            and entry.start_ns < end_ns
            and entry.end_ns >= start_ns
        ]

        def build(job: _Job) -> T:
            entry, stored, before = job
            block = build_indexed_block(
                entry, stored, self._summary.described, self.allowance.largest_chunk
            )
            self.catalogue.check(block.rest, block.byte)
            return work(replace(block, before=before))

        expect_reads(
            self._stream,
            ((entry.start, entry.start + entry.length + entry.index_length) for entry in wanted),
        )
        jobs = self._read_chunks(wanted)
        # Starting threads takes longer than reading one chunk.
        yield from map(build, jobs) if len(wanted) <= 1 else _map_ahead(build, jobs)

    def _walk_blocks(self) -> Iterator[Block]:
        counts: Counter[str] = Counter()
        known = self.catalogue.channels
        for block in walk_blocks(self._stream, self.catalogue, self.allowance):
            yield replace(block, before=dict(counts))
            for channel, starts in block.offsets.items():
                if channel in known:
                    counts[known[channel].topic] += len(starts)

    def _read_chunks(self, entries: Iterable[ChunkEntry]) -> Iterator[_Job]:
        counts: Counter[str] = Counter()
        known = self.catalogue.channels
        for entry in entries:
            self._stream.seek(entry.start)
            stored = self._stream.read(entry.length + entry.index_length)
            yield entry, stored, dict(counts)
            for channel, count in count_indexed(memoryview(stored)[entry.length :]):
                if channel in known:
                    counts[known[channel].topic] += count


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """A segment of consecutive messages.

    Attributes:
        rows: Rows of requested topics.
        size: Number of bytes read.
        counts: Number of messages by channel, requested or not.
        rest: Other records of the block; only in the first piece of a block.
    """

    rows: Mapping[str, Rows]
    size: int
    counts: Mapping[int, int]
    rest: tuple[Any, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """The requested messages.

    Attributes:
        topics: Names of the topics to read. None: every topic that can be decoded.
        start_ns: Earliest log time [ns], inclusive.
        end_ns: End of the log time [ns], exclusive.
        is_lenient: Whether named topics may be missing or undecodable. All chunks are then read and
            checked.
        is_flat: Whether only numbers and texts are allowed as fields. Sequences of texts or
            messages take some hundred times their bytes in memory.
        is_counted: Whether the memory of rows is limited in proportion to the file's size.
        kept: Columns to keep, by topic, including the log time. Topics that are not listed keep all
            columns.
    """

    topics: frozenset[str] | None = None
    start_ns: int = 0
    end_ns: int = EVER
    is_lenient: bool = False
    is_flat: bool = False
    is_counted: bool = False
    kept: Mapping[str, Collection[str]] = field(default_factory=dict)

    @property
    def is_ever(self) -> bool:
        """Whether no message is left out because of its time."""
        return self.start_ns <= 0 and self.end_ns >= EVER

    def choose_plans(self, catalogue: Catalogue) -> dict[str, TopicPlan]:
        """Return the plans of the requested topics that are known so far."""
        known = catalogue.topics
        names = sorted(known if self.topics is None else self.topics.intersection(known))
        plans = ((topic, self.choose_plan(catalogue, topic)) for topic in names)
        return {topic: plan for topic, plan in plans if plan is not None}

    def choose_plan(self, catalogue: Catalogue, topic: str) -> TopicPlan | None:
        """Return the plan of a topic; None if it is not requested."""
        if self.topics is not None and topic not in self.topics:
            return None
        plan = catalogue.find_plan(topic)
        if plan.reason and self.topics is not None and not self.is_lenient:
            raise LogError(plan.describe_reason())
        if self.is_flat and plan.sequence is not None:
            raise LogError(
                f"topic {topic}: expected fields of numbers and texts, found the sequence"
                f" {plan.sequence}"
            )
        if self.is_flat and plan.json is not None:
            flat = tuple(field for field in plan.json if field.kind != "any")
            plan = replace(plan, json=flat, row_size=measure_object(flat))
        return None if plan.reason else plan

    def require_topics(self, catalogue: Catalogue) -> None:
        """Check that every topic requested by name exists, or that any topic can be decoded."""
        if self.topics is None and not self.is_lenient:
            plans = [catalogue.find_plan(topic) for topic in sorted(catalogue.topics)]
            if plans and all(plan.reason for plan in plans):
                raise LogError("; ".join(plan.describe_reason() for plan in plans[:_MOST_REASONS]))
        missing = (self.topics or frozenset()).difference(catalogue.topics)
        for topic in () if self.is_lenient else sorted(missing):
            raise LogError(f"topic {topic}: expected it in the file, found no such topic")


def iterate_pieces(
    source: Source | SqliteSource,
    selection: Selection,
    most_rows: int | None = None,
    wholes: Mapping[str, FixedColumns] = MappingProxyType({}),
) -> Iterator[Piece]:
    """Yield the requested messages in file order, at most `most_rows` per topic in a piece.

    Messages of topics in `wholes` are stored there instead of in pieces, as long as there is room.

    Raises:
        LogError: If a requested topic is missing or cannot be decoded.
        DamageError: If the file is damaged, or counts differ from the statistics.
    """
    catalogue, channels = source.catalogue, None
    if source.is_indexed:
        selection.require_topics(catalogue)
        plans = selection.choose_plans(catalogue)
        known = catalogue.channels.values()
        if not selection.is_lenient:
            channels = {channel.id for channel in known if channel.topic in plans}
    counts: Counter[int] = Counter()

    def read(block: Block) -> list[Piece]:
        parts = _split(block.offsets, most_rows)
        pieces = [read_piece(catalogue, selection, block, offsets, wholes) for offsets in parts]
        return [replace(pieces[0], rest=block.rest), *pieces[1:]]

    for pieces in source.map_blocks(read, channels, selection.start_ns, selection.end_ns):
        for piece in pieces:
            counts.update(piece.counts)
            yield piece
    if not source.is_indexed:  # the blocks have named the topics
        selection.require_topics(catalogue)
        selection.choose_plans(catalogue)
    if selection.is_ever:
        _check_counts(source, counts, channels)


def count_rows(source: Source | SqliteSource, selection: Selection) -> Mapping[str, int]:
    """Return the number of rows of each topic from the statistics; empty without statistics.

    If there are message indexes, their size limits the numbers.
    """
    if source.statistics is None or not selection.is_ever:
        return {}
    room = source.index_length // 16 if source.is_indexed else EVER
    counts: Counter[str] = Counter()
    for number, count in source.statistics.channel_message_counts.items():
        if number in source.catalogue:
            counts[source.catalogue.channels[number].topic] += min(count, room)
    return counts


def read_piece(
    catalogue: Catalogue,
    selection: Selection,
    block: Block,
    offsets: Mapping[int, Offsets],
    wholes: Mapping[str, FixedColumns] = MappingProxyType({}),
) -> Piece:
    """Return the requested messages among those at some offsets of a block."""
    found = {}
    for topic, channels in catalogue.group_channels(offsets, block.byte).items():
        parts = [offsets[channel] for channel in channels]
        starts = parts[0] if len(parts) == 1 else np.sort(np.concatenate(parts))
        plan = selection.choose_plan(catalogue, topic)
        if plan is None or not len(starts):
            continue
        whole = None if block.before is None else wholes.get(topic)
        rows = _read_topic(plan, block, starts, selection, catalogue.allowance, whole)
        if rows and len(rows[LOG_TIME]):
            found[topic] = rows
    counts = {channel: len(starts) for channel, starts in offsets.items()}
    share = sum(counts.values()) / max(sum(map(len, block.offsets.values())), 1)
    return Piece(rows=found, size=int(len(block.data) * share), counts=counts)


def _read_topic(
    plan: TopicPlan,
    block: Block,
    starts: Offsets,
    selection: Selection,
    allowance: Allowance,
    whole: FixedColumns | None,
) -> Rows:
    """Return the requested messages of a topic; empty if they went into the columns `whole`."""
    place = f"{block.unit} {block.byte}: topic {plan.topic}"
    with name_place(place):
        messages = unpack_messages(block, starts, allowance)
        unpacked, starts = rewrite_ros1(plan, *messages)
    if selection.is_counted:
        allowance.spend(COLUMNS, _measure_rows(plan, unpacked.data, starts))
    with name_place(place):
        first = 0 if block.before is None else block.before.get(plan.topic, 0)
        if whole is not None and whole.fill(unpacked.data, starts, first):
            return {}
        rows = decode_rows(plan, unpacked, starts)
    kept = selection.kept.get(plan.topic)
    if kept is not None:
        rows = {name: rows[name] for name in rows if name in kept}
    if selection.is_ever:
        return rows
    times = rows[LOG_TIME]
    return pick_rows(rows, (times >= selection.start_ns) & (times < selection.end_ns))


_LISTS: Final = 2
"""Memory factor for lists: nested messages take ten times their bytes, columns five times."""


def _measure_rows(plan: TopicPlan, data: bytes, starts: Offsets) -> int:
    """Return the approximate memory of messages as columns [bytes]."""
    size = len(starts) * plan.row_size
    if plan.layout is None:
        share = 1 if plan.sequence is None else _LISTS
        size += share * int(gather_heads(data, starts)["length"].sum())
    return size


def _map_ahead(work: Callable[[_Job], T], jobs: Iterable[_Job]) -> Iterator[T]:
    """Yield results in order. Threads compute them ahead, up to a limited number of bytes."""
    from concurrent.futures import ThreadPoolExecutor  # 8 ms that a file with one chunk saves

    waiting: deque[tuple[int, Future[T]]] = deque()
    ahead = 0  # bytes computed ahead
    with ThreadPoolExecutor(_THREADS) as pool:
        try:
            for job in jobs:
                size = job[0].size + job[0].length
                while waiting and (ahead + size > _AHEAD or len(waiting) > 4 * _THREADS):
                    done, future = waiting.popleft()
                    ahead -= done
                    yield future.result()
                waiting.append((size, pool.submit(work, job)))
                ahead += size
            while waiting:
                yield waiting.popleft()[1].result()
        finally:
            for _, future in waiting:
                future.cancel()


def _split(
    offsets: Mapping[int, Offsets], most_rows: int | None
) -> Sequence[Mapping[int, Offsets]]:
    """Return the messages of a block in segments of at most `most_rows` messages per channel."""
    if most_rows is None or max(map(len, offsets.values()), default=0) <= most_rows:
        return [offsets]
    borders = np.unique(np.concatenate([found[most_rows::most_rows] for found in offsets.values()]))
    stretches: Sequence[dict[int, Offsets]] = [{} for _ in range(len(borders) + 1)]
    for channel, of in offsets.items():
        parts = np.split(of, np.searchsorted(of, borders))
        for stretch, part in zip(stretches, parts, strict=True):
            if len(part):
                stretch[channel] = part
    return stretches


def _check_counts(
    source: Source | SqliteSource, counts: Counter[int], channels: Collection[int] | None
) -> None:
    statistics = source.statistics
    for channel, expected in statistics.channel_message_counts.items() if statistics else ():
        if (channels is None or channel in channels) and counts[channel] != expected:
            raise DamageError(
                f"byte {source.summary_start}: channel {channel}: expected {expected} messages"
                f" as the statistics say, found {counts[channel]}"
            )
