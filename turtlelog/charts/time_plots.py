"""Plots over time: the curves of each plot, its level lines, and its place; and the timelines.

A curve is one entry. Figures, Rerun, reports and movies draw these plots.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Final

import numpy as np

from turtlelog.charts import curves
from turtlelog.charts.curves import Command, Curve, Level, Values, read_curve
from turtlelog.charts.plane_scene import part_curve
from turtlelog.charts.plotted_curves import Column, CurveEntry, CurveKind, TimePlot, find_state_unit
from turtlelog.compare.robot_comparison import SHOWN_UNITS, Quantity
from turtlelog.display import describe_count
from turtlelog.errors import ShowError
from turtlelog.measure import find_outliers
from turtlelog.run import Run
from turtlelog.run.angles import unwrap_headings
from turtlelog.run.loops import COMMAND_UNITS, DONE, PAUSE

_TOLERANCES: Final[Mapping[str, str]] = {
    "heading_error": "law.heading_tolerance_rad",
    "distance": "law.position_tolerance_m",
}


def read_measured(run: Run, command: Command) -> tuple[Curve, Curve] | None:
    """Return a robot's reported `speed` or `turn_rate` without its outliers, and the outliers.

    Outliers would flatten every other curve. The result is None without reports.
    """
    curve = read_curve(run, f"measured_{command}")
    if curve is None:
        return None
    outliers = find_outliers(curve.time_ns, curve.values)
    rest = np.delete(np.arange(len(curve.values)), outliers)
    calm = part_curve(run, curves.select_curve_rows(curve, rest))
    return calm, curves.select_curve_rows(curve, outliers)


def find_plot(name: str, runs: Sequence[Run]) -> TimePlot:
    """Return a plot by its name; any other name is a state of the law of one of the runs."""
    return TIME_PLOTS.get(name) or TimePlot(
        title=name,
        unit=find_state_unit(name, [run.declaration for run in runs]),
        curves=(_signal(name, name),),
        list_levels=_list_zero,
        needs="states",
        is_usual=False,
        report="always",
    )


def find_marked(signal: str) -> tuple[str, CurveEntry] | None:
    """Return the plot and curve on which a signal's characteristics are marked; None if missing."""
    marked = ((name, entry) for name, plot in TIME_PLOTS.items() for entry in plot.curves)
    return next((found for found in marked if found[1].signal == signal), None)


def _read_one(read: Callable[[Run], Curve | None], run: Run) -> Iterator[Curve]:
    curve = read(run)
    if curve is not None and len(curve.values):
        yield curve


def _read_signal(run: Run, signal: str) -> Iterator[Curve]:
    curve = read_curve(run, signal)
    if curve is not None:
        yield part_curve(run, curve)


def _read_rate(run: Run, command: Command) -> Iterator[Curve]:
    measured = read_measured(run, command)
    if measured is not None:
        yield measured[0]


def _read_outliers(run: Run, command: Command) -> Iterator[Curve]:
    """Yield the outliers of a measured rate, if there are any, with the largest as text."""
    _, found = read_measured(run, command) or (None, None)
    if found is not None and len(found.values):
        row, count = int(np.abs(found.values).argmax()), len(found.values)
        text = f"{found.values[row]:.4g} {COMMAND_UNITS[command]} at {found.time_s[row]:.1f} s"
        many = f"{describe_count(count, 'outlier')} to {text}"
        yield replace(found, label=f"outlier {text}" if count == 1 else many)


def _list_zero(_: Run) -> Iterator[Level]:
    yield Level(label="zero", value=0.0, kind="zero")


def _list_errors(run: Run, signal: str) -> Iterator[Level]:
    """Yield zero, and the tolerance within which an error counts as zero."""
    yield from _list_zero(run)
    for tolerance in curves.find_limits(run, [_TOLERANCES[signal]]):
        value = float(np.degrees(tolerance)) if signal == "heading_error" else tolerance
        yield Level(label="tolerance", value=value, kind="tolerance")


def _list_limits(run: Run, command: Command) -> Iterator[Level]:
    for limit in curves.find_limits(run, run.declaration.list_limits(command)):
        for sign in (-1.0, 1.0):
            yield Level(label="limit", value=sign * limit, kind="limit")


def _signal(
    signal: str,
    label: str,
    read: Callable[[Run], Iterable[Curve]] | None = None,
    *,
    kind: CurveKind = "run",
    name: str = "",
) -> CurveEntry:
    """Return a curve on which the characteristics of its signal are marked."""
    read = read or partial(_read_signal, signal=signal)
    return CurveEntry(kind=kind, read=read, label=label, name=name, signal=signal)


