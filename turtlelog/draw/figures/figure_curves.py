"""Curves of runs in pictures: their colours, markers and names, and the legend of a figure."""

from collections.abc import Collection, Mapping, Sequence
from math import ceil
from textwrap import fill
from typing import Any, Final

import numpy as np
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.textpath import text_to_path

from turtlelog.charts import curves, palette
from turtlelog.charts.many_runs import (
    choose_colors_by_value,
    cut_alike,
    find_color_scale,
    shorten_run_names,
)
from turtlelog.compare import name_runs
from turtlelog.display import cut_name
from turtlelog.draw.figures.page import IDEAL_ENDS, NOTE, to_rgb
from turtlelog.errors import ShowError
from turtlelog.run import Run

_MOST_SWINGS: Final = 8.0
"""Largest path of a curve up and down, in its height; along a longer path, marks would hide it."""


def draw_curve(axes: Axes, curve: curves.Curve, **looks: Any) -> None:
    """Draw a curve, as steps if its values are held. A long curve is thinned."""
    drawstyle = "steps-post" if curve.holds else "default"
    draw_thinned(axes, curve.time_s, curve.values, curve.values, drawstyle=drawstyle, **looks)


def draw_thinned(
    axes: Axes, across: curves.Values, up: curves.Values, kept: curves.Values, **looks: Any
) -> None:
    """Draw a line. If points are left out, extremes of `kept` remain and a note is added."""
    across, up = _thin(axes, across, up, kept)
    if len(up) == 1:  # a line needs two points
        looks |= {"marker": "o", "ms": 3.0, "markevery": None}
    if every := looks.get("markevery"):
        looks["markevery"] = _space_marks(up, every)
    axes.plot(across, up, **looks)


def _space_marks(up: curves.Values, every: tuple[float, float]) -> tuple[float, float] | None:
    """Return the marks of a curve: along it, or by rows if it oscillates; None if it is empty."""
    known = up[np.isfinite(up)]
    if not len(known):
        return None
    oscillates = np.abs(np.diff(known)).sum() > _MOST_SWINGS * np.ptp(known)
    first, then = every
    return (ceil(first * len(up)), ceil(then * len(up))) if oscillates else every


def draw_points(axes: Axes, across: curves.Values, up: curves.Values, **looks: Any) -> None:
    """Draw points without a joining line, thinned like lines."""
    across, up = _thin(axes, across, up, up)
    axes.plot(across, up, **looks)


def _thin(
    axes: Axes, across: curves.Values, up: curves.Values, kept: curves.Values
) -> tuple[curves.Values, curves.Values]:
    rows = curves.choose_rows(kept)
    if rows is None:
        return across, up
    note = f"curves of over {curves.MOST_POINTS:,} points are\nthinned for drawing, extremes kept"
    axes.figure.supxlabel(note, **NOTE)
    return across[rows], up[rows]


def draw_level(axes: Axes, levels: Sequence[float], **looks: Any) -> None:
    """Draw level lines with one label."""
    for number, level in enumerate(levels):
        axes.axhline(level, zorder=1.5, **{**looks, **({"label": None} if number else {})})


_LINE_HEIGHT: Final = 1.45

_OF_ALL_RUNS: Final = frozenset({"ideal", IDEAL_ENDS, curves.REFERENCE, curves.BEARING_NOW})
"""Labels of lines that have each run's colour, and are therefore colourless in a legend."""

_ALIKE: Final = (
    ("goal bearing", "goal heading", "goal", "zero"),
    ("tolerance", "limit"),
)
"""Labels that share a style in different panels; each panel shows its own label."""

_CURVES: Final = 2.0  # order in which matplotlib draws lines by default; references are below
_MOST_NAMED: Final = 12  # theoretical lines with an entry each: six rows of two entries in a column
_SOME: Final = 7
"""Number of entries of more lines, in even steps. Colours identify the lines in between."""


