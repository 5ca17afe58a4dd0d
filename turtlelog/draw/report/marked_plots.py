"""Characteristics in the plots of a report: dots with names, settling bands, dead times, pauses."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from turtlelog.charts.characteristics import (
    Characteristic,
    MarkShape,
    list_mark_texts,
    read_marked_curve,
)
from turtlelog.draw.report.drawn import RING, Drawn, Plots, to_hex
from turtlelog.libraries import load_library

MOST_MARKED: Final = 4
"""Marks of more runs would hide each other."""

_DEAD: Final = "#c77736"
_WORDS: Final = "#767676"
"""Stands out from white and from black alike: by 4.5 and by 4.6."""

_LINE_PX: Final = 17
_NEAR: Final = 0.2
"""Of the width: words of dots that are nearer to each other stand below one another."""

_LATE: Final = 0.6
"""Of the width: words of later dots stand on the left, or they would leave the plot."""

_SHAPES: Final[Mapping[MarkShape, str]] = {"disc": "circle", "square": "square", "cross": "x"}
"""Marks as Bokeh has them."""


def mark_plots(
    plots: Plots,
    figure: Any,
    drawn: Sequence[Drawn],
    signals: Collection[str],
    found: Sequence[Sequence[Characteristic]],
) -> None:
    """Mark characteristics of signals, and the pauses; of one run names stand beside the dots.

    Args:
        plots: The page.
        figure: The plot of the signal.
        drawn: Runs first.
        signals: What the plot shows.
        found: Characteristics of each run.
    """
    if len(found) > MOST_MARKED:
        return
    is_alone = len(found) == 1
    dots = []
    for number, marks in enumerate(found):
        run = drawn[number].run
        if all(read_marked_curve(run, signal) is None for signal in signals):
            continue
        color = to_hex(drawn[number].color)
        own = [mark for mark in marks if mark.signal in signals and mark.level is not None]
        shades = [
            *_shade_pauses(figure, marks, RING if is_alone else color),
            *_shade_spans(figure, own, RING if is_alone else color),
        ]
        made = [_draw_dot(figure, mark, own, (drawn[number].name, color)) for mark in own]
        dots += [dot for dot in made if dot is not None]
        words = _write_words(plots, figure, own) if is_alone else []
        ids = [one.id for one in (*shades, *(dot for dot in made if dot is not None), *words)]
        plots.config["marks"] += [{"run": number, "renderer": key} for key in ids]
    if dots:
        hover = load_library("bokeh.models").HoverTool(renderers=dots, tooltips="@text")
        hover.visible = False
        figure.add_tools(hover)


def _shade_pauses(figure: Any, marks: Sequence[Characteristic], color: str) -> Iterator[Any]:
    for mark in marks:
        if mark.kind == "pause" and mark.span_s is not None:
            yield _add_box(figure, color, 0.14, left=mark.span_s[0], right=mark.span_s[1])


def _shade_spans(figure: Any, marks: Sequence[Characteristic], color: str) -> Iterator[Any]:
    """Shade settling bands from the start of their loop on, and dead times."""
    for mark in marks:
        if mark.span_s is None:
            continue
        if mark.kind == "settling_time" and mark.levels is not None:
            (low, high), left = mark.levels, mark.start_s
            yield _add_box(
                figure, color, 0.18, left=left, right=mark.span_s[1], bottom=low, top=high
            )
        if mark.kind == "dead_time":
            yield _add_box(figure, _DEAD, 0.3, left=mark.span_s[0], right=mark.span_s[1])


def _add_box(figure: Any, color: str, alpha: float, **edges: float) -> Any:
    models = load_library("bokeh.models")
    box = models.BoxAnnotation(
        fill_color=color, fill_alpha=alpha, line_color=None, level="underlay", **edges
    )
    figure.add_layout(box)
    return box


def _draw_dot(
    figure: Any, mark: Characteristic, others: Sequence[Characteristic], whose: tuple[str, str]
) -> Any:
    """Draw a dot where a metric is taken, None where it is not marked."""
    text = ", ".join(list_mark_texts(mark, others))
    if mark.shape is None or not text:
        return None
    name, color = whose
    source = load_library("bokeh.models").ColumnDataSource(
        data={"x": [mark.marked_s], "y": [mark.level], "text": [f"{name}: {text}"]}
    )
    return figure.scatter(
        "x", "y", source=source, marker=_SHAPES[mark.shape], size=9, line_color=color,
        line_width=1.8, fill_color=color, fill_alpha=0.25,
    )  # fmt: skip


def _write_words(plots: Plots, figure: Any, marks: Sequence[Characteristic]) -> Iterator[Any]:
    """Write the name of each dot beside it; names of dots that are near stand in one column."""
    end_s = float(plots.config["end_s"])
    known = sorted((mark for mark in marks if mark.shape), key=lambda mark: mark.marked_s)
    told = [(mark, ", ".join(list_mark_texts(mark, marks))) for mark in known]
    words = [(mark, text) for mark, text in told if text]
    levels = [float(mark.level or 0.0) for mark, _ in words]
    cluster: list[int] = []
    was_low = False
    for number, (mark, text) in enumerate(words):
        is_low = levels[number] <= _find_middle(figure, mark)
        if cluster and (
            mark.marked_s - words[cluster[0]][0].marked_s > _NEAR * end_s or is_low != was_low
        ):
            cluster = []
        cluster.append(number)
        was_low, first = is_low, words[cluster[0]][0]
        is_late = first.marked_s > _LATE * end_s
        step = _LINE_PX * (len(cluster) - 1)
        word = figure.text(
            [(first if is_late else words[cluster[-1]][0]).marked_s], [levels[cluster[0]]],
            text=[f"{mark.sign} {text}"], text_color=_DEAD if mark.kind == "dead_time" else _WORDS,
            text_font_size="12px", text_align="right" if is_late else "left",
            x_offset=-10 if is_late else 12, y_offset=(-12 - step) if is_low else (12 + step),
            text_baseline="bottom" if is_low else "top",
        )  # fmt: skip
        plots.config["words"].append(word.glyph.id)
        yield word


def _find_middle(figure: Any, mark: Characteristic) -> float:
    """Return the middle of what the curves of a plot span."""
    values = [ys for one in figure.renderers for ys in one.data_source.data.get("ys", [])]
    known = [float(end) for found in values for end in (np.nanmin(found), np.nanmax(found))]
    return (min(known) + max(known)) / 2.0 if known else float(mark.level or 0.0)
