"""The summary of a file whose data may be damaged: what was there to be read."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from io import SEEK_END
from typing import BinaryIO

from mcap.records import Channel, Schema

from turtlelog.log.engine.integrity import DamageError, read_summary
from turtlelog.log.engine.limits import Allowance
from turtlelog.log.engine.summary import parse_summary


@dataclass(frozen=True, slots=True, kw_only=True)
class Ending:
    """What a summary says.

    Attributes:
        schemas: By id.
        channels: By id.
        counts: Messages by channel; None where there are no statistics.
        is_sound: Whether the file ends as it should, with a summary that agrees with its
            checksum or no summary at all.
    """

    schemas: Mapping[int, Schema] = field(default_factory=dict)
    channels: Mapping[int, Channel] = field(default_factory=dict)
    counts: Mapping[int, int] | None = None
    is_sound: bool = False


def read_ending(stream: BinaryIO) -> Ending:
    """Return what the summary says; nothing where there is none, or its checksum fails."""
    try:
        summary = parse_summary(read_summary(stream), Allowance(stream.seek(0, SEEK_END)))
    except DamageError:
        return Ending()
    statistics = summary.statistics
    return Ending(
        schemas={schema.id: schema for schema in summary.schemas},
        channels={channel.id: channel for channel in summary.channels},
        counts=None if statistics is None else dict(statistics.channel_message_counts),
        is_sound=True,
    )
