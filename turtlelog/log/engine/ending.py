"""The summary of a file whose data may be damaged: what was there to be read."""

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from io import BytesIO
from typing import BinaryIO, Final

from mcap.opcode import Opcode
from mcap.records import Channel, Schema, Statistics
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC

_FOOTER: Final = struct.Struct("<BQQQI")  # opcode, length, summary, summary offsets, crc
_TAIL: Final = _FOOTER.size + len(MCAP0_MAGIC)
_LARGEST: Final = 2**28  # bytes of a summary; a damaged footer may claim anything


@dataclass(frozen=True, slots=True, kw_only=True)
class Ending:
    """What a summary says.

    Attributes:
        schemas: By id.
        channels: By id.
        counts: Messages by channel; None where there are no statistics.
        is_checked: Whether the summary's checksum vouches for it.
        is_sound: Whether the file ends as it should, with a summary that agrees with its
            checksum or no summary at all.
    """

    schemas: Mapping[int, Schema] = field(default_factory=dict)
    channels: Mapping[int, Channel] = field(default_factory=dict)
    counts: Mapping[int, int] | None = None
    is_checked: bool = False
    is_sound: bool = False


def read_ending(stream: BinaryIO) -> Ending:
    """Return what the summary says; nothing where there is none, or its checksum fails."""
    size = stream.seek(0, 2)
    stream.seek(max(size - _TAIL, 0))
    tail = stream.read(_TAIL)
    if len(tail) < _TAIL or not tail.endswith(MCAP0_MAGIC):
        return Ending()
    opcode, length, start, _, checksum = _FOOTER.unpack(tail[: _FOOTER.size])
    if (opcode, length) != (Opcode.FOOTER, 20) or not _is_place(start, size):
        return Ending()
    stream.seek(start or size - _TAIL)
    summary = stream.read(size - len(MCAP0_MAGIC) - stream.tell())
    if checksum and zlib.crc32(summary[:-4]) != checksum:
        return Ending()
    try:
        return _parse(summary, is_checked=checksum != 0)
    except Exception:  # the library raises nearly everything; without a checksum anything may stand
        return Ending()


def _is_place(start: int, size: int) -> bool:
    return start == 0 or len(MCAP0_MAGIC) <= start <= size - _TAIL <= start + _LARGEST


def _parse(summary: bytes, *, is_checked: bool) -> Ending:
    reader = StreamReader(BytesIO(summary + MCAP0_MAGIC), skip_magic=True)
    records = list(reader.records)
    statistics = [record for record in records if isinstance(record, Statistics)]
    return Ending(
        schemas={record.id: record for record in records if isinstance(record, Schema)},
        channels={record.id: record for record in records if isinstance(record, Channel)},
        counts=dict(statistics[0].channel_message_counts) if statistics else None,
        is_checked=is_checked,
        is_sound=True,
    )
