"""The bytes of a rare record -> the record, if its lengths agree."""

from io import BytesIO
from typing import TypeVar

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.records import Attachment, Channel, Header, Metadata, Schema

from turtlelog.errors import LogError, describe_error
from turtlelog.log.engine.framing import RECORD

Described = TypeVar("Described", Header, Schema, Channel, Metadata, Attachment)


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
