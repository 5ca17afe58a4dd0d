from .breaks import (
    PoseGap as PoseGap,
    PoseJump as PoseJump,
    find_gaps as find_gaps,
    find_jumps as find_jumps,
)
from .dead_time import (
    DeadTime as DeadTime,
    DeadTimeChange as DeadTimeChange,
    find_dead_time as find_dead_time,
    model_run_loops as model_run_loops,
)
from .metric import (
    MIRRORED as MIRRORED,
    OPERATORS as OPERATORS,
    Metric as Metric,
    Metrics as Metrics,
    MetricWatch as MetricWatch,
    Missing as Missing,
    Numeric as Numeric,
    Status as Status,
)
from .metric_kinds import MetricKind as MetricKind
from .metrics import (
    ANY_LOOP as ANY_LOOP,
    METRICS as METRICS,
    choose_metrics as choose_metrics,
    describe_no_metric as describe_no_metric,
    find_metric_kind as find_metric_kind,
    is_metric_pattern as is_metric_pattern,
    list_essential_metrics as list_essential_metrics,
    list_ids_like as list_ids_like,
    list_metrics as list_metrics,
    measure_run as measure_run,
    miss_metric as miss_metric,
)
from .pose_noise import (
    Outlier as Outlier,
    describe_outliers as describe_outliers,
    list_outliers as list_outliers,
)
from .pose_quality import (
    TravelDirection as TravelDirection,
    describe_breaks as describe_breaks,
    describe_sideways as describe_sideways,
    describe_source as describe_source,
    describe_travel as describe_travel,
    find_travel_direction as find_travel_direction,
)
from .rates import find_outliers as find_outliers
from .references import read_reference as read_reference, read_reference_path as read_reference_path
from .response import find_first_stretch as find_first_stretch
from .run_context import MeasureSettings as MeasureSettings
from .signals import (
    COMMANDED as COMMANDED,
    SIGNALS as SIGNALS,
    Signal as Signal,
    SignalKind as SignalKind,
    could_be_signal as could_be_signal,
    explain_no_signal as explain_no_signal,
    find_signal as find_signal,
    list_signal_units as list_signal_units,
    list_signals as list_signals,
    read_signal as read_signal,
)
from .step_response import (
    find_overshoot as find_overshoot,
    find_settling_time as find_settling_time,
)
