"""Figures of the plane: where the robot drove."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from turtlelog.run import Run
from turtlelog.show.figures.curves import draw_thinned
from turtlelog.show.figures.legend import label_runs
from turtlelog.show.figures.page import REFERENCE, choose_lines

_ARRIVED_M = 1.0


def draw_plane(figure: Figure, runs: Sequence[Run]) -> None:
    """Draw the paths from start to goal, and beside them how each ends, close up."""
    whole, close = figure.subplots(1, 2)
    _draw_paths(whole, runs)
    points = np.concatenate([run.poses.xy_m for run in runs] + [_list_goals(runs)])
    _show_square(whole, points.min(axis=0), points.max(axis=0), 0.08)
    whole.set(title="whole paths")
    _draw_paths(close, runs)
    _close_up(close, runs)


def _draw_paths(axes: Axes, runs: Sequence[Run]) -> None:
    for run, name, looks in zip(runs, label_runs(runs), choose_lines(len(runs)), strict=True):
        xy_m = run.poses.xy_m
        draw_thinned(axes, xy_m[:, 0], xy_m[:, 1], xy_m, **looks, label=name)
        axes.plot(*xy_m[-1], "o", ms=3.0, color=looks["color"])
    starts = np.unique([run.poses.xy_m[0] for run in runs], axis=0)
    axes.plot(*starts.T, "s", ms=4.0, color="0.3", label="start", zorder=3)
    goals = _list_goals(runs)
    if len(goals):
        axes.plot(*goals.T, "x", ms=6.0, mew=1.4, color="black", label="goal", zorder=3)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")


def _close_up(axes: Axes, runs: Sequence[Run]) -> None:
    """Show what lies around the one goal; without one, or where none came near, the ends."""
    goals, ends = _list_goals(runs), np.array([run.poses.xy_m[-1] for run in runs])
    center = goals[0] if len(goals) == 1 else ends.mean(axis=0)
    reach_m = np.hypot(*(ends - center).T)
    near_m = reach_m[reach_m < _ARRIVED_M]
    half_m = max(1.5 * float(near_m.max(initial=0.0)), 0.004)
    _show_square(axes, center - half_m, center + half_m, 0.0)
    for run in runs:
        tolerance_m = run.parameters.get("law.position_tolerance_m")
        if run.goal_xy_m is not None and isinstance(tolerance_m, int | float):
            corner = (run.goal_xy_m[0] - tolerance_m, run.goal_xy_m[1] - tolerance_m)
            axes.add_patch(
                Rectangle(
                    corner,
                    2 * tolerance_m,
                    2 * tolerance_m,
                    fill=False,
                    label="tolerance",
                    **REFERENCE,
                )
            )
    axes.set(title="how each run ends", ylabel="")
    axes.locator_params(nbins=5)


def _list_goals(runs: Sequence[Run]) -> "np.ndarray[tuple[int, int], np.dtype[np.float64]]":
    goals = sorted({run.goal_xy_m for run in runs if run.goal_xy_m is not None})
    return np.array(goals).reshape(-1, 2)


def _show_square(
    axes: Axes,
    low: "np.ndarray[tuple[int], np.dtype[np.float64]]",
    high: "np.ndarray[tuple[int], np.dtype[np.float64]]",
    margin: float,
) -> None:
    center, half = (low + high) / 2.0, max(float((high - low).max()) * (0.5 + margin), 1e-3)
    axes.set_xlim(center[0] - half, center[0] + half)
    axes.set_ylim(center[1] - half, center[1] + half)
