"""What the timelines of compared runs are called, and where the zero of each lies in a run."""

from typing import Final

from turtlelog.loops import DONE, PAUSE
from turtlelog.run import Run

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
