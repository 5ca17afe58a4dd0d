"""The content of a recording, and the views that show it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import rerun.blueprint as rrb
from rerun.blueprint.archetypes import VisibleTimeRanges

from turtlelog.charts import palette, plotted_curves
from turtlelog.charts.close_up import (
    CloseUp,
    WorstPlace,
    find_close_up,
    find_worst_place,
    format_length,
)
from turtlelog.charts.curves import Values, find_end_of_turn
from turtlelog.charts.many_runs import MANY, MANY_PATHS
from turtlelog.charts.plane_scene import tell_gap
from turtlelog.charts.time_plots import list_controlled
from turtlelog.display import describe_count
from turtlelog.draw.rerun import entities
from turtlelog.draw.rerun.entities import (
    TICKS,
    join_path,
    locate_dead_times,
    locate_phases,
    name_document,
)
from turtlelog.draw.rerun.plots import LevelLines, Series
from turtlelog.draw.rerun.world import Bounds, find_plane_bounds
from turtlelog.measure import find_signal
from turtlelog.run import Run
from turtlelog.run.loops import PAUSE

_CLOSE_UP = 2.0
"""Half-height of the close-up, as a multiple of its largest error, which then fills half of it."""

_SMALLEST_CLOSE_UP_DEG = 0.1
"""Smallest half-height of the close-up [deg]; even errors of 0 need a range."""

_LEGEND_WIDTH, _LEGEND_HEIGHT = 0.5, 0.4
"""Width and height of a legend of four lines as shares of a plot. The window has 1600 x 900 pixels,
with three plots of 235 pixels one above another."""

_MOST_IN_PLOT = 4
"""Largest number of names in a legend inside a plot; for more names there is a separate view."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Content:
    """The content of a recording for its layout.

    Attributes:
        prefixes: Entity prefix of each run. If there is only one run, its prefix is empty.
        series: Entity paths of the curves, in the order of drawing.
        references: Plots that have level lines.
        lines: Entity paths of vertical lines, shown in every plot.
        legends: Plots with a legend. None: the plots with several curves.
        highest_speed_m_s: Speed of the brightest colour of the trace by speed; None: no trace.
        steps_title: Title of the attribution; None without an attribution.
        luck_title: Title of the picture of values from other starts; None without this picture.
        starts: Text on other ends in the close-up of the goal, for the title of the close-up.
        has_pause: Whether a run has a pause.
        has_dead_time: Whether the first run's dead times are drawn.
        legend_names: Names of the runs if they need a separate view, otherwise empty.
        with_phases: Number of runs with samples.
        has_several_phases: Whether a run goes from one phase to another.
        has_events: Whether a run has events.
        documents: Titles of the documents.
        plane: Bounds of the plane.
        goal: Close-up of the goal; None without a close-up.
        ranges: Fixed ranges of values, by plot.
        close_ups: Plots whose range does not contain all of their curves.
        controlled: Plots of signals that a loop of a run controls.
        worst: Largest deviations of runs from their path; None if they are not shown.
        states: States of the laws, in groups.
        overlaid: Groups whose states share a plot.
        idle: Plots of states that are always 0 in every run, which need no view.
        notes: Text next to the title of a plot, on gaps and on outliers beyond the range.
        phase_rows: Prefixes of the runs whose phases are shown. Empty: all runs.
        timelines: Names of all timelines. On each timeline, a trail grows to the cursor.
        ghosts: Entity prefixes of ghosts in the plane.
        arrows: Text on the arrows in the plane; empty without arrows.
        origin: Text on the origin of shifted coordinates; empty if they are not shifted.
        equal: Text on runs with equal rows, drawn as one curve; empty without them.
        is_small: Whether the window is too small for legends, phases and documents.
        scale_title: Title of the colour bar of many runs; None without a bar.
        scale_span: Text on the range of the bar, for views without room for it.
        end_s: End of the plots [s]. None: the plots show everything.
        length_s: Duration of the longest run [s], if the plots end earlier.
        restless: Note that names the runs that never come to rest; their commands are not shown.
        corners: Rerun's name of the corner for the legend, by plot, if curves leave room.
    """

    prefixes: tuple[str, ...]
    series: tuple[str, ...]
    references: frozenset[str]
    lines: tuple[str, ...] = ()
    legends: frozenset[str] | None = None
    highest_speed_m_s: float | None = None
    steps_title: str | None = None
    luck_title: str | None = None
    starts: str = ""
    has_pause: bool = False
    has_dead_time: bool = False
    legend_names: tuple[str, ...]
    with_phases: int
    has_several_phases: bool = True
    has_events: bool
    documents: tuple[str, ...]
    plane: Bounds
    goal: CloseUp | None
    ranges: Mapping[str, tuple[float, float]]
    close_ups: frozenset[str] = frozenset()
    controlled: frozenset[str] = frozenset()
    worst: WorstPlace | None = None
    states: tuple[plotted_curves.StateGroup, ...] = ()
    overlaid: frozenset[plotted_curves.StateGroup] = frozenset()
    idle: frozenset[str] = frozenset()
    notes: Mapping[str, str] = field(default_factory=dict)
    corners: Mapping[str, str] = field(default_factory=dict)
    arrows: str = ""
    origin: str = ""
    equal: str = ""
    is_small: bool = False
    phase_rows: tuple[str, ...] = ()
    timelines: tuple[str, ...] = ()
    ghosts: tuple[str, ...] = ()
    scale_title: str | None = None
    scale_span: str = ""
    end_s: float | None = None
    length_s: float = 0.0
    restless: str = ""

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
        has_pause=any(span.phase == PAUSE for run in runs for span in run.find_phase_spans()),
        has_several_phases=any(len(run.find_phase_spans()) > 1 for run in runs),
        has_events=any(run.events for run in runs),
        documents=tuple(documents),
        plane=find_plane_bounds(runs),
        goal=goal,
        worst=find_worst_place(runs) if goal is None else None,
        states=states,
        idle=_find_idle(series),
        overlaid=frozenset(group for group in states if _are_overlaid(group, series)),
        ranges={**find_ranges(series, references), **close_ups},
        close_ups=frozenset(close_ups),
        timelines=(
            plotted_curves.TIMELINE,
            TICKS,
            plotted_curves.WALL_TIMELINE,
            *map(plotted_curves.name_phase_timeline, phases),
        ),
        notes={**_note_gaps(runs, series), **_count_outliers(series)},
        controlled=frozenset(
            entities.name_plot(plot) for run in runs for plot in list_controlled(run)
        ),
    )


