"""Figures of a report with descriptions: the plane, the goal, and the signals of failed checks."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.charts import many_runs, plane_scene
from turtlelog.charts.close_up import CloseUp, format_length
from turtlelog.charts.curve_marks import ViolatedSignal
from turtlelog.charts.curves import Values, choose_rows
from turtlelog.charts.palette import ALLOWED, MAIN, VIOLATION, Color, choose_turtle_size, to_hex
from turtlelog.charts.plane_scene import find_break_rows, part_path
from turtlelog.charts.plotted_curves import CurveKind
from turtlelog.display import describe_count
from turtlelog.libraries import load_library
from turtlelog.plants.turtlesim import WORLD_SIZE_M
from turtlelog.run import Run

MOST_POINTS: Final = 2000  # points of a curve: a screen has fewer columns


_FAR: Final = 1e3
"""Magnitude from which 64 bits are used: 32 bits lose a tenth of a millimetre or millisecond."""

RING: Final = "#8a8a8a"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drawn:
    """A run or ghost with its drawing style."""

    run: Run  # data of the run
    name: str  # name in the legend
    color: Color  # colour in every plot
    is_ghost: bool = False  # whether it is a what-if
    is_plotted: bool = True  # whether the plots over time also show this run


@dataclass(slots=True, kw_only=True)
class Plots:
    """The plots of a page."""

    roots: dict[str, Any] = field(default_factory=dict)  # figures by the id of their place
    config: dict[str, Any] = field(default_factory=dict)  # ids of models for the script by role
    thinned: int = 0  # number of curves drawn with fewer points than were recorded
    points: int = MOST_POINTS  # largest number of points of a curve
    kinds: set[CurveKind] = field(default_factory=set)  # kinds of curves in the page
    crosshair: Any = field(  # line at the time under the mouse, in all plots over time
        default_factory=lambda: load_library("bokeh.models").Span(
            dimension="height", line_color=RING, line_alpha=0.5
        )
    )
    alternatives: dict[str, str] = field(default_factory=dict)  # figures in words, by place


def thin(plots: Plots, columns: Sequence[NDArray[Any]], kept: NDArray[Any]) -> list[NDArray[Any]]:
    """Return columns with the rows that give the same drawing, in the smallest suitable type."""
    rows = choose_rows(kept, plots.points)
    plots.thinned += rows is not None
    found = [np.asarray(column if rows is None else column[rows]) for column in columns]
    return [store(column) for column in found]


def store(values: NDArray[Any]) -> NDArray[Any]:
    """Return values in the smallest suitable type."""
    largest = np.abs(values[np.isfinite(values)]).max(initial=0.0)
    return np.asarray(values, dtype=np.float32 if largest < _FAR else np.float64)


def make_figure(plots: Plots, place: str, title: str, **options: Any) -> Any:
    """Return a new figure at a place of the page."""
    plotting = load_library("bokeh.plotting")
    figure = plotting.figure(
        title=title,
        tools="pan,box_zoom,wheel_zoom,reset,save",
        active_drag="box_zoom" if "x_range" in options else "pan",
        sizing_mode="stretch_width",
        styles={"background-color": "var(--ground)"},
        **options,
    )
    figure.toolbar.logo = None
    figure.toolbar.autohide = True
    # A tenth of a millimetre is written in full, not as a power of ten.
    figure.yaxis.formatter.power_limit_low = -4
    figure.title.text_font_size = "14px"
    plots.roots[place] = figure
    plots.alternatives[place] = title
    plots.config["figures"].append(figure.id)
    return figure


_MOST_TOLD: Final = 4  # ends with distances; with more ends, distances would hide each other


def draw_planes(plots: Plots, drawn: Sequence[Drawn], close_up: CloseUp | None) -> None:
    """Draw the plane, and the close-up of the goal if there is one."""
    models, whole_m = load_library("bokeh.models"), WORLD_SIZE_M
    if not plane_scene.is_in_world([one.run for one in drawn]):
        places = np.concatenate([one.run.poses.xy_m for one in drawn])
        whole_m = max(float(np.ptp(places, axis=0).max()), 0.1)
    poses_of: dict[str, list[Any]] = {key: [] for key in ("t", "x", "y", "h")}
    for one in drawn:
        poses, breaks = one.run.poses, find_break_rows(one.run)
        time_s = (poses.time_ns - one.run.start_ns) / 1e9
        # The robot's place during a gap without poses is unknown: neither path nor turtle is drawn.
        columns = [
            np.insert(time_s, breaks, time_s[breaks]),
            *part_path(one.run).T,
            np.insert(np.unwrap(poses.heading_rad), breaks, np.nan),
        ]
        kept = np.column_stack(columns[1:])
        for key, values in zip(poses_of, thin(plots, columns, kept), strict=True):
            poses_of[key].append(values)
    poses_of["color"] = [to_hex(one.color) for one in drawn]
    poses_of["dash"] = ["dashed" if one.is_ghost else "solid" for one in drawn]
    is_grey = many_runs.has_grey_paths([one.run for one in drawn])
    poses_of["way"] = [RING] * len(drawn) if is_grey else poses_of["color"]
    ways = models.ColumnDataSource(data=poses_of)
    plots.config["ways"] = ways.id
    trails = models.ColumnDataSource(data={"xs": [], "ys": [], "color": [], "alpha": []})
    views: list[tuple[str, str, CloseUp | None]] = [("plane", "The way", None)]
    views += [] if close_up is None else [("goal", f"At the goal, {close_up.describe()}", close_up)]
    for place, title, shown in views:
        figure = make_figure(
            plots, place, title, match_aspect=True, height=430, x_axis_label="x [m]",
            y_axis_label="y [m]",
        )  # fmt: skip
        ways_m = [(one.name, one.run.poses.xy_m) for one in drawn]
        plots.alternatives[place] = describe_plane(title, ways_m)
        figure.toolbar.active_scroll = None
        still = _draw_still(figure, drawn, shown)
        lines = figure.multi_line(
            "x", "y", source=ways, color="way", line_dash="dash", alpha=0.35, line_width=1.2
        )
        still += [] if shown else [lines]
        figure.multi_line("xs", "ys", source=trails, color="color", alpha="alpha", line_width=2.5)
        turtles = models.ColumnDataSource(data={"xs": [], "ys": [], "color": [], "alpha": []})
        figure.patches(
            "xs", "ys", source=turtles, fill_color="color", fill_alpha="alpha",
            line_color="color", line_width=1.5,
        )  # fmt: skip
        if shown is not None:
            _draw_ends(figure, drawn, shown)
        if is_grey:
            _draw_many_ends(figure, drawn)
            # There is no legend if each gain has too few runs for an outline.
            for legend in figure.legend:
                legend.update(visible=shown is None, location="bottom_left")
        figure.x_range.renderers = figure.y_range.renderers = still
        size_m = 0.07 * shown.half_m if shown else 0.045 * whole_m
        size_m *= choose_turtle_size(len(drawn))
        plots.config["planes"].append({"turtles": turtles.id, "size": size_m})
    plots.config["trails"] = trails.id


def _draw_still(figure: Any, drawn: Sequence[Drawn], shown: CloseUp | None) -> list[Any]:
    """Draw the static parts; return the artists that the view must contain."""
    still = []
    if shown is None and plane_scene.is_in_world([one.run for one in drawn]):
        still.append(
            figure.quad(
                left=[0.0], right=[WORLD_SIZE_M], bottom=[0.0], top=[WORLD_SIZE_M],
                fill_alpha=0.0, line_color=RING,
            )
        )  # fmt: skip
    for path in plane_scene.list_paths([one.run for one in drawn]):
        x_m, y_m = plane_scene.outline_path(path).T
        figure.line(store(x_m), store(y_m), color=RING, alpha=0.5, line_width=5)
    goals = plane_scene.list_goals([one.run for one in drawn])
    if len(goals):
        cross = figure.scatter(*goals.T, marker="cross", size=16, color=RING, line_width=2.5)
        still += [] if shown else [cross]
    if shown is not None:
        (x, y), half_m = shown.goal_xy_m, shown.half_m
        still.append(
            figure.quad(
                left=[x - half_m], right=[x + half_m], bottom=[y - half_m], top=[y + half_m],
                fill_alpha=0.0, line_alpha=0.0,
            )
        )  # fmt: skip
        for ring_m, ring in zip(shown.rings_m, shown.list_rings(), strict=True):
            figure.line(*ring.T, color=RING, alpha=0.6)
            figure.text(
                [x], [y + ring_m], text=[format_length(ring_m)], text_color=RING,
                text_font_size="11px", text_align="center", text_baseline="bottom",
            )  # fmt: skip
    return still


def _draw_many_ends(figure: Any, drawn: Sequence[Drawn]) -> None:
    """Draw the ends of runs, and for each gain the median and an outline of 90 % of its ends."""
    colors = [to_hex(one.color) for one in drawn]
    x_m, y_m = np.array([one.run.poses.xy_m[-1] for one in drawn]).T
    figure.scatter(x_m, y_m, size=5, color=colors)
    for group in many_runs.find_gain_ends([one.run for one in drawn]):
        color = colors[group.middle_run]
        figure.line(
            *group.around_xy_m.T, color=color, line_width=1.5,
            legend_label=many_runs.OUTLINE_LABEL,
        )  # fmt: skip
        figure.scatter(
            *group.median_xy_m.reshape(2, 1), marker="diamond", size=13, line_color="white",
            fill_color=color, legend_label=many_runs.MEDIAN_LABEL,
        )  # fmt: skip


def _draw_ends(figure: Any, drawn: Sequence[Drawn], shown: CloseUp) -> None:
    """Draw a dot at the end of each run. The nearest and the furthest end have their distance."""
    ends = shown.ends
    colors = [to_hex(drawn[end.run].color) for end in ends]
    x_m, y_m = zip(*(end.xy_m for end in ends), strict=True)
    figure.scatter(x_m, y_m, size=9, color=colors)
    some = ends if len(ends) <= _MOST_TOLD else (ends[0], ends[-1])
    # Texts within 8 % of the view's height would overlap.
    near_m = 0.16 * shown.half_m
    told = [
        end
        for number, end in enumerate(some)
        if not any(abs(end.xy_m[1] - other.xy_m[1]) < near_m for other in some[:number])
    ]
    for number, end in enumerate(told):
        # The nearest is labelled on the left, all others on the right: turtles come from one side.
        is_left = number == 0 and len(told) > 1
        figure.text(
            [end.xy_m[0]], [end.xy_m[1]], text=[format_length(end.miss_m)], y_offset=-4,
            x_offset=-14 if is_left else 14, text_align="right" if is_left else "left",
            text_color=to_hex(drawn[end.run].color), text_font_size="13px",
            text_font_style="bold",
        )  # fmt: skip


MOST_VIOLATIONS: Final = 6  # failed checks with a plot; the table lists all failed checks

RED: Final = to_hex(VIOLATION)

_CLOSE: Final = 0.3
"""Distance between two moments, as a share of the width, below which their texts would overlap."""


def draw_violations(
    plots: Plots, found: Sequence[tuple[ViolatedSignal, Color | None]], x_range: Any
) -> None:
    """Draw failed checks' signals on the common time axis, at `violation-0`, `violation-1` ..."""
    for number, (violated, color) in enumerate(found[:MOST_VIOLATIONS]):
        _draw_violation(plots, f"violation-{number}", violated, color or MAIN, x_range)


