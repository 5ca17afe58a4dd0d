"""The entry functions of compiled code, in a file of their own: loops, batches and measurements.

Numba's cache depends on the time and size of the entry function's file. The functions that it calls
determine the stamp in its name (`compiled_twins`). The names in capitals are bound to compiled
functions and to constants.
"""

# ruff: noqa: F821
# mypy: ignore-errors


def run_loop(all_settings, states, rows):
    """Simulate a scenario into `rows`; write the stop reason and the counts to the state."""
    settings, state = all_settings[0], states[0]
    now = state.now
    for tick in range(settings.scene.last_tick + 1):
        MOVE_PLANT(settings, state, rows, PARTS, tick)
        before = now.samples
        if now.failure == 0:
            ANSWER(settings, state, rows, PARTS, tick)
        if now.failure != 0:
            break
        FINISH_TICK(settings, state, rows, PARTS, tick, before)
        if now.stop != 0:
            break
    return STAMP


def run_rows(simulate, measure, begun, rows, told, entries):
    """Simulate and measure rows in the same arrays; write numbers and reasons.

    `simulate` is a loop, and `measure` measures its run. Both are passed as pointers, because
    otherwise they would be compiled again. `begun` contains settings, states and lines of each row;
    `told` contains the other arguments of `measure`: facts, loops and memory.
    """
    all_settings, states, lines = begun
    facts, loops, memory = told
    asked, values, reasons = entries
    fact = facts[0]
    for number in range(len(all_settings)):
        after = number + 1
        simulate(all_settings[number:after], states[number:after], rows)
        settings, now = all_settings[number], states[number].now
        if now.failure != 0 or now.samples == 0:
            continue
        fact.period_ns = settings.scene.period_ns
        fact.ticks, fact.samples, fact.published = now.ticks, now.samples, now.published
        fact.is_cut, fact.is_late = now.stop < 0, now.stop == TIMEOUT
        fact.speed_limit = settings.limits.speed_m_s
        fact.turn_limit = settings.limits.turn_rate_rad_s
        entry = (asked, values[number], reasons[number])
        measure(facts, rows.ticks, rows.samples, lines[number:after], loops, memory, entry)
    return STAMP


def measure_row(facts, ticks, samples, line, loops, memory, entry):
    """Measure a row: write values, or the reasons for missing values.

    `entry` contains the requested columns, the values, and the numbers of reasons.
    """
    asked, values, reasons = entry
    ticks, samples = ticks[: facts[0].ticks], samples[: facts[0].samples]
    start_ns, end_ns = PREPARE_ROW(facts[0], ticks, samples, memory)
    row = ROW(facts[0], ticks, samples, line[0], loops, memory, start_ns, end_ns)
    for number in range(len(loops)):
        first, after = number * CURVES, (number + 1) * CURVES
        if not IS_ANY(asked, first, after):
            continue
        segment = FIND_SEGMENT(row, number)
        reason = FIND_MISSING(row, number, segment)
        if reason == 0:
            curve = READ_CURVE(row, number, segment)
            MEASURE_CURVE(curve, asked[first:after], values[first:after], reasons[first:after])
        else:
            reasons[first:after] = reason
    begin = len(loops) * CURVES
    MEASURE_COURSE(READ_COURSE(row), asked[begin:], values[begin:], reasons[begin:])
    pose = ticks[samples[0].pose_sequence]
    values[-2], values[-1] = pose.x_m, pose.y_m
    return STAMP
