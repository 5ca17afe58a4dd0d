"""The one legend of a figure: above its panels and over no curve, each name once."""

from collections.abc import Sequence
from math import ceil
from typing import Any, Final

from matplotlib import rcParams
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.textpath import text_to_path

from turtlelog.compare import name_runs
from turtlelog.run import Run
from turtlelog.show.aims import BEARING_NOW, REFERENCE
from turtlelog.show.figures.page import IDEAL

_MOST_LETTERS: Final = 28
_NAMES: Final = frozenset(
    {
        *("goal", "goal bearing", "goal heading", "zero", "ideal", "limit", "start", "tolerance"),
        *(REFERENCE, BEARING_NOW),
    }
)
"""What figures name beside runs."""
_LINE_HEIGHT: Final = 1.45
_POINTS_PER_INCH: Final = 72.0


def label_runs(runs: Sequence[Run]) -> list[str]:
    """Return a name for each run that can be printed and is short, no two alike."""
    labels = [_shorten(_clean(name)) for name in name_runs(runs)]
    if len(set(labels)) < len(labels):
        labels = [f"{number}: {label}" for number, label in enumerate(labels, start=1)]
    return labels


def add_legend(figure: Figure) -> None:
    """Name what the panels show above them; the figure grows by the lines that this takes."""
    named: dict[str, Any] = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            named.setdefault(label, handle)
    if len(named) < 2:
        return
    width, height = figure.get_size_inches()
    columns = _count_columns(list(named), width * _POINTS_PER_INCH)
    lines = ceil(len(named) / columns)
    line_points = _LINE_HEIGHT * rcParams["legend.fontsize"]
    figure.set_size_inches(width, height + (lines + 0.5) * line_points / _POINTS_PER_INCH)
    legend = figure.legend(
        named.values(), named.keys(), loc="outside upper center", ncols=ceil(len(named) / lines)
    )
    for label, entry in zip(named, legend.legend_handles, strict=True):
        if label in (IDEAL["label"], REFERENCE, BEARING_NOW) and entry is not None:
            entry.set(color="0.35")  # for all runs, whatever the colour of the first


def _count_columns(labels: Sequence[str], width_points: float) -> int:
    """Return how many columns of the widest entry there is room for."""
    size = rcParams["legend.fontsize"]
    font = FontProperties(family=rcParams["font.family"], size=size)
    widest = max(
        text_to_path.get_text_width_height_descent(label, font, ismath=False)[0] for label in labels
    )
    around = ("handlelength", "handletextpad", "columnspacing")
    entry_points = widest + size * sum(rcParams[f"legend.{name}"] for name in around)
    return min(len(labels), max(1, int(width_points / entry_points)))


def _clean(name: str) -> str:
    """Return a name as matplotlib shows it letter by letter; `?` where its font has none."""
    font = get_font(findfont(FontProperties(family=rcParams["font.family"])))
    shown = "".join(
        letter if font.get_char_index(ord(letter)) else "?" for letter in " ".join(name.split())
    )
    if shown in _NAMES:
        return f"run {shown}"
    # A name that begins with `_` would be left out.
    return f" {shown}" if shown.startswith("_") else shown


def _shorten(name: str) -> str:
    half = _MOST_LETTERS // 2
    short = name if len(name) <= _MOST_LETTERS else f"{name[:half]}…{name[1 - half :]}"
    return short.replace("$", r"\$")
