"""The curves of a run: what stands in which plot, before anything is drawn."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.measure import read_signal
from turtlelog.run import Run
from turtlelog.show.rerun import entities, palette

_LINE_WIDTH: Final = 1.5
_COMMANDED_WIDTH: Final = 3.0
_THIN_WIDTH: Final = 1.25


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Series:
    """Curves that share their times and their plot.

    Attributes:
        entity: Entity path below the run's prefix; its first part names the plot.
        labels: Legend, one per curve.
        colors: One per curve.
        time_ns: The run's own time [ns], shape (n,), not decreasing.
        values: One column per curve, shape (n, curves).
        width: Of the lines [points].
        holds: Whether a value lasts until the next, rather than leading to it in a line.
        is_main: Whether a comparison shows it too.
    """

    entity: str
    labels: tuple[str, ...]
    colors: tuple[palette.Color, ...] = (palette.MAIN,)
    time_ns: NDArray[np.int64]
    values: NDArray[np.float64]
    width: float = _LINE_WIDTH
    holds: bool = False
    is_main: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Reference:
    """Level lines across a plot.

    Attributes:
        plot: Entity that the plot is named after.
        label: Legend.
        levels: In the plot's unit.
    """

    plot: str
    label: str
    levels: tuple[float, ...]


def list_series(run: Run) -> tuple[Series, ...]:
    """Return every curve that the run has the data for; one row makes no curve."""
    series = (
        _build_position(run),
        *_list_pose_series(run),
        *_list_commands(run, entities.SPEED),
        *_list_commands(run, entities.TURN_RATE),
    )
    return tuple(curves for curves in series if len(curves.time_ns) > 1)


def list_compared_series(run: Run, name: str, color: palette.Color) -> tuple[Series, ...]:
    """Return the curves that a comparison shows, in the run's name and colour.

    The position is among them only where no track is known.
    """
    main = [series for series in list_series(run) if series.is_main]
    has_track = any(series.entity == entities.ALONG_TRACK for series in main)
    return tuple(
        replace(
            series,
            labels=_name_curves(name, series.labels),
            colors=(color,) * len(series.labels),
            width=_LINE_WIDTH,
        )
        for series in main
        if not (has_track and series.entity == entities.POSITION)
    )


def list_references(runs: Sequence[Run]) -> tuple[Reference, ...]:
    """Return bearings, goals, limits and the zeros of errors, each level once per plot."""
    bearings = {float(np.degrees(value)) for run in runs for value in run.samples.bearing_rad[:1]}
    goals = {value for run in runs for value in run.goal_xy_m or ()}
    distance_zeros = {0.0 for run in runs if run.goal_xy_m is not None}
    track_zeros = {0.0 for run in runs if len(run.samples)}
    levels = (
        (entities.HEADING, "goal bearing", bearings),
        (entities.HEADING_ERROR, "zero", track_zeros),
        (entities.POSITION, "goal", goals),
        (entities.CROSS_TRACK, "zero", track_zeros),
        (entities.DISTANCE, "zero", distance_zeros),
        (entities.SPEED, "limit", _find_limits(runs, "limits.speed_m_s")),
        (entities.TURN_RATE, "limit", _find_limits(runs, "limits.turn_rate_rad_s")),
    )
    return tuple(
        Reference(plot=plot, label=label, levels=tuple(sorted(values)))
        for plot, label, values in levels
        if values
    )


def _name_curves(name: str, labels: tuple[str, ...]) -> tuple[str, ...]:
    return (name,) if len(labels) == 1 else tuple(f"{name} {label}" for label in labels)


def _build_position(run: Run) -> Series:
    return Series(
        entity=entities.POSITION,
        labels=("x", "y"),
        colors=(palette.MAIN, palette.SECOND),
        time_ns=run.poses.time_ns,
        values=run.poses.xy_m,
    )


def _list_pose_series(run: Run) -> Iterable[Series]:
    for entity, signal_name, label in (
        (entities.HEADING, "heading", "heading"),
        (entities.HEADING_ERROR, "heading_error", "heading error"),
        (entities.ALONG_TRACK, "along_track", "along-track"),
        (entities.CROSS_TRACK, "cross_track", "cross-track"),
        (entities.DISTANCE, "distance", "distance"),
    ):
        signal = read_signal(run, signal_name)
        if signal is None:
            continue
        values = np.degrees(signal.values) if signal.kind.unit == "rad" else signal.values
        yield Series(
            entity=entity, labels=(label,), time_ns=signal.time_ns, values=values[:, np.newaxis]
        )


def _list_commands(run: Run, plot: str) -> Iterable[Series]:
    """Yield what was wanted, commanded and applied; the thick one shows beneath the others."""
    poses = run.poses
    applied = poses.speed_m_s if plot == entities.SPEED else poses.turn_rate_rad_s
    wanted = read_signal(run, f"wanted_{plot}")
    if wanted is not None:
        color = palette.WANTED
        yield _build_command(plot, entities.WANTED, wanted.time_ns, wanted.values, color)
    time_ns, commanded = _read_commanded(run, plot)
    yield _build_command(plot, entities.COMMANDED, time_ns, commanded, palette.MAIN)
    if applied is not None:
        yield _build_command(plot, entities.APPLIED, poses.time_ns, applied, palette.SECOND)


def _read_commanded(run: Run, plot: str) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    table = run.samples if len(run.samples) else run.commands
    return table.time_ns, table.speed_m_s if plot == entities.SPEED else table.turn_rate_rad_s


def _build_command(
    plot: str,
    kind: str,
    time_ns: NDArray[np.int64],
    values: NDArray[np.float64],
    color: palette.Color,
) -> Series:
    return Series(
        entity=f"{plot}/{kind}",
        labels=(kind,),
        colors=(color,),
        time_ns=time_ns,
        values=values[:, np.newaxis],
        width=_COMMANDED_WIDTH if kind == entities.COMMANDED else _THIN_WIDTH,
        holds=True,
        is_main=kind == entities.COMMANDED,
    )


def _find_limits(runs: Sequence[Run], key: str) -> set[float]:
    limits = {run.parameters.get(key) for run in runs}
    sizes = {float(limit) for limit in limits if isinstance(limit, int | float)}
    return {sign * size for size in sizes if np.isfinite(size) for sign in (-1.0, 1.0)}
