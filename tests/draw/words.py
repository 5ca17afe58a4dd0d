"""Where the words of a figure lie: off the page, or over each other."""

from collections.abc import Iterator
from itertools import combinations
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

ROOM = 1.5
"""Pixels by which words may reach over: the box of a text has some room around its letters."""


def list_clipped(figure: Figure) -> list[str]:
    """Return the words of a figure that lie off its page in part."""
    page = figure.bbox.padded(ROOM)
    return [
        text.get_text()
        for text in list_words(figure)
        if not (page.contains(*(box := find_box(text)).min) and page.contains(*box.max))
    ]


def list_overlapping(figure: Figure) -> list[tuple[str, str]]:
    """Return the words within one axes that lie over each other."""
    found = []
    for axes in figure.axes:
        words = [(text.get_text(), find_box(text).padded(-ROOM)) for text in list_words(axes)]
        found += [
            (one, other)
            for (one, box), (other, others) in combinations(words, 2)
            if box.overlaps(others)
        ]
    return found


def list_words(part: Figure | Axes) -> Iterator[Text]:
    """Yield the words that are seen of a figure or an axes."""
    unseen = {id(text) for axes in part.findobj(Axes) for text in _list_unseen(axes)}
    for text in part.findobj(Text):
        assert isinstance(text, Text)
        if text.get_text().strip() and text.get_visible() and id(text) not in unseen:
            yield text


def find_box(text: Text) -> Bbox:
    return text.get_window_extent()


def _list_unseen(axes: Any) -> Iterator[Text]:
    """Yield the labels of ticks beyond the ends of an axis, and all words of axes that are off."""
    if not axes.axison:
        yield from axes.findobj(Text)
    for axis in (axes.xaxis, axes.yaxis):
        low, high = sorted(axis.get_view_interval())
        for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
            if not low <= tick.get_loc() <= high:
                yield from (tick.label1, tick.label2)
