"""Conversion of a ROS 1 bag to an MCAP file with the same messages.

The format is described at wiki.ros.org/Bags/Format/2.0: records have a header and data, each after
its length. Messages are in chunks, plain or compressed. The bag is read once, from start to end,
within limits in proportion to its size. Messages are not changed: `engine/ros1_messages.py` reads
those of the requested topics.
"""

import bz2
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from turtlelog.errors import LogError, describe_error
from turtlelog.log.engine.chunks import unpack_chunk
from turtlelog.log.engine.limits import UNPACKED_FILE, Allowance, grow_bound
from turtlelog.log.engine.ros1_messages import name_as_ros2
from turtlelog.log.file_access import DamageError
from turtlelog.log.writing.container import McapFile
from turtlelog.log.writing.records import ChunkRows

_START: Final = b"#ROSBAG V2.0\n"
_LENGTH: Final = struct.Struct("<I")
_PLACE: Final = struct.Struct("<Q")
_TIME: Final = struct.Struct("<II")
_RECORD: Final = struct.Struct("<BQHIQQ")
"""Front of an MCAP message: opcode, length, channel, sequence, log and publish time."""

_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 4, 5, 6, 7
_CHUNK_BYTES: Final = 2**20
_STEP: Final = 2**20
_LONGEST_HEADER: Final = 2**20
"""Longest header of a record [bytes]: a few names, or a definition with all its types."""

_MESSAGES: Final = (2**18, 1 / 20)
"""Largest number of messages in any bag, plus messages per byte.

Each message takes 5 us; those of a bag of 10 MB take about 4 s. A message has 45 bytes before
compression.
"""

_BZ2_BYTES: Final = (48 * 2**20, 8.0)
"""Largest number of bytes that bz2 may unpack, plus bytes per byte of the bag.

Unpacking 30 MB takes 1 s; a bag of 10 MB takes about 4 s. Messages of robots pack to a fifth or a
tenth.
"""

_LARGEST_CHUNK: Final = (2**25, 1.0)
"""Largest size of a chunk in any bag [bytes], plus bytes per byte of the bag.

A message of this size is in memory four times. The recorder closes a chunk at 768 kB, so a larger
chunk contains one large message.
"""

_MOST_CONNECTIONS: Final = 2**16 - 1


class _EndError(Exception):
    """Error of a file that ends within a record."""


@dataclass(slots=True)
class _Copy:
    """The copy so far, including the chunk that is being filled."""

    file: McapFile
    allowance: Allowance
    largest_chunk: int
    messages_left: int
    bz2_left: int
    channels: dict[int, tuple[Schema, Channel]] = field(default_factory=dict)
    schemas: dict[tuple[str, bytes], Schema] = field(default_factory=dict)
    records: bytearray = field(default_factory=bytearray)
    index: dict[int, list[tuple[int, int]]] = field(default_factory=dict)

    def flush(self) -> None:
        """Write the chunk."""
        if not self.index:
            return
        times = [time_ns for entries in self.index.values() for time_ns, _ in entries]
        known = {channel.id: (schema, channel) for schema, channel in self.channels.values()}
        self.file.add_chunk(
            ChunkRows(
                channels=[known[number] for number in self.index],
                records=self.records,
                index={
                    number: np.array(entries, dtype=np.uint64).reshape(-1, 2)
                    for number, entries in self.index.items()
                },
                start_ns=min(times),
                end_ns=max(times),
            )
        )
        self.records, self.index = bytearray(), {}


