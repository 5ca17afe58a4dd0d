"""Panels over time: curves, level lines, gaps, outliers, and a check's band with its violations."""

import re
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import SymmetricalLogLocator

from turtlelog.charts import many_runs, palette, plotted_curves
from turtlelog.charts.curve_marks import ViolatedSignal, ViolationMoment
from turtlelog.charts.curves import BEARING_NOW, Level, find_disturbed_time
from turtlelog.charts.plane_scene import find_origin, label_coordinate, list_seen_gaps, move_near
from turtlelog.charts.plotted_curves import POINTS, PlottedCurve, Scale, TimePlot, list_plotted
from turtlelog.charts.time_plots import find_plot
from turtlelog.display import format_number
from turtlelog.draw.figures import figure_curves, page
from turtlelog.draw.figures.figure_curves import choose_lines, draw_curve, draw_level, label_runs
from turtlelog.draw.figures.page import REFERENCE, STROKES, fix_style, to_rgb
from turtlelog.draw.figures.placed_words import WORDS_POINTS, WordSpace, place_words
from turtlelog.errors import ShowError
from turtlelog.run import Run

_LOOKS: Final[Mapping[plotted_curves.CurveKind, Mapping[str, Any]]] = {
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
    "target": REFERENCE,
    "zero": {**REFERENCE, "label": None},
    "limit": {**REFERENCE, "linestyle": STROKES[palette.LIMIT_DASH]},
    "tolerance": {**REFERENCE, "linestyle": STROKES[palette.LIMIT_DASH]},
}

_GRID: Final = {"color": "0.8", "linewidth": 0.5}
"""Style of the zero line in a panel of commands or states."""

_COMMANDED: Final = fix_style(linewidth=0.5, zorder=1.8, marker="", label="commanded")
"""Style of commands next to measured rates of the same run, in the colour of the run."""

_LOST: Final = fix_style(
    linestyle="", marker="|", markersize=3.5, markeredgewidth=0.4, zorder=1.7, label="dropped"
)
"""Style of poses that the controller does not receive: strokes at the lower edge."""

_OUTLIER: Final = fix_style(
    linestyle="", marker="v", markersize=4.0, clip_on=False, label="outlier"
)

_GAP: Final = fix_style(facecolor="0.95", edgecolor="0.8", hatch="////", linewidth=0.0, zorder=0.45)

_BEARING: Final = (0, (6, 1.2, 1, 1.2, 1, 1.2))  # dash-dot-dot, in multiples of the line's width

_DIMMED: Final = fix_style(alpha=0.35, linewidth=0.6, zorder=1.4)
"""Style of a run that never settles, below runs that settle."""

_OUTLIER_ROOM: Final = 0.15  # share of an axis for a line of text on outliers below the curves


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
    is_left_out = plotted_curves.leaves_out(len(runs), plot)
    # Commands have limits: pale ones fit, too.
    fitted = calm if plot.command is None or is_left_out else runs
    _fit(axes, fitted, plot, scale, is_forced=bool(restless))
    if restless:
        axes.set_xlim(right=1.02 * max(float(run.duration_s) for run in calm))
        how = "without" if is_left_out else "pale:"
        words = f"{how} {many_runs.describe_restless(runs, restless)},\nnot settled"
        if all(words != other.get_title("right") for other in axes.figure.axes):
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
    for name, looks in zip(names, choose_lines(len(names)), strict=True):
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
    levels = plotted_curves.list_plot_levels(runs, plot, scale)
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
    aims: set[tuple[bytes, bytes]] = set()
    colors = many_runs.choose_colors_by_value(runs)
    listed_by_run = [
        list_plotted(run, plot, plotted_curves.choose_kinds(number, len(runs)))
        for number, run in enumerate(runs)
    ]
    # A thick line is one quantity for all runs: the measured rate, if one run has it.
    is_answered = not is_alone and any(one.kind == "measured" for it in listed_by_run for one in it)
    for number, (_, looks) in enumerate(figure_curves.style_runs(runs)):
        if number in restless and plotted_curves.leaves_out(len(runs), plot):
            continue
        for found in (one for one in listed_by_run[number] if one.kind != "outlier"):
            if found.kind == "aim":
                # Runs that track one path by time have equal references.
                aim = (found.curve.time_s.tobytes(), found.curve.values.tobytes())
                if aim in aims:
                    continue
                aims.add(aim)
            own = {
                **_choose_looks(found, looks, colors[number], is_alone=is_alone),
                **(_COMMANDED if found.kind == "run" and is_answered else {}),
                **({"label": page.IDEAL_ENDS} if found.kind == "ideal" and is_many else {}),
                **(_DIMMED if number in restless else {}),
            }
            curve = plotted_curves.take_magnitude(found.curve) if scale == "log" else found.curve
            if found.kind == "dropped_out":
                edge = np.full(len(curve.time_s), 0.02)
                own = {**_LOST, "color": own["color"]}
                axes.plot(curve.time_s, edge, transform=axes.get_xaxis_transform(), **own)
            elif found.kind in POINTS:
                figure_curves.draw_points(axes, curve.time_s, curve.values, **own)
            else:
                draw_curve(axes, curve, **own)


