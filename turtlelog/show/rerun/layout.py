"""Layouts: which views a recording opens with, and where. A view without data is left out."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from rerun.blueprint.archetypes import VisibleTimeRanges

from turtlelog.show import palette
from turtlelog.show.close_up import CloseUp, format_length
from turtlelog.show.phase_timelines import TIMELINE
from turtlelog.show.rerun import entities
from turtlelog.show.rerun.content import Content
from turtlelog.show.rerun.entities import join_path, name_document
from turtlelog.show.rerun.many_runs import MANY
from turtlelog.show.rerun.waterfall import view_waterfall
from turtlelog.show.rerun.world import Bounds
from turtlelog.show.state_groups import StateGroup
from turtlelog.show.tracked_path import WorstPlace

Corners = Mapping[str, rrb.Corner2D]

_RUN_LEGENDS: Final[Corners] = MappingProxyType(
    {
        entities.HEADING: rrb.Corner2D.RightBottom,
        entities.HEADING_ERROR: rrb.Corner2D.RightBottom,
        entities.TURN_RATE: rrb.Corner2D.RightTop,
        entities.ALONG_TRACK_ERROR: rrb.Corner2D.RightTop,
        entities.ALONG_TRACK: rrb.Corner2D.RightBottom,
        entities.POSITION: rrb.Corner2D.LeftTop,
        entities.POSITION_ERROR: rrb.Corner2D.RightTop,
        entities.CROSS_TRACK: rrb.Corner2D.LeftBottom,
        entities.DISTANCE: rrb.Corner2D.RightTop,
        entities.SPEED: rrb.Corner2D.LeftBottom,
        entities.WORLD_VELOCITY: rrb.Corner2D.RightTop,
    }
)
"""Where curves usually leave room; on the right, above or below where they end."""

_TURNING: Final = (
    (entities.HEADING,),
    (entities.HEADING_ERROR, entities.HEADING_ERROR_LOG),
    (entities.TURN_RATE,),
)
_RUN_MOVING: Final = (
    (
        entities.ALONG_TRACK_ERROR,
        entities.ALONG_TRACK,
        entities.POSITION,
        entities.POSITION_ERROR,
    ),
    (entities.CROSS_TRACK, entities.DISTANCE, entities.DISTANCE_LOG),
    (entities.SPEED, entities.WORLD_VELOCITY),
)
_COMPARED_MOVING: Final = (
    (entities.ALONG_TRACK_ERROR, entities.ALONG_TRACK, entities.POSITION),
    (entities.CROSS_TRACK, entities.DISTANCE, entities.DISTANCE_LOG),
    (entities.SPEED,),
)
"""Cells from top to bottom; several plots in one cell are tabs."""

_EXPLAINED: Final = (
    (
        (entities.GAP_MM, entities.GAP_M),
        (entities.HEADING_ERROR, entities.HEADING, entities.HEADING_ERROR_LOG),
    ),
    (
        (
            entities.CROSS_TRACK,
            entities.DISTANCE,
            entities.ALONG_TRACK_ERROR,
            entities.ALONG_TRACK,
            entities.POSITION,
        ),
        (entities.SPEED, entities.TURN_RATE),
    ),
)
_EXPLAINED_ROWS: Final = (1.0, 2.0)
_EXPLAINED_COLUMNS: Final = (1.0, 1.5)

_SHARED_TIME_AXIS: Final = "view/5c0dca6a-e63f-9cf7-f657-2602590474cc/TimeAxis"
"""Where the viewer keeps the range of all linked time axes: in a view that is never shown."""

_LEFT_SHARES: Final = (3.0, 2.5, 2.0, 2.0)
_COLUMN_SHARES: Final = (1.0, 1.8)
_VIOLATION_ROWS: Final = (1.0, 1.2)
_VIOLATION_COLUMNS: Final = (1.0, 1.3, 1.6)
"""The message has lines of 92 letters, of which a window of 1400 pixels shows most."""
_PHASE_HEAD_SHARE: Final = 0.09
_PHASE_ROW_SHARE: Final = 0.055
_LARGEST_PHASE_SHARE: Final = 0.4
_ONE_PHASE_SHARE: Final = 0.18
"""Largest share where every run has but one phase: the bars tell only when each ends."""
_STATE_SHARE: Final = 0.22
"""Of the height of the plots: a little less than one of three rows."""
_MOST_STATES_BESIDE: Final = 3
"""More would each be narrower than the others' legends: they are tabs."""

