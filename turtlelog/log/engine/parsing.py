"""Parse MCAP records: return the offsets of messages, and the contents of other records."""

import struct
import zlib
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from typing import Any, BinaryIO, Final, NamedTuple, TypeVar

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from numpy.typing import NDArray

from turtlelog.errors import LogError, describe_error
from turtlelog.log.engine.framing import RECORD, MessageWalk
from turtlelog.log.engine.limits import LONGEST_DESCRIBED, MOST_DESCRIBED
from turtlelog.log.file_access import DamageError

Rare = TypeVar("Rare")

_LONGEST_KEPT: Final = 2**13  # bytes of a schema or channel that is kept for the next file
_MOST_KEPT: Final = 256  # schemas, and channels; with their parsed types they stay below 8 MB

_ID: Final = struct.Struct("<H")
_IDS: Final = struct.Struct("<HH")  # id of a channel, and of its schema
_LENGTH: Final = struct.Struct("<I")

_MOST_ENTRIES: Final = 4096  # entries of a channel's table; writers use up to five

_RARE: Final[dict[int, Any]] = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata,
    Opcode.STATISTICS: Statistics,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
}

HEADING_FIELDS: Final = (
    *(("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4")),
    *(("log_time", "<u8"), ("publish_time", "<u8")),
)
HEADING: Final = np.dtype([*HEADING_FIELDS])
"""The fields at the front of a message record."""

MESSAGE_HEAD: Final = HEADING.itemsize
"""Bytes of a message record before its data."""

COUNTED_HEAD: Final = MESSAGE_HEAD - RECORD.size
"""Bytes before the data that the record's length includes."""

_MESSAGE: Final = int(Opcode.MESSAGE)
_KNOWN: Final = frozenset(
    {Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA, Opcode.ATTACHMENT}
)
OF_CHUNKS: Final = frozenset({Opcode.SCHEMA, Opcode.CHANNEL})
"""Kinds of records in a chunk, in addition to messages; all other kinds are skipped."""

_ROWS: Final = 2**16  # messages processed together
_BYTES: Final = 2**24  # bytes from the first to the last of these messages

Places = NDArray[np.int64]


class Place(NamedTuple):
    """A record in a buffer or file: its opcode, the start of its body, and its length [bytes].

    This is a named tuple, because a file may have some hundred thousand records: a frozen dataclass
    takes three times as long.
    """

    opcode: int
    start: int
    length: int

    @property
    def end(self) -> int:
        """The offset of the next byte."""
        return self.start + self.length


class _ExactStream(ReadDataStream):
    """A stream that raises an error if too few bytes remain, unlike the library's stream."""

    def __init__(self, body: bytes) -> None:
        super().__init__(BytesIO())
        self._body = body

    def read(self, length: int) -> bytes:
        start, end = self._count, self._count + length
        if end > len(self._body):
            raise EOFError(f"{length} bytes expected, found {len(self._body) - start}")
        self._count = end
        return self._body[start:end]


def iterate_places(data: bytes | memoryview, start: int, end: int, byte: int) -> Iterator[Place]:
    """Yield the records between two places of a buffer, `byte` bytes into the file.

    Raises:
        DamageError: If a record extends beyond `end`.
    """
    while start < end:
        if start + RECORD.size > end:
            raise DamageError(f"byte {byte}: expected a record, found {end - start} bytes more")
        opcode, length = RECORD.unpack_from(data, start)
        place = Place(opcode, start + RECORD.size, length)
        if not opcode or place.end > end:
            left = end - place.start
            raise DamageError(
                f"byte {byte}: expected a record of up to {left} bytes,"
                f" found opcode {opcode} with {length} at {start}"
            )
        yield place
        start = place.end


def take_whole(data: bytes, place: Place) -> bytes:
    """Return the bytes of a record, including opcode and length."""
    return data[place.start - RECORD.size : place.end]


