"""The stream of a recording: its file, complete or absent; properties; timelines and rows of runs.

Nothing in a recording depends on the wall clock.
"""

import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import ArrayLike, NDArray

from turtlelog.charts.curves import Values, choose_rows
from turtlelog.charts.time_plots import TIMELINE, WALL_TIMELINE, find_phase_zeros
from turtlelog.compare import name_runs
from turtlelog.display import join_words
from turtlelog.draw.rerun.entities import APPLICATION_ID, TICKS, join_path, name_document
from turtlelog.errors import ShowError
from turtlelog.files.urls import make_path
from turtlelog.log import replace_when_complete
from turtlelog.measure import Metric
from turtlelog.run import Parameter, Run

_PATIENCE_S: Final = 5.0  # time without growth after which a file counts as stuck [s]

_DISCONNECT_S: Final = 1.0
_END: Final = b"RRF2FOOT"
_END_BYTES: Final = 64
_PROBE: Final = bytes(2**20)
_STRICT_LOCK: Final = threading.Lock()
_BEFORE_STRICT: Final[list[bool]] = []  # earlier settings, one for each active block of strict mode


@contextmanager
def open_recording(
    path: str | Path, *, name: str, layout: rrb.Blueprint
) -> Iterator[rr.RecordingStream]:
    """Yield a stream to a file with its name when complete; ShowError if it cannot be written."""
    path = make_path(path)
    with replace_when_complete(path, raising=ShowError) as part_path, strict_mode():
        # The properties that Rerun would send contain the wall-clock time.
        stream = rr.RecordingStream(APPLICATION_ID, send_properties=False)
        require_enabled(stream, str(path))
        stream.set_log_time_enabled(False)
        try:
            _await(lambda: stream.save(part_path, default_blueprint=layout), part_path, path)
            stream.send_recording_name(name)
            yield stream
            _await(stream.flush, part_path, path)
            _await(stream.disconnect, part_path, path)
        except BaseException:
            abandon_stream(stream)
            raise
        # Rerun does not fail if the disk is full at the very end of the file.
        with part_path.open("rb") as file:
            file.seek(max(part_path.stat().st_size - _END_BYTES, 0))
            end = file.read()
        if _END not in end:
            raise _find_error(part_path, path, "a file without its end" if end else "none")


def require_enabled(stream: rr.RecordingStream, name: str) -> None:
    """Raise ShowError if the environment disables Rerun."""
    if not rr.is_enabled(stream):
        found = f"found RERUN={os.environ.get('RERUN', '')!r} in the environment"
        raise ShowError(f"{name}: expected Rerun to be switched on, {found}")


def abandon_stream(stream: rr.RecordingStream) -> None:
    """End a stream without waiting for a viewer that hangs, unlike Rerun, which waits forever.

    A waiting thread keeps the stream, because dropping the stream would wait too.
    """
    thread = threading.Thread(target=stream.disconnect, name="disconnect", daemon=True)
    thread.start()
    thread.join(_DISCONNECT_S)
    if thread.is_alive():
        rr.unregister_shutdown()


@contextmanager
def strict_mode() -> Iterator[None]:
    """Make Rerun raise errors within the block. By default, Rerun warns and drops the data.

    All threads share the setting: the last block to end restores it.
    """
    with _STRICT_LOCK:
        _BEFORE_STRICT.append(_BEFORE_STRICT[0] if _BEFORE_STRICT else rr.strict_mode())
        rr.set_strict_mode(True)
    try:
        yield
    finally:
        with _STRICT_LOCK:
            before = _BEFORE_STRICT.pop()
            if not _BEFORE_STRICT:
                rr.set_strict_mode(before)


def send_run_properties(
    stream: rr.RecordingStream, run: Run, metrics: Mapping[str, Metric]
) -> None:
    """Store properties of a run, its scenario, and its metrics, each with a name."""
    _send_properties(stream, "run", _describe_runs([run]), [run], [metrics])


def send_comparison_properties(
    stream: rr.RecordingStream,
    runs: Sequence[Run],
    names: Sequence[str],
    prefixes: Sequence[str],
    metrics: Sequence[Mapping[str, Metric]],
) -> None:
    """Store the properties of several runs as lists, in the given order.

    Unknown numbers, and numbers that a run's law does not have, are NaN. Unknown texts are empty.
    """
    of_runs = _describe_runs(runs) | {"name": list(names), "entity": list(prefixes)}
    _send_properties(stream, "runs", of_runs, runs, metrics)