def copy_ros1_bag(stream: BinaryIO, place: Path, stored_size: int) -> None:
    """Write the messages of a ROS 1 bag as an MCAP file.

    Args:
        stream: The bag.
        place: Path of the file to write.
        stored_size: Size of the bag before unpacking [bytes], which sets the limits.

    Raises:
        LogError: If the file is not a bag of version 2.0, is damaged, truncated or unfinished, or
            exceeds the limits for its size.
    """
    allowance = Allowance(stored_size)
    if stream.read(len(_START)) != _START:
        raise LogError("expected a bag of ROS 1 in version 2.0, found another version")
    with place.open("wb") as output:
        file = McapFile(output)
        file.begin(profile="ros1")
        copy = _Copy(
            file,
            allowance,
            largest_chunk=grow_bound(_LARGEST_CHUNK, stored_size),
            messages_left=grow_bound(_MESSAGES, stored_size),
            bz2_left=grow_bound(_BZ2_BYTES, stored_size),
        )
        if not _copy_records(stream, copy):
            raise DamageError(
                f"byte {stream.tell()}: the bag is cut or was never finished: rosbag reindex FILE"
                " keeps what it holds"
            )
        copy.flush()
        file.describe(copy.schemas.values(), (channel for _, channel in copy.channels.values()))
        file.finish()


def _copy_records(stream: BinaryIO, copy: _Copy) -> bool:
    """Copy all records, and return whether the bag was finished and is complete."""
    index_byte = 0
    while True:
        byte = stream.tell()
        try:
            if not (start := stream.read(_LENGTH.size)):
                return 0 < index_byte <= byte
            header = _read_header(_read(stream, _unpack_length(start, _LONGEST_HEADER)))
            size = _unpack_length(stream.read(_LENGTH.size), None)
            operation = _find(header, "op", 1)[0]
            if operation in {_INDEX, _CHUNK_INFO, _BAG}:
                if operation == _BAG:  # an index that was never written has offset 0
                    index_byte = _PLACE.unpack(_find(header, "index_pos", 8))[0]
                stream.seek(size, 1)
                continue
            data = _read(stream, size)
        except _EndError:
            return False
        except LogError as err:
            raise LogError(f"byte {byte}: {err}") from err
        try:
            _take(copy, operation, header, data)
        except LogError as err:
            raise LogError(f"byte {byte}: {err}") from err


def _take(copy: _Copy, operation: int, header: Mapping[str, bytes], data: bytes) -> None:
    if operation == _CHUNK:
        for inner, part in _iterate_records(_unpack(copy, header, data)):
            _take_inner(copy, _find(inner, "op", 1)[0], inner, part)
    else:
        _take_inner(copy, operation, header, data)


def _take_inner(copy: _Copy, operation: int, header: Mapping[str, bytes], data: bytes) -> None:
    if operation == _MESSAGE:
        _take_message(copy, header, data)
    elif operation == _CONNECTION:
        _take_connection(copy, header, data)


def _unpack(copy: _Copy, header: Mapping[str, bytes], data: bytes) -> bytes:
    compression = header.get("compression", b"none").decode(errors="replace")
    claimed: int = _LENGTH.unpack(_find(header, "size", 4))[0]
    largest, spend = copy.largest_chunk, partial(copy.allowance.spend, UNPACKED_FILE)
    if compression == "bz2":
        found = _unpack_bz2(data, min(largest, copy.bz2_left))
        copy.bz2_left -= len(found)
        spend(len(found))
        return found
    if compression not in {"none", "lz4"}:
        raise LogError(f"expected the compression none, bz2 or lz4, found {compression[:20]!r}")
    kind = "" if compression == "none" else compression
    found = unpack_chunk(kind, data, claimed, largest=largest, spend=spend)
    if not kind:
        spend(len(found))
    return found


def _unpack_bz2(data: bytes, most: int) -> bytes:
    found, unpacker = bytearray(), bz2.BZ2Decompressor()
    while not unpacker.eof:
        try:
            part = unpacker.decompress(data, max_length=_STEP)
        except OSError as err:
            raise LogError(f"expected sound bz2 data, found {describe_error(err)}") from err
        data = b""
        found += part
        if len(found) > most:
            raise LogError(
                f"expected up to {most} bytes in this chunk of bz2, found more, which a bag of this"
                " size may not hold: rosbag decompress FILE unpacks it"
            )
        if not part and unpacker.needs_input and not unpacker.eof:
            raise LogError("expected sound bz2 data, found the end of the chunk within it")
    return bytes(found)


