"""The plane of several runs: starts, goals, origin, tracked paths, and gaps of driven paths."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.charts.curves import Curve, Values
from turtlelog.errors import ReplayError, ShowError
from turtlelog.measure import find_outliers
from turtlelog.measure.breaks import find_gap_rows
from turtlelog.measure.references import hold_reference
from turtlelog.plants import TURTLESIM, find_plant
from turtlelog.plants.turtlesim import WORLD_SIZE_M
from turtlelog.replay.breaks_and_commands import find_breaks, read_motion
from turtlelog.run import Run
from turtlelog.run.paths import Path

Point = tuple[float, float]

_POINTS_PER_TURN: Final = 1440
"""Points of a drawn circle: off by 2.4e-6 of the radius, about the rounding of poses."""


def list_starts(runs: Sequence[Run]) -> Values:
    """Return the first pose of each run without duplicates [m], shape (n, 2)."""
    return np.unique([xy_m for run in runs for xy_m in run.poses.xy_m[:1]], axis=0).reshape(-1, 2)


def list_goals(runs: Sequence[Run]) -> Values:
    """Return the goals of the runs without duplicates [m], shape (n, 2)."""
    goals = {run.goal_xy_m for run in runs if run.goal_xy_m is not None}
    return np.array(sorted(goals)).reshape(-1, 2)


def list_places(run: Run) -> Values:
    """Return the positions of the robot, of its reference, and of the path that it tracks [m]."""
    aims, places = run.samples.reference_xy_m, [run.poses.xy_m]
    if aims is not None:
        places.append(aims[np.isfinite(aims[:, 0])])
    return np.concatenate([*places, *map(outline_path, list_paths([run]))])


def is_in_world(runs: Sequence[Run]) -> bool:
    """Return whether every position lies in turtlesim's world.

    The result is False for a robot other than turtlesim, or one known to have no walls.
    """
    if not all(is_turtlesim(run) for run in runs):
        return False
    places = [list_places(run) for run in runs]
    return all(xy_m.min() >= 0.0 and xy_m.max() <= WORLD_SIZE_M for xy_m in places)


_FAR_M: Final = 10_000.0
"""Distance from which coordinates are shifted [m], because their tick labels would touch."""

LEAST_SHOWN_M: Final = 0.5
"""Smallest side of a plane [m]; in a smaller plane, noise of poses would look like a path."""

_STILL_M: Final = 1e-3
"""Extent within which a robot has not moved [m]: poses have noise and a resolution."""

_STILL_RAD: Final = 1e-3


def find_origin(runs: Sequence[Run]) -> Point:
    """Return the origin of x and y [m]: the first start in whole metres, or 0 if the start is near.

    Each coordinate has its own offset. A path in a scenario is always near.
    """
    if not runs or any(run.path is not None for run in runs):
        return (0.0, 0.0)
    x_m, y_m = (float(round(one)) if abs(one) >= _FAR_M else 0.0 for one in runs[0].poses.xy_m[0])
    return x_m, y_m


def move_near(runs: Sequence[Run]) -> tuple[list[Run], str]:
    """Return runs with coordinates relative to `find_origin`, and text on this offset.

    Pictures with 32-bit floats resolve half a metre at coordinates of five million. The text, such
    as `x from 448,262 m, y from 5,411,933 m`, is empty if all runs are near.
    """
    origin_m = find_origin(runs)
    if origin_m == (0.0, 0.0):
        return [*runs], ""
    moved = []
    for run in runs:
        goal, sensed, reference = run.goal_xy_m, run.poses.sensed_xy_m, run.samples.reference_xy_m
        near = None if sensed is None else sensed - origin_m
        poses = replace(run.poses, xy_m=run.poses.xy_m - origin_m, sensed_xy_m=near)
        near = None if reference is None else reference - origin_m
        samples = replace(run.samples, reference_xy_m=near)
        goal = None if goal is None else (goal[0] - origin_m[0], goal[1] - origin_m[1])
        moved.append(replace(run, poses=poses, samples=samples, goal_xy_m=goal))
    named = zip("xy", origin_m, strict=True)
    return moved, ", ".join(
        label_coordinate(name, offset_m) for name, offset_m in named if offset_m
    )


def label_coordinate(name: str, origin_m: float) -> str:
    """Return the name of an axis: `x [m]`, or `x from 448,262 m`."""
    return f"{name} from {origin_m:,.0f} m" if origin_m else f"{name} [m]"


def tell_still(runs: Sequence[Run]) -> str:
    """Return a sentence on runs that did not leave their start; empty if all did."""
    still = [run for run in runs if np.ptp(run.poses.xy_m, axis=0).max() < _STILL_M]
    if not still:
        return ""
    if len(runs) > 1:
        return f"{len(still)} of {len(runs)} runs stayed at their start"
    has_turned = np.ptp(np.unwrap(runs[0].poses.heading_rad)) > _STILL_RAD
    return "turned on the spot" if has_turned else "did not move"


def has_own_way(run: Run) -> bool:
    """Return whether the run's reference moves on its own trajectory, not on the tracked path."""
    return run.path is None or any(loop.reference == "recorded" for loop in run.declaration.loops)


