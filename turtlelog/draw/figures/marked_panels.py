"""Time axes of a finished figure: cut to a window, and marked with characteristics."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from turtlelog.charts import curve_marks
from turtlelog.charts.curve_marks import Characteristic, list_characteristics
from turtlelog.charts.curves import Curve, Values, read_curve
from turtlelog.charts.many_runs import cut_alike
from turtlelog.charts.palette import DEAD_TIME, darken, to_hex
from turtlelog.charts.plotted_curves import find_rest
from turtlelog.draw.figures.figure_curves import label_runs, style_runs
from turtlelog.draw.figures.page import Page, fix_style
from turtlelog.draw.figures.placed_words import GUIDE_ORDER, Table, Word, write_words
from turtlelog.errors import ShowError
from turtlelog.measure import measure_run
from turtlelog.run import Run

MOST_WORDED: Final = 4
"""Largest number of runs with guides and values; of more, which cover curves, extremes are told."""

_GUIDE: Final = fix_style(linestyle=(0, (1, 1.6)), linewidth=0.7, zorder=GUIDE_ORDER)
_PAUSE: Final = fix_style(facecolor="0.90", edgecolor="none", zorder=0.4)
_DEAD: Final = fix_style(facecolor=to_hex(DEAD_TIME), alpha=0.3, edgecolor="none", zorder=0.4)
_BAND: Final = fix_style(facecolor="0.93", edgecolor="none", zorder=0.45)

_ROOM: Final = 0.04
"""Margin before and after a phase to which an axis is cut, as a share of the phase."""
_LEAST_OVERSHOOT: Final = 0.1
"""Smallest overshoot that is marked among many [%]; smaller ones are thinner than the line."""

_LEAST_PAUSE: Final = 0.005
"""Smallest visible pause as a share of an axis: a third of a millimetre in a column."""

_DEAD_WORDS: Final = to_hex(darken(DEAD_TIME))
_CUT: Final = 0.8
"""Largest share of the whole axis that a phase may have for the axis to be cut to it."""

_COORDINATES: Final = frozenset({"x", "y", "error_x", "error_y"})
_WAYS: Final = frozenset({"along_track", "distance"})
"""Signals controlled by loops that move a robot to its goal."""
_MOMENTS: Final = frozenset({"settling_time", "time_to_goal", "position_error"})

_SHAPES: Final[Mapping[curve_marks.MarkShape, str]] = {"disc": "o", "square": "s", "cross": "x"}
"""Mark shapes of matplotlib."""

_OF_ERRORS: Final[Mapping[str, str]] = {"heading_error": "heading"}
"""Error curves that also show the characteristics of a loop's signal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Marked:
    """A panel with the marks of one of the runs."""

    axes: Axes  # axes of the panel
    curve: Curve  # curve of the run in the panel
    is_error: bool  # whether the panel shows the difference from the reference
    is_magnitude: bool  # whether the panel shows the magnitude
    is_alone: bool  # whether no other run is in the panel
    has_guides: bool  # whether lines lead from dots to the axes
    color: Any  # colour of the run

    def read(self, at_s: float) -> float:
        """Return the value of the curve at a time [s], as the panel shows it."""
        value = float(np.interp(at_s, self.curve.time_s, self.curve.values))
        return abs(value) if self.is_magnitude else value


def mark_panels(figure: Figure, runs: Sequence[Run], *, is_cut: bool) -> None:
    """Mark characteristics in the panels of controlled signals, which have the signal's name.

    The figure has its legend, and runs in this order. `is_cut` says whether its time axes are cut.
    """
    panels = [axes for axes in list_time_axes(figure) if axes.get_label()]
    if not panels:
        return
    found = [list_characteristics(run, measure_run(run)) for run in runs]
    if not is_cut:
        for axes in panels:
            _cut_to_phase(axes, found)
    words = {axes: _mark_panel(axes, runs, found) for axes in panels}
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
    for axes, (named, tables) in words.items():
        write_words(axes, named, tables)


