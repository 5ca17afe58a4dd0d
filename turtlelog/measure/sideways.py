"""Commands to the side of a robot and its motion there, which metrics of the speed leave out."""

from typing import Final

import numpy as np

from turtlelog.display import format_short
from turtlelog.measure.breaks import measure_steps
from turtlelog.measure.rates import space_poses
from turtlelog.measure.reductions import compute_median, subtract_neighbours
from turtlelog.run import Run, take_rows

_CHORD_S: Final = 0.5
"""Time over which motion is split into ahead and aside [s]: in it, noise of poses hardly adds."""

_COMMANDED_M_S: Final = 0.01
"""Command to the side from which a robot counts as commanded sideways [m/s], as of rest."""


def describe_sideways(run: Run) -> str:
    """Return a clause on a robot that is commanded sideways; empty for other robots.

    Whether a robot moves sideways without such commands is not told: headings may be wrong.
    """
    most_m_s = float(np.abs(run.commands.lateral_speed_m_s).max(initial=0.0))
    if most_m_s < _COMMANDED_M_S:
        return ""
    commanded = f"commanded sideways, up to {format_short(most_m_s, 'm/s')}"
    if len(run.poses) < 2:
        return commanded
    spaced = space_poses(run)
    every = max(round(_CHORD_S / compute_median(subtract_neighbours(spaced.time_s))), 1)
    rows = np.append(spaced.rows[:-1:every], spaced.rows[-1])
    ahead_m, aside_m, _ = measure_steps(take_rows(run.poses, rows))
    aside, ahead = (format_short(float(np.abs(way).sum()), "m") for way in (aside_m, ahead_m))
    return f"{commanded}; it moves {aside} sideways, {ahead} ahead or back"
