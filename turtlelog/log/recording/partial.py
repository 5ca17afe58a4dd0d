"""Recordings of which something is lost: which rows still belong together."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.columns import TopicColumns
from turtlelog.log.engine.walk import Damage
from turtlelog.log.recording.contents import Contents
from turtlelog.log.recording.topics import CONTROL, POSE, POSE64, VELOCITY64


class PartialRecordingWarning(UserWarning):
    """Part of a recording could not be read, and the caller asked for the rest."""


def reconcile_contents(contents: Contents) -> tuple[Contents, str]:
    """Return contents whose rows belong together, and a clause on what that took; empty if nothing.

    The poses of a recording are numbered from 0, and a sample names the number of its own. Poses
    of which a column is lost, and samples whose pose is, are dropped; the rest are numbered anew.
    """
    topics = dict(contents.topics)
    pose_topics = [
        name
        for name in (POSE.name, POSE64.name, VELOCITY64.name)
        if name == POSE.name or len(topics[name])
    ]
    numbers = _intersect({name: topics[name] for name in pose_topics})
    for name in pose_topics:
        topics[name] = _take(topics[name], np.isin(topics[name].sequence, numbers))
    samples = topics[CONTROL.name]
    read = samples.fields["pose_sequence"]
    kept = _take(samples, np.isin(read, numbers))
    rows = np.searchsorted(numbers, kept.fields["pose_sequence"]).astype(np.uint32)
    fields = MappingProxyType({**kept.fields, "pose_sequence": rows})
    topics[CONTROL.name] = replace(kept, fields=fields)
    return replace(contents, topics=topics), _describe_dropped(len(samples) - len(kept))


def _intersect(topics: Mapping[str, TopicColumns]) -> NDArray[np.uint32]:
    numbers = topics[POSE.name].sequence
    for name, columns in topics.items():
        if (columns.sequence[1:] <= columns.sequence[:-1]).any():
            raise LogError(f"topic {name}: expected poses numbered in order, found others")
        numbers = np.intersect1d(numbers, columns.sequence)
    return numbers


def _take(columns: TopicColumns, rows: NDArray[np.bool_]) -> TopicColumns:
    return replace(
        columns,
        log_time_ns=columns.log_time_ns[rows],
        publish_time_ns=columns.publish_time_ns[rows],
        sequence=columns.sequence[rows],
        fields=MappingProxyType({name: values[rows] for name, values in columns.fields.items()}),
    )


def describe_damages(damages: Sequence[Damage]) -> str:
    """Say in one line how much is lost; the first place stands for all."""
    if not damages:
        return "no data is lost, only the summary is damaged"
    lost, places = sum(damage.end - damage.start for damage in damages), len(damages)
    times = "1 place" if places == 1 else f"{places} places"
    extent = f"{lost} bytes are lost in" if lost else "not whole in"
    return f"{extent} {times}: byte {damages[0].start}: {damages[0].reason}"


def _describe_dropped(samples: int) -> str:
    return f"; {samples} samples without their pose are dropped" if samples else ""
