"""The settings that a search found, as findings."""

from typing import Final

import numpy as np

from turtlelog.explain.finding import Certainty, Finding, find_exactly, miss
from turtlelog.explain.identification import LOOP_KEYS
from turtlelog.explain.resimulation import count_lost_commands
from turtlelog.explain.search import Fits
from turtlelog.explain.trace import Trace

_PERIOD: Final = "the usual distance of the poses answered"


def describe_loop(trace: Trace, fits: Fits, *, is_noisy: bool) -> dict[str, Finding]:
    """Return what lies between controller and plant, and the lost commands.

    Where nothing is exact although the log has no noise, what fits best is no finding.
    """
    findings = {
        key: _describe_setting(trace, fits, key)
        if fits.is_exact or is_noisy
        else _describe_nearest(fits, key)
        for key in LOOP_KEYS
    }
    findings["lost_commands"] = _describe_lost(fits)
    poses = np.column_stack([trace.xy_m, trace.heading_rad])
    if not np.ptp(poses, axis=0).any():
        reason = "the robot never moves in this log"
        findings = {key: miss(reason, fits.guesses[0][key]) for key in LOOP_KEYS}
        return {**findings, "lost_commands": miss(reason)}
    if not trace.shows_pause:
        assumed = fits.guesses[0]["law.pause_ticks"]
        seen = f": at least {assumed - 1} ticks" if assumed else ""
        findings["law.pause_ticks"] = miss(f"the log does not show the end of it{seen}", assumed)
    return findings


def _describe_setting(trace: Trace, fits: Fits, key: str) -> Finding:
    values, chosen = fits.list_values(key), fits.guesses[0][key]
    if key in fits.hidden:
        return miss("a deeper queue gives the same run", chosen)
    if key == "loop.period_ticks":
        return find_exactly(chosen, _PERIOD)
    if len(values) > 1:
        how = "reproduces every sample" if fits.is_exact else "leaves as little as the others"
        return Finding(
            value=chosen,
            certainty=Certainty.AMBIGUOUS,
            evidence=f"each {how}",
            candidates=values,
        )
    if fits.is_exact:
        also = "; so does a command queue of 1" if chosen == "newest" else ""
        return find_exactly(chosen, f"reproduces all {len(trace)} samples{also}")
    return Finding(
        value=chosen,
        certainty=Certainty.FITTED,
        evidence=f"likeliest of {fits.tried} settings; none is exact",
    )


def _describe_nearest(fits: Fits, key: str) -> Finding:
    chosen = fits.guesses[0][key]
    if key == "loop.period_ticks":
        return find_exactly(chosen, _PERIOD)
    return miss(
        f"none of {fits.tried} settings reproduces the samples; {chosen} is the nearest one's",
        chosen,
    )


def _describe_lost(fits: Fits) -> Finding:
    if not fits.is_exact:
        return miss("no setting reproduces every sample")
    counts = sorted({count_lost_commands(scenario) for scenario in fits.scenarios})
    if len(counts) > 1:
        return Finding(
            value=count_lost_commands(fits.scenario),
            certainty=Certainty.AMBIGUOUS,
            evidence="the settings that fit lose different numbers",
            candidates=tuple(counts),
        )
    return find_exactly(counts[0], "the re-simulation's plant never takes them")