def _note_gaps(runs: Sequence[Run], series: Sequence[Sequence[Series]]) -> dict[str, str]:
    """Return the longest gap of a single run for each plot whose curve breaks there."""
    words = tell_gap(runs)
    curves = [one for one in series[0] if one.is_main and words]
    return {one.plot: words for one in curves if np.isnan(one.values).any()}


def _count_outliers(series: Sequence[Sequence[Series]]) -> dict[str, str]:
    """Return text on the number of outliers beyond the range, by plot."""
    found: dict[str, int] = {}
    for curves in (curves for run in series for curves in run):
        if curves.entity.endswith(f"/{entities.OUTLIERS}"):
            found[curves.plot] = found.get(curves.plot, 0) + len(curves.time_ns)
    return {plot: f"{describe_count(rows, 'outlier')} left out" for plot, rows in found.items()}


def find_largest_shown(content: Content) -> float:
    """Return the largest magnitude that any plot shows."""
    return max((abs(bound) for bounds in content.ranges.values() for bound in bounds), default=1.0)


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


def _find_idle(series: Sequence[Sequence[Series]]) -> frozenset[str]:
    states = [
        curves for run in series for curves in run if curves.plot.startswith(f"{entities.STATE}/")
    ]
    acting = {curves.plot for curves in states if curves.values.any()}
    return frozenset(curves.plot for curves in states) - acting


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
        plot: plotted_curves.find_range(values, levels.get(plot, ()))
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