def parse_record(place: Place, body: bytes, byte: int) -> Any:
    """Return a record of a rare kind from its bytes after checksum checks; None for other kinds."""
    kind = _RARE.get(place.opcode)
    if kind is None:
        return None
    try:
        record, size = parse_body(kind, body)
    except LogError as err:
        raise DamageError(f"byte {byte}: {err}") from err
    if kind is Attachment:
        # Some writers leave bytes after the checksum, so it is not always the last four bytes.
        _check_attachment(body[:size], byte)
    return record


def parse_body(kind: type[Rare], body: bytes) -> tuple[Rare, int]:
    """Return a record and its size [bytes]. Bytes that a later version appended may follow.

    Raises:
        LogError: If there are fewer bytes than the record claims; the message is one clause.
    """
    try:
        if kind in _FREQUENT:
            parsed: tuple[Rare, int] = _FREQUENT[kind](body)
            return parsed
        stream = _ExactStream(body)
        record: Rare = kind.read(stream)  # type: ignore[attr-defined]
    except Exception as err:  # the library raises many kinds of errors
        found = describe_error(err)
        raise LogError(f"expected a sound {kind.__name__} record, found {found}") from err
    return record, stream.count


def _recall(read: Callable[[bytes], tuple[Rare, int]]) -> Callable[[bytes], tuple[Rare, int]]:
    """Return a reader with a cache of short records for the process, because files repeat them."""
    keep = lru_cache(maxsize=_MOST_KEPT)(read)
    return lambda body: keep(body) if len(body) <= _LONGEST_KEPT else read(body)


def _read_schema(body: bytes) -> tuple[Schema, int]:
    name, place = _take_field(body, 2)
    encoding, place = _take_field(body, place)
    data, place = _take_field(body, place)
    (number,) = _ID.unpack_from(body)
    return Schema(id=number, name=name.decode(), encoding=encoding.decode(), data=data), place


def _read_channel(body: bytes) -> tuple[Channel, int]:
    topic, place = _take_field(body, 4)
    encoding, place = _take_field(body, place)
    table, end = _take_field(body, place)
    entries = _read_entries(table, _MOST_ENTRIES)
    number, schema = _IDS.unpack_from(body)
    channel = Channel(
        id=number,
        topic=topic.decode(),
        message_encoding=encoding.decode(),
        metadata=entries,
        schema_id=schema,
    )
    return channel, end


def _read_metadata(body: bytes) -> tuple[Metadata, int]:
    name, place = _take_field(body, 0)
    table, end = _take_field(body, place)
    return Metadata(name=name.decode(), metadata=_read_entries(table, len(table))), end


def _read_entries(table: bytes, most: int) -> dict[str, str]:
    entries: dict[str, str] = {}
    place = 0
    while place < len(table):
        if len(entries) == most:
            raise ValueError(f"more than {most} entries")
        key, place = _take_field(table, place)
        value, place = _take_field(table, place)
        entries[key.decode()] = value.decode()
    return entries


def _take_field(body: bytes, place: int) -> tuple[bytes, int]:
    """Return length-prefixed bytes, and the offset after them."""
    start = end = place + 4
    if end <= len(body):
        end += _LENGTH.unpack_from(body, place)[0]
    if end > len(body):
        raise EOFError(f"{end} bytes expected, found {len(body)}")
    return body[start:end], end


# A file may repeat ten thousand of these in every chunk: the library takes three times as long.
_FREQUENT: Final[dict[Any, Any]] = {
    Schema: _recall(_read_schema),
    Channel: _recall(_read_channel),
    Metadata: _read_metadata,
}


def read_record(stream: BinaryIO, place: Place) -> Any:
    """Return a record of a rare kind outside chunks."""
    stream.seek(place.start)
    return parse_record(place, stream.read(place.length), place.start - RECORD.size)


