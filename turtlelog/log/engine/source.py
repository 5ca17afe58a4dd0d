"""A file -> its blocks, through its index where that tells all, else record by record."""

import os
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, BinaryIO, Final, TypeVar

from mcap.records import Statistics

from turtlelog.log.engine.blocks import Block, build_indexed_block, build_walked_block
from turtlelog.log.engine.catalogue import Catalogue
from turtlelog.log.engine.framing import RECORD
from turtlelog.log.engine.integrity import DamageError, Ends, check_data, check_start, read_ends
from turtlelog.log.engine.limits import Allowance
from turtlelog.log.engine.parsing import Place, read_record
from turtlelog.log.engine.summary import ChunkEntry, find_lone_records, parse_summary
from turtlelog.log.engine.walk import Damage, Section, walk_sections

T = TypeVar("T")

_THREADS: Final = min(os.cpu_count() or 1, 4)
_AHEAD: Final = 2**25  # bytes of chunks that are unpacked before they are asked for
EVER: Final = 2**64
"""A log time after all others [ns]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Index:
    """What the summary of a file says, where it tells all.

    Attributes:
        chunks: In the order of the file.
        lone: The records outside chunks that are read one by one.
        statistics: None where there are none.
    """

    chunks: tuple[ChunkEntry, ...]
    lone: tuple[Place, ...]
    statistics: Statistics | None


class Source:
    """An open file, its ends and its summary checked.

    Attributes:
        catalogue: Channels and schemas; without an index it fills as blocks are read.
        index: None where the file has none that tells all.
        ends: Where its parts are.
        allowance: What may be asked for.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self.ends: Ends = read_ends(stream)
        self.allowance = Allowance(stream.seek(0, os.SEEK_END))
        summary = parse_summary(self.ends.summary, self.allowance)
        self.catalogue = Catalogue(self.allowance)
        self.catalogue.add((*summary.schemas, *summary.channels), self.ends.summary.start)
        lone = find_lone_records(stream, self.ends, summary, self.allowance)
        self.statistics = summary.statistics
        self._named = summary.named
        self.index = None
        if lone is not None:
            self.index = Index(chunks=summary.chunks, lone=lone, statistics=summary.statistics)

    def read_lone(self, opcodes: Collection[int]) -> Iterator[Any]:
        """Yield the records of some rare kinds that stand outside chunks; needs an index."""
        assert self.index is not None
        named = {byte: of for byte, of in self._named.items() if of[0] in opcodes}
        for place in self.index.lone:
            if place.opcode not in opcodes:
                continue
            record, byte = read_record(self._stream, place), place.start - RECORD.size
            # Metadata has no checksum; the summary has, and it says what must be there.
            found = place.opcode, getattr(record, "name", "")
            if named.pop(byte, found) != found:
                raise DamageError(f"byte {byte}: expected what the summary names, found {found[1]}")
            yield record
        for byte, (_, name) in named.items():
            raise DamageError(f"byte {byte}: expected a record named {name}, found another")

    def check_data(self) -> None:
        """Check the checksum of the whole data section; costs a pass over the file."""
        check_data(self._stream, self.ends)

    def map_blocks(
        self,
        work: Callable[[Block], T],
        channels: Collection[int] | None = None,
        start_ns: int = 0,
        end_ns: int = EVER,
    ) -> Iterator[T]:
        """Yield what `work` makes of each block, in the order of the file.

        With an index it runs on threads, over the chunks that hold one of the channels and overlap
        the time; otherwise over everything; there the checksum of all data comes at the end.
        """
        if self.index is None:
            yield from map(work, walk_blocks(self._stream, self.catalogue, self.allowance))
            return
        wanted = [
            entry
            for entry in self.index.chunks
            if (channels is None or not entry.channels.isdisjoint(channels))
            and entry.start_ns < end_ns
            and entry.end_ns >= start_ns
        ]

        def build(job: tuple[ChunkEntry, bytes]) -> T:
            block = build_indexed_block(*job, self.allowance.largest_chunk)
            self.catalogue.check(block.rest, block.byte)
            return work(block)

        yield from _map_ahead(build, self._read_chunks(wanted))

    def _read_chunks(self, entries: Iterable[ChunkEntry]) -> Iterator[tuple[ChunkEntry, bytes]]:
        for entry in entries:
            self._stream.seek(entry.start)
            yield entry, self._stream.read(entry.length + entry.index_length)


def walk_blocks(
    stream: BinaryIO,
    catalogue: Catalogue,
    allowance: Allowance,
    *,
    damages: list[Damage] | None = None,
) -> Iterator[Block]:
    """Yield everything in a file as blocks, in its order, and fill the catalogue meanwhile.

    Raises:
        DamageError: Where something is damaged and there is no list that takes the damage.
    """

    def build(section: Section) -> Block:
        block = build_walked_block(
            section.data, section.start, allowance, is_chunk=section.is_chunk
        )
        catalogue.add(block.rest, block.byte)
        return block

    yield from walk_through(stream, build, damages=damages)


def walk_through(
    stream: BinaryIO, work: Callable[[Section], T], *, damages: list[Damage] | None = None
) -> Iterator[T]:
    """Yield what `work` makes of every section of a file, in its order.

    Raises:
        DamageError: Where something is damaged and there is no list that takes the damage.
    """
    check_start(stream)
    for section in walk_sections(stream):
        if isinstance(section, Damage):
            if damages is None:
                raise DamageError(f"byte {section.start}: {section.reason}")
            damages.append(section)
            continue
        try:
            found = work(section)
        except DamageError as err:
            if damages is None:
                raise
            end = section.start + len(section.data)
            damages.append(Damage(start=section.start, end=end, reason=str(err)))
            continue
        yield found


def _map_ahead(
    work: Callable[[tuple[ChunkEntry, bytes]], T], jobs: Iterable[tuple[ChunkEntry, bytes]]
) -> Iterator[T]:
    """Yield results in order, computed on threads a bounded number of bytes ahead."""
    waiting: deque[tuple[int, Future[T]]] = deque()
    ahead = 0  # bytes
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
