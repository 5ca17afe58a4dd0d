"""Sentences on runs and pictures: how runs ended, and text alternatives of pictures."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.compare import name_runs
from turtlelog.display import describe_count, format_short
from turtlelog.explain import choose_metric
from turtlelog.measure import Metric, measure_run
from turtlelog.run import Run
from turtlelog.run.ending import find_goal_end

_ERROR: Final = "final.position_error"
_DURATION: Final = "run.duration"


def describe_runs(runs: Sequence[Run]) -> str:
    """Return how a run ended, or for several runs the range of their distances from the goal."""
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
    # Two ends that are printed alike are no range: the reader sees no difference.
    return f"all {least}" if least == most else f"{least} ({lowest}) to {most} ({highest})"


def describe_end(run: Run) -> str:
    """Return the distance to the goal at the end; for a run without a goal, its motion."""
    if not len(run.poses):
        return f"commands for {run.duration_s:.3g} s, no poses"
    end = find_goal_end(run)
    metric = choose_metric(run.declaration)
    if end is not None and metric == _ERROR:
        return end.describe()
    found = _measure(run, metric, _DURATION, "run.path_length")
    value, duration_s = found[metric].value, found[_DURATION].value
    after = "" if duration_s is None else f" after {duration_s:.3g} s"
    if value is None:
        length_m = found["run.path_length"].value
        if not len(run.samples) and length_m is not None:
            return f"drove {format_short(length_m, 'm')} in {duration_s:.3g} s"
        return f"ended{after}; {metric} has no value: {found[metric].reason}"
    return f"ended{after}, {metric} {format_short(value, found[metric].unit)}"


def _measure(run: Run, *names: str) -> Mapping[str, Metric]:
    return measure_run(run, only=names)


_MOST_NAMED: Final = 6
"""Largest number of runs that are described one by one; with more, a listener forgets the first."""


def describe_plot(title: str, curves: Sequence[tuple[str, NDArray[np.float64]]]) -> str:
    """Return a description of a plot over time: start, end and range of each curve.

    Args:
        title: Title of the plot, with the unit of its values.
        curves: Name and values of each run, shape (n,). Values that are not finite are gaps.
    """
    finite = [(name, values[np.isfinite(values)]) for name, values in curves]
    known = [(name, values) for name, values in finite if len(values)]
    if not known:
        return f"{title}: no values."
    if len(known) <= _MOST_NAMED:
        said = [f"{name}: {_describe_values(values)}" for name, values in known]
        return f"{title} over time. {'; '.join(said)}."
    values = np.concatenate([values for _, values in known])
    return (
        f"{title} over time of {describe_count(len(known), 'run')},"
        f" between {_write(values.min())} and {_write(values.max())}."
    )


def _describe_values(values: NDArray[np.float64]) -> str:
    return (
        f"from {_write(values[0])} to {_write(values[-1])},"
        f" between {_write(values.min())} and {_write(values.max())}"
    )


def _write(value: float) -> str:
    return f"{value + 0.0:.4g}"  # + 0.0: no negative zero


def describe_plane(title: str, ends: Sequence[tuple[str, NDArray[np.float64]]]) -> str:
    """Return a description of a plane: start and end of each run.

    Args:
        title: Title of the plane.
        ends: Name of each run, with its poses [m], shape (n, 2).
    """
    if len(ends) > _MOST_NAMED:
        return f"{title}: the paths of {describe_count(len(ends), 'run')} in the plane."
    said = [
        f"{name} drives from {_write_place(xy_m[0])} to {_write_place(xy_m[-1])} m"
        for name, xy_m in ends
    ]
    return f"{title}. {'; '.join(said)}."


def _write_place(xy_m: NDArray[np.float64]) -> str:
    return f"({xy_m[0]:.4g}, {xy_m[1]:.4g})"
