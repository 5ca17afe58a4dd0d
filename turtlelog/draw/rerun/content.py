"""The content of a recording for its layout, and short legends of its plots."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from turtlelog.charts import palette, plotted_curves, time_plots
from turtlelog.charts.close_up import CloseUp, WorstPlace, find_close_up, find_worst_place
from turtlelog.charts.curve_marks import SIGNS
from turtlelog.charts.curves import Level, Values, find_end_of_turn
from turtlelog.charts.many_runs import MANY
from turtlelog.charts.plane_scene import tell_gap
from turtlelog.display import describe_count
from turtlelog.draw.rerun import entities
from turtlelog.draw.rerun.entities import join_path
from turtlelog.draw.rerun.plane import Bounds, find_plane_bounds
from turtlelog.draw.rerun.plots import LevelLines, Mark, Series
from turtlelog.measure import find_signal
from turtlelog.run import Run
from turtlelog.run.loops import PAUSE

_CLOSE_UP = 2.0
"""Half-height of the close-up, as a multiple of its largest error, which then fills half of it."""

_SMALLEST_CLOSE_UP_DEG = 0.1
"""Smallest half-height of the close-up [deg]; even errors of 0 need a range."""

_LEGEND_WIDTH, _LEGEND_HEIGHT = 0.5, 0.4
"""Shares of a plot of 235 pixels, of three in a window of 1600 x 900, that four lines take."""

_MOST_IN_PLOT = 4
"""Largest number of names in a legend inside a plot; for more names there is a separate view."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Content:
    """The content of a recording for its layout. An empty text or None: there is no such thing."""

    prefixes: tuple[str, ...]  # entity prefix of each run; of a single run empty
    ghosts: tuple[str, ...] = ()  # entity prefixes of ghosts in the plane
    timelines: tuple[str, ...] = ()  # on each of them, a trail grows to the cursor
    is_small: bool = False  # whether the window is too small for legends, phases and documents

    plane: Bounds  # bounds of the plane
    goal: CloseUp | None  # close-up of the goal
    worst: WorstPlace | None = None  # largest deviations of runs from their path, if shown
    highest_speed_m_s: float | None = None  # of the brightest colour of the trace by speed
    arrows: str = ""  # text on the arrows in the plane
    origin: str = ""  # text on the origin of shifted coordinates
    equal: str = ""  # text on runs with equal rows, drawn as one curve
    starts: str = ""  # text on other ends in the close-up of the goal, for its title

    series: tuple[str, ...]  # entity paths of the curves, in the order of drawing
    references: frozenset[str]  # plots that have level lines
    lines: tuple[str, ...] = ()  # entity paths of vertical lines, shown in every plot
    ranges: Mapping[str, tuple[float, float]]  # fixed ranges of values, by plot
    close_ups: frozenset[str] = frozenset()  # plots whose range does not contain all their curves
    controlled: frozenset[str] = frozenset()  # plots of signals that a loop of a run controls
    notes: Mapping[str, str] = field(default_factory=dict)  # text beside the title, by plot
    restless: str = ""  # runs that never come to rest, whose commands are not shown
    end_s: float | None = None  # end of the plots [s]; None: the plots show everything
    length_s: float = 0.0  # duration of the longest run [s], if the plots end earlier

    states: tuple[plotted_curves.StateGroup, ...] = ()  # states of the laws, in groups
    overlaid: frozenset[plotted_curves.StateGroup] = frozenset()  # whose states share a plot
    idle: frozenset[str] = frozenset()  # plots of states that are always 0, which need no view

    legends: frozenset[str] | None = None  # plots with a legend; None: those of several curves
    corners: Mapping[str, str] = field(default_factory=dict)  # Rerun's name, by plot with room
    legend_names: tuple[str, ...]  # names of the runs if they need a separate view
    scale_title: str | None = None  # title of the colour bar of many runs
    scale_span: str = ""  # text on the range of the bar, for views without room for it

    with_phases: int  # number of runs with samples
    has_several_phases: bool = True  # whether a run goes from one phase to another
    phase_rows: tuple[str, ...] = ()  # prefixes of runs whose phases are shown; empty: all runs
    has_pause: bool = False  # whether a run has a pause
    has_dead_time: bool = False  # whether the first run's dead times are drawn
    has_events: bool  # whether a run has events
    documents: tuple[str, ...]  # titles of the documents
    steps_title: str | None = None  # title of the attribution
    luck_title: str | None = None  # title of the picture of values from other starts

    def find_largest_shown(self) -> float:
        """Return the largest magnitude that any plot shows."""
        return max((abs(bound) for bounds in self.ranges.values() for bound in bounds), default=1.0)

    def list_states(self, group: plotted_curves.StateGroup) -> list[str]:
        """Return the plots of the shown states of a group."""
        plots = [f"{entities.STATE}/{name}" for name in group.names]
        return [plot for plot in plots if self.list_curves(plot) and plot not in self.idle]

    def list_curves(self, plot: str) -> list[str]:
        """Return the entity paths of a plot's curves: the plot's own name, and names below it."""
        names = [join_path(prefix, plot) for prefix in self.prefixes]
        return [
            path
            for name in names
            for path in self.series
            if path == name or path.startswith(f"{name}/")
        ]