_WHOLE_TIME: Final = rr.TimeRange(
    start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite()
)
"""From the first time to the last, on every timeline."""

_PAIRS: Final = frozenset({entities.POSITION, entities.POSITION_ERROR, entities.WORLD_VELOCITY})

_CROWDED: Final = frozenset({entities.HEADING, entities.ALONG_TRACK})
"""Plots whose legends have no room for more."""


RESTLESS_PLOTS: Final = frozenset({entities.HEADING_ERROR, entities.SPEED, entities.TURN_RATE})
"""Plots that one run's swinging would fill from end to end."""

_LEAST_WIDTH: Final = 1000
"""Plots of a window 1000 pixels wide have 320, of which a legend takes 210."""
_LEAST_HEIGHT: Final = 700
"""Plots of a window 700 pixels high have 110, of which a legend of three lines takes 85."""

SCALE_WIDTH: Final = 12.0
"""Of the bar that tells the colours of many runs, in heights of it."""
_SCALE_DEPTH: Final = 2.5
_MOST_PHASE_ROWS: Final = 4
"""Of more than seven runs: plots above them keep the larger part."""

_LEGEND_WIDTH: Final = 12.0  # in heights of a row
_LEGEND_LETTERS: Final = 48
_MOST_COLUMNS: Final = 4
_MOST_NAMES: Final = 28
"""In four columns and seven lines, which a window of 1200 x 860 has room for."""


class LinkedBlueprint(rrb.Blueprint):
    """A layout whose time axes are linked and show all there is, on every timeline.

    Of a range of its own the viewer would show one minute, which goes with the cursor.
    """

    end_s: float | None = None
    """Where they end instead, on every timeline [s]."""

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        super()._log_to_stream(stream)
        shown = _WHOLE_TIME
        if self.end_s is not None:
            end = rr.TimeRangeBoundary.absolute(seconds=self.end_s)
            shown = rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=end)
        stream.log(_SHARED_TIME_AXIS, rrb.TimeAxis(view_range=shown))


def is_small(size: tuple[int, int] | None) -> bool:
    """Whether legends would cover the curves of plots in a window of this size [pixels]."""
    return size is not None and (size[0] < _LEAST_WIDTH or size[1] < _LEAST_HEIGHT)


def build_run_layout(content: Content) -> rrb.Blueprint:
    """Return the layout of a run alone: plane, heading loop, position loop, phases below."""
    corners = {plot: _avoid_end(content, plot, usual) for plot, usual in _RUN_LEGENDS.items()}
    return _build_blueprint(content, (_TURNING, _RUN_MOVING), corners)


def build_comparison_layout(content: Content) -> rrb.Blueprint:
    """Return the layout of a comparison: the same views with every run in each, one legend."""
    return _build_blueprint(content, (_TURNING, _COMPARED_MOVING), _choose_legend(content))


def build_violation_layout(content: Content, violated: rrb.View) -> rrb.Blueprint:
    """Return the layout of a violation: its signal over all, then plane, message and plots.

    The plots are as small as a legend, and have none.
    """
    tabs = [_view_document(title) for title in content.documents] + [_view_events(content)]
    parts: list[rrb.Container | rrb.View] = [
        _build_plane(content),
        rrb.Tabs(*tabs, active_tab=0),
    ]
    columns = (_TURNING, _RUN_MOVING)
    stacks = [cells for column in columns if (cells := _list_cells(content, column, {}))]
    if stacks:
        parts.append(rrb.Horizontal(*(rrb.Vertical(*stack) for stack in stacks)))
    below = rrb.Horizontal(*parts, column_shares=_VIOLATION_COLUMNS[: len(parts)])
    return LinkedBlueprint(
        rrb.Vertical(violated, below, row_shares=_VIOLATION_ROWS),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="paused"),
        auto_views=False,
        auto_layout=False,
    )


