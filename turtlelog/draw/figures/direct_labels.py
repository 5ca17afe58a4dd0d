"""Words beside what they name: how much room they take, and where nothing else is."""

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import text_to_path
from numpy.typing import NDArray

Values = NDArray[np.float64]

_MM_PER_POINT: Final = 25.4 / 72.0
_WAYS: Final = np.radians(np.arange(0.0, 360.0, 15.0))
_RING_WAYS: Final = np.radians(90.0 + 22.5 * np.array([0, 8, 1, -1, 7, -7, 4, -4, 2, -2, 6, -6]))
"""Where the name of a ring may stand, best first."""

_AWAY_MM: Final = (2.0, 4.0, 7.0, 10.0, 14.0)
"""How far words may stand from their dot, best first."""

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
