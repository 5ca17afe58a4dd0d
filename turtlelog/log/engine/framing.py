"""Confirmation of MCAP records by their lengths, and of the next record after damage."""

import struct
from collections.abc import Iterator, Mapping
from typing import BinaryIO, Final

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.limits import LARGEST_CHUNK, Allowance, measure_stored
from turtlelog.log.engine.records import COUNTED_HEAD, MCAP0_MAGIC, RECORD, MessageWalk

CHUNK_HEAD: Final = struct.Struct("<QQQII")
"""Start and end time, unpacked size, checksum, and length of the compression's name."""

SUMMARY_ONLY: Final = frozenset(
    {
        Opcode.CHUNK_INDEX,
        Opcode.ATTACHMENT_INDEX,
        Opcode.STATISTICS,
        Opcode.METADATA_INDEX,
        Opcode.SUMMARY_OFFSET,
    }
)
"""Kinds of records that occur only after the data section."""

_AFTER_DATA: Final = SUMMARY_ONLY | {Opcode.FOOTER, Opcode.SCHEMA, Opcode.CHANNEL}

_CHAIN: Final = 4
"""Number of consecutive records that are accepted without a checksum.

The worst case is messages half of zeros: a megabyte contains a thousand places that look like a
record's head. One in a hundred of these is followed by another such place. By chance, three in a
row occur once in a gigabyte, four in a row once in 100 GB. After damage, messages are found only if
this number of them are consecutive.
"""

_LARGEST_RECORD: Final = LARGEST_CHUNK + 2**10
"""Largest length of a record's body that is accepted [bytes]."""

_PRIVATE: Final = 0x80  # first opcode for private use
_KNOWN: Final = frozenset(int(opcode) for opcode in Opcode)
_BEFORE_INDEX: Final = frozenset({0, Opcode.CHUNK, Opcode.MESSAGE_INDEX})
_WINDOW: Final = 2**22  # bytes read at once
_HELD: Final = 2**24  # bytes of a file that are cached, in whatever order records refer to them

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
_LEAST: Final[Mapping[int, int]] = {Opcode.MESSAGE: COUNTED_HEAD, Opcode.CHUNK: 40}
_EXACT: Final[Mapping[int, int]] = {Opcode.DATA_END: 4, Opcode.FOOTER: 20}

_FIRST_STEP: Final = 2**12  # bytes searched at a time while the next record may be near
_STEP: Final = 2**19
_FOOTER_SIZE: Final = 29
_INDEX_HEAD: Final = 6  # bytes of a message index before its pairs: channel, length of the pairs
_PAIR: Final = 16  # bytes: log time, offset

RUNS: Final = frozenset({Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA})
"""Kinds of records that stand one after the other outside chunks."""


_BOUND: Final = (Opcode.FOOTER, Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT)