def _check_attachment(body: bytes, byte: int) -> None:
    expected = int.from_bytes(body[-4:], "little")
    if expected and expected != (found := zlib.crc32(body[:-4])):
        raise DamageError(
            f"byte {byte}: expected an attachment of checksum {expected:#010x}, found {found:#010x}"
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordStretch:
    """Consecutive records, parsed up to the first invalid record.

    Attributes:
        data: Bytes of the records.
        starts: Start of each message record, shape (n,), increasing, 4 bytes each.
        others: Other records with content, in order: place, opcode, end.
        fault: Error of the first invalid length, as one clause; all records before it are included.
        records: Number of records of any kind.
    """

    data: bytes
    starts: NDArray[np.uint32]
    others: tuple[tuple[int, int, int], ...]
    fault: str | None
    records: int

    def iterate_rows(self, rows: slice = slice(None)) -> Iterator[tuple[Places, NDArray[Any]]]:
        """Yield the starts of messages, some thousand at a time, with their `HEADING` fields."""
        chosen, first = self.starts[rows], 0
        while first < len(chosen):
            starts = chosen[first : first + _ROWS].astype(np.int64)
            starts = starts[: np.searchsorted(starts, starts[0] + _BYTES)]
            first += len(starts)
            yield starts, gather_heads(self.data, starts)


def take_apart(data: bytes, *, is_chunk: bool, most_records: int) -> RecordStretch:
    """Return the offsets of the messages in the bytes of records. No checksum is needed.

    A chunk has only messages, schemas and channels. Records beyond `most_records` are ignored.
    """
    starts, others = array("I"), list[tuple[int, int, int]]()
    known, size, place, left = OF_CHUNKS if is_chunk else _KNOWN, len(data), 0, most_records
    fault, walk = None, MessageWalk(data)
    unpack, last = RECORD.unpack_from, size - RECORD.size
    while place < size and left:
        if walk.is_due:
            found, place = walk.go_on(place, left)
            starts.frombytes(found.tobytes())
            left -= len(found)
            continue
        opcode, length = unpack(data, place) if place <= last else (0, 0)
        end = place + 9 + length
        if opcode == _MESSAGE and end <= size and length >= COUNTED_HEAD:
            starts.append(place)
            walk.add(9 + length)
        elif not opcode or opcode == _MESSAGE or end > size:
            fault = _describe_fault(opcode, size - place, length)
            break
        elif opcode in known:
            fault = _check_others(len(others), opcode, length) if is_chunk else None
            if fault is not None:
                break
            others.append((place, opcode, end))
        place, left = end, left - 1
    if place < size and fault is None:
        fault = f"expected up to {most_records} records more, found {size - place} bytes of others"
    return RecordStretch(
        data=data,
        starts=np.frombuffer(starts, np.uint32) if starts else np.empty(0, np.uint32),
        others=tuple(others),
        fault=fault,
        records=most_records - left,
    )


def _check_others(count: int, opcode: int, length: int) -> str | None:
    """Return why a chunk may not contain one more schema or channel; None if it may."""
    if count == MOST_DESCRIBED:
        return f"expected up to {MOST_DESCRIBED} schemas and channels, found more"
    if length <= LONGEST_DESCRIBED:
        return None
    return f"expected a record (opcode {opcode}) of up to {LONGEST_DESCRIBED} bytes, found {length}"


def _describe_fault(opcode: int, left: int, length: int) -> str:
    if left < RECORD.size:
        return f"expected a record, found {left} bytes"
    most = left - RECORD.size
    return f"expected a record of up to {most} bytes, found opcode {opcode} with {length}"


def gather_bytes(data: bytes | bytearray, starts: NDArray[np.int64], size: int) -> NDArray[Any]:
    """Return `size` bytes from each place in `data`, as an array of V-size rows.

    In a strided view, a row starts at every byte. Indexing this view with the places takes a sixth
    of the time of copying field by field.
    """
    if not len(starts):
        return np.empty(0, f"V{size}")
    if starts.min() < 0 or starts.max() > len(data) - size:
        raise LogError(f"expected {size} bytes from each place, found {len(data)} in all")
    view = np.ndarray((len(data) - size + 1,), f"V{size}", buffer=data, strides=(1,))
    return view[starts]


def gather_heads(data: bytes, starts: NDArray[np.int64]) -> NDArray[Any]:
    """Return the `HEADING` fields of the messages that start at given places."""
    return gather_bytes(data, starts, MESSAGE_HEAD).view(HEADING)
