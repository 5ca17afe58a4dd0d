"""A stream into a recording whose entities are drawn again and again while they grow."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import rerun as rr

from turtlelog.show.rerun import entities
from turtlelog.show.rerun.entities import join_path

_GROWTH = 64
"""What is sent anew as a whole waits until there are 1/64 more rows, so that all of it together
stays a small multiple of the rows."""

_WHOLE = (
    join_path(entities.PATH),
    join_path(entities.REFERENCE_PATH),
    join_path(entities.EVENT_PLACES),
    join_path(entities.REFERENCE),
)
_UNSETTLED = frozenset({join_path(entities.PHASE)})
"""Their last row says how the run ended."""


class GrowingStream(rr.RecordingStream):
    """Sends of every entity only what is new since it was drawn before.

    What draws a finished run draws a growing one with this: rows that were sent are left out, and
    so is what is static, but for the path, the places of events and the level lines, which
    grow at their ends.

    Attributes:
        is_due: Whether these are sent in this round.
    """

    def __init__(self, application_id: str) -> None:
        super().__init__(application_id, send_properties=False)
        self._sent: dict[str, int] = {}
        self._seen: dict[str, int] = {}
        self._logged: set[str] = set()
        self._rows = 0
        self.is_due, self._is_last = True, False

    def begin_round(self, rows: int, *, is_last: bool = False) -> None:
        """Begin to draw anew.

        Args:
            rows: How long the run is now.
            is_last: Whether this is what stays: then everything that may change is sent.
        """
        self._seen.clear()
        self._is_last = is_last
        self.is_due = is_last or rows > self._rows + self._rows // _GROWTH
        if self.is_due:
            self._rows = rows

    def log(self, entity_path: str | list[object], entity: Any, *more: Any, **options: Any) -> None:
        """Store what is static, where it is new or due."""
        name = str(entity_path)
        if name not in self._logged or self._is_last or self._is_whole_due(name):
            self._logged.add(name)
            super().log(entity_path, entity, *more, **options)

    def send_columns(
        self,
        entity_path: str,
        indexes: Iterable[Any],
        columns: Iterable[Any],
        *,
        strict: bool | None = None,
    ) -> None:
        """Send the rows that were not sent before."""
        index, values = list(indexes), list(columns)
        count = len(index[0].as_arrow_array())
        if entity_path.startswith(_WHOLE):
            if self._is_whole_due(entity_path) or entity_path not in self._sent:
                self._sent[entity_path] = count
                super().send_columns(entity_path, index, values, strict=strict)
            return
        first = self._seen.get(entity_path, 0)
        self._seen[entity_path] = first + count
        sent = self._sent.get(entity_path, 0)
        held = 1 if entity_path in _UNSETTLED and not self._is_last else 0
        start, end = max(sent - first, 0), count - held
        if start < end:
            self._sent[entity_path] = first + end
            parts: list[Any] = [_cut(column, start, end) for column in (*index, *values)]
            super().send_columns(
                entity_path, parts[: len(index)], parts[len(index) :], strict=strict
            )

    def _is_whole_due(self, name: str) -> bool:
        return self.is_due and name.startswith(_WHOLE)


@dataclass(frozen=True, slots=True)
class _Part:
    """Some rows of a column, as Rerun asks for them."""

    column: Any
    array: Any

    def timeline_name(self) -> str:
        return str(self.column.timeline_name())

    def component_descriptor(self) -> Any:
        return self.column.component_descriptor()

    def as_arrow_array(self) -> Any:
        return self.array


def _cut(column: Any, start: int, end: int) -> _Part:
    return _Part(column, column.as_arrow_array().slice(start, end - start))
