"""What the errors at the end of a phase say of the tolerance that ended it."""

import math
from typing import Final

import numpy as np

from turtlelog.explain.finding import Certainty, Finding, miss
from turtlelog.explain.numbers import find_round_number
from turtlelog.explain.trace import Trace, Values

DEFAULT_TOLERANCE: Final = 0.001
"""Of heading [rad] and position [m], where the log does not tell."""

_LAST_TWO: Final = "the errors at the end and before it"


def bracket_heading_tolerance(trace: Trace, error: Values) -> dict[str, Finding]:
    """Bracket it between the error that ended the rotation and the least that still turned."""
    key = "law.heading_tolerance_rad"
    moving = np.abs(error[1 : trace.rotating - trace.ended_rotation])
    if not trace.ended_rotation:
        high = float(moving.min()) if len(moving) else math.inf
        return {key: _bracket(0.0, high, "the rotation has no end", "rad")}
    ended = float(abs(error[trace.rotating - 1]))
    high = float(moving.min()) if len(moving) else math.inf
    return {key: _bracket(ended, high, _LAST_TWO, "rad")}


def bound_heading_tolerance(high: float) -> dict[str, Finding]:
    """Bound it by the error that the last command tells; the poses tell one with noise."""
    return {
        "law.heading_tolerance_rad": _bracket(0.0, high, "noise; the last command and gain", "rad")
    }


def bracket_position_tolerance(errors: Values, command: Values) -> Finding:
    """Bracket it between the error that ended the run and the least that still drove."""
    larger = np.abs(errors).max(axis=1)
    high = float(larger[command != 0.0].min())
    if command[-1] != 0.0:
        return _bracket(0.0, high, "the run ends outside it", "m")
    return _bracket(float(larger[-1]), high, _LAST_TWO, "m")


def _bracket(low: float, high: float, evidence: str, unit: str) -> Finding:
    if low >= high:
        return miss("noise: errors that moved are no larger than the one that ended", low)
    rounded = DEFAULT_TOLERANCE
    if not low <= rounded < high:
        rounded = find_round_number(low, min(high, 10.0 * low) if low > 0.0 else high)
    if low <= 0.0 or math.isinf(high):
        bound = f"below {high:.4g} {unit}" if low <= 0.0 else f"at least {low:.4g} {unit}"
        return Finding(
            certainty=Certainty.UNKNOWN,
            evidence=f"{evidence}: {bound}",
            interval=(low, high),
            assumed=rounded,
        )
    return Finding(
        value=rounded, certainty=Certainty.BRACKETED, evidence=evidence, interval=(low, high)
    )
