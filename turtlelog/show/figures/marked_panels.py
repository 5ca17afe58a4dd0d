"""Characteristics in panels over time: guide lines, dots, spans, and words that cover nothing."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from turtlelog.measure import measure_run
from turtlelog.run import Run
from turtlelog.show.characteristics import Characteristic, list_characteristics
from turtlelog.show.figures.direct_labels import WordSpace, measure_text_mm
from turtlelog.show.figures.page import choose_lines
from turtlelog.show.figures.time_window import fit_height, list_time_axes
from turtlelog.show.shared_curves import Curve, read_curve

Values = NDArray[np.float64]

MOST_WORDED: Final = 4
"""Of more runs the dots have neither words nor guides: these would cover the curves."""

_WORDS_POINTS: Final = 6.5
_LINE_MM: Final = 1.25 * _WORDS_POINTS * 25.4 / 72.0
_DOT_MM: Final = 0.8
_LEADER_MM: Final = 4.0
"""Words that stand further from their dot have a line to it."""

_GUIDE: Final[Mapping[str, Any]] = MappingProxyType(
    {"linestyle": (0, (1, 1.6)), "linewidth": 0.7, "zorder": 1.6}
)
_GUIDE_POINTS: Final = 40
"""Points of a guide line that words avoid: a tenth of a curve's, as it may rather be covered."""

_PAUSE: Final[Mapping[str, Any]] = MappingProxyType(
    {"facecolor": "0.90", "edgecolor": "none", "zorder": 0.4}
)
_DEAD: Final[Mapping[str, Any]] = MappingProxyType(
    {"facecolor": "#f2d9c4", "edgecolor": "none", "zorder": 0.4}
)
_BAND: Final[Mapping[str, Any]] = MappingProxyType(
    {"facecolor": "0.93", "edgecolor": "none", "zorder": 0.45}
)

_ROOM: Final = 0.04
"""Of a phase, shown before and behind it where the axis is cut to it."""
_LEAST_OVERSHOOT: Final = 0.1
"""Where other marks crowd, less [% of the step] is thinner than the line of the curve."""

_LEAST_PAUSE: Final = 0.005
"""Of an axis: a narrower stripe is a line of a third of a millimetre in a column."""

_DEAD_WORDS: Final = "#8a4f1d"
_AWAY_MM: Final = (2.0, 4.0, 7.0, 10.0, 14.0, 19.0, 25.0, 32.0)
"""How far words may stand from their dot, best first: marks of one phase end in one corner."""

_CUT: Final = 0.8
"""An axis is cut to a phase that is a smaller part of it."""

