"""The measurement of laws that track a path, compiled when this module is imported."""

from turtlelog.sweep.batch.batch_columns import PATHS, compile_measurement
from turtlelog.sweep.batch.batch_entry import measure_row

MEASURE = compile_measurement(measure_row, PATHS)
"""The compiled function that measures a row."""