_MOST_PHASE_ROWS: Final = 4
"""Largest number of phase rows for more than seven runs; plots keep the larger part."""


_ARROWS: Final = (
    *(entities.ARROW, entities.BODY, entities.COMMAND, entities.ERROR),
    entities.REFERENCE_POSE,
)


def view_plane(content: Content, *, with_arrows: bool = True) -> rrb.View:
    """Return the view of the plane, with arrows if the title has room for their names."""
    told = content.equal or content.origin or content.arrows
    if content.is_small:  # a title has room for 20 letters
        told = "equal runs" if content.equal else content.scale_span
    hidden = [entities.SPEED_PATH]
    if content.arrows and (content.is_small or not with_arrows):
        hidden, told = [*hidden, entities.ERROR, entities.COMMAND], ""
    contents = [*_list_planes(content), *_hide(hidden, content)]
    title = f"Plane ({told})" if told else "Plane"
    return _view_bounds(title, contents, content.plane, overrides=_show_trails(content))


def view_speed(content: Content, highest_m_s: float) -> rrb.View:
    """Return the view of the plane with paths coloured by speed."""
    hidden = _hide([entities.PATH, entities.TRAIL, entities.ERROR, entities.NAMES], content)
    title = f"By speed, 0 to {highest_m_s:.3g} m/s"
    return _view_bounds(title, [*_list_planes(content), *hidden], content.plane)


def view_goal(content: Content, close_up: CloseUp) -> rrb.View:
    """Return the close-up of the goal, without arrows and names, which would cover it."""
    bounds = Bounds(center_xy_m=close_up.goal_xy_m, half_size_m=close_up.half_m)
    outlines = ", outlines: 90 % of ends" if len(content.prefixes) > MANY_PATHS else ""
    name = f"At the goal, {close_up.describe()}{content.starts}{outlines}"
    return _view_close_up(content, name, bounds)


def view_worst(content: Content, worst: WorstPlace) -> rrb.View:
    """Return the view of the largest deviation from the tracked path."""
    bounds = Bounds(center_xy_m=worst.center_xy_m, half_size_m=worst.half_m)
    return _view_close_up(content, f"Furthest off the path, ±{format_length(worst.half_m)}", bounds)


def _view_close_up(content: Content, name: str, bounds: Bounds) -> rrb.View:
    hidden = [entities.NAMES, entities.SPEED_PATH, entities.GAP]
    prefixes = (*content.prefixes, *content.ghosts)
    hidden += [join_path(prefix, arrow) for prefix in prefixes for arrow in _ARROWS]
    contents = [*_list_planes(content), *(f"- {join_path(path)}/**" for path in hidden)]
    return _view_bounds(name, contents, bounds, overrides=_show_trails(content))


def _view_bounds(name: str, contents: Sequence[str], bounds: Bounds, **more: Any) -> rrb.View:
    """Return a view of a square of the plane. The view's own coordinates have y downward."""
    (x_m, y_m), half_m = bounds.center_xy_m, bounds.half_size_m
    ranges = (x_m - half_m, x_m + half_m), (-y_m - half_m, -y_m + half_m)
    return view_picture(name, contents, *ranges, **more)


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


def view_plot(content: Content, plot: str, legend: rrb.Corner2D | None, name: str = "") -> rrb.View:
    """Return the view of curves over time, with a needed legend if a corner is free."""
    contents = content.list_curves(plot)
    has_names = len(contents) > 1 if content.legends is None else plot in content.legends
    if plot in content.references:
        contents.insert(0, f"{join_path(entities.REFERENCE, plot)}/**")
    contents += content.lines
    title, limits = name or entities.title_plot(plot), content.ranges.get(plot)
    if plot in content.notes:
        title += f", {content.notes[plot]}"
    if content.restless and plot in entities.RESTLESS:
        title += f", without {content.restless}"
    title = title.replace(" [", ", close up [") if plot in content.close_ups else title
    shown = rrb.PlotLegend(legend, visible=legend is not None and has_names)
    return view_curves(title, contents, limits, shown)


