"""Runs -> differences and tables across gains."""

from turtlelog.compare.across import (
    tabulate_differences,
    tabulate_metrics,
    tabulate_table1,
    tabulate_whole_runs,
)
from turtlelog.compare.difference import (
    Comparison,
    MetricDifference,
    SignalDifference,
    compare_runs,
)
from turtlelog.compare.names import name_runs
from turtlelog.compare.table import Cell, Column, Table, format_cell

__all__ = [
    "Cell",
    "Column",
    "Comparison",
    "MetricDifference",
    "SignalDifference",
    "Table",
    "compare_runs",
    "format_cell",
    "name_runs",
    "tabulate_differences",
    "tabulate_metrics",
    "tabulate_table1",
    "tabulate_whole_runs",
]