def add_legend(figure: Figure, without: Collection[str] = ()) -> None:
    """Add a legend above the panels, which makes the figure higher.

    Labels shown elsewhere are left out. If nothing else is left out, a single entry is left out
    too. Curves come first; curves with the same style in several panels share an entry.
    """
    named: dict[tuple[str, bool], Any] = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            if label not in without and _is_seen(axes, handle):
                # A goal is a cross in the plane, and a line over time.
                is_mark = isinstance(handle, Line2D) and handle.get_linestyle() == "None"
                named.setdefault((label, is_mark), handle)
    if len(named) < 2 and not (named and without):
        return
    groups: dict[Any, list[tuple[str, bool]]] = {}
    for key in sorted(named, key=lambda key: named[key].get_zorder() < _CURVES):
        groups.setdefault(_describe_looks(key[0], named[key]), []).append(key)
    labels = [", ".join(label for label, _ in keys) for keys in groups.values()]
    handles = [named[keys[0]] for keys in groups.values()]
    width, height = figure.get_size_inches()
    columns = count_legend_columns(labels, width * 72.0)
    lines = ceil(len(labels) / columns)
    line_points = _LINE_HEIGHT * rcParams["legend.fontsize"]
    figure.set_size_inches(width, height + (lines + 0.5) * line_points / 72.0)
    place = "outside upper center"
    legend = figure.legend(handles, labels, loc=place, ncols=ceil(len(labels) / lines))
    for label, entry in zip(labels, legend.legend_handles, strict=True):
        if label in _OF_ALL_RUNS and entry is not None:
            entry.set(color="0.35")


def _is_seen(axes: Axes, handle: Any) -> bool:
    """Return whether an entry is seen: for lines, whether any of that style is, uncovered."""
    if not isinstance(handle, Line2D) or not np.size(handle.get_ydata()):
        return True
    looks = _describe_looks("", handle)
    lines = [line for line in axes.get_lines() if _describe_looks("", line) == looks]
    return any(_is_within(axes, line) and not _is_covered(axes, line) for line in lines)


def _is_within(axes: Axes, line: Line2D) -> bool:
    """Return whether a line has a value within the limits of its axes."""
    if not line.get_transform().contains_branch_seperately(axes.transData)[1]:
        return True  # its height is a share of the axes
    values = np.asarray(line.get_ydata(), dtype=float)
    low, high = sorted(axes.get_ylim())
    return bool(((values >= low) & (values <= high)).any())


def _is_covered(axes: Axes, line: Line2D) -> bool:
    """Return whether a constant curve of the same value, solid and as wide, is above a curve.

    Of several runs, whose curves have marks, each keeps its name.
    """
    value = None if line.get_markevery() else _find_constant(line)
    begin, end = np.nanmin(line.get_xdata()), np.nanmax(line.get_xdata())
    lines = sorted(axes.get_lines(), key=Line2D.get_zorder)  # as drawn
    return value is not None and any(
        _find_constant(other) == value
        and other.get_linestyle() == "-"
        and other.get_linewidth() >= line.get_linewidth()
        and np.nanmin(other.get_xdata()) <= begin
        and np.nanmax(other.get_xdata()) >= end
        for other in lines[lines.index(line) + 1 :]
    )


def _find_constant(line: Line2D) -> float | None:
    """Return the value of a curve that never changes; None for others, and for level lines."""
    values = np.asarray(line.get_ydata(), dtype=float)
    is_level = len(values) <= _LEVEL_POINTS
    return None if is_level or np.ptp(values) != 0.0 else float(values[0])


_LEVEL_POINTS: Final = 2  # points of a line across the axes


def name_some(axes: Axes, labels: Sequence[str]) -> list[str | None]:
    """Return labels of lines for a legend. Of many lines, only some, with a note in the legend."""
    if len(labels) <= _MOST_NAMED:
        return list(labels)
    shown = {*np.linspace(0, len(labels) - 1, _SOME).round().astype(int).tolist()}
    axes.plot([], [], " ", zorder=0.0, label=f"{len(shown)} of {len(labels)} are named")
    return [label if number in shown else None for number, label in enumerate(labels)]


def _describe_looks(label: str, handle: Any) -> Any:
    """Return the key that merged entries share: the style, and for dashed lines also the name."""
    if not isinstance(handle, Line2D):
        return label
    alike = next((names for names in _ALIKE if label in names), label)
    if handle.get_linestyle() == "-":
        alike = ""
    return (alike, handle.get_color(), handle.get_linewidth(), handle.get_marker())


