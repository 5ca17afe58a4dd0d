"""The metrics of the registry: importing this package enters them, in display order."""

from turtlelog.measure.table import loop_metrics  # isort: skip
from turtlelog.measure.table import tracking  # isort: skip
from turtlelog.measure.table import commands  # isort: skip
from turtlelog.measure.table import theories  # isort: skip
from turtlelog.measure.table import end  # isort: skip
from turtlelog.measure.table import whole  # isort: skip
from turtlelog.measure.table import travel  # isort: skip
from turtlelog.measure.table import following  # isort: skip
from turtlelog.measure.table import command_steps  # isort: skip
from turtlelog.measure.table import clock  # isort: skip

__all__ = [
    "clock",
    "command_steps",
    "commands",
    "end",
    "following",
    "loop_metrics",
    "theories",
    "tracking",
    "travel",
    "whole",
]
