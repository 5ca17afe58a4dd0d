"""What the runs of a plane share: starts, goals, and whether they stay in the world.

Figures, Rerun, reports and movies draw what stands here.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from turtlelog.charts.robot_curves import is_turtlesim
from turtlelog.charts.tracked_path import list_paths, outline_path
from turtlelog.plants import TURTLESIM, find_plant
from turtlelog.plants.turtlesim import WORLD_SIZE_M
from turtlelog.run import Run

Values = NDArray[np.float64]


def list_starts(runs: Sequence[Run]) -> Values:
    """Return the first pose of each run [m], each place once, shape (n, 2)."""
    return np.unique([xy_m for run in runs for xy_m in run.poses.xy_m[:1]], axis=0).reshape(-1, 2)


def list_goals(runs: Sequence[Run]) -> Values:
    """Return the goals of runs that have one [m], each place once, shape (n, 2)."""
    goals = {run.goal_xy_m for run in runs if run.goal_xy_m is not None}
    return np.array(sorted(goals)).reshape(-1, 2)


def list_places(run: Run) -> Values:
    """Return where the robot is, where its law wants it to be, and the path that it tracks [m]."""
    aims, places = run.samples.reference_xy_m, [run.poses.xy_m]
    if aims is not None:
        places.append(aims[np.isfinite(aims[:, 0])])
    return np.concatenate([*places, *map(outline_path, list_paths([run]))])


def is_in_world(runs: Sequence[Run]) -> bool:
    """Whether every place lies in turtlesim's world.

    A robot that is no turtle, or is known to have no walls, is not in it, wherever it drives.
    """
    if any(find_plant(run) != TURTLESIM or not is_turtlesim(run) for run in runs):
        return False
    places = [list_places(run) for run in runs]
    return all(xy_m.min() >= 0.0 and xy_m.max() <= WORLD_SIZE_M for xy_m in places)
