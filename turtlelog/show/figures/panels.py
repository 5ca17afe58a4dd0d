"""What figures of runs draw: panels over time, and the plane with how each run ends."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from matplotlib.ticker import SymmetricalLogLocator
from numpy.typing import NDArray

from turtlelog.loops import COMMAND_UNITS
from turtlelog.run import Run
from turtlelog.show.close_up import (
    CloseUp,
    Label,
    Lettering,
    find_close_up,
    find_tolerance,
    list_miss_labels,
    list_ring_labels,
)
from turtlelog.show.figures.figure_curves import (
    compute_ideals,
    draw_curve,
    draw_level,
    draw_points,
    draw_thinned,
)
from turtlelog.show.figures.page import (
    AIM,
    DROPPED_OUT,
    IDEAL,
    PUSHED,
    REFERENCE,
    SENSED,
    choose_lines,
    label_runs,
)
from turtlelog.show.figures.tracking_panels import (
    draw_tracked_paths,
    draw_ways_to_reference,
    draw_worst_place,
)
from turtlelog.show.robot_curves import lack_samples, part_curve, part_path, read_measured
from turtlelog.show.shared_curves import (
    REFERENCE as AIMED,
    Command,
    Curve,
    find_disturbance,
    find_limits,
    find_parameters,
    list_aims,
    list_levels,
    read_applied,
    read_command,
    read_curve,
    read_sensed,
)
from turtlelog.show.tracked_path import (
    WorstPlace,
    find_worst_place,
    has_own_way,
    label_worst_place,
    list_paths,
    outline_path,
    read_along_error,
)

Values = NDArray[np.float64]

_TOLERANCES = {"heading_error": "law.heading_tolerance_rad", "distance": "law.position_tolerance_m"}
_AIMED = frozenset({"heading", "x", "y", "along_track"})
"""Signals that come to something else than zero."""

_LIMIT = {**REFERENCE, "linestyle": (0, (5, 2)), "label": "limit"}
_TOLERANCE = {**REFERENCE, "linestyle": (0, (5, 2)), "label": "tolerance"}

_WORDS_POINTS: Final = 6.5
_RING: Final[Mapping[str, Any]] = MappingProxyType(
    {"color": "0.75", "linewidth": 0.5, "zorder": 1.2}
)

_MEASURED: Final[Mapping[str, Any]] = MappingProxyType(
    {"linestyle": "-", "linewidth": 0.8, "zorder": 1.9}
)
_COMMANDED: Final[Mapping[str, Any]] = MappingProxyType(
    {"linestyle": (0, (1, 1.5)), "linewidth": 0.8, "zorder": 1.8, "label": "commanded"}
)
"""Commands beside measured rates of the same run, in its colour."""

_OUTLIER: Final[Mapping[str, Any]] = MappingProxyType(
    {"linestyle": "", "marker": "v", "markersize": 4.0, "clip_on": False, "label": "outlier"}
)

_OUTLIER_ROOM: Final = 0.15
"""Of an axis' length, for a line of words on outliers below the curves."""

Draw = Callable[[Axes, Sequence[Run]], None]
"""Draws one panel of some runs."""


def draw_signal(axes: Axes, runs: Sequence[Run], *, signal: str, label: str) -> None:
    """Draw one signal of every run, with what it aims at and the ideal response where known."""
    axes.set_label(signal)
    _draw_targets(axes, runs, signal)
    _draw_aims(axes, runs, signal)
    for run, looks in _style_runs(runs):
        for ideal in compute_ideals(run, signal):
            draw_curve(axes, ideal, **{**looks, **IDEAL})
        if (curve := read_curve(run, signal)) is not None:
            draw_curve(axes, part_curve(run, curve), **looks)
    if len(runs) == 1:
        _draw_sensed(axes, runs[0], signal)
    _finish(axes, runs, label)


def draw_track(axes: Axes, runs: Sequence[Run]) -> None:
    """Draw how far runs came along the track; where all follow a reference, the error instead."""
    if all(read_along_error(run) is not None for run in runs):
        draw_along_error(axes, runs)
    else:
        draw_signal(axes, runs, signal="along_track", label="along-track [m]")