def count_legend_columns(labels: Sequence[str], width_points: float) -> int:
    """Return the number of legend columns that fit, each as wide as the widest entry."""
    size = rcParams["legend.fontsize"]
    font = FontProperties(family=rcParams["font.family"], size=size)
    widest = max(
        text_to_path.get_text_width_height_descent(label, font, ismath=False)[0] for label in labels
    )
    around = ("handlelength", "handletextpad", "columnspacing")
    entry_points = widest + size * sum(rcParams[f"legend.{name}"] for name in around)
    return min(len(labels), max(1, int(width_points / entry_points)))


_BAR_INCH: Final = 0.42  # height of a bar with its numbers and its name [inch]
_MOST_TICKS: Final = 7  # labels with three digits that fit a column
_BAR_LETTERS: Final = 36  # letters of the bar's name that fit a column


def add_gain_bar(figure: Figure, runs: Sequence[Run]) -> frozenset[str]:
    """Add a colour bar if a figure has more runs than distinct hues.

    Returns:
        Labels in the bar, which the legend need not repeat.
    """
    names, few = label_runs(runs), len(palette.FEW)
    named = [{*names} & {*axes.get_legend_handles_labels()[1]} for axes in figure.axes]
    if len(runs) <= few or all(len(found) <= few for found in named):
        return frozenset()
    count = len(runs)
    colors = ListedColormap(color_runs(runs))
    norm = BoundaryNorm(np.arange(count + 1) - 0.5, count)
    width, height = figure.get_size_inches()
    figure.set_size_inches(width, height + _BAR_INCH)
    place: dict[str, Any] = {"ax": figure.axes, "location": "top", "fraction": 0.04, "pad": 0.02}
    bar = figure.colorbar(ScalarMappable(norm, colors), aspect=width / 0.09, **place)
    bar.outline.set_visible(False)
    bar.ax.minorticks_off()
    scale = find_color_scale(runs)
    if scale is None:
        bar.set_ticks([])
        first, *_, last = cut_alike(names)
        bar.set_label(fill(f"{count} runs, from {first} to {last}", _BAR_LETTERS))
    else:
        places, labels = zip(*scale.list_ticks(_MOST_TICKS), strict=True)
        bar.set_ticks(places, labels=labels)
        bar.set_label(f"{scale.word} of {count} runs{f' [{scale.unit}]' if scale.unit else ''}")
    return frozenset(names)


_MOST_BROAD: Final = 24  # lines of usual width; more would touch in a column of 40 mm

_THIN: Final = 0.7

_MARKERS: Final[Mapping[palette.Marker, tuple[str, float]]] = {
    "up": ("^", 4.6),
    "diamond": ("D", 3.6),
    "down": ("v", 4.6),
    "plus": ("P", 4.8),
    "star": ("*", 6.0),
    "left": ("<", 4.6),
    "right": (">", 4.6),
}
"""Markers of matplotlib, with sizes at which they look equally large [points]."""

_MARK_EVERY: Final = 0.24
"""Distance of a run's markers on its curve, as a share of the panel's diagonal."""

_MOST_LETTERS: Final = 28

_TAIL: Final = 13
"""Number of last letters kept of a longer name: half of its letters, without the mark."""

_NAMES: Final = frozenset(
    {
        *("goal", "goal bearing", "goal heading", "zero", "limit", "path", "start"),
        *("ideal", IDEAL_ENDS),
        *("tolerance", "sensed", "dropped", "disturbance", "end", "outlier"),
        *(curves.REFERENCE, curves.BEARING_NOW),
    }
)
"""Names in figures that are not names of runs."""


def choose_colors(count: int) -> list[tuple[float, ...]]:
    """Return the colours of lines in order; they are the same as on screen."""
    return [*map(to_rgb, palette.choose_run_colors(count))]


def color_runs(runs: Sequence[Run]) -> list[tuple[float, ...]]:
    """Return the colour of each run; it is the same as on screen."""
    return [*map(to_rgb, choose_colors_by_value(runs))]


def choose_run_lines(runs: Sequence[Run]) -> Sequence[Mapping[str, Any]]:
    """Return colour and marker of each run."""
    lines = zip(choose_lines(len(runs)), color_runs(runs), strict=True)
    return [{**line, "color": color} for line, color in lines]


