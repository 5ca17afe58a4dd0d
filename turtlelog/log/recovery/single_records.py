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
    record, size = parse_body(kind, body)
    if isinstance(record, Channel | Schema):
        if size != _measure(record):
            raise LogError(f"expected a sound {kind.__name__} record, found an entry twice")
        return record
    builder = RecordBuilder()
    record.write(builder)
    # A table that claims to be shorter than it is would lose entries without a word.
    written: bytes = builder.end()[RECORD.size :]  # type: ignore[no-untyped-call]
    if kind is not Attachment and not body.startswith(written):
        raise LogError(f"expected a sound {kind.__name__} record, found lengths that disagree")
    return record


def _measure(record: Channel | Schema) -> int:
    """Return the bytes that it takes if its entries are all."""
    if isinstance(record, Schema):
        texts = [record.name.encode(), record.encoding.encode(), record.data]
        return 2 + sum(4 + len(found) for found in texts)
    texts = [record.topic.encode(), record.message_encoding.encode()]
    texts += [found.encode() for entry in record.metadata.items() for found in entry]
    return 4 + 4 + sum(4 + len(found) for found in texts)
