"""The luck of a run as a picture: its value over the starts, and their ends close up."""

from collections.abc import Callable
from textwrap import wrap
from typing import Final

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from turtlelog.charts import palette
from turtlelog.charts.attribution_steps import StepScale
from turtlelog.charts.close_up import CloseUp
from turtlelog.charts.luck_chart import LuckLine, LuckPicture, spread_labels
from turtlelog.charts.palette import Color
from turtlelog.draw.rerun import entities
from turtlelog.draw.rerun.entities import join_path
from turtlelog.draw.rerun.waterfall import (
    HEIGHT,
    LETTERS,
    LINE,
    PADDING,
    PROSE_LETTER,
    choose_ticks,
    measure_words,
    write_tick,
    write_words,
)

_LEFT: Final = 9.0
"""Where the axis stands: words of values have room before it."""

_RIGHT: Final = 77.0
"""Where the curves end; their names stand behind, in the units of the waterfall."""

_FOOT: Final = 30.0
"""Where the axis of the starts lies."""

_TICK: Final = 0.7
_PLAIN: Final = StepScale(factor=1.0, unit="", decimals=0)

_END_RADIUS: Final = 1.6  # [points]
_LINE_RADIUS: Final = 0.9
_THIN_RADIUS: Final = 0.5
_DOT_RADIUS: Final = 1.6
_RECORDED_RADIUS: Final = 4.0

Words = tuple[float, float, str, Color]
Values = NDArray[np.float64]


def draw_luck_picture(stream: rr.RecordingStream, shown: LuckPicture) -> None:
    """Draw the value over the starts, each curve with its name at its right end."""
    lines = wrap(" ".join(shown.sentences), LETTERS)
    if len(lines) > 1:
        lines = [line for text in shown.sentences for line in wrap(text, LETTERS)]
    words: list[Words] = [
        (_place_prose(line), (number + 0.5) * LINE, line, palette.GOAL)
        for number, line in enumerate(lines)
    ]
    top = (len(lines) + 0.5) * LINE
    low, high = shown.limits
    first, last = float(shown.places[0]), float(shown.places[-1])

    def place(points: Values) -> Values:
        across = _LEFT + 1.5 + (points[:, 0] - first) / (last - first) * (_RIGHT - _LEFT - 1.5)
        up = _FOOT - (points[:, 1] - low) / (high - low) * (_FOOT - top)
        return np.stack([across, up], axis=1)

    height = LINE * (high - low) / (_FOOT - top)
    ends = [shown.find_end(line) for line in shown.lines]
    names = spread_labels([end[1] for end in ends], height, shown.limits)
    for number, (line, end, name) in enumerate(zip(shown.lines, ends, names, strict=True)):
        _draw_line(stream, f"{len(shown.lines) - number}", shown, line, place)
        at, leader = place(np.array([end, (last, name)]))
        aside = [at, (_RIGHT + 1.0, leader[1])]
        entity = join_path(entities.LUCK, "leaders", str(number))
        _draw_strips(stream, entity, [np.array(aside)], line.color, _THIN_RADIUS)
        middle = _RIGHT + 1.0 + measure_words(line.name) / 2.0
        words.append((middle, float(leader[1]), line.name, line.color))
    if shown.recorded is not None:
        words.append(_mark_recorded(stream, shown, shown.recorded, place))
    words += _draw_axes(stream, shown, top, place)
    write_words(stream, entities.LUCK, words)


def draw_luck_ends(
    stream: rr.RecordingStream, shown: LuckPicture, close_up: CloseUp | None
) -> None:
    """Draw where the starts end in the close-up of the goal, below the ends of the runs."""
    if shown.plane is None or close_up is None:
        return
    ends_m = np.concatenate([shown.plane.ends_m, shown.plane.ghosts_m])
    colors = [palette.MAIN] * len(shown.plane.ends_m)
    colors += [palette.GHOST] * len(shown.plane.ghosts_m)
    dots = rr.Points2D(
        ends_m + np.array(close_up.goal_xy_m),
        radii=rr.Radius.ui_points(_END_RADIUS),
        colors=colors,
    )
    stream.log(join_path(entities.LUCK_ENDS), dots, static=True)


