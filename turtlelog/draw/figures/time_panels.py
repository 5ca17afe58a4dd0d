"""Panels over time and their arrangement in a figure: curves, level lines, gaps and outliers."""

import re
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import SymmetricalLogLocator

from turtlelog.charts import many_runs
from turtlelog.charts.curves import Curve, find_disturbance, lack_samples
from turtlelog.charts.palette import LIMIT_DASH, Color, choose_curve_color, choose_dash
from turtlelog.charts.plane_scene import find_origin, label_coordinate, list_seen_gaps, move_near
from turtlelog.charts.plotted_curves import (
    POINTS,
    CurveKind,
    PlottedCurve,
    Scale,
    TimePlot,
    choose_kinds,
    find_range,
    label_time,
    leaves_out,
    list_own,
    list_plot_levels,
    list_plotted,
    take_magnitude,
)
from turtlelog.charts.time_plots import find_plot
from turtlelog.draw.figures import page, run_styles
from turtlelog.draw.figures.figure_curves import draw_curve, draw_level, draw_points
from turtlelog.draw.figures.placed_words import WORDS_POINTS
from turtlelog.draw.figures.plane_panels import draw_paths, show_all
from turtlelog.run import Run

_LOOKS: Final[Mapping[CurveKind, Mapping[str, Any]]] = {
    "beside": {"linewidth": 0.9, "zorder": 1.9},
    "measured": {"linewidth": 0.8, "zorder": 1.9},
    "applied": {"linewidth": 0.8, "zorder": 1.9},
    "shaped": {"linewidth": 0.9, "zorder": 1.9},
    "ideal": {"linewidth": 0.7, "zorder": 1.8},
    "aim": {"linewidth": 0.8, "zorder": 1.9},
    "sensed": {"marker": ".", "markersize": 2.4, "markeredgewidth": 0.0, "zorder": 1.7},
}
"""Width and order of each kind of curve; colour and dashes come from `charts.palette`."""

_LEVELS: Final[Mapping[str, Mapping[str, Any]]] = {
    "target": page.REFERENCE,
    "zero": {**page.REFERENCE, "label": None},
    "limit": {**page.REFERENCE, "linestyle": page.STROKES[LIMIT_DASH]},
    "tolerance": {**page.REFERENCE, "linestyle": page.STROKES[LIMIT_DASH]},
}

_GRID: Final = {"color": "0.8", "linewidth": 0.5}
"""Style of the zero line in a panel of commands or states."""

_COMMANDED: Final = page.fix_style(linewidth=0.5, zorder=1.8, marker="", label="commanded")
"""Style of commands next to measured rates of the same run, in the colour of the run."""

_LOST: Final = page.fix_style(
    linestyle="", marker="|", markersize=3.5, markeredgewidth=0.4, zorder=1.7, label="dropped"
)
"""Style of poses that the controller does not receive: strokes at the lower edge."""

_OUTLIER: Final = page.fix_style(
    linestyle="", marker="v", markersize=4.0, clip_on=False, label="outlier"
)

_GAP: Final = page.fix_style(
    facecolor="0.95", edgecolor="0.8", hatch="////", linewidth=0.0, zorder=0.45
)

_DIMMED: Final = page.fix_style(alpha=0.35, linewidth=0.6, zorder=1.4)
"""Style of a run that never settles, below runs that settle."""


_OUTLIER_ROOM: Final = 0.15
"""Share of an axis for a line of text on outliers below the curves."""