def _choose_looks(
    found: PlottedCurve, looks: Mapping[str, Any], color: palette.Color, *, is_alone: bool
) -> dict[str, Any]:
    """Return the style of a curve. The run's own curve has the run's marker."""
    hue = to_rgb(palette.choose_curve_color(found.kind, color, is_alone=is_alone))
    own = {**looks, "color": hue, "linestyle": STROKES[palette.choose_dash(found.kind)]}
    if found.kind not in ("run", "measured"):
        own["marker"] = ""
    own |= _LOOKS.get(found.kind, {})
    if found.label == BEARING_NOW:  # another aim than a recorded reference
        own["linestyle"] = _BEARING
    if found.kind in ("ideal", "aim") or (is_alone and found.entry.name):
        own["label"] = found.label
    if found.kind in POINTS:
        own["linestyle"] = ""
    return own


def _fit(axes: Axes, runs: Sequence[Run], plot: TimePlot, scale: Scale, *, is_forced: bool) -> None:
    """Fit an axis to the measured values, for magnitudes and commands or if forced."""
    curves = [curve for run in runs for curve in plotted_curves.list_own(run, plot)]
    if scale == "log":
        sizes = [plotted_curves.take_magnitude(curve).values for curve in curves]
        known = np.concatenate([*(values[np.isfinite(values)] for values in sizes), np.empty(0)])
        if len(known):
            axes.set_ylim(0.6 * known.min(), 1.8 * known.max())
        elif runs:
            _tell_zero(axes, runs, plotted_curves.list_plot_levels(runs, plot, scale))
    elif scale != "symlog" and (is_forced or plot.command is not None):
        levels = plotted_curves.list_plot_levels(runs, plot)
        found = plotted_curves.find_plot_range([curve.values for curve in curves], levels)
        if found is not None:
            axes.set_ylim(found)


def _tell_zero(axes: Axes, runs: Sequence[Run], levels: Sequence[Level]) -> None:
    """Write that all values are 0, which a logarithmic axis does not show, beside its levels."""
    sizes = [level.value for level in levels if level.value > 0.0] or [1.0]
    length_s = max(float(run.duration_s) for run in runs)
    axes.update_datalim([(0.0, 1.0), (length_s, 1.0)], updatey=False)  # it has no curve
    axes.set_autoscaley_on(False)
    axes.set_ylim(0.1 * min(sizes), 2.0 * max(sizes))
    text = axes.text(0.5, 0.4, "always 0", fontsize=WORDS_POINTS, color="0.3")
    text.set(transform=axes.transAxes, ha="center", va="center")


def _shade(axes: Axes, run: Run, plot: TimePlot) -> None:
    if plot.command is not None and (pushed_s := find_disturbed_time(run)) is not None:
        axes.axvspan(*pushed_s, **page.PUSHED)
    shade_gaps(axes, list_seen_gaps(run))


def shade_gaps(axes: Axes, gaps: Sequence[tuple[float, float, str]]) -> None:
    """Hatch the given segments of time [s], each with its words."""
    for start_s, end_s, words in gaps:
        axes.axvspan(start_s, end_s, **_GAP)
        text = axes.text((start_s + end_s) / 2.0, 0.5, words, fontsize=WORDS_POINTS, color="0.3")
        text.set(transform=axes.get_xaxis_transform(), ha="center", va="center", rotation=90)
        text.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.8, "alpha": 0.8})


