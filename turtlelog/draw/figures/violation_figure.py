"""The signal of a check with its allowed band, the first and the worst violation."""

import textwrap
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from turtlelog.charts import palette
from turtlelog.charts.curve_marks import ViolatedSignal, ViolationMoment
from turtlelog.charts.curves import Values
from turtlelog.charts.plotted_curves import label_time
from turtlelog.display import format_number
from turtlelog.draw.figures.figure_curves import draw_curve, draw_thinned
from turtlelog.draw.figures.page import STROKES, fix_style
from turtlelog.draw.figures.placed_words import WordSpace, place_words
from turtlelog.draw.figures.run_styles import choose_lines, label_runs
from turtlelog.errors import ShowError
from turtlelog.run import Run

_RED: Final = palette.to_hex(palette.VIOLATION)
_GREEN: Final = palette.to_hex(palette.FULFILLED)
_HEIGHT: Final = 0.5
_SHORT: Final = 0.01
"""Share of the time axis below which a violation is narrower than its dot of 2 mm."""
_MOST_STRIPES: Final = 60
"""Largest number of violations that are shaded; more would make the whole panel red."""
_STRIPE: Final = fix_style(color=_RED, alpha=0.3, linewidth=2.5, zorder=0.8)

_TITLE_LETTERS: Final = 11.5
"""Letters of a title per inch of its figure."""

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
    if len(runs) != 1:
        raise ShowError(f"figure violation: expected one recording, found {len(runs)}")
    if violated is None:
        raise ShowError("figure violation needs a formula to check: --expect FORMULA")
    width = figure.get_figwidth()
    figure.set_size_inches(width, max(_HEIGHT * width, _LEAST_INCH))
    axes = figure.subplots()
    curve, holds = violated.curve, not violated.outside.any()
    _draw_band(axes, violated)
    draw_curve(axes, curve, **choose_lines(1)[0], label=label_runs(runs)[0])
    _draw_outside(axes, violated)
    axes.set(xlabel=label_time(runs), ylabel=violated.title.replace("_", " "))
    axes.margins(x=0.01)
    _keep_band_in_view(axes, violated)
    told = "holds" if holds else "violated"
    title = "\n".join(textwrap.wrap(f"{violated.expected}: {told}", int(_TITLE_LETTERS * width)))
    axes.set_title(title, color=_GREEN if holds else _RED)
    if holds:
        word = violated.metric or "nearest to the limit:"
        _name_moments(axes, violated, {word: violated.worst})
        return
    named = {violated.metric or violated.worst_word: violated.worst}
    if violated.first != violated.worst:
        named["first"] = violated.first
    _name_moments(axes, violated, named)


def _draw_band(axes: Axes, violated: ViolatedSignal) -> None:
    time_s = violated.curve.time_s
    if violated.reference is not None:
        axes.plot(time_s, violated.reference, **_REFERENCE)
    names = violated.describe_limits()
    for side, end in (("low", violated.low), ("high", violated.high)):
        if end is not None:
            draw_thinned(axes, time_s, end, end, **_LIMIT)
            _name_limit(axes, time_s, end, names[side], is_low=side == "low")


def _name_limit(axes: Axes, time_s: Values, end: Values, name: str, *, is_low: bool) -> None:
    known = np.flatnonzero(np.isfinite(end))
    if len(known):
        at = (float(time_s[known[-1]]), float(end[known[-1]]))
        offset = (0.0, -2.0 if is_low else 2.0)
        text = axes.annotate(name, at, offset, textcoords="offset points")
        text.set(fontsize=6.5, color=_LIMIT["color"], ha="right", va="top" if is_low else "bottom")
        text.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.2, "alpha": 0.75})
        text.set_zorder(2.4)


def _draw_outside(axes: Axes, violated: ViolatedSignal) -> None:
    """Draw the part outside in red. For a held value, the next row is included."""
    outside = violated.outside
    if not outside.any():
        return
    curve = violated.curve
    shown = outside.copy()
    if curve.holds:
        shown[1:] |= outside[:-1]
    values = np.where(shown, curve.values, np.nan)
    alone = outside & ~np.r_[False, outside[:-1]] & ~np.r_[outside[1:], False]
    drawstyle = "steps-post" if curve.holds else "default"
    label = f"outside: {violated.metric or _measure_outside(violated)}"
    axes.plot(curve.time_s, values, drawstyle=drawstyle, **_OUTSIDE, label=label)
    axes.plot(curve.time_s[alone], curve.values[alone], "o", ms=2.5, color=_RED, zorder=2.6)
    for at_s in _list_short(violated)[:_MOST_STRIPES]:
        axes.axvline(at_s, **_STRIPE)


def _list_short(violated: ViolatedSignal) -> list[float]:
    """Return the middles of violations that are too short to be visible [s]."""
    time_s = violated.curve.time_s
    edges = np.diff(np.concatenate([[False], violated.outside, [False]]).astype(int))
    begin_s = time_s[np.flatnonzero(edges == 1)]
    end_s = time_s[np.minimum(np.flatnonzero(edges == -1), len(time_s) - 1)]
    is_short = end_s - begin_s < _SHORT * float(time_s[-1] - time_s[0])
    return [float(at_s) for at_s in ((begin_s + end_s) / 2.0)[is_short]]


def _measure_outside(violated: ViolatedSignal) -> str:
    """Return the duration outside as text; for a single row, also how long the value is held."""
    time_s = violated.curve.time_s
    lasts_s = np.append(np.diff(time_s), 0.0)
    rows = int(violated.outside.sum())
    told = f"{float(lasts_s[violated.outside].sum()):.3g} s"
    return f"one row, {told}" if rows == 1 else told


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
    if violated.metric:
        pass  # one moment has no span to shade
    elif violated.curve.holds and violated.is_moving:
        axes.fill_between(time_s, below, above, step="post", **_BAND)
    else:
        axes.fill_between(time_s, below, above, **_BAND)
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
