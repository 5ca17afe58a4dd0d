"""Figures that explain a run: what caused its value, what chance adds, why two runs differ."""

import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Circle

from turtlelog import explain
from turtlelog.charts import attribution_steps, luck_chart, palette
from turtlelog.charts.close_up import CloseUp, find_close_up, format_length
from turtlelog.charts.curves import Values, find_steps, find_unit, list_levels, read_curve
from turtlelog.charts.plotted_curves import label_time
from turtlelog.draw.figures import page as pages
from turtlelog.draw.figures.figure_curves import (
    choose_lines,
    draw_curve,
    draw_thinned,
    label_runs,
    require_one_run,
)
from turtlelog.draw.figures.page import Page, fix_style, to_rgb, use_looks
from turtlelog.draw.figures.placed_words import WordSpace, measure_text_mm, name_ring, place_words
from turtlelog.errors import ExplainError, ShowError
from turtlelog.run import Run
from turtlelog.run.loops import SIGNAL_WORDS

_WORDS_POINTS: Final = 7.0
_BAR: Final = 0.62  # height of a bar, as a share of its row

_NEAR: Final = 0.1
"""Share of the step around the reference in which overshoot and settling are visible."""

_GOAL_MM: Final = 1.6  # half the size of the goal's cross in print [mm]
_NOTE_LETTERS: Final = 42  # longest line below the axis that fits a column [letters]

_GHOST: Final = fix_style(
    color="0.55", linestyle=pages.STROKES[palette.SUPPOSED_DASH], linewidth=1.3, zorder=1.9
)
_RING: Final = fix_style(fill=False, color="0.78", linewidth=0.5, linestyle=(0, (4, 2)), zorder=1.2)
_CONNECTOR: Final = fix_style(color="0.5", linewidth=0.6)

_BAR_INCH: Final = 0.27  # height of a bar with its text [inch]

_BARS: Final = 0.72
"""Width of the bars with the text next to them, as a share of the figure's width."""

_MINUS: Final = "\N{MINUS SIGN}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Explained:
    """A run with the causes of its value, and its ghost."""

    run: Run  # recorded run
    found: explain.Attribution  # attribution, with contributions or with nothing to divide
    ghost: Run | None  # the run without all acting causes; None if no cause acts
    ghost_name: str = ""  # causes that the ghost does not have, in words

    @property
    def lines(self) -> list[tuple[Run, Mapping[str, Any], str]]:
        """Run and ghost, with the styles of their lines and their names."""
        lines = [(self.run, choose_lines(1)[0], "recorded")]
        ghost = f"ghost: without {self.ghost_name}"
        return lines if self.ghost is None else [*lines, (self.ghost, _GHOST, ghost)]


def explain_for_figure(
    runs: Sequence[Run],
    *,
    metric: str | None = None,
    work: explain.Work | None = None,
) -> Explained:
    """Explain one run, as `turtlelog explain` does; ShowError, with the reason, if that fails."""
    run, chosen = _choose_explained("attribution", runs, metric)
    identified = explain.identify_run(run)
    if identified.scenario is None:
        reason = next(iter(identified.notes), "no scenario stands for this log").rstrip(".")
        raise ShowError(f"figure attribution needs a scenario of {run.name}: {reason}")
    found = explain.attribute_run(run, metric=chosen, identified=identified, work=work)
    if not attribution_steps.list_attribution_steps(found):
        told = found.withheld or found.reason or "it has no value without the effects"
        if found.without_value and not found.withheld:
            case = found.without_value[0]
            told = f"with {' and '.join(case.causes)} it has no value: {case.reason}"
        raise ShowError(f"figure attribution needs contributions to {chosen}: {told}")
    if not (found.acting or found.without_all):
        raise ShowError(f"figure attribution: {explain.write_headline(found)}")
    ghosts = explain.simulate_what_ifs(identified, found)
    name = next(reversed([*ghosts]), "")
    ghost = ghosts.get(name)
    return Explained(run=run, found=found, ghost=ghost, ghost_name=name)


