"""An attribution as a picture: a bar for each step, with its name before it and its size behind."""

from collections.abc import Sequence
from textwrap import wrap
from typing import Final

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from turtlelog.charts import palette
from turtlelog.charts.attribution_steps import AttributionStep, StepScale, Waterfall
from turtlelog.charts.palette import Color
from turtlelog.draw.rerun import entities
from turtlelog.draw.rerun.entities import join_path

WIDTH: Final = 100.0
"""Of the picture; all else is in its units, of which one is 7 pixels in a window of 1200 x 860."""

HEIGHT: Final = 36.0
_FOOT: Final = 2.0
"""Below it: in a small window words keep their height, and stand lower."""
_LETTER: Final = 0.95
_SMALL_LETTER: Final = 2.3
"""Width of a letter in a window of 700 x 450, where a unit is 3 pixels."""
PADDING: Final = 2.4  # around words
_ABOVE: Final = 1.9  # The viewer writes words below their point.
_GAP: Final = 0.6
LINE: Final = 3.6
_TICK: Final = 0.7
_MOST_TICKS: Final = 3
"""Steps of the axis: its values have room also in a window of 700 x 450."""
_BAR_SHARE: Final = 0.66  # of a row
_HIGHEST_BAR: Final = 5.5
_LEAST_SCALE: Final = 25.0
"""Longest bar at least, however long its words are."""

PROSE_LETTER: Final = 0.84
"""Of long lines, in which narrow letters and wide ones make up for each other."""

LETTERS: Final = 100
"""Of a line of text."""


def draw_waterfall(
    stream: rr.RecordingStream, waterfall: Waterfall, more: Sequence[str] = ()
) -> None:
    """Draw the bars from top to bottom over an axis.

    Args:
        stream: The recording.
        waterfall: What it consists of.
        more: Lines below its notes.
    """
    steps, scale, notes = waterfall.steps, waterfall.scale, (*waterfall.notes, *more)
    names_end = max(measure_words(step.name) for step in steps)
    (low, high), width = waterfall.span, _find_scale(waterfall, names_end)

    def place(value: float) -> float:
        return names_end + _GAP + (value - low) * width

    pitch = HEIGHT / (len(steps) + 1 + len(notes))
    axis_y = len(steps) * pitch
    half = min(_BAR_SHARE * pitch, _HIGHEST_BAR) / 2.0
    middles = (np.arange(len(steps)) + 0.5) * pitch
    words: list[tuple[float, float, str, Color]] = []
    joints = [[(place(0.0), 0.0), (place(0.0), axis_y)]]
    for number, (step, y) in enumerate(zip(steps, middles.tolist(), strict=True)):
        left, right = sorted((place(step.start), place(step.end)))
        _draw_bar(stream, number, (left, y - half), (right, y + half), step.color)
        words.append((names_end - measure_words(step.name) / 2.0, y, step.name, palette.GOAL))
        words.append((_place_words(step, names_end, right), y, step.text, palette.GOAL))
    for x, above, below in zip(map(place, waterfall.joints), middles, middles[1:], strict=False):
        joints.append([(x, float(above) + half), (x, float(below) - half)])
    ticks = choose_ticks([low, high], scale)
    joints.append([(place(min(low, *ticks)), axis_y), (place(high), axis_y)])
    joints += [[(place(tick), axis_y), (place(tick), axis_y + _TICK)] for tick in ticks]
    for tick in ticks:
        words.append((place(tick), axis_y + 0.5 * pitch, write_tick(tick, scale), palette.START))
    for number, note in enumerate(notes):
        y = axis_y + (number + 1.5) * pitch
        words.append((WIDTH / 2.0, y, note, palette.START))
    lines = rr.LineStrips2D(joints, radii=rr.Radius.ui_points(0.5), colors=[palette.REFERENCE])
    stream.log(join_path(entities.STEPS, "joints"), lines, static=True)
    write_words(stream, entities.STEPS, words)


def draw_reason(stream: rr.RecordingStream, sentences: Sequence[str]) -> None:
    """Write in place of the steps why there are none."""
    lines = [line for sentence in sentences for line in wrap(sentence, LETTERS)]
    most = int(HEIGHT // LINE)
    if len(lines) > most:
        lines = [*lines[: most - 1], "..."]
    words = [
        (
            (PROSE_LETTER * len(line) + PADDING) / 2.0,
            (number + 0.5) * LINE,
            line,
            palette.GOAL,
        )
        for number, line in enumerate(lines)
    ]
    write_words(stream, entities.STEPS, words)


def view_waterfall(title: str) -> rrb.View:
    """Return the view of the steps, or of the reason why there are none."""
    return view_picture(title, entities.STEPS)


def view_picture(title: str, entity: str) -> rrb.View:
    """Return the view of a picture in the units of this one."""
    return rrb.Spatial2DView(
        origin="/",
        contents=f"{join_path(entity)}/**",
        name=title,
        background=palette.GROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=(0.0, WIDTH), y_range=(0.0, HEIGHT + _FOOT)),
    )


def choose_ticks(ends: Sequence[float], scale: StepScale) -> list[float]:
    """Return round values between the ends of bars, 0 among them, in the metric's unit."""
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


def _place_words(step: AttributionStep, names_end: float, bar_end: float) -> float:
    """Return the middle of the words behind a bar: those of a short bar keep off its name.

    Words keep their size where the window is small, and stand around their middle.
    """
    half = measure_words(step.text) / 2.0
    clear = names_end + _SMALL_LETTER * len(step.text) / 2.0
    return max(bar_end + _GAP + half, min(clear, WIDTH - half))


def _find_scale(waterfall: Waterfall, names_end: float) -> float:
    """Return the width of a unit, so that the words behind each bar have room."""
    low, high = waterfall.span
    span = high - low
    if not span > 0.0:
        return 1.0
    room = WIDTH - names_end - 2.0 * _GAP
    scales = [
        (room - measure_words(step.text)) / (max(step.start, step.end) - low)
        for step in waterfall.steps
        if max(step.start, step.end) > low
    ]
    return max(min([room / span, *scales]), _LEAST_SCALE / span)


def measure_words(text: str) -> float:
    """Return how wide words are in the units of the picture, with room around them."""
    return _LETTER * len(text) + PADDING


def _draw_bar(
    stream: rr.RecordingStream,
    number: int,
    low: tuple[float, float],
    high: tuple[float, float],
    color: Color,
) -> None:
    """Draw a filled rectangle: an image of one colour, since boxes are but outlines."""
    entity = join_path(entities.STEPS, f"bar_{number}")
    width, height = max(high[0] - low[0], 0.15), high[1] - low[1]
    frame = rr.Transform3D(
        translation=[*low, 0.0], mat3x3=np.diag([width / 2.0, height / 2.0, 1.0])
    )
    stream.log(entity, frame, static=True)
    image = rr.Image(np.full((2, 2, 3), color, dtype=np.uint8))
    stream.log(entity, image, static=True)


def write_words(
    stream: rr.RecordingStream, entity: str, words: Sequence[tuple[float, float, str, Color]]
) -> None:
    """Write words around their middles."""
    points = rr.Points2D(
        [(x, y - _ABOVE) for x, y, _, _ in words],
        radii=rr.Radius.ui_points(0.0),
        colors=[color for *_, color in words],
        labels=[text for _, _, text, _ in words],
        show_labels=True,
    )
    stream.log(join_path(entity, "words"), points, static=True)
