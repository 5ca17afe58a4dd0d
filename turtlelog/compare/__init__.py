"""Runs -> differences, verdicts, and tables across gains."""

from turtlelog.compare.across import (
    tabulate_differences,
    tabulate_table1,
    tabulate_whole_runs,
)
from turtlelog.compare.difference import (
    Comparison,
    MetricDifference,
    SignalDifference,
    compare_runs,
    iter_comparisons,
)
from turtlelog.compare.files import summarise_files
from turtlelog.compare.gains import mark_metric, tabulate_runs
from turtlelog.compare.ids import ALIGNMENTS, list_units, order_ids
from turtlelog.compare.metric_table import tabulate_measured, tabulate_metrics
from turtlelog.compare.names import name_runs
from turtlelog.compare.order import order_by_gain
from turtlelog.compare.summary import (
    RunSummary,
    choose_columns,
    list_needed_metrics,
    list_usual_metrics,
    select_runs,
    sort_runs,
    summarise_run,
)
from turtlelog.compare.table import Cell, Column, Mark, Table, format_cell
from turtlelog.compare.tolerance_file import load_tolerances, parse_tolerances, read_tables
from turtlelog.compare.tolerances import Tolerance, Tolerances
from turtlelog.compare.verdict import Finding
from turtlelog.compare.verdict_table import tabulate_all_findings, tabulate_findings

__all__ = [
    "ALIGNMENTS",
    "Cell",
    "Column",
    "Comparison",
    "Finding",
    "Mark",
    "MetricDifference",
    "RunSummary",
    "SignalDifference",
    "Table",
    "Tolerance",
    "Tolerances",
    "choose_columns",
    "compare_runs",
    "format_cell",
    "iter_comparisons",
    "list_needed_metrics",
    "list_units",
    "list_usual_metrics",
    "load_tolerances",
    "mark_metric",
    "name_runs",
    "order_by_gain",
    "order_ids",
    "parse_tolerances",
    "read_tables",
    "select_runs",
    "sort_runs",
    "summarise_files",
    "summarise_run",
    "tabulate_all_findings",
    "tabulate_differences",
    "tabulate_findings",
    "tabulate_measured",
    "tabulate_metrics",
    "tabulate_runs",
    "tabulate_table1",
    "tabulate_whole_runs",
]