def build_explanation_layout(content: Content) -> rrb.Blueprint:
    """Return the layout of a run beside its ghosts: the planes, the attribution, a few plots."""
    left = _list_planes_of(content)
    tabs = [view_waterfall(content.steps_title or ""), *map(_view_document, content.documents)]
    right: list[rrb.View | rrb.Container] = [
        rrb.Tabs(*tabs, *([_view_events(content)] if content.has_events else []), active_tab=0)
    ]
    stacks = [cells for column in _EXPLAINED if (cells := _list_cells(content, column, {}, tab=0))]
    if stacks:
        plots = rrb.Horizontal(*(rrb.Vertical(*stack) for stack in stacks))
        height = _EXPLAINED_ROWS[1] / sum(_EXPLAINED_ROWS)
        right.append(_add_phases(content, _add_states(content, plots), height))
    return _finish(
        rrb.Horizontal(
            rrb.Vertical(*left),
            rrb.Vertical(*right, row_shares=_EXPLAINED_ROWS[: len(right)]),
            column_shares=_EXPLAINED_COLUMNS,
        )
    )


def choose_names(count: int) -> tuple[int, ...]:
    """Return which of many runs are named: as many as there is room for, the last among them.

    Colours of many runs follow their order, so that those between are known from their neighbours.
    """
    if count <= _MOST_NAMES:
        return tuple(range(count))
    return tuple(np.unique(np.linspace(0, count - 1, _MOST_NAMES).round().astype(int)).tolist())