def draw_documents(stream: rr.RecordingStream, documents: Mapping[str, str]) -> None:
    """Store Markdown documents by title."""
    for title, text in documents.items():
        document = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
        stream.log(name_document(title), document, static=True)


class _Properties(rr.AsComponents):
    """Values by name.

    Rerun's own `AnyValues` would fix the type of a name for the whole process.
    """

    def __init__(self, values: Mapping[str, list[Any]]) -> None:
        self._values = values

    def as_component_batches(self) -> list[rr.DescribedComponentBatch]:
        return [
            rr.DescribedComponentBatch(_Values(pa.array(values)), rr.ComponentDescriptor(name))
            for name, values in self._values.items()
        ]


class _Values:
    """An Arrow array in the form that Rerun requires."""

    def __init__(self, array: pa.Array) -> None:
        self._array = array

    def as_arrow_array(self) -> pa.Array:
        return self._array


def _await(call: Callable[[], None], part_path: Path, path: Path) -> None:
    """Call Rerun and wait as long as its file grows. On a full disk, the call may never return."""
    failures: list[Exception] = []

    def attempt() -> None:
        try:
            call()
        except Exception as err:
            failures.append(err)

    thread = threading.Thread(target=attempt, name="rerun", daemon=True)
    thread.start()
    thread.join(_PATIENCE_S)
    size = -1
    while thread.is_alive():
        before, size = size, part_path.stat().st_size
        if size == before:
            raise _find_error(part_path, path, "no end of writing")
        thread.join(_PATIENCE_S)
    for err in failures:
        raise _find_error(part_path, path, str(err)) from err


def _find_error(part_path: Path, path: Path, found: str) -> ShowError | OSError:
    """Return Rerun's error: on a full disk, writing again causes the error again."""
    try:
        with part_path.open("ab") as stream:
            stream.write(_PROBE)
    except OSError as err:
        return err
    return ShowError(f"{path}: expected Rerun to write the file, found: {found}")


def _send_properties(
    stream: rr.RecordingStream,
    kind: str,
    of_runs: dict[str, list[Any]],
    runs: Sequence[Run],
    metrics: Sequence[Mapping[str, Metric]],
) -> None:
    stream.send_property(kind, _Properties(of_runs))
    keys = sorted({key for run in runs for key in run.parameters})
    if keys:
        found = {key: _fill([run.parameters.get(key) for run in runs]) for key in keys}
        stream.send_property("scenario", _Properties(found))
    ids = dict.fromkeys(name for known in metrics for name in known)
    measured = {
        name: [known[name].value if name in known else None for known in metrics] for name in ids
    }
    values = {name: _fill(of_each) for name, of_each in measured.items()}
    stream.send_property("metrics", _Properties(values))


def _describe_runs(runs: Sequence[Run]) -> dict[str, list[Any]]:
    return {
        "name": [run.name for run in runs],
        "source": [run.source for run in runs],
        "stop_reason": [run.stop_reason or "unknown" for run in runs],
        "start_ns": [run.start_ns for run in runs],
    }


def _fill(values: Sequence[Parameter | None]) -> list[float] | list[str]:
    """Return one value per run: numbers and booleans as floats; texts, if any is not a number."""
    known = [float(one) if isinstance(one, bool | int | float) else one for one in values]
    numbers = [one for one in known if one is None or isinstance(one, float)]
    if len(numbers) == len(known):
        return [float("nan") if one is None else one for one in numbers]
    return ["" if one is None else str(one) for one in known]


Times = NDArray[np.int64]

_SHARE_BEYOND: Final = 16

CHUNK_ROWS: Final = 65_536
"""Number of rows sent at once. For larger chunks, Rerun takes more time per row."""

MOST_ROWS: Final = 2**18
"""Largest number of rows of a table that are all drawn; longer tables are thinned to about this
number.

The number is a hundred for each pixel of a wide screen. A million samples in full took four times
as many bytes.
"""

TRACE_ROWS: Final = 2**16  # approximate number of poses of a trace in the plane