def _add(
    kind: CurveKind, name: str, read: Callable[[Run], Iterable[Curve]], label: str | None = None
) -> CurveEntry:
    """Return a curve with a name, which is also its label by default."""
    return CurveEntry(kind=kind, name=name, label=name if label is None else label, read=read)


def _ideal(signal: str) -> CurveEntry:
    return _add("ideal", "ideal", partial(curves.compute_ideals, signal_name=signal))


def _aim(signal: str) -> CurveEntry:
    return _add("aim", "reference", partial(curves.list_aims, signal=signal), label="")


def _sensed(signal: str) -> tuple[CurveEntry, ...]:
    """Return the signal that the controller read, and the poses that it did not receive."""

    def read_lost(run: Run) -> Iterator[Curve]:
        curve, lost = read_curve(run, signal), run.poses.dropped_out
        if curve is not None and curves.read_sensed(run, signal) is not None and lost.any():
            yield curves.select_curve_rows(curve, np.flatnonzero(lost))

    read = partial(_read_one, partial(curves.read_sensed, signal=signal))
    return _add("sensed", "sensed", read), _add("dropped_out", "dropped_out", read_lost, "dropped")


def _follow(signal: str, label: str) -> tuple[CurveEntry, ...]:
    """Return a signal with what the controller sensed of it, its reference, and the ideal."""
    sensed = _sensed(signal) if signal in curves.SENSED_SIGNALS else ()
    return (*sensed, _aim(signal), _ideal(signal), _signal(signal, label))


