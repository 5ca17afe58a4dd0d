"""Panels over time of signals, errors and states, with what they aim at."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from turtlelog.charts.palette import FEW
from turtlelog.charts.robot_curves import part_curve
from turtlelog.charts.shared_curves import (
    Curve,
    find_parameters,
    list_aims,
    list_levels,
    read_curve,
    read_sensed,
)
from turtlelog.charts.tracked_path import (
    read_along_error,
)
from turtlelog.draw.figures.figure_curves import (
    compute_ideals,
    draw_curve,
    draw_level,
    draw_points,
)
from turtlelog.draw.figures.page import (
    AIM,
    DROPPED_OUT,
    IDEAL,
    IDEAL_ENDS,
    REFERENCE,
    SENSED,
    choose_lines,
    style_runs,
)
from turtlelog.draw.figures.panels import finish
from turtlelog.run import Run

_TOLERANCES = {"heading_error": "law.heading_tolerance_rad", "distance": "law.position_tolerance_m"}

_AIMED = frozenset({"heading", "x", "y", "along_track"})
"""Signals that come to something else than zero."""

_TOLERANCE = {**REFERENCE, "linestyle": (0, (5, 2)), "label": "tolerance"}


def draw_signal(axes: Axes, runs: Sequence[Run], *, signal: str, label: str) -> None:
    """Draw one signal of every run, with what it aims at and the ideal response where known."""
    axes.set_label(signal)
    _draw_targets(axes, runs, signal)
    _draw_aims(axes, runs, signal)
    for run, looks in style_runs(runs):
        for ideal in _list_ideals(run, runs, signal):
            draw_curve(axes, ideal, **{**looks, **_choose_ideal(runs)})
        if (curve := read_curve(run, signal)) is not None:
            draw_curve(axes, part_curve(run, curve), **looks)
    if len(runs) == 1:
        _draw_sensed(axes, runs[0], signal)
    finish(axes, runs, label)


def draw_track(axes: Axes, runs: Sequence[Run]) -> None:
    """Draw how far runs came along the track; where all follow a reference, the error instead."""
    if all(read_along_error(run) is not None for run in runs):
        draw_along_error(axes, runs)
    else:
        draw_signal(axes, runs, signal="along_track", label="along-track [m]")


def draw_along_error(axes: Axes, runs: Sequence[Run]) -> None:
    """Draw how far every run is behind its reference along the track."""
    draw_level(axes, [0.0], **REFERENCE, label=None)
    for run, looks in style_runs(runs):
        if (curve := read_along_error(run)) is not None:
            draw_curve(axes, curve, **looks)
    finish(axes, runs, "along-track error [m]")


def draw_states(axes: Axes, runs: Sequence[Run], *, names: Sequence[str], label: str) -> None:
    """Draw states of a law: one of every run, or several of one run."""
    draw_level(axes, [0.0], color="0.8", linewidth=0.5)
    styled = style_runs(runs)
    if len(names) > 1:
        lines = choose_lines(len(names))
        styled = [(runs[0], {**lines[i], "label": name}) for i, name in enumerate(names)]
    for (run, looks), name in zip(styled, [*names] * len(styled), strict=False):
        if name in run.declaration.states and (curve := read_curve(run, name)) is not None:
            draw_curve(axes, curve, **looks)
    finish(axes, runs, label)


def draw_error_magnitude(axes: Axes, runs: Sequence[Run], *, signal: str, label: str) -> None:
    """Draw the magnitude of an error on a logarithmic scale: what is exponential is straight.

    The axis spans what was measured; an error of zero is a gap.
    """
    axes.set_label(f"|{signal}|")
    axes.set_yscale("log")
    _draw_tolerances(axes, runs, signal)
    extremes: list[float] = []
    for run, looks in style_runs(runs):
        if (curve := read_curve(run, signal)) is None:
            continue
        sizes = np.where(curve.values == 0.0, np.nan, np.abs(curve.values))
        known = sizes[np.isfinite(sizes)]
        extremes += [known.min(), known.max()] if len(known) else []
        for ideal in _list_ideals(run, runs, signal):
            decay = replace(ideal, values=np.abs(ideal.values))
            draw_curve(axes, decay, **{**looks, **_choose_ideal(runs)})
        draw_curve(axes, replace(curve, values=sizes), **looks)
    if extremes:
        axes.set_ylim(0.6 * min(extremes), 1.8 * max(extremes))
    finish(axes, runs, label)


def _list_ideals(run: Run, runs: Sequence[Run], signal: str) -> list[Curve]:
    """Return the ideal responses beside a run; of many runs those of the first and the last."""
    is_drawn = len(runs) <= len(FEW) or run in (runs[0], runs[-1])
    return compute_ideals(run, signal) if is_drawn else []


def _choose_ideal(runs: Sequence[Run]) -> Mapping[str, Any]:
    return IDEAL if len(runs) <= len(FEW) else IDEAL_ENDS


def _are_alike(one: Curve, other: Curve) -> bool:
    """Whether two references are the same: of runs that track one path by time."""
    return np.array_equal(one.time_s, other.time_s) and np.array_equal(
        one.values, other.values, equal_nan=True
    )


def _draw_tolerances(axes: Axes, runs: Sequence[Run], signal: str) -> None:
    found = find_parameters(runs, _TOLERANCES[signal])
    levels = np.degrees(found) if signal == "heading_error" else found
    draw_level(axes, list(levels), **_TOLERANCE)


def _draw_targets(axes: Axes, runs: Sequence[Run], signal: str) -> None:
    """Draw the levels that a signal should come to, under their names; of errors it is zero."""
    if signal not in _AIMED:
        draw_level(axes, [0.0], **REFERENCE, label=None)
        return
    named: dict[str, set[float]] = {}
    for level in (level for run in runs for level in list_levels(run, signal)):
        named.setdefault(level.label, set()).add(level.value)
    for name, levels in named.items():
        draw_level(axes, sorted(levels), **REFERENCE, label=name)


def _draw_aims(axes: Axes, runs: Sequence[Run], signal: str) -> None:
    """Draw references that move; one that several runs share once, in the colour of none."""
    aims = [(aim, looks) for run, looks in style_runs(runs) for aim in list_aims(run, signal)]
    while aims:
        (aim, looks), *others = aims
        aims = [(other, of) for other, of in others if not _are_alike(aim, other)]
        shared = {"color": REFERENCE["color"]} if len(aims) < len(others) else {}
        draw_curve(axes, aim, **{**looks, **AIM, **shared, "label": aim.label})


def _draw_sensed(axes: Axes, run: Run, signal: str) -> None:
    """Draw what the controller reads of a signal as points, and a stroke where it reads nothing."""
    curve = read_sensed(run, signal)
    if curve is None:
        return
    draw_points(axes, curve.time_s, curve.values, **SENSED)
    lost_s = (run.poses.time_ns[run.poses.dropped_out] - run.start_ns) / 1e9
    if len(lost_s):
        edge = np.full(len(lost_s), 0.02)
        axes.plot(lost_s, edge, transform=axes.get_xaxis_transform(), **DROPPED_OUT)
