"""Where a run begins and where it should go."""

from typing import Any, Final

import numpy as np

from turtlelog.explain.finding import Certainty, Finding, find_exactly, miss
from turtlelog.explain.search import START_KEYS, Fits
from turtlelog.explain.trace import Trace

_GOAL_KEYS: Final = ("goal.x_m", "goal.y_m")


def read_start(trace: Trace) -> dict[str, Any]:
    """Return what to simulate with at first, by key of the scenario: the first pose read."""
    precision = "float32" if _is_single(trace) else "float64"
    first = (*trace.xy_m[0].tolist(), float(trace.heading_rad[0]))
    return {**dict(zip(START_KEYS, first, strict=True)), "loop.pose_precision": precision}


def describe_goal(trace: Trace) -> dict[str, Finding]:
    """Return the goal, as the log holds it."""
    if trace.goal_xy_m is None:
        return dict.fromkeys(_GOAL_KEYS, miss("the log does not hold the goal"))
    evidence = "as logged" if trace.run.goal_xy_m else "position plus error, as logged"
    return {
        key: find_exactly(value, evidence)
        for key, value in zip(_GOAL_KEYS, trace.goal_xy_m, strict=True)
    }


def describe_start(trace: Trace, fits: Fits) -> dict[str, Finding]:
    """Return start and precision of the poses, by key of the scenario."""
    read = read_start(trace)
    precision = read.pop("loop.pose_precision")
    return {
        **_describe_pose(fits, read),
        "loop.pose_precision": _describe_precision(fits, precision),
    }


def _describe_pose(fits: Fits, read: dict[str, Any]) -> dict[str, Finding]:
    if fits.is_exact and fits.bounds is None:
        return {key: find_exactly(value, "first pose read") for key, value in read.items()}
    if fits.bounds is not None:
        bounds = zip(read, fits.bounds.middle, fits.bounds.low, fits.bounds.high, strict=True)
        return {
            key: Finding(
                value=value,
                certainty=Certainty.BRACKETED,
                evidence="between the steps of logged poses; all poses agree with it",
                interval=(low, high),
            )
            for key, value, low, high in bounds
        }
    if fits.drive is None or not fits.is_fitted:
        reason = "no setting explains the motion; taken from the first pose read"
        return {key: miss(reason, value) for key, value in read.items()}
    if fits.drive.is_rounding:
        reason = "no start makes every pose round as logged; taken from the first pose read"
        return {key: miss(reason, value) for key, value in read.items()}
    found = zip(read, fits.drive.start, fits.drive.reach, strict=True)
    return {
        key: Finding(
            value=value,
            certainty=Certainty.FITTED,
            evidence="least squares of all poses, 95 %",
            interval=(value - reach, value + reach),
        )
        for key, value, reach in found
    }


def _describe_precision(fits: Fits, precision: str) -> Finding:
    if precision == "float64" and not fits.is_exact:
        return miss("poses have more than 32 bits, which noise may have added", precision)
    evidence = "every pose is a 32-bit float"
    if precision == "float64":
        evidence = "poses have more than 32 bits"
    if fits.is_exact:
        return find_exactly(precision, evidence)
    return Finding(value=precision, certainty=Certainty.FITTED, evidence=evidence)


def _is_single(trace: Trace) -> bool:
    poses = trace.run.poses
    values = np.column_stack([poses.xy_m, poses.heading_rad])
    return bool((values == values.astype(np.float32)).all())
