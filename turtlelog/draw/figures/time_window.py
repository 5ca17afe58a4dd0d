"""A time window to which the time axes of a figure are cut."""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from turtlelog.charts.time_axes import find_rest
from turtlelog.draw.figures.page import Page
from turtlelog.errors import ShowError
from turtlelog.run import Run

_TIME = "time from the first"
"""Beginning of the labels of time axes."""

_MOST_AT_REST: Final = 0.6
"""Largest share of a time axis for curves that come to rest, if the axis ends there."""

_AFTER_REST: Final = 0.15
"""Length of the axis after the beginning of rest, as a share of the time before it."""


def require_window(runs: Sequence[Run], page: Page) -> None:
    """Refuse a time window in which no run has data.

    Raises:
        ShowError: With the available times.
    """
    asked = [
        (name, bound_s)
        for name, bound_s in (("from", page.from_s), ("to", page.to_s))
        if bound_s is not None
    ]
    if not asked:
        return
    if not runs:
        raise ShowError(f"{asked[0][0]}: needs a recording to cut")
    first_s, last_s = _find_span(runs)
    for name, bound_s in asked:
        if not first_s <= bound_s <= last_s:
            raise ShowError(
                f"{name}: expected {first_s:g} to {last_s:g} s, for which the runs last,"
                f" found {bound_s:g} s"
            )


def find_shown_times(runs: Sequence[Run], page: Page) -> tuple[float, float] | None:
    """Return the time window of a page [s]; None if it shows the whole runs."""
    if page.from_s is None and page.to_s is None:
        return None
    first_s, last_s = _find_span(runs)
    return (
        first_s if page.from_s is None else page.from_s,
        last_s if page.to_s is None else page.to_s,
    )


def cut_time_axes(figure: Figure, runs: Sequence[Run], page: Page) -> None:
    """Cut time axes to the page's time window, with heights that fit the visible curves.

    Without a window, an axis whose curves rest in its second half ends there.
    """
    window_s = find_shown_times(runs, page)
    if window_s is None:
        # Constant commands do not show that a robot is at rest.
        if not page.has_marks and (not runs or any(len(run.poses) for run in runs)):
            _end_at_rest(list_time_axes(figure), _find_span(runs)[1] if runs else 0.0)
        return
    for axes in list_time_axes(figure):
        is_free = axes.get_autoscaley_on()
        axes.set_xlim(*window_s)
        if is_free or axes.get_yscale() == "log":
            fit_height(axes, window_s)


def _end_at_rest(found: Sequence[Axes], end_s: float) -> None:
    """End axes where their curves come to rest in the first half, with a note."""
    is_linear = all(axes.get_yscale() == "linear" for axes in found)
    lengths_s = {axes.get_xlim()[1] for axes in found}
    if not is_linear or len(lengths_s) != 1:
        return
    rest_s = max(find_rest(_list_curves(axes), float(np.ptp(axes.get_ylim()))) for axes in found)
    if not 0.0 < rest_s < _MOST_AT_REST * min(lengths_s):
        return
    for axes in found:
        axes.set_xlim(right=(1.0 + _AFTER_REST) * rest_s)
        if label := axes.get_xlabel():
            axes.set_xlabel(f"{label}\nat rest until {end_s:.3g} s")


def _list_curves(axes: Axes) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    for line in axes.get_lines():
        if line.get_transform() == axes.transData:
            yield np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)


def list_time_axes(figure: Figure) -> list[Axes]:
    """Return the time axes. Axes above others have no label of their own."""
    found = []
    for axes in figure.axes:
        alike = axes.get_shared_x_axes().get_siblings(axes)
        if any(other.get_xlabel().startswith(_TIME) for other in alike):
            found.append(axes)
    return found


def fit_height(axes: Axes, window_s: tuple[float, float]) -> None:
    """Fit the height of an axis to its curves within a time window."""
    values = np.concatenate([*_list_visible(axes, window_s), np.empty(0)])
    is_log = axes.get_yscale() == "log"
    values = values[np.isfinite(values) & (values > 0.0 if is_log else True)]
    if not len(values):
        return
    low, high = float(values.min()), float(values.max())
    if is_log:
        axes.set_ylim(0.6 * low, 1.8 * high)
    else:
        room = 0.06 * (high - low) or 0.1 * abs(high) or 1.0
        axes.set_ylim(low - room, high + room)


def _list_visible(axes: Axes, window_s: tuple[float, float]) -> Iterator[np.ndarray]:
    """Yield the values of curves within a time window, including its ends."""
    for line in axes.get_lines():
        if line.get_transform() != axes.transData or line.get_linestyle() == "None":
            continue
        time_s, values = np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)
        inside = (time_s >= window_s[0]) & (time_s <= window_s[1])
        yield values[inside]
        if len(time_s) > 1 and time_s[0] < window_s[1] and time_s[-1] > window_s[0]:
            yield _read_edges(line, time_s, values, window_s)


def _read_edges(
    line: Line2D, time_s: np.ndarray, values: np.ndarray, window_s: tuple[float, float]
) -> np.ndarray:
    edges_s = np.clip(window_s, time_s[0], time_s[-1])
    if line.get_drawstyle() == "steps-post":
        rows = np.searchsorted(time_s, edges_s, side="right") - 1
        return values[rows]
    return np.asarray(np.interp(edges_s, time_s, values))


def _find_span(runs: Sequence[Run]) -> tuple[float, float]:
    """Return the start and end of all runs, from the first sample of each [s]."""
    starts = [min([*run.poses.time_ns[:1].tolist(), run.start_ns]) - run.start_ns for run in runs]
    ends = [run.end_ns - run.start_ns for run in runs]
    return min(starts) / 1e9, max(ends) / 1e9
