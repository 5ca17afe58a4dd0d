"""Pictures in their own coordinates: legends of many runs, an attribution, the effect of chance."""

from collections.abc import Callable, Sequence
from textwrap import wrap
from typing import Any, Final

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from turtlelog.charts import palette
from turtlelog.charts.attribution_steps import StepScale, Waterfall
from turtlelog.charts.close_up import CloseUp
from turtlelog.charts.curves import Values
from turtlelog.charts.luck_chart import LuckLine, LuckPicture, spread_labels
from turtlelog.charts.many_runs import GainScale
from turtlelog.draw.rerun import entities
from turtlelog.draw.rerun.entities import join_path
from turtlelog.draw.rerun.plane import log_points, log_strips, log_words


def view_picture(
    name: str,
    contents: Sequence[str],
    x_range: tuple[float, float],
    y_range: tuple[float, float],
    **more: Any,
) -> rrb.View:
    """Return the view of a picture in its own coordinates, on dark ground."""
    return rrb.Spatial2DView(
        origin="/",
        contents=contents,
        name=name,
        background=palette.GROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=x_range, y_range=y_range),
        **more,
    )


_SCALE_WIDTH: Final = 12.0  # width of the colour bar of many runs, in multiples of its height

_SCALE_DEPTH: Final = 2.5
_LEGEND_WIDTH: Final = 12.0  # least width, in multiples of a row's height
_LEGEND_ASPECT: Final = 2.6  # width per height of its view: with more rows, columns would touch

_LEGEND_LETTERS: Final = 48
"""Number of letters of all columns together; with dots and gaps they take 400 of 430 pixels."""

_MOST_COLUMNS: Final = 4
"""Largest number of columns of names; more columns of short names would look like lines of text."""

_MOST_ROWS: Final = 7  # lines of names in a window of 1200 x 860
_LEGEND_RADIUS: Final = 5.0  # [points]
_SCALE_HEIGHT: Final = 1.0

_SCALE_LINES: Final = 8
"""Number of lines that fill a cell, because the viewer rounds the ends of a thick line."""

_SCALE_LABELS: Final = 12  # largest number of values in a view 500 pixels wide: 40 pixels each


def view_scale(title: str) -> rrb.View:
    """Return the view of the colour bar of many runs."""
    contents, across = [f"{join_path(entities.LEGEND)}/**"], (-0.3, _SCALE_WIDTH + 0.3)
    return view_picture(title, contents, across, (-0.5, _SCALE_DEPTH))


