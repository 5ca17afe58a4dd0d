from .common_clock import ALIGNMENTS as ALIGNMENTS, Tolerance as Tolerance
from .difference import (
    MetricDifference as MetricDifference,
    PathDeviation as PathDeviation,
    RunComparison as RunComparison,
    SignalDifference as SignalDifference,
    compare_metrics as compare_metrics,
    compare_runs as compare_runs,
    compare_signals as compare_signals,
    measure_path_error as measure_path_error,
    tabulate_differences as tabulate_differences,
)
from .ranking import (
    CONDITIONS as CONDITIONS,
    ConditionDifference as ConditionDifference,
    Conditions as Conditions,
    Ranking as Ranking,
    judge_runs as judge_runs,
    list_metric_units as list_metric_units,
    mark_metric as mark_metric,
)
from .robot_comparison import (
    ErrorBand as ErrorBand,
    ErrorGrowth as ErrorGrowth,
    NoiseLevel as NoiseLevel,
    RobotComparison as RobotComparison,
    tabulate_robots as tabulate_robots,
)
from .robot_prediction import compare_robot as compare_robot
from .run_selection import (
    choose_columns as choose_columns,
    describe_runs as describe_runs,
    label_file as label_file,
    list_needed_metrics as list_needed_metrics,
    list_usual_of_run as list_usual_of_run,
    name_runs as name_runs,
    order_by_gain as order_by_gain,
    select_runs as select_runs,
    shorten_names as shorten_names,
    sort_runs as sort_runs,
)
from .run_summary import (
    UNLOCKS as UNLOCKS,
    RunSummary as RunSummary,
    can_unlock as can_unlock,
    complete_summaries as complete_summaries,
    describe_end as describe_end,
    describe_reached as describe_reached,
    list_lacks as list_lacks,
    list_unlocks as list_unlocks,
    summarise_files as summarise_files,
    summarise_run as summarise_run,
)
from .run_table import (
    order_parameters as order_parameters,
    tabulate_measured as tabulate_measured,
    tabulate_metrics as tabulate_metrics,
    tabulate_runs as tabulate_runs,
    tabulate_table1 as tabulate_table1,
    tabulate_whole_runs as tabulate_whole_runs,
)
from .table import (
    Cell as Cell,
    Column as Column,
    Mark as Mark,
    Table as Table,
    drop_absent as drop_absent,
    format_cell as format_cell,
    list_reasons as list_reasons,
    narrow_table as narrow_table,
    order_ids as order_ids,
)
from .trajectory_comparison import (
    Delta as Delta,
    TrajectoryComparison as TrajectoryComparison,
    TrajectorySettings as TrajectorySettings,
    compare_trajectories as compare_trajectories,
    parse_delta as parse_delta,
    tabulate_trajectories as tabulate_trajectories,
)
from .trajectory_errors import ErrorStatistics as ErrorStatistics
