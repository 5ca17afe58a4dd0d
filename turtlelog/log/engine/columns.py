"""File -> columns, topic by topic: the one way in which messages are read."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.layout import Column
from turtlelog.log.engine.selection import (
    Piece,
    Selection,
    count_rows,
    iterate_pieces,
    select_topics,
)
from turtlelog.log.engine.source import Source
from turtlelog.log.engine.topic_columns import (
    LOG_TIME,
    PUBLISH_TIME,
    SEQUENCE,
    Rows,
    RowStore,
    join_rows,
    make_empty_rows,
)
from turtlelog.log.error_boundary import name_file, open_file

_MOST_BYTES: Final = 2**25  # of blocks in a batch: rows of images are large


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TopicColumns:
    """The messages of one topic, as columns in order of log time; equal times as in the file.

    Attributes:
        topic: Its name.
        type: Of its messages, as its schema calls it.
        log_time_ns: When each was recorded [ns], shape (n,).
        publish_time_ns: When each was published [ns], shape (n,).
        sequence: Number that the publisher gave each, shape (n,).
        fields: By dotted name in the order of the schema. A fixed array of k numbers has shape
            (n, k); a text is a `str`, a sequence of numbers an array, a sequence of texts a list,
            one of messages a list of dictionaries by dotted name, each in a column of objects.
    """

    topic: str
    type: str
    log_time_ns: NDArray[np.int64]
    publish_time_ns: NDArray[np.int64]
    sequence: NDArray[np.uint32]
    fields: Mapping[str, Column]

    def __len__(self) -> int:
        return len(self.log_time_ns)


def read_columns(
    path: str | Path,
    topics: Collection[str] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Mapping[str, TopicColumns]:
    """Return the messages of an MCAP file as columns, by topic in order of the topics' names.

    Where the file has an index, only chunks that hold something asked for are read. Every chunk
    that is read is held against its checksum, and the summary against its own.

    Args:
        path: The file.
        topics: Names of topics; None for all that can be understood, `read_info` lists the others.
        start_ns: Least log time [ns], inclusive.
        end_ns: Greatest log time [ns], exclusive.

    Raises:
        LogError: One line with the file and the place, where it cannot be read, is no MCAP, was
            never finished or is damaged, or a topic asked for is not there or not understood.
    """
    with name_file(path, expected="an MCAP file"), open_file(path) as stream:
        source = Source(stream)
        return collect_columns(source, select_topics(topics, start_ns, end_ns))


def read_flat_columns(path: str | Path, topics: Collection[str]) -> Mapping[str, TopicColumns]:
    """Return some topics as `read_columns` does, of types without sequences of texts or messages.

    Raises:
        LogError: As `read_columns`, and where a type has such a sequence.
    """
    with name_file(path, expected="an MCAP file"), open_file(path) as stream:
        selection = Selection(topics=frozenset(topics), is_flat=True)
        return collect_columns(Source(stream), selection)


def iter_columns(
    path: str | Path,
    *,
    rows: int = 65_536,
    topics: Collection[str] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Iterator[Mapping[str, TopicColumns]]:
    """Yield the messages of an MCAP file as columns, batch by batch, in bounded memory.

    Batches come in the order of the file, and each is sorted by log time within itself: where the
    times of chunks overlap, so do those of batches. A batch holds up to about `rows` messages of a
    topic, or fewer where messages are large, and only topics of which it has messages. Arguments
    and errors are those of `read_columns`.
    """
    if rows < 1:
        raise LogError(f"{path}: expected batches of at least one row, found {rows}")
    with name_file(path, expected="an MCAP file"), open_file(path) as stream:
        source, selection = Source(stream), select_topics(topics, start_ns, end_ns)
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


def collect_columns(source: Source, selection: Selection) -> Mapping[str, TopicColumns]:
    """Return the columns of an open file, those of topics without messages included."""
    expected = count_rows(source, selection)
    stores: dict[str, RowStore] = {}
    for piece in iterate_pieces(source, selection):
        for topic, found in piece.rows.items():
            if topic not in stores:
                stores[topic] = RowStore(expected.get(topic, 0))
            stores[topic].take(found)
    parts = {}
    for topic, plan in selection.choose_plans(source.catalogue).items():
        parts[topic] = stores[topic].parts if topic in stores else [make_empty_rows(plan)]
    return build_columns(parts, source.catalogue.types)


def build_columns(
    parts: Mapping[str, list[Rows]], types: Mapping[str, str]
) -> Mapping[str, TopicColumns]:
    """Return rows of topics as columns, in order of the topics' names; `types` says theirs."""
    topics = {}
    for topic in sorted(parts):
        rows = join_rows(parts[topic])
        topics[topic] = TopicColumns(
            topic=topic,
            type=types[topic],
            log_time_ns=rows.pop(LOG_TIME),
            publish_time_ns=rows.pop(PUBLISH_TIME),
            sequence=rows.pop(SEQUENCE),
            fields=MappingProxyType(rows),
        )
    return MappingProxyType(topics)


def _is_over(batch: Mapping[str, list[Rows]], piece: Piece, most_rows: int) -> bool:
    """Return whether a topic would have too many rows with this piece."""
    return any(
        sum(len(part[LOG_TIME]) for part in batch.get(topic, [])) + len(found[LOG_TIME]) > most_rows
        for topic, found in piece.rows.items()
    )
