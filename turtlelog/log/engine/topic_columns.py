"""File -> columns, topic by topic: the one way to read messages."""

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import fit_line
from turtlelog.errors import LogError
from turtlelog.log.engine.decode import (
    LOG_TIME,
    PUBLISH_TIME,
    SEQUENCE,
    FixedColumns,
    Rows,
    make_empty_rows,
    pick_rows,
)
from turtlelog.log.engine.message_types import Column
from turtlelog.log.engine.opening import open_source
from turtlelog.log.engine.source import EVER, Piece, Selection, Source, count_rows, iterate_pieces
from turtlelog.log.engine.sqlite_source import SqliteSource
from turtlelog.run.tables import Tabular

_MOST_BYTES: Final = 2**25  # of blocks in a batch: rows of images are large

# Columns of a topic may take so many times the bytes of the file before they are filled: no one is
# believed who promises more. An index has 16 bytes for each message, whose row takes some 50.
_SHARE: Final = 16
_SPARE: Final = 2**22  # bytes; of small files


_TIMES: Final = ("log_time_ns", "publish_time_ns", "sequence")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TopicColumns(Tabular):
    """The messages of one topic, as columns in order of log time; equal times as in the file.

    Attributes:
        topic: Its name.
        type: Of its messages, as its schema calls it.
        log_time_ns: When each was recorded [ns], shape (n,).
        publish_time_ns: When each was published [ns], shape (n,).
        sequence: Number that the publisher gave each, shape (n,).
        fields: By dotted name in the order of the schema. A fixed array of k numbers has shape
            (n, k); a text is a `str`, a sequence of numbers an array, a sequence of texts a list,
            one of messages a list of dictionaries by dotted name, each in a column of objects. Of
            messages in JSON an array is a list, and what a message lacks NaN, an empty text or
            None.
    """

    topic: str
    type: str
    log_time_ns: NDArray[np.int64]
    publish_time_ns: NDArray[np.int64]
    sequence: NDArray[np.uint32]
    fields: Mapping[str, Column]

    def __len__(self) -> int:
        return len(self.log_time_ns)

    def select(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> "TopicColumns":
        """Return some of the messages, or all of them in another order."""
        return replace(
            self,
            log_time_ns=self.log_time_ns[rows],
            publish_time_ns=self.publish_time_ns[rows],
            sequence=self.sequence[rows],
            fields=pick_rows(self.fields, rows),
        )

    def _tabulate(self) -> Mapping[str, Any]:
        own = {name: getattr(self, name) for name in _TIMES}
        named = {f"message.{key}" if key in own else key: one for key, one in self.fields.items()}
        return own | named

    def _list_units(self) -> Mapping[str, str]:
        return dict.fromkeys(_TIMES[:2], "ns")

    def __repr__(self) -> str:
        names = ", ".join(self.fields)
        return fit_line(f"<TopicColumns {self.topic}: {len(self)} of {self.type}: {names}>")


def read_columns(
    path: str | Path,
    topics: Collection[str] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Mapping[str, TopicColumns]:
    """Return the messages of a file, MCAP or SQLite, as columns: by topic, in order of names.

    Where the file has an index, only chunks that hold something asked for are read. Every chunk
    that is read is held against its checksum, and the summary against its own.

    Args:
        path: The file.
        topics: Names of topics; None for all that can be understood, `read_info` lists the others.
        start_ns: Least log time [ns], inclusive.
        end_ns: Greatest log time [ns], exclusive.

    Raises:
        LogError: One line with the file and the place, where it cannot be read, is neither, was
            never finished or is damaged, or a topic asked for is not there or not understood.
    """
    with open_source(path) as source:
        return collect_columns(source, _select_topics(topics, start_ns, end_ns))


def read_some_columns(
    path: str | Path, topics: Collection[str], *, is_flat: bool
) -> Mapping[str, TopicColumns]:
    """Return some topics as `read_columns` does, where they take no more than the file's size lets.

    Args:
        path: The file.
        topics: Their names.
        is_flat: Whether their types must have no sequences of texts or messages.

    Raises:
        LogError: As `read_columns`, and where a type has such a sequence or there are too many.
    """
    with open_source(path) as source:
        selection = Selection(topics=frozenset(topics), is_flat=is_flat, is_counted=True)
        return collect_columns(source, selection)


def iter_columns(
    path: str | Path,
    *,
    rows: int = 65_536,
    topics: Collection[str] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Iterator[Mapping[str, TopicColumns]]:
    """Yield the messages of a file, MCAP or SQLite, as columns, batch by batch, in bounded memory.

    Batches come in the order of the file, and each is sorted by log time within itself: where the
    times of chunks overlap, so do those of batches. A batch holds up to about `rows` messages of a
    topic, or fewer where messages are large, and only topics of which it has messages. Arguments
    and errors are those of `read_columns`.
    """
    if rows < 1:
        raise LogError(f"{path}: expected batches of at least one row, found {rows}")
    with open_source(path) as source:
        selection = _select_topics(topics, start_ns, end_ns)
        batch: dict[str, list[Rows]] = {}
        size = 0
        for piece in iterate_pieces(source, selection, rows):
            if batch and (size + piece.size > _MOST_BYTES or _is_over(batch, piece, rows)):
                yield build_columns(batch, source.catalogue.types)
                batch, size = {}, 0
            size += piece.size
            for topic, found in piece.rows.items():
                batch.setdefault(topic, []).append(found)
        if batch:
            yield build_columns(batch, source.catalogue.types)


def collect_columns(
    source: Source | SqliteSource, selection: Selection
) -> Mapping[str, TopicColumns]:
    """Return the columns of an open file, those of topics without messages included."""
    found = collect_parts(source, selection)
    plans = selection.choose_plans(source.catalogue)
    parts = {topic: found.get(topic) or [make_empty_rows(plan)] for topic, plan in plans.items()}
    return build_columns(parts, source.catalogue.types)


def collect_parts(
    source: Source | SqliteSource,
    selection: Selection,
    look: Callable[[Piece], object] = lambda _: None,
) -> dict[str, list[Rows]]:
    """Return the rows of topics that have some, in parts; `look` is called with every piece."""
    expected = count_rows(source, selection)
    wholes = _set_aside(source, selection, expected)
    stores: dict[str, _RowStore] = {}
    for piece in iterate_pieces(source, selection, wholes=wholes):
        look(piece)
        for topic, found in piece.rows.items():
            if topic not in stores:
                promised = expected.get(topic, 0) if source.is_indexed else 0
                stores[topic] = _RowStore(0 if topic in wholes else promised)
            stores[topic].take(found)
    parts: dict[str, list[Rows]] = {}
    for topic, columns in wholes.items():
        if columns.has_rows:
            parts[topic] = [columns.finish()]
    for topic, store in stores.items():
        parts[topic] = [*parts.get(topic, []), *store.parts]
    return parts


def _set_aside(
    source: Source | SqliteSource, selection: Selection, expected: Mapping[str, int]
) -> Mapping[str, FixedColumns]:
    """Return columns for topics whose messages have one size and whose number is promised."""
    try:
        plans = selection.choose_plans(source.catalogue)
    except LogError:  # said where they are read
        return {}
    most = _SHARE * source.size + _SPARE
    return {
        topic: FixedColumns(plan.layout, expected[topic], selection.kept.get(topic))
        for topic, plan in plans.items()
        if plan.layout is not None
        and plan.json is None
        and topic in expected
        and expected[topic] * plan.layout.little.itemsize <= most
    }


def _join_rows(parts: list[Rows]) -> Rows:
    """Return the rows of all parts in order of log time; those of one time keep their order."""
    if len(parts) == 1:
        rows = parts[0]
    else:
        rows = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    times = rows[LOG_TIME]
    if len(times) > 1 and (times[1:] < times[:-1]).any():
        rows = pick_rows(rows, np.argsort(times, kind="stable"))
    return rows


def build_columns(
    parts: Mapping[str, list[Rows]], types: Mapping[str, str]
) -> Mapping[str, TopicColumns]:
    """Return rows of topics as columns, in order of the topics' names; `types` says theirs."""
    topics = {}
    for topic in sorted(parts):
        rows = _join_rows(parts[topic])
        topics[topic] = TopicColumns(
            topic=topic,
            type=types[topic],
            log_time_ns=rows.pop(LOG_TIME),
            publish_time_ns=rows.pop(PUBLISH_TIME),
            sequence=rows.pop(SEQUENCE),
            fields=rows,
        )
    return topics


def _select_topics(
    topics: Collection[str] | None, start_ns: int | None, end_ns: int | None
) -> Selection:
    """Return a selection; None takes all."""
    names = [topics] if isinstance(topics, str) else topics
    return Selection(
        topics=None if names is None else frozenset(names),
        start_ns=0 if start_ns is None else start_ns,
        end_ns=EVER if end_ns is None else end_ns,
    )


def _is_over(batch: Mapping[str, list[Rows]], piece: Piece, most_rows: int) -> bool:
    """Return whether a topic would have too many rows with this piece."""
    return any(
        sum(len(part[LOG_TIME]) for part in batch.get(topic, [])) + len(found[LOG_TIME]) > most_rows
        for topic, found in piece.rows.items()
    )


class _RowStore:
    """Rows of one topic, part by part; where their number is known, each is copied only once."""

    def __init__(self, expected: int) -> None:
        self._expected, self._used = expected, 0
        self._whole: Rows = {}
        self._others: list[Rows] = []

    def take(self, part: Rows) -> None:
        """Add rows behind those that are there."""
        end = self._used + len(part[LOG_TIME])
        # Of JSON a block may have floats where others have whole numbers.
        is_new = any(
            name in self._whole and self._whole[name].dtype != values.dtype
            for name, values in part.items()
        )
        if self._others or is_new or end > self._expected:
            self._others.append(part)
            return
        if not self._whole:
            self._whole = {
                name: np.empty((self._expected, *values.shape[1:]), values.dtype)
                for name, values in part.items()
            }
        for name, values in part.items():
            self._whole[name][self._used : end] = values
        self._used = end

    @property
    def parts(self) -> list[Rows]:
        """All rows, in one part where their number was right."""
        whole = [pick_rows(self._whole, slice(self._used))] if self._used else []
        return [*whole, *self._others]
