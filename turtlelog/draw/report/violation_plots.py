"""A plot of each failed check: its signal, the band that it was held to, and the part outside."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from turtlelog.charts.curves import Values
from turtlelog.charts.palette import ALLOWED, MAIN, Color
from turtlelog.charts.violated_signal import ViolatedSignal, ViolationMoment
from turtlelog.display import format_number
from turtlelog.draw.report.drawn import RING, Plots, make_figure, store, thin, to_hex
from turtlelog.libraries import load_library

MOST_VIOLATIONS: Final = 6
"""Failed checks that have a plot: of more the table tells, and a page of plots would be skimmed."""

RED: Final = "#d0342c"

_SMALL: Final = 0.12
"""Share of the axis below which limits and what is outside would be too small to be told apart."""

_ROOM: Final = 0.18
"""Of the height, above and below what is seen, for words."""

_CLOSE: Final = 0.3
"""Share of the width within which words of two moments stand on one another."""


def draw_violations(
    plots: Plots, found: Sequence[tuple[ViolatedSignal, Color | None]], x_range: Any
) -> None:
    """Draw the signal of each failed check, on the axis of time of all plots.

    Args:
        plots: The page, which gets places `violation-0`, `violation-1` and so on.
        found: Signals, and the colour of the run of each.
        x_range: Bokeh's range of time.
    """
    for number, (violated, color) in enumerate(found[:MOST_VIOLATIONS]):
        _draw_violation(plots, f"violation-{number}", violated, color or MAIN, x_range)


def _draw_violation(
    plots: Plots, place: str, violated: ViolatedSignal, color: Color, x_range: Any
) -> None:
    models = load_library("bokeh.models")
    low, high, is_cut = _find_height(violated)
    title = violated.title.replace("_", " ")
    if is_cut:
        furthest = float(np.nanmax(np.abs(violated.curve.values)))
        title += f", close up: its magnitude goes to {format_number(furthest, violated.unit)}"
    figure = make_figure(
        plots, place, title, x_range=x_range, height=260, y_range=models.Range1d(low, high),
        x_axis_label="time from the first sample [s]",
    )  # fmt: skip
    _draw_band(figure, violated, (low, high), x_range.end)
    curve = violated.curve
    mode = "after" if curve.holds else None
    time_s, values = thin(plots, [curve.time_s, curve.values], curve.values)
    _draw_line(figure, time_s, values, mode, color=to_hex(color), line_width=1.8)
    shown = violated.outside.copy()
    if curve.holds:
        shown[1:] |= violated.outside[:-1]
    red = np.where(shown, curve.values, np.nan)
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
    """Shade what is asked for, where it is, and name its limits."""
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
            # Where the band begins late, its name would leave the plot on the right.
            is_late = time_s[row] > 0.7 * end_s
            figure.text(
                [time_s[row]], [end[row]], text=[name], text_color=to_hex(ALLOWED),
                text_font_size="12px", x_offset=-4 if is_late else 4,
                text_align="right" if is_late else "left", y_offset=-2 if side == "high" else 2,
                text_baseline="bottom" if side == "high" else "top",
            )  # fmt: skip


def _find_height(violated: ViolatedSignal) -> tuple[float, float, bool]:
    """Return from where to where the plot goes, and whether the signal goes beyond.

    Limits, what is outside, and the moments that are named are always seen.
    """
    ends = [end[np.isfinite(end)] for end in (violated.low, violated.high) if end is not None]
    values = violated.curve.values
    moments = [violated.first.value, violated.worst.value]
    near: Values = np.concatenate([*ends, values[violated.outside], moments])
    near = near[np.isfinite(near)]
    known = np.concatenate([near, values[np.isfinite(values)]])
    low, high = float(known.min()), float(known.max())
    is_cut = float(np.ptp(near)) < _SMALL * (high - low)
    if is_cut:
        low, high = float(near.min()), float(near.max())
        room = 0.8 * (high - low) or 0.1 * abs(low) or 1.0
    else:
        room = _ROOM * (high - low) or 0.1 * abs(low) or 1.0
    return low - room, high + room, is_cut


def _name_moments(
    plots: Plots,
    figure: Any,
    violated: ViolatedSignal,
    height: tuple[float, float],
    end_s: float,
) -> None:
    """Mark the worst and the first moment, named on the side where there is room."""
    named = [(violated.worst, violated.worst_word)]
    if violated.first != violated.worst:
        named.append((violated.first, "first"))
    # What is outside is an extreme: there is room beyond it, and less on its other side.
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
