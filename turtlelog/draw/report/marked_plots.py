"""Marks in the plots of a report: characteristics, and the bands of failed checks."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from turtlelog.charts import curve_marks
from turtlelog.charts.curve_marks import ViolatedSignal, ViolationMoment
from turtlelog.charts.palette import ALLOWED, DEAD_TIME, MAIN, VIOLATION, Color, to_hex
from turtlelog.draw.report.drawing import RING, Drawn, Plots, make_figure, store, thin
from turtlelog.libraries import load_library

MOST_MARKED: Final = 4
"""Largest number of runs with marks; with more runs, marks would hide each other."""

_DEAD: Final = to_hex(DEAD_TIME)
_WORDS: Final = "#767676"
"""Colour of text, with a contrast of 4.5 to white and 4.6 to black."""

_LINE_PX: Final = 17
_NEAR: Final = 0.2
"""Distance between dots, as a share of the width, below which their texts are one below another."""

_LATE: Final = 0.6
"""Share of the width from which text is on the left of dots, because it would leave the plot on the
right."""

_SHAPES: Final[Mapping[curve_marks.MarkShape, str]] = {
    "disc": "circle",
    "square": "square",
    "cross": "x",
}
"""Mark shapes of Bokeh."""


def mark_plots(
    plots: Plots,
    figure: Any,
    drawn: Sequence[Drawn],
    signals: Collection[str],
    found: Sequence[Sequence[curve_marks.Characteristic]],
) -> None:
    """Mark the characteristics of a plot's signals, and pauses, for each of the first runs drawn.

    For a single run, names are next to the dots.
    """
    if len(found) > MOST_MARKED:
        return
    is_alone = len(found) == 1
    dots = []
    for number, marks in enumerate(found):
        run = drawn[number].run
        if all(curve_marks.read_marked_curve(run, signal) is None for signal in signals):
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


def _shade_pauses(
    figure: Any, marks: Sequence[curve_marks.Characteristic], color: str
) -> Iterator[Any]:
    for mark in marks:
        if mark.kind == "pause" and mark.span_s is not None:
            yield _add_box(figure, color, 0.14, left=mark.span_s[0], right=mark.span_s[1])


def _shade_spans(
    figure: Any, marks: Sequence[curve_marks.Characteristic], color: str
) -> Iterator[Any]:
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
    figure: Any,
    mark: curve_marks.Characteristic,
    others: Sequence[curve_marks.Characteristic],
    whose: tuple[str, str],
) -> Any:
    """Draw a dot at a metric's place on the curve; return None for a metric without a dot."""
    text = ", ".join(curve_marks.list_mark_texts(mark, others))
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


def _write_words(
    plots: Plots, figure: Any, marks: Sequence[curve_marks.Characteristic]
) -> Iterator[Any]:
    """Write the name of each dot next to it. The names of close dots form a column."""
    end_s = float(plots.config["end_s"])
    known = sorted((mark for mark in marks if mark.shape), key=lambda mark: mark.marked_s)
    told = [(mark, ", ".join(curve_marks.list_mark_texts(mark, marks))) for mark in known]
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


def _find_middle(figure: Any, mark: curve_marks.Characteristic) -> float:
    """Return the middle of the range of a plot's curves."""
    values = [ys for one in figure.renderers for ys in one.data_source.data.get("ys", [])]
    known = [float(end) for found in values for end in (np.nanmin(found), np.nanmax(found))]
    return (min(known) + max(known)) / 2.0 if known else float(mark.level or 0.0)


MOST_VIOLATIONS: Final = 6
"""Largest number of failed checks with a plot; the table lists all failed checks."""

RED: Final = to_hex(VIOLATION)

_CLOSE: Final = 0.3
"""Distance between two moments, as a share of the width, below which their texts would overlap."""


def draw_violations(
    plots: Plots, found: Sequence[tuple[ViolatedSignal, Color | None]], x_range: Any
) -> None:
    """Draw the signal of each failed check, in its run's colour, on the common time axis.

    The page gets places `violation-0`, `violation-1` and so on.
    """
    for number, (violated, color) in enumerate(found[:MOST_VIOLATIONS]):
        _draw_violation(plots, f"violation-{number}", violated, color or MAIN, x_range)