def count_ends(shown: LuckPicture, close_up: CloseUp | None) -> str:
    """Return how many starts end in the close-up, to end its title with; empty without both."""
    if shown.plane is None or close_up is None:
        return ""
    ends_m = shown.plane.ends_m
    inside = int((np.abs(ends_m) <= close_up.half_m).all(axis=1).sum())
    what = "starts" if shown.varied == "start" else "seeds"
    return f", dots: {inside} of {len(ends_m)} {what}"


def _place_prose(line: str) -> float:
    return (PROSE_LETTER * len(line) + PADDING) / 2.0


def _draw_line(
    stream: rr.RecordingStream,
    name: str,
    shown: LuckPicture,
    line: LuckLine,
    place: Callable[[Values], Values],
) -> None:
    """Draw the parts of a curve; points where it is of the run, or of one start alone."""
    points = place(np.stack([shown.places, line.values], axis=1))
    entity = join_path(entities.LUCK, f"curve_{name}")
    parts = [points[first : last + 1] for first, last in line.pieces]
    strips = [part for part in parts if len(part) > 1]
    if strips:
        _draw_strips(stream, entity, strips, line.color, _LINE_RADIUS)
    is_run = line.kind == "run"
    dots = [part for part in parts if is_run or len(part) == 1]
    if dots:
        marks = rr.Points2D(
            np.concatenate(dots), radii=rr.Radius.ui_points(_DOT_RADIUS), colors=[line.color]
        )
        stream.log(join_path(entity, "starts"), marks, static=True)


def _draw_strips(
    stream: rr.RecordingStream, entity: str, strips: list[Values], color: Color, radius: float
) -> None:
    drawn = rr.LineStrips2D(strips, radii=rr.Radius.ui_points(radius), colors=[color])
    stream.log(entity, drawn, static=True)


def _mark_recorded(
    stream: rr.RecordingStream,
    shown: LuckPicture,
    recorded: tuple[float, float],
    place: Callable[[Values], Values],
) -> Words:
    """Mark the run itself; return its words, on the side of the curve that has more room."""
    ((x, y),) = place(np.array([recorded])).tolist()
    dot = rr.Points2D([(x, y)], radii=rr.Radius.ui_points(_RECORDED_RADIUS), colors=[palette.MAIN])
    stream.log(join_path(entities.LUCK, "recorded"), dot, static=True)
    is_high = recorded[1] > sum(shown.limits) / 2.0
    return x, y + (LINE if is_high else -LINE), shown.recorded_name, palette.MAIN


def _draw_axes(
    stream: rr.RecordingStream,
    shown: LuckPicture,
    top: float,
    place: Callable[[Values], Values],
) -> list[Words]:
    """Draw both axes; return their words."""
    first, last = float(shown.places[0]), float(shown.places[-1])
    low, high = shown.limits
    rises = [tick for tick in choose_ticks([low, high], _PLAIN) if low <= tick <= high]
    across = [first, 0.0, last] if first < 0.0 else [first, last]
    lefts = place(np.array([(first, tick) for tick in rises])).tolist()
    feet = place(np.array([(tick, low) for tick in across])).tolist()
    strips = [[(_LEFT, top), (_LEFT, _FOOT)], [(_LEFT, _FOOT), (_RIGHT, _FOOT)]]
    strips += [[(_LEFT - _TICK, y), (_LEFT, y)] for _, y in lefts]
    strips += [[(x, _FOOT), (x, _FOOT + _TICK)] for x, _ in feet]
    axes = [np.array(strip) for strip in strips]
    _draw_strips(stream, join_path(entities.LUCK, "axes"), axes, palette.REFERENCE, _THIN_RADIUS)
    words = [
        (_LEFT - _TICK - measure_words(text) / 2.0, y, text, palette.START)
        for (_, y), text in zip(lefts, [write_tick(tick, _PLAIN) for tick in rises], strict=True)
    ]
    words += [
        (x, _FOOT + 0.5 * LINE, f"{tick:.3g}", palette.START)
        for (x, _), tick in zip(feet, across, strict=True)
    ]
    label = f"{shown.value_label} over {shown.place_label}"
    words.append((_place_prose(label), HEIGHT - 0.3 * LINE, label, palette.START))
    return words
