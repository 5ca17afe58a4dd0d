"""Where a plot has room for its legend: in the corner that hides least of its curves and marks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import rerun.blueprint as rrb
from numpy.typing import NDArray

from turtlelog.show.rerun.marks import Mark
from turtlelog.show.rerun.series import Series

Corners = Mapping[str, rrb.Corner2D]

_CORNERS: Final = (
    rrb.Corner2D.RightBottom,
    rrb.Corner2D.RightTop,
    rrb.Corner2D.LeftBottom,
    rrb.Corner2D.LeftTop,
)
_WIDTH: Final = 0.4  # of the plot's, as are the others
_LINE_HEIGHT: Final = 0.125
_MOST_HEIGHT: Final = 0.9
_OTHER_LINES: Final = 2  # levels, events, marks

_JUMP: Final = 0.05
"""What a jump counts at most, in heights of the plot: to hide an upright line hides little."""
_FLAT: Final = 0.05
"""What a curve counts that stands still."""
_MARK: Final = 0.3
"""What a mark counts."""
_ENOUGH: Final = 0.04
"""A corner that is better by less is not taken in place of the usual one."""

_MOST_ROWS: Final = 300


@dataclass(frozen=True, slots=True)
class _Curve:
    """A curve, or a mark as one row, in widths and heights of its plot: shapes (n,), (n, k)."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]

    def measure_hidden(self, corner: rrb.Corner2D, height: float) -> tuple[float, bool]:
        """Return how far it goes up and down beneath a legend, and whether it is there at all."""
        if corner.name.startswith("Right"):
            y = self.y[np.searchsorted(self.x, 1.0 - _WIDTH) :]
        else:
            y = self.y[: np.searchsorted(self.x, _WIDTH)]
        low, high = (1.0 - height, 1.0) if corner.name.endswith("Top") else (0.0, height)
        beneath = np.minimum(np.maximum(y, low), high)
        moves = np.minimum(np.abs(beneath[1:] - beneath[:-1]), _JUMP)
        return float(moves.sum()), bool((beneath == y).any())


def choose_corners(
    series: Sequence[Series],
    marks: Sequence[Mark],
    ranges: Mapping[str, tuple[float, float]],
    usual: Corners,
) -> Corners:
    """Return a corner for the legend of each plot: the usual one, unless another hides less."""
    times_ns = [int(curves.time_ns[row]) for curves in series for row in (0, -1)]
    if not times_ns or min(times_ns) == max(times_ns):
        return {}
    span_ns = (min(times_ns), max(times_ns))
    chosen = {}
    for plot, corner in ((plot, usual[plot]) for plot in usual.keys() & ranges.keys()):
        curves = [_place(found, span_ns, ranges[plot]) for found in series if found.plot == plot]
        points = [_place(mark, span_ns, ranges[plot]) for mark in marks if mark.plot == plot]
        if curves:
            hidden = {at: _measure_hidden(at, curves, points) for at in _CORNERS}
            best = min(_CORNERS, key=lambda at: hidden[at])
            chosen[plot] = best if hidden[best] + _ENOUGH < hidden[corner] else corner
    return chosen


def _place(found: Series | Mark, span_ns: tuple[int, int], limits: tuple[float, float]) -> _Curve:
    """Return its rows, or of many some."""
    if isinstance(found, Mark):
        time_ns, values = np.array([found.time_ns]), np.array([[found.level]])
    else:
        step = len(found.time_ns) // _MOST_ROWS + 1
        time_ns, values = found.time_ns[::step], found.values[::step]
    known = np.isfinite(values).all(axis=1)
    (start_ns, end_ns), (low, high) = span_ns, limits
    return _Curve(
        (time_ns[known] - start_ns) / (end_ns - start_ns), (values[known] - low) / (high - low)
    )


def _measure_hidden(
    corner: rrb.Corner2D, curves: Sequence[_Curve], marks: Sequence[_Curve]
) -> float:
    """Return how much a legend there hides."""
    height = min(_LINE_HEIGHT * (len(curves) + _OTHER_LINES), _MOST_HEIGHT)
    hidden = 0.0
    for found, weight in (
        *((curve, _FLAT) for curve in curves),
        *((mark, _MARK) for mark in marks),
    ):
        moves, is_there = found.measure_hidden(corner, height)
        hidden += moves + weight * is_there
    return hidden
