"""Names and styles of runs in figures: colours, markers, and labels in legends."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from matplotlib import rcParams
from matplotlib.font_manager import FontProperties, findfont, get_font

from turtlelog.charts import palette
from turtlelog.charts.curves import BEARING_NOW, REFERENCE as AIMED
from turtlelog.charts.many_runs import choose_colors_by_value
from turtlelog.compare import name_runs
from turtlelog.display import cut_name
from turtlelog.draw.figures.page import IDEAL_ENDS, to_rgb
from turtlelog.run import Run

_MOST_BROAD: Final = 24
"""Largest number of lines of usual width; with more, a column of 40 mm would have no space between
lines."""
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
        *(AIMED, BEARING_NOW),
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


def label_runs(runs: Sequence[Run]) -> list[str]:
    """Return a short printable name for each run; all names are different."""
    labels = [_shorten(_clean(name)) for name in name_runs(runs)]
    if len(set(labels)) < len(labels):
        labels = [f"{number}: {label}" for number, label in enumerate(labels, start=1)]
    return labels


def style_runs(runs: Sequence[Run]) -> list[tuple[Run, dict[str, Any]]]:
    """Return runs with the style of their lines, including the label in a legend."""
    styled = zip(runs, label_runs(runs), choose_run_lines(runs), strict=True)
    return [(run, {**looks, "label": name}) for run, name, looks in styled]


def _clean(name: str) -> str:
    """Return a name that matplotlib shows literally. Letters missing in its font become `?`."""
    font = get_font(findfont(FontProperties(family=rcParams["font.family"])))
    shown = "".join(
        letter if font.get_char_index(ord(letter)) else "?" for letter in " ".join(name.split())
    )
    if shown in _NAMES:
        return f"run {shown}"
    # matplotlib would leave out a name that begins with `_`.
    return f" {shown}" if shown.startswith("_") else shown


def _shorten(name: str) -> str:
    return cut_name(name, _MOST_LETTERS, tail=_TAIL, mark="…").replace("$", r"\$")
