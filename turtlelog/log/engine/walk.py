"""Reading of a file without an index, or a damaged one, record by record from its start."""

import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import BinaryIO, Final

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine import limits, records
from turtlelog.log.engine.limits import FileWindow
from turtlelog.log.engine.records import RECORD
from turtlelog.log.file_access import MCAP0_MAGIC, START_SIZE, Loss, find_wrong_start

CHUNK_HEAD: Final = struct.Struct("<QQQII")
"""Start and end time, unpacked size, checksum, and length of the compression's name."""

_INDEXES: Final = frozenset({Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX})
_SUMMARY_ONLY: Final = _INDEXES | {Opcode.STATISTICS, Opcode.SUMMARY_OFFSET}
"""Kinds of records that occur only after the data section."""

_AFTER_DATA: Final = _SUMMARY_ONLY | {Opcode.FOOTER, Opcode.SCHEMA, Opcode.CHANNEL}

_CHAIN: Final = 4
"""Number of consecutive records that are accepted without a checksum.

In the worst case, messages half of zeros, a megabyte contains a thousand places that look like a
record's head; one in a hundred is followed by another. By chance, three in a row occur once in a
gigabyte, four once in 100 GB. Fewer consecutive messages are not found after damage."""

_PRIVATE: Final = 0x80  # first opcode for private use
_KNOWN: Final = frozenset(int(opcode) for opcode in Opcode)
_BEFORE_INDEX: Final = frozenset({0, Opcode.CHUNK, Opcode.MESSAGE_INDEX})

# Size of the fixed front of a body [bytes], and number of length-prefixed fields after it.
_SHAPES: Final[Mapping[int, tuple[int, int]]] = {
    Opcode.HEADER: (0, 2),
    Opcode.SCHEMA: (2, 3),
    Opcode.CHANNEL: (4, 3),
    Opcode.METADATA: (0, 2),
    Opcode.MESSAGE_INDEX: (2, 1),
    Opcode.ATTACHMENT: (16, 2),
    Opcode.CHUNK: (28, 1),
}
# Two kinds continue with data that have an 8-byte length; number of bytes after these data.
_DATA: Final[Mapping[int, int]] = {Opcode.ATTACHMENT: 4, Opcode.CHUNK: 0}
# Least and greatest length of other bodies [bytes].
_LENGTHS: Final[Mapping[int, tuple[int, int]]] = {
    Opcode.MESSAGE: (records.COUNTED_HEAD, records.LARGEST_RECORD),
    Opcode.CHUNK: (40, records.LARGEST_RECORD),
    Opcode.DATA_END: (4, 4),
    Opcode.FOOTER: (20, 20),
}

_FIRST_STEP: Final = 2**12  # bytes searched at a time while the next record may be near
_STEP: Final = 2**19
_FOOTER_SIZE: Final = 29
_INDEX_HEAD: Final = 6  # bytes of a message index before its pairs: channel, length of the pairs
_PAIR: Final = 16  # bytes: log time, offset

_RUNS: Final = frozenset({Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA})
"""Kinds of records that stand one after the other outside chunks."""

_BOUND: Final = (Opcode.FOOTER, Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT)

