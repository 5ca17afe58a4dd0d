"""Words beside what they name: where nothing else is, in panels over time upright or in a table."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any, Final

import numpy as np
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import text_to_path
from numpy.typing import NDArray

Values = NDArray[np.float64]

GUIDE_ORDER: Final = 1.6
"""How high guide lines lie: below all curves."""

_WORDS_POINTS: Final = 6.5
_LINE_MM: Final = 1.25 * _WORDS_POINTS * 25.4 / 72.0
_DOT_MM: Final = 0.8
_LEADER_MM: Final = 4.0
"""Words that stand further from their dot have a line to it."""

_NO_ROOM: Final = 150.0
"""Points of curves, 15 mm of them, or one word or dot: words that cover as much are left out."""

_GUIDE_POINTS: Final = 40
"""Points of a guide line that words avoid: a tenth of a curve's, as it may rather be covered."""

_MARK_AWAY_MM: Final = (2.0, 4.0, 7.0, 10.0, 12.0, 14.0, 16.0, 19.0, 22.0, 25.0, 28.0, 32.0, 38.0)
"""How far words may stand from their dot, best first: marks of one phase end in one corner."""

_MOST_COVERED: Final = 12.0
"""Points of curves that a table may cover: 1.2 mm of a curve."""

_PLACES: Final = np.linspace(0.0, 1.0, 15)
"""Where a table may stand, from one side of what is free to the other."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Word:
    """Words for a dot of a panel, or for a span of time, in which they stand upright."""

    text: str
    at: tuple[float, float]
    color: Any
    span_s: tuple[float, float] | None = None


Table = Sequence[tuple[str, Any]]
"""Lines of words with their colours."""


def write_words(axes: Axes, words: Sequence[Word], tables: Sequence[Table] = ()) -> None:
    """Write words near their dots where they cover least.

    Words that would cover much have no room and are left out: their dot stays.

    Args:
        axes: The panel, at its place in the figure.
        words: For its dots and spans.
        tables: Of these the first is written that covers no curve; otherwise the last.
    """
    place, to_panel = _survey(axes)
    low, high = sorted(axes.get_xlim())
    shown = sorted((word for word in words if low <= word.at[0] <= high), key=lambda one: one.at)
    dots = to_panel.transform([word.at for word in shown]) if shown else np.empty((0, 2))
    for word, dot in zip(shown, dots, strict=True):
        if word.span_s is None:
            place.avoid_point(dot, _DOT_MM)
    if tables:
        _write_table(axes, place, tables)
    marked = [*zip(shown, dots, strict=True)]
    orders = [_place_in_order(place, to_panel, order) for order in (marked, marked[::-1])]
    best = min(orders, key=lambda order: sum(min(one.cost, _NO_ROOM) for one in order))
    for placed in sorted(best, key=lambda one: one.word.at):
        if placed.cost < _NO_ROOM:
            _write_placed(axes, placed)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Placed:
    """Words at their place, in parts of the panel.

    Attributes:
        word: What is written.
        middle: Of its box, shape (2,).
        is_upright: Whether it stands in its span.
        leader: From the dot to the box where that is far, shape (2, 2).
        cost: How much it covers.
    """

    word: Word
    middle: Values
    cost: float
    is_upright: bool = False
    leader: Values | None = None


_AWAY_MM: Final = (2.0, 4.0, 7.0, 10.0, 14.0)
"""How far words may stand from their dot, best first."""


@dataclass(slots=True, kw_only=True)
class WordSpace:
    """A panel with linear axes, and what words should not cover.

    Attributes:
        center: Of the panel, in data units, shape (2,).
        half: Half of its width and height, in data units, shape (2,).
        half_mm: The same in print [mm], shape (2,).
        taken: Points of lines and dots, shape (n, 2).
        boxes: Of words that stand there: left, right, bottom, top, in data units.
    """

    center: Values
    half: Values
    half_mm: Values
    taken: list[Values] = field(default_factory=list)
    boxes: list[tuple[float, float, float, float]] = field(default_factory=list)

    def avoid_line(self, points: Values) -> None:
        """Keep words off a line, of which the panel shows a part."""
        inside = np.flatnonzero((np.abs(points - self.center) <= 1.2 * self.half).all(axis=1))
        if not len(inside):
            return
        part = points[max(inside[0] - 1, 0) : inside[-1] + 2]
        steps_mm = np.diff(part, axis=0) / self.half * self.half_mm
        way = np.concatenate([[0.0], np.cumsum(np.hypot(*steps_mm.T))])
        at = np.linspace(0.0, way[-1], min(int(way[-1] / _APART_MM) + 2, _MOST_POINTS))
        self.taken.append(np.stack([np.interp(at, way, part[:, i]) for i in (0, 1)], axis=1))

    def avoid_point(self, point: Values, radius_mm: float = 0.0) -> None:
        """Keep words off a dot, or a mark of some size."""
        ring = np.stack([np.cos(_WAYS), np.sin(_WAYS)], axis=1) * radius_mm
        marks = point + ring * self.half / self.half_mm
        self.taken.append(np.repeat(marks, _OF_A_DOT // len(_WAYS), axis=0))

    def find_room(
        self,
        dot: Values,
        width_mm: float,
        height_mm: float,
        away_mm: tuple[float, ...] = _AWAY_MM,
    ) -> tuple[Values, float]:
        """Return the middle of a box near a dot that covers least, and how much it covers."""
        scale = self.half / self.half_mm
        half = np.array([width_mm, height_mm]) / 2.0 * scale
        points = np.concatenate(self.taken) if self.taken else np.empty((0, 2))
        best, least = dot, np.inf
        for order, gap_mm in enumerate(away_mm):
            for angle in _WAYS:
                way = np.array([np.cos(angle), np.sin(angle)])
                middle = dot + way * (gap_mm * scale + half * np.minimum(np.abs(way) * 1.3, 1.0))
                cost = self.count_covered(middle, half, points) + 3.0 * order
                cost += _OF_A_DOT * self.count_struck(
                    dot, np.clip(dot, middle - half, middle + half)
                )
                if cost < least:
                    best, least = middle, cost
        return best, float(least)

    def take_box(self, middle: Values, half: Values) -> None:
        """Keep other words off a box."""
        (left, bottom), (right, top) = (middle - half).tolist(), (middle + half).tolist()
        self.boxes.append((left, right, bottom, top))

    def count_covered(self, middle: Values, half: Values, points: Values) -> float:
        """Return how much a box would cover: words most, what lies outside most of all."""
        over = np.abs(middle - self.center) + half - 0.98 * self.half
        outside = 1e4 * float((np.maximum(over, 0.0) / self.half).sum())
        margin = half + 0.8 * self.half / self.half_mm
        covered = float((np.abs(points - middle) < margin).all(axis=1).sum())
        return outside + covered + 1e3 * self.count_words(middle, half)

    def count_struck(self, dot: Values, end: Values) -> int:
        """Return how many words the way from a dot to its own would strike through."""
        way = np.linspace(dot, end, _WAY_POINTS)[:, None, :]
        left, right, bottom, top = np.array(self.boxes).reshape(-1, 4).T
        low, high = np.stack([left, bottom], axis=1), np.stack([right, top], axis=1)
        return int(((low < way) & (way < high)).all(axis=2).any(axis=0).sum())

    def count_words(self, middle: Values, half: Values) -> int:
        """Return how many words a box would cover."""
        low, high = middle - half, middle + half
        return sum(
            low[0] < right and high[0] > left and low[1] < top and high[1] > bottom
            for left, right, bottom, top in self.boxes
        )


def _place_in_order(
    survey: WordSpace, to_panel: Any, marked: Sequence[tuple[Word, Values]]
) -> list[_Placed]:
    """Return the places of words, of which each keeps off those before it."""
    place = replace(survey, taken=[*survey.taken], boxes=[*survey.boxes])
    found = []
    for word, dot in marked:
        width = 0.0
        if word.span_s is not None:
            width = float(np.ptp(to_panel.transform([(at_s, 1.0) for at_s in word.span_s])[:, 0]))
        half = _measure(word) / 2.0 * place.half / place.half_mm
        if width >= _LINE_MM * place.half[0] / place.half_mm[0]:
            placed, half = _place_upright(place, word, float(dot[0]))
        else:
            at = dot if word.span_s is None else np.array([dot[0], 0.5])
            placed = _place_beside(place, word, at)
        found.append(placed)
        if placed.cost < _NO_ROOM:
            place.take_box(placed.middle, half)
            if placed.leader is not None:
                place.avoid_line(placed.leader)
    return found


def _survey(axes: Axes) -> tuple[WordSpace, Any]:
    """Return what words should not cover in a panel, and how data are turned into its parts."""
    figure = axes.get_figure(root=True)
    box = axes.get_position()
    inch = np.array(figure.get_size_inches()) if figure is not None else np.ones(2)
    half_mm = np.array([box.width, box.height]) * inch * 25.4 / 2.0
    place = WordSpace(center=np.full(2, 0.5), half=np.full(2, 0.5), half_mm=half_mm)
    to_panel = axes.transData + axes.transAxes.inverted()
    for line in axes.get_lines():
        points = line.get_transform().transform(np.asarray(line.get_xydata(), dtype=np.float64))
        points = axes.transAxes.inverted().transform(_drop_gaps(points))
        if line.get_zorder() == GUIDE_ORDER:
            place.taken.append(np.linspace(points[0], points[-1], _GUIDE_POINTS))
        else:
            place.avoid_line(points)
    return place, to_panel


def _write_table(axes: Axes, place: WordSpace, tables: Sequence[Table]) -> None:
    """Write the first table that has room; each line has the colour of its run."""
    points = np.concatenate(place.taken) if place.taken else np.empty((0, 2))
    for table in tables:
        width_mm = max(measure_text_mm(text, _WORDS_POINTS) for text, _ in table) + 1.0
        half = np.array([width_mm, _LINE_MM * len(table)]) / 2.0 * place.half / place.half_mm
        low, room = half + 0.01, np.maximum(1.0 - 2.0 * half - 0.02, 0.0)
        middles = [low + room * np.array(at) for at in product(_PLACES[::-1], _PLACES)]
        costs = [place.count_covered(middle, half, points) for middle in middles]
        middle = middles[int(np.argmin(costs))]
        if min(costs) <= _MOST_COVERED or table is tables[-1]:
            break
    place.take_box(middle, half)
    line = 2.0 * half[1] / len(table)
    for number, (text, color) in enumerate(table):
        left, top = middle[0] - half[0], middle[1] + half[1]
        at = np.array([left, top - (number + 0.5) * line])
        _write(axes, Word(text=text, at=(0.0, 0.0), color=color), at, side="left")


def _place_beside(place: WordSpace, word: Word, dot: Values) -> _Placed:
    size_mm = _measure(word)
    middle, cost = place.find_room(dot, float(size_mm[0]), float(size_mm[1]), away_mm=_MARK_AWAY_MM)
    scale_mm = place.half_mm / place.half
    half = size_mm / 2.0 / scale_mm
    leader = np.stack([dot, np.clip(dot, middle - half, middle + half)])
    is_far = float(np.hypot(*(np.diff(leader, axis=0)[0] * scale_mm))) > _LEADER_MM
    return _Placed(word=word, middle=middle, cost=cost, leader=leader if is_far else None)


def _place_upright(place: WordSpace, word: Word, center: float) -> tuple[_Placed, Values]:
    """Return words in their span, where they cover least, and half of their box."""
    half = _measure(word)[::-1] / 2.0 * place.half / place.half_mm
    points = np.concatenate(place.taken) if place.taken else np.empty((0, 2))
    heights = np.linspace(half[1] + 0.03, max(0.97 - half[1], half[1] + 0.03), 25)
    middles = [np.array([center, height]) for height in heights]
    costs = [place.count_covered(middle, half, points) for middle in middles]
    middle, cost = middles[int(np.argmin(costs))], min(costs)
    return _Placed(word=word, middle=middle, cost=cost, is_upright=True), half


def _write_placed(axes: Axes, placed: _Placed) -> None:
    if placed.leader is not None:
        looks: dict[str, Any] = {"color": placed.word.color, "linewidth": 0.4, "zorder": 3.1}
        axes.plot(*placed.leader.T, transform=axes.transAxes, scalex=False, scaley=False, **looks)
    _write(axes, placed.word, placed.middle, rotation=90.0 if placed.is_upright else 0.0)


def _measure(word: Word) -> Values:
    """Return the width and height of words [mm], shape (2,)."""
    lines = word.text.split("\n")
    width_mm = max(measure_text_mm(line, _WORDS_POINTS) for line in lines) + 1.0
    return np.array([width_mm, _LINE_MM * len(lines)])


def _write(
    axes: Axes, word: Word, middle: Values, rotation: float = 0.0, side: str = "center"
) -> None:
    at = (float(middle[0]), float(middle[1]))
    words = axes.text(*at, word.text, color=word.color, fontsize=_WORDS_POINTS, rotation=rotation)
    words.set(transform=axes.transAxes, ha=side, va="center", zorder=4)
    if word.span_s is None:
        words.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.3, "alpha": 0.75})
    words.set_in_layout(False)


def _drop_gaps(points: Values) -> Values:
    return points[np.isfinite(points).all(axis=1)]


_MM_PER_POINT: Final = 25.4 / 72.0
_WAYS: Final = np.radians(np.arange(0.0, 360.0, 15.0))
_RING_WAYS: Final = np.radians(90.0 + 22.5 * np.array([0, 8, 1, -1, 7, -7, 4, -4, 2, -2, 6, -6]))
"""Where the name of a ring may stand, best first."""

_APART_MM: Final = 0.1
"""Between points of a line that words avoid: words that a curve strikes through cover hundreds."""

_MOST_POINTS: Final = 4_000
"""On a line that swings."""

_WAY_POINTS: Final = 40
"""From a dot to its words."""

_OF_A_DOT: Final = 400
"""Points of a mark, which words avoid as 40 mm of a line."""


def measure_text_mm(text: str, points: float = 7.0) -> float:
    """Return how wide a line of words is in print [mm]."""
    font = FontProperties(family=rcParams["font.family"], size=points)
    width, _, _ = text_to_path.get_text_width_height_descent(text, font, ismath=False)
    return float(width) * _MM_PER_POINT


def place_words(
    axes: Axes, place: WordSpace, text: str, dot: Values, color: Any, points: float
) -> None:
    """Write words near a dot where they cover least."""
    lines = text.split("\n")
    width_mm = max(measure_text_mm(line, points) for line in lines) + 0.5
    height_mm = 1.25 * points * _MM_PER_POINT * len(lines)
    middle, _ = place.find_room(dot, width_mm, height_mm)
    place.take_box(middle, np.array([width_mm, height_mm]) / 2.0 * place.half / place.half_mm)
    at = (float(middle[0]), float(middle[1]))
    words = axes.text(*at, text, color=color, fontsize=points, ha="center", va="center", zorder=4)
    words.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.4, "alpha": 0.75})


def name_ring(axes: Axes, place: WordSpace, text: str, radius: float, points: float = 6.0) -> None:
    """Write the radius of a ring on it, where it covers least."""
    half = np.array([measure_text_mm(text, points), 1.3 * points * _MM_PER_POINT]) / 2.0
    half *= place.half / place.half_mm
    ring = place.center + radius * np.stack([np.cos(_RING_WAYS), np.sin(_RING_WAYS)], axis=1)
    points_taken = np.concatenate(place.taken) if place.taken else np.empty((0, 2))
    costs = [place.count_covered(middle, half, points_taken) for middle in ring]
    middle = ring[int(np.argmin(costs))]
    place.take_box(middle, half)
    at = (float(middle[0]), float(middle[1]))
    words = axes.text(*at, text, color="0.5", fontsize=points, ha="center", va="center")
    words.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.2})