class FileWindow:
    """A file with random access; small reads use a cached window, or the whole file.

    Attributes:
        size: Size of the file [bytes].
        allowance: Limits for unpacking the file's chunks.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._start, self._data = 0, b""
        self.size = stream.seek(0, 2)
        self._spare = self.size
        self.allowance = Allowance(measure_stored(stream))
        self._is_held = self.size <= _HELD
        if self._is_held:
            stream.seek(0)
            self._data = stream.read(self.size)

    def read(self, start: int, count: int) -> bytes:
        """Return `count` bytes from `start`, fewer at the end of the file."""
        at = start - self._start
        if self._is_held or (at >= 0 and at + count <= len(self._data)):
            return self._data[at : at + count]
        self._stream.seek(start)
        if count > _WINDOW:
            return self._stream.read(count)
        self._start, self._data = start, self._stream.read(_WINDOW)
        return self._data[:count]

    def spend(self, count: int) -> bool:
        """Return whether bytes may be read to try a checksum, although no length agrees.

        The total is limited to the file's size, because otherwise overlapping records could be read
        many times.
        """
        self._spare -= count
        return self._spare >= 0


def find_record_end(window: FileWindow, place: int) -> tuple[int, int]:
    """Return opcode and end of the complete, consistent record at `place`.

    Bytes after its fields belong to the record if `is_padding` returns True.

    Raises:
        LogError: If the lengths disagree, or the file ends within the record; the message is one
            clause.
    """
    opcode, length = _read_head(window, place)
    end = place + RECORD.size + length
    if end > window.size:
        raise LogError(f"the file ends within a record of {length} bytes, and the rest is missing")
    found = measure_record(window, place, opcode, end)
    if found > end or (found < end and not is_padding(window, found, end, opcode)):
        found -= place + RECORD.size
        raise LogError(f"expected a record (opcode {opcode}) of {length} bytes, found {found}")
    # If the fields do not confirm the length of a record, the next record must.
    is_borne_out = opcode in _SHAPES or opcode in _EXACT
    if not is_borne_out and not is_record_start(window, end, after=opcode):
        raise LogError(f"no record follows the one of {length} bytes")
    return opcode, end


def is_record_start(window: FileWindow, place: int, *, after: int = 0) -> bool:
    """Return whether a record can start here; the end of the file may truncate it.

    A message index can follow only a chunk or another index.
    """
    if window.size - place < RECORD.size:
        head = window.read(place, 1)
        return not head or head[0] >= _PRIVATE or head[0] in _KNOWN
    try:
        opcode, _ = _read_head(window, place)
    except LogError:
        return False
    return opcode != Opcode.MESSAGE_INDEX or after in _BEFORE_INDEX


def measure_record(window: FileWindow, place: int, opcode: int, end: int) -> int:
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


def is_padding(window: FileWindow, start: int, end: int, opcode: int) -> bool:
    """Return whether the bytes from `start` to `end` belong to the record before them.

    The known fields of the record end at `start`; the record ends at `end`, according to its
    length. A later version may append fields, which readers ignore. The length is accepted if a
    valid record begins at `end`. If valid records begin at `start`, the length is damaged.
    """
    return _is_followed(window, end, opcode) and not _is_chain(window, start, opcode)


def _is_followed(window: FileWindow, place: int, after: int) -> bool:
    """Return whether a record follows whose fields, or whose next record, confirm its length.

    For a record truncated by the end of the file, a valid header is enough.
    """
    if not is_record_start(window, place, after=after):
        return False
    if window.size - place < RECORD.size:
        return True
    opcode, length = _read_head(window, place)
    end = place + RECORD.size + length
    if end > window.size:
        return True
    if opcode in _SHAPES:
        return measure_record(window, place, opcode, end) <= end
    return is_record_start(window, end, after=opcode)


def _is_chain(window: FileWindow, place: int, after: int) -> bool:
    """Return whether complete records of known kinds follow one another up to the footer."""
    for _ in range(_CHAIN):
        if window.size - place < RECORD.size or not is_record_start(window, place, after=after):
            return False
        opcode, length = _read_head(window, place)
        end = place + RECORD.size + length
        if opcode >= _PRIVATE or end > window.size:
            return False
        if measure_record(window, place, opcode, end) > end:
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
    exact = _EXACT.get(opcode)
    least, most = (_LEAST.get(opcode, 0), _LARGEST_RECORD) if exact is None else (exact, exact)
    if not least <= length <= most:
        raise LogError(f"expected a record (opcode {opcode}), found one of {length} bytes")
    return opcode, length


def find_next_record(window: FileWindow, place: int, *, is_lone: bool) -> int | None:
    """Return the offset of the next record that can be confirmed, if any.

    Schemas, channels and messages outside chunks are searched only in files with such messages:
    within a damaged uncompressed chunk such records would look valid without any confirmation.
    """
    is_wanted = np.zeros(256, dtype=bool)
    is_wanted[[*_BOUND, Opcode.DATA_END, *(RUNS if is_lone else ())]] = True
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
    _, end = find_record_end(window, place)
    if opcode == Opcode.CHUNK:  # the reader of chunks checks the content
        return is_record_start(window, end, after=opcode)
    if opcode == Opcode.DATA_END:
        follows = window.read(end, 1)
        return bool(follows) and follows[0] in _AFTER_DATA
    if opcode == Opcode.MESSAGE_INDEX:
        pairs = measure_record(window, place, opcode, end) - place - RECORD.size - _INDEX_HEAD
        return pairs % _PAIR == 0
    if opcode == Opcode.ATTACHMENT:
        return True
    for _ in range(_CHAIN - 1):
        if end == window.size:
            break
        _, end = find_record_end(window, end)
    return True


def skip_followed(data: bytes) -> int:
    """Return the start of the last message in the unbroken series from the first byte on.

    The last message may be truncated. The result is 0 without any message.
    """
    place, last, walk = 0, 0, MessageWalk(data)
    end, unpack, message = len(data) - RECORD.size, RECORD.unpack_from, int(Opcode.MESSAGE)
    while place <= end:
        opcode, length = unpack(data, place)
        if opcode != message or not COUNTED_HEAD <= length <= _LARGEST_RECORD:
            break
        last = place
        place += RECORD.size + length
        walk.add(RECORD.size + length)
        if walk.is_due:
            starts, place = walk.go_on(place, end)
            if len(starts):
                last = int(starts[-1])
    return last
