"""Plots over time: the curves of each plot, its level lines, and its place. A curve is one entry.

Figures, Rerun, reports and movies draw these plots.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import Final

import numpy as np

from turtlelog.charts.curves import (
    Command,
    Curve,
    Level,
    find_limits,
    find_parameters,
    list_aims,
    list_levels,
    list_loops,
    read_applied,
    read_command,
    read_curve,
    read_distance_to_reference,
    read_sensed,
    select_curve_rows,
)
from turtlelog.charts.ideal_curves import compute_ideals
from turtlelog.charts.plane_scene import read_along_error
from turtlelog.charts.plotted_curves import Column, CurveEntry, CurveKind, TimePlot, find_state_unit
from turtlelog.charts.robot_curves import part_curve, read_measured
from turtlelog.run import Run
from turtlelog.run.loops import COMMAND_UNITS

_TOLERANCES: Final[Mapping[str, str]] = {
    "heading_error": "law.heading_tolerance_rad",
    "distance": "law.position_tolerance_m",
}

_LIMIT_LABEL: Final = "limit"


def find_plot(name: str, runs: Sequence[Run]) -> TimePlot:
    """Return a plot by its name; any other name is a state of the law of one of the runs."""
    return TIME_PLOTS.get(name) or _describe_state(name, runs)


def find_marked(signal: str) -> tuple[str, CurveEntry] | None:
    """Return the plot and curve on which a signal's characteristics are marked; None if missing."""
    for name, plot in TIME_PLOTS.items():
        for entry in plot.curves:
            if entry.signal == signal:
                return name, entry
    return None


def _read_one(read: Callable[[Run], Curve | None], run: Run) -> Iterator[Curve]:
    curve = read(run)
    if curve is not None and len(curve.values):
        yield curve


def _read_signal(run: Run, signal: str) -> Iterator[Curve]:
    curve = read_curve(run, signal)
    if curve is not None:
        yield part_curve(run, curve)


def _read_lost(run: Run, signal: str) -> Iterator[Curve]:
    """Yield the poses that a controller did not receive, if its sensed poses are shown."""
    curve = read_curve(run, signal)
    if curve is not None and read_sensed(run, signal) is not None and run.poses.dropped_out.any():
        yield select_curve_rows(curve, np.flatnonzero(run.poses.dropped_out))


def _read_rate(run: Run, command: Command, *, is_outlier: bool) -> Iterator[Curve]:
    measured = read_measured(run, command)
    if measured is None:
        return
    if not is_outlier:
        yield measured.curve
    elif len(measured.outliers.values):
        yield replace(measured.outliers, label=measured.name_outliers())


def _list_zero(_: Run) -> Iterator[Level]:
    yield Level(label="zero", value=0.0, kind="zero")


def _list_errors(run: Run, signal: str) -> Iterator[Level]:
    """Yield zero, and the tolerance within which an error counts as zero."""
    yield from _list_zero(run)
    for tolerance in find_parameters([run], _TOLERANCES[signal]):
        value = float(np.degrees(tolerance)) if signal == "heading_error" else tolerance
        yield Level(label="tolerance", value=value, kind="tolerance")


def _list_limits(run: Run, command: Command) -> Iterator[Level]:
    for limit in find_limits([run], command):
        for sign in (-1.0, 1.0):
            yield Level(label=_LIMIT_LABEL, value=sign * limit, kind="limit")


def _signal(signal: str, label: str) -> CurveEntry:
    return CurveEntry(
        kind="run", read=partial(_read_signal, signal=signal), label=label, signal=signal
    )


def _add(
    kind: CurveKind, name: str, read: Callable[[Run], Iterable[Curve]], label: str | None = None
) -> CurveEntry:
    """Return a curve with a name, which is also its label by default."""
    return CurveEntry(kind=kind, name=name, label=name if label is None else label, read=read)


def _ideal(signal: str) -> CurveEntry:
    return _add("ideal", "ideal", partial(compute_ideals, signal_name=signal))


def _aim(signal: str) -> CurveEntry:
    return _add("aim", "reference", partial(list_aims, signal=signal), label="")


def _sensed(signal: str) -> tuple[CurveEntry, ...]:
    """Return the signal that the controller read, and the poses that it did not receive."""
    return (
        _add("sensed", "sensed", partial(_read_one, partial(read_sensed, signal=signal))),
        _add("dropped_out", "dropped_out", partial(_read_lost, signal=signal), label="dropped"),
    )


def _plot_command(command: Command, title: str, place: tuple[Column, int]) -> TimePlot:
    """Return the plot of a command: commanded, applied and measured values."""
    # The plant publishes its speed without a sign.
    label = "|applied|" if command == "speed" else "applied"
    applied = partial(_read_one, partial(read_applied, command=command))
    rate = partial(_read_rate, command=command)
    return TimePlot(
        title=title,
        unit=COMMAND_UNITS[command],
        curves=(
            CurveEntry(
                kind="run",
                name="commanded",
                label="commanded",
                signal=command,
                read=partial(_read_one, partial(read_command, command=command)),
            ),
            _add("applied", "applied", applied, label),
            _add("measured", "measured", partial(rate, is_outlier=False)),
            _add("outlier", "outliers", partial(rate, is_outlier=True), label="outlier"),
        ),
        list_levels=partial(_list_limits, command=command),
        figure=command.replace("_", "-"),
        needs=command,
        place=place,
        report="always",
        command=command,
        is_filled=True,
    )