def _draw_violation(
    plots: Plots, place: str, violated: ViolatedSignal, color: Color, x_range: Any
) -> None:
    models = load_library("bokeh.models")
    shown = violated.find_range()
    low, high = shown.low, shown.high
    title = violated.title.replace("_", " ")
    title = f"{title}, {shown.note}" if shown.note else title
    figure = make_figure(
        plots, place, title, x_range=x_range, height=260, y_range=models.Range1d(low, high),
        x_axis_label="time from the first sample [s]",
    )  # fmt: skip
    _draw_band(figure, violated, (low, high), x_range.end)
    curve = violated.curve
    draw = partial(figure.step, mode="after") if curve.holds else figure.line
    time_s, values = thin(plots, [curve.time_s, curve.values], curve.values)
    draw(time_s, values, color=to_hex(color), line_width=1.8)
    is_red = violated.outside.copy()
    if curve.holds:
        is_red[1:] |= violated.outside[:-1]
    red = np.where(is_red, curve.values, np.nan)
    time_s, red = thin(plots, [curve.time_s, red], red)
    draw(time_s, red, color=RED, line_width=3.5)
    _name_moments(plots, figure, violated, (low, high), x_range.end)
    add_cursor(plots, figure)
    tips = [("time", "$x{0.000} s"), (violated.name, f"$y{{0.0000}} {violated.unit}")]
    figure.add_tools(models.CrosshairTool(overlay=plots.crosshair))
    figure.add_tools(models.HoverTool(tooltips=tips, line_policy="nearest"))


