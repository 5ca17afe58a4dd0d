"""Run -> file."""

from io import BytesIO
from pathlib import Path

from mcap.well_known import Profile, SchemaEncoding
from mcap.writer import IndexType, Writer

from turtlelog import __version__
from turtlelog.errors import LogError
from turtlelog.log.atomic import replace_when_complete
from turtlelog.log.head import HEAD, format_head, format_scenario_file
from turtlelog.log.messages import TopicMessages, build_messages
from turtlelog.log.schemas import SCHEMAS
from turtlelog.run import Run


def write_recording(run: Run, path: str | Path) -> None:
    """Write a run as an MCAP file; the same run gives the same bytes.

    Raises:
        LogError: Where the place cannot be written, or the run holds what a recording cannot.
    """
    try:
        data = _format_recording(run)
    except LogError as err:
        raise LogError(f"{path}: {err}") from err
    except UnicodeEncodeError as err:
        raise LogError(f"{path}: expected text, found characters that UTF-8 lacks: {err}") from err
    with replace_when_complete(path) as temporary:
        temporary.write_bytes(data)


def _format_recording(run: Run) -> bytes:
    scenario = format_scenario_file(run)
    # An index without entries would write an empty group, which strict checkers call an error.
    indexes = IndexType.CHUNK | IndexType.MESSAGE | IndexType.METADATA
    if scenario is not None:
        indexes |= IndexType.ATTACHMENT
    output = BytesIO()
    writer = Writer(output, index_types=indexes, enable_data_crcs=True)
    writer.start(profile=Profile.ROS2, library=f"turtlelog/{__version__}")
    writer.add_metadata(HEAD, format_head(run))
    if scenario is not None:
        name, text = scenario
        writer.add_attachment(0, 0, name, "application/toml", text.encode())
    _write_messages(writer, build_messages(run))
    writer.finish()  # type: ignore[no-untyped-call]
    return output.getvalue()


def _write_messages(writer: Writer, topics: tuple[TopicMessages, ...]) -> None:
    """Write all messages in order of time; those of one time in the order of their topics."""
    schema_ids: dict[str, int] = {}
    messages = []
    for of_topic in topics:
        topic = of_topic.topic
        if topic.schema not in schema_ids:
            text = SCHEMAS[topic.schema].encode()
            schema_ids[topic.schema] = writer.register_schema(
                topic.schema, SchemaEncoding.ROS2, text
            )
        # Without the QoS entry some versions of rosbag2 refuse the channel.
        channel = writer.register_channel(
            topic.name, "cdr", schema_ids[topic.schema], {"offered_qos_profiles": ""}
        )
        messages += [
            (time_ns, channel, sequence, payload)
            for time_ns, sequence, payload in zip(
                of_topic.time_ns, of_topic.sequence, of_topic.payloads, strict=True
            )
        ]
    messages.sort(key=lambda message: message[0])
    for time_ns, channel, sequence, payload in messages:
        writer.add_message(channel, time_ns, payload, time_ns, sequence)
