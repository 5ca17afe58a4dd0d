"""How runs ended, in a sentence: `run`, `plot`, `report` and `view` say it."""

from collections.abc import Mapping, Sequence
from math import dist
from typing import Final

from turtlelog.compare import name_runs
from turtlelog.compare.ranking import allow_position
from turtlelog.display import describe_count, format_short
from turtlelog.explain import choose_metric
from turtlelog.measure import Metric, measure_run
from turtlelog.run import Run

_REACHED: Final = "within_tolerance"
_MISSED: Final = ("standstill", "settled", "timeout", "max_duration")
"""Reasons to stop of built-in laws that do not reach the goal."""

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
    # A law that reads other poses than the robot's stops where it believes the goal to be.
    is_seen = run.poses.sensed_xy_m is None
    if (run.stop_reason == _REACHED and is_seen) or value <= _allow(run):
        return f"reached the goal within {size}{after}"
    if run.stop_reason in _MISSED:
        return f"missed the goal by {size}{after}"
    return f"ended {size} from the goal{after}"


def _measure(run: Run, *names: str) -> Mapping[str, Metric]:
    return measure_run(run, only=names)


def _allow(run: Run) -> float:
    """Return the distance to the goal that the tolerances of the law allow [m]; 0 without them."""
    heading_rad = run.parameters.get("law.heading_tolerance_rad")
    position_m = run.parameters.get("law.position_tolerance_m")
    if not isinstance(heading_rad, float | int) or not isinstance(position_m, float | int):
        return 0.0
    if run.goal_xy_m is None:
        return 0.0
    return allow_position(heading_rad, position_m, dist(run.goal_xy_m, run.poses.xy_m[0]))
