"""The plots of a report, as models of Bokeh, and what the script of the page must know of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.libraries import load_library
from turtlelog.measure import Metric
from turtlelog.plants.turtlesim import WORLD_SIZE_M
from turtlelog.run import Run
from turtlelog.show.characteristics import list_characteristics
from turtlelog.show.close_up import CloseUp, find_close_up, format_length
from turtlelog.show.palette import Color
from turtlelog.show.robot_curves import is_turtlesim, part_curve
from turtlelog.show.shared_curves import (
    Curve,
    choose_rows,
    find_unit,
    list_levels,
    read_applied,
    read_command,
    read_curve,
)
from turtlelog.show.tracked_path import list_paths, outline_path

MOST_POINTS: Final = 2000
"""Of a curve: wider than a screen has columns, so that what is left out is not seen before a zoom.
"""

_MOST_OF_ALL: Final = 24_000
"""Points of one signal over all runs: 12 runs have all of theirs; each costs 11 bytes of the file.
"""

_LEAST_POINTS: Final = 200
_FAR: Final = 1e3
"""From here on 32 bits no longer hold a tenth of a millimetre or millisecond: 64 do."""

_MOST_MARKED: Final = 4
"""Marks of more runs would hide each other."""

_ALWAYS: Final = ("heading", "distance", "cross_track", "speed", "turn_rate")
_TITLES: Final = {
    "heading": "heading",
    "distance": "distance to the goal",
    "cross_track": "cross-track error",
    "speed": "commanded speed",
    "turn_rate": "commanded turn rate",
    "measured_speed": "measured speed",
    "measured_turn_rate": "measured turn rate",
}
_MARKED: Final = {"rise_time", "overshoot", "settling_time"}
Violation = tuple[Sequence[str], float]
"""The signals that a check names, and when it is first violated [s]."""

_RED: Final = "#d0342c"
_RING: Final = "#8a8a8a"
_RING_POINTS: Final = 97


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drawn:
    """A run, or what it would have been, as it is drawn.

    Attributes:
        run: Its data.
        name: As the legend calls it.
        color: The same in every plot.
        is_ghost: Whether it is a what-if.
        is_plotted: Whether the plots over time show it, too.
    """

    run: Run
    name: str
    color: Color
    is_ghost: bool = False
    is_plotted: bool = True


@dataclass(slots=True, kw_only=True)
class Plots:
    """What stands in the page.

    Attributes:
        roots: Figures by the id of their place.
        config: For the script: ids of models, by what they are.
        thinned: How many curves are drawn with fewer points than were recorded.
        points: How many points a curve has at most.
    """

    roots: dict[str, Any] = field(default_factory=dict)
    config: dict[str, Any] = field(default_factory=dict)
    thinned: int = 0
    points: int = MOST_POINTS


def draw_plots(
    drawn: Sequence[Drawn],
    metrics: Sequence[Mapping[str, Metric]],
    violations_s: Sequence[Violation],
) -> Plots:
    """Return the plane, the close-up of the goal where there is one, and the plots over time.

    Args:
        drawn: Runs first, then ghosts.
        metrics: Of the runs.
        violations_s: Signals of checks, and when each is first violated.
    """
    plots = Plots(points=max(_LEAST_POINTS, min(MOST_POINTS, _MOST_OF_ALL // len(drawn))))
    plots.config = {
        "runs": [
            {"name": one.name, "color": to_hex(one.color), "ghost": one.is_ghost, "renderers": []}
            for one in drawn
        ],
        "plots": [],
        "planes": [],
        "marks": [],
        "cursors": [],
        "figures": [],
    }
    runs = [one.run for one in drawn]
    _draw_planes(plots, drawn, find_close_up(runs))
    end_s = max(float(one.run.duration_s) for one in drawn) or 1.0
    plots.config["end_s"] = end_s
    x_range = load_library("bokeh.models").Range1d(0.0, end_s, bounds=None)
    plots.config["x_range"] = x_range.id
    for signal in _choose_signals(runs):
        _draw_signal(plots, drawn, signal, x_range, (metrics, violations_s))
    return plots


def to_hex(color: Color) -> str:
    """Return a colour as HTML writes it."""
    return "#{:02x}{:02x}{:02x}".format(*color)


def _choose_signals(runs: Sequence[Run]) -> list[str]:
    names = [name for name in _ALWAYS if any(_read(run, name) is not None for run in runs)]
    lawless = [run for run in runs if not len(run.samples)]
    for name in ("measured_speed", "measured_turn_rate"):
        if any(read_curve(run, name) is not None for run in lawless):
            names.append(name)
    return names


def _read(run: Run, signal: str) -> Curve | None:
    """Return a signal; of a robot that recorded no commands what its plant applied."""
    if signal == "speed":
        return read_command(run, "speed") or read_applied(run, "speed")
    if signal == "turn_rate":
        return read_command(run, "turn_rate") or read_applied(run, "turn_rate")
    curve = read_curve(run, signal)
    return None if curve is None else part_curve(run, curve)


def _thin(plots: Plots, columns: Sequence[NDArray[Any]], kept: NDArray[Any]) -> list[NDArray[Any]]:
    """Return columns with the rows that draw the same, as small as they may be stored."""
    rows = choose_rows(kept, plots.points)
    plots.thinned += rows is not None
    found = [np.asarray(column if rows is None else column[rows]) for column in columns]
    return [_store(column) for column in found]


def _store(values: NDArray[Any]) -> NDArray[Any]:
    largest = np.abs(values[np.isfinite(values)]).max(initial=0.0)
    return np.asarray(values, dtype=np.float32 if largest < _FAR else np.float64)


def _make_figure(plots: Plots, place: str, title: str, **options: Any) -> Any:
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
    figure.title.text_font_size = "14px"
    plots.roots[place] = figure
    plots.config["figures"].append(figure.id)
    return figure


def _draw_planes(plots: Plots, drawn: Sequence[Drawn], close_up: CloseUp | None) -> None:
    models = load_library("bokeh.models")
    sources = []
    for number, one in enumerate(drawn):
        poses = one.run.poses
        columns = [
            (poses.time_ns - one.run.start_ns) / 1e9,
            *poses.xy_m.T,
            np.unwrap(poses.heading_rad),
        ]
        kept = np.column_stack([poses.xy_m, columns[3]])
        stored = dict(zip("txyh", _thin(plots, columns, kept), strict=True))
        sources.append(models.ColumnDataSource(data=stored))
        plots.config["runs"][number]["pose"] = sources[-1].id
    trails = models.ColumnDataSource(data={"xs": [], "ys": [], "color": [], "alpha": []})
    views: list[tuple[str, str, CloseUp | None]] = [("plane", "The way", None)]
    views += [] if close_up is None else [("goal", f"At the goal, {close_up.describe()}", close_up)]
    for place, title, shown in views:
        figure = _make_figure(
            plots, place, title, match_aspect=True, height=430, x_axis_label="x [m]",
            y_axis_label="y [m]",
        )  # fmt: skip
        figure.toolbar.active_scroll = None
        still = _draw_still(figure, drawn, shown)
        for number, (one, source) in enumerate(zip(drawn, sources, strict=True)):
            line = figure.line(
                "x", "y", source=source, color=to_hex(one.color), alpha=0.35, line_width=1.2,
                line_dash="dashed" if one.is_ghost else "solid", name=one.name,
            )  # fmt: skip
            plots.config["runs"][number]["renderers"].append(line.id)
            still += [] if shown else [line]
        figure.multi_line("xs", "ys", source=trails, color="color", alpha="alpha", line_width=2.5)
        turtles = models.ColumnDataSource(data={"xs": [], "ys": [], "color": [], "alpha": []})
        figure.patches(
            "xs", "ys", source=turtles, fill_color="color", fill_alpha="alpha",
            line_color="color", line_width=1.5,
        )  # fmt: skip
        if shown is not None:
            _draw_ends(figure, drawn, shown)
        figure.x_range.renderers = figure.y_range.renderers = still
        size_m = 0.07 * shown.half_m if shown else 0.045 * _measure_size(drawn)
        plots.config["planes"].append({"turtles": turtles.id, "size": size_m})
    plots.config["trails"] = trails.id


def _measure_size(drawn: Sequence[Drawn]) -> float:
    if _are_in_world(drawn):
        return WORLD_SIZE_M
    places = np.concatenate([one.run.poses.xy_m for one in drawn])
    return max(float(np.ptp(places, axis=0).max()), 0.1)


def _are_in_world(drawn: Sequence[Drawn]) -> bool:
    return all(
        is_turtlesim(one.run)
        and one.run.poses.xy_m.min() >= 0.0
        and one.run.poses.xy_m.max() <= WORLD_SIZE_M
        for one in drawn
    )


def _draw_still(figure: Any, drawn: Sequence[Drawn], shown: CloseUp | None) -> list[Any]:
    """Draw what does not move, and return what the view must hold."""
    still = []
    if shown is None and _are_in_world(drawn):
        still.append(
            figure.quad(
                left=[0.0], right=[WORLD_SIZE_M], bottom=[0.0], top=[WORLD_SIZE_M],
                fill_alpha=0.0, line_color=_RING,
            )
        )  # fmt: skip
    for path in list_paths([one.run for one in drawn]):
        x_m, y_m = outline_path(path).T
        figure.line(_store(x_m), _store(y_m), color=_RING, alpha=0.5, line_width=5)
    goals = sorted({one.run.goal_xy_m for one in drawn if one.run.goal_xy_m is not None})
    if goals:
        x_m, y_m = zip(*goals, strict=True)
        cross = figure.scatter(x_m, y_m, marker="cross", size=16, color=_RING, line_width=2.5)
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
    (x, y), turns = shown.goal_xy_m, np.linspace(0.0, 2.0 * np.pi, _RING_POINTS)
    for ring_m in shown.rings_m:
        figure.line(x + ring_m * np.cos(turns), y + ring_m * np.sin(turns), color=_RING, alpha=0.6)
        figure.text(
            [x], [y + ring_m], text=[format_length(ring_m)], text_color=_RING,
            text_font_size="11px", text_align="center", text_baseline="bottom",
        )  # fmt: skip


def _draw_ends(figure: Any, drawn: Sequence[Drawn], shown: CloseUp) -> None:
    """Draw a dot where each run ends; the nearest and the furthest say how far that is."""
    ends = shown.ends
    colors = [to_hex(drawn[end.run].color) for end in ends]
    x_m, y_m = zip(*(end.xy_m for end in ends), strict=True)
    figure.scatter(x_m, y_m, size=9, color=colors)
    some = ends if len(ends) <= _MOST_MARKED else (ends[0], ends[-1])
    told = [one for n, one in enumerate(some) if not _is_near(one, some[:n], shown)]
    for number, end in enumerate(told):
        # The nearest on the left, all others on the right: turtles come from one side.
        is_left = number == 0 and len(told) > 1
        figure.text(
            [end.xy_m[0]], [end.xy_m[1]], text=[format_length(end.miss_m)], y_offset=-4,
            x_offset=-14 if is_left else 14, text_align="right" if is_left else "left",
            text_color=to_hex(drawn[end.run].color), text_font_size="13px",
            text_font_style="bold",
        )  # fmt: skip


def _is_near(end: Any, others: Sequence[Any], shown: CloseUp) -> bool:
    """Whether its words would stand on those of another end: within 8 % of the view's height."""
    return any(abs(end.xy_m[1] - other.xy_m[1]) < 0.16 * shown.half_m for other in others)


