"""The bytes of MCAP records -> values; the rare kinds through the mcap library."""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import Any, BinaryIO, Final, TypeVar

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

from turtlelog.errors import LogError, describe_error
from turtlelog.log.engine.framing import RECORD
from turtlelog.log.engine.integrity import DamageError

Rare = TypeVar("Rare")

_MOST_ENTRIES: Final = 4096  # of a channel's table; writers use up to five

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


@dataclass(frozen=True, slots=True)
class Place:
    """A record in a buffer or file: its opcode, where its body starts, and its length [bytes]."""

    opcode: int
    start: int
    length: int

    @property
    def end(self) -> int:
        """The byte behind it."""
        return self.start + self.length


class _ExactBytes(BytesIO):
    """Bytes of which more than there are cannot be read: the library would take fewer."""

    def read(self, size: int | None = -1, /) -> bytes:
        data = super().read(size)
        if size is not None and len(data) < size:
            raise EOFError(f"{size} bytes expected, found {len(data)}")
        return data


def iterate_places(data: bytes, start: int, end: int, byte: int) -> Iterator[Place]:
    """Yield the records between two places of a buffer.

    Args:
        data: The buffer.
        start: Where the first one starts.
        end: Where the last one must end.
        byte: Of the file, for the error: where the stretch of records starts, or its chunk.

    Raises:
        DamageError: Where one goes over the end.
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


def parse_record(place: Place, body: bytes, byte: int) -> Any:
    """Return a record of a rare kind from its bytes, checksums checked; None for another kind.

    Raises:
        DamageError: Where they are no such record; `byte` is where it stands in the file.
    """
    kind = _RARE.get(place.opcode)
    if kind is None:
        return None
    try:
        record, size = parse_body(kind, body)
    except LogError as err:
        raise DamageError(f"byte {byte}: {err}") from err
    if kind is Attachment:
        # Some writers leave bytes behind the checksum, so it is not just the last four.
        _check_attachment(body[:size], byte)
    return record


def parse_body(kind: type[Rare], body: bytes) -> tuple[Rare, int]:
    """Return a record and how many bytes it takes; bytes that a later version appended follow.

    Raises:
        LogError: One clause, where there are fewer than it claims.
    """
    stream = ReadDataStream(_ExactBytes(body))
    try:
        if kind in _FREQUENT:
            parsed: tuple[Rare, int] = _FREQUENT[kind](body)
            return parsed
        record: Rare = kind.read(stream)  # type: ignore[attr-defined]
    except Exception as err:  # the library raises nearly everything
        found = describe_error(err)
        raise LogError(f"expected a sound {kind.__name__} record, found {found}") from err
    return record, stream.count


def _read_schema(body: bytes) -> tuple[Schema, int]:
    name, place = _take_field(body, 2)
    encoding, place = _take_field(body, place)
    data, place = _take_field(body, place)
    number = int.from_bytes(body[:2], "little")
    return Schema(id=number, name=name.decode(), encoding=encoding.decode(), data=data), place


def _read_channel(body: bytes) -> tuple[Channel, int]:
    topic, place = _take_field(body, 4)
    encoding, place = _take_field(body, place)
    table, end = _take_field(body, place)
    entries: dict[str, str] = {}
    place = 0
    while place < len(table):
        if len(entries) == _MOST_ENTRIES:
            raise ValueError(f"more than {_MOST_ENTRIES} entries")
        key, place = _take_field(table, place)
        value, place = _take_field(table, place)
        entries[key.decode()] = value.decode()
    channel = Channel(
        id=int.from_bytes(body[:2], "little"),
        topic=topic.decode(),
        message_encoding=encoding.decode(),
        metadata=entries,
        schema_id=int.from_bytes(body[2:4], "little"),
    )
    return channel, end


def _take_field(body: bytes, place: int) -> tuple[bytes, int]:
    """Return the bytes that stand behind their length, and the place behind them."""
    start = place + 4
    end = start + int.from_bytes(body[place:start], "little")
    if len(body) < end or len(body) < start:
        raise EOFError(f"{end} bytes expected, found {len(body)}")
    return body[start:end], end


# A file may repeat some ten thousand of these in every chunk: the library takes thrice as long.
_FREQUENT: Final[dict[Any, Any]] = {Schema: _read_schema, Channel: _read_channel}


def read_record(stream: BinaryIO, place: Place) -> Any:
    """Return a record of a rare kind that stands alone in a file."""
    stream.seek(place.start)
    return parse_record(place, stream.read(place.length), place.start - RECORD.size)


def _check_attachment(body: bytes, byte: int) -> None:
    expected = int.from_bytes(body[-4:], "little")
    if expected and expected != (found := zlib.crc32(body[:-4])):
        raise DamageError(
            f"byte {byte}: expected an attachment of checksum {expected:#010x}, found {found:#010x}"
        )
