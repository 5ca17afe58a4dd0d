"""Sound bytes -> records, one by one; for rare records and rare paths, columns are faster."""

import struct
from collections.abc import Iterator
from io import BytesIO
from typing import Final, TypeVar

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema

from turtlelog.errors import LogError, describe_error
from turtlelog.log.engine.framing import RECORD

MESSAGE_HEAD: Final = struct.Struct("<HIQQ")
"""Channel, sequence, log time, publish time [ns]; the payload follows."""

Described = TypeVar("Described", Header, Schema, Channel, Metadata, Attachment)


def iterate_records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and body of records that stand one after the other.

    Raises:
        LogError: One clause, where a length makes no sense; all before it have come.
    """
    place = 0
    while place < len(data):
        if len(data) - place < RECORD.size:
            raise LogError(f"expected a record, found {len(data) - place} bytes")
        opcode, length = RECORD.unpack_from(data, place)
        place += RECORD.size
        least = MESSAGE_HEAD.size if opcode == Opcode.MESSAGE else 0
        if not least <= length <= len(data) - place:
            raise LogError(f"expected {len(data) - place} bytes at most, found {length} claimed")
        yield opcode, data[place : place + length]
        place += length


def parse_record(kind: type[Described], body: bytes) -> Described:
    """Return a record whose lengths agree; bytes that a later version appended are ignored.

    Raises:
        LogError: One clause, where they do not.
    """
    try:
        record: Described = kind.read(ReadDataStream(BytesIO(body)))
        builder = RecordBuilder()
        record.write(builder)
    except Exception as err:  # the library raises nearly everything
        found = describe_error(err)
        raise LogError(f"expected a sound {kind.__name__} record, found {found}") from err
    # The library reads texts that are shorter than they claim without a word.
    written: bytes = builder.end()[RECORD.size :]  # type: ignore[no-untyped-call]
    if kind is not Attachment and not body.startswith(written):
        raise LogError(f"expected a sound {kind.__name__} record, found lengths that disagree")
    return record