def _draw_signal(
    plots: Plots,
    drawn: Sequence[Drawn],
    signal: str,
    x_range: Any,
    marked: tuple[Sequence[Mapping[str, Metric]], Sequence[Violation]],
) -> None:
    models = load_library("bokeh.models")
    title, unit = _TITLES[signal], find_unit(drawn[0].run, signal)
    figure = _make_figure(
        plots, f"plot-{signal}", f"{title} [{unit}]", x_range=x_range, height=230,
        x_axis_label="time from the first sample [s]",
    )  # fmt: skip
    figure.y_range.only_visible = True
    config: dict[str, Any] = {"title": title, "unit": unit, "curves": []}
    plots.config["plots"].append(config)
    levels = {level for one in drawn for level in list_levels(one.run, signal)}
    for level in sorted(levels, key=lambda found: found.value):
        figure.add_layout(
            models.Span(
                location=level.value, dimension="width", line_color=_RING, line_dash="dashed"
            )
        )
    for number, one in enumerate(drawn):
        curve = _read(one.run, signal) if one.is_plotted else None
        if curve is None:
            continue
        time_s, values = _thin(plots, [curve.time_s, curve.values], curve.values)
        source = models.ColumnDataSource(data={"t": time_s, "v": values})
        looks = {
            "color": to_hex(one.color), "line_width": 1.2 if one.is_ghost else 1.8,
            "line_dash": "dashed" if one.is_ghost else "solid", "name": one.name, "source": source,
        }  # fmt: skip
        line = figure.step("t", "v", mode="after", **looks) if curve.holds else figure.line(
            "t", "v", **looks
        )  # fmt: skip
        plots.config["runs"][number]["renderers"].append(line.id)
        config["curves"].append({"run": number, "source": source.id, "holds": curve.holds})
    _draw_marks(plots, figure, drawn, signal, marked[0])
    for signals, at_s in marked[1]:
        if signal not in signals and not set(signals).isdisjoint(_TITLES):
            continue
        figure.add_layout(
            models.Span(location=at_s, dimension="height", line_color=_RED, line_dash="dotted",
                        line_width=2)
        )  # fmt: skip
    cursor = models.Span(location=0.0, dimension="height", line_color=_RING, line_width=1)
    figure.add_layout(cursor)
    plots.config["cursors"].append(cursor.id)
    figure.add_tools(
        models.HoverTool(
            tooltips=[("run", "$name"), ("time", "$x{0.000} s"), (title, f"$y{{0.0000}} {unit}")],
            line_policy="nearest",
        ),
        models.CrosshairTool(dimensions="height", line_alpha=0.5),
    )


def _draw_marks(
    plots: Plots,
    figure: Any,
    drawn: Sequence[Drawn],
    signal: str,
    metrics: Sequence[Mapping[str, Metric]],
) -> None:
    """Mark rise, overshoot and settling of the loops that control a signal, of a few runs."""
    if len(metrics) > _MOST_MARKED:
        return
    for number, known in enumerate(metrics):
        color = to_hex(drawn[number].color)
        for found in list_characteristics(drawn[number].run, known):
            if found.signal != signal or found.kind not in _MARKED:
                continue
            text = f"{drawn[number].name}: {found.word} {found.value:.3g} {found.unit}"
            mark = figure.scatter(
                [found.at_s], [found.level], size=9, name=text, line_width=1.8, line_color=color,
                marker="diamond" if found.kind == "overshoot" else "circle",
                fill_color=color, fill_alpha=0.25,
            )  # fmt: skip
            plots.config["marks"].append({"run": number, "renderer": mark.id, "text": text})
