"""The plots of a report, as models of Bokeh, and what the script of the page must know of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from turtlelog.libraries import load_library
from turtlelog.measure import Metric
from turtlelog.run import Run
from turtlelog.show.characteristics import Characteristic, list_characteristics
from turtlelog.show.close_up import find_close_up
from turtlelog.show.report.drawn import (
    MOST_POINTS,
    RING,
    Drawn,
    Plots,
    make_figure,
    thin,
    to_hex,
)
from turtlelog.show.report.marked_plots import draw_marks
from turtlelog.show.report.planes import draw_planes
from turtlelog.show.report.violation_plots import RED, draw_violations
from turtlelog.show.robot_curves import part_curve
from turtlelog.show.shared_curves import (
    Curve,
    find_unit,
    list_levels,
    read_applied,
    read_command,
    read_curve,
)
from turtlelog.show.violated_signal import ViolatedSignal

_MOST_OF_ALL: Final = 24_000
"""Points of one signal over all runs: 12 runs have all of theirs; each costs 11 bytes of the file.
"""

_LEAST_POINTS: Final = 200
_ROOM: Final = 0.012
"""Of the time, before and behind it: dots at its ends are seen whole."""

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Violation:
    """Where a check fails.

    Attributes:
        names: The signals that it names.
        first_s: When it is first violated [s], None where at no moment.
        run: Number of its run; None where it is of no run that is shown.
        signal: What is drawn of it; None where there is none.
    """

    names: tuple[str, ...]
    first_s: float | None
    run: int | None = None
    signal: ViolatedSignal | None = None


def draw_plots(
    drawn: Sequence[Drawn],
    metrics: Sequence[Mapping[str, Metric]],
    violations: Sequence[Violation],
) -> Plots:
    """Return the plane, the close-up of the goal where there is one, and the plots over time.

    Args:
        drawn: Runs first, then ghosts.
        metrics: Of the runs.
        violations: Where checks fail.
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
        "words": [],
    }
    runs = [one.run for one in drawn]
    draw_planes(plots, drawn, find_close_up(runs))
    end_s = max(float(one.run.duration_s) for one in drawn) or 1.0
    plots.config["end_s"] = end_s
    x_range = load_library("bokeh.models").Range1d(
        -_ROOM * end_s, (1.0 + _ROOM) * end_s, bounds=None
    )
    plots.config["x_range"] = x_range.id
    plots.config["room_s"] = _ROOM * end_s
    pairs = zip(runs, metrics, strict=False)
    marks = [list_characteristics(run, known) for run, known in pairs]
    for signal in _choose_signals(runs):
        _draw_signal(plots, drawn, signal, x_range, (marks, violations))
    found = [
        (one.signal, None if one.run is None else drawn[one.run].color)
        for one in violations
        if one.signal is not None
    ]
    draw_violations(plots, found, x_range)
    return plots


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


def _draw_signal(
    plots: Plots,
    drawn: Sequence[Drawn],
    signal: str,
    x_range: Any,
    marked: tuple[Sequence[Sequence[Characteristic]], Sequence[Violation]],
) -> None:
    models = load_library("bokeh.models")
    title, unit = _TITLES[signal], find_unit(drawn[0].run, signal)
    figure = make_figure(
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
                location=level.value, dimension="width", line_color=RING, line_dash="dashed"
            )
        )
    for number, one in enumerate(drawn):
        curve = _read(one.run, signal) if one.is_plotted else None
        if curve is None:
            continue
        time_s, values = thin(plots, [curve.time_s, curve.values], curve.values)
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
    draw_marks(plots, figure, drawn, signal, marked[0])
    for found in marked[1]:
        if signal not in found.names and not set(found.names).isdisjoint(_TITLES):
            continue
        if found.first_s is not None:
            figure.add_layout(
                models.Span(location=found.first_s, dimension="height", line_color=RED,
                            line_dash="dotted", line_width=2)
            )  # fmt: skip
    cursor = models.Span(location=0.0, dimension="height", line_color=RING, line_width=1)
    figure.add_layout(cursor)
    plots.config["cursors"].append(cursor.id)
    figure.add_tools(
        models.HoverTool(
            tooltips=[("run", "$name"), ("time", "$x{0.000} s"), (title, f"$y{{0.0000}} {unit}")],
            line_policy="nearest",
        ),
        models.CrosshairTool(dimensions="height", line_alpha=0.5),
    )
