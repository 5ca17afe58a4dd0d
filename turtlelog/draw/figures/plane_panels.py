"""The plane: paths with ends or deviations of runs, and the arrangement of panels around it."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from matplotlib.ticker import MaxNLocator

from turtlelog.charts import close_up as close_ups, many_runs, plane_scene
from turtlelog.charts.close_up import CloseUp, Label, Lettering, find_worst_place
from turtlelog.charts.curves import REFERENCE as AIMED, Values, lack_samples
from turtlelog.draw.figures import figure_curves, page
from turtlelog.draw.figures.figure_curves import draw_thinned, label_runs
from turtlelog.draw.figures.page import fix_style
from turtlelog.draw.figures.placed_words import WORDS_POINTS
from turtlelog.run import Run

_RING: Final = fix_style(color="0.75", linewidth=0.5, zorder=1.2)

_OF_MANY: Final = fix_style(color="0.8", linewidth=0.4, zorder=1.6)
"""Style of the paths of very many runs; only their ends have colours."""

_RESTLESS: Final = fix_style(alpha=0.45, zorder=1.7)
"""Style of runs that never come to rest, if others do."""

_OUTLINE: Final = fix_style(linewidth=0.8, zorder=2.96, label=many_runs.OUTLINE_LABEL)
_MEDIAN: Final = fix_style(mec="white", mew=0.7, ms=5.5, zorder=2.97, label=many_runs.MEDIAN_LABEL)

_MOST_TICKS: Final = 5

_LEAST_TOLERANCE: Final = 0.04
"""Smallest tolerance in the legend, of half a close-up; smaller ones are below the goal's cross."""

_PLANE: Final = "plane"  # label of axes that show paths
_FAINT: Final = 0.25  # opacity of the part of a path outside the page's time window


def draw_plane(figure: Figure, runs: Sequence[Run]) -> None:
    """Draw the paths from start to goal, and next to them the ends of runs that arrive."""
    close_up = find_named_close_up(runs)
    worst = find_worst_place(runs) if close_up is None else None
    grid = figure.subplots(1, 2 if close_up or worst else 1, squeeze=False)[0]
    draw_paths(grid[0], runs)
    show_all(grid[0], runs)
    told = plane_scene.tell_still(runs) or plane_scene.tell_gap(runs)
    if told or len(grid) > 1 or not lack_samples(runs):
        grid[0].set(title=told or "whole paths")
    # Text for a close-up of about two fifths of the figure's width.
    half_points, size = 0.2 * figure.get_figwidth() * 72.0, WORDS_POINTS
    lettering = Lettering(
        letter=0.62 * size / half_points, line=1.5 * size / half_points, gap=8.0 / half_points
    )
    if close_up is not None:
        draw_paths(grid[1], runs)
        _close_up(grid[1], runs, close_up, lettering)
    if worst is not None:
        draw_paths(grid[1], runs)
        center, color = np.array(worst.center_xy_m), figure_curves.color_runs(runs)[worst.run]
        _show_square(grid[1], center - worst.half_m, center + worst.half_m)
        ends = np.array([worst.path_xy_m, worst.xy_m])
        grid[1].plot(*ends.T, color=color, linewidth=0.8, marker=".", markersize=4.0, zorder=3)
        _write(grid[1], close_ups.label_worst_place(worst, lettering), color)
        grid[1].set(title="furthest off the path", ylabel="")
        grid[1].locator_params(nbins=5)


def find_named_close_up(runs: Sequence[Run]) -> CloseUp | None:
    """Return the close-up of the goal in which each of a few runs has its name."""
    close_up = close_ups.find_close_up(runs)
    if close_up is None or not 1 < len(runs) <= many_runs.MANY:
        return close_up
    return close_ups.name_ends(close_up, many_runs.cut_alike(label_runs(runs)))


def has_one_plane(runs: Sequence[Run]) -> bool:
    """Return whether the plane is alone, because no run arrives, or leaves its path."""
    return close_ups.find_close_up(runs) is None and find_worst_place(runs) is None


