"""Whether an MCAP file is whole: its ends, and the checksum of its summary.

The mcap library checks chunks and the data section, but never the summary.
"""

import io
import struct
import zlib
from typing import IO, Final

from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from turtlelog.errors import LogError

_FOOTER: Final = struct.Struct("<BQQQI")  # opcode, length, summary, summary offsets, crc
_DATA_END: Final = struct.Struct("<BQI")  # opcode, length, crc
_UNCHECKED: Final = 4 + len(MCAP0_MAGIC)  # the footer's checksum and what follows it


def check_ends(stream: IO[bytes]) -> None:
    """Check the magic bytes at both ends, the footer and the summary; leaves `stream` at its start.

    Raises:
        LogError: Where the file is no MCAP, is cut short, or its summary is damaged.
    """
    size = stream.seek(0, io.SEEK_END)
    stream.seek(0)
    start = stream.read(len(MCAP0_MAGIC))
    if start != MCAP0_MAGIC:
        found = f"0x{start.hex()}" if start else "an empty file"
        raise LogError(f"byte 0: expected an MCAP file (0x{MCAP0_MAGIC.hex()}), found {found}")
    tail = _FOOTER.size + len(MCAP0_MAGIC)
    stream.seek(max(size - tail, 0))
    footer, end = stream.read(_FOOTER.size), stream.read()
    if size < len(MCAP0_MAGIC) + tail or end != MCAP0_MAGIC:
        raise LogError(
            f"byte {size}: expected the end of an MCAP file, found none:"
            " cut short, or never finished"
        )
    opcode, length, summary_start, _, checksum = _FOOTER.unpack(footer)
    if opcode != Opcode.FOOTER or length != 20 or summary_start > size - tail:
        raise LogError(f"byte {size - tail}: expected a footer, found 0x{footer.hex()}")
    end_of_data = summary_start or size - tail
    stream.seek(max(end_of_data - _DATA_END.size, 0))
    data_end, summary = stream.read(_DATA_END.size), stream.read(size - _UNCHECKED - end_of_data)
    if _DATA_END.unpack(data_end)[:2] != (Opcode.DATA_END, 4):
        place = end_of_data - _DATA_END.size
        raise LogError(f"byte {place}: expected the end of the data, found 0x{data_end.hex()}")
    if checksum and checksum != (found_checksum := zlib.crc32(summary)):
        raise LogError(
            f"summary at byte {end_of_data}: expected checksum {checksum:#010x},"
            f" found {found_checksum:#010x}: the file is damaged"
        )
    stream.seek(0)
