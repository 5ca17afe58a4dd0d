"""The metrics that the batch computes, their columns and their compilation.

The batch computes the registered metrics that are functions of numbers; this module names none of
them.
"""

from collections.abc import Mapping
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import turtlelog.measure.metric_list  # noqa: F401  (enters every metric in the registry)
from turtlelog.arithmetic import called
from turtlelog.measure.metric import REASONS, Status
from turtlelog.measure.metric_kinds import CUT, LOOP_METRICS, NO_STEP, RUN_METRICS, SMALLEST_STEP
from turtlelog.run.loops import PAUSE, Declaration
from turtlelog.simulate.assemble import Function, compile_text
from turtlelog.simulate.compiled.compiled_loop import SAMPLE, TICK, compile_entry
from turtlelog.simulate.compiled.twins import Twins, stamp_functions
from turtlelog.sweep.batch import batch_kernel
from turtlelog.sweep.batch.batch_kernel import REFERENCES, SIGNALS, USES_OF_ROW, Memory, Row

CURVES: Final = {name: kind for name, kind in LOOP_METRICS.items() if kind.numbers is not None}
"""Metrics of a loop's curve by name, in column order."""

COURSES: Final = {name: kind for name, kind in RUN_METRICS.items() if kind.numbers is not None}
"""Metrics of the whole run by id, in column order, after those of all loops."""

STATUSES: Final = tuple(Status)
"""Statuses in the order of their numbers."""

STATUS_OF: Final = np.array([STATUSES.index(one.status) for one in REASONS], np.int8)
"""Status number of each reason."""

OK: Final = STATUSES.index(Status.OK)
TOO_LARGE: Final = STATUSES.index(Status.TOO_LARGE)

LINE: Final = np.dtype(
    [
        (name, np.float64)
        for name in (
            *("x_m", "y_m", "cos", "sin", "length_m", "bearing_rad"),
            *("goal_x_m", "goal_y_m", "goal_heading_rad", "band"),
        )
    ]
)
"""The line from start to goal, and further values of a scenario that only the measurement needs."""

FACTS: Final = np.dtype(
    [(name, np.int64) for name in ("period_ns", "ticks", "samples", "published")]
    + [("is_cut", np.bool_), ("is_late", np.bool_)]
    + [("speed_limit", np.float64), ("turn_limit", np.float64)],
    align=True,
)
"""Values of a run for its measurement, in addition to the rows.

The values are the clock [ns], the numbers of rows, whether `max_duration_s` or the law's timeout
ended the run, and the limits.
"""

LOOP: Final = np.dtype(
    [(name, np.int64) for name in ("phases", "pause", "signal", "reference")]
    + [("turns", np.bool_)],
    align=True,
)
"""Description of a loop for the measurement: the phases in which it acts, one bit each; the phase
of its pause; indices into `SIGNALS` and `REFERENCES`; whether its command is the turn rate."""

SPAN: Final = np.dtype([(name, np.int64) for name in ("first", "after", "end", "last")])
"""Sample indices of a loop: the first sample, the one after its phases, the end of its first
segment with pauses, and the last sample."""

FIRST_POSE: Final = slice(-2, None)
"""Last columns: x and y of the first pose that the controller read [m]."""


def is_covered(name: str) -> bool:
    """Return whether the batch computes a metric, for any loop."""
    return name in COURSES if name in RUN_METRICS else name.rpartition(".")[2] in CURVES


def count_columns(loops: int) -> int:
    """Return the number of columns for a number of loops."""
    return loops * len(CURVES) + len(COURSES) + 2


def find_column(name: str, declaration: Declaration) -> int | None:
    """Return the column of a covered metric; None if the law has no such metric."""
    if name in COURSES:
        return len(declaration.loops) * len(CURVES) + [*COURSES].index(name)
    loop, _, plain = name.rpartition(".")
    for number, one in enumerate(declaration.loops):
        if one.name == loop and CURVES[plain].applies(one):
            return number * len(CURVES) + [*CURVES].index(plain)
    return None


def is_angle(name: str, declaration: Declaration) -> bool:
    """Return whether a metric is computed in rad but reported in deg."""
    loop, _, plain = name.rpartition(".")
    unit = "" if name in COURSES else CURVES[plain].describe_unit(declaration.find_loop(loop))
    return unit == "deg"