def choose_lines(count: int) -> Sequence[Mapping[str, Any]]:
    """Return colour and marker of each line.

    If there are more lines than hues, the first lines are on top, because the fast oscillations of
    a large gain would cover all others.
    """
    lines: list[dict[str, Any]] = [{"color": color} for color in choose_colors(count)]
    for number, (line, marker) in enumerate(
        zip(lines, palette.choose_markers(count), strict=False)
    ):
        shape, size = _MARKERS[marker]
        first = _MARK_EVERY * (number + 0.5) / count
        line |= {"marker": shape, "ms": size, "markevery": (first, _MARK_EVERY)}
        line |= {"mec": "white", "mew": 0.4}
    if count <= len(palette.FEW):
        return lines
    looks = {"linewidth": _THIN} if count > _MOST_BROAD else {}
    return [{**line, **looks, "zorder": 2.9 - 0.9 * i / count} for i, line in enumerate(lines)]


def require_one_run(figure: str, runs: Sequence[Run]) -> Run:
    """Return the only run of a figure; ShowError for none or several."""
    if len(runs) != 1:
        raise ShowError(f"figure {figure}: expected one recording, found {len(runs)}")
    return runs[0]


def label_runs(runs: Sequence[Run]) -> list[str]:
    """Return a different short name for each run, without unprintable letters and formulas."""
    font = get_font(findfont(FontProperties(family=rcParams["font.family"])))
    labels = []
    for name in name_runs(runs):
        words = " ".join(name.split())
        shown = "".join(one if font.get_char_index(ord(one)) else "?" for one in words)
        # matplotlib would leave out a name that begins with `_`.
        before = "run " if shown in _NAMES else " " if shown.startswith("_") else ""
        cut = cut_name(before + shown, _MOST_LETTERS, tail=_TAIL, mark="…")
        labels.append(cut.replace("$", r"\$"))
    if len(set(labels)) < len(labels):
        labels = [f"{number}: {label}" for number, label in enumerate(labels, start=1)]
    return labels


def style_runs(runs: Sequence[Run]) -> list[tuple[Run, dict[str, Any]]]:
    """Return runs with the style of their lines, including the label in a legend."""
    styled = zip(runs, label_runs(runs), choose_run_lines(runs), strict=True)
    return [(run, {**looks, "label": name}) for run, name, looks in styled]


NAMES_HEIGHT: Final = 0.935  # height of the line's middle, as a share of the picture
_MOST_ABOVE: Final = 7  # names above the picture: as many as there are hues

_NAMES_END: Final = 0.66
"""End of the names, as a share of the width; the rest of the width is for the clock."""

_LEAST_POINTS: Final = 10.0
"""Smallest size of a name [points]; smaller letters are illegible in a movie 450 pixels high."""


def name_runs_above(
    figure: Figure, runs: Sequence[Run], colors: Sequence[Any], *, left: float
) -> None:
    """Write names of runs in their colours. Long names are shortened, made smaller, or left out."""
    chosen = list(range(len(runs)))
    if len(runs) > _MOST_ABOVE:
        chosen = np.linspace(0, len(runs) - 1, 4).round().astype(int).tolist()
    names = label_runs(runs)
    short = shorten_run_names(runs, names)
    named, end = 0, left
    for words, points in ((names, 17.0), (short, 17.0), (short, 13.0), (short, 10.0)):
        told = [(words[number], colors[number]) for number in chosen]
        end, texts = _write_names(figure, told, points, left)
        named = len(texts)
        if named == len(chosen) or points <= _LEAST_POINTS:
            break
        for text in texts:
            text.remove()
    if named < len(runs):
        figure.text(end, NAMES_HEIGHT, f"({named} of {len(runs)} runs)", va="center")


def _write_names(
    figure: Figure, told: Sequence[tuple[str, Any]], points: float, left: float
) -> tuple[float, list[Text]]:
    """Write names side by side while there is room; return the end of the names and the texts."""
    texts: list[Text] = []
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    for name, color in told:
        text = figure.text(left, NAMES_HEIGHT, name, color=color)
        text.set(fontsize=points, fontweight="bold", va="center")
        right = left + text.get_window_extent(renderer).width / figure.bbox.width
        if right > _NAMES_END:
            text.remove()
            break
        texts.append(text)
        left = right + 0.02
    return left, texts
