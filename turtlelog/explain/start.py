"""Where a run begins and where it should go."""

import numpy as np

from turtlelog.explain.finding import Certainty, Finding, find_exactly, miss
from turtlelog.explain.trace import Trace


def identify_start(trace: Trace, dead_time_ticks: int) -> dict[str, Finding]:
    """Return start, goal and the precision of poses, by key of the scenario."""
    poses = trace.run.poses
    values = np.column_stack([poses.xy_m, poses.heading_rad])
    single = bool((values == values.astype(np.float32)).all())
    precision = "float32" if single else "float64"
    goal = trace.goal_xy_m or (None, None)
    goal_evidence = "as logged" if trace.run.goal_xy_m else "position plus error, as logged"
    return {
        **_find_start(trace, dead_time_ticks),
        **{
            f"goal.{axis}_m": miss("the log does not hold the goal")
            if value is None
            else find_exactly(value, goal_evidence)
            for axis, value in zip("xy", goal, strict=True)
        },
        "loop.pose_precision": find_exactly(
            precision,
            "every pose is a 32-bit float" if single else "poses have more than 32 bits",
        ),
    }


def _find_start(trace: Trace, dead_time_ticks: int) -> dict[str, Finding]:
    """Return the first pose read, or the mean of those before the first command acts."""
    standing = slice(0, dead_time_ticks // trace.period_ticks + 1)
    poses = np.column_stack([trace.xy_m, trace.heading_rad])[standing]
    names = ("start.x_m", "start.y_m", "start.heading_rad")
    if (poses == poses[0]).all():
        found = poses[0].tolist()
        return {
            name: find_exactly(value, "first pose read")
            for name, value in zip(names, found, strict=True)
        }
    evidence = f"mean of {len(poses)} poses before the first command acts"
    return {
        name: Finding(value=value, certainty=Certainty.FITTED, evidence=evidence)
        for name, value in zip(names, poses.mean(axis=0).tolist(), strict=True)
    }
