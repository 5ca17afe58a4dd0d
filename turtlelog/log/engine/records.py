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
from turtlelog.log.engine.limits import LARGEST_CHUNK, LONGEST_DESCRIBED, MOST_DESCRIBED
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


RECORD: Final = struct.Struct("<BQ")
"""Opcode, and length of the body [bytes]."""


HEADING_FIELDS: Final = (
    *(("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4")),
    *(("log_time", "<u8"), ("publish_time", "<u8")),
)
HEADING: Final = np.dtype([*HEADING_FIELDS])
"""The fields at the front of a message record."""

MESSAGE_HEAD: Final = HEADING.itemsize
"""Bytes of a message record before its data."""


FRONT: Final = struct.Struct("<BQHIQQ4s")
"""Front of a record: opcode, length, channel, sequence, log and publish time, encapsulation."""

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


LARGEST_RECORD: Final = LARGEST_CHUNK + 2**10
"""Largest length of a record's body that is accepted [bytes]."""


class Place(NamedTuple):
    """A record in a buffer or file: its opcode, the start of its body, and its length [bytes].

    A file may have some hundred thousand: frozen dataclasses take three times as long.
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
    """Yield the records between two places of a buffer, `byte` bytes into the file."""
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
        expected, found = (
            int.from_bytes(body[size - 4 : size], "little"),
            zlib.crc32(body[: size - 4]),
        )
        if expected not in {0, found}:
            raise DamageError(
                f"byte {byte}: expected an attachment of checksum {expected:#010x}, found"
                f" {found:#010x}"
            )
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


_HEAD: Final = np.dtype([("opcode", "u1"), ("length", "<u8")])

_LONGEST_TURN: Final = 64  # messages; robots have some 20 topics with different rates
_FIRST: Final = 16  # steps before a period is searched; a chunk has some thousand messages
_RAREST: Final = 2**12  # steps between failed searches: a search takes the time of 100 steps
_WORTH: Final = 128  # messages to predict: a search that predicts fewer costs more than it saves
_MOST: Final = 2**14  # messages predicted at a time


class MessageWalk:
    """Predicts where messages start, from the lengths of earlier messages.

    Attributes:
        is_due: Whether a prediction should be tried now.
    """

    def __init__(self, data: bytes) -> None:
        self.is_due = False
        self._size = len(data)
        count = max(self._size - RECORD.size + 1, 0)
        self._heads = np.ndarray((count,), f"V{RECORD.size}", buffer=data, strides=(1,))
        self._steps: list[int] = []
        self._wait, self._turn, self._reach = _FIRST, 0, 2 * _WORTH

    def add(self, step: int) -> None:
        """Add the distance from one message to the next [bytes]."""
        self._steps.append(step)
        self.is_due = len(self._steps) >= self._wait

    def go_on(self, place: int, most: int) -> tuple[NDArray[np.uint32], int]:
        """Return the starts of complete messages from `place` on, and the next place."""
        length = self._turn or _find_turn(self._steps)
        turn = np.array(self._steps[len(self._steps) - length :], np.int64)
        found = [np.array([place], np.int64)]
        count = 0
        while len(turn) and count < most:
            reach = min(self._reach - self._reach % len(turn), most - count)  # whole periods
            places = self._foretell(int(found[-1][-1]), turn, reach)
            found.append(places[1:])
            count += len(places) - 1
            if len(places) <= reach:
                break
            self._reach = min(2 * self._reach, _MOST)
        self._plan(count, len(turn))
        places = np.concatenate(found)
        return places[:-1].astype(np.uint32), int(places[-1])

    def _foretell(self, place: int, turn: NDArray[np.int64], most: int) -> NDArray[np.int64]:
        ends = np.cumsum(turn)
        firsts = place + ends[-1] * np.arange(-(-most // len(turn)))
        places = np.empty(most + 1, np.int64)
        places[0], places[1:] = place, (firsts[:, None] + ends).ravel()[:most]
        places = places[: places.searchsorted(self._size, side="right")]
        heads = self._heads[places[:-1]].view(_HEAD)
        lengths = np.diff(places) - RECORD.size
        fits = (heads["length"] == lengths.view(np.uint64)) & (heads["opcode"] == _MESSAGE)
        return places if fits.all() else places[: int(fits.argmin()) + 1]

    def _plan(self, count: int, turn: int) -> None:
        """Set the time of the next try."""
        if count >= _WORTH:
            # The step that was not predicted comes before those of the next period.
            self._turn, self._wait = turn, turn + 1
            self._reach = min(max(count + 2 * turn, 2 * _WORTH), _MOST)
        else:
            self._turn, self._wait = 0, min(2 * max(self._wait, _FIRST), _RAREST)
        self._steps.clear()
        self.is_due = False


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
    """Return the offsets of the messages in the bytes of records; no checksum is needed."""
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

    A row of a strided view starts at every byte: indexing it takes a sixth of copying by field.
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


def _find_turn(steps: list[int]) -> int:
    """Return the latest period of the steps; 0 if the steps did not repeat."""
    for turn in range(1, min(len(steps) // 2, _LONGEST_TURN) + 1):
        if steps[-turn:] == steps[-2 * turn : -turn]:
            return turn
    return 0


def skip_followed(data: bytes) -> int:
    """Return the start of the last message, perhaps cut, in the series from byte 0; 0 if none."""
    place, last, walk = 0, 0, MessageWalk(data)
    end, unpack, message = len(data) - RECORD.size, RECORD.unpack_from, int(Opcode.MESSAGE)
    while place <= end:
        opcode, length = unpack(data, place)
        if opcode != message or not COUNTED_HEAD <= length <= LARGEST_RECORD:
            break
        last = place
        place += RECORD.size + length
        walk.add(RECORD.size + length)
        if walk.is_due:
            starts, place = walk.go_on(place, end)
            if len(starts):
                last = int(starts[-1])
    return last
