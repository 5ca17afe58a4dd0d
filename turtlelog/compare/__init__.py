"""Runs -> differences and tables across gains."""

from turtlelog.compare.across import (
    tabulate_differences,
    tabulate_metrics,
    tabulate_table1,
    tabulate_whole_runs,
)
from turtlelog.compare.clock import ALIGNMENTS
from turtlelog.compare.difference import (
    Comparison,
    MetricDifference,
    SignalDifference,
    compare_runs,
    iter_comparisons,
)
from turtlelog.compare.names import name_runs
from turtlelog.compare.table import Cell, Column, Table, format_cell
from turtlelog.compare.tolerance_file import load_tolerances, parse_tolerances, read_tables
from turtlelog.compare.tolerances import Tolerance, Tolerances
from turtlelog.compare.verdict import Finding

__all__ = [
    "ALIGNMENTS",
    "Cell",
    "Column",
    "Comparison",
    "Finding",
    "MetricDifference",
    "SignalDifference",
    "Table",
    "Tolerance",
    "Tolerances",
    "compare_runs",
    "format_cell",
    "iter_comparisons",
    "load_tolerances",
    "name_runs",
    "parse_tolerances",
    "read_tables",
    "tabulate_differences",
    "tabulate_metrics",
    "tabulate_table1",
    "tabulate_whole_runs",
]
