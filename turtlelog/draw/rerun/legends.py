"""Legends in the colours of runs: names, or for many runs a colour bar of a gain."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from turtlelog.charts import palette
from turtlelog.charts.characteristics import SIGNS
from turtlelog.charts.curves import Level, Values
from turtlelog.charts.many_runs import GainScale
from turtlelog.charts.palette import Color
from turtlelog.draw.rerun import entities
from turtlelog.draw.rerun.content import view_picture
from turtlelog.draw.rerun.entities import join_path
from turtlelog.draw.rerun.marks import Mark, name_marks
from turtlelog.draw.rerun.plots import LevelLines, Series
from turtlelog.draw.rerun.world import draw_points, write_words

_SCALE_WIDTH: Final = 12.0
"""Width of the colour bar of many runs, in multiples of its height."""

_SCALE_DEPTH: Final = 2.5

_LEGEND_WIDTH: Final = 12.0  # in multiples of a row's height

_LEGEND_LETTERS: Final = 48
"""Number of letters of all columns together; with dots and gaps they take 400 of 430 pixels."""

_MOST_COLUMNS: Final = 4
"""Largest number of columns of names; more columns of short names would look like lines of text."""

_MOST_NAMES: Final = 28
"""Largest number of names, in four columns and seven lines of a window of 1200 x 860."""

_LEGEND_RADIUS: Final = 5.0  # [points]

_SCALE_HEIGHT: Final = 1.0

_SCALE_LINES: Final = 8
"""Number of lines side by side that fill a cell, because the viewer rounds the ends of a thick
line."""

_LINE_LETTERS: Final = 46
"""Number of letters in a legend's line: in any window, the viewer breaks lines of more than 275
pixels."""

_SCALE_LABELS: Final = 12
"""Largest number of values in a view 500 pixels wide: 40 pixels each."""


def view_legend(names: Sequence[str]) -> rrb.View:
    """Return a view with the names of many runs, each in the colour of its run."""
    shown = [names[number] for number in choose_names(len(names))]
    last_row = float(arrange_names(shown)[-1, 1])
    title = "Runs" if len(shown) == len(names) else f"{len(shown)} of {len(names)} runs"
    ranges = (0.0, _LEGEND_WIDTH), (-0.5, last_row + 1.0)
    return view_picture(title, [join_path(entities.LEGEND)], *ranges)


def view_scale(title: str) -> rrb.View:
    """Return a view of the colour bar of many runs."""
    contents = [f"{join_path(entities.LEGEND)}/**"]
    return view_picture(title, contents, (-0.3, _SCALE_WIDTH + 0.3), (-0.5, _SCALE_DEPTH))


def draw_legend(stream: rr.RecordingStream, names: Sequence[str], colors: Sequence[Color]) -> None:
    """Draw the names of runs in their colours."""
    chosen = choose_names(len(names))
    shown, hues = [names[number] for number in chosen], [colors[number] for number in chosen]
    looks: dict[str, Any] = {"labels": shown, "show_labels": True}
    draw_points(stream, entities.LEGEND, arrange_names(shown), hues, _LEGEND_RADIUS, **looks)


def draw_scale(stream: rr.RecordingStream, scale: GainScale, colors: Sequence[Color]) -> None:
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
    write_words(stream, f"{entities.LEGEND}/values", places, [value for _, value in ticks], hues)


def title_scale(scale: GainScale) -> str:
    """Return the title of the colour bar."""
    return f"{len(scale.values)} runs, coloured by {scale.word}: {tell_span(scale)}"


def tell_span(scale: GainScale) -> str:
    """Return the least and the greatest value of the bar."""
    return f"{min(scale.values):g} to {max(scale.values):g}"


def choose_names(count: int) -> tuple[int, ...]:
    """Return the indices of the named runs among many, as room allows, including the last run.

    Colours of many runs follow their order, so neighbouring names identify unnamed runs.
    """
    if count <= _MOST_NAMES:
        return tuple(range(count))
    return tuple(np.unique(np.linspace(0, count - 1, _MOST_NAMES).round().astype(int)).tolist())


def arrange_names(names: Sequence[str]) -> Values:
    """Return places in a grid, y downward, shape (n, 2). The longest name sets the column width."""
    longest = max(len(name) for name in names)
    columns = max(1, min(_MOST_COLUMNS, _LEGEND_LETTERS // longest))
    number = np.arange(len(names))
    across = (number % columns + 0.5) * (_LEGEND_WIDTH / columns)
    return np.column_stack([across, number // columns])


@dataclass(frozen=True, slots=True, kw_only=True)
class Legends:
    """All curves, lines and marks of plots, with their names in legends.

    Attributes:
        series: Curves.
        references: Level lines.
        marks: Metrics on curves.
        names: Name of the main curve of each plot, which vertical lines share.
        shown: Plots whose legend contains more than their title.
    """

    series: tuple[Series, ...]
    references: tuple[LevelLines, ...]
    marks: tuple[Mark, ...]
    names: Mapping[str, str]
    shown: frozenset[str]


def name_legends(
    series: Sequence[Series], references: Sequence[LevelLines], marks: Sequence[Mark] = ()
) -> Legends:
    """Return curves, level lines and marks under names that make a short legend of each plot.

    Items with one colour share a name. Limits and marks have the name of the main curve. Zero has
    no line, because the axis shows it.
    """
    lines = {line.plot: line for line in references}
    found = [
        _name_plot(
            [one for one in series if one.plot == plot],
            lines.get(plot),
            [mark for mark in marks if mark.plot == plot],
        )
        for plot in dict.fromkeys(curves.plot for curves in series)
    ]
    return Legends(
        series=tuple(one for named in found for one in named.series),
        references=tuple(line for named in found for line in named.references),
        marks=tuple(mark for named in found for mark in named.marks),
        names={plot: name for named in found for plot, name in named.names.items()},
        shown=frozenset(plot for named in found for plot in named.shown),
    )


def _name_plot(
    curves: Sequence[Series], lines: LevelLines | None, marks: Sequence[Mark]
) -> Legends:
    """Return the items of one plot with their names in its legend."""
    main = next((one for one in curves if one.is_main), curves[0])
    # Marks are sufficient for a curve with the name of its plot.
    is_named = not marks or main.entity != main.plot
    words: dict[Color, list[str]] = {main.colors[0]: [main.labels[0]] if is_named else []}
    for one in curves:
        for color, label in zip(one.colors, one.labels, strict=True):
            said = f"lighter: {label}" if color == palette.tint(main.colors[0]) else label
            if one is main and label == main.labels[0]:
                continue
            words.setdefault(_join_tint(color, main), []).append(_describe(one, said))
    marks = _choose_marks(marks, _LINE_LETTERS - len(", ".join([*words[main.colors[0]], ""])))
    words[main.colors[0]] += [_join_marks(marks)] if marks else []
    levels = () if lines is None else lines.levels
    for level in levels:
        if level.kind in ("target", "tolerance"):
            words.setdefault(palette.IDEAL, []).insert(0, f"{level.label} {level.value:.4g}")
        elif level.kind == "limit" and level.value > 0.0:
            words[main.colors[0]].append(f"limit {level.value:.4g}")
    names = {color: ", ".join(dict.fromkeys(said)) for color, said in words.items()}
    name, plot = names[main.colors[0]], main.plot
    is_told = len(names) > 1 or name != main.labels[0]
    return Legends(
        series=tuple(
            replace(one, labels=tuple(names[_join_tint(color, main)] for color in one.colors))
            for one in curves
        ),
        references=tuple(_part_levels(plot, levels, names, main)),
        marks=tuple(replace(mark, label=name) for mark in marks),
        names={plot: name},
        shown=frozenset([plot] if is_told else []),
    )


def _choose_marks(marks: Sequence[Mark], letters: int) -> Sequence[Mark]:
    """Return the marks whose names fit a line, after less interesting marks are left out."""
    for least in [mark for mark in marks if mark.is_minor]:
        if len(_join_marks(marks)) > letters:
            marks = [mark for mark in marks if mark is not least]
    return marks


def _join_marks(marks: Sequence[Mark]) -> str:
    return " ".join(name_marks(marks))


def _part_levels(
    plot: str, levels: Sequence[Level], names: Mapping[Color, str], main: Series
) -> Iterator[LevelLines]:
    """Yield references in grey, and limits in the colour of the curve that they limit."""
    grey = tuple(level for level in levels if level.kind in ("target", "tolerance"))
    limits = tuple(level for level in levels if level.kind == "limit")
    for kept, color in ((grey, palette.IDEAL), (limits, main.colors[0])):
        if kept:
            yield LevelLines(plot=plot, levels=kept, name=names[color], color=color)


def _join_tint(color: Color, main: Series) -> Color:
    return main.colors[0] if color == palette.tint(main.colors[0]) else color


def _describe(curves: Series, label: str) -> str:
    """Return the name of a curve; for points, the name describes their look."""
    if curves.marker is None:
        return label
    return f"{SIGNS['disc' if curves.marker == 'circle' else 'cross']} {label}"