def draw_along_error(axes: Axes, runs: Sequence[Run]) -> None:
    """Draw how far every run is behind its reference along the track."""
    draw_level(axes, [0.0], **REFERENCE, label=None)
    for run, looks in _style_runs(runs):
        if (curve := read_along_error(run)) is not None:
            draw_curve(axes, curve, **looks)
    _finish(axes, runs, "along-track error [m]")


def draw_states(axes: Axes, runs: Sequence[Run], *, names: Sequence[str], label: str) -> None:
    """Draw states of a law: one of every run, or several of one run."""
    draw_level(axes, [0.0], color="0.8", linewidth=0.5)
    styled = _style_runs(runs)
    if len(names) > 1:
        lines = choose_lines(len(names))
        styled = [(runs[0], {**lines[i], "label": name}) for i, name in enumerate(names)]
    for (run, looks), name in zip(styled, [*names] * len(styled), strict=False):
        if name in run.declaration.states and (curve := read_curve(run, name)) is not None:
            draw_curve(axes, curve, **looks)
    _finish(axes, runs, label)


def draw_error_magnitude(axes: Axes, runs: Sequence[Run], *, signal: str, label: str) -> None:
    """Draw the magnitude of an error on a logarithmic scale: what is exponential is straight.

    The axis spans what was measured; an error of zero is a gap.
    """
    axes.set_label(f"|{signal}|")
    axes.set_yscale("log")
    _draw_tolerances(axes, runs, signal)
    extremes: list[float] = []
    for run, looks in _style_runs(runs):
        if (curve := read_curve(run, signal)) is None:
            continue
        sizes = np.where(curve.values == 0.0, np.nan, np.abs(curve.values))
        known = sizes[np.isfinite(sizes)]
        extremes += [known.min(), known.max()] if len(known) else []
        for ideal in compute_ideals(run, signal):
            decay = replace(ideal, values=np.abs(ideal.values))
            draw_curve(axes, decay, **{**looks, **IDEAL})
        draw_curve(axes, replace(curve, values=sizes), **looks)
    if extremes:
        axes.set_ylim(0.6 * min(extremes), 1.8 * max(extremes))
    _finish(axes, runs, label)


def draw_command(axes: Axes, runs: Sequence[Run], *, command: Command, label: str) -> None:
    """Draw a command: of one run wanted, commanded and applied, of several what was commanded.

    Beside it is what the robot measured, without outliers, which are named at the lower edge.
    """
    _draw_limits(axes, runs, command)
    if len(runs) == 1:
        if (pushed_s := find_disturbance(runs[0])) is not None:
            axes.axvspan(*pushed_s, **PUSHED)
        _draw_stages(axes, runs[0], command)
    else:
        _draw_commands(axes, runs, command)
    _finish(axes, runs, f"{label} [{COMMAND_UNITS[command]}]")
    _keep_to_limits(axes, runs, command)
    _name_outliers(axes, runs, command)


def draw_wanted(axes: Axes, runs: Sequence[Run], *, command: Command, label: str) -> None:
    """Draw commands before clipping, on a symmetric logarithmic scale that is linear to 1."""
    axes.set_yscale("symlog", linthresh=1.0)
    ticks = SymmetricalLogLocator(base=10.0, linthresh=1.0, subs=(1.0, 2.0, 5.0))
    axes.yaxis.set_major_locator(ticks)
    axes.yaxis.set_major_formatter("{x:g}")
    _draw_limits(axes, runs, command)
    for run, looks in _style_runs(runs):
        if (curve := read_curve(run, f"wanted_{command}")) is not None:
            draw_curve(axes, curve, **looks)
    _finish(axes, runs, f"{label} [{COMMAND_UNITS[command]}]")


def draw_stack(figure: Figure, runs: Sequence[Run], panels: Sequence[Draw]) -> None:
    """Draw panels over each other on one time axis."""
    grid = figure.subplots(len(panels), 1, sharex=True, squeeze=False)
    for axes, panel in zip(grid[:, 0], panels, strict=True):
        panel(axes, runs)
    for axes, _ in pairwise(grid[:, 0]):
        axes.set_xlabel("")