MOST_BORDERS: Final = 2**14
"""Largest number of borders of phases and events that are kept exactly.

The rows next to borders are at most an eighth of the rows of a curve. More borders would be closer
together than pixels."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Timelines:
    """The times of a run on each timeline. All timelines except the first are optional.

    Times are the run's own. Borders are those of phases and events, increasing; long curves keep
    the rows next to them.
    """

    zero_ns: int  # zero of `sim_time` [ns]
    tick_ns: Times | None = None  # times of the poses [ns], shape (n,); the indices are ticks
    starts_ns: Mapping[str, int] = field(default_factory=dict)  # zeros of phases by timeline [ns]
    epoch_ns: int | None = None  # time from 1970 UTC to the run's time 0 [ns]
    borders_ns: Times = field(default_factory=lambda: np.zeros(0, dtype=np.int64))  # [ns]

    def read(self, time_ns: Times) -> dict[str, Times]:
        """Return the run's own times [ns], shape (n,), converted to each timeline."""
        read = {TIMELINE: time_ns - self.zero_ns}
        if time_ns is self.tick_ns:
            read[TICKS] = np.arange(len(time_ns), dtype=np.int64)
        elif self.tick_ns is not None:  # the last pose at or before each time
            read[TICKS] = np.searchsorted(self.tick_ns, time_ns, side="right") - 1
        for name, start_ns in self.starts_ns.items():
            read[name] = time_ns - start_ns
        if self.epoch_ns is not None:
            read[WALL_TIMELINE] = time_ns + self.epoch_ns
        return read


def build_run_timelines(run: Run) -> Timelines:
    """Return the timelines of a single run, including ticks; for an import, also wall time."""
    return Timelines(
        zero_ns=run.start_ns,
        tick_ns=run.poses.time_ns,
        epoch_ns=run.origin.began_ns,
        borders_ns=_find_borders(run),
    )


def build_compared_timelines(run: Run) -> Timelines:
    """Return the timelines of a run among others: from its first sample, and from later phases."""
    return Timelines(
        zero_ns=run.start_ns, starts_ns=find_phase_zeros(run), borders_ns=_find_borders(run)
    )


