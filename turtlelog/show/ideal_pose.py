"""The ideal loop as a ghost: the poses that follow from the ideal responses of a run's loops."""

from typing import Final

import numpy as np

from turtlelog.angles import wrap_angle
from turtlelog.run import PoseColumns, Run
from turtlelog.show.shared_curves import find_steps

NAME: Final = "ideal loop"


def find_ideal_poses(run: Run) -> PoseColumns | None:
    """Return where the ideal loops of a run would be at its own pose times.

    Each begins where the run's loop does, as its ideal response in the plots: nothing is clipped.
    Theory tells a pose where a loop turns the robot, and another then drives it along its track.

    Returns:
        None where theory does not know both, or where they act together.
    """
    turns, ways = [*find_steps(run, "heading")], [*find_steps(run, "along_track")]
    line = run.goal_line
    if len(turns) != 1 or len(ways) != 1 or line is None or not len(run.poses):
        return None
    (turn,), (way,) = turns, ways
    loops = {loop.name for loop in run.declaration.loops}
    if loops != {turn.loop.name, way.loop.name} or turn.end_ns > way.start_ns:
        return None
    time_ns = run.poses.time_ns
    after_s = np.maximum(time_ns - turn.start_ns, 0) / 1e9
    heading_rad = np.radians(turn.respond(after_s))
    driven_s = np.maximum(time_ns - way.start_ns, 0) / 1e9
    along_m = way.respond(driven_s)
    ahead = np.array([np.cos(line.bearing_rad), np.sin(line.bearing_rad)])
    xy_m = line.start_xy_m + along_m[:, np.newaxis] * ahead
    return PoseColumns(time_ns=time_ns, xy_m=xy_m, heading_rad=wrap_angle(heading_rad))