def _mark_panel(
    axes: Axes, runs: Sequence[Run], found: Sequence[Sequence[Characteristic]]
) -> tuple[list[Word], list[Table]]:
    """Draw the guides of a panel, and return its text, or tables for several runs."""
    label = str(axes.get_label())
    signal = label.strip("|")
    height = axes.get_ylim()
    words: list[Word] = []
    told: dict[str, tuple[Any, list[_Told]]] = {}
    for (run, looks), marks, name in zip(
        style_runs(runs), found, cut_alike(label_runs(runs)), strict=True
    ):
        curve = read_curve(run, signal)
        if curve is None:
            continue
        panel = _Marked(
            axes=axes,
            curve=curve,
            is_error=signal in _OF_ERRORS,
            is_magnitude=label != signal,
            is_alone=len(runs) == 1,
            has_guides=len(runs) <= MOST_WORDED,
            color=looks["color"],
        )
        drawn = list(_mark_run(panel, choose_marks(signal, marks)))
        for mark, text in drawn if panel.is_alone else ():
            color = _DEAD_WORDS if mark.kind == "dead_time" else "0.25"
            at = (mark.marked_s, panel.read(mark.marked_s))
            words.append(Word(text=text, at=at, color=color))
        words += _shade_pauses(axes, marks) if panel.is_alone else ()
        told[name] = (looks["color"], drawn)
    axes.set_ylim(height)
    return words, [] if len(runs) == 1 else _tabulate(axes, told)


_Told = tuple[Characteristic, str]
"""A mark that is drawn, with its text."""


def choose_marks(signal: str, marks: Sequence[Characteristic]) -> list[Characteristic]:
    """Return the marks of a run that belong on the curve of a signal.

    Curves of coordinates show the times of the path to the goal, without its bands.
    """
    if signal not in _COORDINATES:
        return [mark for mark in marks if mark.signal in {signal, _OF_ERRORS.get(signal, signal)}]
    return [
        replace(mark, span_s=None, levels=None)
        for mark in marks
        if mark.signal in _WAYS and mark.kind in _MOMENTS
    ]


def _mark_run(panel: _Marked, marks: Sequence[Characteristic]) -> Iterator[_Told]:
    for mark in marks:
        is_end = mark.kind == "position_error" and str(panel.axes.get_label()) in _COORDINATES
        # The mark at the end of a coordinate shows the value instead of the distance.
        shown = replace(mark, value=panel.read(mark.at_s)) if is_end else mark
        draw = _DRAWN.get(mark.kind)
        text = draw(panel, shown, marks) if draw is not None else ""
        if text:
            yield shown, text


def _tabulate(axes: Axes, told: Mapping[str, tuple[Any, Sequence[_Told]]]) -> list[Table]:
    """Return a table with a line for each of a few runs, and a table with the extremes."""
    low, high = axes.get_xlim()
    seen = {
        name: (color, [one for one in drawn if low <= one[0].at_s <= high])
        for name, (color, drawn) in told.items()
    }
    lines = [
        (f"{name}: {', '.join(text for _, text in drawn)}", color)
        for name, (color, drawn) in seen.items()
        if drawn
    ]
    by_word: dict[tuple[str, str], list[float]] = {}
    for _, drawn in seen.values():
        for mark, _ in drawn:
            by_word.setdefault((mark.word, mark.unit), []).append(mark.value)
    extremes = []
    for (word, unit), values in by_word.items():
        least, most = f"{min(values):.3g}", f"{max(values):.3g}"
        span = least if least == most else f"{least} to {most}"
        some = "" if len(values) == len(told) else f" ({len(values)} of {len(told)} runs)"
        extremes.append((f"{word} {span} {unit}{some}", "0.25"))
    tables = [lines, extremes] if len(told) <= MOST_WORDED else [extremes]
    return [table for table in tables if table]


def has_marks(signal: str, marks: Sequence[Characteristic]) -> bool:
    """Return whether the curve of a signal has a mark of a run."""
    return any(mark.kind in _DRAWN for mark in choose_marks(signal, marks))


def _mark_span(panel: _Marked, mark: Characteristic, _: Sequence[Characteristic]) -> str:
    if not panel.is_alone or panel.is_error or mark.span_s is None:
        return ""
    if mark.kind == "rise_time":
        for at_s in mark.span_s:
            _guide(panel, mark, mark.start_s, at_s)
    elif mark.value <= 0.0:
        return ""
    else:
        panel.axes.axvspan(*mark.span_s, **_DEAD)
    return mark.text


def _mark_overshoot(panel: _Marked, mark: Characteristic, others: Sequence[Characteristic]) -> str:
    if (panel.is_error or not panel.is_alone) and mark.value < _LEAST_OVERSHOOT:
        return ""
    _guide(panel, mark, mark.start_s)
    if not panel.is_alone:
        return mark.text
    # An error has no peak: its curve shows the remaining error.
    return "\n".join(curve_marks.list_mark_texts(mark, () if panel.is_error else others))


def _mark_point(panel: _Marked, mark: Characteristic, _: Sequence[Characteristic]) -> str:
    if not panel.is_alone and mark.kind == "final_error":
        return ""
    if mark.kind == "settling_time":
        _draw_band(panel, mark)
    _guide(panel, mark, None)
    return mark.text


_POINTS: Final = (
    *("settling_time", "final_error", "time_to_goal"),
    *("position_error", "largest_error", "cross_track_max"),
)

