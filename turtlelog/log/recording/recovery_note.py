"""What a recovered file says of the one that it came from: a metadata record, and a line."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import msgspec
from mcap.records import Metadata

from turtlelog.errors import LogError
from turtlelog.log.recording.head import CHECKSUM, sum_up

RECOVERY: Final = "turtlelog_recovery"
"""Name of the metadata record that tells a recovered file from one that was always whole."""

_NOTE: Final = "recovered"


@dataclass(frozen=True, slots=True, kw_only=True)
class Loss:
    """A stretch of a file that could not be recovered.

    Attributes:
        start: First byte in the file.
        end: Byte after the last one; where it equals `start`, something is missing there.
        reason: One clause: what was expected, what was found.
    """

    start: int
    end: int
    reason: str


def format_recovery(
    lost: Sequence[Loss], missing: Mapping[str, int] | None, unchecked: Mapping[str, int]
) -> dict[str, str]:
    """Return the metadata record: each entry as JSON, and the checksum of all."""
    entries = {"lost": lost, "missing": missing, "unchecked": unchecked}
    record = {name: msgspec.json.encode(value).decode() for name, value in entries.items()}
    return {**record, CHECKSUM: sum_up(record)}


def describe_recovery(records: Iterable[Any]) -> dict[str, str]:
    """Return the note `recovered` for a file with these records; none where it was always whole.

    Raises:
        LogError: Where the record is not as it was written.
    """
    found = [
        record.metadata
        for record in records
        if isinstance(record, Metadata) and record.name == RECOVERY
    ]
    if not found:
        return {}
    losses = "; ".join(dict.fromkeys(map(_describe, found)))
    return {_NOTE: f"from a damaged or unfinished file: {losses}"}


def _describe(record: Mapping[str, str]) -> str:
    if record.get(CHECKSUM) != sum_up(record):
        raise LogError(f"metadata {RECOVERY}: expected its checksum, found another: it is damaged")
    lost = _decode(record, "lost", tuple[Loss, ...])
    missing = _decode(record, "missing", dict[str, int] | None)
    if missing is None:
        count = "nobody knows how many messages are lost"
    elif missing:
        count = "lost " + ", ".join(f"{count} of {topic}" for topic, count in missing.items())
    else:
        count = "no message is lost"
    places = [f"byte {loss.start}: {loss.reason}" for loss in lost[:1]]
    if len(lost) > 1:
        places.append("1 more place" if len(lost) == 2 else f"{len(lost) - 1} more places")
    return f"{count} ({', and '.join(places)})" if places else count


def _decode(record: Mapping[str, str], key: str, kind: Any) -> Any:
    try:
        return msgspec.json.decode(record[key], type=kind)
    except (KeyError, msgspec.MsgspecError) as err:
        raise LogError(f"metadata {RECOVERY}: {key}: expected its JSON, found {err}") from err
