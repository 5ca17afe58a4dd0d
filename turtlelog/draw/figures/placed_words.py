"""Placement of text next to its marks, where the text covers least, or in a table."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any, Final

import numpy as np
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import text_to_path

from turtlelog.charts.curves import Values

GUIDE_ORDER: Final = 1.6  # drawing order of guide lines: below all curves

WORDS_POINTS: Final = 6.5
_MM_PER_POINT: Final = 25.4 / 72.0
_LINE_MM: Final = 1.25 * WORDS_POINTS * 25.4 / 72.0
_DOT_MM: Final = 0.8
_LEADER_MM: Final = 4.0  # distance from which a line connects text and its dot [mm]

_NO_ROOM: Final = 150.0
"""Number of covered points from which a text is left out: 15 mm of a curve, a text, or a dot."""

_GUIDE_POINTS: Final = 40
"""Number of points of a guide line: a tenth of a curve's, because covering it matters less."""

_MARK_AWAY_MM: Final = (2.0, 4.0, 7.0, 10.0, 12.0, 14.0, 16.0, 19.0, 22.0, 25.0, 28.0, 32.0, 38.0)
"""Distances of text from its dot, best first [mm]. The marks of one phase end in one corner."""

_MOST_COVERED: Final = 12.0  # curve points that a table may cover: 1.2 mm of a curve

