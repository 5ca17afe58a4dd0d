"""The curves of a run, and the levels beside them: what stands in which plot, and drawing it."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from turtlelog.charts import palette
from turtlelog.charts.palette import Color
from turtlelog.charts.robot_curves import find_jump_rows, part_curve, part_path, read_measured
from turtlelog.charts.shared_curves import (
    Command,
    find_limits,
    list_aims,
    list_levels,
    read_applied,
    read_command,
    read_curve,
    read_distance_to_reference,
    read_sensed,
    read_world_velocity,
)
from turtlelog.charts.state_groups import StateGroup, group_states
from turtlelog.charts.tracked_path import read_along_error
from turtlelog.draw.rerun import entities
from turtlelog.draw.rerun.entities import join_path
from turtlelog.draw.rerun.timelines import RunStream, Times, Values, build_index
from turtlelog.run import Run

_POSE_SIGNALS: Final = (
    (entities.HEADING, "heading", "heading"),
    (entities.HEADING_ERROR, "heading_error", "heading error"),
    (entities.ALONG_TRACK, "along_track", "along-track"),
    (entities.CROSS_TRACK, "cross_track", "cross-track"),
    (entities.DISTANCE, "distance", "distance"),
)

_AIM_WIDTH: Final = 1.0  # [points]
_REFERENCE_WIDTH: Final = 1.0

_LOGARITHMS: Final = (
    (entities.HEADING_ERROR, entities.HEADING_ERROR_LOG),
    (entities.DISTANCE, entities.DISTANCE_LOG),
)

LINE_WIDTH: Final = 1.5

_COMMANDED_WIDTH: Final = 3.0
_THIN_WIDTH: Final = 1.25
_SENSED_SIZE: Final = 0.75
_DROPPED_SIZE: Final = 2.5
_OUTLIER_SIZE: Final = 4.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Series:
    """Curves that share their times and their plot.

    Attributes:
        entity: Entity path below the run's prefix; its first part names the plot, of a state of a
            law its first two.
        labels: Legend, one per curve.
        colors: One per curve.
        time_ns: The run's own time [ns], shape (n,), not decreasing.
        values: One column per curve, shape (n, curves); NaN where there is nothing to draw.
        width: Of the lines [points].
        holds: Whether a value lasts until the next, rather than leading to it in a line.
        is_main: Whether a comparison shows it too.
        is_measured: Whether it is the run's own, so that the plot must have room for it.
        marker: Shape of points instead of lines; None: lines.
    """

    entity: str
    labels: tuple[str, ...]
    colors: tuple[Color, ...] = (palette.MAIN,)
    time_ns: NDArray[np.int64]
    values: NDArray[np.float64]
    width: float = LINE_WIDTH
    holds: bool = False
    is_main: bool = True
    is_measured: bool = True
    marker: Literal["circle", "cross"] | None = None

    @property
    def plot(self) -> str:
        """The plot it stands in: each state of a law has one of its own."""
        parts = self.entity.split("/")
        return "/".join(parts[: 1 + (parts[0] == entities.STATE)])


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelLines:
    """Level lines across a plot.

    Attributes:
        plot: Entity that the plot is named after.
        labels: Legend, one per level.
        levels: In the plot's unit.
    """

    plot: str
    labels: tuple[str, ...]
    levels: tuple[float, ...]


def list_series(run: Run) -> tuple[Series, ...]:
    """Return every curve that the run has the data for; one row makes no curve."""
    poses = tuple(_list_pose_series(run))
    series = (
        *_list_pairs(run),
        *poses,
        *_list_logarithms(poses),
        *_list_along_errors(run),
        *_list_aims(run),
        *_list_sensed(run),
        *_list_states(run),
        *_list_measured(run, entities.SPEED, "speed"),
        *_list_commands(run, entities.SPEED, "speed"),
        *_list_measured(run, entities.TURN_RATE, "turn_rate"),
        *_list_commands(run, entities.TURN_RATE, "turn_rate"),
    )
    return tuple(
        curves
        for curves in series
        if len(curves.time_ns) > 1 or curves.entity.endswith(f"/{entities.OUTLIERS}")
    )


def list_compared_series(run: Run, name: str, color: Color) -> tuple[Series, ...]:
    """Return the curves that a comparison shows, in the run's name and colour.

    The position is among them only where no track is known.
    """
    main = [series for series in list_series(run) if series.is_main]
    has_track = any(series.entity == entities.ALONG_TRACK for series in main)
    measured = {series.plot for series in main if series.entity.endswith(f"/{entities.MEASURED}")}
    found = []
    for series in main:
        if has_track and series.entity == entities.POSITION:
            continue
        is_beside = series.plot in measured and not series.entity.endswith(entities.MEASURED)
        shown = f"{name} {series.labels[0]}" if is_beside else name
        found.append(
            replace(
                series,
                labels=_name_curves(shown, series.labels),
                colors=(color,) * len(series.labels),
                width=_THIN_WIDTH if is_beside else LINE_WIDTH,
            )
        )
    return tuple(found)


def list_references(runs: Sequence[Run]) -> tuple[LevelLines, ...]:
    """Return what loops aim at, goals, limits and the zeros of errors, each once per plot."""
    goals = {value for run in runs for value in run.goal_xy_m or ()}
    zeros = {0.0}
    levels = (
        (entities.HEADING, _list_levels(runs, "heading")),
        (entities.HEADING_ERROR, _name("zero", zeros if _hold(runs, "heading_error") else ())),
        (entities.POSITION, _list_levels(runs, "x", "y")),
        (entities.POSITION_ERROR, _name("zero", zeros if goals else ())),
        (entities.ALONG_TRACK, _list_levels(runs, "along_track")),
        (entities.ALONG_TRACK_ERROR, _name("zero", zeros if _follow_along(runs) else ())),
        (entities.CROSS_TRACK, _name("zero", zeros if _hold(runs, "cross_track") else ())),
        (entities.DISTANCE, _name("zero", zeros if goals or _follow_distance(runs) else ())),
        (entities.SPEED, _name("limit", _find_limits(runs, "speed"))),
        (entities.TURN_RATE, _name("limit", _find_limits(runs, "turn_rate"))),
        (entities.WORLD_VELOCITY, _name("zero", zeros if _hold(runs, "world_velocity_x") else ())),
    )
    return tuple(
        LevelLines(
            plot=plot,
            labels=tuple(label for _, label in sorted(named)),
            levels=tuple(level for level, _ in sorted(named)),
        )
        for plot, named in levels
        if named
    )


def draw_series(run_stream: RunStream, series: Series) -> None:
    """Draw curves into their plot."""
    names, colors = series.labels, palette.pack_colors(series.colors)
    style: rr.AsComponents
    if series.marker is not None:
        sizes, markers = [series.width] * len(names), [series.marker] * len(names)
        style = rr.SeriesPoints(names=names, colors=colors, markers=markers, marker_sizes=sizes)
    else:
        style = rr.SeriesLines(
            names=names,
            colors=colors,
            widths=[series.width] * len(names),
            interpolation_mode="StepAfter" if series.holds else "Linear",
            aggregation_policy="MinMax",
        )
    run_stream.log(series.entity, style)
    run_stream.send(series.entity, series.time_ns, series.values, _build_scalars)


def draw_references(
    stream: rr.RecordingStream, references: Sequence[LevelLines], span: Mapping[str, Times]
) -> None:
    """Draw level lines across plots, over a span of every timeline."""
    index = build_index(span)
    for reference in references:
        entity = join_path(entities.REFERENCE, reference.plot)
        count = len(reference.levels)
        style = rr.SeriesLines(
            names=list(reference.labels),
            colors=palette.pack_colors([palette.REFERENCE] * count),
            widths=[_REFERENCE_WIDTH] * count,
        )
        stream.log(entity, style, static=True)
        columns = rr.Scalars.columns(scalars=np.tile(reference.levels, (2, 1)))
        stream.send_columns(entity, index, columns)


def _list_commands(run: Run, plot: str, command: Command) -> Iterator[Series]:
    """Yield what was wanted, shaped, commanded and applied; the thick one shows beneath."""
    found = (
        (entities.WANTED, read_curve(run, f"wanted_{command}"), palette.WANTED),
        (entities.SHAPED, read_curve(run, f"shaped_{command}"), palette.SHAPED),
        (entities.COMMANDED, read_command(run, command), palette.MAIN),
        (entities.APPLIED, read_applied(run, command), palette.SECOND),
    )
    for kind, curve, color in found:
        if curve is None:
            continue
        is_main = kind == entities.COMMANDED
        is_magnitude = kind == entities.APPLIED and command == "speed"
        yield Series(
            entity=f"{plot}/{kind}",
            labels=(f"|{kind}|" if is_magnitude else kind,),
            colors=(color,),
            time_ns=curve.time_ns,
            values=curve.values[:, np.newaxis],
            width=_COMMANDED_WIDTH if is_main else _THIN_WIDTH,
            holds=True,
            is_main=is_main,
        )


def _list_measured(run: Run, plot: str, command: Command) -> Iterator[Series]:
    """Yield what a robot measured, and as points what no range has room for."""
    measured = read_measured(run, command)
    if measured is None:
        return
    curve, outliers = measured.curve, measured.outliers
    found = Series(
        entity=f"{plot}/{entities.MEASURED}",
        labels=("measured",),
        colors=(palette.MEASURED,),
        time_ns=curve.time_ns,
        values=curve.values[:, np.newaxis],
        width=_THIN_WIDTH,
    )
    yield found
    if len(outliers.values):
        yield replace(
            found,
            entity=f"{plot}/{entities.MEASURED}/{entities.OUTLIERS}",
            labels=(measured.name_outliers(),),
            time_ns=outliers.time_ns,
            values=outliers.values[:, np.newaxis],
            width=_OUTLIER_SIZE,
            is_measured=False,
            marker="cross",
        )


def _find_limits(runs: Sequence[Run], command: Command) -> set[float]:
    """Return the limits of runs with both signs."""
    return {sign * limit for limit in find_limits(runs, command) for sign in (-1.0, 1.0)}


def _list_levels(runs: Sequence[Run], *signals: str) -> set[tuple[float, str]]:
    found = [level for run in runs for name in signals for level in list_levels(run, name)]
    return {(level.value, level.label) for level in found}


def _name(label: str, levels: Iterable[float]) -> set[tuple[float, str]]:
    return {(level, label) for level in levels}


def _hold(runs: Sequence[Run], signal: str) -> bool:
    return any(read_curve(run, signal) is not None for run in runs)


def _follow_distance(runs: Sequence[Run]) -> bool:
    return any(read_distance_to_reference(run) is not None for run in runs)


def _follow_along(runs: Sequence[Run]) -> bool:
    return any(read_along_error(run) is not None for run in runs)


def _name_curves(name: str, labels: tuple[str, ...]) -> tuple[str, ...]:
    return (name,) if len(labels) == 1 else tuple(f"{name} {label}" for label in labels)


def _list_pairs(run: Run) -> Iterable[Series]:
    """Yield what has a value along x and one along y of the world."""
    poses, samples = run.poses, run.samples
    xy_m, jumps = part_path(run), find_jump_rows(run)
    time_ns = np.insert(poses.time_ns, jumps, poses.time_ns[jumps]) if len(jumps) else poses.time_ns
    yield _build_pair(entities.POSITION, ("x", "y"), time_ns, xy_m)
    if run.goal_xy_m is not None:
        errors_m = np.array(run.goal_xy_m) - xy_m
        labels = ("goal x - x", "goal y - y")
        series = _build_pair(entities.POSITION_ERROR, labels, time_ns, errors_m)
        yield replace(series, is_main=False)
    velocity = read_world_velocity(run)
    if velocity is not None:
        series = _build_pair(entities.WORLD_VELOCITY, ("Kp ex", "Kp ey"), *velocity)
        yield replace(series, is_main=False, holds=True)
    if samples.reference_xy_m is not None:
        yield Series(
            entity=f"{entities.POSITION}/{entities.AIMED}",
            labels=("reference x", "reference y"),
            colors=(palette.REFERENCE, palette.REFERENCE),
            time_ns=samples.time_ns,
            values=samples.reference_xy_m,
            width=_AIM_WIDTH,
            holds=True,
            is_main=False,
        )


def _build_pair(
    entity: str,
    labels: tuple[str, str],
    time_ns: NDArray[np.int64],
    values: NDArray[np.float64],
) -> Series:
    colors = (palette.MAIN, palette.SECOND)
    return Series(entity=entity, labels=labels, colors=colors, time_ns=time_ns, values=values)


def _list_pose_series(run: Run) -> Iterable[Series]:
    for entity, signal_name, label in _POSE_SIGNALS:
        curve = read_curve(run, signal_name)
        if curve is not None:
            curve = part_curve(run, curve)
            values = curve.values[:, np.newaxis]
            yield Series(entity=entity, labels=(label,), time_ns=curve.time_ns, values=values)


def _list_along_errors(run: Run) -> Iterable[Series]:
    """Yield how far the robot is behind a reference that moves along the track."""
    curve = read_along_error(run)
    if curve is not None:
        yield Series(
            entity=entities.ALONG_TRACK_ERROR,
            labels=("reference - along-track",),
            time_ns=curve.time_ns,
            values=curve.values[:, np.newaxis],
        )


def _list_aims(run: Run) -> Iterable[Series]:
    """Yield what moves and a signal of a loop should be, or is recorded as reference."""
    for signal, plot in entities.PLOTS.items():
        for aim in list_aims(run, signal):
            yield Series(
                entity=f"{plot}/{entities.AIMED if aim.holds else entities.BEARING_NOW}",
                labels=(aim.label,),
                colors=(palette.REFERENCE,),
                time_ns=aim.time_ns,
                values=aim.values[:, np.newaxis],
                width=_AIM_WIDTH,
                holds=aim.holds,
                is_main=False,
            )
    away_m = read_distance_to_reference(run)
    if away_m is not None:
        yield Series(
            entity=f"{entities.DISTANCE}/{entities.TO_REFERENCE}",
            labels=("to the reference",),
            colors=(palette.SECOND,),
            time_ns=run.samples.time_ns,
            values=away_m[:, np.newaxis],
            is_main=False,
        )


def _list_sensed(run: Run) -> Iterable[Series]:
    """Yield what the controller read, and where it read nothing the pose itself, as points."""
    lost = run.poses.dropped_out
    for plot, signals in ((entities.POSITION, ("x", "y")), (entities.HEADING, ("heading",))):
        found = [read_sensed(run, signal) for signal in signals]
        own = [read_curve(run, signal) for signal in signals]
        columns = [curve.values for curve in found if curve is not None]
        if len(columns) < len(signals) or found[0] is None:
            continue
        names = signals if len(signals) > 1 else ("",)
        sensed = Series(
            entity=f"{plot}/{entities.SENSED}",
            labels=tuple(f"sensed {name}".strip() for name in names),
            colors=(palette.SENSED,) * len(signals),
            time_ns=found[0].time_ns,
            values=np.column_stack(columns),
            width=_SENSED_SIZE,
            is_main=False,
            is_measured=False,
            marker="circle",
        )
        yield sensed
        yield replace(
            sensed,
            entity=f"{plot}/{entities.DROPPED_OUT}",
            labels=tuple(f"{name} dropped out".strip() for name in names),
            colors=(palette.DROPPED_OUT,) * len(signals),
            time_ns=run.poses.time_ns[lost],
            values=np.column_stack([curve.values[lost] for curve in own if curve is not None]),
            width=_DROPPED_SIZE,
            marker="cross",
        )


def _list_states(run: Run) -> Iterable[Series]:
    groups = group_states(run.declaration)
    hues = [(name, hue) for group in groups for name, hue in _color_states(group)]
    for name, hue in hues:
        curve = read_curve(run, name)
        if curve is not None:
            yield Series(
                entity=f"{entities.STATE}/{name}",
                labels=(name,),
                colors=(hue,),
                time_ns=curve.time_ns,
                values=curve.values[:, np.newaxis],
                holds=True,
            )


def _color_states(group: StateGroup) -> Iterable[tuple[str, Color]]:
    """Return the states of a group with colours that tell them apart."""
    return zip(group.names, palette.choose_run_colors(len(group.names)), strict=True)


def _list_logarithms(series: Iterable[Series]) -> Iterable[Series]:
    """Yield the decimal logarithm of the errors' magnitudes; what is exponential is straight."""
    entity_of = dict(_LOGARITHMS)
    for curves in series:
        if curves.entity not in entity_of:
            continue
        sizes = np.abs(curves.values)
        values = np.log10(sizes, out=np.full_like(sizes, np.nan), where=sizes > 0.0)
        yield replace(curves, entity=entity_of[curves.entity], values=values)


def _build_scalars(values: Values) -> rr.ComponentColumnList:
    return rr.Scalars.columns(scalars=values)
