"""The timelines of compared runs: names, where zero lies in each run, and where the run is then."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.run import Run
from turtlelog.run.loops import DONE, PAUSE

Values = NDArray[np.float64]

TIMELINE: Final = "sim_time"
WALL_TIMELINE: Final = "wall_time"

_PHASE_TIMELINE: Final = "{}_time"
_MOST_PHASES: Final = 8
"""Timelines of phases in a run: in a view each costs 8 bytes per row and entity."""


def name_phase_timeline(phase: str) -> str:
    """Return the timeline whose zero is the start of a phase; no other has its name."""
    name = _PHASE_TIMELINE.format(phase)
    return _PHASE_TIMELINE.format(f"phase.{phase}") if name in {TIMELINE, WALL_TIMELINE} else name


def find_phase_zeros(run: Run) -> dict[str, int]:
    """Return the timelines of the phases after the first that is declared, with their zeros.

    Zeros are in the run's own time [ns].
    """
    phases = [name for name in run.declaration.phases if name not in (PAUSE, DONE)]
    starts_ns: dict[str, int] = {}
    for span in run.find_phase_spans():
        starts_ns.setdefault(span.phase, span.start_ns)
    later = phases[1 : 1 + _MOST_PHASES]
    return {name_phase_timeline(name): starts_ns[name] for name in later if name in starts_ns}


def locate_run(run: Run, zero_ns: int, time_s: Values) -> tuple[Values, Values]:
    """Return where a run is at times of a timeline: x and y [m], shape (n, 2), and heading [rad].

    Between two poses it moves straight; before the first and after the last it stands.

    Args:
        run: With at least one pose.
        zero_ns: Where the timeline is zero, in the run's own time [ns].
        time_s: Times [s], shape (n,).
    """
    own_s = (run.poses.time_ns - zero_ns) / 1e9
    heading_rad = np.unwrap(run.poses.heading_rad)
    xy_m = np.column_stack([np.interp(time_s, own_s, values) for values in run.poses.xy_m.T])
    return xy_m, np.interp(time_s, own_s, heading_rad)