def _choose_explained(figure: str, runs: Sequence[Run], metric: str | None) -> tuple[Run, str]:
    run = require_one_run(figure, runs)
    chosen = metric or explain.choose_metric(run.declaration)
    explain.require_causes(run, chosen, None)
    return run, chosen


def draw_attribution(
    figure: Figure, runs: Sequence[Run], *, explained: Explained | None = None
) -> None:
    """Draw one run's waterfall, by default that of `explain_for_figure`, with its ghost."""
    told = explained or explain_for_figure(runs)
    waterfall = attribution_steps.draw_up_attribution(told.found)
    width = figure.get_figwidth()
    if width < pages.SIDE_BY_SIDE_INCH:
        low = _BAR_INCH * (len(waterfall.steps) + 2.0)
        figure.set_size_inches(width, 0.82 * width + low)
        seen, bars = figure.subplots(2, 1, height_ratios=[0.82 * width, low])
        if isinstance(engine := figure.get_layout_engine(), ConstrainedLayoutEngine):
            # The square above the bars is laid out first, and takes 0.1 points from the names'
            # width.
            engine.set(w_pad=0.1)
        room_inch = _BARS * width
    else:
        figure.set_size_inches(width, max(0.42 * width, _BAR_INCH * (len(waterfall.steps) + 2.5)))
        seen, bars = figure.subplots(1, 2, width_ratios=[1.0, 1.35])
        room_inch = 0.41 * width
    loop = told.run.declaration.find_loop(told.found.metric.rpartition(".")[0])
    if loop is not None:
        _draw_signals(seen, told, loop.signal, SIGNAL_WORDS[loop.signal])
    elif told.found.metric == "final.heading_error":
        _draw_signals(seen, told, "heading_error", "heading error")
    else:
        _draw_ends(seen, told)
    _draw_waterfall(bars, waterfall, room_inch)
    bars.set_title(f"what caused {waterfall.steps[0].text}")


def _draw_waterfall(axes: Axes, waterfall: attribution_steps.Waterfall, room_inch: float) -> None:
    """Draw the bars of a waterfall with their text; `room_inch` is the width for both [inch]."""
    steps, factor = waterfall.steps, waterfall.scale.factor
    starts = np.array([step.start for step in steps]) * factor
    ends = np.array([step.end for step in steps]) * factor
    low, high = (factor * end for end in waterfall.span)
    rights = np.maximum(starts, ends)
    texts = [re.sub("^-", _MINUS, step.text) for step in steps]
    span = _find_span(texts, rights - low, high - low or 1.0, room_inch)
    if span > 2.2 * (high - low or 1.0):
        # Text wider than half of the panel would leave no room for bars.
        texts = [text.replace(", ", ",\n", 1) for text in texts]
        span = _find_span(texts, rights - low, high - low or 1.0, room_inch)
    for row, (step, text) in enumerate(zip(steps, texts, strict=True)):
        color = "0.62" if step.kind == "left" else to_rgb(step.color)
        axes.barh(row, ends[row] - starts[row], left=starts[row], height=_BAR, color=color)
        words = f" {text}" if "\n" not in text else text
        axes.text(rights[row] + 0.012 * span, row, words, va="center", fontsize=_WORDS_POINTS)
    for row, joint in enumerate(waterfall.joints):
        edges = [row + _BAR / 2.0, row + 1 - _BAR / 2.0]
        axes.plot([factor * joint] * 2, edges, **_CONNECTOR)
    axes.set_yticks(range(len(steps)), [step.name for step in steps])
    notes = [textwrap.fill(note, _NOTE_LETTERS) for note in waterfall.notes]
    axes.set_xlabel("\n".join([waterfall.label, *notes]))
    axes.axvline(0.0, color="0.2", linewidth=0.6)
    axes.tick_params(axis="y", length=0.0, labelsize=_WORDS_POINTS + 0.5)
    axes.spines["left"].set_visible(False)
    axes.grid(visible=False, axis="y")
    axes.set(ylim=(len(steps) - 0.5, -0.6), xlim=(low - 0.02 * span, low + span))