def read_way_to_reference(run: Run) -> Values | None:
    """Return the vector from every pose to the reference held at that time [m], shape (n, 2)."""
    held_xy_m = hold_reference(run, run.samples.reference_xy_m)
    return None if held_xy_m is None else held_xy_m - run.poses.xy_m


def part_path(run: Run) -> Values:
    """Return the positions of a run [m], shape (n, 2), with NaN before each break of its poses.

    The robot did not drive between the poses before and after a reset or teleport. The robot's
    position is unknown while it sent no poses.
    """
    return np.insert(run.poses.xy_m, find_break_rows(run), np.nan, axis=0)


def part_curve(run: Run, curve: Curve) -> Curve:
    """Return a curve with NaN before each break of the poses in which the curve has no row."""
    rows = find_break_rows(run)
    if not len(rows):
        return curve
    before_ns, after_ns = run.poses.time_ns[rows - 1], run.poses.time_ns[rows]
    places = np.searchsorted(curve.time_ns, after_ns)
    is_inside = (places > 0) & (places < len(curve.time_ns))
    is_bare = np.searchsorted(curve.time_ns, before_ns, side="right") == places
    kept = is_inside & is_bare
    time_ns = np.insert(curve.time_ns, places[kept], after_ns[kept])
    return replace(curve, time_ns=time_ns, values=np.insert(curve.values, places[kept], np.nan))


def find_break_rows(run: Run) -> NDArray[np.int64]:
    """Return the rows of poses before which curves break: at jumps, and after gaps."""
    gaps = _find_long_gaps(run.poses.time_ns, min(_find_least_ns(run), _LEAST_NS))
    return np.unique(np.array([*find_jump_rows(run), *gaps], dtype=np.int64))


