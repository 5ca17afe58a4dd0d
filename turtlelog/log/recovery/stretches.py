"""Sound bytes -> where the messages in them stand, and the other records; one pass over heads."""

import struct
from dataclasses import dataclass
from typing import Final

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from turtlelog.log.engine.blocks import MESSAGE_HEAD
from turtlelog.log.engine.framing import RECORD

_FRONT: Final = struct.Struct("<BQH")  # opcode, length; a message's channel
_MESSAGE: Final = int(Opcode.MESSAGE)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stretch:
    """Records that stand one after the other, taken apart as far as they make sense.

    Attributes:
        data: Their bytes.
        starts: Where each message record starts, shape (n,), increasing.
        ends: The byte after each.
        channels: The number of the channel that each names, shape (n,).
        others: The other records in their order: place, opcode, body.
        fault: One clause, where a length makes no sense; everything before it has come.
    """

    data: bytes
    starts: NDArray[np.int64]
    ends: NDArray[np.int64]
    channels: NDArray[np.int64]
    others: tuple[tuple[int, int, bytes], ...]
    fault: str | None


def take_apart(data: bytes) -> Stretch:
    """Return where the messages stand in bytes that a checksum vouches for, or nobody."""
    starts: list[int] = []
    ends: list[int] = []
    channels: list[int] = []
    others: list[tuple[int, int, bytes]] = []
    # Read up to here a message's head is whole, however short the last record is.
    padded, size, place, fault = data + bytes(_FRONT.size), len(data), 0, None
    unpack = _FRONT.unpack_from
    while place < size:
        opcode, length, channel = unpack(padded, place)
        end = place + 9 + length
        if end > size or (opcode == _MESSAGE and length < MESSAGE_HEAD - 9):
            fault = _describe_fault(size - place, length)
            break
        if opcode == _MESSAGE:
            starts.append(place)
            ends.append(end)
            channels.append(channel)
        else:
            others.append((place, opcode, data[place + 9 : end]))
        place = end
    return Stretch(
        data=data,
        starts=np.array(starts, np.int64),
        ends=np.array(ends, np.int64),
        channels=np.array(channels, np.int64),
        others=tuple(others),
        fault=fault,
    )


def _describe_fault(left: int, length: int) -> str:
    if left < RECORD.size:
        return f"expected a record, found {left} bytes"
    return f"expected {left - RECORD.size} bytes at most, found {length} claimed"
