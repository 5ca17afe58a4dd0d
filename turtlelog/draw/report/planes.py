"""The plane of a report, and the close-up of the goal, with turtles moved by the slider."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from turtlelog.charts.captions import describe_plane
from turtlelog.charts.close_up import CloseUp, format_length
from turtlelog.charts.palette import choose_turtle_size, to_hex
from turtlelog.charts.plane_scene import (
    MEDIAN_LABEL,
    OUTLINE_LABEL,
    find_gain_ends,
    has_grey_paths,
    is_in_world,
    list_goals,
)
from turtlelog.charts.robot_curves import find_break_rows, part_path
from turtlelog.charts.tracked_path import list_paths, outline_path
from turtlelog.draw.report.drawn import RING, Drawn, Plots, make_figure, store, thin
from turtlelog.libraries import load_library
from turtlelog.plants.turtlesim import WORLD_SIZE_M

_MOST_NAMED: Final = 4
"""Largest number of ends with distances; with more ends, distances would hide each other."""


def draw_planes(plots: Plots, drawn: Sequence[Drawn], close_up: CloseUp | None) -> None:
    """Draw the plane, and the close-up of the goal if there is one."""
    models = load_library("bokeh.models")
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
    is_grey = has_grey_paths([one.run for one in drawn])
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
        size_m = 0.07 * shown.half_m if shown else 0.045 * _measure_size(drawn)
        size_m *= choose_turtle_size(len(drawn))
        plots.config["planes"].append({"turtles": turtles.id, "size": size_m})
    plots.config["trails"] = trails.id


def _measure_size(drawn: Sequence[Drawn]) -> float:
    if is_in_world([one.run for one in drawn]):
        return WORLD_SIZE_M
    places = np.concatenate([one.run.poses.xy_m for one in drawn])
    return max(float(np.ptp(places, axis=0).max()), 0.1)


def _draw_still(figure: Any, drawn: Sequence[Drawn], shown: CloseUp | None) -> list[Any]:
    """Draw the static parts; return the artists that the view must contain."""
    still = []
    if shown is None and is_in_world([one.run for one in drawn]):
        still.append(
            figure.quad(
                left=[0.0], right=[WORLD_SIZE_M], bottom=[0.0], top=[WORLD_SIZE_M],
                fill_alpha=0.0, line_color=RING,
            )
        )  # fmt: skip
    for path in list_paths([one.run for one in drawn]):
        x_m, y_m = outline_path(path).T
        figure.line(store(x_m), store(y_m), color=RING, alpha=0.5, line_width=5)
    goals = list_goals([one.run for one in drawn])
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
        _draw_rings(figure, shown)
    return still


def _draw_rings(figure: Any, shown: CloseUp) -> None:
    x, y = shown.goal_xy_m
    for ring_m, ring in zip(shown.rings_m, shown.list_rings(), strict=True):
        figure.line(*ring.T, color=RING, alpha=0.6)
        figure.text(
            [x], [y + ring_m], text=[format_length(ring_m)], text_color=RING,
            text_font_size="11px", text_align="center", text_baseline="bottom",
        )  # fmt: skip


def _draw_many_ends(figure: Any, drawn: Sequence[Drawn]) -> None:
    """Draw the ends of runs, and for each gain the median and an outline of 90 % of its ends."""
    colors = [to_hex(one.color) for one in drawn]
    x_m, y_m = np.array([one.run.poses.xy_m[-1] for one in drawn]).T
    figure.scatter(x_m, y_m, size=5, color=colors)
    for group in find_gain_ends([one.run for one in drawn]):
        color = colors[group.middle_run]
        figure.line(*group.around_xy_m.T, color=color, line_width=1.5, legend_label=OUTLINE_LABEL)
        figure.scatter(
            *group.median_xy_m.reshape(2, 1), marker="diamond", size=13, line_color="white",
            fill_color=color, legend_label=MEDIAN_LABEL,
        )  # fmt: skip


def _draw_ends(figure: Any, drawn: Sequence[Drawn], shown: CloseUp) -> None:
    """Draw a dot at the end of each run. The nearest and the furthest end have their distance."""
    ends = shown.ends
    colors = [to_hex(drawn[end.run].color) for end in ends]
    x_m, y_m = zip(*(end.xy_m for end in ends), strict=True)
    figure.scatter(x_m, y_m, size=9, color=colors)
    some = ends if len(ends) <= _MOST_NAMED else (ends[0], ends[-1])
    told = [one for n, one in enumerate(some) if not _is_near(one, some[:n], shown)]
    for number, end in enumerate(told):
        # The nearest is labelled on the left, all others on the right: turtles come from one side.
        is_left = number == 0 and len(told) > 1
        figure.text(
            [end.xy_m[0]], [end.xy_m[1]], text=[format_length(end.miss_m)], y_offset=-4,
            x_offset=-14 if is_left else 14, text_align="right" if is_left else "left",
            text_color=to_hex(drawn[end.run].color), text_font_size="13px",
            text_font_style="bold",
        )  # fmt: skip


def _is_near(end: Any, others: Sequence[Any], shown: CloseUp) -> bool:
    """Return whether the text of an end would overlap another: within 8 % of the view's height."""
    return any(abs(end.xy_m[1] - other.xy_m[1]) < 0.16 * shown.half_m for other in others)
