"""Layouts of recordings: their views, and the places of the views."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Final

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.archetypes import VisibleTimeRanges

from turtlelog.charts.close_up import format_length
from turtlelog.charts.many_runs import MANY, MANY_PATHS
from turtlelog.charts.plotted_curves import Column, StateGroup
from turtlelog.charts.time_plots import TIMELINE
from turtlelog.draw.rerun import entities
from turtlelog.draw.rerun.content import Content
from turtlelog.draw.rerun.entities import join_path
from turtlelog.draw.rerun.pictures import view_explained, view_legend, view_picture, view_scale
from turtlelog.draw.rerun.plane import Bounds

Corners = Mapping[str, rrb.Corner2D]


def _list_column(column: Column) -> tuple[tuple[str, ...], ...]:
    """Return the cells of a column from top to bottom. Several plots in one cell are tabs."""
    cells: dict[int, list[str]] = {}
    for name, plots in entities.GROUPS.items():
        place = plots[0].place
        if place is not None and place[0] == column:
            log = [entities.name_logarithm(name)] if plots[0].is_log else []
            cells.setdefault(place[1], []).extend([name, *log])
    return tuple(tuple(cells[row]) for row in sorted(cells))


_COLUMNS: Final = (_list_column("turning"), _list_column("moving"))

_EXPLAINED: Final = (
    ((entities.GAP_MM, entities.GAP_M), (entities.HEADING_ERROR, entities.HEADING)),
    (
        ("cross_track", "distance", "along_track_error", entities.ALONG_TRACK, entities.POSITION),
        (entities.SPEED, entities.TURN_RATE),
    ),
)

_EXPLAINED_ROWS: Final = (1.0, 1.7)

_SHARED_TIME_AXIS: Final = "view/5c0dca6a-e63f-9cf7-f657-2602590474cc/TimeAxis"
"""Entity of the range of all linked time axes, in a view that the viewer never shows."""


_VIOLATION_TOP: Final = (4.0, 1.0)
"""Widths of signal and legend. Of 1200 pixels, the legend has 240, with 32 letters per line."""

LEGEND_TITLE: Final = "Legend"

_VIOLATION_COLUMNS: Final = (1.0, 1.3, 1.6)
"""Widths of the columns: 1400 pixels show most of a message's lines of 92 letters."""

_PHASE_HEAD_SHARE: Final = 0.09
_PHASE_ROW_SHARE: Final = 0.055
_LARGEST_PHASE_SHARE: Final = 0.4

_ONE_PHASE_SHARE: Final = 0.18
"""Largest share of the phases if every run has only one phase, whose bar only shows the end."""

_STATE_SHARE: Final = 0.22
"""Share of the plots' height for states: slightly less than one of three rows."""

_MOST_STATES_BESIDE: Final = 3  # states side by side; more, narrower than legends, become tabs

_WHOLE_TIME: Final = rr.TimeRange(
    start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite()
)
"""Range from the first to the last time, on every timeline."""

_LEAST_WIDTH: Final = 1000
"""Width below which legends are left out [pixels]: plots have 320, and a legend takes 210."""

_LEAST_HEIGHT: Final = 700
"""Height below which legends are left out [pixels]: plots have 110, and three lines take 85."""


class LinkedBlueprint(rrb.Blueprint):
    """A layout with linked time axes, which show everything on every timeline.

    If a plot had its own time range, the viewer would show only one minute of it, around the
    cursor.
    """

    end_s: float | None = None
    """End of the time axes on every timeline [s]; None: everything."""

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        super()._log_to_stream(stream)
        shown = _WHOLE_TIME
        if self.end_s is not None:
            end = rr.TimeRangeBoundary.absolute(seconds=self.end_s)
            shown = rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=end)
        stream.log(_SHARED_TIME_AXIS, rrb.TimeAxis(view_range=shown))


def is_small(size: tuple[int, int] | None) -> bool:
    """Return whether legends would cover the curves of plots in a window of this size [pixels]."""
    return size is not None and (size[0] < _LEAST_WIDTH or size[1] < _LEAST_HEIGHT)


def build_run_layout(content: Content) -> rrb.Blueprint:
    """Return the layout of a single run: plane, heading loop, position loop, phases below."""
    corners = {plot: rrb.Corner2D[corner] for plot, corner in content.corners.items()}
    return _build_blueprint(content, corners)


