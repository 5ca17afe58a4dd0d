"""Legends of the plots of a run alone: a line for each colour, two at most.

The viewer joins curves of one name to one line of a legend, in the colour of the lowest curve.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from turtlelog.charts import palette
from turtlelog.charts.curves import Level
from turtlelog.charts.palette import Color
from turtlelog.draw.rerun.marks import Mark, name_marks
from turtlelog.draw.rerun.plots import LevelLines, Series


@dataclass(frozen=True, slots=True, kw_only=True)
class Legends:
    """All that is drawn in plots, under the names of their legends.

    Attributes:
        series: Curves.
        references: Level lines.
        marks: Metrics on curves.
        names: The name of the main curve of each plot, which upright lines share.
        shown: Plots whose legend tells more than their title.
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

    What has one colour shares a name. Limits and marks have that of the main curve. Zero needs no
    line beside that of the axis.
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
    """Return what stands in one plot under the names of its legend."""
    main = next((one for one in curves if one.is_main), curves[0])
    # Marks tell enough of a curve that has the name of its plot.
    is_named = not marks or main.entity != main.plot
    words: dict[Color, list[str]] = {main.colors[0]: [main.labels[0]] if is_named else []}
    for one in curves:
        for color, label in zip(one.colors, one.labels, strict=True):
            said = f"lighter: {label}" if color == palette.tint(main.colors[0]) else label
            if one is main and label == main.labels[0]:
                continue
            words.setdefault(_join_tint(color, main), []).append(_describe(one, said))
    words[main.colors[0]] += ["  ".join(name_marks(marks))] if marks else []
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


def _part_levels(
    plot: str, levels: Sequence[Level], names: Mapping[Color, str], main: Series
) -> Iterator[LevelLines]:
    """Yield what is aimed at in grey, and limits in the colour of the curve that they bound."""
    grey = tuple(level for level in levels if level.kind in ("target", "tolerance"))
    limits = tuple(level for level in levels if level.kind == "limit")
    for kept, color in ((grey, palette.IDEAL), (limits, main.colors[0])):
        if kept:
            yield LevelLines(plot=plot, levels=kept, name=names[color], color=color)


def _join_tint(color: Color, main: Series) -> Color:
    return main.colors[0] if color == palette.tint(main.colors[0]) else color


def _describe(curves: Series, label: str) -> str:
    """Return what a curve is called; points say how they look."""
    if curves.marker is None:
        return label
    return f"{'dots' if curves.marker == 'circle' else 'crosses'}: {label}"