def _find_span(texts: Sequence[str], rights: Values, least: float, room_inch: float) -> float:
    """Return the width of the axis for the text next to the bars, in the unit of the bars."""
    span = least
    for text, right in zip(texts, rights, strict=True):
        words_inch = max(map(measure_text_mm, text.split("\n"))) / 25.4 + 0.08
        share = min(words_inch / room_inch, 0.8)
        span = max(span, float(right) / (1.0 - share), least * min(1.0, words_inch / room_inch))
    return 1.02 * span


def _draw_signals(axes: Axes, told: Explained, signal: str, words: str) -> None:
    """Draw a signal of the run and of its ghost, from the approach to its reference on."""
    for level in {level.value for level in list_levels(told.run, signal)} or {0.0}:
        axes.axhline(level, **pages.REFERENCE)
    window_s = _find_arrival(told, signal)
    start_s, end_s = window_s or (-np.inf, np.inf)
    shown: list[Values] = []
    for run, looks, name in told.lines:
        curve = read_curve(run, signal)
        if curve is not None:
            draw_curve(axes, curve, **looks, label=name)
            shown.append(curve.values[(curve.time_s >= start_s) & (curve.time_s <= end_s)])
    values = np.concatenate([*shown, np.zeros(0)])
    if window_s is not None and len(values):
        low, high = float(values.min()), float(values.max())
        room = 0.12 * (high - low) or 1.0
        axes.set(xlim=window_s, ylim=(low - room, high + room))
    ylabel = f"{words} [{find_unit(told.run, signal)}]"
    axes.set(xlabel=label_time([told.run]), ylabel=ylabel)
    (name,) = label_runs([told.run])
    axes.set_title(f"{name}{'' if window_s is None else ', the last tenth of the step'}")


def _find_arrival(told: Explained, signal: str) -> tuple[float, float] | None:
    """Return from when on a signal is within a tenth of its step, and its end [s]; None: never."""
    curve = read_curve(told.run, signal)
    name = told.found.metric.rpartition(".")[0]
    step = next((one for one in find_steps(told.run, signal) if one.loop.name == name), None)
    if curve is None or step is None or step.initial == step.reference:
        return None
    off = np.abs(curve.values - step.reference) / abs(step.reference - step.initial)
    near = np.flatnonzero((off <= _NEAR) & (curve.time_ns >= step.start_ns))
    if not len(near):
        return None
    start_s, end_s = float(curve.time_s[near[0]]), (step.end_ns - told.run.start_ns) / 1e9
    return (start_s, end_s) if end_s > start_s else None


def _draw_ends(axes: Axes, told: Explained) -> None:
    close_up = find_close_up([run for run, _, _ in told.lines])
    if close_up is not None and all(end.run for end in close_up.ends):
        close_up = None  # the first run, the recorded one, ends elsewhere
    goal = None if told.run.goal_xy_m is None else np.array(told.run.goal_xy_m)
    place = _choose_place(axes, told, close_up)
    for run, looks, _ in told.lines:
        xy_m = run.poses.xy_m
        draw_thinned(axes, xy_m[:, 0], xy_m[:, 1], xy_m, **looks)
        place.avoid_line(xy_m)
        place.avoid_point(xy_m[-1])
    if goal is not None:
        axes.plot(*goal, "+", ms=9.0, mew=1.6, color=pages.GOAL["color"], zorder=2.8)
        place.avoid_point(goal, _GOAL_MM)
    # The distance has the decimals of the waterfall if the waterfall shows it.
    is_shown = told.found.metric == "final.position_error"
    scale = attribution_steps.choose_step_scale(told.found)
    tell = scale.format_value if is_shown else format_length
    for run, looks, name in told.lines:
        end = run.poses.xy_m[-1]
        axes.plot(*end, "o", ms=4.5, color=looks["color"], zorder=3, mec="white", mew=0.5)
        if (np.abs(end - place.center) <= place.half).all():
            miss = "" if goal is None else f"\n{tell(float(np.hypot(*(end - goal))))} off"
            color = looks["color"] if run is told.run else "0.35"
            text = name.replace("without ", "without\n", 1) + miss
            place_words(axes, place, text, end, color, _WORDS_POINTS)
    for ring_m in () if close_up is None else close_up.rings_m:
        axes.add_patch(Circle((place.center[0], place.center[1]), ring_m, **_RING))
        name_ring(axes, place, format_length(ring_m), ring_m)
    where = "whole paths" if close_up is None else f"at the goal{close_up.count_outside()}"
    axes.set_title(f"{label_runs([told.run])[0]}, {where}")