def build_comparison_layout(content: Content) -> rrb.Blueprint:
    """Return the views of all runs; as a run has one colour in every view, one legend is enough."""
    if content.legend_names:
        return _build_blueprint(content, {})
    alone = ("along_track_error", "along_track")
    whole = [plot for plot in alone if len(content.list_curves(plot)) == len(content.prefixes)]
    return _build_blueprint(content, {[*whole, entities.HEADING][0]: rrb.Corner2D.RightBottom})


def build_violation_layout(content: Content, violated: rrb.View) -> rrb.Blueprint:
    """Return the layout of a violation: the signal at the top, then plane, message and plots.

    The signal's legend is next to the signal, where it covers nothing; its lines wrap in a small
    window. The plots have no legends, because they are as small as a legend.
    """
    top = rrb.Horizontal(violated, view_document(LEGEND_TITLE), column_shares=_VIOLATION_TOP)
    titles = [title for title in content.documents if title != LEGEND_TITLE]
    tabs = [*map(view_document, titles), view_events(content)]
    parts: list[rrb.Container | rrb.View] = [
        _build_plane(content, with_arrows=False),
        rrb.Tabs(*tabs, active_tab=0),
    ]
    parts += _list_stacks(content, _COLUMNS, {})
    below = rrb.Horizontal(*parts, column_shares=_VIOLATION_COLUMNS[: len(parts)])
    return link_views(rrb.Vertical(top, below, row_shares=(1.0, 1.2)))


def build_explanation_layout(content: Content) -> rrb.Blueprint:
    """Return the layout of a run with ghosts: the planes, the attribution, and a few plots."""
    left = _list_planes_of(content)
    tabs = [view_explained(content.steps_title or "", entities.STEPS)]
    tabs += (
        [] if content.luck_title is None else [view_explained(content.luck_title, entities.LUCK)]
    )
    tabs += map(view_document, content.documents)
    right: list[rrb.View | rrb.Container] = [
        rrb.Tabs(*tabs, *([view_events(content)] if content.has_events else []), active_tab=0)
    ]
    height = _EXPLAINED_ROWS[1] / sum(_EXPLAINED_ROWS)
    for plots in _list_stacks(content, _EXPLAINED, {}, tab=0):
        right.append(_add_phases(content, _add_states(content, plots), height))
    return link_views(
        rrb.Horizontal(
            rrb.Vertical(*left),
            rrb.Vertical(*right, row_shares=_EXPLAINED_ROWS[: len(right)]),
            column_shares=(1.0, 1.5),
        )
    )


def _build_blueprint(content: Content, legends: Corners) -> rrb.Blueprint:
    left = _list_planes_of(content)
    tabs = [] if content.is_small else _list_tabs(content)
    left += [rrb.Tabs(*tabs, active_tab=0)] if tabs else []
    parts: list[rrb.Container] = [rrb.Vertical(*left, row_shares=(3.0, 2.5, 2.0, 2.0)[: len(left)])]
    for plots in _list_stacks(content, _COLUMNS, legends):
        parts.append(_add_phases(content, _add_states(content, plots)))
    root = rrb.Horizontal(*parts, column_shares=(1.0, 1.8)[: len(parts)])
    return link_views(root, end_s=content.end_s)


def link_views(root: rrb.Container, *, end_s: float | None = None) -> rrb.Blueprint:
    """Return a layout whose views share their time, with no panels except the time panel."""
    layout = LinkedBlueprint(
        root,
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="paused"),
        auto_views=False,
        auto_layout=False,
    )
    layout.end_s = end_s
    return layout


def _list_tabs(content: Content) -> list[rrb.View]:
    tabs: list[rrb.View] = []
    if content.scale_title is not None:
        tabs.append(view_scale(content.scale_title))
    elif content.legend_names:
        tabs.append(view_legend(content.legend_names))
    tabs += map(view_document, content.documents)
    return [*tabs, *([view_events(content)] if content.has_events else [])]


def _list_planes_of(content: Content) -> list[rrb.View | rrb.Container]:
    """Return the plane, and the close-up of goal or path, if any."""
    plane, close_up = _build_plane(content), view_close_up(content)
    return [plane] if close_up is None else [plane, close_up]