def _name_outliers(axes: Axes, runs: Sequence[Run], plot: TimePlot) -> None:
    lines = []
    colors = many_runs.choose_colors_by_value(runs)
    for run, name, color in zip(runs, label_runs(runs), colors, strict=True):
        for found in list_plotted(run, plot):
            if found.kind != "outlier":
                continue
            hue = to_rgb(palette.choose_curve_color("outlier", color, is_alone=len(runs) == 1))
            at_s, edge = found.curve.time_s, axes.get_xaxis_transform()
            axes.plot(at_s, np.zeros(len(at_s)), transform=edge, color=hue, **_OUTLIER)
            lines.append(found.label if len(runs) == 1 else f"{name}: {found.label}")
    if lines:
        low, high = axes.get_ylim()
        axes.set_ylim(low - _OUTLIER_ROOM * len(lines) * (high - low), high)
        text = axes.text(0.99, 0.03, "\n".join(lines), fontsize=WORDS_POINTS, color="0.3")
        text.set(transform=axes.transAxes, ha="right", va="bottom")


def _finish(axes: Axes, runs: Sequence[Run], label: str) -> None:
    axes.set(xlabel=plotted_curves.label_time(runs), ylabel=label)
    axes.margins(x=0.01)
    axes.locator_params(axis="x", nbins=6)


_RED: Final = palette.to_hex(palette.VIOLATION)

_GREEN: Final = palette.to_hex(palette.FULFILLED)

_HEIGHT: Final = 0.5

_SHORT: Final = 0.01
"""Share of the time axis below which a violation is narrower than its dot of 2 mm."""

_MOST_STRIPES: Final = 60  # violations that are shaded; more would make the whole panel red

_STRIPE: Final = fix_style(color=_RED, alpha=0.3, linewidth=2.5, zorder=0.8)

_TITLE_LETTERS: Final = 11.5  # letters of a title per inch of its figure

_LEAST_INCH: Final = 2.2

_BAND: Final = fix_style(color="0.5", alpha=0.14, linewidth=0.0, zorder=0.6, label="asked for")

_LIMIT: Final = fix_style(
    color="0.4", linewidth=0.9, linestyle=STROKES[palette.LIMIT_DASH], zorder=1.6
)

_REFERENCE: Final = fix_style(color="0.5", linewidth=0.7, zorder=1.5, label="reference")

_OUTSIDE: Final = fix_style(color=_RED, linewidth=2.0, zorder=2.6, solid_capstyle="round")

_POINT: Final = fix_style(markeredgecolor="white", markeredgewidth=0.6, zorder=4)


def draw_violation(
    figure: Figure, runs: Sequence[Run], *, violated: ViolatedSignal | None = None
) -> None:
    """Draw the signal of a check with its band; for a passed check, also the closest approach.

    Raises:
        ShowError: If there is not exactly one run, or nothing was checked.
    """
    figure_curves.require_one_run("violation", runs)
    if violated is None:
        raise ShowError("figure violation needs a formula to check: --expect FORMULA")
    width = figure.get_figwidth()
    figure.set_size_inches(width, max(_HEIGHT * width, _LEAST_INCH))
    axes = figure.subplots()
    curve, holds = violated.curve, not violated.outside.any()
    _draw_band(axes, violated)
    draw_curve(axes, curve, **choose_lines(1)[0], label=label_runs(runs)[0])
    _draw_outside(axes, violated)
    axes.set(xlabel=plotted_curves.label_time(runs), ylabel=violated.title.replace("_", " "))
    axes.margins(x=0.01)
    _keep_band_in_view(axes, violated)
    told = "holds" if holds else "violated"
    title = "\n".join(textwrap.wrap(f"{violated.expected}: {told}", int(_TITLE_LETTERS * width)))
    axes.set_title(title, color=_GREEN if holds else _RED)
    word = "nearest to the limit:" if holds else violated.worst_word
    named = {violated.metric or word: violated.worst}
    if not holds and violated.first != violated.worst:
        named["first"] = violated.first
    _name_moments(axes, violated, named)


