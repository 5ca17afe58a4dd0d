"""Effect of chance on a run: the ends and values of its starts, with and without effects."""

import re
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from turtlelog.charts import luck_chart, palette
from turtlelog.draw.figures.page import SIDE_BY_SIDE_INCH, to_rgb
from turtlelog.draw.figures.placed_words import WordSpace, measure_text_mm, name_ring, place_words
from turtlelog.errors import ExplainError, ShowError
from turtlelog.explain import Luck, Work, choose_metric, measure_luck, require_causes
from turtlelog.run import Run

_POINTS: Final = 7.0
_TITLE_POINTS: Final = 8.0
_LINE_INCH: Final = 1.3 * _TITLE_POINTS / 72.0
_LABEL_INCH: Final = 1.25 * _POINTS / 72.0

_PANEL_INCH: Final = 2.4
"""Smallest height of the curves [inch]; five labels beside them take a quarter of it."""

_AXIS_INCH: Final = 0.45
"""Height of the axis below the curves with its text [inch]."""

_GHOST: Final = (0.5, 0.5, 0.5)
_GHOST_WORDS: Final = (0.35, 0.35, 0.35)
"""Colour of a ghost's text; a lighter grey would not be visible on paper."""

_DARKER: Final = 0.7
"""Factor by which a colour for text on paper is darkened, because its strokes are thin."""

_DOT_MM: Final = 1.2
"""Half the size of the run's own mark in print [mm]."""

_DASHES: Final[tuple[Any, ...]] = ((0, (6, 1.5)), (0, (3, 1.2, 1, 1.2)), (0, (1.6, 0.9)))
"""Dash patterns of the curves without one cause, chosen so that coinciding curves are all
visible."""

_MINUS: Final = "\N{MINUS SIGN}"


def measure_luck_for_figure(
    runs: Sequence[Run],
    *,
    metric: str | None = None,
    work: Work | None = None,
) -> Luck:
    """Measure the effect of chance on one run; the default metric is the choice of `explain`.

    Raises:
        ShowError: If there is not exactly one run, or nothing can be shown. The message says why.
    """
    if len(runs) != 1:
        raise ShowError(f"figure luck: expected one recording, found {len(runs)}")
    (run,) = runs
    chosen = metric or choose_metric(run.declaration)
    require_causes(run, chosen, None)
    try:
        return measure_luck(run, metric=chosen, work=work)
    except ExplainError as err:
        raise ShowError(f"figure luck of {run.name}: {err}") from err


def draw_luck(figure: Figure, runs: Sequence[Run], *, luck: Luck | None = None) -> None:
    """Draw the ends of one run's starts, and the value over the starts.

    The values are by default those of `measure_luck_for_figure`.
    """
    shown = luck_chart.build_luck_picture(luck or measure_luck_for_figure(runs))
    width = float(figure.get_figwidth())
    title = _wrap(shown.sentences, 25.4 * (0.98 * width - 0.1))
    head = (len(title.split("\n")) + 0.5) * _LINE_INCH
    high = max(0.36 * width, _PANEL_INCH) + _AXIS_INCH
    figure.suptitle(title, x=0.05 / width, ha="left", fontsize=_TITLE_POINTS)
    if shown.plane is None:
        figure.set_size_inches(width, head + high)
        curves = figure.subplots()
    elif width < SIDE_BY_SIDE_INCH:
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


