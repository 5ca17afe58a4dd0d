"""Runs -> differences on a common clock, and tables across runs."""

from turtlelog.compare.alignment import ALIGNMENTS
from turtlelog.compare.difference import (
    MetricDifference,
    PathError,
    RunComparison,
    compare_metrics,
    compare_runs,
    compare_signals,
    iter_comparisons,
    measure_path_error,
    tabulate_differences,
)
from turtlelog.compare.like_loops import order_ids
from turtlelog.compare.paper_tables import tabulate_table1, tabulate_whole_runs
from turtlelog.compare.robot_comparison import (
    ErrorBand,
    ErrorGrowth,
    RobotComparison,
    tabulate_robots,
)
from turtlelog.compare.robot_prediction import HORIZONS_S, compare_robot
from turtlelog.compare.run_names import name_runs, order_by_gain
from turtlelog.compare.run_summary import (
    RunSummary,
    choose_columns,
    complete_summaries,
    list_lacks,
    list_needed_metrics,
    list_usual_metrics,
    list_usual_of_run,
    select_runs,
    sort_runs,
    summarise_files,
    summarise_run,
)
from turtlelog.compare.run_table import (
    UNLOCKS,
    Cell,
    Column,
    Mark,
    Table,
    drop_absent,
    format_cell,
    list_units,
    list_unlocks,
    mark_metric,
    tabulate_measured,
    tabulate_metrics,
    tabulate_runs,
)
from turtlelog.compare.tube import Tolerance
from turtlelog.differences import SignalDifference

__all__ = [
    "ALIGNMENTS",
    "HORIZONS_S",
    "UNLOCKS",
    "Cell",
    "Column",
    "ErrorBand",
    "ErrorGrowth",
    "Mark",
    "MetricDifference",
    "PathError",
    "RobotComparison",
    "RunComparison",
    "RunSummary",
    "SignalDifference",
    "Table",
    "Tolerance",
    "choose_columns",
    "compare_metrics",
    "compare_robot",
    "compare_runs",
    "compare_signals",
    "complete_summaries",
    "drop_absent",
    "format_cell",
    "iter_comparisons",
    "list_lacks",
    "list_needed_metrics",
    "list_units",
    "list_unlocks",
    "list_usual_metrics",
    "list_usual_of_run",
    "mark_metric",
    "measure_path_error",
    "name_runs",
    "order_by_gain",
    "order_ids",
    "select_runs",
    "sort_runs",
    "summarise_files",
    "summarise_run",
    "tabulate_differences",
    "tabulate_measured",
    "tabulate_metrics",
    "tabulate_robots",
    "tabulate_runs",
    "tabulate_table1",
    "tabulate_whole_runs",
]
