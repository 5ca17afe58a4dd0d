"""The outermost function of the batch's measurement, compiled when this module is imported.

Numba's cache checks the time and size of this file. The stamp in the name covers the called
functions. The names in capitals are bound to compiled functions.
"""

# ruff: noqa: F821, PLR0913, PLR0917
# mypy: ignore-errors

from turtlelog.sweep.batch.batch_columns import compile_measurement


def measure_row(facts, ticks, samples, line, loops, memory, entry):
    """Measure a row: write values, or the reasons for missing values.

    `entry` contains the requested columns, the values, and the numbers of reasons.
    """
    asked, values, reasons = entry
    ticks, samples = ticks[: facts[0].ticks], samples[: facts[0].samples]
    start_ns, end_ns = PREPARE_ROW(facts[0], ticks, samples, loops, memory)
    row = ROW(facts[0], ticks, samples, line[0], loops, memory, start_ns, end_ns)
    for number in range(len(loops)):
        first, after = number * CURVES, (number + 1) * CURVES
        if not IS_ANY(asked, first, after):
            continue
        begin, end, reason = FIND_STRETCH(row, number)
        if reason == 0:
            curve = READ_CURVE(row, number, begin, end, line[0].band)
            MEASURE_CURVE(curve, asked[first:after], values[first:after], reasons[first:after])
        else:
            reasons[first:after] = reason
    begin = len(loops) * CURVES
    MEASURE_COURSE(READ_COURSE(row), asked[begin:], values[begin:], reasons[begin:])
    pose = ticks[samples[0].pose_sequence]
    values[-2], values[-1] = pose.x_m, pose.y_m
    return STAMP


MEASURE = compile_measurement(measure_row)
"""The compiled function that measures a row."""
