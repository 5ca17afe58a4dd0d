"""The measurement of laws with a goal, compiled when this module is imported."""

from turtlelog.sweep.batch.batch_columns import GOALS, compile_measurement
from turtlelog.sweep.batch.batch_entry import measure_row

MEASURE = compile_measurement(measure_row, GOALS)
"""The compiled function that measures a row."""
