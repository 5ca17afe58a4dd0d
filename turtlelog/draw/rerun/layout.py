"""Layouts: the views of a recording and their places; and the legend of many runs."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Final

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from turtlelog.charts import palette
from turtlelog.charts.curves import Values
from turtlelog.charts.many_runs import GainScale
from turtlelog.charts.plotted_curves import Column, StateGroup
from turtlelog.charts.time_plots import TIMELINE
from turtlelog.draw.rerun import content as views, entities
from turtlelog.draw.rerun.content import Content
from turtlelog.draw.rerun.entities import join_path
from turtlelog.draw.rerun.explanation_pictures import view_explained
from turtlelog.draw.rerun.plane import draw_points, write_words

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
    """Return the layout of a comparison: the same views with all runs, and one legend.

    A run keeps its colour in every view, so one legend is enough.
    """
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
    top = rrb.Horizontal(violated, views.view_document(LEGEND_TITLE), column_shares=_VIOLATION_TOP)
    titles = [title for title in content.documents if title != LEGEND_TITLE]
    tabs = [*map(views.view_document, titles), views.view_events(content)]
    parts: list[rrb.Container | rrb.View] = [
        _build_plane(content, with_arrows=False),
        rrb.Tabs(*tabs, active_tab=0),
    ]
    parts += _list_stacks(content, _COLUMNS, {})
    below = rrb.Horizontal(*parts, column_shares=_VIOLATION_COLUMNS[: len(parts)])
    return link_views(rrb.Vertical(top, below, row_shares=_VIOLATION_ROWS))


def build_explanation_layout(content: Content) -> rrb.Blueprint:
    """Return the layout of a run with ghosts: the planes, the attribution, and a few plots."""
    left = _list_planes_of(content)
    tabs = [view_explained(content.steps_title or "", entities.STEPS)]
    tabs += (
        [] if content.luck_title is None else [view_explained(content.luck_title, entities.LUCK)]
    )
    tabs += map(views.view_document, content.documents)
    right: list[rrb.View | rrb.Container] = [
        rrb.Tabs(*tabs, *([views.view_events(content)] if content.has_events else []), active_tab=0)
    ]
    height = _EXPLAINED_ROWS[1] / sum(_EXPLAINED_ROWS)
    for plots in _list_stacks(content, _EXPLAINED, {}, tab=0):
        right.append(_add_phases(content, _add_states(content, plots), height))
    return link_views(
        rrb.Horizontal(
            rrb.Vertical(*left),
            rrb.Vertical(*right, row_shares=_EXPLAINED_ROWS[: len(right)]),
            column_shares=_EXPLAINED_COLUMNS,
        )
    )


def _build_blueprint(content: Content, legends: Corners) -> rrb.Blueprint:
    left = _list_planes_of(content)
    tabs = [] if content.is_small else _list_tabs(content)
    left += [rrb.Tabs(*tabs, active_tab=0)] if tabs else []
    parts: list[rrb.Container] = [rrb.Vertical(*left, row_shares=_LEFT_SHARES[: len(left)])]
    for plots in _list_stacks(content, _COLUMNS, legends):
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


def _list_tabs(content: Content) -> list[rrb.View]:
    tabs: list[rrb.View] = []
    if content.scale_title is not None:
        bar, ranges = f"{join_path(entities.LEGEND)}/**", (-0.3, _SCALE_WIDTH + 0.3)
        tabs.append(views.view_picture(content.scale_title, [bar], ranges, (-0.5, _SCALE_DEPTH)))
    elif content.legend_names:
        tabs.append(_view_legend(content.legend_names))
    tabs += map(views.view_document, content.documents)
    return [*tabs, *([views.view_events(content)] if content.has_events else [])]


def _list_planes_of(content: Content) -> list[rrb.View | rrb.Container]:
    """Return the plane, and the close-up of goal or path, if any."""
    plane, close_up = _build_plane(content), views.view_close_up(content)
    return [plane] if close_up is None else [plane, close_up]


def _build_plane(content: Content, *, with_arrows: bool = True) -> rrb.View | rrb.Container:
    plane = views.view_plane(content, with_arrows=with_arrows)
    if content.highest_speed_m_s is None:
        return plane
    by_speed = views.view_speed(content, content.highest_speed_m_s)
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
            plots = [*map(partial(views.view_plot, content), shown, corners)]
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
        shown = [views.view_plot(content, plot, None, name) for plot, name in pairs]
        return rrb.Tabs(*shown, active_tab=0) if len(shown) > 1 else next(iter(shown), None)
    ranges = [content.ranges[plot] for plot in plots if plot in content.ranges]
    axis = (min(low for low, _ in ranges), max(high for _, high in ranges)) if ranges else None
    corner = content.corners.get(plots[0], "RightTop")
    contents = [path for plot in plots for path in content.list_curves(plot)]
    return views.view_curves(group.label, contents, axis, rrb.PlotLegend(rrb.Corner2D[corner]))


def _add_phases(content: Content, plots: rrb.Container, height: float = 1.0) -> rrb.Container:
    """Add the phases below plots; `height` is the height of both, as a share of the window."""
    if not content.with_phases or content.is_small:
        return plots
    rows = min(content.with_phases, len(content.phase_rows) or content.with_phases)
    share = _PHASE_HEAD_SHARE + _PHASE_ROW_SHARE * (rows + content.has_dead_time)
    largest = _LARGEST_PHASE_SHARE if content.has_several_phases else _ONE_PHASE_SHARE
    share = min(share / height, largest)
    return rrb.Vertical(plots, views.view_phases(content), row_shares=[1.0 - share, share])


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

_SCALE_LABELS: Final = 12
"""Largest number of values in a view 500 pixels wide: 40 pixels each."""


def _view_legend(names: Sequence[str]) -> rrb.View:
    shown = [names[number] for number in choose_names(len(names))]
    last_row = float(arrange_names(shown)[-1, 1])
    title = "Runs" if len(shown) == len(names) else f"{len(shown)} of {len(names)} runs"
    ranges = (0.0, _LEGEND_WIDTH), (-0.5, last_row + 1.0)
    return views.view_picture(title, [join_path(entities.LEGEND)], *ranges)


def draw_legend(
    stream: rr.RecordingStream, names: Sequence[str], colors: Sequence[palette.Color]
) -> None:
    """Draw the names of runs in their colours."""
    chosen = choose_names(len(names))
    shown, hues = [names[number] for number in chosen], [colors[number] for number in chosen]
    looks: dict[str, Any] = {"labels": shown, "show_labels": True}
    draw_points(stream, entities.LEGEND, arrange_names(shown), hues, _LEGEND_RADIUS, **looks)


def draw_scale(
    stream: rr.RecordingStream, scale: GainScale, colors: Sequence[palette.Color]
) -> None:
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
