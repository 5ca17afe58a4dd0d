"""The attribution of one run: a waterfall of its contributions, with the run and its ghost."""

import re
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Circle

from turtlelog import explain
from turtlelog.charts import attribution_steps
from turtlelog.charts.close_up import CloseUp, find_close_up, format_length
from turtlelog.charts.curves import Values, find_steps, find_unit, list_levels, read_curve
from turtlelog.charts.palette import SUPPOSED_DASH
from turtlelog.charts.plotted_curves import label_time
from turtlelog.draw.figures import page, run_styles
from turtlelog.draw.figures.figure_curves import draw_curve, draw_thinned
from turtlelog.draw.figures.placed_words import WordSpace, measure_text_mm, name_ring, place_words
from turtlelog.errors import ShowError
from turtlelog.run import Run
from turtlelog.run.loops import SIGNAL_WORDS

_WORDS_POINTS: Final = 7.0
_BAR: Final = 0.62
"""Height of a bar, as a share of its row."""

_NEAR: Final = 0.1
"""Share of the step around the reference in which overshoot and settling are visible."""

_GOAL_MM: Final = 1.6
"""Half the size of the goal's cross in print [mm]."""

_NOTE_LETTERS: Final = 42
"""Longest line below the axis that fits a column [letters]."""

_MINUS: Final = "\N{MINUS SIGN}"

_GHOST: Final = page.fix_style(
    color="0.55", linestyle=page.STROKES[SUPPOSED_DASH], linewidth=1.3, zorder=1.9
)
_RING: Final = page.fix_style(
    fill=False, color="0.78", linewidth=0.5, linestyle=(0, (4, 2)), zorder=1.2
)
_CONNECTOR: Final = page.fix_style(color="0.5", linewidth=0.6)


@dataclass(frozen=True, slots=True, kw_only=True)
class Explained:
    """A run with the causes of its value, and its ghost."""

    run: Run  # recorded run
    found: explain.Attribution  # attribution, with contributions or with nothing to divide
    ghost: Run | None  # the run without all acting causes; None if no cause acts
    ghost_name: str = ""  # causes that the ghost does not have, in words


def explain_for_figure(
    runs: Sequence[Run],
    *,
    metric: str | None = None,
    report: Callable[[int, int], None] | None = None,
) -> Explained:
    """Explain one run, as `turtlelog explain` does; `report` gets the numbers of simulations.

    Raises:
        ShowError: If there is not exactly one run, or the run has no contributions. The message
            says why.
    """
    if len(runs) != 1:
        raise ShowError(f"figure attribution: expected one recording, found {len(runs)}")
    (run,) = runs
    chosen = metric or explain.choose_metric(run.declaration)
    explain.require_causes(run, chosen, None)
    identified = explain.identify_run(run)
    if identified.scenario is None:
        reason = next(iter(identified.notes), "no scenario stands for this log").rstrip(".")
        raise ShowError(f"figure attribution needs a scenario of {run.name}: {reason}")
    work = explain.Work(report=report)
    found = explain.attribute_run(run, metric=chosen, identified=identified, work=work)
    if not attribution_steps.list_attribution_steps(found):
        raise ShowError(f"figure attribution needs contributions to {chosen}: {_tell(found)}")
    ghosts = explain.simulate_what_ifs(identified, found)
    name = next(reversed([*ghosts]), "")
    ghost = ghosts.get(name)
    return Explained(run=run, found=found, ghost=ghost, ghost_name=name)


def _tell(found: explain.Attribution) -> str:
    """Return why there are no contributions, as one clause."""
    if found.withheld:
        return found.withheld
    if found.without_value:
        case = found.without_value[0]
        return f"with {' and '.join(case.causes)} it has no value: {case.reason}"
    return found.reason or "it has no value without the effects"


def draw_attribution(
    figure: Figure, runs: Sequence[Run], *, explained: Explained | None = None
) -> None:
    """Draw the waterfall of one run's metric, with the run and its ghost.

    The explanation is by default that of `explain_for_figure`.
    """
    told = explained or explain_for_figure(runs)
    waterfall = attribution_steps.draw_up_attribution(told.found)
    width = figure.get_figwidth()
    line_inch = 0.27
    if width < page.SIDE_BY_SIDE_INCH:
        low = line_inch * (len(waterfall.steps) + 2.0)
        figure.set_size_inches(width, 0.82 * width + low)
        seen, bars = figure.subplots(2, 1, height_ratios=[0.82 * width, low])
        if isinstance(engine := figure.get_layout_engine(), ConstrainedLayoutEngine):
            # The square above the bars is laid out first, and takes 0.1 points from the names'
            # width.
            engine.set(w_pad=0.1)
        room_inch = 0.72 * width
    else:
        figure.set_size_inches(width, max(0.42 * width, line_inch * (len(waterfall.steps) + 2.5)))
        seen, bars = figure.subplots(1, 2, width_ratios=[1.0, 1.35])
        room_inch = 0.41 * width
    _draw_run_and_ghost(seen, told)
    draw_waterfall(bars, waterfall, room_inch)
    bars.set_title(f"what caused {waterfall.steps[0].text}")


