"""Run -> metrics."""

from turtlelog.measure.dead_time import DeadTime, DeadTimeChange, find_dead_time
from turtlelog.measure.metric import Metric, Missing, Status
from turtlelog.measure.metrics import (
    ESSENTIAL_METRICS,
    METRICS,
    choose_metrics,
    measure_run,
    suggest_metrics,
)
from turtlelog.measure.path_file import read_reference_path
from turtlelog.measure.settings import MeasureSettings
from turtlelog.measure.signals import SIGNALS, Signal, SignalKind, read_signal
from turtlelog.measure.step import find_overshoot, find_settling_time
from turtlelog.measure.table.end import PAPER_WINDOW_S
from turtlelog.measure.table.kinds import MetricKind

__all__ = [
    "ESSENTIAL_METRICS",
    "METRICS",
    "PAPER_WINDOW_S",
    "SIGNALS",
    "DeadTime",
    "DeadTimeChange",
    "MeasureSettings",
    "Metric",
    "MetricKind",
    "Missing",
    "Signal",
    "SignalKind",
    "Status",
    "choose_metrics",
    "find_dead_time",
    "find_overshoot",
    "find_settling_time",
    "measure_run",
    "read_reference_path",
    "read_signal",
    "suggest_metrics",
]
