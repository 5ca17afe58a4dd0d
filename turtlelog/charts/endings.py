"""How runs ended, in a sentence: `run`, `plot`, `report` and `view` say it."""

from collections.abc import Mapping, Sequence
from typing import Final

from turtlelog.compare import name_runs
from turtlelog.display import describe_count, format_short
from turtlelog.explain import choose_metric
from turtlelog.measure import Metric, measure_run
from turtlelog.run import Run
from turtlelog.run.ending import describe_goal_end

_ERROR: Final = "final.position_error"
_DURATION: Final = "run.duration"


def describe_runs(runs: Sequence[Run]) -> str:
    """Return how a run ended, or between what distances from the goal several did."""
    names = name_runs(runs)
    if len(runs) == 1:
        return f"{names[0]}: {describe_end(runs[0])}."
    errors = [_measure(run, _ERROR)[_ERROR].value for run in runs]
    known = [(value, name) for value, name in zip(errors, names, strict=True) if value is not None]
    if len(known) == len(runs):
        return f"{len(runs)} runs end {_describe_range(known, 'm')} from the goal."
    lengths = [(run.duration_s, name) for run, name in zip(runs, names, strict=True)]
    return f"{describe_count(len(runs), 'run')} last {_describe_range(lengths, 's')}."


def _describe_range(values: Sequence[tuple[float, str]], unit: str) -> str:
    (low, lowest), (high, highest) = min(values), max(values)
    least, most = format_short(low, unit), format_short(high, unit)
    return f"all {least}" if low == high else f"{least} ({lowest}) to {most} ({highest})"


def describe_end(run: Run) -> str:
    """Return the distance to the goal at the end; of a run without a goal what it did."""
    if not len(run.poses):
        return f"commands for {run.duration_s:.3g} s, no poses"
    metric = choose_metric(run.declaration)
    found = _measure(run, metric, _DURATION, "run.path_length")
    value, duration_s = found[metric].value, found[_DURATION].value
    after = "" if duration_s is None else f" after {duration_s:.3g} s"
    if value is None:
        length_m = found["run.path_length"].value
        if not len(run.samples) and length_m is not None:
            return f"drove {format_short(length_m, 'm')} in {duration_s:.3g} s"
        return f"ended{after}; {metric} has no value: {found[metric].reason}"
    size = format_short(value, found[metric].unit)
    if metric != _ERROR:
        return f"ended{after}, {metric} {size}"
    return describe_goal_end(run, value, duration_s)


def _measure(run: Run, *names: str) -> Mapping[str, Metric]:
    return measure_run(run, only=names)
