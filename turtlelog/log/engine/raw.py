"""File -> records, as they stand: for conformance, and for whoever asks for more than columns."""

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema

from turtlelog.log.engine.blocks import Block
from turtlelog.log.engine.source import Source
from turtlelog.log.engine.stretches import MESSAGE_HEAD
from turtlelog.log.error_boundary import name_file, open_file

_HEAD: Final = struct.Struct("<QHIQQ")  # length, channel, sequence, log and publish time
_LONE: Final = (Opcode.HEADER, Opcode.METADATA, Opcode.ATTACHMENT)


@dataclass(frozen=True, slots=True, kw_only=True)
class RawContents:
    """All records of a file that carry something.

    Attributes:
        header: Profile and library.
        schemas: By id.
        channels: By id.
        messages: In the order of the file.
        metadata: In the order of the file.
        attachments: In the order of the file.
    """

    header: Header
    schemas: dict[int, Schema]
    channels: dict[int, Channel]
    messages: tuple[Message, ...]
    metadata: tuple[Metadata, ...]
    attachments: tuple[Attachment, ...]


def read_raw(path: str | Path) -> RawContents:
    """Return the records of an MCAP file, every checksum checked, through its index if it has one.

    Raises:
        LogError: One line with the file and the place, where it is no MCAP or is damaged.
    """
    with name_file(path, expected="an MCAP file"), open_file(path) as stream:
        source = Source(stream)
        source.check_data()
        messages: list[Message] = []
        found: list[Any] = []
        if source.index is not None:
            found += source.read_lone(_LONE)
        for block, of_block in source.map_blocks(lambda block: (block, _list_messages(block))):
            messages += of_block
            found += block.rest
    headers = [record for record in found if isinstance(record, Header)]
    return RawContents(
        header=headers[0] if headers else Header(profile="", library=""),
        schemas=dict(source.catalogue.schemas),
        channels=dict(source.catalogue.channels),
        messages=tuple(messages),
        metadata=tuple(record for record in found if isinstance(record, Metadata)),
        attachments=tuple(record for record in found if isinstance(record, Attachment)),
    )


def _list_messages(block: Block) -> list[Message]:
    starts = sorted(start for found in block.offsets.values() for start in found.tolist())
    return [_read_message(block.data, start) for start in starts]


def _read_message(data: bytes, start: int) -> Message:
    length, channel, sequence, log_time, publish_time = _HEAD.unpack_from(data, start + 1)
    return Message(
        channel_id=channel,
        sequence=sequence,
        log_time=log_time,
        publish_time=publish_time,
        data=data[start + MESSAGE_HEAD : start + 9 + length],
    )