_OF_ERRORS: Final[Mapping[str, str]] = MappingProxyType({"heading_error": "heading"})
"""Errors on whose curve the characteristics of a loop's signal stand, too."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Marked:
    """A panel with the marks of one run.

    Attributes:
        axes: The panel.
        curve: What it shows of the run.
        is_error: Whether the panel shows what is missing to the reference.
        is_magnitude: Whether without its sign.
        is_alone: Whether no other run is in the panel.
        has_guides: Whether lines lead from dots to the axes.
        color: Of the run.
    """

    axes: Axes
    curve: Curve
    is_error: bool
    is_magnitude: bool
    is_alone: bool
    has_guides: bool
    color: Any

    def read(self, at_s: float) -> float:
        """Return the height of the curve at a time, as the panel shows it."""
        value = float(np.interp(at_s, self.curve.time_s, self.curve.values))
        return abs(value) if self.is_magnitude else value


@dataclass(frozen=True, slots=True, kw_only=True)
class _Word:
    """Words for a dot of a panel, or for a span of time, in which they stand upright."""

    text: str
    at: tuple[float, float]
    color: Any
    span_s: tuple[float, float] | None = None


def mark_panels(figure: Figure, runs: Sequence[Run], *, is_cut: bool) -> None:
    """Mark characteristics in the panels that show what loops control.

    Args:
        figure: Drawn, with its legend; panels that are to be marked have the name of their signal.
        runs: What it shows, in its order.
        is_cut: Whether its time axes are cut already.
    """
    panels = [axes for axes in list_time_axes(figure) if axes.get_label()]
    if not panels:
        return
    found = [list_characteristics(run, measure_run(run)) for run in runs]
    if not is_cut:
        for axes in panels:
            _cut_to_phase(axes, found)
    words = {axes: [*_mark_panel(axes, runs, found)] for axes in panels}
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
    for axes, named in words.items():
        _write_words(axes, named)


def _mark_panel(
    axes: Axes, runs: Sequence[Run], found: Sequence[Sequence[Characteristic]]
) -> Iterator[_Word]:
    """Draw the guides of a panel, and yield the words that belong to them."""
    label = str(axes.get_label())
    signal = label.strip("|")
    height = axes.get_ylim()
    for run, marks, looks in zip(runs, found, choose_lines(len(runs)), strict=True):
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
        own = [mark for mark in marks if mark.signal in {signal, _OF_ERRORS.get(signal, signal)}]
        named = list(_mark_run(panel, own))
        yield from named if len(runs) <= MOST_WORDED else ()
        if panel.is_alone:
            yield from _shade_pauses(axes, marks)
    axes.set_ylim(height)


def _mark_run(panel: _Marked, marks: Sequence[Characteristic]) -> Iterator[_Word]:
    for mark in marks:
        draw = _DRAWN.get(mark.kind)
        text = draw(panel, mark, marks) if draw is not None else ""
        if text:
            is_dead = mark.kind == "dead_time"
            at_s = mark.span_s[1] if is_dead and mark.span_s is not None else mark.at_s
            color = "0.25" if panel.is_alone else panel.color
            yield _Word(
                text=text, at=(at_s, panel.read(at_s)), color=_DEAD_WORDS if is_dead else color
            )


def _mark_rise(panel: _Marked, mark: Characteristic, _: Sequence[Characteristic]) -> str:
    if not panel.is_alone or panel.is_error or mark.span_s is None:
        return ""
    for at_s in mark.span_s:
        _guide(panel, mark.start_s, at_s)
    return _tell(mark)


def _mark_settled(panel: _Marked, mark: Characteristic, _: Sequence[Characteristic]) -> str:
    _draw_band(panel, mark)
    _guide(panel, None, mark.at_s)
    return _tell(mark)


def _mark_overshoot(panel: _Marked, mark: Characteristic, others: Sequence[Characteristic]) -> str:
    if (panel.is_error or not panel.is_alone) and mark.value < _LEAST_OVERSHOOT:
        return ""
    _guide(panel, mark.start_s, mark.at_s)
    if not panel.is_alone:
        return f"{mark.value:+.2g} %"
    peaks = [other for other in others if other.kind == "peak" and other.loop == mark.loop]
    words = [] if panel.is_error else [_tell(peak) for peak in peaks]
    return "\n".join([*words, *([_tell(mark)] if mark.value >= 0.0 else [])])


def _mark_dead_time(panel: _Marked, mark: Characteristic, _: Sequence[Characteristic]) -> str:
    if not panel.is_alone or panel.is_error or mark.span_s is None or mark.value <= 0.0:
        return ""
    panel.axes.axvspan(*mark.span_s, **_DEAD)
    return f"{mark.word} {1e3 * mark.value:.3g} ms"


def _mark_point(panel: _Marked, mark: Characteristic, _: Sequence[Characteristic]) -> str:
    if not panel.is_alone:
        return ""
    _guide(panel, None, mark.at_s)
    return _tell(mark)


_DRAWN: Final[Mapping[str, Callable[[_Marked, Characteristic, Sequence[Characteristic]], str]]] = {
    "rise_time": _mark_rise,
    "settling_time": _mark_settled,
    "overshoot": _mark_overshoot,
    "dead_time": _mark_dead_time,
    "final_error": _mark_point,
    "time_to_goal": _mark_point,
    "position_error": _mark_point,
    "largest_error": _mark_point,
    "cross_track_max": _mark_point,
}
"""What draws a metric, by its kind, and returns its words; a peak stands with its overshoot."""


def _tell(mark: Characteristic) -> str:
    """Return a metric in words, as exact as a reader of a figure can use it."""
    digits = 4 if mark.kind == "peak" else 3
    return f"{mark.word} {mark.value:.{digits}g} {mark.unit}"


def _guide(panel: _Marked, from_s: float | None, at_s: float) -> None:
    """Draw a dot on the curve, dotted lines down to the axis and, from a time on, along."""
    axes, level = panel.axes, panel.read(at_s)
    color = "0.35" if panel.is_alone else panel.color
    bottom = axes.get_ylim()[0]
    if panel.has_guides:
        axes.plot([at_s, at_s], [bottom, level], color=color, **_GUIDE)
    if panel.has_guides and from_s is not None:
        axes.plot([from_s, at_s], [level, level], color=color, **_GUIDE)
    axes.plot([at_s], [level], "o", ms=3.2, mfc="white", mec=panel.color, mew=0.9, zorder=3.2)


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
    color = "0.35" if panel.is_alone else panel.color
    for level in [high] if panel.is_magnitude else [low, high]:
        panel.axes.plot(times_s, [level, level], color=color, **_GUIDE)


def _shade_pauses(axes: Axes, marks: Sequence[Characteristic]) -> Iterator[_Word]:
    """Shade the pauses that are seen by half at least, and wider than a line."""
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
        yield _Word(text=_tell(mark), at=at, color="0.45", span_s=(start_s, end_s))


def _cut_to_phase(axes: Axes, found: Sequence[Sequence[Characteristic]]) -> None:
    """Cut an axis of its own to the stretches of the loops that it shows."""
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


def _write_words(axes: Axes, words: Sequence[_Word]) -> None:
    """Write words near their dots where they cover least, in the order of time."""
    figure = axes.get_figure(root=True)
    box = axes.get_position()
    inch = np.array(figure.get_size_inches()) if figure is not None else np.ones(2)
    half_mm = np.array([box.width, box.height]) * inch * 25.4 / 2.0
    place = WordSpace(center=np.full(2, 0.5), half=np.full(2, 0.5), half_mm=half_mm)
    to_panel = axes.transData + axes.transAxes.inverted()
    for line in axes.get_lines():
        points = line.get_transform().transform(np.asarray(line.get_xydata(), dtype=np.float64))
        points = axes.transAxes.inverted().transform(_drop_gaps(points))
        if line.get_zorder() == _GUIDE["zorder"]:
            place.taken.append(np.linspace(points[0], points[-1], _GUIDE_POINTS))
        else:
            place.avoid_line(points)
    low, high = sorted(axes.get_xlim())
    shown = [word for word in words if low <= word.at[0] <= high]
    dots = to_panel.transform([word.at for word in shown]) if shown else np.empty((0, 2))
    for word, dot in zip(shown, dots, strict=True):
        if word.span_s is None:
            place.avoid_point(dot, _DOT_MM)
    for word, dot in sorted(zip(shown, dots, strict=True), key=lambda pair: pair[0].at):
        if word.span_s is None:
            _write_beside(axes, place, word, dot)
        else:
            width = float(np.ptp(to_panel.transform([(at_s, 1.0) for at_s in word.span_s])[:, 0]))
            _write_upright(axes, place, word, (float(dot[0]), width))


def _write_beside(axes: Axes, place: WordSpace, word: _Word, dot: Values) -> None:
    size_mm = _measure(word)
    middle = place.find_room(dot, float(size_mm[0]), float(size_mm[1]), away_mm=_AWAY_MM)
    scale_mm = place.half_mm / place.half
    away_mm = np.maximum(np.abs(middle - dot) * scale_mm - size_mm / 2.0, 0.0)
    if float(np.hypot(*away_mm)) > _LEADER_MM:
        half = size_mm / 2.0 / scale_mm
        ends = np.stack([dot, np.clip(dot, middle - half, middle + half)], axis=1)
        looks: dict[str, Any] = {"color": word.color, "linewidth": 0.4, "zorder": 3.1}
        axes.plot(*ends, transform=axes.transAxes, scalex=False, scaley=False, **looks)
    _write(axes, word, middle)


def _write_upright(axes: Axes, place: WordSpace, word: _Word, span: tuple[float, float]) -> None:
    """Write words into a span, where they cover least; beside it where it is too narrow."""
    center, width = span
    size_mm = _measure(word)
    half = size_mm[::-1] / 2.0 * place.half / place.half_mm
    if width < 2.0 * half[0]:
        _write_beside(axes, place, word, np.array([center, 0.5]))
        return
    points = np.concatenate(place.taken) if place.taken else np.empty((0, 2))
    heights = np.linspace(half[1] + 0.03, max(0.97 - half[1], half[1] + 0.03), 25)
    middles = [np.array([center, height]) for height in heights]
    middle = min(middles, key=lambda found: place.count_covered(found, half, points))
    place.take_box(middle, half)
    _write(axes, word, middle, rotation=90.0)


def _measure(word: _Word) -> Values:
    """Return the width and height of words [mm], shape (2,)."""
    lines = word.text.split("\n")
    width_mm = max(measure_text_mm(line, _WORDS_POINTS) for line in lines) + 1.0
    return np.array([width_mm, _LINE_MM * len(lines)])


def _write(axes: Axes, word: _Word, middle: Values, rotation: float = 0.0) -> None:
    at = (float(middle[0]), float(middle[1]))
    words = axes.text(*at, word.text, color=word.color, fontsize=_WORDS_POINTS, rotation=rotation)
    words.set(transform=axes.transAxes, ha="center", va="center", zorder=4)
    if word.span_s is None:
        words.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.3, "alpha": 0.75})
    words.set_in_layout(False)


def _drop_gaps(points: Values) -> Values:
    return points[np.isfinite(points).all(axis=1)]
