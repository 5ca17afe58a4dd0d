"""Run -> metrics."""

from turtlelog.measure.dead_time import DeadTime, DeadTimeChange, find_dead_time
from turtlelog.measure.metric import Metric, Missing, Status
from turtlelog.measure.metrics import METRICS, PAPER_WINDOW_S, MetricKind, measure_run
from turtlelog.measure.signals import SIGNALS, Signal, SignalKind, read_signal
from turtlelog.measure.step import find_overshoot, find_settling_time

__all__ = [
    "METRICS",
    "PAPER_WINDOW_S",
    "SIGNALS",
    "DeadTime",
    "DeadTimeChange",
    "Metric",
    "MetricKind",
    "Missing",
    "Signal",
    "SignalKind",
    "Status",
    "find_dead_time",
    "find_overshoot",
    "find_settling_time",
    "measure_run",
    "read_signal",
]
