"""Whether an MCAP file is whole: its ends, and the checksums of its summary and its data.

The mcap library checks chunks and the data section, but never the summary.
"""

import io
import struct
import zlib
from dataclasses import dataclass
from typing import BinaryIO, Final

from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from turtlelog.errors import LogError

_FOOTER: Final = struct.Struct("<BQQQI")  # opcode, length, summary, summary offsets, crc
_DATA_END: Final = struct.Struct("<BQI")  # opcode, length, crc
_STEP: Final = 2**20  # bytes
_SQLITE: Final = b"SQLite format 3\0"
_RERUN: Final = b"RRF2"
_BYTE_ORDER_MARK: Final = b"\xef\xbb\xbf"
START_SIZE: Final = len(_SQLITE)
"""Bytes at the start of a file that tell what it is."""


class DamageError(LogError):
    """A file that is not what its writer wrote, or not all of it."""


class UnfinishedError(DamageError):
    """A file whose writer never came to its end, or whose end is cut off."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ends:
    """Where the parts of a whole file are.

    Attributes:
        data_end: Byte of the record that ends the data section.
        data_crc: Checksum of all bytes before it, 0 where there is none.
        summary_start: Byte of the summary section; where it is empty, that of the footer.
        summary: Its records, summary offsets included.
    """

    data_end: int
    data_crc: int
    summary_start: int
    summary: bytes


def check_start(stream: BinaryIO) -> None:
    """Check the magic bytes at the start.

    Raises:
        LogError: Where the file is no MCAP.
    """
    stream.seek(0)
    reason = find_wrong_start(stream.read(START_SIZE))
    if reason is not None:
        raise LogError(f"byte 0: {reason}")


def find_wrong_start(start: bytes) -> str | None:
    """Return why the first bytes of a file are none of MCAP, and what may help; None if sound."""
    if start.startswith(MCAP0_MAGIC):
        return None
    found = f"0x{start[: len(MCAP0_MAGIC)].hex()}" if start else "an empty file"
    if start.startswith(_SQLITE):
        found = "a bag in SQLite: ros2 bag convert makes MCAP of it"
    elif start.startswith(_RERUN):
        found = "a Rerun recording: turtlelog view shows it"
    elif start and _is_text(start.removeprefix(_BYTE_ORDER_MARK)):
        found = "text: turtlelog import makes a recording of a log in JSON or CSV"
    return f"expected an MCAP file (0x{MCAP0_MAGIC.hex()}), found {found}"


def _is_text(start: bytes) -> bool:
    return all(byte in b"\t\n\r" or 0x20 <= byte < 0x7F for byte in start)


def read_ends(stream: BinaryIO) -> Ends:
    """Check the magic bytes at both ends, the footer and the summary.

    Raises:
        LogError: Where the file is no MCAP.
        DamageError: Where it is cut short, or its summary is damaged.
    """
    check_start(stream)
    place, start, checksum = _read_footer(stream)
    data_end, data_crc = _read_data_end(stream, start)
    summary = _read_summary(stream, place, start, checksum)
    return Ends(data_end=data_end, data_crc=data_crc, summary_start=start, summary=summary)


def read_summary(stream: BinaryIO) -> tuple[int, bytes]:
    """Return start and records of the summary section of a file, whatever its data are like.

    Raises:
        DamageError: Where the file is cut short, or its footer or summary is damaged.
    """
    place, start, checksum = _read_footer(stream)
    if not checksum:  # then only this bears out where it starts
        _read_data_end(stream, start)
    return start, _read_summary(stream, place, start, checksum)


def check_data(stream: BinaryIO, ends: Ends) -> None:
    """Check all bytes before the end of the data section; costs one pass over the file.

    Raises:
        DamageError: Where they are not those that were written.
    """
    found = _compute_checksum(stream, 0, ends.data_end if ends.data_crc else 0)
    if found != ends.data_crc:
        raise DamageError(
            f"byte {ends.data_end}: expected data of checksum {ends.data_crc:#010x},"
            f" found {found:#010x}"
        )


def _read_footer(stream: BinaryIO) -> tuple[int, int, int]:
    """Return where the footer stands and the summary starts, and the checksum of both, 0 if none.

    Where the summary is empty, it starts where the footer does.
    """
    size = stream.seek(0, io.SEEK_END)
    place = size - _FOOTER.size - len(MCAP0_MAGIC)
    stream.seek(max(place, 0))
    footer, end = stream.read(_FOOTER.size), stream.read()
    if place < len(MCAP0_MAGIC) or end != MCAP0_MAGIC:
        raise UnfinishedError(
            f"byte {size}: expected the end of an MCAP file, found none:"
            " cut short, or never finished"
        )
    opcode, length, start, _, checksum = _FOOTER.unpack(footer)
    if opcode != Opcode.FOOTER or length != 20 or start > place:
        raise DamageError(f"byte {place}: expected a footer, found 0x{footer.hex()}")
    return place, start or place, checksum


def _read_summary(stream: BinaryIO, footer: int, start: int, expected: int) -> bytes:
    end = footer + _FOOTER.size - 4  # the checksum covers the footer up to itself
    # Held before anything is read: a damaged footer may claim that all of the file is summary.
    if expected and expected != (found := _compute_checksum(stream, start, end)):
        raise DamageError(
            f"byte {start}: expected a summary of checksum {expected:#010x}, found {found:#010x}"
        )
    stream.seek(start)
    return stream.read(footer - start)


def _compute_checksum(stream: BinaryIO, start: int, end: int) -> int:
    stream.seek(start)
    found = 0
    for place in range(start, end, _STEP):
        found = zlib.crc32(stream.read(min(_STEP, end - place)), found)
    return found


def _read_data_end(stream: BinaryIO, summary_start: int) -> tuple[int, int]:
    place = max(summary_start - _DATA_END.size, 0)
    stream.seek(place)
    record = stream.read(_DATA_END.size)
    if len(record) < _DATA_END.size or _DATA_END.unpack(record)[:2] != (Opcode.DATA_END, 4):
        raise DamageError(f"byte {place}: expected the end of the data, found 0x{record.hex()}")
    return place, int(_DATA_END.unpack(record)[2])