def _build_plane(content: Content, *, with_arrows: bool = True) -> rrb.View | rrb.Container:
    plane = view_plane(content, with_arrows=with_arrows)
    if content.highest_speed_m_s is None:
        return plane
    by_speed = view_speed(content, content.highest_speed_m_s)
    return rrb.Tabs(plane, by_speed, active_tab=0)


def _list_stacks(
    content: Content,
    columns: Sequence[Sequence[Sequence[str]]],
    legends: Corners,
    *,
    tab: int | None = None,
) -> list[rrb.Container]:
    """Return the columns of plots side by side, if there is a plot; plots in a cell are tabs."""
    stacks = []
    for column in columns:
        cells: list[rrb.View | rrb.Container] = []
        for cell in column:
            shown = [plot for plot in cell if content.list_curves(plot)]
            corners = [None if content.is_small else legends.get(plot) for plot in shown]
            plots = [*map(partial(view_plot, content), shown, corners)]
            if plots:
                active = _choose_tab(content, cell) if tab is None else tab
                cells.append(rrb.Tabs(*plots, active_tab=active) if len(plots) > 1 else plots[0])
        stacks += [cells] if cells else []
    return [rrb.Horizontal(*(rrb.Vertical(*cells) for cells in stacks))] if stacks else []


def _choose_tab(content: Content, cell: Sequence[str]) -> int:
    """Return the index of the first plot that a loop controls, or else 0.

    An along-track error of every run has priority: beside many metres it would not be visible.
    """
    shown = [plot for plot in cell if content.list_curves(plot)]
    if len(content.list_curves(shown[0])) < len(content.prefixes):
        shown = ["", *shown[1:]]
    return next((tab for tab, plot in enumerate(shown) if plot in content.controlled), 0)


def _add_states(content: Content, plots: rrb.Container) -> rrb.Container:
    """Add the states of the laws as a separate row, with a cell for each group."""
    cells = [cell for group in content.states if (cell := _view_states(content, group))]
    if not cells:
        return plots
    beside = len(cells) <= _MOST_STATES_BESIDE
    row = rrb.Horizontal(*cells) if beside else rrb.Tabs(*cells, active_tab=0)
    return rrb.Vertical(plots, row, row_shares=[1.0 - _STATE_SHARE, _STATE_SHARE])


def _view_states(content: Content, group: StateGroup) -> rrb.View | rrb.Container | None:
    """Show the states of a group in one plot if they share it; otherwise each state is a tab."""
    plots = content.list_states(group)
    if group not in content.overlaid or not plots:
        has_tabs = group.command is not None and len(plots) > 1
        states = [group.label_state(plot.partition("/")[2]) for plot in plots]
        names = [state if has_tabs else f"State {state}" for state in states]
        pairs = zip(plots, names, strict=True)
        shown = [view_plot(content, plot, None, name) for plot, name in pairs]
        return rrb.Tabs(*shown, active_tab=0) if len(shown) > 1 else next(iter(shown), None)
    ranges = [content.ranges[plot] for plot in plots if plot in content.ranges]
    axis = (min(low for low, _ in ranges), max(high for _, high in ranges)) if ranges else None
    corner = content.corners.get(plots[0], "RightTop")
    contents = [path for plot in plots for path in content.list_curves(plot)]
    return view_curves(group.label, contents, axis, rrb.PlotLegend(rrb.Corner2D[corner]))


def _add_phases(content: Content, plots: rrb.Container, height: float = 1.0) -> rrb.Container:
    """Add the phases below plots; `height` is the height of both, as a share of the window."""
    if not content.with_phases or content.is_small:
        return plots
    rows = min(content.with_phases, len(content.phase_rows) or content.with_phases)
    share = _PHASE_HEAD_SHARE + _PHASE_ROW_SHARE * (rows + content.has_dead_time)
    largest = _LARGEST_PHASE_SHARE if content.has_several_phases else _ONE_PHASE_SHARE
    share = min(share / height, largest)
    return rrb.Vertical(plots, view_phases(content), row_shares=[1.0 - share, share])


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
    contents = [*_list_plane_paths(content), *_hide(hidden, content)]
    title = f"Plane ({told})" if told else "Plane"
    return _view_bounds(title, contents, content.plane, overrides=_show_trails(content))