def _choose_place(axes: Axes, told: Explained, close_up: CloseUp | None) -> WordSpace:
    """Set the limits of the panel: those of the close-up, or those of the whole paths."""
    if close_up is not None:
        center, half_m = np.array(close_up.goal_xy_m), close_up.half_m
    else:
        ghosts = [] if told.ghost is None else [told.ghost.poses.xy_m]
        goals = [] if told.run.goal_xy_m is None else [np.array([told.run.goal_xy_m])]
        points = np.concatenate([told.run.poses.xy_m, *ghosts, *goals])
        center = (points.min(axis=0) + points.max(axis=0)) / 2.0
        half_m = max(0.56 * float(np.ptp(points, axis=0).max()), 1e-3)
    sides = half_m * np.array([-1.0, 1.0])
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.set(xlim=center[0] + sides, ylim=center[1] + sides)
    axes.locator_params(nbins=5)
    axes.grid(visible=False)
    width_inch = float(axes.get_figure(root=True).get_figwidth())  # type: ignore[union-attr]
    share = 0.16 if width_inch >= pages.SIDE_BY_SIDE_INCH else 0.29
    half_mm = np.full(2, 25.4 * share * width_inch)
    return WordSpace(center=center, half=np.full(2, half_m), half_mm=half_mm)


_TITLE_POINTS: Final = 8.0

_LINE_INCH: Final = 1.3 * _TITLE_POINTS / 72.0
_LABEL_INCH: Final = 1.25 * _WORDS_POINTS / 72.0

_PANEL_INCH: Final = 2.4
"""Smallest height of the curves [inch]; five labels beside them take a quarter of it."""

_AXIS_INCH: Final = 0.45  # height of the axis below the curves with its text [inch]

_GHOST_COLOR: Final = (0.5, 0.5, 0.5)
_GHOST_WORDS: Final = (0.35, 0.35, 0.35)
"""Colour of a ghost's text; a lighter grey would not be visible on paper."""

_DOT_MM: Final = 1.2  # half the size of the run's own mark in print [mm]

_DASHES: Final[tuple[Any, ...]] = ((0, (6, 1.5)), (0, (3, 1.2, 1, 1.2)), (0, (1.6, 0.9)))
"""Dashes of the curves without one cause, such that coinciding curves are all visible."""


def measure_luck_for_figure(
    runs: Sequence[Run], *, metric: str | None = None, work: explain.Work | None = None
) -> explain.Luck:
    """Measure the effect of chance on one run; ShowError, with the reason, if that fails.

    The default metric is the choice of `explain`.
    """
    run, chosen = _choose_explained("luck", runs, metric)
    try:
        return explain.measure_luck(run, metric=chosen, work=work)
    except ExplainError as err:
        raise ShowError(f"figure luck of {run.name}: {err}") from err