_PLACES: Final = np.linspace(0.0, 1.0, 15)
"""Places of a table, from one side of the free area to the other."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Word:
    """Text for a dot of a panel, or upright text for a span of time."""

    text: str
    at: tuple[float, float]
    color: Any
    span_s: tuple[float, float] | None = None


Table = Sequence[tuple[str, Any]]
"""Lines of text with their colours."""


def write_words(axes: Axes, words: Sequence[Word], tables: Sequence[Table] = ()) -> None:
    """Write text for dots and spans of a panel at its final place, where it covers least.

    Text that would cover much is left out; its dot remains. The first table that covers no curve is
    written, or else the last.
    """
    place, to_panel = _survey(axes)
    low, high = sorted(axes.get_xlim())
    shown = sorted((word for word in words if low <= word.at[0] <= high), key=lambda one: one.at)
    dots = to_panel.transform([word.at for word in shown]) if shown else np.empty((0, 2))
    marked = [*zip(shown, dots, strict=True)]
    for word, dot in marked:
        if word.span_s is None:
            place.avoid_point(dot, _DOT_MM)
    if tables:
        _write_table(axes, place, tables)
    orders = [_place_in_order(place, to_panel, order) for order in (marked, marked[::-1])]
    best = min(orders, key=lambda order: sum(min(one.cost, _NO_ROOM) for one in order))
    for placed in sorted(best, key=lambda one: one.word.at):
        if placed.cost >= _NO_ROOM:
            continue
        if placed.leader is not None:
            looks: dict[str, Any] = {"color": placed.word.color, "linewidth": 0.4, "zorder": 3.1}
            looks |= {"transform": axes.transAxes, "scalex": False, "scaley": False}
            axes.plot(*placed.leader.T, **looks)
        _write(axes, placed.word, placed.middle, rotation=90.0 if placed.is_upright else 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Placed:
    """Text at its place, in fractions of the panel."""

    word: Word  # text to place
    middle: Values  # middle of the text's box, shape (2,)
    cost: float  # number of points that the text covers
    is_upright: bool = False  # whether the text is upright in its span
    leader: Values | None = None  # line from the dot to a box that is far away, shape (2, 2)


_AWAY_MM: Final = (2.0, 4.0, 7.0, 10.0, 14.0)  # distances of text from its dot, best first [mm]


@dataclass(slots=True, kw_only=True)
class WordSpace:
    """A panel with linear axes, and what text should not cover.

    A box of placed text is its left, right, bottom and top, in data units.
    """

    center: Values  # center of the panel, in data units, shape (2,)
    half: Values  # half of the panel's width and height, in data units, shape (2,)
    half_mm: Values  # half of the panel's width and height in print [mm], shape (2,)
    taken: list[Values] = field(default_factory=list)  # points of lines and dots, shape (n, 2)
    boxes: list[tuple[float, float, float, float]] = field(default_factory=list)  # placed text

    @property
    def points(self) -> Values:
        """All points that text should not cover, shape (n, 2)."""
        return np.concatenate([*self.taken, np.empty((0, 2))])

    def scale_half(self, size_mm: Sequence[float] | Values) -> Values:
        """Return half of a box of a size [mm], in data units, shape (2,)."""
        return np.array(size_mm) / 2.0 * self.half / self.half_mm

    def choose(self, middles: Sequence[Values], half: Values) -> tuple[Values, float]:
        """Return the first middle at which a box covers least, and the points that it covers."""
        points = self.points
        costs = [self.count_covered(middle, half, points) for middle in middles]
        return middles[int(np.argmin(costs))], min(costs)

    def avoid_line(self, points: Values) -> None:
        """Make text avoid a line, which may be partly outside the panel."""
        inside = np.flatnonzero((np.abs(points - self.center) <= 1.2 * self.half).all(axis=1))
        if not len(inside):
            return
        part = points[max(inside[0] - 1, 0) : inside[-1] + 2]
        steps_mm = np.diff(part, axis=0) / self.half * self.half_mm
        way = np.concatenate([[0.0], np.cumsum(np.hypot(*steps_mm.T))])
        at = np.linspace(0.0, way[-1], min(int(way[-1] / _APART_MM) + 2, _MOST_POINTS))
        self.taken.append(np.stack([np.interp(at, way, part[:, i]) for i in (0, 1)], axis=1))

    def avoid_point(self, point: Values, radius_mm: float = 0.0) -> None:
        """Make text avoid a dot, or a mark with a radius."""
        ring = np.stack([np.cos(_WAYS), np.sin(_WAYS)], axis=1) * radius_mm
        marks = point + ring * self.half / self.half_mm
        self.taken.append(np.repeat(marks, _OF_A_DOT // len(_WAYS), axis=0))

    def find_room(
        self, dot: Values, size_mm: Sequence[float] | Values, away_mm: Sequence[float] = _AWAY_MM
    ) -> tuple[Values, float]:
        """Return the middle of the box near a dot that covers least, and the points covered."""
        scale, half, points = self.half / self.half_mm, self.scale_half(size_mm), self.points
        best, least = dot, np.inf
        for order, gap_mm in enumerate(away_mm):
            for angle in _WAYS:
                way = np.array([np.cos(angle), np.sin(angle)])
                middle = dot + way * (gap_mm * scale + half * np.minimum(np.abs(way) * 1.3, 1.0))
                cost = self.count_covered(middle, half, points) + 3.0 * order
                end = np.clip(dot, middle - half, middle + half)
                cost += _OF_A_DOT * self.count_struck(dot, end)
                if cost < least:
                    best, least = middle, cost
        return best, float(least)

    def take_box(self, middle: Values, half: Values) -> None:
        """Make other text avoid a box."""
        (left, bottom), (right, top) = (middle - half).tolist(), (middle + half).tolist()
        self.boxes.append((left, right, bottom, top))

    def count_covered(self, middle: Values, half: Values, points: Values) -> float:
        """Return the points that a box would cover. Text counts more, and the outside most."""
        over = np.abs(middle - self.center) + half - 0.98 * self.half
        outside = 1e4 * float((np.maximum(over, 0.0) / self.half).sum())
        margin = half + 0.8 * self.half / self.half_mm
        covered = float((np.abs(points - middle) < margin).all(axis=1).sum())
        return outside + covered + 1e3 * self.count_words(middle, half)

    def count_struck(self, dot: Values, end: Values) -> int:
        """Return the number of texts that a line from a dot to its own text would cross."""
        way = np.linspace(dot, end, _WAY_POINTS)[:, None, :]
        left, right, bottom, top = np.array(self.boxes).reshape(-1, 4).T
        low, high = np.stack([left, bottom], axis=1), np.stack([right, top], axis=1)
        return int(((low < way) & (way < high)).all(axis=2).any(axis=0).sum())

    def count_words(self, middle: Values, half: Values) -> int:
        """Return the number of texts that a box would cover."""
        low, high = middle - half, middle + half
        return sum(
            low[0] < right and high[0] > left and low[1] < top and high[1] > bottom
            for left, right, bottom, top in self.boxes
        )


def _place_in_order(
    survey: WordSpace, to_panel: Any, marked: Sequence[tuple[Word, Values]]
) -> list[_Placed]:
    """Return the places of texts. Each text avoids the texts before it."""
    place = replace(survey, taken=[*survey.taken], boxes=[*survey.boxes])
    found = []
    for word, dot in marked:
        width = 0.0
        if word.span_s is not None:
            width = float(np.ptp(to_panel.transform([(at_s, 1.0) for at_s in word.span_s])[:, 0]))
        half = place.scale_half(_measure(word))
        if width >= _LINE_MM * place.half[0] / place.half_mm[0]:
            # Upright text in its span, at the height where it covers least.
            half = place.scale_half(_measure(word)[::-1])
            heights = np.linspace(half[1] + 0.03, max(0.97 - half[1], half[1] + 0.03), 25)
            middle, cost = place.choose([np.array([dot[0], height]) for height in heights], half)
            placed = _Placed(word=word, middle=middle, cost=cost, is_upright=True)
        else:
            at = dot if word.span_s is None else np.array([dot[0], 0.5])
            middle, cost = place.find_room(at, _measure(word), _MARK_AWAY_MM)
            leader = np.stack([at, np.clip(at, middle - half, middle + half)])
            away_mm = np.diff(leader, axis=0)[0] * (place.half_mm / place.half)
            is_far = float(np.hypot(*away_mm)) > _LEADER_MM
            ends = leader if is_far else None
            placed = _Placed(word=word, middle=middle, cost=cost, leader=ends)
        found.append(placed)
        if placed.cost < _NO_ROOM:
            place.take_box(placed.middle, half)
            if placed.leader is not None:
                place.avoid_line(placed.leader)
    return found


def _survey(axes: Axes) -> tuple[WordSpace, Any]:
    """Return the points to avoid in a panel, and the transform from data to panel fractions."""
    figure = axes.get_figure(root=True)
    box = axes.get_position()
    inch = np.array(figure.get_size_inches()) if figure is not None else np.ones(2)
    half_mm = np.array([box.width, box.height]) * inch * 25.4 / 2.0
    place = WordSpace(center=np.full(2, 0.5), half=np.full(2, 0.5), half_mm=half_mm)
    to_panel = axes.transData + axes.transAxes.inverted()
    for line in axes.get_lines():
        points = line.get_transform().transform(np.asarray(line.get_xydata(), dtype=np.float64))
        points = axes.transAxes.inverted().transform(points[np.isfinite(points).all(axis=1)])
        if line.get_zorder() == GUIDE_ORDER:
            place.taken.append(np.linspace(points[0], points[-1], _GUIDE_POINTS))
        else:
            place.avoid_line(points)
    return place, to_panel


def _write_table(axes: Axes, place: WordSpace, tables: Sequence[Table]) -> None:
    """Write the first table that has enough room. Each line has the colour of its run."""
    for table in tables:
        width_mm = max(measure_text_mm(text, WORDS_POINTS) for text, _ in table) + 1.0
        half = place.scale_half([width_mm, _LINE_MM * len(table)])
        low, room = half + 0.01, np.maximum(1.0 - 2.0 * half - 0.02, 0.0)
        middles = [low + room * np.array(at) for at in product(_PLACES[::-1], _PLACES)]
        middle, cost = place.choose(middles, half)
        if cost <= _MOST_COVERED or table is tables[-1]:
            break
    place.take_box(middle, half)
    line = 2.0 * half[1] / len(table)
    for number, (text, color) in enumerate(table):
        left, top = middle[0] - half[0], middle[1] + half[1]
        at = np.array([left, top - (number + 0.5) * line])
        _write(axes, Word(text=text, at=(0.0, 0.0), color=color), at, side="left")


def _measure(word: Word) -> Values:
    """Return width and height of text [mm], shape (2,)."""
    lines = word.text.split("\n")
    width_mm = max(measure_text_mm(line, WORDS_POINTS) for line in lines) + 1.0
    return np.array([width_mm, _LINE_MM * len(lines)])


def _write(
    axes: Axes, word: Word, middle: Values, rotation: float = 0.0, side: str = "center"
) -> None:
    at = (float(middle[0]), float(middle[1]))
    words = axes.text(*at, word.text, color=word.color, fontsize=WORDS_POINTS, rotation=rotation)
    words.set(transform=axes.transAxes, ha=side, va="center", zorder=4)
    if word.span_s is None:
        words.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.3, "alpha": 0.75})
    words.set_in_layout(False)


_WAYS: Final = np.radians(np.arange(0.0, 360.0, 15.0))
_RING_WAYS: Final = np.radians(90.0 + 22.5 * np.array([0, 8, 1, -1, 7, -7, 4, -4, 2, -2, 6, -6]))
"""Angles at which the name of a ring may be placed, best first [rad]."""

_APART_MM: Final = 0.1
"""Distance between the points of a line [mm]; a curve that crosses a text has hundreds."""

_MOST_POINTS: Final = 4_000  # points on an oscillating line
_WAY_POINTS: Final = 40  # number of points from a dot to its text

_OF_A_DOT: Final = 400
"""Number of points of a mark, so that text avoids the mark like 40 mm of a line."""


def measure_text_mm(text: str, points: float = 7.0) -> float:
    """Return the width of a line of text in print [mm]."""
    font = FontProperties(family=rcParams["font.family"], size=points)
    width, _, _ = text_to_path.get_text_width_height_descent(text, font, ismath=False)
    return float(width) * _MM_PER_POINT


def place_words(
    axes: Axes, place: WordSpace, text: str, dot: Values, color: Any, points: float
) -> None:
    """Write text near a dot where it covers least."""
    lines = text.split("\n")
    width_mm = max(measure_text_mm(line, points) for line in lines) + 0.5
    size_mm = (width_mm, 1.25 * points * _MM_PER_POINT * len(lines))
    middle, _ = place.find_room(dot, size_mm)
    place.take_box(middle, place.scale_half(size_mm))
    at = (float(middle[0]), float(middle[1]))
    words = axes.text(*at, text, color=color, fontsize=points, ha="center", va="center", zorder=4)
    words.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.4, "alpha": 0.75})


def name_ring(axes: Axes, place: WordSpace, text: str, radius: float) -> None:
    """Write the radius of a ring on the ring, where the text covers least."""
    points = 6.0
    half = place.scale_half([measure_text_mm(text, points), 1.3 * points * _MM_PER_POINT])
    ring = place.center + radius * np.stack([np.cos(_RING_WAYS), np.sin(_RING_WAYS)], axis=1)
    middle, _ = place.choose([*ring], half)
    place.take_box(middle, half)
    at = (float(middle[0]), float(middle[1]))
    words = axes.text(*at, text, color="0.5", fontsize=points, ha="center", va="center")
    words.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.2})