def build_loops(declaration: Declaration) -> NDArray[Any] | None:
    """Return the loops of a law as `LOOP` records; None if a reference is not supported."""
    phases = declaration.phase_names
    rows = []
    for loop in declaration.loops:
        if loop.reference not in REFERENCES or loop.limit is not None or len(phases) > 60:
            return None
        own = sum(1 << phases.index(phase) for phase in declaration.list_phases(loop.name))
        kinds = SIGNALS.index(loop.signal), REFERENCES.index(loop.reference)
        rows.append((own, phases.index(PAUSE), *kinds, loop.command == "turn_rate"))
    return np.array(rows, LOOP)


def allocate_memory(ticks: int, samples: int, loops: int) -> Memory:
    """Return arrays for rows with at most the given numbers of poses, samples and loops."""
    numbers = np.empty((USES_OF_ROW, max(2 * ticks, samples)))
    return Memory(numbers, np.empty(ticks, np.int64), np.empty(loops, SPAN))


def name_measurement() -> str:
    """Return the name of the measurement in numba's cache."""
    return f"measure_{_bind(tuple(CURVES), tuple(COURSES))[1]}"


def compile_measurement(
    entry: Function, curves: tuple[str, ...] = (), courses: tuple[str, ...] = ()
) -> Any:
    """Return the compiled function that measures a row, with all or only some metrics.

    Args:
        entry: The outermost function.
        curves: Metrics of curves. If neither list contains a metric, every metric is computed.
        courses: Metrics of the whole run.
    """
    if not curves and not courses:
        curves, courses = tuple(CURVES), tuple(COURSES)
    functions, stamp = _bind(curves, courses)

    def bind(compiler: Any) -> dict[str, Any]:
        twins = Twins(compiler, inline=False, wide=frozenset({"curve", "course", "row"}))
        scope = {name: twins.compile(function) for name, function in functions.items()}
        return {**scope, "ROW": Row, "CURVES": len(curves), "STAMP": int(stamp[:12], 16)}

    return compile_entry(entry, f"measure_{stamp}", bind, type_measurement())


def type_measurement() -> Any:
    """Return numba's type of the function that measures a row."""
    from numba import typeof, types

    entry = np.empty(1, np.bool_), np.empty(1), np.empty(1, np.int16)
    arrays = [np.empty(1, kind) for kind in (FACTS, TICK, SAMPLE, LINE, LOOP)]
    return types.int64(*map(typeof, (*arrays, allocate_memory(1, 1, 1), entry)))


@cache
def _bind(curves: tuple[str, ...], courses: tuple[str, ...]) -> tuple[dict[str, Function], str]:
    """Return the functions that the outermost function calls, and a stamp of all their sources."""
    from importlib.metadata import version

    of_curve = _chain("curve", {name: CURVES[name] for name in curves})
    of_course = _chain("course", {name: COURSES[name] for name in courses})
    functions: dict[str, Function] = {
        "IS_ANY": batch_kernel.is_any,
        "PREPARE_ROW": batch_kernel.prepare_row,
        "FIND_STRETCH": batch_kernel.find_stretch,
        "READ_CURVE": batch_kernel.read_loop_curve,
        "READ_COURSE": batch_kernel.read_course,
        "MEASURE_CURVE": of_curve,
        "MEASURE_COURSE": of_course,
    }
    types = FACTS, TICK, SAMPLE, LINE, LOOP, SPAN
    return functions, stamp_functions(functions.values(), *types, version("numba"), np.__version__)


def _chain(what: str, kinds: Mapping[str, Any]) -> Function:
    """Return a function that writes each requested metric."""
    lines = [f"def measure_{what}({what}, asked, values, reasons):"]
    names: dict[str, Any] = {}
    if what == "curve":
        lines.append(f"    is_step = not abs(curve.reference - curve.initial) <= {SMALLEST_STEP!r}")
    for place, kind in enumerate(kinds.values()):
        names[f"find_{place}"] = kind.numbers
        tests = {f"not asked[{place}]": "pass"}
        if what == "curve" and kind.needs_whole:
            tests["curve.was_cut"] = f"reasons[{place}] = {CUT}"
        if what == "curve" and kind.needs_step:
            tests["not is_step"] = f"reasons[{place}] = {NO_STEP}"
        words = "if"
        for test, then in tests.items():
            lines += [f"    {words} {test}:", f"        {then}"]
            words = "elif"
        call = f"values[{place}], at_s, reasons[{place}] = find_{place}({what})"
        lines += ["    else:", f"        {call}"]
    return called(compile_text(f"measure_{what}", [*lines, "    return"], names))
