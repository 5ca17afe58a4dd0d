"""Topics -> the schema and channel records that describe them."""

from collections.abc import Mapping, Sequence

from mcap.records import Channel, Schema

from turtlelog.errors import LogError
from turtlelog.log.recording.type_hashes import find_type_hash


def describe_topics(
    topics: Sequence[tuple[str, str]], definitions: Mapping[str, str]
) -> list[tuple[Schema, Channel]]:
    """Return schema and channel of topics, given by name and type, numbered from 1.

    Raises:
        LogError: Where the `ros2msg` text of a type is not among the definitions.
    """
    schemas: dict[str, Schema] = {}
    pairs = []
    for number, (topic, kind) in enumerate(topics, start=1):
        if kind not in definitions:
            raise LogError(f"topic {topic}: expected a definition of {kind}, found none")
        if kind not in schemas:
            data = definitions[kind].encode()
            schemas[kind] = Schema(id=len(schemas) + 1, name=kind, encoding="ros2msg", data=data)
        channel = Channel(
            id=number,
            topic=topic,
            message_encoding="cdr",
            schema_id=schemas[kind].id,
            metadata=_describe_type(kind, definitions[kind]),
        )
        pairs.append((schemas[kind], channel))
    return pairs


def _describe_type(kind: str, definition: str) -> dict[str, str]:
    # Without the QoS entry some versions of rosbag2 refuse the channel.
    metadata = {"offered_qos_profiles": ""}
    # A hash holds for one text: nobody knows that of a type that somebody else has defined.
    if (type_hash := find_type_hash(kind, definition)) is not None:
        metadata["topic_type_hash"] = type_hash
    return metadata