def read_span(runs: Sequence[Run], timelines: Sequence[Timelines]) -> dict[str, Times]:
    """Return the first time of all runs, and slightly more than the last, on each timeline."""
    spans: dict[str, list[Times]] = {}
    for run, own in zip(runs, timelines, strict=True):
        firsts = (
            table.time_ns[0] for table in (run.poses, run.samples, run.commands) if len(table)
        )
        for name, read in own.read(np.array([min(firsts), run.end_ns])).items():
            spans.setdefault(name, []).append(read)
    ends = {name: (int(np.min(found)), int(np.max(found))) for name, found in spans.items()}
    # Without the addition, the last phase would not be visible.
    return {
        name: np.array([first, last + (last - first) // _SHARE_BEYOND])
        for name, (first, last) in ends.items()
    }


def build_index(times: Mapping[str, Times]) -> list[rr.TimeColumn]:
    """Return index columns in whole nanoseconds, because seconds would be truncated."""
    columns = []
    for name, values in times.items():
        if name == TICKS:
            columns.append(rr.TimeColumn(name, sequence=values))
        elif name == WALL_TIMELINE:
            columns.append(rr.TimeColumn(name, timestamp=values.astype("datetime64[ns]")))
        else:
            columns.append(rr.TimeColumn(name, duration=values.astype("timedelta64[ns]")))
    return columns


class RunStream:
    """Stream of the drawn data of one run; its entity prefix is empty if it is the only run."""

    def __init__(self, stream: rr.RecordingStream, prefix: str, timelines: Timelines) -> None:
        self.stream, self.prefix, self.timelines = stream, prefix, timelines
        # Many curves share their times, so their index columns are built once.
        self._indexes: dict[int, tuple[Times, list[list[rr.TimeColumn]]]] = {}

    def log(self, entity: str, archetype: rr.AsComponents, *, static: bool = True) -> None:
        """Store data that are valid at all times if they are static, as by default."""
        self.stream.log(join_path(self.prefix, entity), archetype, static=static)

    def send(
        self,
        entity: str,
        time_ns: Times,
        values: Values,
        build: Callable[[Values], rr.ComponentColumnList],
    ) -> None:
        """Send a row per time of the run [ns]; `build` makes columns of values, shape (n, ...)."""
        time_ns, values = self.thin(time_ns, values)
        path = join_path(self.prefix, entity)
        for part, index in zip(_split(len(values)), self._find_indexes(time_ns), strict=True):
            self.stream.send_columns(path, index, build(values[part]))

    def thin(self, time_ns: Times, values: Values) -> tuple[Times, Values]:
        """Return the rows that `send` sends; many rows are thinned."""
        if len(values) <= MOST_ROWS:
            return time_ns, values
        beside = _find_beside(time_ns, self.timelines.borders_ns)
        rows = choose_rows(values, MOST_ROWS, always=beside)
        return time_ns[rows], values[rows]

    def send_few(self, entity: str, time_ns: ArrayLike, columns: rr.ComponentColumnList) -> None:
        """Send columns of a few rows unchanged."""
        times = self.timelines.read(np.asarray(time_ns, dtype=np.int64))
        self.stream.send_columns(join_path(self.prefix, entity), build_index(times), columns)

    def _find_indexes(self, time_ns: Times) -> list[list[rr.TimeColumn]]:
        known = self._indexes.get(id(time_ns))
        if known is None:
            times = self.timelines.read(time_ns)
            parts = _split(len(time_ns))
            known = (
                time_ns,
                [build_index({name: read[part] for name, read in times.items()}) for part in parts],
            )
            self._indexes[id(time_ns)] = known
        return known[1]


def choose_trace_rows(run: Run) -> NDArray[np.int64]:
    """Return the indices of the poses of a trace in the plane."""
    poses = run.poses
    beside = _find_beside(poses.time_ns, _find_borders(run)) if len(poses) > TRACE_ROWS else None
    rows = choose_rows(poses.xy_m, TRACE_ROWS, always=beside)
    return np.arange(len(run.poses)) if rows is None else rows


def add_thinning(documents: Mapping[str, str], runs: Sequence[Run]) -> Mapping[str, str]:
    """Return documents, with one more on the data that pictures leave out, if any."""
    tables = [table for run in runs for table in (run.poses, run.samples, run.commands)]
    poses, longest = max(len(run.poses) for run in runs), max(map(len, tables))
    drawn = []
    if poses > TRACE_ROWS:
        drawn.append(f"traces about {TRACE_ROWS:,} of up to {poses:,} poses")
    if longest > MOST_ROWS:
        drawn.append(f"curves about {MOST_ROWS:,} of up to {longest:,} rows")
    if not drawn:
        return documents
    kept = ["the first row", "the least and the greatest value", "the first row of a gap"]
    text = (
        f"Drawn are of {' and of '.join(drawn)} at most: of every part {join_words(kept)}"
        f"{_describe_borders(runs)}. What lies between is left out. Metrics are of all."
    )
    return {**documents, "Drawn": text}


def _find_borders(run: Run) -> Times:
    """Return times of phases and events [ns]; empty for a whole run, or if there are too many."""
    borders_ns = None if _is_whole(run) else _list_borders(run)
    return np.zeros(0, dtype=np.int64) if borders_ns is None else borders_ns


def _is_whole(run: Run) -> bool:
    longest = max(len(run.poses), len(run.samples), len(run.commands))
    return longest <= min(MOST_ROWS, TRACE_ROWS)


def _list_borders(run: Run) -> Times | None:
    """Return times of phase starts, phase ends and events [ns]; None if there are too many."""
    if np.count_nonzero(np.diff(run.samples.phase)) > MOST_BORDERS:
        return None
    spans = [end_ns for span in run.find_phase_spans() for end_ns in (span.start_ns, span.end_ns)]
    borders_ns = np.unique(np.array([*spans, *(event.time_ns for event in run.events)], np.int64))
    return borders_ns if len(borders_ns) <= MOST_BORDERS else None


def _find_beside(time_ns: Times, borders_ns: Times) -> NDArray[np.int64]:
    """Return the last row before each border, and the first row at or after it."""
    after = np.searchsorted(time_ns, borders_ns)
    return np.unique(np.concatenate([after - 1, after]).clip(0, len(time_ns) - 1))


def _describe_borders(runs: Sequence[Run]) -> str:
    """Return text on the runs whose rows next to borders are kept."""
    named = zip(name_runs(runs), runs, strict=True)
    borders = [(name, _list_borders(run)) for name, run in named if not _is_whole(run)]
    crowded = [name for name, found in borders if found is None]
    if not any(found is not None and len(found) for _, found in borders):
        return ""
    but = f" (not of {join_words(crowded)}: more than {MOST_BORDERS:,})" if crowded else ""
    return f", and the rows beside each border of a phase and each event{but}"


def _split(count: int) -> Iterator[slice]:
    return (slice(start, start + CHUNK_ROWS) for start in range(0, count, CHUNK_ROWS))