def view_legend(names: Sequence[str]) -> rrb.View:
    """Return the view of the names of runs."""
    shown = choose_names(names)
    rows = -(-len(shown) // _count_columns(names))
    title = "Runs" if len(shown) == len(names) else f"{len(shown)} of {len(names)} runs"
    ranges = (0.0, _find_width(rows)), (-0.5, float(rows))
    return view_picture(title, [join_path(entities.LEGEND)], *ranges)


def draw_legend(
    stream: rr.RecordingStream, names: Sequence[str], colors: Sequence[palette.Color]
) -> None:
    """Draw the names of runs in their colours."""
    chosen = choose_names(names)
    shown, hues = [names[number] for number in chosen], [colors[number] for number in chosen]
    looks: dict[str, Any] = {"labels": shown, "show_labels": True}
    places = arrange_names(len(shown), _count_columns(names))
    log_points(stream, entities.LEGEND, places, hues, _LEGEND_RADIUS, **looks)


def draw_scale(
    stream: rr.RecordingStream, scale: GainScale, colors: Sequence[palette.Color]
) -> None:
    """Draw a bar of the runs' colours in order, with some of the values below the bar."""
    width = _SCALE_WIDTH / len(colors)
    edges = np.arange(len(colors) + 1) * width
    bar = rr.LineStrips2D(
        [
            [(x, (row + 0.5) * _SCALE_HEIGHT / _SCALE_LINES) for x in edges[number : number + 2]]
            for number in range(len(colors))
            for row in range(_SCALE_LINES)
        ],
        radii=_SCALE_HEIGHT / _SCALE_LINES * 0.6,
        colors=palette.pack_colors([color for color in colors for _ in range(_SCALE_LINES)]),
    )
    stream.log(join_path(entities.LEGEND, "bar"), bar, static=True)
    ticks = scale.list_ticks(_SCALE_LABELS)
    places = [((place + 0.5) * width, _SCALE_HEIGHT) for place, _ in ticks]
    hues = [colors[round(place)] for place, _ in ticks]
    log_words(stream, f"{entities.LEGEND}/values", places, [value for _, value in ticks], hues)


def choose_names(names: Sequence[str]) -> tuple[int, ...]:
    """Return the indices of the named runs among many, as room allows, including the last run.

    Colours of many runs follow their order, so neighbouring names identify unnamed runs.
    """
    most = min(len(names), _MOST_ROWS * _count_columns(names))
    return tuple(np.linspace(0, len(names) - 1, most).round().astype(int).tolist())


def arrange_names(count: int, columns: int) -> Values:
    """Return places in a grid, y downward, shape (n, 2)."""
    number, width = np.arange(count), _find_width(-(-count // columns))
    across = (number % columns + 0.5) * (width / columns)
    return np.column_stack([across, number // columns])


def _count_columns(names: Sequence[str]) -> int:
    """Return the number of columns of names. The longest name sets their width."""
    return max(1, min(_MOST_COLUMNS, _LEGEND_LETTERS // max(map(len, names))))


def _find_width(rows: int) -> float:
    return max(_LEGEND_WIDTH, _LEGEND_ASPECT * (rows + 0.5))


_WIDTH: Final = 100.0
"""Width of the picture in its unit of length; one unit is 7 pixels in a window of 1200 x 860."""

_HEIGHT: Final = 36.0
_FOOT: Final = 2.0
"""Space below the picture: in a small window, text keeps its height and extends further down."""
_LETTER: Final = 0.95
_SMALL_LETTER: Final = 2.3  # width of a letter in a window of 700 x 450, where a unit is 3 pixels
_PADDING: Final = 2.4  # around text
_ABOVE: Final = 1.9  # the viewer writes text below its point
_GAP: Final = 0.6
_LINE: Final = 3.6
_TICK: Final = 0.7
_MOST_TICKS: Final = 3  # steps of the axis; the values also have room in a window of 700 x 450
_BAR_SHARE: Final = 0.66  # of a row
_HIGHEST_BAR: Final = 5.5
_LEAST_SCALE: Final = 25.0  # smallest length of the longest bar, however long the text is
_PROSE_LETTER: Final = 0.84  # factor for long lines, in which narrow and wide letters compensate
_LETTERS: Final = 100  # largest length of a line of text [letters]
_LEFT: Final = 9.0  # position of the axis; the values have room to the left of it

_RIGHT: Final = 77.0
"""Right end of the curves, followed by their names, in the units of the waterfall."""

_AXIS_FOOT: Final = 30.0  # height of the axis of the starts

_PLAIN: Final = StepScale(factor=1.0, unit="", decimals=0)
_END_RADIUS: Final = 1.6  # [points]
_THIN_RADIUS: Final = 0.5

_Words = tuple[float, float, str, palette.Color]
"""Middle of a text, the text, and its colour."""


def draw_waterfall_picture(
    stream: rr.RecordingStream, waterfall: Waterfall, more: Sequence[str] = ()
) -> None:
    """Draw the bars from top to bottom over an axis, with `more` lines below the notes."""
    steps, scale, notes = waterfall.steps, waterfall.scale, (*waterfall.notes, *more)
    names_end = max(_measure_words(step.name) for step in steps)
    (low, high), width = waterfall.span, _find_scale(waterfall, names_end)

    def place(value: float) -> float:
        return names_end + _GAP + (value - low) * width

    pitch = _HEIGHT / (len(steps) + 1 + len(notes))
    axis_y = len(steps) * pitch
    half = min(_BAR_SHARE * pitch, _HIGHEST_BAR) / 2.0
    middles = (np.arange(len(steps)) + 0.5) * pitch
    words: list[_Words] = []
    joints = [[(place(0.0), 0.0), (place(0.0), axis_y)]]
    for number, (step, y) in enumerate(zip(steps, middles.tolist(), strict=True)):
        left, right = sorted((place(step.start), place(step.end)))
        # A filled rectangle is an image of one colour, because boxes have only outlines.
        size = np.diag([max(right - left, 0.15) / 2.0, half, 1.0])
        frame = rr.Transform3D(translation=[left, y - half, 0.0], mat3x3=size)
        image = rr.Image(np.full((2, 2, 3), step.color, dtype=np.uint8))
        for part in (frame, image):
            stream.log(join_path(entities.STEPS, f"bar_{number}"), part, static=True)
        words.append((names_end - _measure_words(step.name) / 2.0, y, step.name, palette.GOAL))
        # In a small window, text keeps its size around its middle: it avoids the bar's name.
        room = _measure_words(step.text) / 2.0
        clear = names_end + _SMALL_LETTER * len(step.text) / 2.0
        middle = max(right + _GAP + room, min(clear, _WIDTH - room))
        words.append((middle, y, step.text, palette.GOAL))
    for x, above, below in zip(map(place, waterfall.joints), middles, middles[1:], strict=False):
        joints.append([(x, float(above) + half), (x, float(below) - half)])
    ticks = choose_ticks([low, high], scale)
    joints.append([(place(min(low, *ticks)), axis_y), (place(high), axis_y)])
    joints += [[(place(tick), axis_y), (place(tick), axis_y + _TICK)] for tick in ticks]
    for tick in ticks:
        words.append((place(tick), axis_y + 0.5 * pitch, write_tick(tick, scale), palette.START))
    for number, note in enumerate(notes):
        y = axis_y + (number + 1.5) * pitch
        words.append((_WIDTH / 2.0, y, note, palette.START))
    entity = f"{entities.STEPS}/joints"
    log_strips(stream, entity, joints, [palette.REFERENCE], _THIN_RADIUS)
    _write_words(stream, entities.STEPS, words)


def draw_reason(stream: rr.RecordingStream, sentences: Sequence[str]) -> None:
    """Write the reason why there are no steps, in place of the steps."""
    lines = [line for sentence in sentences for line in wrap(sentence, _LETTERS)]
    most = int(_HEIGHT // _LINE)
    if len(lines) > most:
        lines = [*lines[: most - 1], "..."]
    _write_words(stream, entities.STEPS, _list_prose(lines))


def _list_prose(lines: Sequence[str]) -> list[_Words]:
    """Return lines of text one below another, with their places."""
    return [
        (_place_prose(line), (number + 0.5) * _LINE, line, palette.GOAL)
        for number, line in enumerate(lines)
    ]


def view_explained(title: str, entity: str) -> rrb.View:
    """Return the view of the steps, of the reason why there are none, or of chance."""
    contents = [f"{join_path(entity)}/**"]
    return view_picture(title, contents, (0.0, _WIDTH), (0.0, _HEIGHT + _FOOT))


def choose_ticks(ends: Sequence[float], scale: StepScale) -> list[float]:
    """Return round values between the ends of bars, including 0, in the metric's unit."""
    low, high = min(0.0, *ends) * scale.factor, max(0.0, *ends) * scale.factor
    if not high > low:
        return [0.0]
    decade = 10.0 ** np.floor(np.log10((high - low) / _MOST_TICKS))
    step = next(s * decade for s in (1.0, 2.0, 5.0, 10.0) if s * decade * _MOST_TICKS > high - low)
    numbers = np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1.0)
    return [float(number * step / scale.factor) + 0.0 for number in numbers]


def write_tick(value: float, scale: StepScale) -> str:
    """Return a value of the axis with its unit."""
    return f"{round(value * scale.factor, 12):g} {scale.unit}".strip()


def _find_scale(waterfall: Waterfall, names_end: float) -> float:
    """Return the width of a unit with which the text after each bar has room."""
    low, high = waterfall.span
    span = high - low
    if not span > 0.0:
        return 1.0
    room = _WIDTH - names_end - 2.0 * _GAP
    scales = [
        (room - _measure_words(step.text)) / (max(step.start, step.end) - low)
        for step in waterfall.steps
        if max(step.start, step.end) > low
    ]
    return max(min([room / span, *scales]), _LEAST_SCALE / span)


def _measure_words(text: str) -> float:
    """Return the width of text in the units of the picture, with a margin."""
    return _LETTER * len(text) + _PADDING


def _write_words(stream: rr.RecordingStream, entity: str, words: Sequence[_Words]) -> None:
    places = [(x, y - _ABOVE) for x, y, _, _ in words]
    texts, colors = [text for _, _, text, _ in words], [color for *_, color in words]
    log_words(stream, f"{entity}/words", places, texts, colors)


def draw_luck_picture(stream: rr.RecordingStream, shown: LuckPicture) -> None:
    """Draw the value over the starts. Each curve has its name at the right end."""
    lines = wrap(" ".join(shown.sentences), _LETTERS)
    if len(lines) > 1:
        lines = [line for text in shown.sentences for line in wrap(text, _LETTERS)]
    words = _list_prose(lines)
    top = (len(lines) + 0.5) * _LINE
    low, high = shown.limits
    first, last = float(shown.places[0]), float(shown.places[-1])

    def place(points: Values) -> Values:
        across = _LEFT + 1.5 + (points[:, 0] - first) / (last - first) * (_RIGHT - _LEFT - 1.5)
        up = _AXIS_FOOT - (points[:, 1] - low) / (high - low) * (_AXIS_FOOT - top)
        return np.stack([across, up], axis=1)

    height = _LINE * (high - low) / (_AXIS_FOOT - top)
    ends = [shown.find_end(line) for line in shown.lines]
    names = spread_labels([end[1] for end in ends], height, shown.limits)
    for number, (line, end, name) in enumerate(zip(shown.lines, ends, names, strict=True)):
        _draw_line(stream, f"{len(shown.lines) - number}", shown, line, place)
        at, leader = place(np.array([end, (last, name)]))
        aside = [at, (_RIGHT + 1.0, leader[1])]
        entity = f"{entities.LUCK}/leaders/{number}"
        log_strips(stream, entity, [np.array(aside)], [line.color], _THIN_RADIUS)
        middle = _RIGHT + 1.0 + _measure_words(line.name) / 2.0
        words.append((middle, float(leader[1]), line.name, line.color))
    if shown.recorded is not None:
        ((x, y),) = place(np.array([shown.recorded])).tolist()
        entity = f"{entities.LUCK}/recorded"
        log_points(stream, entity, [(x, y)], [palette.MAIN], radius=4.0)
        # The text is on the side of the curve with more room.
        y += _LINE if shown.recorded[1] > sum(shown.limits) / 2.0 else -_LINE
        words.append((x, y, shown.recorded_name, palette.MAIN))
    words += _draw_axes(stream, shown, top, place)
    _write_words(stream, entities.LUCK, words)


def draw_luck_ends(
    stream: rr.RecordingStream, shown: LuckPicture, close_up: CloseUp | None
) -> None:
    """Draw the ends of the starts in the close-up of the goal, below the ends of the runs."""
    if shown.plane is None or close_up is None:
        return
    ends_m = np.concatenate([shown.plane.ends_m, shown.plane.ghosts_m]) + close_up.goal_xy_m
    colors = [palette.MAIN] * len(shown.plane.ends_m)
    colors += [palette.GHOST] * len(shown.plane.ghosts_m)
    log_points(stream, entities.LUCK_ENDS, ends_m, colors, _END_RADIUS)


def count_ends(shown: LuckPicture, close_up: CloseUp | None) -> str:
    """Return text on the number of ends in the close-up, for the title; empty without ends."""
    if shown.plane is None or close_up is None:
        return ""
    ends_m = shown.plane.ends_m
    inside = int((np.abs(ends_m) <= close_up.half_m).all(axis=1).sum())
    what = "starts" if shown.varied == "start" else "seeds"
    return f", dots: {inside} of {len(ends_m)} {what}"


def _place_prose(line: str) -> float:
    return (_PROSE_LETTER * len(line) + _PADDING) / 2.0


def _draw_line(
    stream: rr.RecordingStream,
    name: str,
    shown: LuckPicture,
    line: LuckLine,
    place: Callable[[Values], Values],
) -> None:
    """Draw the parts of a curve, and points for the parts of the run or of a single start."""
    points = place(np.stack([shown.places, line.values], axis=1))
    entity = f"{entities.LUCK}/curve_{name}"
    parts = [points[first : last + 1] for first, last in line.pieces]
    strips = [part for part in parts if len(part) > 1]
    if strips:
        log_strips(stream, entity, strips, [line.color], radius=0.9)
    dots = [part for part in parts if line.kind == "run" or len(part) == 1]
    if dots:
        places = np.concatenate(dots)
        log_points(stream, f"{entity}/starts", places, [line.color], radius=1.6)


def _draw_axes(
    stream: rr.RecordingStream,
    shown: LuckPicture,
    top: float,
    place: Callable[[Values], Values],
) -> list[_Words]:
    """Draw both axes, and return their text."""
    first, last = float(shown.places[0]), float(shown.places[-1])
    low, high = shown.limits
    rises = [tick for tick in choose_ticks([low, high], _PLAIN) if low <= tick <= high]
    across = [first, 0.0, last] if first < 0.0 else [first, last]
    lefts = place(np.array([(first, tick) for tick in rises])).tolist()
    feet = place(np.array([(tick, low) for tick in across])).tolist()
    strips = [[(_LEFT, top), (_LEFT, _AXIS_FOOT)], [(_LEFT, _AXIS_FOOT), (_RIGHT, _AXIS_FOOT)]]
    strips += [[(_LEFT - _TICK, y), (_LEFT, y)] for _, y in lefts]
    strips += [[(x, _AXIS_FOOT), (x, _AXIS_FOOT + _TICK)] for x, _ in feet]
    axes = [np.array(strip) for strip in strips]
    log_strips(stream, f"{entities.LUCK}/axes", axes, [palette.REFERENCE], _THIN_RADIUS)
    texts = [write_tick(tick, _PLAIN) for tick in rises]
    words = [
        (_LEFT - _TICK - _measure_words(text) / 2.0, y, text, palette.START)
        for (_, y), text in zip(lefts, texts, strict=True)
    ]
    words += [
        (x, _AXIS_FOOT + 0.5 * _LINE, f"{tick:.3g}", palette.START)
        for (x, _), tick in zip(feet, across, strict=True)
    ]
    label = f"{shown.value_label} over {shown.place_label}"
    words.append((_place_prose(label), _HEIGHT - 0.3 * _LINE, label, palette.START))
    return words
