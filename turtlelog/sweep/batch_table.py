"""Which metrics the compiled batch computes, where it enters them, and its numbers of statuses."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from turtlelog.measure.metric import Status

LOOPS: Final = ("rotate", "translate", "reorient")
"""The loops of the sequential laws, in the order of their figures."""

LOOP_FIGURES: Final = (
    *("duration", "delay_time", "rise_time", "peak", "peak_time", "overshoot", "undershoot"),
    *("settling_time", "crossings", "final_error", "steady_state_error", "largest_error"),
    *("stable", "iae", "saturated_share"),
)
"""What it computes of each loop."""

DEGREES: Final = frozenset({"peak", "final_error", "steady_state_error", "largest_error"})
"""Those that are angles where the loop turns."""

END: Final = (
    *("duration", "heading_error", "x_m", "y_m", "goal_heading_error"),
    *("first_x_m", "first_y_m", "cross_track", "cross_track_max", "largest_gap", "path_length"),
)
"""What it enters of a run after its loops; the places are those of the last and first pose read."""

STATUSES: Final = tuple(Status)
"""Statuses by number."""

OK, NOT_REACHED, NO_STEP, NO_PHASE, TOO_SHORT, TOO_LARGE, ABSENT, UNDETERMINED = (
    STATUSES.index(status)
    for status in (
        *(Status.OK, Status.NOT_REACHED, Status.NO_STEP, Status.NO_PHASE),
        *(Status.TOO_SHORT, Status.TOO_LARGE, Status.ABSENT, Status.UNDETERMINED),
    )
)
CUT: Final = TOO_SHORT
"""Of a loop that the end of the run cuts."""

OF_LOOPS: Final[Mapping[str, int]] = MappingProxyType(
    {
        f"{loop}.{figure}": row * len(LOOP_FIGURES) + place
        for row, loop in enumerate(LOOPS)
        for place, figure in enumerate(LOOP_FIGURES)
    }
)
"""Metrics of loops by id: in which column they stand."""

POSITION_ERROR: Final = "final.position_error"
"""Computed from the last place: `x_m` and `y_m`."""

OF_RUN: Final[Mapping[str, str]] = MappingProxyType(
    {
        "run.duration": "duration",
        "run.path_length": "path_length",
        "run.cross_track_max": "cross_track_max",
        "run.largest_gap": "largest_gap",
        "final.heading_error": "heading_error",
        "final.cross_track": "cross_track",
        "final.goal_heading_error": "goal_heading_error",
        POSITION_ERROR: "x_m",
    }
)
"""Metrics of the run and of its end by id: what of `END` they are."""

COLUMNS: Final = len(OF_LOOPS) + len(END)


def find_column(metric: str) -> int:
    """Return the column of a metric that is covered."""
    if metric in OF_LOOPS:
        return OF_LOOPS[metric]
    return len(OF_LOOPS) + END.index(OF_RUN[metric])


def is_covered(metric: str) -> bool:
    """Whether the batch computes a metric."""
    return metric in OF_LOOPS or metric in OF_RUN
