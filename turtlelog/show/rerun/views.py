"""The views of a layout, one by one."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final

import rerun.blueprint as rrb

from turtlelog.show.rerun import entities
from turtlelog.show.rerun.content import Content
from turtlelog.show.rerun.drawing import name_document
from turtlelog.show.rerun.entities import TIMELINE, join_path
from turtlelog.show.rerun.legend import arrange_names
from turtlelog.show.rerun.surroundings import Bounds

_TITLES: Final[Mapping[str, str]] = MappingProxyType(
    {
        entities.HEADING: "Heading [deg]",
        entities.HEADING_ERROR: "Heading error [deg]",
        entities.TURN_RATE: "Turn rate [rad/s]",
        entities.POSITION: "Position [m]",
        entities.ALONG_TRACK: "Along-track [m]",
        entities.CROSS_TRACK: "Cross-track [m]",
        entities.DISTANCE: "Distance [m]",
        entities.SPEED: "Speed [m/s]",
    }
)


def view_plane(content: Content) -> rrb.View:
    """Show where the turtles drive."""
    return rrb.Spatial2DView(
        origin="/",
        contents=_list_planes(content),
        name="Plane",
        visual_bounds=_turn_bounds(content.plane),
    )


def view_goal(content: Content, bounds: Bounds) -> rrb.View:
    """Show how close they come; arrows and names would cover it."""
    hidden = [entities.NAMES, *(join_path(p, entities.ARROW) for p in content.prefixes)]
    return rrb.Spatial2DView(
        origin="/",
        contents=[*_list_planes(content), *(f"- {join_path(path)}" for path in hidden)],
        name=f"At the goal, ±{_format_length(bounds.half_size_m)}",
        visual_bounds=_turn_bounds(bounds),
    )


def view_plot(content: Content, plot: str, legend: rrb.Corner2D | None) -> rrb.View:
    """Show curves over time, with a legend where there is a corner and anything to tell apart."""
    contents = content.list_curves(plot)
    has_several = len(contents) > 1 or plot in content.references or plot == entities.POSITION
    if plot in content.references:
        contents.insert(0, join_path(entities.REFERENCE, plot))
    title, limits = _TITLES[plot], content.ranges.get(plot)
    is_close_up = plot == entities.HEADING_ERROR and limits is not None
    return rrb.TimeSeriesView(
        origin="/",
        contents=contents,
        name=title.replace(" [", ", close up [") if is_close_up else title,
        axis_x=rrb.TimeAxis(link="LinkToGlobal"),
        axis_y=None if limits is None else rrb.ScalarAxis(range=limits),
        plot_legend=rrb.PlotLegend(legend, visible=legend is not None and has_several),
    )


def view_phases(content: Content) -> rrb.View:
    """Show the phases, a row per run; a pause is too short for its name."""
    return rrb.StateTimelineView(
        origin="/",
        contents=[join_path(prefix, entities.PHASE) for prefix in content.prefixes],
        name="Phases (brown: pause)",
        time_view=rrb.TimeAxis(link="LinkToGlobal"),
    )


def view_legend(names: Sequence[str]) -> rrb.View:
    """Show the names of many runs in their colours."""
    grid = arrange_names(names)
    return rrb.Spatial2DView(
        origin="/",
        contents=[join_path(entities.LEGEND)],
        name="Runs",
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


def _format_length(length_m: float) -> str:
    return f"{length_m * 1e3:.3g} mm" if length_m < 1.0 else f"{length_m:.2f} m"


def _turn_bounds(bounds: Bounds) -> rrb.VisualBounds2D:
    """Return the bounds in the view's own coordinates, y downward."""
    (x_m, y_m), half_m = bounds.center_xy_m, bounds.half_size_m
    return rrb.VisualBounds2D(
        x_range=(x_m - half_m, x_m + half_m), y_range=(-y_m - half_m, -y_m + half_m)
    )
