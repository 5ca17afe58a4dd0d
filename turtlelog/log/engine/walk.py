"""Reading of a file record by record from its start, even if damaged.

Finished files are read by their indexes. This module is for files without an index, and for
unfinished or damaged files.
"""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import BinaryIO, Final

from mcap.opcode import Opcode

from turtlelog.errors import LogError
from turtlelog.log.engine import framing, limits, records
from turtlelog.log.engine.records import MCAP0_MAGIC, RECORD

_BATCH: Final = 2**20  # bytes of consecutive records outside chunks that are returned together
_LONGEST_NAME: Final = 64  # bytes of the name of a compression
_LONE: Final = framing.RUNS | {Opcode.HEADER, Opcode.DATA_END}


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A segment of records without known damage.

    Attributes:
        data: Records one after the other: opcode u8, length u64, body. The records are all those of
            an unpacked chunk, or records outside chunks in the data section: header, schemas,
            channels, messages, metadata, one attachment, the end of the data.
        start: Offset in the file [bytes].
        is_chunk: Whether the segment is a chunk.
        is_checked: Whether the checksum of the chunk or attachment is correct. For the record at
            the end of the data: whether the checksum of the whole data section is correct.
    """

    data: bytes
    start: int
    is_chunk: bool
    is_checked: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Loss:
    """A segment of a file that could not be read.

    Attributes:
        start: Offset of the first byte in the file.
        end: Offset after the last byte; equal to `start` if bytes are missing there.
        reason: Expected and found content, in one clause.
    """

    start: int
    end: int
    reason: str


def walk_sections(stream: BinaryIO) -> Iterator[Section | Loss]:
    """Yield the data section in the order of the file, and the segments that cannot be read.

    After an invalid header, reading continues at the next record that can be confirmed: a chunk, a
    message index, or an attachment with its checksum. Single messages count only if earlier
    messages were outside chunks. A chunk that fails its checksum counts as damaged as a whole. An
    unfinished file ends in damage. The summary is not read. Memory is needed for one chunk at a
    time, packed and unpacked.
    """
    window, damaged = framing.FileWindow(stream), False
    for found in _walk_records(window):
        if isinstance(found, Loss):
            damaged = True
        elif not damaged and _find_opcode(found) == Opcode.DATA_END:
            expected, checksum = int.from_bytes(found.data[-4:], "little"), 0
            for place in range(0, found.start if expected else 0, _BATCH):
                data = window.read(place, min(_BATCH, found.start - place))
                checksum = zlib.crc32(data, checksum)
            yield replace(found, is_checked=expected != 0 and checksum == expected)
            if checksum != expected:
                start = found.start
                reason = f"expected data with the checksum {expected:#010x}, found {checksum:#010x}"
                yield Loss(start=start, end=start, reason=reason)
            continue
        yield found


def walk_growing(stream: BinaryIO, place: int) -> Iterator[tuple[Section | None, int]]:
    """Yield complete records from `place`, the start of a record, and the place to continue.

    This function reads files that are being written, so it ends before the first incomplete record.
    After the end of the data, the place to continue is the end of the file.
    """
    window = framing.FileWindow(stream)
    while place < window.size:
        try:
            found, after = _read_record(window, place, Opcode.CHUNK)
        except LogError:
            return
        place = window.size if after is None else after
        if not found:
            yield None, place
        for section in found:
            if isinstance(section, Loss):
                return
            yield section, place


def _walk_records(window: framing.FileWindow) -> Iterator[Section | Loss]:
    place: int | None = len(MCAP0_MAGIC)
    reason = records.find_wrong_start(window.read(0, records.START_SIZE))
    if reason is not None:
        yield Loss(start=0, end=min(len(MCAP0_MAGIC), window.size), reason=reason)
    kind = 0  # first kind found: chunks, single messages, or 0 for records that precede both
    while place is not None:
        start = place
        try:
            found, place = _read_record(window, place, kind)
            losses = sum(isinstance(one, Loss) for one in found)
            window.allowance.spend(limits.DAMAGES, losses)
            sections = [one for one in found if isinstance(one, Section)]
            window.allowance.spend(limits.CHUNKS, sum(one.is_chunk for one in sections))
            notes = [one for one in sections if _find_opcode(one) == Opcode.ATTACHMENT]
            window.allowance.spend(limits.NOTES, len(notes))
        except LogError as err:
            if not all(
                map(window.allowance.count_left, (limits.CHUNKS, limits.DAMAGES, limits.NOTES))
            ):
                yield Loss(start=start, end=window.size, reason=str(err))
                return
            window.allowance.spend(limits.DAMAGES)
            place = framing.find_next_record(window, start + 1, is_lone=kind == Opcode.MESSAGE)
            end = window.size if place is None else place
            yield Loss(start=start, end=end, reason=str(err))
            continue
        yield from found
        if kind not in {Opcode.CHUNK, Opcode.MESSAGE} and start < window.size:
            kind = window.read(start, 1)[0]


def _find_opcode(section: Section) -> int:
    return Opcode.CHUNK if section.is_chunk else section.data[0]


def _read_record(
    window: framing.FileWindow, place: int, kind: int
) -> tuple[list[Section | Loss], int | None]:
    """Return the record at `place` and the place to continue, if any."""
    if place >= window.size:
        reason = "expected the end of the data, found that of the file: cut short, or not finished"
        return [Loss(start=window.size, end=window.size, reason=reason)], None
    if window.read(place, 1)[0] == Opcode.CHUNK:
        return _read_chunk(window, place)
    if window.read(place, 1)[0] == Opcode.ATTACHMENT:
        return _read_attachment(window, place)
    opcode, end = framing.find_record_end(window, place)
    # A wrong bit can turn a header or a message index into a message. No writer mixes chunks and
    # single messages.
    if opcode == Opcode.MESSAGE and kind in {0, Opcode.CHUNK}:
        raise LogError("expected messages in chunks, found one that stands alone")
    # A wrong bit can turn metadata or an attachment into one of these.
    if opcode in framing.SUMMARY_ONLY:
        raise LogError(f"expected data, found a record of the summary (opcode {opcode})")
    if opcode == Opcode.FOOTER:
        reason = "expected the end of the data, found that of the file"
        return [Loss(start=place, end=place, reason=reason)], None
    if opcode not in _LONE:
        return [], end
    data = _read_run(window, place, opcode)
    section = Section(data=data, start=place, is_chunk=False, is_checked=False)
    return [section], None if opcode == Opcode.DATA_END else place + len(data)


def _read_run(window: framing.FileWindow, place: int, opcode: int) -> bytes:
    """Return consecutive records of one kind from `place`, up to a batch."""
    end = framing.find_record_end(window, place)[1]
    if opcode == Opcode.MESSAGE:
        end = max(end, place + framing.skip_followed(window.read(place, _BATCH)))
    while opcode in framing.RUNS and end - place < _BATCH:
        try:
            found, after = framing.find_record_end(window, end)
        except LogError:
            break
        if found != opcode:
            break
        end = after
    return window.read(place, end - place)


def _read_attachment(window: framing.FileWindow, place: int) -> tuple[list[Section | Loss], int]:
    fault = None
    last = framing.measure_record(window, place, Opcode.ATTACHMENT, window.size)
    try:
        _, end = framing.find_record_end(window, place)
    except LogError as err:
        if last > window.size or not window.spend(last - place):
            raise
        fault, end = err, last
    data = window.read(place, last - place)
    checksum, found = (
        int.from_bytes(data[-4:], "little"),
        zlib.crc32(data[RECORD.size : -4]),
    )
    is_checked = checksum != 0 and found == checksum
    if fault is not None and not is_checked:
        raise fault
    if checksum and not is_checked:
        reason = f"expected an attachment with checksum {checksum:#010x}, found {found:#010x}"
        return [Loss(start=place, end=end, reason=reason)], end
    # Bytes after the checksum are omitted; the length is corrected.
    data = data[:1] + (last - place - RECORD.size).to_bytes(8, "little") + data[RECORD.size :]
    section = Section(data=data, start=place, is_chunk=False, is_checked=is_checked)
    if fault is None:
        return [section], end
    # The checksum is correct, so the length is wrong, or the next record.
    return [section, Loss(start=place, end=place, reason=str(fault))], end


def _read_chunk(window: framing.FileWindow, place: int) -> tuple[list[Section | Loss], int]:
    front = RECORD.size + framing.CHUNK_HEAD.size
    head = window.read(place, front)
    if len(head) < front:
        raise LogError("expected a chunk, found the end of the file within its header")
    _, length = RECORD.unpack_from(head)
    _, _, size, checksum, name_size = framing.CHUNK_HEAD.unpack_from(head, RECORD.size)
    if name_size > _LONGEST_NAME:
        raise LogError(f"expected a chunk, found a compression of {name_size} letters")
    rest = window.read(place + front, name_size + 8)
    start = place + front + name_size + 8
    by_record, by_data = (
        place + RECORD.size + length,
        start + int.from_bytes(rest[-8:], "little"),
    )
    agree = by_data == by_record or (
        by_data < by_record <= window.size
        and framing.is_padding(window, by_data, by_record, Opcode.CHUNK)
    )
    ends = [
        end
        for end in dict.fromkeys((by_data, by_record))
        if start <= end <= min(window.size, start + limits.LARGEST_CHUNK)
    ]
    after = [
        end for end in ends if agree or framing.is_record_start(window, end, after=Opcode.CHUNK)
    ]
    reason = f"the file ends {window.size - start} bytes into a chunk of {length}"
    for end in filter(lambda end: end in after or (checksum and window.spend(end - start)), ends):
        try:
            packed = window.read(start, end - start)
            data = _unpack(window.allowance, rest[:-8].decode("utf-8", "replace"), packed, size)
            _check_chunk(data, size, checksum, agree=agree and end == by_data)
        except LogError as err:
            reason = str(err)
            continue
        section = Section(data=data, start=place, is_chunk=True, is_checked=checksum != 0)
        if agree and end == by_data and len(data) == size:
            return [section], by_record
        # The checksum is correct, so the header is wrong, or the next record.
        reason = f"expected a chunk of {len(data)} bytes, found a header that says otherwise"
        if len(data) == size:
            reason = "the chunk's lengths disagree, and no sound record follows"
        return [section, Loss(start=place, end=start, reason=reason)], end
    if not after:
        raise LogError(reason)
    end = by_record if agree else after[0]
    return [Loss(start=place, end=end, reason=reason)], end


def _unpack(allowance: limits.Allowance, compression: str, packed: bytes, size: int) -> bytes:
    largest = allowance.largest_chunk
    if compression and size > largest:
        raise LogError(f"expected a chunk of up to {largest} bytes, found {size}")
    if compression and not allowance.count_left(limits.UNPACKED):
        allowance.spend(limits.UNPACKED)
    spend = partial(allowance.spend, limits.UNPACKED)
    return limits.unpack_chunk(compression, packed, size, largest=largest, spend=spend)


def _check_chunk(data: bytes, size: int, checksum: int, *, agree: bool) -> None:
    if checksum and (found := zlib.crc32(data)) != checksum:
        raise LogError(f"expected a chunk with the checksum {checksum:#010x}, found {found:#010x}")
    if not checksum and (len(data) != size or not agree):
        raise LogError(f"expected a chunk of {size} bytes, found {len(data)} and no checksum")
