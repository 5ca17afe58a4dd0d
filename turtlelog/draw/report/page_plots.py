"""The plots of a report, as models of Bokeh, and what the script of the page must know of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from turtlelog.charts.characteristics import (
    ALONG_ERROR,
    TO_REFERENCE,
    Characteristic,
    list_characteristics,
    read_marked_curve,
)
from turtlelog.charts.close_up import find_close_up
from turtlelog.charts.robot_curves import part_curve
from turtlelog.charts.shared_curves import (
    Curve,
    Values,
    find_unit,
    list_aims,
    list_levels,
    read_applied,
    read_command,
    read_curve,
)
from turtlelog.charts.state_groups import group_states
from turtlelog.charts.violated_signal import ViolatedSignal
from turtlelog.draw.report.drawn import (
    MOST_POINTS,
    RING,
    Drawn,
    Plots,
    make_figure,
    thin,
    to_hex,
)
from turtlelog.draw.report.marked_plots import draw_marks
from turtlelog.draw.report.planes import draw_planes
from turtlelog.draw.report.violation_plots import RED, draw_violations
from turtlelog.libraries import load_library
from turtlelog.measure import Metric, list_signals
from turtlelog.run import Run

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
    "x": "x",
    "y": "y",
    "along_track": "along the track",
    ALONG_ERROR: "behind the reference along the track",
    TO_REFERENCE: "distance to the reference",
}
_IF_MOVING: Final = ("x", "y", "along_track")
"""Plotted where what they should be moves."""

_DERIVED: Final = (ALONG_ERROR, TO_REFERENCE)
_MOST_STATES: Final = 6
_MOST_TIPS: Final = 6
"""States of a law that have a plot: a page of more would be skimmed."""

_RARE: Final = 1e-3
"""Share of rows that may be left out of view at either end: faults of a sensor are single ones."""

_FAR_OFF: Final = 20.0
"""Times the height of all other rows: with more, those would take less than a twentieth of it."""


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
            {"name": one.name, "color": to_hex(one.color), "ghost": one.is_ghost} for one in drawn
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
    """Return what is plotted over time: signals, what follows a reference that moves, states."""
    names = [name for name in _ALWAYS if any(_read(run, name) is not None for run in runs)]
    names += [name for name in _IF_MOVING if any(list_aims(run, name) for run in runs)]
    names += [name for name in _DERIVED if any(_read(run, name) is not None for run in runs)]
    lawless = [run for run in runs if not len(run.samples)]
    for name in ("measured_speed", "measured_turn_rate"):
        if any(read_curve(run, name) is not None for run in lawless):
            names.append(name)
    groups = group_states(*(run.declaration for run in runs))
    states = [name for group in groups for name in group.names]
    return names + [name for name in states if _moves(runs, name)][:_MOST_STATES]


def _moves(runs: Sequence[Run], state: str) -> bool:
    """Whether a state of a law is ever anything but 0."""
    curves = [_read(run, state) for run in runs if state in run.declaration.states]
    return any(curve is not None and bool(np.any(curve.values)) for curve in curves)


def _read(run: Run, signal: str) -> Curve | None:
    """Return a signal; of a robot that recorded no commands what its plant applied."""
    if signal == "speed":
        return read_command(run, "speed") or read_applied(run, "speed")
    if signal == "turn_rate":
        return read_command(run, "turn_rate") or read_applied(run, "turn_rate")
    if signal in _DERIVED:
        return read_marked_curve(run, signal)
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
    title = _TITLES.get(signal, f"state {signal}").replace("_", " ")
    unit = _find_unit([one.run for one in drawn], signal)
    measured = f"{title} [{unit}]" if unit else title
    figure = make_figure(
        plots, f"plot-{signal}", measured, x_range=x_range, height=230,
        x_axis_label="time from the first sample [s]",
    )  # fmt: skip
    config: dict[str, Any] = {"title": measured, "curves": []}
    plots.config["plots"].append(config)
    levels = {level for one in drawn for level in list_levels(one.run, signal)}
    for level in sorted(levels, key=lambda found: found.value):
        figure.add_layout(
            models.Span(
                location=level.value, dimension="width", line_color=RING, line_dash="dashed"
            )
        )
    source = models.ColumnDataSource(data=_list_curves(plots, drawn, signal, config))
    config["source"] = source.id
    lines = figure.multi_line(
        "xs", "ys", source=source, color="color", line_width="width", line_dash="dash",
        line_alpha="alpha",
    )  # fmt: skip
    _keep_in_view(figure, source.data["ys"])
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
    tips = [("", "@name"), ("time", "$snap_x{0.000} s"), (title, f"$snap_y{{0.0000}} {unit}")]
    # Of few curves all are read at the cursor, of more the one under it: tips would hide the plot.
    mode = "vline" if len(config["curves"]) <= _MOST_TIPS else "mouse"
    figure.add_tools(
        models.HoverTool(renderers=[lines], tooltips=tips, line_policy="nearest", mode=mode),
        models.CrosshairTool(overlay=plots.crosshair),
    )


def _list_curves(
    plots: Plots, drawn: Sequence[Drawn], signal: str, config: dict[str, Any]
) -> dict[str, list[Any]]:
    """Return the curves of a signal, each a row: aims that move first, so that they lie below.

    Curves that hold are stored as they are: the page's script turns them into steps.
    """
    data: dict[str, list[Any]] = {
        key: [] for key in ("xs", "ys", "color", "name", "dash", "width", "alpha")
    }

    def add(curve: Curve, number: int, *, is_aim: bool) -> None:
        one = drawn[number]
        time_s, values = thin(plots, [curve.time_s, curve.values], curve.values)
        row = {
            "xs": time_s,
            "ys": values,
            "color": to_hex(one.color),
            "name": f"{one.name}: {curve.label}" if is_aim else one.name,
            "dash": "dashed" if one.is_ghost or is_aim else "solid",
            "width": 1.2 if one.is_ghost or is_aim else 1.8,
            "alpha": 0.6 if is_aim else 1.0,
        }
        for key, value in row.items():
            data[key].append(value)
        # Between rows that are left out a value does not hold: steps would show what never was.
        holds = curve.holds and len(time_s) == len(curve.values)
        config["curves"].append({"run": number, "holds": holds, "aim": is_aim})

    for number, one in enumerate(drawn):
        aims = list_aims(one.run, signal) if one.is_plotted and not one.is_ghost else []
        for aim in aims:
            add(aim, number, is_aim=True)
    for number, one in enumerate(drawn):
        curve = _read(one.run, signal) if one.is_plotted else None
        if curve is not None:
            add(curve, number, is_aim=False)
    return data


def _find_unit(runs: Sequence[Run], signal: str) -> str:
    """Return the unit of a plot; empty of states, whose unit nobody declares."""
    if signal in _DERIVED:
        return "m"
    known = [run for run in runs if signal in list_signals(run.declaration)]
    unit = find_unit(known[0], signal) if known else ""
    return "" if unit == "1" else unit


def _keep_in_view(figure: Any, curves: Sequence[Values]) -> None:
    """Leave a few rows far outside of all others out of view, and say so in the title."""
    values = np.concatenate([*curves, np.empty(0)])
    values = values[np.isfinite(values)]
    if not len(values):
        return
    rest = np.quantile(values, [_RARE, 1.0 - _RARE])
    room = float(np.ptp(rest))
    whole = float(np.ptp(values))
    if room == 0.0 or whole < _FAR_OFF * room:
        return
    figure.y_range = load_library("bokeh.models").Range1d(
        float(rest[0]) - 0.1 * room, float(rest[1]) + 0.1 * room
    )
    far = float(values[np.abs(values - rest.mean()).argmax()])
    figure.title.text += f", close up: single values go to {far:.4g}"