def _draw_violation(
    plots: Plots, place: str, violated: ViolatedSignal, color: Color, x_range: Any
) -> None:
    models = load_library("bokeh.models")
    shown = violated.find_range()
    low, high = shown.low, shown.high
    title = violated.title.replace("_", " ")
    title = f"{title}, {shown.note}" if shown.note else title
    figure = make_figure(
        plots, place, title, x_range=x_range, height=260, y_range=models.Range1d(low, high),
        x_axis_label="time from the first sample [s]",
    )  # fmt: skip
    _draw_band(figure, violated, (low, high), x_range.end)
    curve = violated.curve
    mode = "after" if curve.holds else None
    time_s, values = thin(plots, [curve.time_s, curve.values], curve.values)
    _draw_line(figure, time_s, values, mode, color=to_hex(color), line_width=1.8)
    is_red = violated.outside.copy()
    if curve.holds:
        is_red[1:] |= violated.outside[:-1]
    red = np.where(is_red, curve.values, np.nan)
    time_s, red = thin(plots, [curve.time_s, red], red)
    _draw_line(figure, time_s, red, mode, color=RED, line_width=3.5)
    _name_moments(plots, figure, violated, (low, high), x_range.end)
    cursor = models.Span(location=0.0, dimension="height", line_color=RING, line_width=1)
    figure.add_layout(cursor)
    plots.config["cursors"].append(cursor.id)
    tips = [("time", "$x{0.000} s"), (violated.name, f"$y{{0.0000}} {violated.unit}")]
    figure.add_tools(models.CrosshairTool(overlay=plots.crosshair))
    figure.add_tools(models.HoverTool(tooltips=tips, line_policy="nearest"))


def _draw_line(figure: Any, time_s: Any, values: Any, mode: str | None, **looks: Any) -> None:
    if mode is None:
        figure.line(time_s, values, **looks)
    else:
        figure.step(time_s, values, mode=mode, **looks)


def _draw_band(
    figure: Any, violated: ViolatedSignal, height: tuple[float, float], end_s: float
) -> None:
    """Shade the allowed band over its time, and name its limits."""
    time_s = violated.curve.time_s
    whole = np.ones(len(time_s))
    ends = {"low": violated.low, "high": violated.high}
    below, above = (
        whole * edge if end is None else end
        for edge, end in zip(height, ends.values(), strict=True)
    )
    asked = np.isfinite(below) & np.isfinite(above)
    if asked.any():
        nowhere = np.where(asked, 0.0, np.nan)
        figure.varea(
            store(time_s), store(below + nowhere), store(above + nowhere),
            fill_color=to_hex(ALLOWED), fill_alpha=0.13,
        )  # fmt: skip
    if violated.reference is not None:
        figure.line(store(time_s), store(violated.reference), color=RING)
    for side, name in violated.describe_limits().items():
        end = ends[side]
        if end is None:
            continue
        figure.line(
            store(time_s), store(end), color=to_hex(ALLOWED), line_dash="dashed", line_width=1.6
        )
        known = np.flatnonzero(np.isfinite(end))
        if len(known):
            row = known[0]
            # If the band begins late, its name would leave the plot on the right.
            is_late = time_s[row] > 0.7 * end_s
            figure.text(
                [time_s[row]], [end[row]], text=[name], text_color=to_hex(ALLOWED),
                text_font_size="12px", x_offset=-4 if is_late else 4,
                text_align="right" if is_late else "left", y_offset=-2 if side == "high" else 2,
                text_baseline="bottom" if side == "high" else "top",
            )  # fmt: skip


def _name_moments(
    plots: Plots,
    figure: Any,
    violated: ViolatedSignal,
    height: tuple[float, float],
    end_s: float,
) -> None:
    """Mark the worst and the first moment, named on the side that has more room."""
    named = [(violated.worst, violated.worst_word)]
    if violated.first != violated.worst:
        named.append((violated.first, "first"))
    # A violation is an extreme: there is room beyond it, and less on the other side.
    is_above = violated.worst.value >= sum(height) / 2.0
    is_close = abs(violated.first.time_s - violated.worst.time_s) < _CLOSE * end_s
    for moment, word in named:
        if word == "first" and is_close:
            is_above = not is_above
        figure.scatter(
            [moment.time_s], [moment.value], size=10, color=RED, line_color="white",
            marker="circle" if word != "first" else "inverted_triangle",
        )  # fmt: skip
        text = violated.describe_moment(moment, word)
        words = _write(figure, text, moment, (is_above, end_s))
        plots.config["words"].append(words.glyph.id)


def _write(figure: Any, text: str, moment: ViolationMoment, place: tuple[bool, float]) -> Any:
    is_above, end_s = place
    is_late = moment.time_s > 0.5 * end_s
    return figure.text(
        [moment.time_s], [moment.value], text=[text], text_color=RED, text_font_size="13px",
        text_font_style="bold", text_align="right" if is_late else "left",
        x_offset=-6 if is_late else 6, y_offset=-9 if is_above else 9,
        text_baseline="bottom" if is_above else "top",
    )  # fmt: skip