def view_curves(
    name: str,
    contents: Sequence[str],
    limits: tuple[float, float] | None,
    legend: rrb.PlotLegend,
) -> rrb.View:
    """Return a view of curves on the common time axis, with limits of the values if known."""
    return rrb.TimeSeriesView(
        origin="/",
        contents=contents,
        name=name,
        axis_x=rrb.TimeAxis(link="LinkToGlobal"),
        axis_y=None if limits is None else rrb.ScalarAxis(range=limits),
        plot_legend=legend,
    )


def view_phases(content: Content) -> rrb.View:
    """Return the view of the phases, one row per run. A pause is too short for its name."""
    shown = content.phase_rows or content.prefixes
    contents = [locate_phases(prefix) for prefix in shown]
    of = f" of {len(shown)} of {len(content.prefixes)} runs" if len(content.prefixes) > MANY else ""
    colors = ["brown: pause"] if content.has_pause else []
    colors += ["pink: dead time"] if content.has_dead_time else []
    key = f" ({', '.join(colors)})" if colors else ""
    until = "" if content.end_s is None else f", {content.end_s:.0f} of {content.length_s:.0f} s"
    if content.has_dead_time:
        contents.insert(1, locate_dead_times(shown[0]))
    return rrb.StateTimelineView(
        origin="/",
        contents=contents,
        name=f"Phases{of}{until}{key}",
        time_view=rrb.TimeAxis(link="LinkToGlobal"),
    )


def choose_phase_rows(prefixes: Sequence[str]) -> tuple[str, ...]:
    """Return the runs whose phases are shown: all, or a few that include the first and last."""
    if len(prefixes) <= MANY:
        return ()
    rows = np.linspace(0, len(prefixes) - 1, _MOST_PHASE_ROWS).round().astype(int)
    return tuple(prefixes[row] for row in rows)


def view_document(title: str) -> rrb.View:
    """Return the view of a Markdown text."""
    return rrb.TextDocumentView(origin=name_document(title), name=title)


def view_events(content: Content) -> rrb.View:
    """Return the view that lists the events."""
    columns = rrb.TextLogColumns(
        timeline_columns=[plotted_curves.TIMELINE], text_log_columns=["Body"]
    )
    return rrb.TextLogView(
        origin="/",
        contents=[join_path(prefix, entities.EVENTS) for prefix in content.prefixes],
        name="Events",
        columns=columns,
    )


def _show_trails(content: Content) -> dict[Any, VisibleTimeRanges]:
    """Return the overrides that make a view show trails from their start to the cursor."""
    until_now = VisibleTimeRanges(
        ranges=[
            rrb.VisibleTimeRange(
                name,
                start=rrb.TimeRangeBoundary.infinite(),
                end=rrb.TimeRangeBoundary.cursor_relative(),
            )
            for name in content.timelines
        ]
    )
    prefixes = (*content.prefixes, *content.ghosts)
    return {join_path(prefix, entities.TRAIL): until_now for prefix in prefixes}


def _list_planes(content: Content) -> list[str]:
    prefixes = dict.fromkeys(["", *content.prefixes, *content.ghosts])
    return [f"{join_path(prefix, entities.PLANE)}/**" for prefix in prefixes]


def _hide(paths: Sequence[str], content: Content) -> list[str]:
    """Return the exclusions of a view of the whole plane: some paths, and the close-up."""
    ends = [join_path(prefix, entities.END) for prefix in content.prefixes]
    return [f"- {join_path(path)}/**" for path in (*paths, entities.CLOSE_UP, *ends)]
