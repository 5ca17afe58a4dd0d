"""Sound bytes -> where the messages in them stand, and the other records; one pass over heads."""

from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from turtlelog.log.engine.framing import RECORD
from turtlelog.log.engine.gather import gather_bytes
from turtlelog.log.engine.limits import LONGEST_DESCRIBED, MOST_DESCRIBED

MESSAGE_HEAD: Final = 31
"""Bytes of a message record before its data."""

HEADING: Final = np.dtype(
    {
        "names": ["length", "channel", "log_time"],
        "formats": ["<u8", "<u2", "<u8"],
        "offsets": [1, 9, 15],
        "itemsize": MESSAGE_HEAD,
    }
)
"""The front of a message record."""

_MESSAGE: Final = int(Opcode.MESSAGE)
_KNOWN: Final = frozenset(
    {Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA, Opcode.ATTACHMENT}
)
_OF_CHUNKS: Final = frozenset({Opcode.SCHEMA, Opcode.CHANNEL})
_ROWS: Final = 2**16  # messages looked at together
_BYTES: Final = 2**24  # from the first to the last of them

Places = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stretch:
    """Records that stand one after the other, taken apart as far as they make sense.

    Attributes:
        data: Their bytes.
        starts: Where each message record starts, shape (n,), increasing, of 4 bytes each.
        others: The other records that carry something, in their order: place, opcode, end.
        fault: One clause, where a length makes no sense; everything before it has come.
        records: How many there are of any kind.
    """

    data: bytes
    starts: NDArray[np.uint32]
    others: tuple[tuple[int, int, int], ...]
    fault: str | None
    records: int

    def iterate_rows(self, rows: slice = slice(None)) -> Iterator[tuple[Places, NDArray[Any]]]:
        """Yield where some thousand messages start, and their `HEADING`."""
        chosen, first = self.starts[rows], 0
        while first < len(chosen):
            starts = chosen[first : first + _ROWS].astype(np.int64)
            starts = starts[: np.searchsorted(starts, starts[0] + _BYTES)]
            first += len(starts)
            yield starts, gather_bytes(self.data, starts, HEADING.itemsize).view(HEADING)


def take_apart(data: bytes, *, is_chunk: bool, most_records: int) -> Stretch:
    """Return where the messages stand in bytes that a checksum vouches for, or nobody.

    Args:
        data: The bytes.
        is_chunk: Whether they are a chunk's, which carries messages, schemas and channels only.
        most_records: What there may be before the rest is given up.
    """
    starts, others = array("I"), list[tuple[int, int, int]]()
    known, size, place, left = _OF_CHUNKS if is_chunk else _KNOWN, len(data), 0, most_records
    fault = None
    unpack, last = RECORD.unpack_from, size - RECORD.size
    for left in range(most_records, -1, -1):
        if place >= size or not left:
            break
        opcode, length = unpack(data, place) if place <= last else (0, 0)
        end = place + 9 + length
        if opcode == _MESSAGE and end <= size and length >= MESSAGE_HEAD - 9:
            starts.append(place)
        elif not opcode or opcode == _MESSAGE or end > size:
            fault = _describe_fault(opcode, size - place, length)
            break
        elif opcode in known:
            fault = _check_others(len(others), opcode, length) if is_chunk else None
            if fault is not None:
                break
            others.append((place, opcode, end))
        place = end
    if place < size and fault is None:
        fault = f"expected up to {most_records} records more, found {size - place} bytes of others"
    return Stretch(
        data=data,
        starts=np.frombuffer(starts, np.uint32) if starts else np.empty(0, np.uint32),
        others=tuple(others),
        fault=fault,
        records=most_records - left,
    )


def _check_others(count: int, opcode: int, length: int) -> str | None:
    """Return why a chunk may not hold one more schema or channel."""
    if count == MOST_DESCRIBED:
        return f"expected up to {MOST_DESCRIBED} schemas and channels, found more"
    if length > LONGEST_DESCRIBED:
        expected = f"a record (opcode {opcode}) of up to {LONGEST_DESCRIBED} bytes"
        return f"expected {expected}, found {length}"
    return None


def _describe_fault(opcode: int, left: int, length: int) -> str:
    if left < RECORD.size:
        return f"expected a record, found {left} bytes"
    found = f"opcode {opcode} with {length}"
    return f"expected a record of up to {left - RECORD.size} bytes, found {found}"