def _iterate_records(data: bytes) -> Iterator[tuple[Mapping[str, bytes], bytes]]:
    """Yield header and data of the records in a chunk."""
    place = 0
    while place < len(data):
        parts = []
        for _ in range(2):
            start = place + _LENGTH.size
            end = start + _LENGTH.unpack(data[place:start])[0] if start <= len(data) else start
            if end > len(data):
                raise LogError("expected whole records in a chunk, found the end within one")
            parts.append(data[start:end])
            place = end
        yield _read_header(parts[0]), parts[1]


def _take_connection(copy: _Copy, header: Mapping[str, bytes], data: bytes) -> None:
    number: int = _LENGTH.unpack(_find(header, "conn", 4))[0]
    if number in copy.channels:
        return
    fields = _read_header(data)
    if len(copy.channels) == _MOST_CONNECTIONS:
        raise LogError(f"expected up to {_MOST_CONNECTIONS} connections, found more")
    kind = name_as_ros2(_find(fields, "type", None).decode(errors="replace"))
    definition = _find(fields, "message_definition", None)
    schema = copy.schemas.get((kind, definition))
    if schema is None:
        schema = Schema(id=len(copy.schemas) + 1, name=kind, encoding="ros1msg", data=definition)
        copy.allowance.spend_description(schema)
        copy.schemas[kind, definition] = schema
    channel = Channel(
        id=len(copy.channels) + 1,
        topic=_find(header, "topic", None).decode(errors="replace"),
        message_encoding="ros1",
        schema_id=schema.id,
        metadata={"md5sum": fields.get("md5sum", b"").decode(errors="replace")},
    )
    copy.allowance.spend_description(channel)
    copy.channels[number] = (schema, channel)


def _take_message(copy: _Copy, header: Mapping[str, bytes], data: bytes) -> None:
    copy.messages_left -= 1
    if copy.messages_left < 0:
        raise LogError("a bag of this size may not hold so many messages; cut it into parts")
    number: int = _LENGTH.unpack(_find(header, "conn", 4))[0]
    known = copy.channels.get(number)
    if known is None:
        raise LogError(f"connection {number}: expected its record, found messages only")
    seconds, rest = _TIME.unpack(_find(header, "time", 8))
    time_ns = seconds * 1_000_000_000 + rest
    channel = known[1].id
    entries = copy.index.setdefault(channel, [])
    entries.append((time_ns, len(copy.records)))
    size = _RECORD.size - _RECORD_HEAD + len(data)
    copy.records += _RECORD.pack(Opcode.MESSAGE, size, channel, 0, time_ns, time_ns)
    copy.records += data
    if len(copy.records) >= _CHUNK_BYTES:
        copy.flush()


_RECORD_HEAD: Final = 9
"""Size of opcode and length, which the length does not include [bytes]."""


def _read_header(data: bytes) -> dict[str, bytes]:
    """Return the fields of a header. Each field has a length, a name, `=` and a value."""
    found, place = {}, 0
    while place < len(data):
        start = place + _LENGTH.size
        place = start + _LENGTH.unpack(data[place:start])[0] if start <= len(data) else start
        name, sign, value = data[start:place].partition(b"=")
        if not sign or place > len(data):
            raise LogError("expected fields of a name and a value, found others")
        found[name.decode("ascii", errors="replace")] = value
    return found


def _find(header: Mapping[str, bytes], name: str, size: int | None) -> bytes:
    value = header.get(name)
    if value is None or (size is not None and len(value) != size):
        found = "none" if value is None else f"{len(value)} bytes"
        expected = f"of {size} bytes" if size else "with a value"
        raise LogError(f"expected a field {name} {expected}, found {found}")
    return value


def _unpack_length(data: bytes, most: int | None) -> int:
    if len(data) < _LENGTH.size:
        raise _EndError
    size: int = _LENGTH.unpack(data)[0]
    if most is not None and size > most:
        raise LogError(f"expected a header of up to {most} bytes, found one of {size}")
    return size


def _read(stream: BinaryIO, size: int) -> bytes:
    """Return `size` bytes, read in steps, because a damaged length may claim any size."""
    found = bytearray()
    while len(found) < size:
        part = stream.read(min(_STEP, size - len(found)))
        if not part:
            raise _EndError
        found += part
    return bytes(found)
