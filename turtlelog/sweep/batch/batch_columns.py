"""The metrics that the batch computes, their columns and their compilation.

The batch computes the registered metrics that are functions of numbers; this module names none of
them.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import turtlelog.measure.metric_list  # noqa: F401  (enters every metric in the registry)
from turtlelog.arithmetic import called
from turtlelog.measure.metric import REASONS, Status
from turtlelog.measure.metric_kinds import CUT, LOOP_METRICS, NO_STEP, RUN_METRICS, SMALLEST_STEP
from turtlelog.measure.response import list_corners
from turtlelog.run.loops import PAUSE, REFERENCES as REFERENCES_OF, ControlLoop, Declaration
from turtlelog.run.paths import Path
from turtlelog.simulate.compiled.compiled_loop import (
    PIECE,
    SAMPLE,
    TICK,
    build_pieces,
    compile_entry,
)
from turtlelog.simulate.compiled.twins import Twins, as_record, stamp_functions
from turtlelog.simulate.loop_parts import Function, compile_text
from turtlelog.sweep.batch import batch_kernel, path_kernel
from turtlelog.sweep.batch.batch_entry import measure_row
from turtlelog.sweep.batch.batch_kernel import PATH, REFERENCES, SIGNALS, USES_OF_ROW, Memory, Row
from turtlelog.sweep.batch.path_kernel import PathMemory

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


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Laws that one compiled measurement covers.

    Attributes:
        name: Name of the measurement in numba's cache.
        compiler: Function that compiles it, as `module:function`.
        curves: Names of the metrics in `CURVES` that a loop of these laws may have.
        functions: Functions that the outermost function calls for the inputs of metrics.
        uses: Number of rows of `Memory.numbers`.
    """

    name: str
    compiler: str
    curves: tuple[str, ...]
    functions: Mapping[str, Function]
    uses: int


def _choose_curves(references: Collection[str]) -> tuple[str, ...]:
    """Return the metrics that apply to any loop with one of these references."""
    loops = [
        ControlLoop(name="any", signal=signal, command="speed", reference=reference)
        for signal in SIGNALS
        for reference in REFERENCES_OF[signal]
        if reference in references
    ]
    return tuple(name for name, kind in CURVES.items() if any(map(kind.applies, loops)))


GOALS: Final = Coverage(
    "goal",
    f"{__name__}:compile_goals",
    _choose_curves(REFERENCES[:-1]),
    {
        "PREPARE_ROW": batch_kernel.prepare_row,
        "FIND_STRETCH": batch_kernel.find_stretch,
        "READ_CURVE": batch_kernel.read_loop_curve,
        "READ_COURSE": batch_kernel.read_course,
    },
    USES_OF_ROW,
)
"""Laws with a goal and a loop of the heading."""

PATHS: Final = Coverage(
    "path",
    f"{__name__}:compile_paths",
    _choose_curves([PATH]),
    {
        "PREPARE_ROW": path_kernel.prepare_path_row,
        "FIND_STRETCH": path_kernel.find_path_stretch,
        "READ_CURVE": path_kernel.read_path_curve,
        "READ_COURSE": path_kernel.read_path_course,
    },
    path_kernel.USES_OF_PATH,
)
"""Laws without a goal, whose loops all refer to the path."""


def find_coverage(declaration: Declaration, *, has_path: bool) -> Coverage | None:
    """Return the measurement that covers a law; None if there is none."""
    loops, is_path = declaration.loops, has_path and not declaration.uses_goal
    references = {loop.reference for loop in loops}
    is_known = references <= {*REFERENCES} and all(loop.limit is None for loop in loops)
    if not is_known or len(declaration.phase_names) > _MOST_PHASES:
        return None
    if is_path and references == {PATH}:
        return PATHS
    has_heading = any(loop.signal == "heading" for loop in loops)
    is_goal = declaration.uses_goal and not has_path and PATH not in references
    return GOALS if is_goal and has_heading else None


def is_covered(name: str) -> bool:
    """Return whether the batch computes a metric, for any loop."""
    return name in COURSES if name in RUN_METRICS else name.rpartition(".")[2] in CURVES


