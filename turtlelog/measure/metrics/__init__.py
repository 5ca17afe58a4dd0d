"""The metrics of the registry. Importing this package registers them in display order."""

from turtlelog.measure.metrics import loop_metrics  # isort: skip
from turtlelog.measure.metrics import tracking  # isort: skip
from turtlelog.measure.metrics import commands  # isort: skip
from turtlelog.measure.metrics import theories  # isort: skip
from turtlelog.measure.metrics import end  # isort: skip
from turtlelog.measure.metrics import whole  # isort: skip
from turtlelog.measure.metrics import travel  # isort: skip
from turtlelog.measure.metrics import following  # isort: skip
from turtlelog.measure.metrics import command_steps  # isort: skip
from turtlelog.measure.metrics import clock  # isort: skip

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
