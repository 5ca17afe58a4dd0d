"""Small recordings to damage, and what they hold."""

import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

from mcap.reader import NonSeekingReader
from mcap.records import Attachment, Channel, DataEnd, Header, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, Writer

import turtlelog as tl

COMPRESSIONS = {
    "none": CompressionType.NONE,
    "lz4": CompressionType.LZ4,
    "zstd": CompressionType.ZSTD,
}
INDEXES = IndexType.CHUNK | IndexType.MESSAGE | IndexType.METADATA | IndexType.ATTACHMENT

Record = tuple[str, str, int, int, int, bytes]
"""Topic, type, log time [ns], publish time [ns], sequence, payload."""


def make_recording(folder: Path, compression: str, *, seconds: float = 0.25) -> bytes:
    """Return a short run as turtlelog records it, in several chunks of another compression."""
    scenario = tl.override_scenario(tl.load_scenario("paper"), {"max_duration_s": seconds})
    return record_scenario(scenario, folder, compression)


def record_scenario(scenario: tl.Scenario, folder: Path, compression: str) -> bytes:
    """Return a recording of a scenario, likewise."""
    tl.write_recording(tl.simulate_run(scenario), folder / "whole.mcap")
    return pack_again((folder / "whole.mcap").read_bytes(), compression)


def pack_again(
    data: bytes, compression: str, *, use_chunking: bool = True, has_index: bool = True
) -> bytes:
    output = BytesIO()
    writer = Writer(
        output,
        chunk_size=1024,
        compression=COMPRESSIONS[compression],
        index_types=INDEXES if has_index else IndexType.NONE,
        use_chunking=use_chunking,
        use_statistics=has_index,
        enable_data_crcs=True,
    )
    schemas = set[int]()
    for record in StreamReader(BytesIO(data)).records:
        if isinstance(record, DataEnd):
            break
        if isinstance(record, Schema):
            if record.id in schemas:  # of two topics; the writer would number it anew
                continue
            schemas.add(record.id)
        _write_record(writer, record)
    writer.finish()  # type: ignore[no-untyped-call]
    return output.getvalue()


def _write_record(writer: Writer, record: McapRecord) -> None:
    match record:
        case Header():
            writer.start(profile=record.profile, library=record.library)
        case Metadata():
            writer.add_metadata(record.name, record.metadata)
        case Attachment():
            writer.add_attachment(0, 0, record.name, record.media_type, record.data)
        case Schema():
            writer.register_schema(record.name, record.encoding, record.data)
        case Channel():
            writer.register_channel(
                record.topic, record.message_encoding, record.schema_id, record.metadata
            )
        case Message(channel_id=channel, log_time=time_ns, sequence=number):
            writer.add_message(channel, time_ns, record.data, record.publish_time, number)


def list_messages(data: bytes) -> list[Record]:
    """Return the messages of a sound file in the order of the file, read by the mcap library."""
    found = NonSeekingReader(BytesIO(data)).iter_messages(log_time_order=False)
    return [
        (
            channel.topic,
            schema.name if schema else "",
            message.log_time,
            message.publish_time,
            message.sequence,
            message.data,
        )
        for schema, channel, message in found
    ]


def list_contents(data: bytes) -> tuple[list[Record], list[object]]:
    """Return the messages of a sound file, every checksum held, and its metadata and attachments.

    What recovery adds is left out. One pass: the torture reads every recovered file this way.
    """
    types, channels = {0: ""}, dict[int, tuple[str, str]]()
    messages: list[Record] = []
    files: list[object] = []
    for record in StreamReader(BytesIO(data), validate_crcs=True).records:
        match record:
            case Message(channel_id=number, log_time=time_ns, publish_time=sent_ns):
                stamps = time_ns, sent_ns, record.sequence
                messages.append((*channels[number], *stamps, record.data))
            case Schema():
                types[record.id] = record.name
            case Channel():
                channels[record.id] = record.topic, types[record.schema_id]
            case Metadata(name=name) | Attachment(name=name) if name != "turtlelog_recovery":
                files.append(record)
    return messages, files


def list_records(data: bytes) -> list[tuple[int, int, int]]:
    """Return opcode, place and length of the body of every record of a sound file."""
    return list(_iterate_records(data))


def _iterate_records(data: bytes) -> Iterator[tuple[int, int, int]]:
    place = 8
    while place < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, place)
        yield opcode, place, length
        place += 9 + length