def draw_paths(axes: Axes, runs: Sequence[Run]) -> None:
    """Draw the path of every run, its start and end, its goal and its tracked path."""
    _draw_tracked_paths(axes, runs)
    _draw_ways_to_reference(axes, runs)
    for run, looks in _style_paths(runs):
        driven_m = plane_scene.part_path(run)
        draw_thinned(axes, driven_m[:, 0], driven_m[:, 1], driven_m, **looks)
        if len(runs) == 1 and run.poses.sensed_xy_m is not None:
            figure_curves.draw_points(axes, *run.poses.sensed_xy_m.T, **page.SENSED)
        for aims_m in _list_aims([run]) if plane_scene.has_own_way(run) else ():
            aim = {**looks, **page.AIM, "label": AIMED}
            draw_thinned(axes, aims_m[:, 0], aims_m[:, 1], aims_m, **aim)
    _draw_ends(axes, runs)
    axes.plot(*plane_scene.list_starts(runs).T, **page.START, ms=4.0, label="start")
    goals = plane_scene.list_goals(runs)
    if len(goals):
        axes.plot(*goals.T, **page.GOAL, ms=6.0, mew=1.4, label="goal")
    axes.set(aspect="equal", label=_PLANE)
    for axis, name, origin_m in zip(
        (axes.xaxis, axes.yaxis), "xy", plane_scene.find_origin(runs), strict=True
    ):
        axis.set_label_text(plane_scene.label_coordinate(name, origin_m))
        if origin_m:
            locator = _FromOrigin(origin_m)
            axis.set_major_locator(locator)
            axis.set_major_formatter(locator.tell_tick)


def _style_paths(runs: Sequence[Run]) -> list[tuple[Run, dict[str, Any]]]:
    """Return runs with path styles: grey for very many runs, faint for a run that never rests."""
    is_grey, restless = many_runs.has_grey_paths(runs), many_runs.find_restless(runs)
    return [
        (run, {**looks, **(_OF_MANY if is_grey else _RESTLESS if number in restless else {})})
        for number, (run, looks) in enumerate(figure_curves.style_runs(runs))
    ]


def _draw_ends(axes: Axes, runs: Sequence[Run]) -> None:
    """Draw the ends of runs above all paths; for many per gain, also the median and an outline."""
    ends_m = np.array([run.poses.xy_m[-1] for run in runs])
    colors = figure_curves.color_runs(runs)
    is_many = many_runs.has_grey_paths(runs)
    # Random order, because in the order of gains the last runs would cover the others.
    order = np.random.default_rng(0).permutation(len(runs)) if is_many else range(len(runs))
    for number in order:
        looks: dict[str, Any] = {"color": colors[number], "ms": 2.2 if is_many else 4.2}
        looks |= {"mew": 0.0 if is_many else 0.5, "mec": "white"}
        (end,) = axes.plot(*ends_m[number], "o", zorder=2.95, **looks)
        if lack_samples(runs) and len(runs) == 1:
            end.set_label("end")
    for group in many_runs.find_gain_ends(runs) if is_many else ():
        color = colors[group.middle_run]
        axes.plot(*group.around_xy_m.T, color=color, **_OUTLINE)
        axes.plot(*group.median_xy_m, "D", color=color, **_MEDIAN)


def stress_window(
    figure: Figure, runs: Sequence[Run], window_s: tuple[float, float] | None
) -> None:
    """Emphasise the parts of paths in a time window [s], and fade the rest; None: no window."""
    planes = [axes for axes in figure.axes if axes.get_label() == _PLANE]
    if window_s is None or not planes:
        return
    from_s, to_s = window_s
    for axes in planes:
        for run, looks in _style_paths(runs):
            (whole,) = [line for line in axes.get_lines() if line.get_label() == looks["label"]]
            whole.set(alpha=_FAINT, label=None)
            time_s = (run.poses.time_ns - run.start_ns) / 1e9
            time_s = np.insert(time_s, plane_scene.find_break_rows(run), np.nan)
            is_inside = (time_s >= from_s) & (time_s <= to_s)
            driven_m = np.where(is_inside[:, None], plane_scene.part_path(run), np.nan)
            draw_thinned(axes, driven_m[:, 0], driven_m[:, 1], driven_m, **looks)
    title = planes[0].get_title()
    planes[0].set_title(f"{f'{title}, ' if title else ''}{from_s:g} to {to_s:g} s strong")


