"""The views of a layout, one by one."""

from collections.abc import Sequence
from typing import Final

import rerun as rr
import rerun.blueprint as rrb

from turtlelog.show import palette
from turtlelog.show.close_up import CloseUp
from turtlelog.show.rerun import entities
from turtlelog.show.rerun.content import Content
from turtlelog.show.rerun.drawing import name_document
from turtlelog.show.rerun.entities import TIMELINE, join_path
from turtlelog.show.rerun.legend import arrange_names, choose_names
from turtlelog.show.rerun.world import Bounds

WHOLE_TIME: Final = rr.TimeRange(
    start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite()
)
"""From the first time to the last, on every timeline."""

_PAIRS: Final = frozenset({entities.POSITION, entities.POSITION_ERROR, entities.WORLD_VELOCITY})


_CROWDED: Final = frozenset({entities.HEADING, entities.ALONG_TRACK})
"""Plots whose legends have no room for more."""


def view_plane(content: Content) -> rrb.View:
    """Show where the turtles drive."""
    return rrb.Spatial2DView(
        origin="/",
        contents=[*_list_planes(content), *_hide([entities.SPEED_PATH], content)],
        name="Plane",
        background=palette.GROUND,
        visual_bounds=_turn_bounds(content.plane),
    )


def view_speed(content: Content, highest_m_s: float) -> rrb.View:
    """Show where they drive fast."""
    hidden = _hide([entities.PATH, entities.ERROR, entities.NAMES], content)
    return rrb.Spatial2DView(
        origin="/",
        contents=[*_list_planes(content), *hidden],
        name=f"By speed, 0 to {highest_m_s:.3g} m/s",
        background=palette.GROUND,
        visual_bounds=_turn_bounds(content.plane),
    )


def view_goal(content: Content, close_up: CloseUp) -> rrb.View:
    """Show how close they end; arrows and names would cover it."""
    arrows = (entities.ARROW, entities.COMMAND, entities.ERROR, entities.REFERENCE_POSE)
    hidden = [entities.NAMES, entities.SPEED_PATH]
    hidden += [join_path(prefix, arrow) for prefix in content.prefixes for arrow in arrows]
    bounds = Bounds(center_xy_m=close_up.goal_xy_m, half_size_m=close_up.half_m)
    return rrb.Spatial2DView(
        origin="/",
        contents=[*_list_planes(content), *(f"- {join_path(path)}/**" for path in hidden)],
        name=f"At the goal, {close_up.describe()}",
        background=palette.GROUND,
        visual_bounds=_turn_bounds(bounds),
    )


def view_plot(content: Content, plot: str, legend: rrb.Corner2D | None) -> rrb.View:
    """Show curves over time, with a legend where there is a corner and anything to tell apart."""
    contents = content.list_curves(plot)
    has_several = len(contents) > 1 or plot in {*content.references, *_PAIRS}
    if plot in content.references:
        contents.insert(0, join_path(entities.REFERENCE, plot))
    if legend is None or plot not in _CROWDED:
        contents += content.lines
    title, limits = _name_plot(plot), content.ranges.get(plot)
    return rrb.TimeSeriesView(
        origin="/",
        contents=contents,
        name=title.replace(" [", ", close up [") if plot in content.close_ups else title,
        axis_x=rrb.TimeAxis(link="LinkToGlobal"),
        axis_y=None if limits is None else rrb.ScalarAxis(range=limits),
        plot_legend=rrb.PlotLegend(legend, visible=legend is not None and has_several),
    )


def _name_plot(plot: str) -> str:
    return entities.TITLES.get(plot) or f"State {plot.partition('/')[2]}"


def view_phases(content: Content) -> rrb.View:
    """Show the phases, a row per run; a pause is too short for its name."""
    contents = [join_path(prefix, entities.PHASE) for prefix in content.prefixes]
    if content.has_dead_time:
        contents.insert(0, join_path(content.prefixes[0], entities.DEAD_TIME))
    return rrb.StateTimelineView(
        origin="/",
        contents=contents,
        name=f"Phases (brown: pause{', pink: dead time' if content.has_dead_time else ''})",
        time_view=rrb.TimeAxis(link="LinkToGlobal"),
    )


def view_shares(title: str) -> rrb.View:
    """Show the mechanisms' shares as bars."""
    legend = rrb.PlotLegend(rrb.Corner2D.RightTop)
    contents = f"{join_path(entities.SHARES)}/**"
    return rrb.BarChartView(origin="/", contents=contents, name=title, plot_legend=legend)


def view_legend(names: Sequence[str]) -> rrb.View:
    """Show the names of many runs in their colours."""
    shown = [names[number] for number in choose_names(len(names))]
    grid = arrange_names(shown)
    return rrb.Spatial2DView(
        origin="/",
        contents=[join_path(entities.LEGEND)],
        name="Runs" if len(shown) == len(names) else f"{len(shown)} of {len(names)} runs",
        background=palette.GROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=grid.x_range, y_range=grid.y_range),
    )


def view_document(title: str) -> rrb.View:
    """Show a Markdown text."""
    return rrb.TextDocumentView(origin=name_document(title), name=title)


def view_events(content: Content) -> rrb.View:
    """List the events."""
    columns = rrb.TextLogColumns(timeline_columns=[TIMELINE], text_log_columns=["Body"])
    return rrb.TextLogView(
        origin="/",
        contents=[join_path(prefix, entities.EVENTS) for prefix in content.prefixes],
        name="Events",
        columns=columns,
    )


def _list_planes(content: Content) -> list[str]:
    prefixes = dict.fromkeys(["", *content.prefixes])
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