def find_column(name: str, declaration: Declaration, coverage: Coverage) -> int | None:
    """Return the column of a covered metric; None if the law has no such metric."""
    curves = coverage.curves
    if name in COURSES:
        return len(declaration.loops) * len(curves) + [*COURSES].index(name)
    loop, _, plain = name.rpartition(".")
    for number, one in enumerate(declaration.loops):
        if one.name == loop and CURVES[plain].applies(one):
            return number * len(curves) + curves.index(plain)
    return None


def is_angle(name: str, declaration: Declaration) -> bool:
    """Return whether a metric is computed in rad but reported in deg."""
    loop, _, plain = name.rpartition(".")
    unit = "" if name in COURSES else CURVES[plain].describe_unit(declaration.find_loop(loop))
    return unit == "deg"


_MOST_PHASES: Final = 60
"""Largest number of phases of a law: each has a bit of 64."""


def build_loops(declaration: Declaration) -> NDArray[Any]:
    """Return the loops of a covered law as `LOOP`."""
    phases = declaration.phase_names
    rows = []
    for loop in declaration.loops:
        own = sum(1 << phases.index(phase) for phase in declaration.list_phases(loop.name))
        kinds = SIGNALS.index(loop.signal), REFERENCES.index(loop.reference)
        rows.append((own, phases.index(PAUSE), *kinds, loop.command == "turn_rate"))
    return np.array(rows, LOOP)


def allocate_memory(
    ticks: int, samples: int, loops: int, path: Path | None = None
) -> Memory | PathMemory:
    """Return arrays for rows with at most these numbers of poses, samples and loops.

    `path` is the path of the rows, if they track one.
    """
    coverage = GOALS if path is None else PATHS
    numbers = np.empty((coverage.uses, max(2 * ticks, samples)))
    memory = Memory(numbers, np.empty(ticks, np.int64), np.empty(loops, SPAN))
    if path is None:
        return memory
    numbers_of_path = as_record(path.numbers), build_pieces(path), list_corners(path)
    return PathMemory(*memory, *numbers_of_path, path.seam_rad)


def name_measurement(coverage: Coverage) -> str:
    """Return the name of a measurement in numba's cache."""
    return f"measure_{coverage.name}_{_bind(coverage)[1]}"


@cache
def compile_goals() -> Any:
    """Return the compiled measurement of laws with a goal."""
    return _compile_measurement(GOALS)


@cache
def compile_paths() -> Any:
    """Return the compiled measurement of laws that track a path."""
    return _compile_measurement(PATHS)


def _compile_measurement(coverage: Coverage) -> Any:
    """Return the compiled function that measures a row."""
    functions, stamp = _bind(coverage)

    def bind(compiler: Any) -> dict[str, Any]:
        twins = Twins(compiler, inline=False, wide=frozenset({"curve", "course", "row"}))
        scope = {name: twins.compile(function) for name, function in functions.items()}
        return {**scope, "ROW": Row, "CURVES": len(coverage.curves), "STAMP": int(stamp[:12], 16)}

    return compile_entry(measure_row, name_measurement(coverage), bind, type_measurement(coverage))


_ANY_PATH: Final = Path(kind="line", points=((0.0, 0.0), (1.0, 0.0)))


def type_measurement(coverage: Coverage) -> Any:
    """Return numba's type of the function that measures a row."""
    from numba import typeof, types

    entry = np.empty(1, np.bool_), np.empty(1), np.empty(1, np.int16)
    arrays = [np.empty(1, kind) for kind in (FACTS, TICK, SAMPLE, LINE, LOOP)]
    memory = allocate_memory(1, 1, 1, _ANY_PATH if coverage is PATHS else None)
    return types.int64(*map(typeof, (*arrays, memory, entry)))


@cache
def _bind(coverage: Coverage) -> tuple[dict[str, Function], str]:
    """Return the functions that the outermost function calls, and a stamp of all their sources."""
    from importlib.metadata import version

    functions: dict[str, Function] = {
        "IS_ANY": batch_kernel.is_any,
        **coverage.functions,
        "MEASURE_CURVE": _chain("curve", {name: CURVES[name] for name in coverage.curves}),
        "MEASURE_COURSE": _chain("course", COURSES),
    }
    types = FACTS, TICK, SAMPLE, LINE, LOOP, SPAN, PIECE
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
