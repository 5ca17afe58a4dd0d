"""The curves of a run, and the levels beside them: what stands in which plot."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.measure import read_signal
from turtlelog.run import Run
from turtlelog.show.rerun import entities, palette
from turtlelog.show.rerun.commands import find_limits, list_commands
from turtlelog.show.rerun.series import LINE_WIDTH, Reference, Series
from turtlelog.show.run_colors import Color

_POSE_SIGNALS: Final = (
    (entities.HEADING, "heading", "heading"),
    (entities.HEADING_ERROR, "heading_error", "heading error"),
    (entities.ALONG_TRACK, "along_track", "along-track"),
    (entities.CROSS_TRACK, "cross_track", "cross-track"),
    (entities.DISTANCE, "distance", "distance"),
)

_LOGARITHMS: Final = (
    (entities.HEADING_ERROR, entities.HEADING_ERROR_LOG),
    (entities.DISTANCE, entities.DISTANCE_LOG),
)


def list_series(run: Run) -> tuple[Series, ...]:
    """Return every curve that the run has the data for; one row makes no curve."""
    poses = tuple(_list_pose_series(run))
    series = (
        *_list_pairs(run),
        *poses,
        *_list_logarithms(poses),
        *list_commands(run, entities.SPEED),
        *list_commands(run, entities.TURN_RATE),
    )
    return tuple(curves for curves in series if len(curves.time_ns) > 1)


def list_compared_series(run: Run, name: str, color: Color) -> tuple[Series, ...]:
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
            width=LINE_WIDTH,
        )
        for series in main
        if not (has_track and series.entity == entities.POSITION)
    )


def list_references(runs: Sequence[Run]) -> tuple[Reference, ...]:
    """Return bearings, goals, limits and the zeros of errors, each level once per plot."""
    bearings = {float(np.degrees(value)) for run in runs for value in run.samples.bearing_rad[:1]}
    goals = {value for run in runs for value in run.goal_xy_m or ()}
    lengths = {float(np.hypot(*run.samples.error_xy_m[0])) for run in runs if len(run.samples)}
    goal_zeros = {0.0 for run in runs if run.goal_xy_m is not None}
    track_zeros = {0.0 for run in runs if len(run.samples)}
    levels = (
        (entities.HEADING, "goal bearing", bearings),
        (entities.HEADING_ERROR, "zero", track_zeros),
        (entities.POSITION, "goal", goals),
        (entities.POSITION_ERROR, "zero", goal_zeros),
        (entities.ALONG_TRACK, "goal", lengths),
        (entities.CROSS_TRACK, "zero", track_zeros),
        (entities.DISTANCE, "zero", goal_zeros),
        (entities.SPEED, "limit", find_limits(runs, "limits.speed_m_s")),
        (entities.TURN_RATE, "limit", find_limits(runs, "limits.turn_rate_rad_s")),
        (entities.WORLD_VELOCITY, "zero", track_zeros),
    )
    return tuple(
        Reference(plot=plot, label=label, levels=tuple(sorted(values)))
        for plot, label, values in levels
        if values
    )


def _name_curves(name: str, labels: tuple[str, ...]) -> tuple[str, ...]:
    return (name,) if len(labels) == 1 else tuple(f"{name} {label}" for label in labels)


def _list_pairs(run: Run) -> Iterable[Series]:
    """Yield what has a value along x and one along y of the world."""
    poses, samples = run.poses, run.samples
    yield _build_pair(entities.POSITION, ("x", "y"), poses.time_ns, poses.xy_m)
    if run.goal_xy_m is not None:
        errors_m = np.array(run.goal_xy_m) - poses.xy_m
        labels = ("goal x - x", "goal y - y")
        series = _build_pair(entities.POSITION_ERROR, labels, poses.time_ns, errors_m)
        yield replace(series, is_main=False)
    if len(samples):
        labels, velocity = ("Kp ex", "Kp ey"), samples.world_velocity_m_s
        series = _build_pair(entities.WORLD_VELOCITY, labels, samples.time_ns, velocity)
        yield replace(series, is_main=False, holds=True)


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
        signal = read_signal(run, signal_name)
        if signal is None:
            continue
        values = np.degrees(signal.values) if signal.kind.unit == "rad" else signal.values
        yield Series(
            entity=entity, labels=(label,), time_ns=signal.time_ns, values=values[:, np.newaxis]
        )


def _list_logarithms(series: Iterable[Series]) -> Iterable[Series]:
    """Yield the decimal logarithm of the errors' magnitudes; what is exponential is straight."""
    entity_of = dict(_LOGARITHMS)
    for curves in series:
        if curves.entity not in entity_of:
            continue
        sizes = np.abs(curves.values)
        values = np.log10(sizes, out=np.full_like(sizes, np.nan), where=sizes > 0.0)
        yield replace(curves, entity=entity_of[curves.entity], values=values)
