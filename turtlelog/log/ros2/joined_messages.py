"""The messages of one topic from all files of a bag, and poses computed of them as messages."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.ros2.stamps import read_stamps

Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JoinedMessages:
    """Messages in order of log time.

    Attributes:
        topic: Their topic.
        type: Their type.
        log_ns: When each was recorded [ns], shape (n,).
        publish_ns: When each was published [ns], shape (n,).
        sequence: Number that the publisher gave each, shape (n,).
        stamp_ns: When each was stamped [ns], shape (n,); zeros where the type has no stamps.
        frame: In which they are, as the first one names it.
        fields: Those that were asked for, each of n rows.
    """

    topic: str
    type: str
    log_ns: NDArray[np.int64]
    publish_ns: NDArray[np.int64]
    sequence: NDArray[np.uint32]
    stamp_ns: NDArray[np.int64]
    frame: str
    fields: Mapping[str, NDArray[Any]]

    def __len__(self) -> int:
        return len(self.log_ns)

    @property
    def motion_s(self) -> Values:
        """Time of the motion [s], shape (n,): stamps that rise, or else log times."""
        is_usable = len(self) and (self.stamp_ns > 0).all() and (np.diff(self.stamp_ns) >= 0).all()
        time_ns = self.stamp_ns if is_usable else self.log_ns
        return np.asarray((time_ns - time_ns[:1]) / 1e9)

    def make_poses(self, rows: NDArray[np.int64], columns: Mapping[str, Values]) -> TopicColumns:
        """Return poses that were computed of some messages, as if the topic had held them."""
        stamp_ns = self.stamp_ns[rows]
        return TopicColumns(
            topic=self.topic,
            type=self.type,
            log_time_ns=self.log_ns[rows],
            publish_time_ns=self.publish_ns[rows],
            sequence=self.sequence[rows],
            fields={
                "header.stamp.sec": stamp_ns // 1_000_000_000,
                "header.stamp.nanosec": stamp_ns % 1_000_000_000,
                **columns,
            },
        )


def join_messages(found: Sequence[TopicColumns], names: Sequence[str]) -> JoinedMessages:
    """Return the messages of a topic in all files.

    Args:
        found: Of each file, at least one.
        names: Of the fields that are wanted.

    Raises:
        LogError: Where a field is missing.
    """
    for columns in found:
        for name in names:
            if name not in columns.fields:
                raise LogError(
                    f"topic {columns.topic}: expected {columns.type} with a field {name}, found"
                    f" {', '.join(columns.fields)}"
                )
    log_ns = np.concatenate([columns.log_time_ns for columns in found])
    order = np.argsort(log_ns, kind="stable")
    stamps = [read_stamps(columns) for columns in found]
    known = [of_file for of_file in stamps if of_file is not None]
    stamp_ns = np.concatenate(known) if len(known) == len(found) else np.zeros_like(log_ns)
    frames = [columns.fields.get("header.frame_id") for columns in found]
    named = [str(column[0]).lstrip("/") for column in frames if column is not None and len(column)]
    return JoinedMessages(
        topic=found[0].topic,
        type=found[0].type,
        log_ns=log_ns[order],
        publish_ns=np.concatenate([columns.publish_time_ns for columns in found])[order],
        sequence=np.concatenate([columns.sequence for columns in found])[order],
        stamp_ns=stamp_ns[order],
        frame=[*named, ""][0],
        fields={
            name: np.concatenate([np.asarray(columns.fields[name]) for columns in found])[order]
            for name in names
        },
    )