def show_all(axes: Axes, runs: Sequence[Run]) -> None:
    """Set the axis limits to a square that contains everything drawn for the given runs."""
    points = np.concatenate(
        [
            *(run.poses.xy_m for run in runs),
            plane_scene.list_goals(runs),
            *_list_aims(runs),
            *map(plane_scene.outline_path, plane_scene.list_paths(runs)),
        ]
    )
    low, high = points.min(axis=0), points.max(axis=0)
    missing_m = max(0.5 * (plane_scene.LEAST_SHOWN_M - float((high - low).max())), 0.0)
    _show_square(axes, low - missing_m, high + missing_m, 0.08)


def _close_up(axes: Axes, runs: Sequence[Run], close_up: CloseUp, lettering: Lettering) -> None:
    goal = np.array(close_up.goal_xy_m)
    _show_square(axes, goal - close_up.half_m, goal + close_up.half_m)
    for run in runs:
        tolerance_m = close_ups.find_tolerance(run)
        if run.goal_xy_m is not None and tolerance_m is not None:
            corner = (run.goal_xy_m[0] - tolerance_m, run.goal_xy_m[1] - tolerance_m)
            side_m, looks = 2 * tolerance_m, dict(page.REFERENCE)
            if tolerance_m >= _LEAST_TOLERANCE * close_up.half_m:
                looks["label"] = "tolerance"
            axes.add_patch(Rectangle(corner, side_m, side_m, fill=False, **looks))
    for ring_m in close_up.rings_m:
        axes.add_patch(Circle(close_up.goal_xy_m, ring_m, fill=False, **_RING))
    misses = close_ups.list_miss_labels(close_up, lettering)
    colors = figure_curves.color_runs(runs)
    for label in misses:
        color = colors[label.runs[0]] if len(label.runs) == 1 else "0.2"
        _write(axes, label, color)
    start_m = runs[0].poses.xy_m[0]
    for label in close_ups.list_ring_labels(close_up, start_m, misses, lettering):
        _write(axes, label, "0.45")
    axes.set(title=f"how each run ends{close_up.count_outside()}", ylabel="")
    axes.locator_params(nbins=5)


def _write(axes: Axes, label: Label, color: Any) -> None:
    box = {"facecolor": "white", "edgecolor": "none", "pad": 0.5, "alpha": 0.8}
    words = axes.text(*label.xy_m, label.text, color=color, fontsize=WORDS_POINTS)
    words.set(ha="center", va="center", bbox=box)


def _list_aims(runs: Sequence[Run]) -> list[Values]:
    found = [run.samples.reference_xy_m for run in runs]
    known = [xy_m[np.isfinite(xy_m[:, 0])] for xy_m in found if xy_m is not None]
    return [xy_m for xy_m in known if len(xy_m)]


class _FromOrigin(MaxNLocator):
    """Ticks at round distances from an origin."""

    def __init__(self, origin_m: float) -> None:
        super().__init__(nbins=_MOST_TICKS, steps=[1, 2, 2.5, 5, 10])
        self._origin_m = origin_m

    def tick_values(self, vmin: float, vmax: float) -> list[float]:
        """Return the positions of ticks between two ends [m]."""
        from_origin = super().tick_values(vmin - self._origin_m, vmax - self._origin_m)
        return [float(tick) + self._origin_m for tick in from_origin]

    def tell_tick(self, value_m: float, _: float | None = None) -> str:
        """Return the distance of a tick from the origin as text."""
        return f"{round(value_m - self._origin_m, 6):g}"


def _show_square(axes: Axes, low: Values, high: Values, margin: float = 0.0) -> None:
    center, half = (low + high) / 2.0, max(float((high - low).max()) * (0.5 + margin), 1e-3)
    axes.set_xlim(center[0] - half, center[0] + half)
    axes.set_ylim(center[1] - half, center[1] + half)


