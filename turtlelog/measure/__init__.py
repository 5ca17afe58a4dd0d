"""Run -> metrics."""

from turtlelog.measure.metric import Metric, Status
from turtlelog.measure.metrics import METRICS, PAPER_WINDOW_S, MetricKind, measure_run
from turtlelog.measure.signals import SIGNALS, Signal, SignalKind, read_signal
from turtlelog.measure.step import find_overshoot, find_settling_time

__all__ = [
    "METRICS",
    "PAPER_WINDOW_S",
    "SIGNALS",
    "Metric",
    "MetricKind",
    "Signal",
    "SignalKind",
    "Status",
    "find_overshoot",
    "find_settling_time",
    "measure_run",
    "read_signal",
]