def _wrap(sentences: Sequence[str], width_mm: float) -> str:
    """Return sentences on one line if they fit, else each on its own line."""
    whole = _break_lines(" ".join(sentences), width_mm)
    parts = [line for text in sentences for line in _break_lines(text, width_mm)]
    return "\n".join(whole if len(whole) == 1 else parts)


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
        color, zorder = _choose_color(line), 3.0 - 0.1 * number
        # Points show the run's values if there is only one between two jumps.
        dashes = _DASHES[(number - 1) % len(_DASHES)] if line.kind == "cause" else "-"
        looks: dict[str, Any] = {"color": color, "zorder": zorder, "linestyle": dashes, "lw": 1.2}
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
        words = _darken(line)
        leader: dict[str, Any] = {"color": words, "lw": 0.5, "clip_on": False, "zorder": 1.5}
        if abs(place - end[1]) > 0.3 * height or end[0] < right:
            axes.plot([end[0], right + 2.0 * gap], [end[1], place], **leader)
        axes.text(
            right + 2.4 * gap, place, line.name, color=words, fontsize=_POINTS, va="center_baseline"
        )


def _mark_recorded(
    axes: Axes, shown: luck_chart.LuckPicture, recorded: tuple[float, float]
) -> None:
    """Mark the run itself, with text on the side of the curve that has more room."""
    color = _choose_color(shown.lines[0])
    axes.plot(*recorded, "o", ms=6.0, color=color, mec="white", mew=0.6, zorder=3.5)
    low, high = shown.limits
    is_high = recorded[1] > (low + high) / 2.0
    words = axes.annotate(
        shown.recorded_name,
        recorded,
        xytext=(0.0, -16.0 if is_high else 16.0),
        textcoords="offset points",
        color=_darken(shown.lines[0]),
        fontsize=_POINTS,
        ha="center",
        va="top" if is_high else "bottom",
        arrowprops={"arrowstyle": "-", "color": color, "lw": 0.6, "shrinkA": 0.5, "shrinkB": 2.0},
        zorder=4.0,
    )
    words.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.4, "alpha": 0.75})


def _choose_color(line: luck_chart.LuckLine) -> tuple[float, ...]:
    return _GHOST if line.kind == "ghost" else to_rgb(line.color)


def _darken(line: luck_chart.LuckLine) -> tuple[float, ...]:
    if line.kind == "ghost":
        return _GHOST_WORDS
    return tuple(_DARKER * part for part in to_rgb(line.color))


def _draw_plane(axes: Axes, plane: luck_chart.LuckPlane, side_inch: float) -> None:
    """Draw the ends around the goal, and rings for scale."""
    half = plane.half_m
    place = WordSpace(
        center=np.zeros(2), half=np.full(2, half), half_mm=np.full(2, 12.7 * side_inch)
    )
    for ring_m in plane.rings_m:
        axes.add_patch(Circle((0.0, 0.0), ring_m, fill=False, color="0.8", lw=0.5, zorder=1.2))
    axes.plot(0.0, 0.0, "+", ms=9.0, mew=1.0, color="black", zorder=1.8)
    axes.plot(*plane.ghosts_m.T, "o", ms=2.4, color=_GHOST, zorder=2.4)
    run = to_rgb(palette.MAIN)
    axes.plot(*plane.ends_m.T, "o", ms=3.2, mfc="none", mec=run, mew=0.7, zorder=2.2)
    axes.plot(*plane.recorded_m, "o", ms=6.0, color=run, mec="white", mew=0.6, zorder=2.8)
    scale = place.half / place.half_mm
    ends_mm = np.concatenate([plane.ends_m, plane.ghosts_m]) / scale
    for end_mm in np.unique(ends_mm.round(), axis=0):  # ends within a millimetre are drawn once
        place.avoid_point(end_mm * scale, _DOT_MM)
    place.avoid_point(plane.recorded_m, _DOT_MM)
    darker = tuple(_DARKER * part for part in run)
    place_words(axes, place, "this run", plane.recorded_m, darker, _POINTS)
    if plane.note:
        middle = np.median(plane.ghosts_m, axis=0)
        place_words(axes, place, plane.note, middle, _GHOST_WORDS, _POINTS)
    for ring_m, name in zip(plane.rings_m, plane.names, strict=True):
        name_ring(axes, place, name, ring_m)
    axes.set(aspect="equal", xlim=(-half, half), ylim=(-half, half), title=plane.title)
    axes.set_axis_off()
