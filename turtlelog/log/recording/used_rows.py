"""The rows of a recording's topics while it is read, without what no run needs."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import numpy as np

from turtlelog.log.engine.decode import LOG_TIME, PUBLISH_TIME, SEQUENCE, Rows
from turtlelog.log.recording.topics import (
    COMMAND,
    MEASURED,
    PHASE,
    POSE64,
    REFERENCE,
    REFERENCE64,
    SENSED,
    SENSED64,
    SHAPED,
    VELOCITY64,
)

_FIELDS: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        **dict.fromkeys((POSE64.name, SENSED.name, SENSED64.name), ("x", "y", "theta")),
        **dict.fromkeys((VELOCITY64.name, MEASURED.name), ("linear.x", "angular.z")),
        **dict.fromkeys((PHASE.name, REFERENCE.name), ()),
        REFERENCE64.name: ("x", "y", "theta"),
        SHAPED.name: ("linear.x", "angular.z"),
        COMMAND.name: ("linear.x", "linear.y", "angular.z"),
    }
)
"""What is kept of topics of which a run needs only some fields: rows take their memory until it is
built."""


class UsedRows:
    """The rows of a topic, without what no run needs: each is copied once, to where it stays."""

    def __init__(self, topic: str, expected: int) -> None:
        self._topic, self._expected, self._used = topic, expected, 0
        self._columns: Rows = {}
        self._others: list[Rows] = []

    def take(self, part: Rows) -> None:
        """Add rows behind those that are there."""
        count = len(part[LOG_TIME])
        if not self._columns:
            rows = max(self._expected, count)
            # Of memory that is only set aside, none is taken before it is written to.
            self._columns = {
                name: np.empty((rows, *part[name].shape[1:]), part[name].dtype)
                for name in self._choose(part)
            }
        if self._others or not self._fits(part):
            self._others.append(part)  # of another type: what checks the types refuses it
            return
        start, self._used = self._used, self._used + count
        if self._used > len(self._columns[LOG_TIME]):
            self._resize(self._used + self._used // 8)
        for name, column in self._columns.items():
            column[start : self._used] = part[name]

    def finish(self) -> list[Rows]:
        """Return all rows."""
        if self._used < len(self._columns[LOG_TIME]):
            self._resize(self._used)
        return [{**self._columns, PUBLISH_TIME: self._columns[LOG_TIME]}, *self._others]

    def _choose(self, part: Rows) -> list[str]:
        if self._topic not in _FIELDS:
            return [name for name in part if name != PUBLISH_TIME]
        return [name for name in (LOG_TIME, SEQUENCE, *_FIELDS[self._topic]) if name in part]

    def _fits(self, part: Rows) -> bool:
        return all(
            name in part
            and part[name].dtype == column.dtype
            and part[name].shape[1:] == column.shape[1:]
            for name, column in self._columns.items()
        )

    def _resize(self, rows: int) -> None:
        for column in self._columns.values():
            column.resize((rows, *column.shape[1:]), refcheck=False)