def add_cursor(plots: Plots, figure: Any) -> None:
    """Add the line at the time of the slider to a plot over time."""
    span = load_library("bokeh.models").Span
    cursor = span(location=0.0, dimension="height", line_color=RING, line_width=1)
    figure.add_layout(cursor)
    plots.config["cursors"].append(cursor.id)


def _draw_band(
    figure: Any, violated: ViolatedSignal, height: tuple[float, float], end_s: float
) -> None:
    """Shade the allowed band over its time, and name its limits."""
    time_s = violated.curve.time_s
    whole = np.ones(len(time_s))
    ends = {"low": violated.low, "high": violated.high}
    below, above = (
        whole * edge if end is None else end
        for edge, end in zip(height, ends.values(), strict=True)
    )
    asked = np.isfinite(below) & np.isfinite(above)
    if asked.any():
        nowhere = np.where(asked, 0.0, np.nan)
        figure.varea(
            store(time_s), store(below + nowhere), store(above + nowhere),
            fill_color=to_hex(ALLOWED), fill_alpha=0.13,
        )  # fmt: skip
    if violated.reference is not None:
        figure.line(store(time_s), store(violated.reference), color=RING)
    for side, name in violated.describe_limits().items():
        end = ends[side]
        if end is None:
            continue
        figure.line(
            store(time_s), store(end), color=to_hex(ALLOWED), line_dash="dashed", line_width=1.6
        )
        known = np.flatnonzero(np.isfinite(end))
        if len(known):
            row = known[0]
            # If the band begins late, its name would leave the plot on the right.
            is_late = time_s[row] > 0.7 * end_s
            figure.text(
                [time_s[row]], [end[row]], text=[name], text_color=to_hex(ALLOWED),
                text_font_size="12px", x_offset=-4 if is_late else 4,
                text_align="right" if is_late else "left", y_offset=-2 if side == "high" else 2,
                text_baseline="bottom" if side == "high" else "top",
            )  # fmt: skip


