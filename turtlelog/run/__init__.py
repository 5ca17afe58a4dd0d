"""Run: the columns that every stage hands on."""

from turtlelog.run.columns import Clock, CommandColumns, PoseColumns, SampleColumns, take_rows
from turtlelog.run.run import CUT_SHORT, Event, GoalLine, Parameter, PhaseSpan, Run
from turtlelog.run.slicing import slice_run
from turtlelog.run.tables import TABLES, tabulate_run

__all__ = [
    "CUT_SHORT",
    "TABLES",
    "Clock",
    "CommandColumns",
    "Event",
    "GoalLine",
    "Parameter",
    "PhaseSpan",
    "PoseColumns",
    "Run",
    "SampleColumns",
    "slice_run",
    "tabulate_run",
    "take_rows",
]