def view_speed(content: Content, highest_m_s: float) -> rrb.View:
    """Return the view of the plane with paths coloured by speed."""
    hidden = _hide([entities.PATH, entities.TRAIL, entities.ERROR, entities.NAMES], content)
    title = f"By speed, 0 to {highest_m_s:.3g} m/s"
    return _view_bounds(title, [*_list_plane_paths(content), *hidden], content.plane)


def view_close_up(content: Content) -> rrb.View | None:
    """Return the close-up of the goal or of the largest deviation from the path, if there is one.

    It has neither arrows nor names, which would cover it.
    """
    if content.goal is not None:
        bounds = Bounds(center_xy_m=content.goal.goal_xy_m, half_size_m=content.goal.half_m)
        outlines = ", outlines: 90 % of ends" if len(content.prefixes) > MANY_PATHS else ""
        name = f"At the goal, {content.goal.describe()}{content.starts}{outlines}"
    elif content.worst is not None:
        bounds = Bounds(center_xy_m=content.worst.center_xy_m, half_size_m=content.worst.half_m)
        name = f"Furthest off the path, ±{format_length(content.worst.half_m)}"
    else:
        return None
    hidden = [entities.NAMES, entities.SPEED_PATH, entities.GAP]
    prefixes = (*content.prefixes, *content.ghosts)
    hidden += [join_path(prefix, arrow) for prefix in prefixes for arrow in _ARROWS]
    contents = [*_list_plane_paths(content), *(f"- {join_path(path)}/**" for path in hidden)]
    return _view_bounds(name, contents, bounds, overrides=_show_trails(content))


def _view_bounds(name: str, contents: Sequence[str], bounds: Bounds, **more: Any) -> rrb.View:
    """Return a view of a square of the plane. The view's own coordinates have y downward."""
    (x_m, y_m), half_m = bounds.center_xy_m, bounds.half_size_m
    ranges = (x_m - half_m, x_m + half_m), (-y_m - half_m, -y_m + half_m)
    return view_picture(name, contents, *ranges, **more)


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
    contents = [entities.locate_phases(prefix) for prefix in shown]
    of = f" of {len(shown)} of {len(content.prefixes)} runs" if len(content.prefixes) > MANY else ""
    colors = ["brown: pause"] if content.has_pause else []
    colors += ["pink: dead time"] if content.has_dead_time else []
    key = f" ({', '.join(colors)})" if colors else ""
    until = "" if content.end_s is None else f", {content.end_s:.0f} of {content.length_s:.0f} s"
    if content.has_dead_time:
        contents.insert(1, entities.locate_dead_times(shown[0]))
    return rrb.StateTimelineView(
        origin="/",
        contents=contents,
        name=f"Phases{of}{until}{key}",
        time_view=rrb.TimeAxis(link="LinkToGlobal"),
    )


def view_document(title: str) -> rrb.View:
    """Return the view of a Markdown text."""
    return rrb.TextDocumentView(origin=entities.name_document(title), name=title)


def view_events(content: Content) -> rrb.View:
    """Return the view that lists the events."""
    timelines = [TIMELINE]
    return rrb.TextLogView(
        origin="/",
        contents=[join_path(prefix, entities.EVENTS) for prefix in content.prefixes],
        name="Events",
        columns=rrb.TextLogColumns(timeline_columns=timelines, text_log_columns=["Body"]),
    )


def _show_trails(content: Content) -> dict[Any, VisibleTimeRanges]:
    """Return the overrides that make a view show trails from their start to the cursor."""
    start, end = rrb.TimeRangeBoundary.infinite(), rrb.TimeRangeBoundary.cursor_relative()
    ranges = [rrb.VisibleTimeRange(name, start=start, end=end) for name in content.timelines]
    until_now = VisibleTimeRanges(ranges=ranges)
    prefixes = (*content.prefixes, *content.ghosts)
    return {join_path(prefix, entities.TRAIL): until_now for prefix in prefixes}


def _list_plane_paths(content: Content) -> list[str]:
    prefixes = dict.fromkeys(["", *content.prefixes, *content.ghosts])
    return [f"{join_path(prefix, entities.PLANE)}/**" for prefix in prefixes]


def _hide(paths: Sequence[str], content: Content) -> list[str]:
    """Return the exclusions of a view of the whole plane: some paths, and the close-up."""
    ends = [join_path(prefix, entities.END) for prefix in content.prefixes]
    return [f"- {join_path(path)}/**" for path in (*paths, entities.CLOSE_UP, *ends)]