def _name_moments(
    plots: Plots,
    figure: Any,
    violated: ViolatedSignal,
    height: tuple[float, float],
    end_s: float,
) -> None:
    """Mark the worst and the first moment, named on the side that has more room."""
    named = [(violated.worst, violated.worst_word)]
    if violated.first != violated.worst:
        named.append((violated.first, "first"))
    # A violation is an extreme: there is room beyond it, and less on the other side.
    is_above = violated.worst.value >= sum(height) / 2.0
    is_close = abs(violated.first.time_s - violated.worst.time_s) < _CLOSE * end_s
    for moment, word in named:
        if word == "first" and is_close:
            is_above = not is_above
        figure.scatter(
            [moment.time_s], [moment.value], size=10, color=RED, line_color="white",
            marker="circle" if word != "first" else "inverted_triangle",
        )  # fmt: skip
        is_late = moment.time_s > 0.5 * end_s
        words = figure.text(
            [moment.time_s], [moment.value], text=[violated.describe_moment(moment, word)],
            text_color=RED, text_font_size="13px", text_font_style="bold",
            text_align="right" if is_late else "left", x_offset=-6 if is_late else 6,
            y_offset=-9 if is_above else 9, text_baseline="bottom" if is_above else "top",
        )  # fmt: skip
        plots.config["words"].append(words.glyph.id)


_MOST_NAMED: Final = 6
"""Largest number of runs that are described one by one; with more, a listener forgets the first."""


def describe_plot(title: str, curves: Sequence[tuple[str, Values]]) -> str:
    """Describe a plot over time by each run's start, end and range; NaN is a gap."""
    finite = [(name, values[np.isfinite(values)]) for name, values in curves]
    known = [(name, values) for name, values in finite if len(values)]
    if not known:
        return f"{title}: no values."
    if len(known) <= _MOST_NAMED:
        said = [
            f"{name}: from {_write(values[0])} to {_write(values[-1])}, {_write_range(values)}"
            for name, values in known
        ]
        return f"{title} over time. {'; '.join(said)}."
    values = np.concatenate([values for _, values in known])
    return f"{title} over time of {describe_count(len(known), 'run')}, {_write_range(values)}."


def _write_range(values: Values) -> str:
    return f"between {_write(values.min())} and {_write(values.max())}"


def _write(value: float) -> str:
    return f"{value + 0.0:.4g}"  # + 0.0: no negative zero


def describe_plane(title: str, ends: Sequence[tuple[str, Values]]) -> str:
    """Return a description of a plane: start and end of each run with its poses [m]."""
    if len(ends) > _MOST_NAMED:
        return f"{title}: the paths of {describe_count(len(ends), 'run')} in the plane."
    said = [
        f"{name} drives from {_write_place(xy_m[0])} to {_write_place(xy_m[-1])} m"
        for name, xy_m in ends
    ]
    return f"{title}. {'; '.join(said)}."


def _write_place(xy_m: Values) -> str:
    return f"({xy_m[0]:.4g}, {xy_m[1]:.4g})"
