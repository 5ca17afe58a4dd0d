"""Names of the runs in a figure: a legend above the panels, or for many runs a bar of gains."""

from collections.abc import Collection, Mapping, Sequence
from math import ceil
from typing import Any, Final

import numpy as np
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.textpath import text_to_path

from turtlelog.charts.curves import BEARING_NOW, REFERENCE as AIMED
from turtlelog.charts.many_runs import find_color_scale
from turtlelog.charts.palette import FEW
from turtlelog.draw.figures.page import IDEAL_ENDS, color_runs, label_runs
from turtlelog.run import Run

_LINE_HEIGHT: Final = 1.45
_POINTS_PER_INCH: Final = 72.0

_OF_ALL_RUNS: Final = frozenset({"ideal", IDEAL_ENDS, AIMED, BEARING_NOW})
"""Labels of lines that have each run's colour, and are therefore colourless in a legend."""

_ALIKE: Final = (
    ("goal bearing", "goal heading", "goal", "zero"),
    ("tolerance", "limit"),
    ("applied", "|applied|"),
)
"""Labels that share a style in different panels; each panel shows its own label."""

_CURVES: Final = 2.0
"""Order in which matplotlib draws lines by default; references are below."""

_MOST_NAMED: Final = 12
"""Largest number of theoretical lines with an entry each: six rows of two entries in a column."""
_SOME: Final = 7
"""Number of entries if there are more lines, in even steps. Colours identify the lines in
between."""


def add_legend(figure: Figure, without: Collection[str] = ()) -> None:
    """Add a legend above the panels, which makes the figure higher.

    Labels shown elsewhere are left out. If nothing else is left out, a single entry is left out
    too. Curves come first; curves with the same style in several panels share an entry.
    """
    named: dict[tuple[str, bool], Any] = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            if label not in without:
                # A goal is a cross in the plane, and a line over time.
                is_mark = isinstance(handle, Line2D) and handle.get_linestyle() == "None"
                named.setdefault((label, is_mark), handle)
    if len(named) < 2 and not (named and without):
        return
    labels, handles = zip(*_join_alike(named), strict=True)
    width, height = figure.get_size_inches()
    columns = count_legend_columns(labels, width * _POINTS_PER_INCH)
    lines = ceil(len(labels) / columns)
    line_points = _LINE_HEIGHT * rcParams["legend.fontsize"]
    figure.set_size_inches(width, height + (lines + 0.5) * line_points / _POINTS_PER_INCH)
    legend = figure.legend(
        handles,
        labels,
        loc="outside upper center",
        ncols=ceil(len(labels) / lines),
    )
    for label, entry in zip(labels, legend.legend_handles, strict=True):
        if label in _OF_ALL_RUNS and entry is not None:
            entry.set(color="0.35")


def name_some(axes: Axes, labels: Sequence[str]) -> list[str | None]:
    """Return labels of lines for a legend. Of many lines, only some, with a note in the legend."""
    if len(labels) <= _MOST_NAMED:
        return list(labels)
    shown = {*np.linspace(0, len(labels) - 1, _SOME).round().astype(int).tolist()}
    axes.plot([], [], " ", zorder=0.0, label=f"{len(shown)} of {len(labels)} are named")
    return [label if number in shown else None for number, label in enumerate(labels)]


def _join_alike(named: Mapping[tuple[str, bool], Any]) -> list[tuple[str, Any]]:
    """Return the entries of a legend: curves first, then the layers below them."""
    groups: dict[Any, list[tuple[str, bool]]] = {}
    for key in sorted(named, key=lambda key: named[key].get_zorder() < _CURVES):
        groups.setdefault(_describe_looks(key[0], named[key]), []).append(key)
    return [(", ".join(label for label, _ in keys), named[keys[0]]) for keys in groups.values()]


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


_BAR_INCH: Final = 0.42
"""Height of a bar with its numbers and its name [inch]."""
_MOST_TICKS: Final = 7
"""Largest number of labels with three digits that fit a column."""


def add_gain_bar(figure: Figure, runs: Sequence[Run]) -> frozenset[str]:
    """Add a colour bar if a figure has more runs than distinct hues.

    Returns:
        Labels in the bar, which the legend need not repeat.
    """
    names = label_runs(runs)
    drawn = [axes for axes in figure.axes if _names_all(axes.get_legend_handles_labels()[1], names)]
    if len(runs) <= len(FEW) or not drawn:
        return frozenset()
    count = len(runs)
    colors = ListedColormap(color_runs(runs))
    norm = BoundaryNorm(np.arange(count + 1) - 0.5, count)
    width, height = figure.get_size_inches()
    figure.set_size_inches(width, height + _BAR_INCH)
    bar = figure.colorbar(
        ScalarMappable(norm, colors),
        ax=figure.axes,
        location="top",
        fraction=0.04,
        aspect=width / 0.09,
        pad=0.02,
    )
    bar.outline.set_visible(False)
    bar.ax.minorticks_off()
    scale = find_color_scale(runs)
    if scale is None:
        bar.set_ticks([])
        bar.set_label(f"{count} runs, from {names[0]} to {names[-1]}")
    else:
        places, labels = zip(*scale.list_ticks(_MOST_TICKS), strict=True)
        bar.set_ticks(places, labels=labels)
        bar.set_label(f"{scale.word} of {count} runs{f' [{scale.unit}]' if scale.unit else ''}")
    return frozenset(names)


def _names_all(labels: Sequence[str], names: Sequence[str]) -> bool:
    return len({*names} & {*labels}) > len(FEW)
