"""Conversion of ROS 1 messages to CDR, with alignment and zero-terminated texts.

ROS 1 (wiki.ros.org/msg) writes little-endian numbers one after another, and the length before a
text or a sequence. CDR aligns each number to its own size and counts the zero after a text.
"""

import struct
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.framing import RECORD
from turtlelog.log.engine.message_types import (
    TEXT,
    Field,
    MessageType,
    name_parts,
    read_type,
    shorten_type,
)
from turtlelog.log.engine.parsing import COUNTED_HEAD, MESSAGE_HEAD, gather_heads

_ENCAPSULATION: Final = b"\x00\x01\x00\x00"
_LENGTH: Final = struct.Struct("<I")
_HEADER: Final = f"{'=' * 80}\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
"""Header of ROS 1, which counts messages. Definitions always include the header."""

_RENAMED: Final = {"tf/tfMessage": "tf2_msgs/TFMessage"}
"""Types that have another name in ROS 2."""

Places = NDArray[np.int64]
_Step = Callable[["_Message"], None]


def name_as_ros2(kind: str) -> str:
    """Return the ROS 2 name of a type: `nav_msgs/Odometry` becomes `nav_msgs/msg/Odometry`."""
    known = _RENAMED.get(kind, kind)
    package, slash, name = known.partition("/")
    return f"{package}/msg/{name}" if slash and "/" not in name else known


def read_ros1_type(name: str, text: str) -> MessageType:
    """Return a type from its definition in `ros1msg`.

    Raises:
        LogError: As for `read_type`, and if there is no text.
    """
    if not text.strip():
        raise LogError(f"schema {name}: the file holds no definition of it")
    has_header = "MSG: std_msgs/Header" in text or shorten_type(name) == "std_msgs/Header"
    return read_type(name, text if has_header else f"{text.rstrip()}\n{_HEADER}")


def convert_ros1(fields: tuple[Field, ...], data: bytes, starts: Places) -> tuple[bytes, Places]:
    """Return ROS 1 messages as records of CDR messages.

    Args:
        fields: Fields of the message type.
        data: Bytes that contain the records.
        starts: Start of each record.

    Raises:
        LogError: If a message does not have this type.
    """
    heads = gather_heads(data, starts)
    ends = starts + RECORD.size + heads["length"].astype(np.int64)
    steps = _plan(fields)
    found, places = bytearray(), np.empty_like(starts)
    for number, (start, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
        message = _Message(data[start + MESSAGE_HEAD : end])
        try:
            for step in steps:
                step(message)
        except LogError as err:
            raise LogError(f"message {number}: {err}") from err
        if message.place != len(message.data):
            raise LogError(
                f"message {number}: expected {message.place} bytes, found {len(message.data)}"
            )
        heads["length"][number] = COUNTED_HEAD + len(_ENCAPSULATION) + len(message.body)
        places[number] = len(found)
        found += heads[number].tobytes()
        found += _ENCAPSULATION
        found += message.body
    return bytes(found), places


class _Message:
    """A message that is being converted.

    Attributes:
        data: Message in the ROS 1 format.
        place: Number of bytes read so far.
        body: Message in CDR so far, without the encapsulation header.
    """

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
    return tuple(_copy(*run) if isinstance(run, tuple) else run for run in runs)


def _append_steps(runs: list[tuple[int, int] | _Step], fields: tuple[Field, ...]) -> None:
    for field in fields:
        if field.is_sequence:
            runs.append(_copy_sequence(field))
        elif field.kind == TEXT:
            runs.append(_copy_texts(1 if field.length is None else field.length))
        elif isinstance(field.kind, str):
            size = np.dtype(field.kind).itemsize
            _append_run(runs, size, size * (1 if field.length is None else field.length))
        else:
            for _ in name_parts(field):
                _append_steps(runs, field.kind)
    if not fields:  # ROS 2 gives a type without fields one byte, ROS 1 none
        runs.append(_add_byte)


def _append_run(runs: list[tuple[int, int] | _Step], size: int, total: int) -> None:
    last = runs[-1] if runs else None
    if isinstance(last, tuple) and last[0] == size:
        runs[-1] = size, last[1] + total
    elif total:
        runs.append((size, total))


def _copy(size: int, total: int) -> _Step:
    def step(message: _Message) -> None:
        message.align(size)
        message.body += message.take(total)

    return step


def _copy_texts(count: int) -> _Step:
    def step(message: _Message) -> None:
        for _ in range(count):
            _copy_text(message)

    return step


def _copy_text(message: _Message) -> None:
    data = message.take(message.take_count())
    message.align(_LENGTH.size)
    message.body += _LENGTH.pack(len(data) + 1)
    message.body += data
    message.body.append(0)


def _add_byte(message: _Message) -> None:
    message.body.append(0)


def _copy_sequence(field: Field) -> _Step:
    if not isinstance(field.kind, str):
        return _copy_items(_plan(field.kind))
    if field.kind == TEXT:
        return _copy_items((_copy_text,))
    size = np.dtype(field.kind).itemsize

    def step(message: _Message) -> None:
        if count := _copy_count(message):
            message.align(size)
            message.body += message.take(size * count)

    return step


def _copy_items(items: tuple[_Step, ...]) -> _Step:
    def step(message: _Message) -> None:
        for _ in range(_copy_count(message)):
            for item in items:
                item(message)

    return step


def _copy_count(message: _Message) -> int:
    count = message.take_count()
    message.align(_LENGTH.size)
    message.body += _LENGTH.pack(count)
    return count