_BATCH: Final = 2**20  # bytes of consecutive records outside chunks that are returned together
_LONE: Final = _RUNS | {Opcode.HEADER, Opcode.DATA_END}


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A segment of records without known damage.

    Attributes:
        data: Records one after the other (opcode u8, length u64, body): all those of an unpacked
            chunk, or records outside chunks in the data section.
        start: Offset in the file [bytes].
        is_chunk: Whether the segment is a chunk.
        is_checked: Whether the checksum of the chunk or attachment is correct. For the record at
            the end of the data: whether the checksum of the whole data section is correct.
    """

    data: bytes
    start: int
    is_chunk: bool
    is_checked: bool

    @property
    def opcode(self) -> int:
        """Kind of the records; for records outside chunks, that of the first."""
        return Opcode.CHUNK if self.is_chunk else self.data[0]


def walk_sections(stream: BinaryIO) -> Iterator[Section | Loss]:
    """Yield the data section in the order of the file, and the segments that cannot be read.

    After an invalid header, reading continues at the next record that can be confirmed: a chunk, a
    message index, or an attachment with its checksum; messages only if earlier ones were outside
    chunks. A chunk that fails its checksum is damaged as a whole. An unfinished file ends in
    damage. Memory is needed for one chunk at a time, packed and unpacked.
    """
    window, damaged = FileWindow(stream), False
    for found in _walk_records(window):
        if isinstance(found, Loss):
            damaged = True
        elif not damaged and found.opcode == Opcode.DATA_END:
            expected, checksum = int.from_bytes(found.data[-4:], "little"), 0
            for place in range(0, found.start if expected else 0, _BATCH):
                data = window.read(place, min(_BATCH, found.start - place))
                checksum = zlib.crc32(data, checksum)
            yield replace(found, is_checked=expected != 0 and checksum == expected)
            if checksum != expected:
                reason = f"expected data with the checksum {expected:#010x}, found {checksum:#010x}"
                yield Loss(start=found.start, end=found.start, reason=reason)
            continue
        yield found


def walk_growing(stream: BinaryIO, place: int) -> Iterator[tuple[Section | None, int]]:
    """Yield complete records from `place`, the start of a record, and the place to continue.

    The file may be growing: reading ends before the first incomplete record. After the end of the
    data, the place to continue is the end of the file.
    """
    window = FileWindow(stream)
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


def _walk_records(window: FileWindow) -> Iterator[Section | Loss]:
    place: int | None = len(MCAP0_MAGIC)
    reason = find_wrong_start(window.read(0, START_SIZE))
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
            notes = [one for one in sections if one.opcode == Opcode.ATTACHMENT]
            window.allowance.spend(limits.NOTES, len(notes))
        except LogError as err:
            counted = limits.CHUNKS, limits.DAMAGES, limits.NOTES
            if not all(map(window.allowance.count_left, counted)):
                yield Loss(start=start, end=window.size, reason=str(err))
                return
            window.allowance.spend(limits.DAMAGES)
            place = _find_next_record(window, start + 1, is_lone=kind == Opcode.MESSAGE)
            end = window.size if place is None else place
            yield Loss(start=start, end=end, reason=str(err))
            continue
        yield from found
        if kind not in {Opcode.CHUNK, Opcode.MESSAGE} and start < window.size:
            kind = window.read(start, 1)[0]


def _read_record(
    window: FileWindow, place: int, kind: int
) -> tuple[list[Section | Loss], int | None]:
    """Return the record at `place` and the place to continue, if any."""
    if place >= window.size:
        reason = "expected the end of the data, found that of the file: cut short, or not finished"
        return [Loss(start=window.size, end=window.size, reason=reason)], None
    if (opcode := window.read(place, 1)[0]) == Opcode.CHUNK:
        return _read_chunk(window, place)
    if opcode == Opcode.ATTACHMENT:
        return _read_attachment(window, place)
    opcode, end = _find_record_end(window, place)
    # A wrong bit can turn another record into a message. No writer mixes chunks and single
    # messages.
    if opcode == Opcode.MESSAGE and kind in {0, Opcode.CHUNK}:
        raise LogError("expected messages in chunks, found one that stands alone")
    # A wrong bit can turn metadata or an attachment into one of these.
    if opcode in _SUMMARY_ONLY:
        raise LogError(f"expected data, found a record of the summary (opcode {opcode})")
    if opcode == Opcode.FOOTER:
        reason = "expected the end of the data, found that of the file"
        return [Loss(start=place, end=place, reason=reason)], None
    if opcode not in _LONE:
        return [], end
    data = _read_run(window, place, opcode, end)
    section = Section(data=data, start=place, is_chunk=False, is_checked=False)
    return [section], None if opcode == Opcode.DATA_END else place + len(data)


def _read_run(window: FileWindow, place: int, opcode: int, end: int) -> bytes:
    """Return consecutive records of one kind from `place`, the first to `end`, up to a batch."""
    if opcode == Opcode.MESSAGE:
        end = max(end, place + records.skip_followed(window.read(place, _BATCH)))
    while opcode in _RUNS and end - place < _BATCH:
        try:
            found, after = _find_record_end(window, end)
        except LogError:
            break
        if found != opcode:
            break
        end = after
    return window.read(place, end - place)


def _read_attachment(window: FileWindow, place: int) -> tuple[list[Section | Loss], int]:
    fault = None
    last = _measure_record(window, place, Opcode.ATTACHMENT, window.size)
    try:
        _, end = _find_record_end(window, place)
    except LogError as err:
        if last > window.size or not window.spend(last - place):
            raise
        fault, end = err, last
    data = window.read(place, last - place)
    checksum, found = int.from_bytes(data[-4:], "little"), zlib.crc32(data[RECORD.size : -4])
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


def _read_chunk(window: FileWindow, place: int) -> tuple[list[Section | Loss], int]:
    front = RECORD.size + CHUNK_HEAD.size
    head = window.read(place, front)
    if len(head) < front:
        raise LogError("expected a chunk, found the end of the file within its header")
    _, length = RECORD.unpack_from(head)
    _, _, size, checksum, name_size = CHUNK_HEAD.unpack_from(head, RECORD.size)
    if name_size > limits.LONGEST_COMPRESSION:
        raise LogError(f"expected a chunk, found a compression of {name_size} letters")
    rest = window.read(place + front, name_size + 8)
    compression = rest[:-8].decode("utf-8", "replace")
    start = place + front + name_size + 8
    by_record = place + RECORD.size + length
    by_data = start + int.from_bytes(rest[-8:], "little")
    agree = by_data == by_record or (
        by_data < by_record <= window.size and _is_padding(window, by_data, by_record, Opcode.CHUNK)
    )
    ends = [
        end
        for end in dict.fromkeys((by_data, by_record))
        if start <= end <= min(window.size, start + limits.LARGEST_CHUNK)
    ]
    after = [end for end in ends if agree or _is_record_start(window, end, after=Opcode.CHUNK)]
    reason = f"the file ends {window.size - start} bytes into a chunk of {length}"
    for end in filter(lambda end: end in after or (checksum and window.spend(end - start)), ends):
        try:
            packed = window.read(start, end - start)
            data = limits.unpack_within(window.allowance, compression, packed, size)
            limits.check_chunk(data, size, checksum, agree=agree and end == by_data)
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


def _find_record_end(window: FileWindow, place: int) -> tuple[int, int]:
    """Return opcode and end of the complete, consistent record at `place`.

    Bytes after its fields belong to the record if `_is_padding` returns True.

    Raises:
        LogError: If the lengths disagree, or the file ends within the record; one clause.
    """
    opcode, length = _read_head(window, place)
    end = place + RECORD.size + length
    if end > window.size:
        raise LogError(f"the file ends within a record of {length} bytes, and the rest is missing")
    found = _measure_record(window, place, opcode, end)
    if found > end or (found < end and not _is_padding(window, found, end, opcode)):
        found -= place + RECORD.size
        raise LogError(f"expected a record (opcode {opcode}) of {length} bytes, found {found}")
    # If the fields do not confirm the length of a record, the next record must.
    is_borne_out = opcode in _SHAPES or opcode in {Opcode.DATA_END, Opcode.FOOTER}
    if not is_borne_out and not _is_record_start(window, end, after=opcode):
        raise LogError(f"no record follows the one of {length} bytes")
    return opcode, end


def _is_record_start(window: FileWindow, place: int, *, after: int = 0) -> bool:
    """Return whether a record can start here; the end of the file may truncate it."""
    if window.size - place < RECORD.size:
        head = window.read(place, 1)
        return not head or head[0] >= _PRIVATE or head[0] in _KNOWN
    try:
        opcode, _ = _read_head(window, place)
    except LogError:
        return False
    return opcode != Opcode.MESSAGE_INDEX or after in _BEFORE_INDEX


def _measure_record(window: FileWindow, place: int, opcode: int, end: int) -> int:
    """Return the end of a record by the lengths of its fields; `end` is that by its own length."""
    shape = _SHAPES.get(opcode)
    if shape is None:
        return end
    fixed, fields = shape
    at = place + RECORD.size + fixed
    for _ in range(fields):
        if at + 4 > end:
            return at + 4
        at += 4 + int.from_bytes(window.read(at, 4), "little")
    if opcode not in _DATA:
        return at
    if at + 8 > end:
        return at + 8
    return at + 8 + int.from_bytes(window.read(at, 8), "little") + _DATA[opcode]


def _is_padding(window: FileWindow, start: int, end: int, opcode: int) -> bool:
    """Return whether the bytes from `start` to `end` belong to the record before them.

    Its known fields end at `start`, and by its length it ends at `end`: a later version may append
    fields. A valid record at `end` confirms the length; valid records from `start` on refute it.
    """
    return _is_followed(window, end, opcode) and not _is_chain(window, start, opcode)


def _is_followed(window: FileWindow, place: int, after: int) -> bool:
    """Return whether a record, perhaps cut, follows whose fields or next record fit its length."""
    if not _is_record_start(window, place, after=after):
        return False
    if window.size - place < RECORD.size:
        return True
    opcode, length = _read_head(window, place)
    end = place + RECORD.size + length
    if end > window.size:
        return True
    if opcode in _SHAPES:
        return _measure_record(window, place, opcode, end) <= end
    return _is_record_start(window, end, after=opcode)


def _is_chain(window: FileWindow, place: int, after: int) -> bool:
    """Return whether complete records of known kinds follow one another up to the footer."""
    for _ in range(_CHAIN):
        if window.size - place < RECORD.size or not _is_record_start(window, place, after=after):
            return False
        opcode, length = _read_head(window, place)
        end = place + RECORD.size + length
        if opcode >= _PRIVATE or end > window.size:
            return False
        if _measure_record(window, place, opcode, end) > end:
            return False
        if opcode == Opcode.FOOTER:
            return True
        place, after = end, opcode
    return True


def _read_head(window: FileWindow, place: int) -> tuple[int, int]:
    head = window.read(place, RECORD.size)
    if len(head) < RECORD.size:
        raise LogError("expected a record, found the end of the file within its first 9 bytes")
    opcode, length = RECORD.unpack(head)
    if opcode < _PRIVATE and opcode not in _KNOWN:
        raise LogError(f"expected a record, found the opcode {opcode:#04x}")
    least, most = _LENGTHS.get(opcode, (0, records.LARGEST_RECORD))
    if not least <= length <= most:
        raise LogError(f"expected a record (opcode {opcode}), found one of {length} bytes")
    return opcode, length


def _find_next_record(window: FileWindow, place: int, *, is_lone: bool) -> int | None:
    """Return the offset of the next record that can be confirmed, if any.

    Schemas, channels and messages outside chunks are searched only in files with such messages:
    they would look valid within a damaged uncompressed chunk.
    """
    is_wanted = np.zeros(256, dtype=bool)
    is_wanted[[*_BOUND, Opcode.DATA_END, *(_RUNS if is_lone else ())]] = True
    for candidate in _iterate_candidates(window, place, is_wanted):
        try:
            if _is_borne_out(window, candidate):
                return candidate
        except LogError:
            continue
    return None


def _iterate_candidates(
    window: FileWindow, place: int, is_wanted: NDArray[np.bool_]
) -> Iterator[int]:
    """Yield the offsets at which an opcode and a length below 2^40 are possible."""
    start, after, step = place, place, _FIRST_STEP
    while after < window.size:
        start, after, step = after, after + step, min(2 * step, _STEP)
        block = np.frombuffer(window.read(start, after - start + RECORD.size - 1), dtype=np.uint8)
        count = len(block) - RECORD.size + 1
        if count <= 0:
            return
        high = [block[at : at + count] == 0 for at in (6, 7, 8)]
        found = is_wanted[block[:count]] & high[0] & high[1] & high[2]
        yield from (start + at for at in np.flatnonzero(found).tolist())


def _is_borne_out(window: FileWindow, place: int) -> bool:
    opcode = window.read(place, 1)[0]
    if opcode == Opcode.FOOTER:
        return place + _FOOTER_SIZE + len(MCAP0_MAGIC) == window.size
    _, end = _find_record_end(window, place)
    if opcode == Opcode.CHUNK:  # the reader of chunks checks the content
        return _is_record_start(window, end, after=opcode)
    if opcode == Opcode.DATA_END:
        follows = window.read(end, 1)
        return bool(follows) and follows[0] in _AFTER_DATA
    if opcode == Opcode.MESSAGE_INDEX:
        pairs = _measure_record(window, place, opcode, end) - place - RECORD.size - _INDEX_HEAD
        return pairs % _PAIR == 0
    if opcode == Opcode.ATTACHMENT:
        return True
    for _ in range(_CHAIN - 1):
        if end == window.size:
            break
        _, end = _find_record_end(window, end)
    return True