def draw_time_plot(
    axes: Axes, runs: Sequence[Run], *, name: str, scale: Scale | None = None
) -> None:
    """Draw a plot of `TIME_PLOTS` or a state: all curves of a single run, a few kinds of several.

    The references of the plot's signal are drawn too. Runs that never settle are dimmed if others
    settle, and do not set the axis limits.
    """
    plot = find_plot(name, runs)
    scale = scale or plot.scale
    origin_m = 0.0
    if plot.pair == "position":
        origin_m = find_origin(runs)["xy".index(name)]
        runs, _ = move_near(runs)
    if plot.command is None and scale != "symlog":
        axes.set_label(f"|{name}|" if scale == "log" else name)  # name by which marks find it
    _scale(axes, scale)
    _draw_levels(axes, runs, plot, scale)
    restless = many_runs.find_restless(runs)
    _draw_curves(axes, runs, plot, scale, restless)
    # A distance is never negative, so its magnitude is the same.
    has_sign = scale == "log" and name != "distance"
    label = f"|{plot.title}| [{plot.unit}]" if has_sign else plot.label
    label = label_coordinate(name, origin_m) if origin_m else label
    _finish(axes, runs, re.sub(r"Kp e(\w)", r"$K_p e_\1$", label))
    calm = [run for number, run in enumerate(runs) if number not in restless]
    _fit(axes, calm, plot, scale, is_forced=bool(restless))
    if restless:
        axes.set_xlim(right=1.02 * max(float(run.duration_s) for run in calm))
        how = "without" if leaves_out(len(runs), plot) else "pale:"
        words = f"{how} {many_runs.describe_restless(runs, restless)}, not settled"
        axes.set_title(words, fontsize=WORDS_POINTS, color="0.3", loc="right", pad=3.0)
    if len(runs) == 1:
        _shade(axes, runs[0], plot)
    if plot.command is not None:
        _name_outliers(axes, runs, plot)


def draw_states(axes: Axes, runs: Sequence[Run], *, names: Sequence[str], label: str) -> None:
    """Draw states of a law: one state of every run, or several states of one run."""
    if len(names) == 1:
        draw_time_plot(axes, runs, name=names[0])
        return
    draw_level(axes, [0.0], **_GRID)
    for name, looks in zip(names, run_styles.choose_lines(len(names)), strict=True):
        for found in list_plotted(runs[0], find_plot(name, runs)):
            draw_curve(axes, found.curve, **looks, label=name)
    _finish(axes, runs, label)


def _scale(axes: Axes, scale: Scale) -> None:
    if scale == "log":
        axes.set_yscale("log")
    elif scale == "symlog":
        axes.set_yscale("symlog", linthresh=1.0)
        ticks = SymmetricalLogLocator(base=10.0, linthresh=1.0, subs=(1.0, 2.0, 5.0))
        axes.yaxis.set_major_locator(ticks)
        axes.yaxis.set_major_formatter("{x:g}")


def _draw_levels(axes: Axes, runs: Sequence[Run], plot: TimePlot, scale: Scale) -> None:
    """Draw level lines with their names, each name once."""
    levels = list_plot_levels(runs, plot, scale)
    if any(level.kind == "limit" for level in levels) or plot.command is not None:
        draw_level(axes, [0.0], **_GRID)
    for label, kind in dict.fromkeys((level.label, level.kind) for level in levels):
        values = [level.value for level in levels if (level.label, level.kind) == (label, kind)]
        draw_level(axes, values, **{"label": label, **_LEVELS[kind]})


def _draw_curves(
    axes: Axes, runs: Sequence[Run], plot: TimePlot, scale: Scale, restless: frozenset[int]
) -> None:
    """Draw the curves of all runs; a reference that several share is drawn once."""
    is_alone, is_many = len(runs) == 1, len(runs) > many_runs.MANY
    aims: list[Curve] = []
    colors = many_runs.choose_colors_by_value(runs)
    for number, (run, looks) in enumerate(run_styles.style_runs(runs)):
        listed = list_plotted(run, plot, choose_kinds(number, len(runs)))
        is_answered = any(one.kind == "measured" for one in listed) and not is_alone
        if number in restless and leaves_out(len(runs), plot):
            continue
        for found in listed:
            if found.kind == "outlier":
                continue
            if found.kind == "aim":
                if any(_are_alike(found.curve, other) for other in aims):
                    continue
                aims.append(found.curve)
            own = {
                **_choose_looks(found, looks, colors[number], is_alone=is_alone),
                **(_COMMANDED if found.kind == "run" and is_answered else {}),
                **({"label": page.IDEAL_ENDS} if found.kind == "ideal" and is_many else {}),
                **(_DIMMED if number in restless else {}),
            }
            curve = take_magnitude(found.curve) if scale == "log" else found.curve
            _draw(axes, run, found.kind, curve, own)


