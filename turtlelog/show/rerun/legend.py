"""The names of many runs in their colours, as a view: plots have no room for them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from turtlelog.show.rerun import entities
from turtlelog.show.rerun.entities import join_path
from turtlelog.show.run_colors import Color

_WIDTH: Final = 12.0  # in heights of a row
_LETTERS: Final = 48
_MOST_COLUMNS: Final = 4
_RADIUS: Final = 5.0  # [points]
_MOST_NAMES: Final = 28
"""In four columns and seven lines, which a window of 1200 x 860 has room for."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LegendGrid:
    """Where the names stand.

    Attributes:
        places: One per name, y downward, shape (n, 2).
        x_range: What the view shows.
        y_range: What the view shows.
    """

    places: NDArray[np.float64]
    x_range: tuple[float, float]
    y_range: tuple[float, float]


def choose_names(count: int) -> tuple[int, ...]:
    """Return which of many runs are named: as many as there is room for, the last among them.

    Colours of many runs follow their order, so that those between are known from their neighbours.
    """
    if count <= _MOST_NAMES:
        return tuple(range(count))
    return tuple(np.unique(np.linspace(0, count - 1, _MOST_NAMES).round().astype(int)).tolist())


def arrange_names(names: Sequence[str]) -> LegendGrid:
    """Return a grid with as many columns as the longest name allows."""
    longest = max(len(name) for name in names)
    columns = max(1, min(_MOST_COLUMNS, _LETTERS // longest))
    number = np.arange(len(names))
    step = _WIDTH / columns
    places = np.column_stack([(number % columns + 0.5) * step, number // columns])
    return LegendGrid(
        places=places, x_range=(0.0, _WIDTH), y_range=(-0.5, float(places[-1, 1]) + 1.0)
    )


def draw_legend(stream: rr.RecordingStream, names: Sequence[str], colors: Sequence[Color]) -> None:
    """Draw runs' names in their colours."""
    chosen = choose_names(len(names))
    shown = [names[number] for number in chosen]
    points = rr.Points2D(
        arrange_names(shown).places,
        radii=rr.Radius.ui_points(_RADIUS),
        colors=[colors[number] for number in chosen],
        labels=shown,
        show_labels=True,
    )
    stream.log(join_path(entities.LEGEND), points, static=True)
