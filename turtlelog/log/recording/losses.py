"""What is lost of a recording: notes of it, a recovered file's record, rows that still match."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, Final

import msgspec
import numpy as np
from mcap.records import Metadata
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.columns import TopicColumns
from turtlelog.log.engine.walk import Loss
from turtlelog.log.recording.head import CHECKSUM, sum_up
from turtlelog.log.recording.topics import (
    CONTROL,
    LAW_STATE,
    POSE,
    POSE64,
    REFERENCE,
    REFERENCE64,
    VELOCITY64,
)
from turtlelog.loops import Declaration

RECOVERY: Final = "turtlelog_recovery"
"""Name of the metadata record that tells a recovered file from one that was always whole."""

_NOTE: Final = "recovered"


class PartialRecordingWarning(UserWarning):
    """Part of a recording could not be read, and the caller asked for the rest."""


def reconcile_topics(
    topics: Mapping[str, TopicColumns], declaration: Declaration | None
) -> tuple[Mapping[str, TopicColumns], str]:
    """Return topics whose rows belong together, and a clause on what that took; empty if nothing.

    The poses of a recording are numbered from 0, and a sample names the number of its own. Poses
    of which a column is lost, and samples whose pose, states or reference is, are dropped; the rest
    are numbered anew.
    """
    topics = dict(topics)
    pose_topics = [
        name
        for name in (POSE.name, POSE64.name, VELOCITY64.name)
        if name == POSE.name or len(topics[name])
    ]
    numbers = _intersect({name: topics[name] for name in pose_topics})
    for name in pose_topics:
        topics[name] = topics[name].select(np.isin(topics[name].sequence, numbers))
    samples = topics[CONTROL.name]
    read = samples.fields["pose_sequence"]
    kept = samples.select(np.isin(read, numbers))
    if declaration is not None:
        kept = _take_described(kept, topics, declaration)
    rows = np.searchsorted(numbers, kept.fields["pose_sequence"]).astype(np.uint32)
    fields = MappingProxyType({**kept.fields, "pose_sequence": rows})
    topics[CONTROL.name] = replace(kept, fields=fields)
    return topics, _describe_dropped(len(samples) - len(kept))


def _take_described(
    samples: TopicColumns, topics: dict[str, TopicColumns], declaration: Declaration
) -> TopicColumns:
    """Return the samples whose states and reference are there, and drop the rows of all others."""
    if declaration.states:
        samples = samples.select(np.isin(samples.fields["sequence"], topics[LAW_STATE].sequence))
    if declaration.has_reference:
        due = np.isin(samples.fields["phase"], _list_reference_phases(declaration))
        is_there = np.isin(samples.fields["sequence"], topics[REFERENCE64.name].sequence)
        samples = samples.select(is_there | ~due)
    for name in (LAW_STATE, REFERENCE.name, REFERENCE64.name):
        if name in topics:
            is_kept = np.isin(topics[name].sequence, samples.fields["sequence"])
            topics[name] = topics[name].select(is_kept)
    return samples


def _list_reference_phases(declaration: Declaration) -> list[int]:
    """Return the numbers of the phases in which every sample has a reference pose."""
    moved = {loop.name for loop in declaration.loops if loop.reference == "recorded"}
    phases = declaration.phases.values()
    return [number for number, loops in enumerate(phases) if not moved.isdisjoint(loops)]


def _intersect(topics: Mapping[str, TopicColumns]) -> NDArray[np.uint32]:
    numbers = topics[POSE.name].sequence
    for name, columns in topics.items():
        if (columns.sequence[1:] <= columns.sequence[:-1]).any():
            raise LogError(f"topic {name}: expected poses numbered in order, found others")
        numbers = np.intersect1d(numbers, columns.sequence)
    return numbers


def describe_damages(damages: Sequence[Loss]) -> str:
    """Say in one line how much is lost; the first place stands for all."""
    if not damages:
        return "no data is lost, only the summary is damaged"
    lost, places = sum(damage.end - damage.start for damage in damages), len(damages)
    times = "1 place" if places == 1 else f"{places} places"
    extent = f"{lost} bytes are lost in" if lost else "not whole in"
    return f"{extent} {times}: byte {damages[0].start}: {damages[0].reason}"


def _describe_dropped(samples: int) -> str:
    if not samples:
        return ""
    return f"; {samples} samples without their pose, states or reference are dropped"


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
