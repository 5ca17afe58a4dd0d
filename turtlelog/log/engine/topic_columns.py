"""Reading of the messages of a file as columns, topic by topic."""

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Integral
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import fit_line
from turtlelog.errors import LogError
from turtlelog.log.engine import decode
from turtlelog.log.engine.blocks import Block, Offsets, read_heads
from turtlelog.log.engine.message_types import Column
from turtlelog.log.engine.opening import open_source
from turtlelog.log.engine.source import Source
from turtlelog.log.engine.sqlite_source import SqliteSource
from turtlelog.log.file_access import DamageError
from turtlelog.run.tables import Tabular

_MOST_BYTES: Final = 2**25  # bytes of blocks in a batch: rows of images are large

# Columns of a topic may take this many times the bytes of the file before they are filled: a
# claimed number of messages is not trusted. An index has 16 bytes for each message; a row takes
# about 50.
_SHARE: Final = 16
_SPARE: Final = 2**22  # bytes for small files


_TIMES: Final = ("log_time_ns", "publish_time_ns", "sequence")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TopicColumns(Tabular):
    """The messages of one topic as columns, in order of log time, and at equal times of the file.

    Attributes:
        topic: Name of the topic.
        type: Message type, as named in its schema.
        log_time_ns: Log time of each message [ns], shape (n,).
        publish_time_ns: Publish time of each message [ns], shape (n,).
        sequence: Sequence number set by the publisher, shape (n,).
        fields: Columns by dotted name, in the order of the schema. A fixed array of k numbers has
            shape (n, k). Columns of objects contain texts as `str`, sequences of numbers as arrays,
            sequences of texts as lists, and sequences of messages as lists of dictionaries by
            dotted name. For JSON messages, an array is a list, and missing values are NaN, an empty
            text or None.
        stored: Key of the order of storage, shape (n,); None if that is the order of log time.
    """

    topic: str
    type: str
    log_time_ns: NDArray[np.int64]
    publish_time_ns: NDArray[np.int64]
    sequence: NDArray[np.uint32]
    fields: Mapping[str, Column]
    stored: NDArray[np.int64] | None = None

    def __len__(self) -> int:
        return len(self.log_time_ns)

    def select(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> "TopicColumns":
        """Return selected messages, in the given order."""
        return replace(
            self,
            log_time_ns=self.log_time_ns[rows],
            publish_time_ns=self.publish_time_ns[rows],
            sequence=self.sequence[rows],
            fields=decode.pick_rows(self.fields, rows),
            stored=None if self.stored is None else self.stored[rows],
        )

    def describe_missing(self, field: str) -> LogError:
        """Return the error about a field that the messages do not have."""
        return LogError(
            f"topic {self.topic}: expected {self.type} with a field {field}, found"
            f" {', '.join(self.fields)}"
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
    """Return the messages of an MCAP or SQLite file as columns, by topic in order of names.

    If the file has an index, only chunks with requested messages are read. The checksums of these
    chunks and of the summary are checked.

    Args:
        path: The file.
        topics: Names of topics. Default: all that can be decoded; `read_info` lists the others.
        start_ns: Start of the log time [ns], inclusive.
        end_ns: End of the log time [ns], exclusive.

    Raises:
        LogError: If the file cannot be read, is neither MCAP nor SQLite, is unfinished or damaged,
            or a requested topic is missing or cannot be decoded. One line with the file and the
            place.
    """
    with open_source(path) as source:
        return _collect_columns(source, _select_topics(topics, start_ns, end_ns))


def read_some_columns(
    path: str | Path, topics: Collection[str], *, is_flat: bool
) -> Mapping[str, TopicColumns]:
    """Return some topics as `read_columns` does, with memory limited by the file's size.

    Raises:
        LogError: As for `read_columns`, or if a type has a sequence, or there are too many rows.
    """
    with open_source(path) as source:
        selection = decode.Selection(topics=frozenset(topics), is_flat=is_flat, is_counted=True)
        return _collect_columns(source, selection)


def iter_columns(
    path: str | Path,
    *,
    rows: int = 65_536,
    topics: Collection[str] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Iterator[Mapping[str, TopicColumns]]:
    """Yield the messages of an MCAP or SQLite file as columns, in batches with bounded memory.

    Batches have the order of the file, and each batch is sorted by log time. If the times of chunks
    overlap, those of batches overlap too. A batch contains up to about `rows` messages per topic,
    or fewer if messages are large, and only topics with messages. Arguments and errors are those of
    `read_columns`.
    """
    if not isinstance(rows, Integral) or rows < 1:
        raise LogError(f"{path}: expected batches of at least one row, found {rows!r:.60}")
    with open_source(path) as source:
        selection = _select_topics(topics, start_ns, end_ns)
        batch: dict[str, list[decode.Rows]] = {}
        size, counts = 0, Counter[str]()
        for piece in iterate_pieces(source, selection, rows):
            new = Counter({topic: len(of[decode.LOG_TIME]) for topic, of in piece.rows.items()})
            is_over = any(count > rows for count in (counts + new).values())
            if batch and (size + piece.size > _MOST_BYTES or is_over):
                yield build_columns(batch, source.catalogue.types)
                batch, size, counts = {}, 0, Counter()
            size, counts = size + piece.size, counts + new
            for topic, found in piece.rows.items():
                batch.setdefault(topic, []).append(found)
        if batch:
            yield build_columns(batch, source.catalogue.types)


def iterate_heads(path: str | Path, start_ns: int, end_ns: int) -> Iterator[tuple[str, int]]:
    """Yield topic and log time [ns] of messages in the order of storage; contents are not decoded.

    The end of the interval of log times is exclusive.
    """
    with open_source(path) as source:
        for channels, log_ns in source.map_blocks(read_heads, None, start_ns, end_ns):
            known = source.catalogue.channels
            for channel, time_ns in zip(channels.tolist(), log_ns.tolist(), strict=True):
                if channel in known and start_ns <= time_ns < end_ns:
                    yield known[channel].topic, time_ns


def _collect_columns(
    source: Source | SqliteSource, selection: decode.Selection
) -> Mapping[str, TopicColumns]:
    """Return the columns of an open file, including topics without messages."""
    found = collect_parts(source, selection)
    plans = selection.choose_plans(source.catalogue)
    parts = {
        topic: found.get(topic) or [decode.make_empty_rows(plan)] for topic, plan in plans.items()
    }
    return build_columns(parts, source.catalogue.types)


def collect_parts(
    source: Source | SqliteSource,
    selection: decode.Selection,
    look: Callable[[decode.Piece], object] = lambda _: None,
) -> dict[str, list[decode.Rows]]:
    """Return the rows of topics with messages, in parts; `look` is called with each piece."""
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
    parts = {topic: [columns.finish()] for topic, columns in wholes.items() if columns.has_rows}
    for topic, store in stores.items():
        parts[topic] = [*parts.get(topic, []), *store.parts]
    return parts


def _set_aside(
    source: Source | SqliteSource, selection: decode.Selection, expected: Mapping[str, int]
) -> Mapping[str, decode.FixedColumns]:
    """Allocate columns for topics with messages of fixed size and a known count."""
    try:
        plans = selection.choose_plans(source.catalogue)
    except LogError:  # reported where the messages are read
        return {}
    most = _SHARE * source.size + _SPARE
    return {
        topic: decode.FixedColumns(plan.layout, expected[topic], selection.kept.get(topic))
        for topic, plan in plans.items()
        if plan.layout is not None
        and plan.json is None
        and topic in expected
        and expected[topic] * plan.layout.little.itemsize <= most
    }


def build_columns(
    parts: Mapping[str, list[decode.Rows]], types: Mapping[str, str]
) -> Mapping[str, TopicColumns]:
    """Return rows of topics as columns, in order of topic names and of log time.

    Rows with equal times keep their order. `types` are the message types.
    """
    topics = {}
    for topic, found in sorted(parts.items()):
        rows = found[0]
        if len(found) > 1:
            rows = {name: np.concatenate([part[name] for part in found]) for name in rows}
        times, stored = rows[decode.LOG_TIME], None
        if len(times) > 1 and (times[1:] < times[:-1]).any():
            stored = np.argsort(times, kind="stable")
            rows = decode.pick_rows(rows, stored)
        topics[topic] = TopicColumns(
            topic=topic,
            type=types[topic],
            log_time_ns=rows.pop(decode.LOG_TIME),
            publish_time_ns=rows.pop(decode.PUBLISH_TIME),
            sequence=rows.pop(decode.SEQUENCE),
            fields=rows,
            stored=stored,
        )
    return topics


def _select_topics(
    topics: Collection[str] | None, start_ns: int | None, end_ns: int | None
) -> decode.Selection:
    names = [topics] if isinstance(topics, str) else topics
    return decode.Selection(
        topics=None if names is None else frozenset(names),
        start_ns=0 if start_ns is None else start_ns,
        end_ns=decode.EVER if end_ns is None else end_ns,
    )


class _RowStore:
    """Rows of one topic, part by part. If their number is known, each row is copied once."""

    def __init__(self, expected: int) -> None:
        self._expected, self._used = expected, 0
        self._whole: decode.Rows = {}
        self._others: list[decode.Rows] = []

    def take(self, part: decode.Rows) -> None:
        """Append rows."""
        end = self._used + len(part[decode.LOG_TIME])
        # In JSON, one block may have floats where another has whole numbers.
        is_new = any(
            name in self._whole and self._whole[name].dtype != values.dtype
            for name, values in part.items()
        )
        if self._others or is_new or end > self._expected:
            self._others.append(part)
            return
        if not self._whole and end == self._expected:
            self._whole, self._used = part, end
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
    def parts(self) -> list[decode.Rows]:
        """All rows, as a single part if the expected number was right."""
        whole = [decode.pick_rows(self._whole, slice(self._used))] if self._used else []
        return [*whole, *self._others]


def iterate_pieces(
    source: Source | SqliteSource,
    selection: decode.Selection,
    most_rows: int | None = None,
    wholes: Mapping[str, decode.FixedColumns] = MappingProxyType({}),
) -> Iterator[decode.Piece]:
    """Yield the requested messages in file order, at most `most_rows` per topic in a piece.

    Messages of topics in `wholes` are stored there instead of in pieces, as long as there is room.
    """
    catalogue, channels = source.catalogue, None
    if source.is_indexed:
        selection.require_topics(catalogue)
        plans = selection.choose_plans(catalogue)
        known = catalogue.channels.values()
        if not selection.is_lenient:
            channels = {channel.id for channel in known if channel.topic in plans}
    counts: Counter[int] = Counter()

    def read(block: Block) -> list[decode.Piece]:
        parts = _split(block.offsets, most_rows)
        pieces = [
            decode.read_piece(catalogue, selection, block, offsets, wholes) for offsets in parts
        ]
        return [replace(pieces[0], rest=block.rest), *pieces[1:]]

    for pieces in source.map_blocks(read, channels, selection.start_ns, selection.end_ns):
        for piece in pieces:
            counts.update(piece.counts)
            yield piece
    if not source.is_indexed:  # the blocks have named the topics
        selection.require_topics(catalogue)
        selection.choose_plans(catalogue)
    if selection.is_ever:
        _check_counts(source, counts, channels)


def count_rows(source: Source | SqliteSource, selection: decode.Selection) -> Mapping[str, int]:
    """Return the rows of each topic by the statistics, limited by the message indexes, if any."""
    if source.statistics is None or not selection.is_ever:
        return {}
    room = source.index_length // 16 if source.is_indexed else decode.EVER
    counts: Counter[str] = Counter()
    for number, count in source.statistics.channel_message_counts.items():
        if number in source.catalogue:
            counts[source.catalogue.channels[number].topic] += min(count, room)
    return counts


def _split(
    offsets: Mapping[int, Offsets], most_rows: int | None
) -> Sequence[Mapping[int, Offsets]]:
    """Return the messages of a block in segments of at most `most_rows` messages per channel."""
    if most_rows is None or max(map(len, offsets.values()), default=0) <= most_rows:
        return [offsets]
    borders = np.unique(np.concatenate([found[most_rows::most_rows] for found in offsets.values()]))
    stretches: Sequence[dict[int, Offsets]] = [{} for _ in range(len(borders) + 1)]
    for channel, of in offsets.items():
        parts = np.split(of, np.searchsorted(of, borders))
        for stretch, part in zip(stretches, parts, strict=True):
            if len(part):
                stretch[channel] = part
    return stretches


def _check_counts(
    source: Source | SqliteSource, counts: Counter[int], channels: Collection[int] | None
) -> None:
    statistics = source.statistics
    for channel, expected in statistics.channel_message_counts.items() if statistics else ():
        if (channels is None or channel in channels) and counts[channel] != expected:
            raise DamageError(
                f"byte {source.summary_start}: channel {channel}: expected {expected} messages"
                f" as the statistics say, found {counts[channel]}"
            )
