"""The line above a movie: the runs by name in their colours, as large as they have room."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.text import Text

from turtlelog.charts.many_runs import shorten_names
from turtlelog.draw.figures.page import label_runs
from turtlelog.run import Run

HEIGHT: Final = 0.935
"""Of the line's middle in the picture."""

_MOST_NAMED: Final = 7
"""Names above the picture: as many as have a hue of their own."""

_NAMES_END: Final = 0.66
"""Of the width: the rest is the clock's."""

_LEAST_POINTS: Final = 10.0
"""Of a name: in a .gif of 450 pixels in height smaller letters are a blot."""


def name_runs_above(
    figure: Figure, runs: Sequence[Run], colors: Sequence[Any], *, left: float
) -> None:
    """Name runs in their colours; long names are shortened, then smaller, and of many some."""
    chosen = list(range(len(runs)))
    if len(runs) > _MOST_NAMED:
        chosen = np.linspace(0, len(runs) - 1, 4).round().astype(int).tolist()
    names = label_runs(runs)
    short = shorten_names(runs, names)
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
        figure.text(end, HEIGHT, f"({named} of {len(runs)} runs)", va="center")


def _write_names(
    figure: Figure, told: Sequence[tuple[str, Any]], points: float, left: float
) -> tuple[float, list[Text]]:
    """Write names beside each other while there is room; return where they end, and the texts."""
    texts: list[Text] = []
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    for name, color in told:
        text = figure.text(left, HEIGHT, name, color=color)
        text.set(fontsize=points, fontweight="bold", va="center")
        right = left + text.get_window_extent(renderer).width / figure.bbox.width
        if right > _NAMES_END:
            text.remove()
            break
        texts.append(text)
        left = right + 0.02
    return left, texts