def _plot_command(command: Command, title: str, place: tuple[Column, int]) -> TimePlot:
    applied = partial(_read_one, partial(curves.read_applied, command=command))
    commanded = partial(_read_one, partial(curves.read_command, command=command))
    return TimePlot(
        title=title,
        unit=COMMAND_UNITS[command],
        curves=(
            _signal(command, "commanded", commanded, name="commanded"),
            _add("applied", "applied", applied),
            _add("measured", "measured", partial(_read_rate, command=command)),
            _add("outlier", "outliers", partial(_read_outliers, command=command), label="outlier"),
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
        curves=_follow(axis, axis),
        list_levels=partial(curves.list_levels, signal=axis),
        figure="position",
        pair="position",
        place=("moving", 0),
        report="moving",
    )


def _plot_component(signal: str, title: str, label: str) -> TimePlot:
    """Return the plot of an error, or of the gain times an error, along x or y."""
    is_error = signal.startswith("error")
    pair = "position_error" if is_error else "world_velocity"
    return TimePlot(
        title=title,
        unit="m" if is_error else "m/s",
        curves=(_ideal(signal), _signal(signal, label)),
        list_levels=_list_zero,
        figure=pair.replace("_", "-"),
        needs="goal" if is_error else "world_velocity",
        pair=pair,
        place=("moving", 0 if is_error else 2),
        is_compared=False,
    )


TIME_PLOTS: Final[Mapping[str, TimePlot]] = MappingProxyType(
    {
        "heading": TimePlot(
            title="heading",
            unit="deg",
            curves=_follow("heading", "heading"),
            list_levels=partial(curves.list_levels, signal="heading"),
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
                _signal(
                    "along_track_error",
                    "reference - along-track",
                    partial(_read_one, curves.read_along_error),
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
            curves=_follow("along_track", "along-track"),
            list_levels=partial(curves.list_levels, signal="along_track"),
            figure="along-track",
            needs="track",
            loop="along_track",
            place=("moving", 0),
            report="moving",
        ),
        "x": _plot_coordinate("x"),
        "y": _plot_coordinate("y"),
        "error_x": _plot_component("error_x", "error in x", "goal x - x"),
        "error_y": _plot_component("error_y", "error in y", "goal y - y"),
        "cross_track": TimePlot(
            title="cross-track",
            unit="m",
            curves=(_aim("cross_track"), _signal("cross_track", "cross-track")),
            list_levels=_list_zero,
            needs="track",
            place=("moving", 1),
            report="always",
        ),
        "distance": TimePlot(
            title="distance",
            unit="m",
            curves=(
                _signal(
                    "distance_to_reference",
                    "to the reference",
                    partial(_read_one, curves.read_distance_to_reference),
                    kind="beside",
                    name="to_reference",
                ),
                *_follow("distance", "distance"),
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
        "world_velocity_x": _plot_component("world_velocity_x", "Kp ex", "Kp ex"),
        "world_velocity_y": _plot_component("world_velocity_y", "Kp ey", "Kp ey"),
    }
)
"""Every plot over time by name, in the order of display."""


def list_controlled(run: Run) -> Iterator[str]:
    """Yield the plots of the signals that the loops of a run control."""
    for loop in run.declaration.loops:
        if loop.signal == "along_track" and loop.moves:
            yield "along_track_error"
        is_own = loop in curves.list_loops(run, loop.signal) or loop.moves
        if loop.signal in TIME_PLOTS and is_own:
            yield loop.signal


def label_error(quantity: Quantity) -> str:
    """Return the axis label of a predicted error: `position error [mm]`."""
    unit, _ = SHOWN_UNITS[quantity]
    return f"{quantity} error [{unit}]"


TIMELINE: Final = "sim_time"
WALL_TIMELINE: Final = "wall_time"

_MOST_PHASES: Final = 8  # phase timelines of a run; each takes 8 bytes per row and entity in a view


def name_phase_timeline(phase: str) -> str:
    """Return the unique name of the timeline that begins at the start of a phase."""
    name = f"{phase}_time"
    return f"phase.{name}" if name in {TIMELINE, WALL_TIMELINE} else name


def find_phase_zeros(run: Run) -> dict[str, int]:
    """Return the timelines of phases after the first, with their zeros in the run's time [ns]."""
    phases = [name for name in run.declaration.phases if name not in (PAUSE, DONE)]
    starts_ns: dict[str, int] = {}
    for span in run.find_phase_spans():
        starts_ns.setdefault(span.phase, span.start_ns)
    later = phases[1 : 1 + _MOST_PHASES]
    return {name_phase_timeline(name): starts_ns[name] for name in later if name in starts_ns}


def locate_run(run: Run, zero_ns: int, time_s: Values) -> tuple[Values, Values]:
    """Return the poses of a run on a timeline: x and y [m], shape (n, 2), and heading [rad].

    Poses are linearly interpolated at times [s], shape (n,), from a zero in the run's own time
    [ns]. Before the first and after the last pose, the robot is at rest.
    """
    own_s = (run.poses.time_ns - zero_ns) / 1e9
    heading_rad = unwrap_headings(run.poses)
    xy_m = np.column_stack([np.interp(time_s, own_s, values) for values in run.poses.xy_m.T])
    return xy_m, np.interp(time_s, own_s, heading_rad)


_STILL_S: Final = 1.5  # time without motion at the end [s], for reading the distances of the runs
_MOST_STILL: Final = 0.3  # largest share of this time in the movie

_SLOWEST: Final = 0.25
"""Slowest motion: a run of half a second takes two seconds, so that each pose is visible."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Film:
    """The times of a movie's pictures."""

    timeline: str  # timeline of the times
    zeros_ns: tuple[int, ...]  # zero of the timeline in each run's own time [ns]
    time_s: Values  # times on the timeline [s], shape (n,), increasing, then constant
    driving: int  # number of pictures that show the runs driving
    pace: float  # seconds of the runs per second of the movie


def plan_film(
    runs: Sequence[Run], *, timeline: str, length_s: float | None, pictures_per_s: float
) -> Film:
    """Return the times of a movie's pictures, from the first pose of any run to the last pose.

    The runs are together on `TIMELINE` or that of a phase, which each must have. The default length
    is real time, within limits.
    """
    zeros_ns = tuple(_find_zero_ns(run, timeline) for run in runs)
    ends_ns = [run.poses.time_ns[[0, -1]] - zero for run, zero in zip(runs, zeros_ns, strict=True)]
    first_s, last_s = float(np.min(ends_ns)) / 1e9, float(np.max(ends_ns)) / 1e9
    whole_s = _choose_length(last_s - first_s) if length_s is None else length_s
    still_s = min(_STILL_S, _MOST_STILL * whole_s)
    driving = max(round((whole_s - still_s) * pictures_per_s), 2)
    still = max(round(still_s * pictures_per_s), 1)
    moments = np.linspace(first_s, last_s, driving)
    return Film(
        timeline=timeline,
        zeros_ns=zeros_ns,
        time_s=np.append(moments, np.full(still, last_s)),
        driving=driving,
        pace=(last_s - first_s) * pictures_per_s / driving,
    )


def _choose_length(span_s: float) -> float:
    """Return the default length of a movie [s]: real time, within limits."""
    return float(np.clip(span_s + _STILL_S, min(span_s / _SLOWEST + _STILL_S, 3.0), 10.0))


def _find_zero_ns(run: Run, timeline: str) -> int:
    zeros_ns = {TIMELINE: run.start_ns, **find_phase_zeros(run)}
    if timeline not in zeros_ns:
        known = ", ".join(zeros_ns)
        raise ShowError(f"timeline: {run.name}: expected one of {known}, found {timeline!r}")
    return zeros_ns[timeline]
