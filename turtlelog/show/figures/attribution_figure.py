"""The attribution of one run: a waterfall of its shares, beside the run and its ghost."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from turtlelog.errors import ShowError
from turtlelog.explain import (
    Attribution,
    Work,
    attribute_run,
    choose_metric,
    identify_run,
    require_mechanisms,
    simulate_what_ifs,
)
from turtlelog.loops import SIGNAL_WORDS
from turtlelog.run import Run
from turtlelog.show.attribution_steps import (
    AttributionStep,
    choose_step_scale,
    list_attribution_steps,
)
from turtlelog.show.close_up import find_close_up, format_length
from turtlelog.show.figures.direct_labels import Place, measure_text_mm, name_ring, place_words
from turtlelog.show.figures.figure_curves import draw_curve, draw_thinned
from turtlelog.show.figures.page import REFERENCE, choose_lines, label_runs
from turtlelog.show.palette import Color
from turtlelog.show.shared_curves import list_levels, read_curve

Values = NDArray[np.float64]

_WORDS_POINTS: Final = 7.0
_SIDE_BY_SIDE_INCH: Final = 5.0
"""Narrower than this, both panels would be smaller than their words: they stand over each other."""

_BAR: Final = 0.62
"""Height of a bar, of the room of its line."""

_GHOST: Final[Mapping[str, Any]] = MappingProxyType(
    {"color": "0.55", "linestyle": (0, (5, 1.5)), "linewidth": 1.3, "zorder": 1.9}
)
_RING: Final[Mapping[str, Any]] = MappingProxyType(
    {"fill": False, "color": "0.78", "linewidth": 0.5, "linestyle": (0, (4, 2)), "zorder": 1.2}
)
_CONNECTOR: Final[Mapping[str, Any]] = MappingProxyType({"color": "0.5", "linewidth": 0.6})


@dataclass(frozen=True, slots=True, kw_only=True)
class Explained:
    """A run with what caused its value, and its ghost.

    Attributes:
        run: As recorded.
        found: The attribution; it has shares, or nothing to divide.
        ghost: What it would have been without all that acts; None where nothing does.
        ghost_name: What the ghost lacks, in words.
    """

    run: Run
    found: Attribution
    ghost: Run | None
    ghost_name: str = ""


def explain_for_figure(
    runs: Sequence[Run],
    *,
    metric: str | None = None,
    report: Callable[[int, int], None] | None = None,
) -> Explained:
    """Explain one run, as `turtlelog explain` does.

    Args:
        runs: One.
        metric: Its id; the same as `explain` chooses unless given.
        report: Called with the simulations that are done, and how many there are.

    Raises:
        ShowError: Where there is not one run, or it has no shares; the line says why.
    """
    if len(runs) != 1:
        raise ShowError(f"figure attribution: expected one recording, found {len(runs)}")
    (run,) = runs
    chosen = metric or choose_metric(run.declaration)
    require_mechanisms(run, chosen, None)
    identified = identify_run(run)
    if identified.scenario is None:
        reason = next(iter(identified.notes), "no scenario stands for this log").rstrip(".")
        raise ShowError(
            f"figure attribution: expected a scenario of {run.name}, found none: {reason}"
        )
    work = Work(report=report)
    found = attribute_run(run, metric=chosen, identified=identified, work=work)
    if not list_attribution_steps(found):
        raise ShowError(
            f"figure attribution: expected shares of {chosen}, found none: {_tell(found)}"
        )
    ghosts = simulate_what_ifs(identified, found)
    name, ghost = next(reversed(ghosts.items()), ("", None))
    return Explained(run=run, found=found, ghost=ghost, ghost_name=name)


def _tell(found: Attribution) -> str:
    """Return in one clause why there are no shares."""
    if found.withheld:
        return found.withheld
    if found.without_value:
        case = found.without_value[0]
        return f"with {' and '.join(case.mechanisms)} it has no value: {case.reason}"
    return found.reason or "it has no value without the effects"


def draw_attribution(
    figure: Figure, runs: Sequence[Run], *, explained: Explained | None = None
) -> None:
    """Draw the waterfall of a run's metric, beside the run and its ghost.

    Args:
        figure: To draw on.
        runs: One.
        explained: What `explain_for_figure` returned; it is called where this is not given.
    """
    told = explained or explain_for_figure(runs)
    steps = list_attribution_steps(told.found)
    width = figure.get_figwidth()
    line_inch = 0.27
    if width < _SIDE_BY_SIDE_INCH:
        low = line_inch * (len(steps) + 2.0)
        figure.set_size_inches(width, 0.82 * width + low)
        seen, bars = figure.subplots(2, 1, height_ratios=[0.82 * width, low])
        room_inch = 0.72 * width
    else:
        figure.set_size_inches(width, max(0.42 * width, line_inch * (len(steps) + 2.5)))
        seen, bars = figure.subplots(1, 2, width_ratios=[1.0, 1.35])
        room_inch = 0.41 * width
    _draw_run_and_ghost(seen, told)
    _draw_waterfall(bars, told.found, steps, room_inch)


def _draw_waterfall(
    axes: Axes, found: Attribution, steps: Sequence[AttributionStep], room_inch: float
) -> None:
    scale = choose_step_scale(found)
    starts = np.array([step.start for step in steps]) * scale.factor
    ends = np.array([step.end for step in steps]) * scale.factor
    low, high = min(0.0, *starts, *ends), max(0.0, *starts, *ends)
    rights = np.maximum(starts, ends)
    texts = [re.sub("^-", "−", step.text) for step in steps]
    span = _find_span(texts, rights - low, high - low or 1.0, room_inch)
    if span > 2.2 * (high - low or 1.0):
        # Words longer than the panel's half would leave no room for bars.
        texts = [text.replace(", ", ",\n", 1) for text in texts]
        span = _find_span(texts, rights - low, high - low or 1.0, room_inch)
    for row, (step, text) in enumerate(zip(steps, texts, strict=True)):
        color = "0.62" if step.kind == "left" else _to_rgb(step.color)
        axes.barh(row, ends[row] - starts[row], left=starts[row], height=_BAR, color=color)
        words = f" {text}" if "\n" not in text else text
        axes.text(rights[row] + 0.012 * span, row, words, va="center", fontsize=_WORDS_POINTS)
        if row + 1 < len(steps):
            at, below = ends[row], row + 1 - _BAR / 2.0
            axes.plot([at, at], [row + _BAR / 2.0, below], **_CONNECTOR)
    axes.axvline(0.0, color="0.2", linewidth=0.6)
    names = [f"− {step.name}" if step.mechanism else step.name for step in steps]
    axes.set_yticks(range(len(steps)), names)
    axes.tick_params(axis="y", length=0.0, labelsize=_WORDS_POINTS + 0.5)
    axes.spines["left"].set_visible(False)
    axes.grid(visible=False, axis="y")
    axes.set(ylim=(len(steps) - 0.5, -0.6), xlim=(low - 0.02 * span, low + span))
    words = found.metric.replace("_", " ").replace("final.", "final ").replace("run.", "")
    unit = f" [{scale.unit}]" if scale.unit else ""
    seeds = "" if found.seeds is None else f"\nshares: means over {found.seeds.used} seeds"
    axes.set(xlabel=f"{words.replace('.', ' ')}{unit}{seeds}", title=f"what caused {steps[0].text}")


def _find_span(texts: Sequence[str], rights: Values, least: float, room_inch: float) -> float:
    """Return how wide the axis must be for the words beside the bars, in the unit of the bars."""
    span = least
    for text, right in zip(texts, rights, strict=True):
        words_inch = max(map(measure_text_mm, text.split("\n"))) / 25.4 + 0.08
        share = min(words_inch / room_inch, 0.8)
        span = max(span, float(right) / (1.0 - share), least * min(1.0, words_inch / room_inch))
    return 1.02 * span


def _to_rgb(color: Color) -> tuple[float, ...]:
    return tuple(part / 255.0 for part in color)


def _draw_run_and_ghost(axes: Axes, told: Explained) -> None:
    """Draw what the metric is of: where the run ends, or the signal of its loop."""
    loop = told.run.declaration.find_loop(told.found.metric.rpartition(".")[0])
    if loop is None and told.found.metric != "final.heading_error":
        _draw_ends(axes, told)
        return
    signal = "heading_error" if loop is None else loop.signal
    words = "heading error" if loop is None else SIGNAL_WORDS[loop.signal]
    _draw_signals(axes, told, signal, words)


def _draw_signals(axes: Axes, told: Explained, signal: str, words: str) -> None:
    """Draw a signal of the run and of its ghost."""
    for level in {level.value for level in list_levels(told.run, signal)} or {0.0}:
        axes.axhline(level, **REFERENCE)
    lines = [(told.run, choose_lines(1)[0], "recorded")]
    if told.ghost is not None:
        lines.append((told.ghost, _GHOST, f"ghost: without {told.ghost_name}"))
    for run, looks, name in lines:
        curve = read_curve(run, signal)
        if curve is not None:
            draw_curve(axes, curve, **looks)
            axes.plot([], [], **looks, label=name)
    unit = "deg" if "heading" in signal else "m"
    axes.set(xlabel="time from the first sample [s]", ylabel=f"{words} [{unit}]")
    axes.set_title(_name(told))
    axes.legend(loc="best", frameon=True, framealpha=0.85, edgecolor="none", borderpad=0.3)


def _draw_ends(axes: Axes, told: Explained) -> None:
    """Draw where the run and its ghost end, close up where they arrive."""
    runs = [told.run] if told.ghost is None else [told.run, told.ghost]
    looks = [choose_lines(1)[0], _GHOST]
    names = ["recorded", f"ghost: without\n{told.ghost_name}"]
    close_up, goal = find_close_up(runs), told.run.goal_xy_m
    if close_up is not None:
        center, half_m = np.array(close_up.goal_xy_m), close_up.half_m
        for ring_m in close_up.rings_m:
            axes.add_patch(Circle(close_up.goal_xy_m, ring_m, **_RING))
    else:
        points = np.concatenate([run.poses.xy_m for run in runs] + ([[goal]] if goal else []))
        center = (points.min(axis=0) + points.max(axis=0)) / 2.0
        half_m = max(0.54 * float(np.ptp(points, axis=0).max()), 1e-3)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.set(
        xlim=center[0] + half_m * np.array([-1, 1]), ylim=center[1] + half_m * np.array([-1, 1])
    )
    axes.locator_params(nbins=5)
    axes.grid(visible=False)
    half_inch = 0.36 * axes.get_figure().get_figwidth()  # type: ignore[union-attr]
    if axes.get_figure().get_figwidth() >= _SIDE_BY_SIDE_INCH:  # type: ignore[union-attr]
        half_inch *= 0.45
    place = Place(center=center, half=half_m, half_mm=25.4 * half_inch)
    for run in runs:
        place.avoid_line(run.poses.xy_m)
    if goal is not None:
        place.avoid_point(np.array(goal))
    for run, look in zip(runs, looks, strict=False):
        xy_m = run.poses.xy_m
        draw_thinned(axes, xy_m[:, 0], xy_m[:, 1], xy_m, **look)
        place.avoid_point(xy_m[-1])
    for run, look, name in zip(runs, looks, names, strict=False):
        end = run.poses.xy_m[-1]
        color = look["color"] if run is told.run else "0.35"
        axes.plot(*end, "o", ms=4.5, color=look["color"], zorder=3, mec="white", mew=0.5)
        miss = "" if goal is None else f"\n{_tell_miss(told, float(np.hypot(*(end - goal))))} off"
        if np.abs(end - center).max() <= half_m:
            place_words(axes, place, f"{name}{miss}", end, color, _WORDS_POINTS)
    if goal is not None:
        axes.plot(*goal, "+", ms=9.0, mew=1.6, color="black", zorder=2.8)
    for ring_m in () if close_up is None else close_up.rings_m:
        name_ring(axes, place, format_length(ring_m), ring_m)
    outside = "" if close_up is None else close_up.count_outside()
    where = "whole paths" if close_up is None else "at the goal"
    axes.set_title(f"{_name(told)}, {where}{outside}")


def _tell_miss(told: Explained, miss_m: float) -> str:
    """Return a distance, with the decimals of the waterfall where that is of the same."""
    if told.found.metric == "final.position_error":
        return choose_step_scale(told.found).format_value(miss_m)
    return format_length(miss_m)


def _name(told: Explained) -> str:
    return label_runs([told.run])[0]