def find_time_breaks(time_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the rows before which curves over some times break, after gaps."""
    return _find_long_gaps(time_ns, min(_LEAST_SHARE * float(np.ptp(time_ns)), _LEAST_NS))


def _find_long_gaps(time_ns: NDArray[np.int64], least_ns: float) -> NDArray[np.int64]:
    rows = find_gap_rows(time_ns)
    return rows[time_ns[rows] - time_ns[rows - 1] >= least_ns]


def find_jump_rows(run: Run) -> NDArray[np.int64]:
    """Return the rows of poses after jumps, for turtlesim without samples."""
    none = np.zeros(0, dtype=np.int64)
    if len(run.samples) or not is_turtlesim(run):
        return none
    try:
        jumps, _, _ = find_breaks(read_motion(run))
    except ReplayError:
        return none
    return np.asarray(np.searchsorted(run.poses.time_ns, [jump.at_ns for jump in jumps]))


def read_pace(run: Run, rows: NDArray[np.int64]) -> Values:
    """Return the speed of a run between some of its poses [m/s], shape (n - 1,).

    For runs without samples, the reported speed is used, because the times of their poses jitter.
    Outliers are clipped to the largest of the other values.
    """
    poses = run.poses
    way_m, time_ns = np.diff(poses.xy_m[rows], axis=0), poses.time_ns[rows]
    pace = np.hypot(*way_m.T) / (np.diff(time_ns) / 1e9)
    if len(run.samples) or not len(pace):
        return np.asarray(pace)
    reported = poses.measured_speed_m_s if poses.speed_m_s is None else poses.speed_m_s
    if reported is not None:
        pace = np.abs(reported[rows][1:])
    rest = np.delete(pace, find_outliers(time_ns[1:], pace))
    return np.asarray(np.minimum(pace, rest.max()))


_LEAST_SHARE: Final = 0.01
"""Smallest visible gap as a share of the duration: in a column of 70 mm, a millimetre."""

_LEAST_NS: Final = 1_000_000_000
"""Length from which a gap always interrupts curves [ns], because a view can be zoomed. Shorter gaps
in a long run are single poses that a busy computer lost."""

_MOST_NAMED: Final = 5  # gaps with text, the longest gaps; more text would cover the curves


def list_seen_gaps(run: Run) -> list[tuple[float, float, str]]:
    """Return start and end from the first sample [s], in order, and words of the longest gaps."""
    return list_time_gaps(run.poses.time_ns, run.start_ns, _find_least_ns(run), "poses")


def list_time_gaps(
    time_ns: NDArray[np.int64], zero_ns: int, least_ns: float | None = None, missing: str = "pairs"
) -> list[tuple[float, float, str]]:
    """Return the longest gaps of some times, as `list_seen_gaps` does.

    The times ascend, and the results are relative to a zero [ns]. The smallest length of a gap is
    1 % of the duration by default; `missing` is what a gap lacks.
    """
    least_ns = _LEAST_SHARE * float(np.ptp(time_ns)) if least_ns is None else least_ns
    rows = _find_long_gaps(time_ns, least_ns)
    lengths_ns = time_ns[rows] - time_ns[rows - 1]
    longest = np.sort(rows[np.argsort(-lengths_ns, kind="stable")[:_MOST_NAMED]])
    return [
        (
            (start_ns - zero_ns) / 1e9,
            (end_ns - zero_ns) / 1e9,
            f"{(end_ns - start_ns) / 1e9:.2g} s without {missing}",
        )
        for start_ns, end_ns in zip(
            time_ns[longest - 1].tolist(), time_ns[longest].tolist(), strict=True
        )
    ]


def tell_gap(runs: Sequence[Run]) -> str:
    """Return text on the longest gap in the poses of a single run; empty without a gap."""
    gaps = list_seen_gaps(runs[0]) if len(runs) == 1 else []
    return max(gaps, key=lambda gap: gap[1] - gap[0])[2] if gaps else ""


def _find_least_ns(run: Run) -> float:
    first_ns = [*run.poses.time_ns[:1].tolist(), run.start_ns][0]
    return _LEAST_SHARE * float(run.end_ns - first_ns)


def list_paths(runs: Sequence[Run]) -> tuple[Path, ...]:
    """Return the paths that the laws of runs track, at any speed, without duplicates."""
    paths = [run.path for run in runs]
    return tuple(dict.fromkeys(replace(path, speed_m_s=None) for path in paths if path is not None))


def outline_path(path: Path) -> Values:
    """Return the points for drawing a path [m], shape (n, 2); a closed path is closed."""
    if path.points is not None:
        points = [*path.points, *path.points[:1]] if path.is_closed else path.points
        return np.array(points, dtype=np.float64)
    turns = 1 if path.kind == "circle" else 2
    arcs_m = np.linspace(0.0, path.length_m, turns * _POINTS_PER_TURN + 1).tolist()
    return np.array([path.locate(arc_m)[:2] for arc_m in arcs_m])


def is_turtlesim(run: Run) -> bool:
    """Return whether poses are those of turtlesim, which alone publishes applied velocities.

    A run with a controller's samples counts as turtlesim's.
    """
    publishes = run.poses.speed_m_s is not None or len(run.samples) > 0
    return publishes and find_plant(run) == TURTLESIM


_FARTHEST_M: Final = 1e150
"""Largest distance from the origin whose square is still a finite number [m]."""


def require_near(runs: Sequence[Run]) -> None:
    """Raise ShowError, with run and distance, for a pose too far away to be drawn."""
    for run in runs:
        far_m = float(np.abs(run.poses.xy_m).max(initial=0.0))
        if far_m > _FARTHEST_M:
            raise ShowError(
                f"{run.name}: a pose lies {far_m:g} m from the origin, and pictures show"
                f" {_FARTHEST_M:g} m at most. Its unit or its type may be wrong"
            )