def arrange_names(names: Sequence[str]) -> NDArray[np.float64]:
    """Return places in a grid, y downward, shape (n, 2): the longest name sets its columns."""
    longest = max(len(name) for name in names)
    columns = max(1, min(_MOST_COLUMNS, _LEGEND_LETTERS // longest))
    number = np.arange(len(names))
    across = (number % columns + 0.5) * (_LEGEND_WIDTH / columns)
    return np.column_stack([across, number // columns])


def _avoid_end(content: Content, plot: str, usual: rrb.Corner2D) -> rrb.Corner2D:
    """Return a corner on the same side, on the right away from where the plot's curve ends.

    Of a run without a goal the corner where its curves leave most room.
    """
    if plot in content.corners:
        return rrb.Corner2D[content.corners[plot]]
    if plot not in content.ends or usual.name.startswith("Left"):
        return usual
    is_high = content.ends[plot] > sum(content.ranges[plot]) / 2.0
    return rrb.Corner2D.RightBottom if is_high else rrb.Corner2D.RightTop


def _choose_legend(content: Content) -> Corners:
    """Return the one legend's place: a run keeps its colour in every view."""
    if content.legend_names:
        return {}
    for plot in (entities.ALONG_TRACK_ERROR, entities.ALONG_TRACK):
        if len(content.list_curves(plot)) == len(content.prefixes):
            return {plot: rrb.Corner2D.RightBottom}
    return {entities.HEADING: rrb.Corner2D.RightBottom}


def _build_blueprint(
    content: Content, columns: Sequence[Sequence[Sequence[str]]], legends: Corners
) -> rrb.Blueprint:
    left = _list_left_views(content)
    parts: list[rrb.Container] = [rrb.Vertical(*left, row_shares=_LEFT_SHARES[: len(left)])]
    stacks = [cells for column in columns if (cells := _list_cells(content, column, legends))]
    if stacks:
        plots = rrb.Horizontal(*(rrb.Vertical(*stack) for stack in stacks))
        parts.append(_add_phases(content, _add_states(content, plots)))
    root = rrb.Horizontal(*parts, column_shares=_COLUMN_SHARES[: len(parts)])
    return _finish(root, end_s=content.end_s)


def _finish(root: rrb.Container, *, end_s: float | None = None) -> rrb.Blueprint:
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


def _list_left_views(content: Content) -> list[rrb.View | rrb.Container]:
    left = _list_planes_of(content)
    tabs = [] if content.is_small else _list_tabs(content)
    if tabs:
        left.append(rrb.Tabs(*tabs, active_tab=0))
    return left


def _list_tabs(content: Content) -> list[rrb.View]:
    tabs: list[rrb.View] = []
    if content.scale_title is not None:
        tabs.append(_view_scale(content.scale_title))
    elif content.legend_names:
        tabs.append(_view_legend(content.legend_names))
    tabs += [_view_document(title) for title in content.documents]
    if content.has_events:
        tabs.append(_view_events(content))
    return tabs


def _list_planes_of(content: Content) -> list[rrb.View | rrb.Container]:
    """Return the plane, and the close-up of goal or path where there is one."""
    views: list[rrb.View | rrb.Container] = [_build_plane(content)]
    if content.goal is not None:
        views.append(_view_goal(content, content.goal))
    elif content.worst is not None:
        views.append(_view_worst(content, content.worst))
    return views


def _build_plane(content: Content) -> rrb.View | rrb.Container:
    plane = _view_plane(content)
    if content.highest_speed_m_s is None:
        return plane
    by_speed = _view_speed(content, content.highest_speed_m_s)
    return rrb.Tabs(plane, by_speed, active_tab=0)


def _list_cells(
    content: Content,
    column: Sequence[Sequence[str]],
    legends: Corners,
    *,
    tab: int | None = None,
) -> list[rrb.View | rrb.Container]:
    cells: list[rrb.View | rrb.Container] = []
    for cell in column:
        plots = [
            _view_plot(content, plot, None if content.is_small else legends.get(plot))
            for plot in cell
            if content.list_curves(plot)
        ]
        if plots:
            active = _choose_tab(content, cell) if tab is None else tab
            cells.append(rrb.Tabs(*plots, active_tab=active) if len(plots) > 1 else plots[0])
    return cells


def _choose_tab(content: Content, cell: Sequence[str]) -> int:
    """Return the first plot that a loop controls, among those that are there; else the first.

    The error along the track is the first where every run has it: beside a way of many metres it
    could not be seen.
    """
    shown = [plot for plot in cell if content.list_curves(plot)]
    if len(content.list_curves(shown[0])) < len(content.prefixes):
        shown = ["", *shown[1:]]
    return next((tab for tab, plot in enumerate(shown) if plot in content.controlled), 0)


def _add_states(content: Content, plots: rrb.Container) -> rrb.Container:
    """Put the states of the laws into a row of their own: a cell for each group."""
    cells = [cell for group in content.states if (cell := _view_states(content, group))]
    if not cells:
        return plots
    beside = len(cells) <= _MOST_STATES_BESIDE
    row = rrb.Horizontal(*cells) if beside else rrb.Tabs(*cells, active_tab=0)
    return rrb.Vertical(plots, row, row_shares=[1.0 - _STATE_SHARE, _STATE_SHARE])


def _view_states(content: Content, group: StateGroup) -> rrb.View | rrb.Container | None:
    """Show states over each other where they share a plot, else each as a tab."""
    plots = content.list_states(group)
    if group not in content.overlaid or not plots:
        has_tabs = group.command is not None and len(plots) > 1
        names = [plot.partition("/")[2] if has_tabs else "" for plot in plots]
        pairs = zip(plots, names, strict=True)
        views = [_view_plot(content, plot, None, name) for plot, name in pairs]
        return rrb.Tabs(*views, active_tab=0) if len(views) > 1 else next(iter(views), None)
    ranges = [content.ranges[plot] for plot in plots if plot in content.ranges]
    axis = (min(low for low, _ in ranges), max(high for _, high in ranges)) if ranges else None
    corner = content.corners.get(plots[0], "RightTop")
    return rrb.TimeSeriesView(
        origin="/",
        contents=[path for plot in plots for path in content.list_curves(plot)],
        name=group.title,
        axis_x=rrb.TimeAxis(link="LinkToGlobal"),
        axis_y=None if axis is None else rrb.ScalarAxis(range=axis),
        plot_legend=rrb.PlotLegend(rrb.Corner2D[corner]),
    )


def _add_phases(content: Content, plots: rrb.Container, height: float = 1.0) -> rrb.Container:
    """Put the phases below plots; `height` is that of both together, as a share of the window."""
    if not content.with_phases or content.is_small:
        return plots
    rows = min(content.with_phases, len(content.phase_rows) or content.with_phases)
    share = _PHASE_HEAD_SHARE + _PHASE_ROW_SHARE * (rows + content.has_dead_time)
    largest = _LARGEST_PHASE_SHARE if content.has_several_phases else _ONE_PHASE_SHARE
    share = min(share / height, largest)
    return rrb.Vertical(plots, _view_phases(content), row_shares=[1.0 - share, share])


def _view_plane(content: Content) -> rrb.View:
    """Show where the turtles drive."""
    return rrb.Spatial2DView(
        origin="/",
        contents=[*_list_planes(content), *_hide([entities.SPEED_PATH], content)],
        name=f"Plane ({content.arrows})" if content.arrows and not content.is_small else "Plane",
        background=palette.GROUND,
        overrides=show_trails(content),
        visual_bounds=_turn_bounds(content.plane),
    )


def _view_speed(content: Content, highest_m_s: float) -> rrb.View:
    """Show where they drive fast."""
    hidden = _hide([entities.PATH, entities.TRAIL, entities.ERROR, entities.NAMES], content)
    return rrb.Spatial2DView(
        origin="/",
        contents=[*_list_planes(content), *hidden],
        name=f"By speed, 0 to {highest_m_s:.3g} m/s",
        background=palette.GROUND,
        visual_bounds=_turn_bounds(content.plane),
    )


def _view_goal(content: Content, close_up: CloseUp) -> rrb.View:
    """Show how close they end; arrows and names would cover it."""
    bounds = Bounds(center_xy_m=close_up.goal_xy_m, half_size_m=close_up.half_m)
    return _view_close_up(content, f"At the goal, {close_up.describe()}", bounds)


def _view_worst(content: Content, worst: WorstPlace) -> rrb.View:
    """Show where they are furthest from the path that they track."""
    bounds = Bounds(center_xy_m=worst.center_xy_m, half_size_m=worst.half_m)
    return _view_close_up(content, f"Furthest off the path, ±{format_length(worst.half_m)}", bounds)


def _view_close_up(content: Content, name: str, bounds: Bounds) -> rrb.View:
    arrows = (
        entities.ARROW,
        entities.BODY,
        entities.COMMAND,
        entities.ERROR,
        entities.REFERENCE_POSE,
    )
    hidden = [entities.NAMES, entities.SPEED_PATH]
    prefixes = (*content.prefixes, *content.ghosts)
    hidden += [join_path(prefix, arrow) for prefix in prefixes for arrow in arrows]
    return rrb.Spatial2DView(
        origin="/",
        contents=[*_list_planes(content), *(f"- {join_path(path)}/**" for path in hidden)],
        name=name,
        background=palette.GROUND,
        overrides=show_trails(content),
        visual_bounds=_turn_bounds(bounds),
    )


def _view_plot(
    content: Content, plot: str, legend: rrb.Corner2D | None, name: str = ""
) -> rrb.View:
    """Show curves over time, with a legend where there is a corner and anything to tell apart."""
    contents = content.list_curves(plot)
    has_several = len(contents) > 1 or plot in {*content.references, *_PAIRS}
    if plot in content.references:
        contents.insert(0, join_path(entities.REFERENCE, plot))
    if legend is None or plot not in _CROWDED:
        contents += content.lines
    title, limits = name or _name_plot(plot), content.ranges.get(plot)
    if plot in content.outliers:
        title += f", {content.outliers[plot]}"
    if content.restless and plot in RESTLESS_PLOTS:
        title += f", without {content.restless}"
    return rrb.TimeSeriesView(
        origin="/",
        contents=contents,
        name=title.replace(" [", ", close up [") if plot in content.close_ups else title,
        axis_x=rrb.TimeAxis(link="LinkToGlobal"),
        axis_y=None if limits is None else rrb.ScalarAxis(range=limits),
        plot_legend=rrb.PlotLegend(legend, visible=legend is not None and has_several),
    )


def _view_phases(content: Content) -> rrb.View:
    """Show the phases, a row per run; a pause is too short for its name."""
    shown = content.phase_rows or content.prefixes
    contents = [join_path(prefix, entities.PHASE) for prefix in shown]
    of = f" of {len(shown)} of {len(content.prefixes)} runs" if len(content.prefixes) > MANY else ""
    dead = ", pink: dead time" if content.has_dead_time else ""
    until = "" if content.end_s is None else f", {content.end_s:.0f} of {content.length_s:.0f} s"
    if content.has_dead_time:
        contents.insert(0, join_path(content.prefixes[0], entities.DEAD_TIME))
    return rrb.StateTimelineView(
        origin="/",
        contents=contents,
        name=f"Phases{of}{until} (brown: pause{dead})",
        time_view=rrb.TimeAxis(link="LinkToGlobal"),
    )


def _view_legend(names: Sequence[str]) -> rrb.View:
    """Show the names of many runs in their colours."""
    shown = [names[number] for number in choose_names(len(names))]
    last_row = float(arrange_names(shown)[-1, 1])
    return rrb.Spatial2DView(
        origin="/",
        contents=[join_path(entities.LEGEND)],
        name="Runs" if len(shown) == len(names) else f"{len(shown)} of {len(names)} runs",
        background=palette.GROUND,
        visual_bounds=rrb.VisualBounds2D(
            x_range=(0.0, _LEGEND_WIDTH), y_range=(-0.5, last_row + 1.0)
        ),
    )


def _view_scale(title: str) -> rrb.View:
    """Show the bar of the colours of many runs."""
    return rrb.Spatial2DView(
        origin="/",
        contents=[f"{join_path(entities.LEGEND)}/**"],
        name=title,
        background=palette.GROUND,
        visual_bounds=rrb.VisualBounds2D(
            x_range=(-0.3, SCALE_WIDTH + 0.3), y_range=(-0.5, _SCALE_DEPTH)
        ),
    )


def choose_phase_rows(prefixes: Sequence[str]) -> tuple[str, ...]:
    """Return the runs whose phases are shown: of many a few, the first and the last among them."""
    if len(prefixes) <= MANY:
        return ()
    rows = np.linspace(0, len(prefixes) - 1, _MOST_PHASE_ROWS).round().astype(int)
    return tuple(prefixes[row] for row in rows)


def _view_document(title: str) -> rrb.View:
    """Show a Markdown text."""
    return rrb.TextDocumentView(origin=name_document(title), name=title)


def _view_events(content: Content) -> rrb.View:
    """List the events."""
    columns = rrb.TextLogColumns(timeline_columns=[TIMELINE], text_log_columns=["Body"])
    return rrb.TextLogView(
        origin="/",
        contents=[join_path(prefix, entities.EVENTS) for prefix in content.prefixes],
        name="Events",
        columns=columns,
    )


def _name_plot(plot: str) -> str:
    return entities.TITLES.get(plot) or f"State {plot.partition('/')[2]}"


def show_trails(content: Content) -> dict[Any, VisibleTimeRanges]:
    """Return what makes a view show the trails from their beginning to the cursor."""
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
    """Leave out what a view of the whole plane does not show: some paths, and the close-up."""
    ends = [join_path(prefix, entities.END) for prefix in content.prefixes]
    return [f"- {join_path(path)}/**" for path in (*paths, entities.CLOSE_UP, *ends)]


def _turn_bounds(bounds: Bounds) -> rrb.VisualBounds2D:
    """Return the bounds in the view's own coordinates, y downward."""
    (x_m, y_m), half_m = bounds.center_xy_m, bounds.half_size_m
    return rrb.VisualBounds2D(
        x_range=(x_m - half_m, x_m + half_m), y_range=(-y_m - half_m, -y_m + half_m)
    )
