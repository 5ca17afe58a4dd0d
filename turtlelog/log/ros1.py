"""ROS 1: a bag as an MCAP file with the same messages, and its messages as CDR.

In a bag (wiki.ros.org/Bags/Format/2.0), records have a header and data, each after its length, and
messages are in chunks, plain or compressed. They are copied unchanged, and those of the requested
topics are converted on reading: ROS 1 (wiki.ros.org/msg) writes little-endian numbers one after
another, and the length before a text or a sequence. CDR aligns each number to its own size and
counts the zero after a text.
"""

import bz2
import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from turtlelog.errors import LogError, describe_error
from turtlelog.log.engine import limits
from turtlelog.log.engine.blocks import ChunkRows
from turtlelog.log.engine.cdr import ENCAPSULATION
from turtlelog.log.engine.limits import UNPACKED_FILE, Allowance, grow_bound, unpack_chunk
from turtlelog.log.engine.message_types import (
    TEXT,
    Field,
    MessageType,
    name_parts,
    read_type,
    shorten_type,
)
from turtlelog.log.engine.records import COUNTED_HEAD
from turtlelog.log.file_access import DamageError
from turtlelog.log.mcap_writer import McapFile

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


_MOST_CONNECTIONS: Final = 2**16 - 1
_IN_RECORD: Final = "expected whole records in a chunk, found the end within one"
_NO_FIELD: Final = "expected fields of a name and a value, found others"


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
        known = {channel.id: (schema, channel) for schema, channel in self.channels.values()}
        self.file.add_chunk(
            ChunkRows(
                channels=[known[number] for number in self.index],
                records=self.records,
                index={
                    number: np.array(entries, dtype=np.uint64).reshape(-1, 2)
                    for number, entries in self.index.items()
                },
            )
        )
        self.records, self.index = bytearray(), {}


def copy_ros1_bag(
    stream: BinaryIO, place: Path, stored_size: int, faults: list[str] | None = None
) -> None:
    """Write the messages of a ROS 1 bag as an MCAP file.

    `stored_size` is the size of the bag before unpacking [bytes], which sets the limits. `faults`
    takes the place where a bag is cut, of which the whole chunks are then written.

    Raises:
        LogError: If the file is no complete bag of version 2.0, or exceeds the limits for its size.
    """
    if stream.read(len(_START)) != _START:
        raise LogError("expected a bag of ROS 1 in version 2.0, found another version")
    with place.open("wb") as output:
        file = McapFile(output)
        file.begin(profile="ros1")
        copy = _Copy(
            file,
            Allowance(stored_size),
            largest_chunk=grow_bound(limits.ROS1_CHUNK, stored_size),
            messages_left=grow_bound(limits.ROS1_MESSAGES, stored_size),
            bz2_left=grow_bound(limits.ROS1_BZ2_BYTES, stored_size),
        )
        if not _copy_records(stream, copy, is_partial=faults is not None):
            cut = f"byte {stream.tell()}: the bag is cut or was never finished"
            if faults is None:
                fix = "rosbag reindex FILE and --partial keep its whole chunks"
                raise DamageError(f"{cut}: {fix}")
            faults.append(cut)
        copy.flush()
        file.describe(copy.schemas.values(), (channel for _, channel in copy.channels.values()))
        file.finish()


def _copy_records(stream: BinaryIO, copy: _Copy, *, is_partial: bool) -> bool:
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
            if operation == _BAG:  # an index that was never written has offset 0
                index_byte = _PLACE.unpack(_find(header, "index_pos", 8))[0]
            if operation in {_INDEX, _CHUNK_INFO, _BAG}:
                stream.seek(size, 1)
                continue
            _take_next(stream, copy, header, size, is_partial=is_partial)
        except _EndError:
            return False
        except LogError as err:
            raise LogError(f"byte {byte}: {err}") from err


def _take_next(
    stream: BinaryIO, copy: _Copy, header: Mapping[str, bytes], size: int, *, is_partial: bool
) -> None:
    """Take the data of a record; of a chunk that is cut, the records before it, if plain."""
    operation = _find(header, "op", 1)[0]
    try:
        _take(copy, operation, header, _read(stream, size))
    except _EndError as err:
        if is_partial and operation == _CHUNK:
            with suppress(LogError):
                _take(copy, operation, header, err.args[0])
        raise


def _take(copy: _Copy, operation: int, header: Mapping[str, bytes], data: bytes) -> None:
    if operation == _CHUNK:
        parts = _iterate_parts(_unpack(copy, header, data), _IN_RECORD)
        for inner in map(_read_header, parts):
            if (body := next(parts, None)) is None:
                raise LogError(_IN_RECORD)
            if (kind := _find(inner, "op", 1)[0]) != _CHUNK:
                _take(copy, kind, inner, body)
    elif operation == _MESSAGE:
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
    if compression == "lz4":
        return unpack_chunk(compression, data, claimed, largest=largest, spend=spend)
    if compression != "none":
        raise LogError(f"expected the compression none, bz2 or lz4, found {compression[:20]!r}")
    spend(len(data))
    return data


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


