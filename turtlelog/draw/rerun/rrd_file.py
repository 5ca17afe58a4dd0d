"""Writing of an .rrd file that is complete or absent, without wall-clock time."""

import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from turtlelog.draw.output_files import replace_file
from turtlelog.draw.rerun.entities import APPLICATION_ID, name_document
from turtlelog.errors import ShowError
from turtlelog.files.urls import make_path
from turtlelog.measure import Metric
from turtlelog.run import Run

_PATIENCE_S: Final = 5.0
"""Time without growth after which a file counts as stuck [s]."""

_DISCONNECT_S: Final = 1.0
_END: Final = b"RRF2FOOT"
_END_BYTES: Final = 64
_PROBE: Final = bytes(2**20)

_STRICT_LOCK: Final = threading.Lock()
_BEFORE_STRICT: Final[list[bool]] = []
"""Earlier settings, one for each active block of strict mode."""

RUN: Final = "run"
RUNS: Final = "runs"
SCENARIO: Final = "scenario"
METRICS: Final = "metrics"


@contextmanager
def open_recording(
    path: str | Path, *, name: str, layout: rrb.Blueprint
) -> Iterator[rr.RecordingStream]:
    """Yield a stream to a file that gets its final name when it is complete.

    Raises:
        ShowError: If the file cannot be written.
    """
    path = make_path(path)
    with replace_file(path) as part_path, strict_mode():
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
        _require_end(part_path, path)


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
    _send_properties(stream, RUN, _describe_runs([run]), [run], [metrics])


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
    _send_properties(stream, RUNS, of_runs, runs, metrics)


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
    thread = threading.Thread(target=_try, args=(call, failures), name="rerun", daemon=True)
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


def _try(call: Callable[[], None], failures: list[Exception]) -> None:
    try:
        call()
    except Exception as err:
        failures.append(err)


def _require_end(part_path: Path, path: Path) -> None:
    """Refuse a truncated file, because Rerun does not fail if the disk is full at the very end."""
    with part_path.open("rb") as stream:
        stream.seek(max(part_path.stat().st_size - _END_BYTES, 0))
        end = stream.read()
    if _END not in end:
        raise _find_error(part_path, path, "a file without its end" if end else "none")


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
    parameters = [_flatten(run) for run in runs]
    keys = sorted({key for known in parameters for key in known})
    if keys:
        found = {key: _fill([known.get(key) for known in parameters]) for key in keys}
        stream.send_property(SCENARIO, _Properties(found))
    ids = dict.fromkeys(name for known in metrics for name in known)
    values = {name: [_get_value(known.get(name)) for known in metrics] for name in ids}
    stream.send_property(METRICS, _Properties(values))


def _describe_runs(runs: Sequence[Run]) -> dict[str, list[Any]]:
    return {
        "name": [run.name for run in runs],
        "source": [run.source for run in runs],
        "stop_reason": [run.stop_reason or "unknown" for run in runs],
        "start_ns": [run.start_ns for run in runs],
    }


def _flatten(run: Run) -> dict[str, float | str]:
    """Return the scenario's numbers as floats, booleans as 0 and 1, other values as text."""
    return {
        key: float(value) if isinstance(value, bool | int | float) else str(value)
        for key, value in run.parameters.items()
    }


def _fill(values: list[float | str | None]) -> list[float] | list[str]:
    """Return one value per run, all of one type: text if any value is text."""
    if any(isinstance(value, str) for value in values):
        return ["" if value is None else str(value) for value in values]
    return [float("nan") if value is None else float(value) for value in values]


def _get_value(metric: Metric | None) -> float:
    return float("nan") if metric is None or metric.value is None else metric.value