def _draw_band(axes: Axes, violated: ViolatedSignal) -> None:
    time_s = violated.curve.time_s
    if violated.reference is not None:
        axes.plot(time_s, violated.reference, **_REFERENCE)
    names = violated.describe_limits()
    for side, end, away in (("low", violated.low, -2.0), ("high", violated.high, 2.0)):
        if end is None:
            continue
        figure_curves.draw_thinned(axes, time_s, end, end, **_LIMIT)
        for last in np.flatnonzero(np.isfinite(end))[-1:]:
            at = (float(time_s[last]), float(end[last]))
            text = axes.annotate(names[side], at, (0.0, away), textcoords="offset points")
            va = "top" if side == "low" else "bottom"
            text.set(fontsize=6.5, color=_LIMIT["color"], ha="right", va=va, zorder=2.4)
            text.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.2, "alpha": 0.75})


def _draw_outside(axes: Axes, violated: ViolatedSignal) -> None:
    """Draw the part outside in red, with stripes where it is too short to be visible."""
    outside, curve, time_s = violated.outside, violated.curve, violated.curve.time_s
    if not outside.any():
        return
    before, after = np.r_[False, outside[:-1]], np.r_[outside[1:], False]
    shown = outside | before if curve.holds else outside  # a value is held until the next row
    # The duration outside; for a single row, also how long the value is held.
    told = f"{float(np.append(np.diff(time_s), 0.0)[outside].sum()):.3g} s"
    told = f"one row, {told}" if outside.sum() == 1 else told
    drawstyle = "steps-post" if curve.holds else "default"
    label = f"outside: {violated.metric or told}"
    values = np.where(shown, curve.values, np.nan)
    axes.plot(time_s, values, drawstyle=drawstyle, **_OUTSIDE, label=label)
    alone = outside & ~before & ~after
    axes.plot(time_s[alone], curve.values[alone], "o", ms=2.5, color=_RED, zorder=2.6)
    begin_s = time_s[outside & ~before]
    ends = np.flatnonzero(np.r_[False, outside] & ~np.r_[outside, False])
    end_s = time_s[np.minimum(ends, len(time_s) - 1)]
    is_short = end_s - begin_s < _SHORT * float(time_s[-1] - time_s[0])
    for at_s in ((begin_s + end_s) / 2.0)[is_short][:_MOST_STRIPES].tolist():
        axes.axvline(at_s, **_STRIPE)


def _keep_band_in_view(axes: Axes, violated: ViolatedSignal) -> None:
    """Shade the band. If the signal goes far beyond the band, show only the part near it."""
    shown = violated.find_range()
    low, high = shown.low, shown.high
    if shown.note:
        text = axes.text(0.99, 0.98, shown.note, fontsize=6.5, color="0.4", ha="right", va="top")
        text.set_transform(axes.transAxes)
    time_s, whole = violated.curve.time_s, np.ones(len(violated.curve.values))
    below = low * whole if violated.low is None else violated.low
    above = high * whole if violated.high is None else violated.high
    if not violated.metric:  # the moment of a metric has no span to shade
        is_stepped = violated.curve.holds and violated.is_moving
        axes.fill_between(time_s, below, above, step="post" if is_stepped else None, **_BAND)
    axes.set_ylim(low, high)


def _name_moments(
    axes: Axes, violated: ViolatedSignal, named: Mapping[str, ViolationMoment]
) -> None:
    """Mark moments, and write their names where the text covers least."""
    figure = axes.get_figure(root=True)
    width, height = figure.get_size_inches() if figure is not None else (1.0, 1.0)
    x, y = np.array(axes.get_xlim()), np.array(axes.get_ylim())
    place = WordSpace(
        center=np.array([x.mean(), y.mean()]),
        half=np.array([np.ptp(x), np.ptp(y)]) / 2.0,
        half_mm=25.4 * np.array([0.44 * width, 0.36 * height]),
    )
    time_s = violated.curve.time_s
    for values in (violated.curve.values, violated.low, violated.high):
        if values is not None:
            place.avoid_line(np.stack([time_s, values], axis=1)[np.isfinite(values)])
    for moment in named.values():
        place.avoid_point(np.array([moment.time_s, moment.value]))
    for (word, moment), marker in zip(named.items(), ("o", "v"), strict=False):
        color = _RED if violated.outside.any() else _GREEN
        axes.plot([moment.time_s], [moment.value], marker, ms=5.5, color=color, **_POINT)
        text = f"{word} {format_number(moment.value, violated.unit)}\nat {moment.time_s:.3f} s"
        if moment is violated.worst and (distance := violated.describe_outside(moment)):
            text += f"\n{distance} outside"
        place_words(axes, place, text, np.array([moment.time_s, moment.value]), color, 7.0)
