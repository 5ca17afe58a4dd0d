"""The bytes of a rare record -> the record, if all its lengths agree."""

from typing import TypeVar

from mcap.data_stream import RecordBuilder
from mcap.records import Attachment, Channel, Header, Metadata, Schema

from turtlelog.errors import LogError
from turtlelog.log.engine.framing import RECORD
from turtlelog.log.engine.parsing import parse_body

Described = TypeVar("Described", Header, Schema, Channel, Metadata, Attachment)


def parse_record(kind: type[Described], body: bytes) -> Described:
    """Return a record whose lengths agree; bytes that a later version appended are ignored.

    Raises:
        LogError: One clause, where they do not.
    """
    record, _ = parse_body(kind, body)
    builder = RecordBuilder()
    record.write(builder)
    # A table that claims to be shorter than it is would lose entries without a word.
    written: bytes = builder.end()[RECORD.size :]  # type: ignore[no-untyped-call]
    if kind is not Attachment and not body.startswith(written):
        raise LogError(f"expected a sound {kind.__name__} record, found lengths that disagree")
    return record
