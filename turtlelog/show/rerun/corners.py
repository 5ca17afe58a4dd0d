"""Where a plot has room for its legend: in the corner in which its curves move least."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import rerun.blueprint as rrb
from numpy.typing import NDArray

from turtlelog.show.rerun.series import Series

Corners = Mapping[str, rrb.Corner2D]

_SIDES: Final[Mapping[rrb.Corner2D, tuple[bool, bool]]] = {
    rrb.Corner2D.RightBottom: (True, False),
    rrb.Corner2D.RightTop: (True, True),
    rrb.Corner2D.LeftTop: (False, True),
    rrb.Corner2D.LeftBottom: (False, False),
}
"""Whether a corner is at the right, and whether at the top."""

_WIDTH: Final = 0.4
_LINE_HEIGHT: Final = 0.125
_OTHER_LINES: Final = 2  # levels, events, marks
_FLAT: Final = 0.05
"""What a curve that stands still in a corner counts, in heights of the plot."""
_ENOUGH: Final = 0.1
"""A corner that is better by less is not taken instead of the usual one."""
_MOST_ROWS: Final = 2000


def choose_corners(
    series: Sequence[Series], ranges: Mapping[str, tuple[float, float]], usual: Corners
) -> Corners:
    """Return a corner for the legend of each plot: the usual one, where that is not in the way."""
    end_ns = max((int(curves.time_ns[-1]) for curves in series), default=0)
    start_ns = min((int(curves.time_ns[0]) for curves in series), default=0)
    chosen = {}
    for plot, corner in usual.items():
        drawn = [curves for curves in series if curves.plot == plot]
        if drawn and plot in ranges and end_ns > start_ns:
            height = min(_LINE_HEIGHT * (len(drawn) + _OTHER_LINES), 0.9)
            placed = [_place(curves, (start_ns, end_ns), ranges[plot]) for curves in drawn]
            hidden = {at: _measure_hidden(placed, sides, height) for at, sides in _SIDES.items()}
            best = min(hidden, key=lambda at: hidden[at])
            chosen[plot] = best if hidden[best] + _ENOUGH < hidden[corner] else corner
    return chosen


def _place(
    curves: Series, span_ns: tuple[int, int], limits: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the rows, or some of them, in widths and heights of the plot: (n,), (n, curves)."""
    step = max(len(curves.time_ns) // _MOST_ROWS, 1)
    start_ns, end_ns = span_ns
    low, high = limits
    x = (curves.time_ns[::step] - start_ns) / (end_ns - start_ns)
    return x, (curves.values[::step] - low) / (high - low)


def _measure_hidden(
    placed: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]],
    sides: tuple[bool, bool],
    height: float,
) -> float:
    """Return how far curves move up and down beneath a legend, in heights of the plot."""
    is_right, is_top = sides
    hidden = 0.0
    for x, y in placed:
        across = (x > 1.0 - _WIDTH) if is_right else (x < _WIDTH)
        up = ((y > 1.0 - height) & (y <= 1.0)) if is_top else ((y < height) & (y >= 0.0))
        inside = up & across[:, np.newaxis]
        moves = np.abs(np.diff(y, axis=0))
        hidden += float(moves[inside[1:] & inside[:-1]].sum()) + _FLAT * bool(inside.any())
    return hidden
