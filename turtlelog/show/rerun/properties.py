"""Properties of a recording: what tells files apart in the viewer and in a query."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import pyarrow as pa  # type: ignore[import-untyped]
import rerun as rr

from turtlelog.measure import Metric
from turtlelog.run import Run

RUN: Final = "run"
RUNS: Final = "runs"
SCENARIO: Final = "scenario"
METRICS: Final = "metrics"


def send_run_properties(
    stream: rr.RecordingStream, run: Run, metrics: Mapping[str, Metric]
) -> None:
    """Store what a run is, its scenario, and its metrics, each under a name of its own."""
    stream.send_property(RUN, _Properties({key: [value] for key, value in _describe(run).items()}))
    parameters = {key: [value] for key, value in _flatten(run).items()}
    if parameters:
        stream.send_property(SCENARIO, _Properties(parameters))
    values = {name: [_get_value(metric)] for name, metric in metrics.items()}
    stream.send_property(METRICS, _Properties(values))


def send_comparison_properties(
    stream: rr.RecordingStream,
    runs: Sequence[Run],
    names: Sequence[str],
    prefixes: Sequence[str],
    metrics: Sequence[Mapping[str, Metric]],
) -> None:
    """Store the same of several runs, as lists in the order given.

    A number that is not known, or that a run's law does not have, is NaN, a text empty.
    """
    described = [_describe(run) for run in runs]
    of_runs = {key: [values[key] for values in described] for key in described[0]}
    of_runs |= {"name": list(names), "entity": list(prefixes)}
    stream.send_property(RUNS, _Properties(of_runs))
    parameters = [_flatten(run) for run in runs]
    keys = sorted({key for known in parameters for key in known})
    if keys:
        found = {key: _fill([known.get(key) for known in parameters]) for key in keys}
        stream.send_property(SCENARIO, _Properties(found))
    ids = dict.fromkeys(name for known in metrics for name in known)
    values = {name: [_get_value(known.get(name)) for known in metrics] for name in ids}
    stream.send_property(METRICS, _Properties(values))


class _Properties(rr.AsComponents):
    """Values by name. Rerun's own `AnyValues` would hold a name to one type in all of a process."""

    def __init__(self, values: Mapping[str, list[Any]]) -> None:
        self._values = values

    def as_component_batches(self) -> list[rr.DescribedComponentBatch]:
        return [
            rr.DescribedComponentBatch(_Values(pa.array(values)), rr.ComponentDescriptor(name))
            for name, values in self._values.items()
        ]


class _Values:
    """An Arrow array as Rerun wants to be given it."""

    def __init__(self, array: pa.Array) -> None:
        self._array = array

    def as_arrow_array(self) -> pa.Array:
        return self._array


def _describe(run: Run) -> dict[str, Any]:
    return {
        "name": run.name,
        "source": run.source,
        "stop_reason": run.stop_reason or "unknown",
        "start_ns": run.start_ns,
    }


def _flatten(run: Run) -> dict[str, float | str]:
    """Return the scenario's numbers as floats, truths as 0 and 1, the rest as text."""
    return {
        key: float(value) if isinstance(value, bool | int | float) else str(value)
        for key, value in run.parameters.items()
    }


def _fill(values: list[float | str | None]) -> list[float] | list[str]:
    """Return one value per run in one type: text where one of them is text."""
    if any(isinstance(value, str) for value in values):
        return ["" if value is None else str(value) for value in values]
    return [float("nan") if value is None else float(value) for value in values]


def _get_value(metric: Metric | None) -> float:
    return float("nan") if metric is None or metric.value is None else metric.value