_DRAWN: Final[Mapping[str, Callable[[_Marked, Characteristic, Sequence[Characteristic]], str]]] = {
    "rise_time": _mark_span,
    "dead_time": _mark_span,
    "overshoot": _mark_overshoot,
    **dict.fromkeys(_POINTS, _mark_point),
}
"""Functions that draw a metric and return its text, by kind. A peak is drawn with its overshoot."""


def _guide(
    panel: _Marked, mark: Characteristic, from_s: float | None, at_s: float | None = None
) -> None:
    """Draw a mark on the curve, with dotted lines to the time axis and along the curve's level."""
    at_s = mark.marked_s if at_s is None else at_s
    axes, level = panel.axes, panel.read(at_s)
    color = "0.35" if panel.is_alone else panel.color
    bottom = axes.get_ylim()[0]
    # For several runs, only settling times have a line, because the times differ.
    if panel.has_guides and (panel.is_alone or mark.kind == "settling_time"):
        axes.plot([at_s, at_s], [bottom, level], color=color, **_GUIDE)
    if panel.is_alone and from_s is not None:
        axes.plot([from_s, at_s], [level, level], color=color, **_GUIDE)
    shape = _SHAPES[mark.shape or "disc"]
    axes.plot([at_s], [level], shape, ms=3.2, mfc="white", mec=panel.color, mew=0.9, zorder=3.2)


def _draw_band(panel: _Marked, mark: Characteristic) -> None:
    if mark.levels is None or mark.span_s is None or not panel.has_guides:
        return
    low, high = mark.levels
    half = (high - low) / 2.0
    if panel.is_error:
        low, high = -half, half
    if panel.is_magnitude:
        low = panel.axes.get_ylim()[0]
    times_s = [mark.start_s, mark.span_s[1]]
    if panel.is_alone:
        panel.axes.fill_between(times_s, low, high, **_BAND)
    color = "0.35"  # also for several runs, whose bands are often the same
    for level in [high] if panel.is_magnitude else [low, high]:
        panel.axes.plot(times_s, [level, level], color=color, **_GUIDE)


def _shade_pauses(axes: Axes, marks: Sequence[Characteristic]) -> Iterator[Word]:
    """Shade the pauses that are at least half visible, and wider than a line."""
    left, right = axes.get_xlim()
    for mark in marks:
        if mark.kind != "pause" or mark.span_s is None:
            continue
        start_s, end_s = max(mark.span_s[0], left), min(mark.span_s[1], right)
        if end_s - start_s < max(0.5 * mark.value, _LEAST_PAUSE * (right - left)):
            continue
        axes.axvspan(*mark.span_s, **_PAUSE)
        bottom, top = axes.get_ylim()
        level = float(np.sqrt(bottom * top)) if axes.get_yscale() == "log" else (bottom + top) / 2.0
        at = ((start_s + end_s) / 2.0, level)
        yield Word(text=mark.text, at=at, color="0.45", span_s=(start_s, end_s))


def _cut_to_phase(axes: Axes, found: Sequence[Sequence[Characteristic]]) -> None:
    """Cut an axis to the segments of its loops, if no other panel shares the axis."""
    if len(axes.get_shared_x_axes().get_siblings(axes)) > 1:
        return
    signal = str(axes.get_label()).strip("|")
    spans = [
        (mark.start_s, mark.span_s[1])
        for marks in found
        for mark in marks
        if mark.loop and mark.signal == _OF_ERRORS.get(signal, signal) and mark.span_s is not None
    ]
    if not spans:
        return
    start_s, end_s = min(start for start, _ in spans), max(end for _, end in spans)
    low, high = axes.get_xlim()
    room = _ROOM * (end_s - start_s)
    if 0.0 < end_s - start_s < _CUT * (high - low):
        is_free = axes.get_autoscaley_on() or axes.get_yscale() == "log"
        axes.set_xlim(max(start_s - room, low), min(end_s + room, high))
        if is_free:
            fit_height(axes, axes.get_xlim())


_TIME = "time from the first"
"""Beginning of the labels of time axes."""

_MOST_AT_REST: Final = 0.6
"""Largest share of a time axis for curves that come to rest, if the axis ends there."""

_AFTER_REST: Final = 0.15
"""Length of the axis after the beginning of rest, as a share of the time before it."""


def require_window(runs: Sequence[Run], page: Page) -> None:
    """Raise ShowError, with the available times, for a time window in which no run has data."""
    for name, bound_s in (("from", page.from_s), ("to", page.to_s)):
        if bound_s is None:
            continue
        if not runs:
            raise ShowError(f"{name}: needs a recording to cut")
        first_s, last_s = _find_span(runs)
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
    from_s = first_s if page.from_s is None else page.from_s
    return from_s, last_s if page.to_s is None else page.to_s