def draw_luck(figure: Figure, runs: Sequence[Run], *, luck: explain.Luck | None = None) -> None:
    """Draw the ends of one run's starts, and the value over the starts.

    The values are by default those of `measure_luck_for_figure`.
    """
    shown = luck_chart.build_luck_picture(luck or measure_luck_for_figure(runs))
    width = float(figure.get_figwidth())
    wide_mm = 25.4 * (0.98 * width - 0.1)
    whole = _break_lines(" ".join(shown.sentences), wide_mm)
    parts = [line for text in shown.sentences for line in _break_lines(text, wide_mm)]
    title = "\n".join(whole if len(whole) == 1 else parts)
    head = (len(title.split("\n")) + 0.5) * _LINE_INCH
    high = max(0.36 * width, _PANEL_INCH) + _AXIS_INCH
    figure.suptitle(title, x=0.05 / width, ha="left", fontsize=_TITLE_POINTS)
    if shown.plane is None:
        figure.set_size_inches(width, head + high)
        curves = figure.subplots()
    elif width < pages.SIDE_BY_SIDE_INCH:
        side = 0.6 * width
        figure.set_size_inches(width, head + side + high)
        plane, curves = figure.subplots(2, 1, height_ratios=[side, high])
        _draw_plane(plane, shown.plane, side - _LINE_INCH)
    else:
        figure.set_size_inches(width, head + high)
        plane, curves = figure.subplots(1, 2, width_ratios=[1.0, 1.6])
        side = min(high - _LINE_INCH, 0.34 * width)
        _draw_plane(plane, shown.plane, side)
    _draw_curves(curves, shown, high - _AXIS_INCH)


def _break_lines(text: str, width_mm: float) -> list[str]:
    lines = [""]
    for word in re.sub(r"-(?=\d)", _MINUS, text).split():
        longer = f"{lines[-1]} {word}".strip()
        if lines[-1] and measure_text_mm(longer, _TITLE_POINTS) > width_mm:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines


def _draw_curves(axes: Axes, shown: luck_chart.LuckPicture, height_inch: float) -> None:
    ends = []
    for number, line in enumerate(shown.lines):
        color = _GHOST_COLOR if line.kind == "ghost" else to_rgb(line.color)
        # Points show the run's values if there is only one between two jumps.
        dashes = _DASHES[(number - 1) % len(_DASHES)] if line.kind == "cause" else "-"
        looks: dict[str, Any] = {"color": color, "linestyle": dashes, "lw": 1.2}
        looks["zorder"] = 3.0 - 0.1 * number
        for first, last in line.pieces:
            rows = slice(first, last + 1)
            marker = "o" if line.kind == "run" or first == last else ""
            size = 2.4 if line.kind == "run" else 1.6
            axes.plot(shown.places[rows], line.values[rows], marker=marker, ms=size, **looks)
        ends.append(shown.find_end(line))
    if shown.recorded is not None:
        _mark_recorded(axes, shown, shown.recorded)
    right = float(shown.places[-1])
    gap = 0.02 * (right - float(shown.places[0]))
    axes.set(ylim=shown.limits, xlim=(shown.places[0] - gap, right + gap))
    axes.set(xlabel=shown.place_label, ylabel=shown.value_label)
    height = (shown.limits[1] - shown.limits[0]) * _LABEL_INCH / height_inch
    places = luck_chart.spread_labels([end[1] for end in ends], height, shown.limits)
    for line, end, place in zip(shown.lines, ends, places, strict=True):
        words = _GHOST_WORDS if line.kind == "ghost" else _darken(line.color)
        leader: dict[str, Any] = {"color": words, "lw": 0.5, "clip_on": False, "zorder": 1.5}
        if abs(place - end[1]) > 0.3 * height or end[0] < right:
            axes.plot([end[0], right + 2.0 * gap], [end[1], place], **leader)
        text = axes.text(right + 2.4 * gap, place, line.name, color=words, fontsize=_WORDS_POINTS)
        text.set_verticalalignment("center_baseline")


