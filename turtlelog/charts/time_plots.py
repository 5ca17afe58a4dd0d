"""Plots over time: the curves of each, its level lines, and where it stands. A curve is one entry.

Figures, Rerun, reports and movies draw what stands here.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Final, Literal

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
    select_rows,
)
from turtlelog.charts.ideal_curves import compute_ideals
from turtlelog.charts.many_runs import MANY
from turtlelog.charts.robot_curves import part_curve, read_measured
from turtlelog.charts.tracked_path import read_along_error
from turtlelog.loops import COMMAND_UNITS
from turtlelog.run import Run

CurveKind = Literal[
    "run", "beside", "measured", "applied", "wanted", "shaped",
    "ideal", "aim", "sensed", "dropped_out", "outlier",
]  # fmt: skip
"""What a curve is: what the run did, a second signal of it, what the robot measured, what the plant
applied, what the law wanted and what shaping left of that; the ideal loop, what is asked for where
that moves; points that the controller read, that it did not get, that were measured far off."""

POINTS: Final[frozenset[CurveKind]] = frozenset({"sensed", "dropped_out", "outlier"})
"""Kinds that are points without a line between them."""

OWN: Final[frozenset[CurveKind]] = frozenset({"run", "beside", "measured", "applied", "aim"})
"""Kinds that a plot must have room for: theory and what a law wants may lie far beyond."""

_MEASURED: Final = OWN - {"aim"}

COMPARED: Final[frozenset[CurveKind]] = frozenset({"run", "measured", "ideal", "aim"})
"""Kinds that are drawn of several runs over each other."""

Scale = Literal["linear", "log", "symlog"]
Column = Literal["turning", "moving"]

_TOLERANCES: Final[Mapping[str, str]] = MappingProxyType(
    {"heading_error": "law.heading_tolerance_rad", "distance": "law.position_tolerance_m"}
)

_LIMIT_LABEL: Final = "limit"


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveEntry:
    """A curve of a plot over time.

    Attributes:
        kind: What it is; colour and dash follow from it.
        read: Returns it for a run; several where its loop steps several times.
        label: In a legend; a curve's own label goes before.
        name: Tells the curves of a plot apart; empty for the run's own.
        signal: Whose characteristics stand on it, as they name it; empty for others.
    """

    kind: CurveKind
    read: Callable[[Run], Iterable[Curve]]
    label: str = ""
    name: str = ""
    signal: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class TimePlot:
    """A plot over time.

    Attributes:
        title: What it shows.
        unit: Of its values; empty where nobody declares it.
        curves: Its curves, as a legend lists them.
        list_levels: Returns the level lines of a run.
        is_log: Whether it has a twin that shows magnitudes on a logarithmic scale.
        scale: How values stand on its axis.
        figure: The figure for print that it is a panel of; one of that name is made where none is.
        needs: What a run must hold, by its name in the table of needs.
        loop: Signal that a loop of a run must control for it; empty: any.
        is_usual: Whether a figure misses it where no run has anything for it.
        pair: Name of the plot in which x and y stand together where there is little room.
        place: Column and row of a view of many plots; plots of one place are tabs.
        is_compared: Whether a view of several runs has it.
        report: When a report has it: always, where what is asked for moves, never.
        command: Which command it shows; None for any other signal.
        is_filled: Whether one oscillation would fill it from end to end.
    """

    title: str
    unit: str
    curves: tuple[CurveEntry, ...]
    list_levels: Callable[[Run], Iterable[Level]] = lambda _: ()
    is_log: bool = False
    scale: Scale = "linear"
    figure: str = ""
    needs: str = "poses"
    loop: str = ""
    is_usual: bool = True
    pair: str = ""
    place: tuple[Column, int] | None = None
    is_compared: bool = True
    report: Literal["always", "moving", "never"] = "never"
    command: Command | None = None
    is_filled: bool = False

    @property
    def label(self) -> str:
        """Title and unit."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlottedCurve:
    """A curve of a run in a plot.

    Attributes:
        entry: Which.
        label: In a legend of the run alone.
        curve: Its values.
    """

    entry: CurveEntry
    label: str
    curve: Curve

    @property
    def kind(self) -> CurveKind:
        """What it is."""
        return self.entry.kind


def find_plot(name: str) -> TimePlot:
    """Return a plot by its name; any other name is a state of a law."""
    return TIME_PLOTS.get(name) or _describe_state(name)


def list_plotted(
    run: Run, plot: TimePlot, kinds: frozenset[CurveKind] | None = None
) -> list[PlottedCurve]:
    """Return the curves that a run has in a plot, of some kinds or of all.

    A run without a curve of its own has none: what is aimed at is nothing without it. For a robot
    that recorded no commands the applied rates stand where those are asked for.
    """
    found = _read_entries(run, [one for one in plot.curves if kinds is None or one.kind in kinds])
    if kinds is not None and not found:
        found = _read_entries(run, [one for one in plot.curves if one.kind == "applied"])
    return found if any(one.kind in _MEASURED for one in found) else []


def list_own(run: Run, plot: TimePlot) -> list[Curve]:
    """Return what a run did in a plot; the axis of the plot must have room for that."""
    return [one.curve for one in list_plotted(run, plot, OWN)]


def has_own(run: Run, plot: TimePlot) -> bool:
    """Whether a run has a curve of its own in a plot."""
    return any(True for one in plot.curves if one.kind in _MEASURED for _ in one.read(run))


