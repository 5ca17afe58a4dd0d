"""One run's way into a recording: below its prefix, on its clock, in chunks that Rerun likes."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Final

import numpy as np
import rerun as rr
from numpy.typing import ArrayLike, NDArray

from turtlelog.run import Run
from turtlelog.show.rerun.entities import join_path
from turtlelog.show.rerun.timelines import Clock, Times, build_index
from turtlelog.show.thinning import choose_rows

Values = NDArray[np.float64]

CHUNK_ROWS: Final = 65_536
"""Rows sent at once; Rerun takes longer for each row of larger chunks."""

MOST_ROWS: Final = 2**20
"""Rows of a table up to which every one is drawn."""

THINNED_ROWS: Final = 2**18
"""About how many rows of longer tables are drawn."""

TRACE_ROWS: Final = 2**16
"""About how many poses a trace in the plane is drawn through."""


class RunStream:
    """Sends what is drawn of one run.

    Attributes:
        stream: The recording.
        prefix: Entity prefix of the run, empty where it stands alone.
        clock: What its times are called.
    """

    def __init__(self, stream: rr.RecordingStream, prefix: str, clock: Clock) -> None:
        self.stream, self.prefix, self.clock = stream, prefix, clock
        # Many curves share their times: their index columns are built once.
        self._indexes: dict[int, tuple[Times, list[list[rr.TimeColumn]]]] = {}

    def log(self, entity: str, archetype: rr.AsComponents) -> None:
        """Store what holds at all times."""
        self.stream.log(join_path(self.prefix, entity), archetype, static=True)

    def send(
        self,
        entity: str,
        time_ns: Times,
        values: Values,
        build: Callable[[Values], rr.ComponentColumnList],
    ) -> None:
        """Send a row per time of the run [ns], `build` making columns of values, shape (n, ...)."""
        rows = choose_rows(values, THINNED_ROWS) if len(values) > MOST_ROWS else None
        if rows is not None:
            time_ns, values = time_ns[rows], values[rows]
        path = join_path(self.prefix, entity)
        for part, index in zip(_split(len(values)), self._find_indexes(time_ns), strict=True):
            self.stream.send_columns(path, index, build(values[part]))

    def send_few(self, entity: str, time_ns: ArrayLike, columns: rr.ComponentColumnList) -> None:
        """Send columns of a few rows as they are."""
        times = self.clock.read(np.asarray(time_ns, dtype=np.int64))
        self.stream.send_columns(join_path(self.prefix, entity), build_index(times), columns)

    def _find_indexes(self, time_ns: Times) -> list[list[rr.TimeColumn]]:
        known = self._indexes.get(id(time_ns))
        if known is None:
            times = self.clock.read(time_ns)
            parts = _split(len(time_ns))
            known = (
                time_ns,
                [build_index({name: read[part] for name, read in times.items()}) for part in parts],
            )
            self._indexes[id(time_ns)] = known
        return known[1]


def choose_trace_rows(run: Run) -> NDArray[np.int64]:
    """Return the poses that a trace in the plane is drawn through."""
    rows = choose_rows(run.poses.xy_m, TRACE_ROWS)
    return np.arange(len(run.poses)) if rows is None else rows


def add_thinning(documents: Mapping[str, str], runs: Sequence[Run]) -> Mapping[str, str]:
    """Return documents with one more that says what the pictures leave out, if anything."""
    text = _describe_thinning(runs)
    return {**documents, "Drawn": text} if text else documents


def _describe_thinning(runs: Sequence[Run]) -> str:
    tables = [table for run in runs for table in (run.poses, run.samples, run.commands)]
    poses, longest = max(len(run.poses) for run in runs), max(map(len, tables))
    drawn = []
    if poses > TRACE_ROWS:
        drawn.append(f"traces about {TRACE_ROWS:,} of up to {poses:,} poses")
    if longest > MOST_ROWS:
        drawn.append(f"curves about {THINNED_ROWS:,} of up to {longest:,} rows")
    if not drawn:
        return ""
    kept = "of every stretch the first row, the least and the greatest value"
    return f"Drawn are of {' and of '.join(drawn)}: {kept}. Metrics are of all."


def _split(count: int) -> Iterator[slice]:
    return (slice(start, start + CHUNK_ROWS) for start in range(0, count, CHUNK_ROWS))