def cut_time_axes(figure: Figure, runs: Sequence[Run], page: Page) -> None:
    """Cut time axes to the page's time window, with heights that fit the visible curves.

    Without a window, an axis whose curves rest in its second half ends there.
    """
    window_s = find_shown_times(runs, page)
    if window_s is None:
        # Constant commands do not show that a robot is at rest.
        if not page.has_marks and (not runs or any(len(run.poses) for run in runs)):
            _end_at_rest(list_time_axes(figure), runs)
        return
    for axes in list_time_axes(figure):
        is_free = axes.get_autoscaley_on()
        axes.set_xlim(*window_s)
        if is_free or axes.get_yscale() == "log":
            fit_height(axes, window_s)


def _end_at_rest(found: Sequence[Axes], runs: Sequence[Run]) -> None:
    """End axes where their curves come to rest in the first half, with a note."""
    is_linear = all(axes.get_yscale() == "linear" for axes in found)
    lengths_s = {axes.get_xlim()[1] for axes in found}
    if not is_linear or len(lengths_s) != 1:
        return
    curves = {axes: [(time_s, one) for _, time_s, one in _list_curves(axes)] for axes in found}
    rest_s = max(find_rest(own, float(np.ptp(axes.get_ylim()))) for axes, own in curves.items())
    if not 0.0 < rest_s < _MOST_AT_REST * min(lengths_s):
        return
    shown_s = (1.0 + _AFTER_REST) * rest_s
    # A robot that drives straight ahead leaves its heading and its commands nearly unchanged.
    state = "at rest" if all(_find_standstill(run) <= shown_s for run in runs) else "within 1 %"
    for axes in found:
        axes.set_xlim(right=shown_s)
        if label := axes.get_xlabel():
            end_s = _find_span(runs)[1] if runs else 0.0
            axes.set_xlabel(f"{label}\n{state} until {end_s:.3g} s")


def _find_standstill(run: Run) -> float:
    """Return the time from which a robot stays within 1 % of its motion of its last pose [s]."""
    poses = run.poses
    time_s = (poses.time_ns - run.start_ns) / 1e9
    turned_rad = np.unwrap(poses.heading_rad)
    return max(
        find_rest([(time_s, values) for values in columns], float(np.ptp(columns, axis=1).max()))
        if len(time_s)
        else 0.0
        for columns in (poses.xy_m.T, turned_rad[None])
    )


def _list_curves(axes: Axes) -> Iterator[tuple[Line2D, Values, Values]]:
    for line in axes.get_lines():
        if line.get_transform() == axes.transData:
            yield line, np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)


def list_time_axes(figure: Figure) -> list[Axes]:
    """Return the time axes. Axes above others have no label of their own."""
    return [
        axes
        for axes in figure.axes
        for alike in [axes.get_shared_x_axes().get_siblings(axes)]
        if any(other.get_xlabel().startswith(_TIME) for other in alike)
    ]


def fit_height(axes: Axes, window_s: tuple[float, float]) -> None:
    """Fit the height of an axis to its curves within a time window, including its ends."""
    parts = [np.empty(0)]
    for line, time_s, own in _list_curves(axes):
        if line.get_linestyle() == "None":
            continue
        parts.append(own[(time_s >= window_s[0]) & (time_s <= window_s[1])])
        if len(time_s) > 1 and time_s[0] < window_s[1] and time_s[-1] > window_s[0]:
            edges_s = np.clip(window_s, time_s[0], time_s[-1])
            rows = np.searchsorted(time_s, edges_s, side="right") - 1
            is_held = line.get_drawstyle() == "steps-post"
            parts.append(own[rows] if is_held else np.interp(edges_s, time_s, own))
    values, is_log = np.concatenate(parts), axes.get_yscale() == "log"
    values = values[np.isfinite(values) & (values > 0.0 if is_log else True)]
    if not len(values):
        return
    low, high = float(values.min()), float(values.max())
    if is_log:
        axes.set_ylim(0.6 * low, 1.8 * high)
    else:
        room = 0.06 * (high - low) or 0.1 * abs(high) or 1.0
        axes.set_ylim(low - room, high + room)


def _find_span(runs: Sequence[Run]) -> tuple[float, float]:
    """Return the start and end of all runs, from the first sample of each [s]."""
    starts = [min([*run.poses.time_ns[:1].tolist(), run.start_ns]) - run.start_ns for run in runs]
    ends = [run.end_ns - run.start_ns for run in runs]
    return min(starts) / 1e9, max(ends) / 1e9
