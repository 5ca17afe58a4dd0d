"""What the errors at the end of a phase say of the tolerance that ended it."""

import math
from typing import Final

import numpy as np

from turtlelog.explain.command_fit import CommandFit
from turtlelog.explain.constant_recovery import find_round_number
from turtlelog.explain.finding import Certainty, Finding, miss
from turtlelog.explain.trace import Trace, Values

DEFAULT_TOLERANCE: Final = 0.001
"""Of heading [rad] and position [m], where the log does not tell."""

_LAST_TWO: Final = "the errors at the end and before it"
_NOISY: Final = "noise; from the last errors and commands"

_SURE: Final = 4.0
"""Standard deviations that a bound read off one noisy error is moved outwards by: a bound that
holds always, and no interval of 95 %."""


def bracket_heading_tolerance(trace: Trace, error: Values, fit: CommandFit | None) -> Finding:
    """Bracket it between the error that ended the rotation and the least that still turned."""
    moving = slice(1, trace.rotating - trace.ended_rotation)
    ended = float(abs(error[trace.rotating - 1])) if trace.ended_rotation else 0.0
    if fit is not None and fit.gain is not None and not fit.is_certain:
        if fit.obstacle:
            return miss(fit.obstacle, DEFAULT_TOLERANCE)
        # A command tells its error better than the noisy pose.
        commands = np.abs(trace.turn_rate_rad_s[moving])
        least = float(commands[commands > 0.0].min()) / fit.gain.interval[0]
        return _bound(ended, least, fit.gain.noise, "rad", high_noise=0.0)
    if not np.any(trace.turn_rate_rad_s[moving]):
        return miss("the run has no command that turns", DEFAULT_TOLERANCE)
    high = float(np.abs(error[moving]).min(initial=math.inf))
    if not trace.ended_rotation:
        return _bracket(0.0, high, "the rotation has no end", "rad")
    return _bracket(ended, high, _LAST_TWO, "rad")


def bracket_position_tolerance(errors: Values, command: Values, fit: CommandFit) -> Finding:
    """Bracket it between the error that ended the run and the least that still drove."""
    larger = np.abs(errors).max(axis=1)
    is_within = command[-1] == 0.0
    if fit.gain is not None and not fit.is_certain:
        if fit.obstacle:
            return miss(fit.obstacle, DEFAULT_TOLERANCE)
        driven = float(larger[command != 0.0][-1])
        return _bound(float(larger[-1]) if is_within else 0.0, driven, fit.gain.noise, "m")
    high = float(larger[command != 0.0].min())
    if not is_within:
        return _bracket(0.0, high, "the run ends outside it", "m")
    return _bracket(float(larger[-1]), high, _LAST_TWO, "m")


def _bound(
    low: float, high: float, noise: float, unit: str, *, high_noise: float | None = None
) -> Finding:
    """Return bounds from noisy errors, moved outwards by what noise may have done."""
    low = max(low - _SURE * noise, 0.0)
    high += _SURE * (noise if high_noise is None else high_noise)
    return Finding(
        certainty=Certainty.UNKNOWN,
        evidence=f"{_NOISY}: {_name_bounds(low, high, unit)}",
        interval=(low, high),
        assumed=_choose(low, high),
    )


def _bracket(low: float, high: float, evidence: str, unit: str) -> Finding:
    if low >= high:
        return miss("errors that moved are no larger than the one that ended", DEFAULT_TOLERANCE)
    if low <= 0.0 or math.isinf(high):
        return Finding(
            certainty=Certainty.UNKNOWN,
            evidence=f"{evidence}: {_name_bounds(low, high, unit)}",
            interval=(low, high),
            assumed=_choose(low, high),
        )
    return Finding(
        value=_choose(low, high),
        certainty=Certainty.BRACKETED,
        evidence=evidence,
        interval=(low, high),
    )


def _choose(low: float, high: float) -> float:
    """Return the usual tolerance where it fits, else the roundest."""
    if low <= DEFAULT_TOLERANCE < high:
        return DEFAULT_TOLERANCE
    return find_round_number(low, min(high, 10.0 * low) if low > 0.0 else high)


def _name_bounds(low: float, high: float, unit: str) -> str:
    if low <= 0.0:
        return f"below {high:.4g} {unit}"
    return f"at least {low:.4g} {unit}" + ("" if math.isinf(high) else f", below {high:.4g} {unit}")
