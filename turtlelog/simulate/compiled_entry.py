"""The entry functions of compiled loops, in a file of their own.

Numba's cache depends on the time and size of the entry function's file. The functions that it calls
determine the stamp in its name (`compiled_loop`). The names in capitals are bound to a loop's
twins.
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