def describe_content(
    runs: Sequence[Run],
    prefixes: Sequence[str],
    series: Sequence[Sequence[Series]],
    references: Sequence[LevelLines],
    documents: Iterable[str],
    *,
    names: Sequence[str] = (),
) -> Content:
    """Return the content of a recording of runs; `series` are the curves of each run."""
    close_ups, goal = find_heading_close_up(runs), find_close_up(runs)
    states = plotted_curves.group_states(*(run.declaration for run in runs))
    phases = dict.fromkeys(name for run in runs for name in run.declaration.phases)
    # Of many runs, a few phases are shown, of the first and the last run among them.
    rows = np.linspace(0, len(prefixes) - 1, _MOST_PHASE_ROWS).round().astype(int)
    of_states = [one for run in series for one in run if one.plot.startswith(f"{entities.STATE}/")]
    return Content(
        prefixes=tuple(prefixes),
        series=tuple(
            join_path(prefix, curves.entity)
            for prefix, listed in zip(prefixes, series, strict=True)
            for curves in listed
        ),
        references=frozenset(reference.plot for reference in references),
        legend_names=tuple(names) if len(names) > _MOST_IN_PLOT else (),
        with_phases=sum(len(run.samples) > 0 for run in runs),
        phase_rows=tuple(prefixes[row] for row in rows) if len(prefixes) > MANY else (),
        has_pause=any(span.phase == PAUSE for run in runs for span in run.find_phase_spans()),
        has_several_phases=any(len(run.find_phase_spans()) > 1 for run in runs),
        has_events=any(run.events for run in runs),
        documents=tuple(documents),
        plane=find_plane_bounds(runs),
        goal=goal,
        worst=find_worst_place(runs) if goal is None else None,
        states=states,
        idle=frozenset(one.plot for one in of_states)
        - {one.plot for one in of_states if one.values.any()},
        overlaid=frozenset(group for group in states if _are_overlaid(group, series)),
        ranges={**find_ranges(series, references), **close_ups},
        close_ups=frozenset(close_ups),
        timelines=(
            time_plots.TIMELINE,
            entities.TICKS,
            time_plots.WALL_TIMELINE,
            *map(time_plots.name_phase_timeline, phases),
        ),
        notes=_list_notes(runs, series),
        controlled=frozenset(
            entities.name_plot(plot) for run in runs for plot in time_plots.list_controlled(run)
        ),
    )


def _list_notes(runs: Sequence[Run], series: Sequence[Sequence[Series]]) -> dict[str, str]:
    """Return by plot the longest gap of a single run, and the number of outliers out of range."""
    words, outliers = tell_gap(runs), Counter[str]()
    curves = [one for one in series[0] if one.is_main and words]
    notes = {one.plot: words for one in curves if np.isnan(one.values).any()}
    for one in (one for run in series for one in run):
        if one.entity.endswith(f"/{entities.OUTLIERS}"):
            outliers[one.plot] += len(one.time_ns)
    for plot, rows in outliers.items():
        notes[plot] = f"{describe_count(rows, 'outlier')} left out"
    return notes


def find_corners(
    series: Sequence[Series], ranges: Mapping[str, tuple[float, float]]
) -> dict[str, str]:
    """Return Rerun's name of the emptiest corner of each plot."""
    first_ns = min((int(curves.time_ns[0]) for curves in series), default=0)
    last_ns = max((int(curves.time_ns[-1]) for curves in series), default=1)
    rows: dict[str, list[Values]] = {}
    for curves in (one for one in series if one.plot in ranges):
        low, high = ranges[curves.plot]
        across = (curves.time_ns - first_ns) / max(last_ns - first_ns, 1)
        for column in curves.values.T:
            places = np.column_stack([across, (column - low) / (high - low)])
            rows.setdefault(curves.plot, []).append(places[np.isfinite(column)])
    return {plot: _find_emptiest(np.concatenate(places)) for plot, places in rows.items()}


def _find_emptiest(places: Values) -> str:
    """Return the corner with the fewest points, from (0, 0) at the lower left to (1, 1)."""
    is_right, is_left = places[:, 0] > 1.0 - _LEGEND_WIDTH, places[:, 0] < _LEGEND_WIDTH
    is_high = (places[:, 1] > 1.0 - _LEGEND_HEIGHT) & (places[:, 1] <= 1.0)
    is_low = (places[:, 1] < _LEGEND_HEIGHT) & (places[:, 1] >= 0.0)
    counts = {
        f"{side}{end}": int((across & up).sum())
        for side, across in (("Right", is_right), ("Left", is_left))
        for end, up in (("Top", is_high), ("Bottom", is_low))
    }
    return min(counts, key=lambda corner: counts[corner])


