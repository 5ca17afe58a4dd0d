"""Run -> metrics."""

from turtlelog.measure.breaks import (
    PoseGap,
    PoseJump,
    describe_breaks,
    find_gaps,
    find_jumps,
)
from turtlelog.measure.dead_time import DeadTime, DeadTimeChange, find_dead_time
from turtlelog.measure.measure_settings import MeasureSettings
from turtlelog.measure.metric import Metric, Metrics, Missing, Status
from turtlelog.measure.metrics import (
    ANY_LOOP,
    METRICS,
    choose_metrics,
    find_metric_kind,
    is_lawless,
    is_metric_pattern,
    list_essential_metrics,
    list_ids_like,
    list_metrics,
    measure_run,
    miss_metric,
    suggest_metrics,
)
from turtlelog.measure.outliers import (
    Outlier,
    describe_outliers,
    find_outliers,
    list_outliers,
)
from turtlelog.measure.path import read_reference_path
from turtlelog.measure.references import read_reference
from turtlelog.measure.registry import MetricKind
from turtlelog.measure.response import find_first_stretch
from turtlelog.measure.run_loops import model_run_loops
from turtlelog.measure.signals import (
    COMMANDED,
    SIGNALS,
    Signal,
    SignalKind,
    could_be_signal,
    explain_no_signal,
    list_signal_units,
    list_signals,
    read_signal,
)
from turtlelog.measure.step_response import find_overshoot, find_settling_time
from turtlelog.measure.table.end import PAPER_WINDOW_S

__all__ = [
    "ANY_LOOP",
    "COMMANDED",
    "METRICS",
    "PAPER_WINDOW_S",
    "SIGNALS",
    "DeadTime",
    "DeadTimeChange",
    "MeasureSettings",
    "Metric",
    "MetricKind",
    "Metrics",
    "Missing",
    "Outlier",
    "PoseGap",
    "PoseJump",
    "Signal",
    "SignalKind",
    "Status",
    "choose_metrics",
    "could_be_signal",
    "describe_breaks",
    "describe_outliers",
    "explain_no_signal",
    "find_dead_time",
    "find_first_stretch",
    "find_gaps",
    "find_jumps",
    "find_metric_kind",
    "find_outliers",
    "find_overshoot",
    "find_settling_time",
    "is_lawless",
    "is_metric_pattern",
    "list_essential_metrics",
    "list_ids_like",
    "list_metrics",
    "list_outliers",
    "list_signal_units",
    "list_signals",
    "measure_run",
    "miss_metric",
    "model_run_loops",
    "read_reference",
    "read_reference_path",
    "read_signal",
    "suggest_metrics",
]
