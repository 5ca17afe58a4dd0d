"""What figures draw of runs whose laws track a path: the path, errors from it, the worst place."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes

from turtlelog.charts.tracked_path import (
    WorstPlace,
    has_own_way,
    list_paths,
    outline_path,
    read_way_to_reference,
)
from turtlelog.run import Run

_PATH: Final[Mapping[str, Any]] = MappingProxyType(
    {"color": "0.8", "linewidth": 3.0, "zorder": 1.1, "solid_joinstyle": "miter", "label": "path"}
)
"""A broad band, on which the driven way is seen."""

_WAY: Final[Mapping[str, Any]] = MappingProxyType(
    {"color": "0.35", "linewidth": 0.5, "zorder": 2.2, "solid_capstyle": "butt"}
)

_MOST_WAYS: Final = 60
"""About two in a centimetre of a path around half a page: more would be a grey area."""

_STEPS: Final = (1.0, 2.0, 5.0, 10.0)


def draw_tracked_paths(axes: Axes, runs: Sequence[Run]) -> None:
    """Draw each path that a law tracks once, below what was driven."""
    for number, path in enumerate(list_paths(runs)):
        name = {} if number else {"label": _PATH["label"]}
        axes.plot(*outline_path(path).T, **{**_PATH, "label": None, **name})


def draw_ways_to_reference(axes: Axes, runs: Sequence[Run]) -> None:
    """Draw of a run alone where its reference on the path is, at equal times, as seen from it."""
    ways_m = read_way_to_reference(runs[0]) if len(runs) == 1 else None
    if ways_m is None or has_own_way(runs[0]):
        return
    run, step_s = runs[0], _choose_step(runs[0].duration_s)
    times_s = (run.poses.time_ns - run.start_ns) / 1e9
    rows = np.searchsorted(times_s, np.arange(0.0, times_s[-1] + step_s / 2.0, step_s))
    rows = rows[rows < len(times_s)]
    starts_m, gaps = run.poses.xy_m[rows], np.full((len(rows), 2), np.nan)
    lines = np.stack([starts_m, starts_m + ways_m[rows], gaps], axis=1).reshape(-1, 2)
    axes.plot(*lines.T, **_WAY, label=f"to the reference, every {step_s:g} s")


def draw_worst_place(axes: Axes, worst: WorstPlace, color: Any) -> None:
    """Draw how far from the path the run is that is furthest off, in its colour."""
    ends = np.array([worst.path_xy_m, worst.xy_m])
    axes.plot(*ends.T, color=color, linewidth=0.8, marker=".", markersize=4.0, zorder=3)


def _choose_step(duration_s: float) -> float:
    """Return a round time of which about as many fit into a run as there is room for."""
    least_s = max(duration_s, 1e-3) / _MOST_WAYS
    decade = 10.0 ** np.floor(np.log10(least_s))
    return float(next(step * decade for step in _STEPS if step * decade >= least_s * (1 - 1e-9)))