def _plot_wanted(command: Command, title: str, place: tuple[Column, int]) -> TimePlot:
    """Return the plot of a law's commands before clipping."""
    return TimePlot(
        title=f"wanted {title}",
        unit=COMMAND_UNITS[command],
        curves=(
            _add("shaped", "shaped", partial(_read_signal, signal=f"shaped_{command}")),
            _add("run", "wanted", partial(_read_signal, signal=f"wanted_{command}")),
        ),
        list_levels=partial(_list_limits, command=command),
        scale="symlog",
        figure=f"wanted-{command.replace('_', '-')}",
        needs=f"wanted_{command}",
        place=place,
        is_compared=False,
    )


def _plot_coordinate(axis: str) -> TimePlot:
    return TimePlot(
        title=axis,
        unit="m",
        curves=(*_sensed(axis), _aim(axis), _ideal(axis), _signal(axis, axis)),
        list_levels=partial(list_levels, signal=axis),
        figure="position",
        pair="position",
        place=("moving", 0),
        report="moving",
    )


def _plot_coordinate_error(axis: str) -> TimePlot:
    signal = f"error_{axis}"
    return TimePlot(
        title=f"error in {axis}",
        unit="m",
        curves=(_ideal(signal), _signal(signal, f"goal {axis} - {axis}")),
        list_levels=_list_zero,
        figure="position-error",
        needs="goal",
        pair="position_error",
        place=("moving", 0),
        is_compared=False,
    )


def _plot_world_velocity(axis: str) -> TimePlot:
    signal = f"world_velocity_{axis}"
    return TimePlot(
        title=f"Kp e{axis}",
        unit="m/s",
        curves=(_ideal(signal), _signal(signal, f"Kp e{axis}")),
        list_levels=_list_zero,
        figure="world-velocity",
        needs="world_velocity",
        pair="world_velocity",
        place=("moving", 2),
        is_compared=False,
    )


def _describe_state(name: str, runs: Sequence[Run]) -> TimePlot:
    return TimePlot(
        title=name,
        unit=find_state_unit(name, [run.declaration for run in runs]),
        curves=(_signal(name, name),),
        list_levels=_list_zero,
        needs="states",
        is_usual=False,
        report="always",
    )


TIME_PLOTS: Final[Mapping[str, TimePlot]] = MappingProxyType(
    {
        "heading": TimePlot(
            title="heading",
            unit="deg",
            curves=(
                *_sensed("heading"),
                _aim("heading"),
                _ideal("heading"),
                _signal("heading", "heading"),
            ),
            list_levels=partial(list_levels, signal="heading"),
            figure="heading",
            loop="heading",
            place=("turning", 0),
            report="always",
        ),
        "heading_error": TimePlot(
            title="heading error",
            unit="deg",
            curves=(_ideal("heading_error"), _signal("heading_error", "heading error")),
            list_levels=partial(_list_errors, signal="heading_error"),
            is_log=True,
            is_filled=True,
            figure="heading-error",
            needs="heading_error",
            loop="heading",
            place=("turning", 1),
        ),
        "turn_rate": _plot_command("turn_rate", "turn rate", ("turning", 2)),
        "wanted_turn_rate": _plot_wanted("turn_rate", "turn rate", ("turning", 2)),
        "along_track_error": TimePlot(
            title="along-track error",
            unit="m",
            curves=(
                CurveEntry(
                    kind="run",
                    label="reference - along-track",
                    signal="along_track_error",
                    read=partial(_read_one, read_along_error),
                ),
            ),
            list_levels=_list_zero,
            figure="path-error",
            needs="along_error",
            is_usual=False,
            place=("moving", 0),
            report="always",
        ),
        "along_track": TimePlot(
            title="along-track",
            unit="m",
            curves=(
                _aim("along_track"),
                _ideal("along_track"),
                _signal("along_track", "along-track"),
            ),
            list_levels=partial(list_levels, signal="along_track"),
            figure="along-track",
            needs="track",
            loop="along_track",
            place=("moving", 0),
            report="moving",
        ),
        "x": _plot_coordinate("x"),
        "y": _plot_coordinate("y"),
        "error_x": _plot_coordinate_error("x"),
        "error_y": _plot_coordinate_error("y"),
        "cross_track": TimePlot(
            title="cross-track",
            unit="m",
            curves=(
                _aim("cross_track"),
                _signal("cross_track", "cross-track"),
            ),
            list_levels=_list_zero,
            needs="track",
            place=("moving", 1),
            report="always",
        ),
        "distance": TimePlot(
            title="distance",
            unit="m",
            curves=(
                CurveEntry(
                    kind="beside",
                    name="to_reference",
                    label="to the reference",
                    signal="distance_to_reference",
                    read=partial(_read_one, read_distance_to_reference),
                ),
                _aim("distance"),
                _ideal("distance"),
                _signal("distance", "distance"),
            ),
            list_levels=partial(_list_errors, signal="distance"),
            is_log=True,
            needs="goal",
            loop="distance",
            is_usual=False,
            place=("moving", 1),
            report="always",
        ),
        "speed": _plot_command("speed", "speed", ("moving", 2)),
        "wanted_speed": _plot_wanted("speed", "speed", ("moving", 2)),
        "world_velocity_x": _plot_world_velocity("x"),
        "world_velocity_y": _plot_world_velocity("y"),
    }
)
"""Every plot over time by name, in the order of display."""


def list_controlled(run: Run) -> Iterator[str]:
    """Yield the plots of the signals that the loops of a run control."""
    for loop in run.declaration.loops:
        if loop.signal == "along_track" and loop.moves:
            yield "along_track_error"
        if loop.signal in TIME_PLOTS and (loop in list_loops(run, loop.signal) or loop.moves):
            yield loop.signal
