"""Notes on what a file has lost: in one that was recovered, and of one that is damaged."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import msgspec
from mcap.records import Metadata

from turtlelog.errors import LogError
from turtlelog.log.engine.walk import Loss
from turtlelog.log.recording.head import CHECKSUM, sum_up

RECOVERY: Final = "turtlelog_recovery"
"""Name of the metadata record that tells a recovered file from one that was always whole."""

_NOTE: Final = "recovered"

LOSS_NOTES: Final = ("partial", "recovered")
"""Notes of a run that say what its recording has lost."""

_FROM_DAMAGED: Final = "from a damaged or unfinished file: "
_NO_MESSAGE: Final = "no message is lost"

SUMMARY_ALONE: Final = "no data is lost, only the summary is damaged"
NO_LOSS: Final = (SUMMARY_ALONE, f"{_FROM_DAMAGED}{_NO_MESSAGE}")
"""How the notes begin of files of which nothing is lost but the summary; what follows a semicolon
is another loss."""


def describe_damages(damages: Sequence[Loss]) -> str:
    """Say in one line how much is lost; the first place stands for all."""
    if not damages:
        return SUMMARY_ALONE
    lost, places = sum(damage.end - damage.start for damage in damages), len(damages)
    times = "1 place" if places == 1 else f"{places} places"
    extent = f"{lost} bytes are lost in" if lost else "not whole in"
    return f"{extent} {times}: byte {damages[0].start}: {damages[0].reason}"


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
    return {_NOTE: f"{_FROM_DAMAGED}{losses}"}


def _describe(record: Mapping[str, str]) -> str:
    if record.get(CHECKSUM) != sum_up(record):
        raise LogError(f"metadata {RECOVERY}: damaged, its checksum does not match")
    lost = _decode(record, "lost", tuple[Loss, ...])
    missing = _decode(record, "missing", dict[str, int] | None)
    if missing is None:
        count = "nobody knows how many messages are lost"
    elif missing:
        count = "lost " + ", ".join(f"{count} of {topic}" for topic, count in missing.items())
    else:
        count = _NO_MESSAGE
    places = [f"byte {loss.start}: {loss.reason}" for loss in lost[:1]]
    if len(lost) > 1:
        places.append("1 more place" if len(lost) == 2 else f"{len(lost) - 1} more places")
    return f"{count} ({', and '.join(places)})" if places else count


def _decode(record: Mapping[str, str], key: str, kind: Any) -> Any:
    try:
        return msgspec.json.decode(record[key], type=kind)
    except (KeyError, msgspec.MsgspecError) as err:
        raise LogError(f"metadata {RECOVERY}: {key}: expected its JSON, found {err}") from err
