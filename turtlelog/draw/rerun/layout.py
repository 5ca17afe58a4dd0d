"""Layouts: the views of a recording and their places. Views without data are left out."""

from collections.abc import Mapping, Sequence
from typing import Final

import rerun as rr
import rerun.blueprint as rrb

from turtlelog.charts.plotted_curves import TIMELINE, Column, StateGroup
from turtlelog.draw.rerun import entities
from turtlelog.draw.rerun.content import (
    Content,
    view_curves,
    view_document,
    view_events,
    view_goal,
    view_phases,
    view_plane,
    view_plot,
    view_speed,
    view_worst,
)
from turtlelog.draw.rerun.explanation_pictures import view_explained
from turtlelog.draw.rerun.legends import view_legend, view_scale

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

_EXPLAINED_COLUMNS: Final = (1.0, 1.5)

_SHARED_TIME_AXIS: Final = "view/5c0dca6a-e63f-9cf7-f657-2602590474cc/TimeAxis"
"""Entity in which the viewer keeps the range of all linked time axes, in a view that is never
shown."""

_LEFT_SHARES: Final = (3.0, 2.5, 2.0, 2.0)

_COLUMN_SHARES: Final = (1.0, 1.8)

_VIOLATION_ROWS: Final = (1.0, 1.2)

_VIOLATION_TOP: Final = (4.0, 1.0)
"""Widths of signal and legend. Of 1200 pixels, the legend has 240, with 32 letters per line."""

LEGEND_TITLE: Final = "Legend"

_VIOLATION_COLUMNS: Final = (1.0, 1.3, 1.6)
"""Widths of the columns. A line of the message has 92 letters; a window of 1400 pixels shows most
of them."""

_PHASE_HEAD_SHARE: Final = 0.09

_PHASE_ROW_SHARE: Final = 0.055

_LARGEST_PHASE_SHARE: Final = 0.4

_ONE_PHASE_SHARE: Final = 0.18
"""Largest share of the phases if every run has only one phase, whose bar only shows the end."""

_STATE_SHARE: Final = 0.22
"""Share of the plots' height for states: slightly less than one of three rows."""

_MOST_STATES_BESIDE: Final = 3
"""Largest number of states side by side. More states would be narrower than legends; they become
tabs."""

_WHOLE_TIME: Final = rr.TimeRange(
    start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite()
)
"""Range from the first to the last time, on every timeline."""

_LEAST_WIDTH: Final = 1000
"""Window width below which legends are left out [pixels]. Of 1000 pixels, plots have 320, and a
legend takes 210."""

_LEAST_HEIGHT: Final = 700
"""Window height below which legends are left out [pixels]. Of 700 pixels, plots have 110, and a
legend of three lines takes 85."""


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
    """Return the layout of a comparison: the same views with all runs, and one legend."""
    return _build_blueprint(content, _choose_legend(content))


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
    stacks = [cells for column in _COLUMNS if (cells := _list_cells(content, column, {}))]
    if stacks:
        parts.append(rrb.Horizontal(*(rrb.Vertical(*stack) for stack in stacks)))
    below = rrb.Horizontal(*parts, column_shares=_VIOLATION_COLUMNS[: len(parts)])
    return link_views(rrb.Vertical(top, below, row_shares=_VIOLATION_ROWS))


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
    stacks = [cells for column in _EXPLAINED if (cells := _list_cells(content, column, {}, tab=0))]
    if stacks:
        plots = rrb.Horizontal(*(rrb.Vertical(*stack) for stack in stacks))
        height = _EXPLAINED_ROWS[1] / sum(_EXPLAINED_ROWS)
        right.append(_add_phases(content, _add_states(content, plots), height))
    return link_views(
        rrb.Horizontal(
            rrb.Vertical(*left),
            rrb.Vertical(*right, row_shares=_EXPLAINED_ROWS[: len(right)]),
            column_shares=_EXPLAINED_COLUMNS,
        )
    )


def _choose_legend(content: Content) -> Corners:
    """Return the place of the only legend. A run keeps its colour in every view."""
    if content.legend_names:
        return {}
    for plot in ("along_track_error", "along_track"):
        if len(content.list_curves(plot)) == len(content.prefixes):
            return {plot: rrb.Corner2D.RightBottom}
    return {entities.HEADING: rrb.Corner2D.RightBottom}


def _build_blueprint(content: Content, legends: Corners) -> rrb.Blueprint:
    left = _list_left_views(content)
    parts: list[rrb.Container] = [rrb.Vertical(*left, row_shares=_LEFT_SHARES[: len(left)])]
    stacks = [cells for column in _COLUMNS if (cells := _list_cells(content, column, legends))]
    if stacks:
        plots = rrb.Horizontal(*(rrb.Vertical(*stack) for stack in stacks))
        parts.append(_add_phases(content, _add_states(content, plots)))
    root = rrb.Horizontal(*parts, column_shares=_COLUMN_SHARES[: len(parts)])
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


def _list_left_views(content: Content) -> list[rrb.View | rrb.Container]:
    left = _list_planes_of(content)
    tabs = [] if content.is_small else _list_tabs(content)
    if tabs:
        left.append(rrb.Tabs(*tabs, active_tab=0))
    return left


def _list_tabs(content: Content) -> list[rrb.View]:
    tabs: list[rrb.View] = []
    if content.scale_title is not None:
        tabs.append(view_scale(content.scale_title))
    elif content.legend_names:
        tabs.append(view_legend(content.legend_names))
    tabs += [view_document(title) for title in content.documents]
    if content.has_events:
        tabs.append(view_events(content))
    return tabs


def _list_planes_of(content: Content) -> list[rrb.View | rrb.Container]:
    """Return the plane, and the close-up of goal or path, if any."""
    views: list[rrb.View | rrb.Container] = [_build_plane(content)]
    if content.goal is not None:
        views.append(view_goal(content, content.goal))
    elif content.worst is not None:
        views.append(view_worst(content, content.worst))
    return views


def _build_plane(content: Content, *, with_arrows: bool = True) -> rrb.View | rrb.Container:
    plane = view_plane(content, with_arrows=with_arrows)
    if content.highest_speed_m_s is None:
        return plane
    by_speed = view_speed(content, content.highest_speed_m_s)
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
            view_plot(content, plot, None if content.is_small else legends.get(plot))
            for plot in cell
            if content.list_curves(plot)
        ]
        if plots:
            active = _choose_tab(content, cell) if tab is None else tab
            cells.append(rrb.Tabs(*plots, active_tab=active) if len(plots) > 1 else plots[0])
    return cells


def _choose_tab(content: Content, cell: Sequence[str]) -> int:
    """Return the index of the first plot that a loop controls, or else 0.

    The along-track error has priority if every run has this signal: next to a path of many metres,
    the error would not be visible.
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
        views = [view_plot(content, plot, None, name) for plot, name in pairs]
        return rrb.Tabs(*views, active_tab=0) if len(views) > 1 else next(iter(views), None)
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