def _choose_looks(
    found: PlottedCurve, looks: Mapping[str, Any], color: Color, *, is_alone: bool
) -> dict[str, Any]:
    """Return the style of a curve. The run's own curve has the run's marker."""
    hue = page.to_rgb(choose_curve_color(found.kind, color, is_alone=is_alone))
    own = {**looks, "color": hue, "linestyle": page.STROKES[choose_dash(found.kind)]}
    if found.kind not in ("run", "measured"):
        own["marker"] = ""
    own |= _LOOKS.get(found.kind, {})
    if found.kind in ("ideal", "aim") or (is_alone and found.entry.name):
        own["label"] = found.label
    if found.kind in POINTS:
        own["linestyle"] = ""
    return own


def _draw(axes: Axes, run: Run, kind: CurveKind, curve: Curve, looks: Mapping[str, Any]) -> None:
    if kind == "dropped_out":
        lost_s = (run.poses.time_ns[run.poses.dropped_out] - run.start_ns) / 1e9
        edge = np.full(len(lost_s), 0.02)
        own = {**_LOST, "color": looks["color"]}
        axes.plot(lost_s, edge, transform=axes.get_xaxis_transform(), **own)
    elif kind in POINTS:
        draw_points(axes, curve.time_s, curve.values, **looks)
    else:
        draw_curve(axes, curve, **looks)


def _are_alike(one: Curve, other: Curve) -> bool:
    """Return whether two references are equal, for example of runs that track one path by time."""
    return np.array_equal(one.time_s, other.time_s) and np.array_equal(
        one.values, other.values, equal_nan=True
    )


def _fit(axes: Axes, runs: Sequence[Run], plot: TimePlot, scale: Scale, *, is_forced: bool) -> None:
    """Fit an axis to the measured values, for magnitudes and commands or if forced."""
    curves = [curve for run in runs for curve in list_own(run, plot)]
    if scale == "log":
        sizes = [take_magnitude(curve).values for curve in curves]
        known = np.concatenate([*(values[np.isfinite(values)] for values in sizes), np.empty(0)])
        if len(known):
            axes.set_ylim(0.6 * known.min(), 1.8 * known.max())
        return
    if scale == "symlog" or not (is_forced or plot.command is not None):
        return
    found = find_range([curve.values for curve in curves], list_plot_levels(runs, plot))
    if found is not None:
        axes.set_ylim(found)


def _shade(axes: Axes, run: Run, plot: TimePlot) -> None:
    """Shade disturbances of the plant, and gaps without poses with their length."""
    if plot.command is not None and (pushed_s := find_disturbance(run)) is not None:
        axes.axvspan(*pushed_s, **page.PUSHED)
    for start_s, end_s, words in list_seen_gaps(run):
        axes.axvspan(start_s, end_s, **_GAP)
        text = axes.text((start_s + end_s) / 2.0, 0.5, words, fontsize=WORDS_POINTS, color="0.3")
        text.set(transform=axes.get_xaxis_transform(), ha="center", va="center", rotation=90)
        text.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.8, "alpha": 0.8})


def _name_outliers(axes: Axes, runs: Sequence[Run], plot: TimePlot) -> None:
    """Write the outliers beyond the axis, with a mark at the time of each."""
    lines = []
    colors = many_runs.choose_colors_by_value(runs)
    for run, name, color in zip(runs, run_styles.label_runs(runs), colors, strict=True):
        for found in list_plotted(run, plot):
            if found.kind != "outlier":
                continue
            hue = choose_curve_color("outlier", color, is_alone=len(runs) == 1)
            at_s, edge = found.curve.time_s, axes.get_xaxis_transform()
            looks = {**_OUTLIER, "color": page.to_rgb(hue)}
            axes.plot(at_s, np.zeros(len(at_s)), transform=edge, **looks)
            lines.append(found.label if len(runs) == 1 else f"{name}: {found.label}")
    if lines:
        low, high = axes.get_ylim()
        axes.set_ylim(low - _OUTLIER_ROOM * len(lines) * (high - low), high)
        text = axes.text(0.99, 0.03, "\n".join(lines), fontsize=WORDS_POINTS, color="0.3")
        text.set(transform=axes.transAxes, ha="right", va="bottom")


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
    places = [(row, column) for row in range(grid.nrows) for column in (0, 1)]
    places = [(row, column) for row, column in places if column or row >= rows]
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


def _finish(axes: Axes, runs: Sequence[Run], label: str) -> None:
    """Label the axes of a panel over time."""
    axes.set(xlabel=label_time(runs), ylabel=label)
    axes.margins(x=0.01)
    axes.locator_params(axis="x", nbins=6)
