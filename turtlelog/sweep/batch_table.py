"""Which metrics the compiled batch computes, where it enters them, and its numbers of statuses."""

from collections.abc import Mapping
from enum import IntEnum
from types import MappingProxyType
from typing import Final

from turtlelog.measure.metric import Status

LOOPS: Final = ("rotate", "translate", "reorient")
"""The loops of the sequential laws, in the order of their columns."""


class LoopMetric(IntEnum):
    """What the batch measures of each loop, by the place among the columns of the loop."""

    DURATION = 0
    DELAY_TIME = 1
    RISE_TIME = 2
    PEAK = 3
    PEAK_TIME = 4
    OVERSHOOT = 5
    UNDERSHOOT = 6
    SETTLING_TIME = 7
    CROSSINGS = 8
    FINAL_ERROR = 9
    STEADY_STATE_ERROR = 10
    LARGEST_ERROR = 11
    STABLE = 12
    IAE = 13
    SATURATED_SHARE = 14

    @property
    def ending(self) -> str:
        """How the ids of the metric end."""
        return self.name.lower()


class RunColumn(IntEnum):
    """What the batch enters of a run, by the place among the columns behind those of its loops.

    `X_M` and `Y_M` are the last pose, `FIRST_X_M` and `FIRST_Y_M` the first that was read.
    """

    DURATION = 0
    HEADING_ERROR = 1
    X_M = 2
    Y_M = 3
    GOAL_HEADING_ERROR = 4
    FIRST_X_M = 5
    FIRST_Y_M = 6
    CROSS_TRACK = 7
    CROSS_TRACK_MAX = 8
    LARGEST_GAP = 9
    PATH_LENGTH = 10


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
        f"{loop}.{metric.ending}": number * len(LoopMetric) + metric
        for number, loop in enumerate(LOOPS)
        for metric in LoopMetric
    }
)
"""Metrics of loops by id: in which column they stand."""

POSITION_ERROR: Final = "final.position_error"
"""Computed from the last pose, `X_M` and `Y_M`."""

RUN_AT: Final = len(OF_LOOPS)
"""The first column of a run."""

OF_RUN: Final[Mapping[str, int]] = MappingProxyType(
    {
        name: RUN_AT + column
        for name, column in {
            "run.duration": RunColumn.DURATION,
            "run.path_length": RunColumn.PATH_LENGTH,
            "run.cross_track_max": RunColumn.CROSS_TRACK_MAX,
            "run.largest_gap": RunColumn.LARGEST_GAP,
            "final.heading_error": RunColumn.HEADING_ERROR,
            "final.cross_track": RunColumn.CROSS_TRACK,
            "final.goal_heading_error": RunColumn.GOAL_HEADING_ERROR,
            POSITION_ERROR: RunColumn.X_M,
        }.items()
    }
)
"""Metrics of the run and of its end by id, likewise."""

COLUMN_OF: Final[Mapping[str, int]] = MappingProxyType({**OF_LOOPS, **OF_RUN})
"""Every metric that the batch computes."""

COLUMNS: Final = len(OF_LOOPS) + len(RunColumn)
"""How many columns a row has."""
