"""Views: the content and the title of each view."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import rerun.blueprint as rrb
from rerun.blueprint.archetypes import VisibleTimeRanges

from turtlelog.charts import palette
from turtlelog.charts.close_up import CloseUp, format_length
from turtlelog.charts.many_runs import MANY
from turtlelog.charts.plane_scene import MANY_PATHS
from turtlelog.charts.time_axes import TIMELINE
from turtlelog.charts.tracked_path import WorstPlace
from turtlelog.draw.rerun import entities
from turtlelog.draw.rerun.content import Content
from turtlelog.draw.rerun.entities import join_path, locate_dead_times, locate_phases, name_document
from turtlelog.draw.rerun.world import Bounds

_MOST_PHASE_ROWS: Final = 4
"""Largest number of phase rows for more than seven runs; plots keep the larger part."""


def view_plane(content: Content, *, with_arrows: bool = True) -> rrb.View:
    """Return the view of the plane, with arrows if the title has room for their names."""
    told = content.equal or content.origin or content.arrows
    if content.is_small:  # a title has room for 20 letters
        told = "equal runs" if content.equal else content.scale_span
    hidden = [entities.SPEED_PATH]
    if content.arrows and (content.is_small or not with_arrows):
        hidden, told = [*hidden, entities.ERROR, entities.COMMAND], ""
    return rrb.Spatial2DView(
        origin="/",
        contents=[*_list_planes(content), *_hide(hidden, content)],
        name=f"Plane ({told})" if told else "Plane",
        background=palette.GROUND,
        overrides=_show_trails(content),
        visual_bounds=_turn_bounds(content.plane),
    )


def view_speed(content: Content, highest_m_s: float) -> rrb.View:
    """Return the view of the plane with paths coloured by speed."""
    hidden = _hide([entities.PATH, entities.TRAIL, entities.ERROR, entities.NAMES], content)
    return rrb.Spatial2DView(
        origin="/",
        contents=[*_list_planes(content), *hidden],
        name=f"By speed, 0 to {highest_m_s:.3g} m/s",
        background=palette.GROUND,
        visual_bounds=_turn_bounds(content.plane),
    )


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
    arrows = (
        entities.ARROW,
        entities.BODY,
        entities.COMMAND,
        entities.ERROR,
        entities.REFERENCE_POSE,
    )
    hidden = [entities.NAMES, entities.SPEED_PATH, entities.GAP]
    prefixes = (*content.prefixes, *content.ghosts)
    hidden += [join_path(prefix, arrow) for prefix in prefixes for arrow in arrows]
    return rrb.Spatial2DView(
        origin="/",
        contents=[*_list_planes(content), *(f"- {join_path(path)}/**" for path in hidden)],
        name=name,
        background=palette.GROUND,
        overrides=_show_trails(content),
        visual_bounds=_turn_bounds(bounds),
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
    return rrb.TimeSeriesView(
        origin="/",
        contents=contents,
        name=title.replace(" [", ", close up [") if plot in content.close_ups else title,
        axis_x=rrb.TimeAxis(link="LinkToGlobal"),
        axis_y=None if limits is None else rrb.ScalarAxis(range=limits),
        plot_legend=rrb.PlotLegend(legend, visible=legend is not None and has_names),
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
    columns = rrb.TextLogColumns(timeline_columns=[TIMELINE], text_log_columns=["Body"])
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


def _turn_bounds(bounds: Bounds) -> rrb.VisualBounds2D:
    """Return bounds in the view's own coordinates, with y downward."""
    (x_m, y_m), half_m = bounds.center_xy_m, bounds.half_size_m
    return rrb.VisualBounds2D(
        x_range=(x_m - half_m, x_m + half_m), y_range=(-y_m - half_m, -y_m + half_m)
    )