def list_plot_levels(
    runs: Sequence[Run], plot: TimePlot, scale: Scale | None = None
) -> list[Level]:
    """Return the level lines of runs in a plot, each once, rising; magnitudes have tolerances."""
    is_log = (scale or plot.scale) == "log"
    found = dict.fromkeys(level for run in runs for level in plot.list_levels(run))
    kept = [level for level in found if (level.kind == "tolerance") == is_log]
    return sorted(kept, key=lambda level: (level.value, level.label))


def find_marked(signal: str) -> tuple[str, CurveEntry] | None:
    """Return the plot and the curve on which characteristics of a signal stand; None of none."""
    for name, plot in TIME_PLOTS.items():
        for entry in plot.curves:
            if entry.signal == signal:
                return name, entry
    return None


def leaves_out(count: int, plot: TimePlot) -> bool:
    """Whether a plot of so many runs leaves out those that never settle."""
    return count > MANY and plot.is_filled


def take_magnitude(curve: Curve) -> Curve:
    """Return the magnitudes of a curve for a logarithmic scale: zeros are gaps."""
    return replace(curve, values=np.where(curve.values == 0.0, np.nan, np.abs(curve.values)))


def _read_entries(run: Run, entries: Iterable[CurveEntry]) -> list[PlottedCurve]:
    return [
        PlottedCurve(entry=entry, label=curve.label or entry.label, curve=curve)
        for entry in entries
        for curve in entry.read(run)
    ]


def _read_one(read: Callable[[Run], Curve | None], run: Run) -> Iterator[Curve]:
    curve = read(run)
    if curve is not None and len(curve.values):
        yield curve


def _read_signal(run: Run, signal: str) -> Iterator[Curve]:
    curve = read_curve(run, signal)
    if curve is not None:
        yield part_curve(run, curve)


def _read_away(run: Run) -> Iterator[Curve]:
    values = read_distance_to_reference(run)
    if values is not None:
        yield Curve(start_ns=run.start_ns, time_ns=run.samples.time_ns, values=values)


def _read_lost(run: Run, signal: str) -> Iterator[Curve]:
    """Yield the poses that a controller did not get, where something stands for what it read."""
    curve = read_curve(run, signal)
    if curve is not None and read_sensed(run, signal) is not None and run.poses.dropped_out.any():
        yield select_rows(curve, np.flatnonzero(run.poses.dropped_out))


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


def _around(signal: str) -> tuple[CurveEntry, ...]:
    """Return what is drawn below a signal: what is asked for where that moves, the ideal loop."""
    return (
        CurveEntry(kind="aim", name="reference", read=partial(list_aims, signal=signal)),
        _ideal(signal),
    )


def _ideal(signal: str) -> CurveEntry:
    return CurveEntry(
        kind="ideal", name="ideal", label="ideal", read=partial(compute_ideals, signal_name=signal)
    )


def _sensed(signal: str, word: str) -> tuple[CurveEntry, ...]:
    """Return what the controller read of a signal, and where it read nothing."""
    return (
        CurveEntry(
            kind="sensed",
            name="sensed",
            label=f"sensed {word}".strip(),
            read=partial(_read_one, partial(read_sensed, signal=signal)),
        ),
        CurveEntry(
            kind="dropped_out",
            name="dropped_out",
            label=f"{word} dropped out".strip(),
            read=partial(_read_lost, signal=signal),
        ),
    )


def _plot_command(command: Command, title: str, place: tuple[Column, int]) -> TimePlot:
    """Return the plot of what was commanded, applied and measured."""
    # The plant tells its speed without a sign.
    applied = "|applied|" if command == "speed" else "applied"
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
            CurveEntry(
                kind="applied",
                name="applied",
                label=applied,
                read=partial(_read_one, partial(read_applied, command=command)),
            ),
            CurveEntry(
                kind="measured",
                name="measured",
                label="measured",
                read=partial(_read_rate, command=command, is_outlier=False),
            ),
            CurveEntry(
                kind="outlier",
                name="outliers",
                label="outlier",
                read=partial(_read_rate, command=command, is_outlier=True),
            ),
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
    """Return the plot of what a law wanted before clipping."""
    return TimePlot(
        title=f"wanted {title}",
        unit=COMMAND_UNITS[command],
        curves=(
            CurveEntry(
                kind="shaped",
                name="shaped",
                label="shaped",
                read=partial(_read_signal, signal=f"shaped_{command}"),
            ),
            CurveEntry(
                kind="run",
                name="wanted",
                label="wanted",
                read=partial(_read_signal, signal=f"wanted_{command}"),
            ),
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
        curves=(*_sensed(axis, axis), *_around(axis), _signal(axis, axis)),
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


def _describe_state(name: str) -> TimePlot:
    return TimePlot(
        title=name,
        unit="",
        curves=(
            CurveEntry(
                kind="run", label=name, signal=name, read=partial(_read_signal, signal=name)
            ),
        ),
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
            curves=(*_sensed("heading", ""), *_around("heading"), _signal("heading", "heading")),
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
            curves=(*_around("along_track"), _signal("along_track", "along-track")),
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
                CurveEntry(
                    kind="aim",
                    name="reference",
                    read=partial(list_aims, signal="cross_track"),
                ),
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
                    read=_read_away,
                ),
                *_around("distance"),
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
"""Every plot over time by name, in the order in which they stand."""


def list_controlled(run: Run) -> Iterator[str]:
    """Yield the plots of what the loops of a run control."""
    for loop in run.declaration.loops:
        if loop.signal == "along_track" and loop.moves:
            yield "along_track_error"
        if loop.signal in TIME_PLOTS and (loop in list_loops(run, loop.signal) or loop.moves):
            yield loop.signal