def _are_overlaid(group: plotted_curves.StateGroup, series: Sequence[Sequence[Series]]) -> bool:
    """Return whether the states of a group share a plot: for one run, if no state looks like 0."""
    plots = {f"{entities.STATE}/{name}": name for name in group.names}
    found = [curves for run in series for curves in run if curves.plot in plots]
    names, columns = [plots[one.plot] for one in found], [one.values[:, 0] for one in found]
    return len(series) == 1 and len(group.names) > 1 and group.can_share(names, columns)


def find_ranges(
    series: Sequence[Sequence[Series]], references: Sequence[LevelLines]
) -> dict[str, tuple[float, float]]:
    """Return ranges of plots that contain all measured values, with a margin."""
    levels = {reference.plot: reference.levels for reference in references}
    measured: dict[str, list[Values]] = {}
    for curves in (curves for run in series for curves in run if curves.is_measured):
        measured.setdefault(curves.plot, []).append(curves.values)
    found = {
        plot: plotted_curves.find_plot_range(values, levels.get(plot, ()))
        for plot, values in measured.items()
    }
    return {plot: limits for plot, limits in found.items() if limits is not None}


def find_heading_close_up(runs: Sequence[Run]) -> dict[str, tuple[float, float]]:
    """Return the range of heading errors after turning, which the turn itself would hide.

    The result is empty if a heading loop acts in every phase, or never.
    """
    largest_deg = 0.0
    for run in runs:
        errors = find_signal(run, "heading_error")
        if errors is None:
            continue
        end_ns = find_end_of_turn(run)
        if end_ns is None:
            return {}
        after = np.abs(errors.values[errors.time_ns >= end_ns])
        largest_deg = max(largest_deg, float(np.degrees(after.max(initial=0.0))))
    half_deg = max(_CLOSE_UP * largest_deg, _SMALLEST_CLOSE_UP_DEG)
    return {entities.HEADING_ERROR: (-half_deg, half_deg)}


_MOST_PHASE_ROWS: Final = 4  # phase rows for more than seven runs; plots keep the larger part


_LINE_LETTERS: Final = 46
"""Letters in a legend's line, because the viewer breaks lines of more than 275 pixels."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Legends:
    """All curves, lines and marks of plots, with their names in legends."""

    series: tuple[Series, ...]  # curves
    references: tuple[LevelLines, ...]  # level lines
    marks: tuple[Mark, ...]  # metrics on curves
    names: Mapping[str, str]  # name of the main curve of each plot, which vertical lines share
    shown: frozenset[str]  # plots whose legend contains more than their title


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
    main = next((one for one in curves if one.is_main), curves[0])
    # Marks are sufficient for a curve with the name of its plot.
    is_named = not marks or main.entity != main.plot
    words: dict[palette.Color, list[str]] = {main.colors[0]: [main.labels[0]] if is_named else []}
    for one in curves:
        for color, label in zip(one.colors, one.labels, strict=True):
            said = f"lighter: {label}" if color == palette.tint(main.colors[0]) else label
            if one is main and label == main.labels[0]:
                continue
            words.setdefault(_join_tint(color, main), []).append(_describe(one, said))
    marks = _choose_marks(marks, _LINE_LETTERS - len(", ".join([*words[main.colors[0]], ""])))
    words[main.colors[0]] += [" ".join(_name_marks(marks))] if marks else []
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


def _name_marks(marks: Sequence[Mark]) -> list[str]:
    """Return the legend text of marks, in order of time."""
    placed = sorted(marks, key=lambda found: found.time_ns)
    return [f"{mark.sign} {mark.label}" for mark in placed]


def _choose_marks(marks: Sequence[Mark], letters: int) -> Sequence[Mark]:
    """Return the marks whose names fit a line, after less interesting marks are left out."""
    for least in [mark for mark in marks if mark.is_minor]:
        if len(" ".join(_name_marks(marks))) > letters:
            marks = [mark for mark in marks if mark is not least]
    return marks


def _part_levels(
    plot: str, levels: Sequence[Level], names: Mapping[palette.Color, str], main: Series
) -> Iterator[LevelLines]:
    """Yield references in grey, and limits in the colour of the curve that they limit."""
    grey = tuple(level for level in levels if level.kind in ("target", "tolerance"))
    limits = tuple(level for level in levels if level.kind == "limit")
    for kept, color in ((grey, palette.IDEAL), (limits, main.colors[0])):
        if kept:
            yield LevelLines(plot=plot, levels=kept, name=names[color], color=color)


def _join_tint(color: palette.Color, main: Series) -> palette.Color:
    return main.colors[0] if color == palette.tint(main.colors[0]) else color


def _describe(curves: Series, label: str) -> str:
    """Return the name of a curve; for points, the name describes their look."""
    if curves.marker is None:
        return label
    return f"{SIGNS['disc' if curves.marker == 'circle' else 'cross']} {label}"