def draw_columns(figure: Figure, runs: Sequence[Run], panels: Sequence[Draw]) -> None:
    """Draw panels in two columns on one time axis, from left to right."""
    grid = figure.subplots(-(-len(panels) // 2), min(len(panels), 2), sharex=True, squeeze=False)
    for number, axes in enumerate(grid.flat):
        if number >= len(panels):
            axes.remove()
            continue
        panels[number](axes, runs)
        if number + 2 < len(panels):
            axes.set_xlabel("")
        else:
            axes.tick_params(labelbottom=True)


def draw_overview(figure: Figure, runs: Sequence[Run], panels: Sequence[Draw]) -> None:
    """Draw panels in two columns; of runs without samples over each other, beside the plane."""
    if not lack_samples(runs):
        draw_columns(figure, runs, panels)
        return
    grid = figure.add_gridspec(len(panels), 2, width_ratios=(1.0, 1.25))
    plane = figure.add_subplot(grid[:, 0])
    _draw_paths(plane, runs)
    _show_all(plane, runs)
    shared: Axes | None = None
    for number, panel in enumerate(panels):
        shared = axes = figure.add_subplot(grid[number, 1], sharex=shared)
        panel(axes, runs)
        # Low panels have no room for a unit beside its name.
        axes.set_ylabel(axes.get_ylabel().replace(" [", "\n["))
        if number + 1 < len(panels):
            axes.set_xlabel("")
            axes.tick_params(labelbottom=False)


def draw_plane(figure: Figure, runs: Sequence[Run]) -> None:
    """Draw the paths from start to goal, and beside them, where runs arrive, how each ends."""
    close_up = find_close_up(runs)
    worst = find_worst_place(runs) if close_up is None else None
    grid = figure.subplots(1, 2 if close_up or worst else 1, squeeze=False)[0]
    _draw_paths(grid[0], runs)
    _show_all(grid[0], runs)
    if len(grid) > 1 or not lack_samples(runs):
        grid[0].set(title="whole paths")
    if close_up is not None:
        _draw_paths(grid[1], runs)
        _close_up(grid[1], runs, close_up, _measure_letters(figure))
    if worst is not None:
        _draw_paths(grid[1], runs)
        _show_worst(grid[1], runs, worst, _measure_letters(figure))


def has_one_plane(runs: Sequence[Run]) -> bool:
    """Whether nothing stands beside the plane, of runs without samples."""
    return lack_samples(runs) and find_close_up(runs) is None and find_worst_place(runs) is None


def _show_all(axes: Axes, runs: Sequence[Run]) -> None:
    points = np.concatenate(
        [
            *(run.poses.xy_m for run in runs),
            _list_goals(runs),
            *_list_aims(runs),
            *map(outline_path, list_paths(runs)),
        ]
    )
    _show_square(axes, points.min(axis=0), points.max(axis=0), 0.08)


def _are_alike(one: Curve, other: Curve) -> bool:
    """Whether two references are the same: of runs that track one path by time."""
    return np.array_equal(one.time_s, other.time_s) and np.array_equal(
        one.values, other.values, equal_nan=True
    )


def _style_runs(runs: Sequence[Run]) -> list[tuple[Run, dict[str, Any]]]:
    styled = zip(runs, label_runs(runs), choose_lines(len(runs)), strict=True)
    return [(run, {**looks, "label": name}) for run, name, looks in styled]


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
    aims = [(aim, looks) for run, looks in _style_runs(runs) for aim in list_aims(run, signal)]
    while aims:
        (aim, looks), *others = aims
        aims = [(other, of) for other, of in others if not _are_alike(aim, other)]
        shared = {"color": REFERENCE["color"]} if len(aims) < len(others) else {}
        draw_curve(axes, aim, **{**looks, **AIM, **shared, "label": aim.label})


def _draw_limits(axes: Axes, runs: Sequence[Run], command: Command) -> None:
    draw_level(axes, [0.0], color="0.8", linewidth=0.5)
    levels = [sign * limit for limit in find_limits(runs, command) for sign in (1.0, -1.0)]
    draw_level(axes, levels, **_LIMIT)


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


def _draw_stages(axes: Axes, run: Run, command: Command) -> None:
    lines = choose_lines(4)
    # The plant tells its speed without a sign.
    applied = "|applied|" if command == "speed" else "applied"
    measured = read_measured(run, command)
    stages = (
        ("wanted", read_curve(run, f"wanted_{command}"), {**lines[1], "linewidth": 0.9}),
        ("shaped", read_curve(run, f"shaped_{command}"), {**lines[3], "linewidth": 0.9}),
        ("commanded", read_command(run, command), {**lines[0], "linewidth": 1.7}),
        (applied, read_applied(run, command), {**lines[2], "linewidth": 0.8}),
        ("measured", None if measured is None else measured.curve, {**lines[2], **_MEASURED}),
    )
    for name, curve, looks in stages:
        if curve is not None:
            draw_curve(axes, curve, **looks, label=name)


def _draw_commands(axes: Axes, runs: Sequence[Run], command: Command) -> None:
    """Draw what was commanded of several runs, finer where the answer was measured as well."""
    for run, looks in _style_runs(runs):
        curve, measured = read_command(run, command), read_measured(run, command)
        if measured is not None:
            draw_curve(axes, measured.curve, **looks)
            looks = {**looks, **_COMMANDED}
        if curve is not None:
            draw_curve(axes, curve, **looks)


def _name_outliers(axes: Axes, runs: Sequence[Run], command: Command) -> None:
    """Name the outliers that the axis leaves out, with a mark at each one's time."""
    lines = []
    for (run, looks), name in zip(_style_runs(runs), label_runs(runs), strict=True):
        measured = read_measured(run, command)
        if measured is None or not (words := measured.name_outliers()):
            continue
        color = choose_lines(4)[2]["color"] if len(runs) == 1 else looks["color"]
        at_s, edge = measured.outliers.time_s, axes.get_xaxis_transform()
        axes.plot(at_s, np.zeros(len(at_s)), transform=edge, color=color, **_OUTLIER)
        lines.append(words if len(runs) == 1 else f"{name}: {words}")
    if lines:
        low, high = axes.get_ylim()
        axes.set_ylim(low - _OUTLIER_ROOM * len(lines) * (high - low), high)
        text = axes.text(0.99, 0.03, "\n".join(lines), fontsize=_WORDS_POINTS, color="0.3")
        text.set(transform=axes.transAxes, ha="right", va="bottom")


def _keep_to_limits(axes: Axes, runs: Sequence[Run], command: Command) -> None:
    """End the axis a little beyond the limits: what was wanted may lie far outside."""
    limits = find_limits(runs, command)
    if not limits:
        return
    curves = [read_command(run, command) for run in runs]
    if len(runs) == 1 and find_disturbance(runs[0]) is not None:
        curves.append(read_applied(runs[0], command))
    low = min((float(curve.values.min()) for curve in curves if curve), default=0.0)
    high = max((float(curve.values.max()) for curve in curves if curve), default=0.0)
    axes.set_ylim(min(1.3 * low, -0.2 * limits[-1]), 1.3 * max(high, limits[-1]))


def _finish(axes: Axes, runs: Sequence[Run], label: str) -> None:
    firsts = dict.fromkeys("sample" if len(run.samples) else "pose" for run in runs)
    axes.set(xlabel=f"time from the first {' or '.join(firsts)} [s]", ylabel=label)
    axes.margins(x=0.01)
    axes.locator_params(axis="x", nbins=6)


def _draw_paths(axes: Axes, runs: Sequence[Run]) -> None:
    draw_tracked_paths(axes, runs)
    draw_ways_to_reference(axes, runs)
    for run, name, looks in zip(runs, label_runs(runs), choose_lines(len(runs)), strict=True):
        xy_m = run.poses.xy_m
        driven_m = part_path(run)
        draw_thinned(axes, driven_m[:, 0], driven_m[:, 1], driven_m, **looks, label=name)
        if len(runs) == 1 and run.poses.sensed_xy_m is not None:
            draw_points(axes, *run.poses.sensed_xy_m.T, **SENSED)
        (end,) = axes.plot(*xy_m[-1], "o", ms=3.0, color=looks["color"])
        if lack_samples(runs) and len(runs) == 1:
            end.set_label("end")
        for aims_m in _list_aims([run]) if has_own_way(run) else ():
            draw_thinned(axes, aims_m[:, 0], aims_m[:, 1], aims_m, **{**looks, **AIM}, label=AIMED)
    starts = np.unique([run.poses.xy_m[0] for run in runs], axis=0)
    axes.plot(*starts.T, "s", ms=4.0, color="0.3", label="start", zorder=3)
    goals = _list_goals(runs)
    if len(goals):
        axes.plot(*goals.T, "x", ms=6.0, mew=1.4, color="black", label="goal", zorder=3)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")


def _close_up(axes: Axes, runs: Sequence[Run], close_up: CloseUp, lettering: Lettering) -> None:
    """Show what lies around the goal: rings, and how far from it each run ends."""
    goal = np.array(close_up.goal_xy_m)
    _show_square(axes, goal - close_up.half_m, goal + close_up.half_m)
    for run in runs:
        if run.goal_xy_m is not None and (tolerance_m := find_tolerance(run)) is not None:
            corner = (run.goal_xy_m[0] - tolerance_m, run.goal_xy_m[1] - tolerance_m)
            side_m = 2 * tolerance_m
            axes.add_patch(
                Rectangle(corner, side_m, side_m, fill=False, label="tolerance", **REFERENCE)
            )
    for ring_m in close_up.rings_m:
        axes.add_patch(Circle(close_up.goal_xy_m, ring_m, fill=False, **_RING))
    misses = list_miss_labels(close_up, lettering)
    lines = choose_lines(len(runs))
    for label in misses:
        color = lines[label.runs[0]]["color"] if len(label.runs) == 1 else "0.2"
        _write(axes, label, color)
    for label in list_ring_labels(close_up, runs[0].poses.xy_m[0], misses, lettering):
        _write(axes, label, "0.45")
    axes.set(title=f"how each run ends{close_up.count_outside()}", ylabel="")
    axes.locator_params(nbins=5)


def _show_worst(axes: Axes, runs: Sequence[Run], worst: WorstPlace, lettering: Lettering) -> None:
    """Show where runs are furthest from their path, and how far that is."""
    center, looks = np.array(worst.center_xy_m), choose_lines(len(runs))[worst.run]
    _show_square(axes, center - worst.half_m, center + worst.half_m)
    draw_worst_place(axes, worst, looks)
    _write(axes, label_worst_place(worst, lettering), looks["color"])
    axes.set(title="furthest off the path", ylabel="")
    axes.locator_params(nbins=5)


def _write(axes: Axes, label: Label, color: Any) -> None:
    box = {"facecolor": "white", "edgecolor": "none", "pad": 0.5, "alpha": 0.8}
    words = axes.text(*label.xy_m, label.text, color=color, fontsize=_WORDS_POINTS)
    words.set(ha="center", va="center", bbox=box)


def _measure_letters(figure: Figure) -> Lettering:
    """Return the room that words take: a close-up is about two fifths of the figure wide."""
    half_points, size = 0.2 * figure.get_figwidth() * 72.0, _WORDS_POINTS
    return Lettering(
        letter=0.62 * size / half_points, line=1.5 * size / half_points, gap=8.0 / half_points
    )


def _list_aims(runs: Sequence[Run]) -> list[Values]:
    """Return the places where laws wanted their robots to be, of each run that records them."""
    found = [run.samples.reference_xy_m for run in runs]
    known = [xy_m[np.isfinite(xy_m[:, 0])] for xy_m in found if xy_m is not None]
    return [xy_m for xy_m in known if len(xy_m)]


def _list_goals(runs: Sequence[Run]) -> Values:
    goals = sorted({run.goal_xy_m for run in runs if run.goal_xy_m is not None})
    return np.array(goals).reshape(-1, 2)


def _show_square(axes: Axes, low: Values, high: Values, margin: float = 0.0) -> None:
    center, half = (low + high) / 2.0, max(float((high - low).max()) * (0.5 + margin), 1e-3)
    axes.set_xlim(center[0] - half, center[0] + half)
    axes.set_ylim(center[1] - half, center[1] + half)