_PATH: Final = fix_style(
    color="0.8", linewidth=3.0, zorder=1.1, solid_joinstyle="miter", label="path"
)
"""Style of a tracked path: a broad band on which the driven path is visible."""

_WAY: Final = fix_style(color="0.35", linewidth=0.5, zorder=2.2, solid_capstyle="butt")

_MOST_WAYS: Final = 60  # deviation lines: two per centimetre. More would be a grey area

_STEPS: Final = (1.0, 2.0, 5.0, 10.0)


def _draw_tracked_paths(axes: Axes, runs: Sequence[Run]) -> None:
    for number, path in enumerate(plane_scene.list_paths(runs)):
        name = {} if number else {"label": _PATH["label"]}
        axes.plot(*plane_scene.outline_path(path).T, **{**_PATH, "label": None, **name})


def _draw_ways_to_reference(axes: Axes, runs: Sequence[Run]) -> None:
    """Draw lines from a single run to the reference on the path at equal times."""
    ways_m = plane_scene.read_way_to_reference(runs[0]) if len(runs) == 1 else None
    if ways_m is None or plane_scene.has_own_way(runs[0]):
        return
    run = runs[0]
    least_s = max(run.duration_s, 1e-3) / _MOST_WAYS
    decade = 10.0 ** np.floor(np.log10(least_s))
    step_s = float(next(one * decade for one in _STEPS if one * decade >= least_s * (1 - 1e-9)))
    times_s = (run.poses.time_ns - run.start_ns) / 1e9
    rows = np.searchsorted(times_s, np.arange(0.0, times_s[-1] + step_s / 2.0, step_s))
    rows = rows[rows < len(times_s)]
    starts_m, gaps = run.poses.xy_m[rows], np.full((len(rows), 2), np.nan)
    lines = np.stack([starts_m, starts_m + ways_m[rows], gaps], axis=1).reshape(-1, 2)
    axes.plot(*lines.T, **_WAY, label=f"to the reference, every {step_s:g} s")


Draw = Callable[[Axes, Sequence[Run]], None]
"""A function that draws one panel for some runs."""


def draw_stack(figure: Figure, runs: Sequence[Run], panels: Sequence[Draw]) -> None:
    """Draw panels one above the other on one time axis."""
    grid = figure.subplots(len(panels), 1, sharex=True, squeeze=False)
    for axes, panel in zip(grid[:, 0], panels, strict=True):
        panel(axes, runs)
    for axes, _ in pairwise(grid[:, 0]):
        axes.set_xlabel("")


def draw_overview(figure: Figure, runs: Sequence[Run], panels: Sequence[Draw]) -> None:
    """Draw the paths, with panels on one time axis in two columns around them.

    The plane is at the top of the left column. For runs without samples it takes the whole column;
    for runs without poses there is no plane.
    """
    if not any(len(run.poses) for run in runs):
        draw_stack(figure, runs, panels)
        return
    if lack_samples(runs):
        grid = figure.add_gridspec(len(panels), 2, width_ratios=(1.0, 1.25))
        rows = len(panels)
    else:
        rows = count_plane_rows(panels)
        grid = figure.add_gridspec((len(panels) + rows) // 2, 2)
    plane = figure.add_subplot(grid[:rows, 0])
    draw_paths(plane, runs)
    show_all(plane, runs)
    places = [(row, column) for row in range(grid.nrows) for column in range(row < rows, 2)]
    shared: Axes | None = None
    for panel, (row, column) in zip(panels, places, strict=True):
        shared = axes = figure.add_subplot(grid[row, column], sharex=shared)
        panel(axes, runs)
        if rows == grid.nrows:
            # Low panels have no room for a unit beside its name.
            axes.set_ylabel(page.break_label(axes.get_ylabel()))
        if row + 1 < grid.nrows:
            axes.set_xlabel("")
            axes.tick_params(labelbottom=False)


def count_plane_rows(panels: Sequence[object]) -> int:
    """Return the rows that a plane takes of two columns, so that no place is empty."""
    return 1 + (len(panels) + 1) % 2