def draw_waterfall(axes: Axes, waterfall: attribution_steps.Waterfall, room_inch: float) -> None:
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
        color = "0.62" if step.kind == "left" else page.to_rgb(step.color)
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


def _draw_run_and_ghost(axes: Axes, told: Explained) -> None:
    """Draw the data of the metric: the end of the run, or the signal of its loop."""
    loop = told.run.declaration.find_loop(told.found.metric.rpartition(".")[0])
    if loop is None and told.found.metric != "final.heading_error":
        _draw_ends(axes, told)
        return
    signal = "heading_error" if loop is None else loop.signal
    words = "heading error" if loop is None else SIGNAL_WORDS[loop.signal]
    _draw_signals(axes, told, signal, words)


def _draw_signals(axes: Axes, told: Explained, signal: str, words: str) -> None:
    """Draw a signal of the run and of its ghost, from the approach to its reference on."""
    for level in {level.value for level in list_levels(told.run, signal)} or {0.0}:
        axes.axhline(level, **page.REFERENCE)
    lines = [(told.run, run_styles.choose_lines(1)[0], "recorded")]
    if told.ghost is not None:
        lines.append((told.ghost, _GHOST, f"ghost: without {told.ghost_name}"))
    window_s = _find_arrival(told, signal)
    start_s, end_s = window_s or (-np.inf, np.inf)
    shown: list[Values] = []
    for run, looks, name in lines:
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
    axes.set_title(f"{_name(told)}{'' if window_s is None else ', the last tenth of the step'}")


def _find_arrival(told: Explained, signal: str) -> tuple[float, float] | None:
    """Return the time from which a loop's signal stays visibly near its reference, and its end [s].

    Near means within a tenth of the step. The result is None if the signal has no step or never
    comes near.
    """
    curve = read_curve(told.run, signal)
    steps = [step for step in find_steps(told.run, signal) if curve is not None]
    steps = [step for step in steps if told.found.metric.startswith(f"{step.loop.name}.")]
    if curve is None or not steps or steps[0].initial == steps[0].reference:
        return None
    (step, *_) = steps
    off = np.abs(curve.values - step.reference) / abs(step.reference - step.initial)
    near = np.flatnonzero((off <= _NEAR) & (curve.time_ns >= step.start_ns))
    if not len(near):
        return None
    start_s, end_s = float(curve.time_s[near[0]]), (step.end_ns - told.run.start_ns) / 1e9
    return (start_s, end_s) if end_s > start_s else None


def _draw_ends(axes: Axes, told: Explained) -> None:
    """Draw the ends of the run and its ghost, enlarged if they arrive."""
    lines = [(told.run, run_styles.choose_lines(1)[0], "recorded")]
    if told.ghost is not None:
        lines.append((told.ghost, _GHOST, f"ghost: without\n{told.ghost_name}"))
    close_up = find_close_up([run for run, _, _ in lines])
    if close_up is not None and all(end.run for end in close_up.ends):
        close_up = None  # the first run, the recorded one, ends elsewhere
    goal = None if told.run.goal_xy_m is None else np.array(told.run.goal_xy_m)
    place = _choose_place(axes, told, close_up)
    for run, looks, _ in lines:
        xy_m = run.poses.xy_m
        draw_thinned(axes, xy_m[:, 0], xy_m[:, 1], xy_m, **looks)
        place.avoid_line(xy_m)
        place.avoid_point(xy_m[-1])
    if goal is not None:
        axes.plot(*goal, "+", ms=9.0, mew=1.6, color="black", zorder=2.8)
        place.avoid_point(goal, _GOAL_MM)
    # The distance has the decimals of the waterfall if the waterfall shows it.
    is_shown = told.found.metric == "final.position_error"
    scale = attribution_steps.choose_step_scale(told.found)
    tell = scale.format_value if is_shown else format_length
    for run, looks, name in lines:
        end = run.poses.xy_m[-1]
        axes.plot(*end, "o", ms=4.5, color=looks["color"], zorder=3, mec="white", mew=0.5)
        if (np.abs(end - place.center) <= place.half).all():
            miss = "" if goal is None else f"\n{tell(float(np.hypot(*(end - goal))))} off"
            color = looks["color"] if run is told.run else "0.35"
            place_words(axes, place, f"{name}{miss}", end, color, _WORDS_POINTS)
    for ring_m in () if close_up is None else close_up.rings_m:
        axes.add_patch(Circle((place.center[0], place.center[1]), ring_m, **_RING))
        name_ring(axes, place, format_length(ring_m), ring_m)
    where = "whole paths" if close_up is None else f"at the goal{close_up.count_outside()}"
    axes.set_title(f"{_name(told)}, {where}")


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
    share = 0.16 if width_inch >= page.SIDE_BY_SIDE_INCH else 0.29
    half_mm = np.full(2, 25.4 * share * width_inch)
    return WordSpace(center=center, half=np.full(2, half_m), half_mm=half_mm)


def _name(told: Explained) -> str:
    return run_styles.label_runs([told.run])[0]