def _iterate_parts(data: bytes, complaint: str) -> Iterator[bytes]:
    """Yield the parts of data that each follow their length; refuse an incomplete part."""
    place = 0
    while place < len(data):
        start = place + _LENGTH.size
        place = start + _LENGTH.unpack(data[place:start])[0] if start <= len(data) else start
        if place > len(data):
            raise LogError(complaint)
        yield data[start:place]


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
    copy.index.setdefault(channel, []).append((time_ns, len(copy.records)))
    size = COUNTED_HEAD + len(data)
    copy.records += _RECORD.pack(Opcode.MESSAGE, size, channel, 0, time_ns, time_ns)
    copy.records += data
    if len(copy.records) >= _CHUNK_BYTES:
        copy.flush()


def _read_header(data: bytes) -> dict[str, bytes]:
    """Return the fields of a header. Each field has a length, a name, `=` and a value."""
    found = {}
    for part in _iterate_parts(data, _NO_FIELD):
        name, sign, value = part.partition(b"=")
        if not sign:
            raise LogError(_NO_FIELD)
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
            raise _EndError(bytes(found))
        found += part
    return bytes(found)


_HEADER: Final = f"{'=' * 80}\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
"""Header of ROS 1, which counts messages. Definitions always include the header."""

_RENAMED: Final = {"tf/tfMessage": "tf2_msgs/TFMessage"}
"""Types that have another name in ROS 2."""

_Step = Callable[["_Message"], None]


def name_as_ros2(kind: str) -> str:
    """Return the ROS 2 name of a type: `nav_msgs/Odometry` becomes `nav_msgs/msg/Odometry`."""
    known = _RENAMED.get(kind, kind)
    package, slash, name = known.partition("/")
    return f"{package}/msg/{name}" if slash and "/" not in name else known


def read_ros1_type(name: str, text: str) -> MessageType:
    """Return a type from its definition in `ros1msg`."""
    if not text.strip():
        raise LogError(f"schema {name}: the file holds no definition of it")
    has_header = "MSG: std_msgs/Header" in text or shorten_type(name) == "std_msgs/Header"
    return read_type(name, text if has_header else f"{text.rstrip()}\n{_HEADER}")


def build_converter(fields: tuple[Field, ...]) -> Callable[[bytes], bytes]:
    """Return a function that converts a ROS 1 message with these fields to CDR."""
    steps = _plan(fields)

    def convert(data: bytes) -> bytes:
        message = _Message(data)
        for step in steps:
            step(message)
        if message.place != len(data):
            raise LogError(f"expected {message.place} bytes, found {len(data)}")
        return ENCAPSULATION + message.body

    return convert


class _Message:
    """A message in the ROS 1 format, read up to `place`, and its body in CDR so far."""

    __slots__ = ("body", "data", "place")

    def __init__(self, data: bytes) -> None:
        self.data, self.place, self.body = data, 0, bytearray()

    def take(self, size: int) -> bytes:
        """Return the next bytes."""
        start, self.place = self.place, self.place + size
        if self.place > len(self.data):
            raise LogError(
                f"expected {size} bytes more at byte {start}, found {len(self.data) - start}"
            )
        return self.data[start : self.place]

    def take_count(self) -> int:
        """Return the next length."""
        count: int = _LENGTH.unpack(self.take(_LENGTH.size))[0]
        if count > len(self.data) - self.place:
            raise LogError(
                f"expected at most {len(self.data) - self.place} items at byte {self.place}, found"
                f" {count}"
            )
        return count

    def align(self, size: int) -> None:
        """Pad the body to a multiple of a size [bytes]."""
        self.body += bytes(-len(self.body) % size)


def _plan(fields: tuple[Field, ...]) -> tuple[_Step, ...]:
    """Return the steps that convert a message. Consecutive numbers of one size form one step."""
    runs: list[tuple[int, int] | _Step] = []
    _append_steps(runs, fields)
    return tuple(partial(_copy_run, *run) if isinstance(run, tuple) else run for run in runs)


def _append_steps(runs: list[tuple[int, int] | _Step], fields: tuple[Field, ...]) -> None:
    for one in fields:
        count = 1 if one.length is None else one.length
        if one.is_sequence:
            runs.append(_copy_sequence(one.kind))
        elif one.kind == TEXT:
            runs += [_copy_text] * count
        elif isinstance(one.kind, str):
            size = np.dtype(one.kind).itemsize
            _append_run(runs, size, size * count)
        else:
            for _ in name_parts(one):
                _append_steps(runs, one.kind)
    if not fields:  # ROS 2 gives a type without fields one byte, ROS 1 none
        runs.append(lambda message: message.body.append(0))


def _append_run(runs: list[tuple[int, int] | _Step], size: int, total: int) -> None:
    last = runs[-1] if runs else None
    if isinstance(last, tuple) and last[0] == size:
        runs[-1] = size, last[1] + total
    elif total:
        runs.append((size, total))


def _copy_run(size: int, total: int, message: _Message) -> None:
    message.align(size)
    message.body += message.take(total)


def _copy_text(message: _Message) -> None:
    data = message.take(message.take_count())
    message.align(_LENGTH.size)
    message.body += _LENGTH.pack(len(data) + 1)
    message.body += data
    message.body.append(0)


def _copy_sequence(kind: str | tuple[Field, ...]) -> _Step:
    size = np.dtype(kind).itemsize if isinstance(kind, str) and kind != TEXT else 0
    items = (_copy_text,) if isinstance(kind, str) else _plan(kind)

    def step(message: _Message) -> None:
        count = message.take_count()
        message.align(_LENGTH.size)
        message.body += _LENGTH.pack(count)
        if size and count:
            _copy_run(size, size * count, message)
        for _ in range(0 if size else count):
            for item in items:
                item(message)

    return step