def _mark_recorded(
    axes: Axes, shown: luck_chart.LuckPicture, recorded: tuple[float, float]
) -> None:
    """Mark the run itself, with text on the side of the curve that has more room."""
    color = to_rgb(shown.lines[0].color)
    axes.plot(*recorded, "o", ms=6.0, color=color, mec="white", mew=0.6, zorder=3.5)
    low, high = shown.limits
    is_high = recorded[1] > (low + high) / 2.0
    away, va = (-16.0, "top") if is_high else (16.0, "bottom")
    arrow = {"arrowstyle": "-", "color": color, "lw": 0.6, "shrinkA": 0.5, "shrinkB": 2.0}
    looks: dict[str, Any] = {"textcoords": "offset points", "arrowprops": arrow, "zorder": 4.0}
    looks |= {"color": _darken(shown.lines[0].color), "fontsize": _WORDS_POINTS}
    words = axes.annotate(shown.recorded_name, recorded, (0.0, away), ha="center", va=va, **looks)
    words.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.4, "alpha": 0.75})


def _darken(color: palette.Color) -> tuple[float, ...]:
    """Return a colour for text on paper, darker because its strokes are thin."""
    return tuple(0.7 * part for part in to_rgb(color))


def _draw_plane(axes: Axes, plane: luck_chart.LuckPlane, side_inch: float) -> None:
    half = plane.half_m
    place = WordSpace(
        center=np.zeros(2), half=np.full(2, half), half_mm=np.full(2, 12.7 * side_inch)
    )
    for ring_m in plane.rings_m:
        axes.add_patch(Circle((0.0, 0.0), ring_m, fill=False, color="0.8", lw=0.5, zorder=1.2))
    axes.plot(0.0, 0.0, "+", ms=9.0, mew=1.0, color=pages.GOAL["color"], zorder=1.8)
    axes.plot(*plane.ghosts_m.T, "o", ms=2.4, color=_GHOST_COLOR, zorder=2.4)
    run = to_rgb(palette.MAIN)
    axes.plot(*plane.ends_m.T, "o", ms=3.2, mfc="none", mec=run, mew=0.7, zorder=2.2)
    axes.plot(*plane.recorded_m, "o", ms=6.0, color=run, mec="white", mew=0.6, zorder=2.8)
    scale = place.half / place.half_mm
    ends_mm = np.concatenate([plane.ends_m, plane.ghosts_m]) / scale
    for end_mm in np.unique(ends_mm.round(), axis=0):  # ends within a millimetre are drawn once
        place.avoid_point(end_mm * scale, _DOT_MM)
    place.avoid_point(plane.recorded_m, _DOT_MM)
    place_words(axes, place, "this run", plane.recorded_m, _darken(palette.MAIN), _WORDS_POINTS)
    if plane.note:
        middle = np.median(plane.ghosts_m, axis=0)
        place_words(axes, place, plane.note, middle, _GHOST_WORDS, _WORDS_POINTS)
    for ring_m in plane.rings_m:
        name_ring(axes, place, format_length(ring_m), ring_m)
    axes.set(aspect="equal", xlim=(-half, half), ylim=(-half, half), title=plane.title)
    axes.set_axis_off()


def write_difference_figure(
    found: explain.ExplainedDifference, path: str | Path, *, page: Page | None = None
) -> Path:
    """Write a figure of the causes of a difference between two runs, and return its path.

    Args:
        found: Result of `turtlelog.explain_difference`.
        path: File name with the suffix .pdf, .png or .svg.
        page: Page format.

    Raises:
        ShowError: If there are no contributions, or the file cannot be written.
    """
    path = pages.require_figure_path(path)
    waterfall = attribution_steps.draw_up_difference(found)
    if not waterfall.steps:
        reason = found.withheld or "no setting that differs changes the metric"
        raise ShowError(f"{path}: there are no contributions to draw: {reason}")
    page = page or Page(kind="page")
    with use_looks():
        height_inch = _BAR_INCH * (len(waterfall.steps) + 2.5)
        figure = Figure(figsize=(page.width_inch, height_inch), layout="constrained")
        _draw_waterfall(figure.subplots(), waterfall, _BARS * page.width_inch)
    return pages.write_figure(figure, path, page)
