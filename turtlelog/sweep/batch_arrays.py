"""The arrays of the batch: rows with their settings, and the compiled measurement of its metrics.

The batch computes the registered metrics that are functions of numbers; this module names none of
them.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import turtlelog.measure.metrics  # noqa: F401  (enters every metric in the registry)
from turtlelog.arithmetic import SETTLING_BAND, called, to_float32
from turtlelog.errors import TurtlelogError
from turtlelog.laws import LawPart, find_law
from turtlelog.laws.sequential import SequentialNumbers
from turtlelog.measure.loop_segment import GOAL_REFERENCES, SIGNALS, Aim, LoopNumbers, aim_at
from turtlelog.measure.metric import FOUND, Status
from turtlelog.measure.metric_kinds import LOOP_METRICS, RUN_METRICS, refuse_curve
from turtlelog.measure.response import list_corners
from turtlelog.parts import Plant, PlantPart
from turtlelog.plants import PLANTS
from turtlelog.run import CUT_SHORT
from turtlelog.run.loops import REFERENCES as REFERENCES_OF, ControlLoop
from turtlelog.run.paths import Path
from turtlelog.run.stop_reasons import draw_goal_line
from turtlelog.scenario import Scenario, resolve_scenario
from turtlelog.simulate import compiled_loop, declare_scenario, loop_parts
from turtlelog.simulate.class_law import is_built_in
from turtlelog.simulate.compiled_entry import measure_row
from turtlelog.simulate.compiled_twins import Twins, as_record, compile_entry, stamp_functions
from turtlelog.simulate.many import find_loop
from turtlelog.sweep import batch_kernel
from turtlelog.sweep.batch_kernel import USES_OF_PATH, USES_OF_ROW, Memory, PathMemory, Row
from turtlelog.sweep.sweep_plan import build_row_scenario

CURVES: Final = {name: kind for name, kind in LOOP_METRICS.items() if kind.numbers is not None}
"""Metrics of a loop's curve by name, in column order."""

COURSES: Final = {name: kind for name, kind in RUN_METRICS.items() if kind.numbers is not None}
"""Metrics of the whole run by id, in column order, after those of all loops."""

STATUSES: Final = tuple(Status)  # statuses in the order of their numbers

OK: Final = STATUSES.index(Status.OK)

LINE: Final = np.dtype([(name, np.float64) for name in (*Aim._fields, "band")])
"""The line from start to goal, and the settling band."""

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

_KINDS: Final = {int: np.int64, bool: np.bool_}
LOOP: Final = np.dtype(
    [(name, _KINDS[kind]) for name, kind in LoopNumbers.__annotations__.items()], align=True
)
"""Record type of `LoopNumbers`."""

FIRST_POSE: Final = slice(-2, None)
"""Last columns: x and y of the first pose that the controller read [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Laws that one compiled measurement covers."""

    name: str  # name of the measurement in numba's cache
    compiler: str  # function that compiles it, as `module:function`
    curves: tuple[str, ...]  # names of the metrics in `CURVES` that a loop of these laws may have
    functions: Mapping[str, loop_parts.Function]  # called for the inputs of metrics
    uses: int  # number of rows of `Memory.numbers`


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
    _choose_curves(GOAL_REFERENCES),
    {
        "PREPARE_ROW": batch_kernel.prepare_row,
        "FIND_MISSING": batch_kernel.find_missing,
        "READ_CURVE": batch_kernel.read_loop_curve,
        "READ_COURSE": batch_kernel.read_course,
    },
    USES_OF_ROW,
)
"""Laws with a goal and a loop of the heading."""

PATHS: Final = Coverage(
    "path",
    f"{__name__}:compile_paths",
    _choose_curves(["path"]),
    {
        "PREPARE_ROW": batch_kernel.prepare_path_row,
        "FIND_MISSING": batch_kernel.find_path_missing,
        "READ_CURVE": batch_kernel.read_path_curve,
        "READ_COURSE": batch_kernel.read_path_course,
    },
    USES_OF_PATH,
)
"""Laws without a goal, whose loops all refer to the path."""


def find_coverage(scenario: Scenario) -> Coverage | None:
    """Return the measurement that covers the law of a scenario; None if there is none."""
    declaration, has_path = declare_scenario(scenario), scenario.path is not None
    loops, is_path = declaration.loops, has_path and not declaration.uses_goal
    references = {loop.reference for loop in loops}
    has_limits = any(loop.limit is not None for loop in loops)
    if has_limits or len(declaration.phase_names) > _MOST_PHASES:
        return None
    if is_path and references == {"path"}:
        return PATHS
    has_heading = any(loop.signal == "heading" for loop in loops)
    is_goal = declaration.uses_goal and not has_path and references <= {*GOAL_REFERENCES}
    return GOALS if is_goal and has_heading else None


_MOST_PHASES: Final = 60  # phases of a law: each has a bit of 64


def allocate_memory(ticks: int, samples: int, path: Path | None = None) -> Memory | PathMemory:
    """Return arrays for rows with at most these numbers of poses and samples.

    `path` is the path of the rows, if they track one.
    """
    coverage = GOALS if path is None else PATHS
    numbers = np.empty((coverage.uses, max(2 * ticks, samples)))
    memory = Memory(numbers, np.empty(ticks, np.int64))
    if path is None:
        return memory
    numbers_of_path = as_record(path.numbers), compiled_loop.build_pieces(path), list_corners(path)
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
    functions, stamp = _bind(coverage)

    def bind(compiler: Any) -> dict[str, Any]:
        twins = Twins(compiler, inline=False, wide=frozenset({"curve", "course", "row", "run"}))
        scope = {name: twins.compile(function) for name, function in functions.items()}
        return {**scope, "ROW": Row, "CURVES": len(coverage.curves), "STAMP": int(stamp[:12], 16)}

    return compile_entry(measure_row, name_measurement(coverage), bind, type_measurement(coverage))


def type_measurement(coverage: Coverage) -> Any:
    """Return numba's type of the function that measures a row."""
    from numba import typeof, types

    entry = np.empty(1, np.bool_), np.empty(1), np.empty(1, np.int16)
    arrays = [
        np.empty(1, kind) for kind in (FACTS, compiled_loop.TICK, compiled_loop.SAMPLE, LINE, LOOP)
    ]
    path = Path(kind="line", points=((0.0, 0.0), (1.0, 0.0))) if coverage is PATHS else None
    memory = allocate_memory(1, 1, path)
    return types.int64(*map(typeof, (*arrays, memory, entry)))


@cache
def _bind(coverage: Coverage) -> tuple[dict[str, loop_parts.Function], str]:
    """Return the functions that the outermost function calls, and a stamp of all their sources."""
    from importlib.metadata import version

    functions: dict[str, loop_parts.Function] = {
        "IS_ANY": batch_kernel.is_any,
        "FIND_SEGMENT": batch_kernel.find_row_segment,
        **coverage.functions,
        "MEASURE_CURVE": _chain("curve", {name: CURVES[name] for name in coverage.curves}),
        "MEASURE_COURSE": _chain("course", COURSES),
    }
    types = FACTS, compiled_loop.TICK, compiled_loop.SAMPLE, LINE, LOOP, compiled_loop.PIECE
    return functions, stamp_functions(functions.values(), *types, version("numba"), np.__version__)


def _chain(what: str, kinds: Mapping[str, Any]) -> loop_parts.Function:
    """Return a function that writes each requested metric."""
    lines = [f"def measure_{what}({what}, asked, values, reasons):"]
    names: dict[str, Any] = {"refuse_curve": refuse_curve}
    refusals: dict[str, str] = {}  # by arguments
    for place, kind in enumerate(kinds.values()):
        names[f"find_{place}"] = kind.numbers
        body = [f"values[{place}], at_s, reasons[{place}] = find_{place}({what})"]
        if what == "curve" and (kind.needs_whole or kind.needs_step):
            needs = f"{kind.needs_whole}, {kind.needs_step}"
            reason = refusals.setdefault(needs, f"reason_{len(refusals)}")
            body = [
                f"if {reason} != {FOUND}:",
                f"    reasons[{place}] = {reason}",
                "else:",
                f"    {body[0]}",
            ]
        lines += [f"    if asked[{place}]:", *(f"        {line}" for line in body)]
    lines[1:1] = [f"    {one} = refuse_curve(curve, {needs})" for needs, one in refusals.items()]
    return called(loop_parts.compile_text(f"measure_{what}", [*lines, "    return"], names))


FREE_KEYS: Final = frozenset(
    {
        *(f"law.k{term}_{axis}" for term in "pid" for axis in ("linear", "angular")),
        *("law.heading_tolerance_rad", "law.position_tolerance_m", "law.pause_ticks"),
        *("law.timeout_s", "law.settled_within_m", "law.settled_for_s", "law.standstill_samples"),
        *("law.standstill_below", "law.derivative_filter_s", "law.tracking_time_s"),
        *("plant.speed_gain", "plant.turn_gain", "plant.speed_lag_s", "plant.turn_lag_s", "seed"),
    }
)
"""Keys whose values can be validated one by one. No rule combines these keys with others, each may
be any number between two bounds, and each is a number of the loop itself. Other keys are validated
in combination."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PreparedRows:
    """Rows as arrays of shape (n,) for the compiled loop."""

    rows: NDArray[np.int64]  # row numbers
    others: list[int]  # rows that the loop cannot simulate
    settings: NDArray[Any]
    starts: NDArray[Any]  # start states
    states: NDArray[Any]  # states that the loop changes
    lines: NDArray[Any]  # lines from start to goal
    table: NDArray[np.float64]  # table of the law, shared by all rows
    path: Path | None  # path, shared by all rows; None if they track none
    seeds: NDArray[Any]
    streams: frozenset[str]  # names of the random streams that any row needs
    ticks: int  # largest possible number of ticks of a row
    samples: int  # largest possible number of samples of a row

    def take(self, places: NDArray[np.int64]) -> "PreparedRows":
        """Return some of the rows."""
        names = ("rows", "settings", "starts", "states", "lines", "seeds")
        return replace(self, **{name: getattr(self, name)[places] for name in names})


Kind = tuple[LawPart, PlantPart, tuple[str, ...]]
"""Key of a compiled loop: a law, a plant, and the declared states of the law."""


def find_column_kind(scenario: Scenario) -> Kind | None:
    """Return the kind of compiled loop for rows of a scenario; None if no loop fits.

    A measurement must cover its law, and its runs must have an ordinary end.
    """
    law = find_law(scenario.law.kind)
    if not isinstance(law, LawPart) or CUT_SHORT & {*law.stops}:
        return None
    if find_coverage(scenario) is None:
        return None
    return law, PLANTS[scenario.plant.kind], declare_scenario(scenario).states


class _Case:
    """A combination of the keys that are validated together."""

    def __init__(self, scenario: Scenario, plant: Plant, kind: Kind) -> None:
        law, part, _ = kind
        declaration = declare_scenario(scenario)
        _, settings, start = loop_parts.build_settings(scenario, law, declaration, plant)
        kinds = compiled_loop.find_kinds(*kind)
        self.settings = as_record(settings, kinds.settings)
        self.state, self.seed = as_record(start, kinds.state), scenario.seed
        self.table = compiled_loop.build_law_table(scenario)
        self.streams = loop_parts.list_streams(scenario)
        self.ticks, self.samples = loop_parts.bound_rows(scenario, plant)
        x_m, y_m = part.read(start.plant)[:2]
        exact = scenario.loop.pose_precision == "float64"
        start_xy_m = (x_m, y_m) if exact else (to_float32(x_m), to_float32(y_m))
        goal, self.path = scenario.goal, scenario.path
        line = draw_goal_line(start_xy_m, (goal.x_m, goal.y_m))
        aim = aim_at(line, (goal.x_m, goal.y_m), goal.heading_rad)
        if self.path is not None:  # a law that tracks a path has no goal
            aim = aim_at(line, None, None)
        self.line = (*aim, SETTLING_BAND)

    def has_memory_of(self, other: "_Case") -> bool:
        """Return whether two cases have the same table of the law and the same path."""
        if self is other:
            return True
        return self.path == other.path and np.array_equal(self.table, other.table, equal_nan=True)


def prepare_rows(
    base: Scenario, columns: Mapping[str, Sequence[Any]], rows: Sequence[int]
) -> PreparedRows:
    """Return rows as arrays, with a separate list of rows that the loop of `base` cannot simulate.

    The law of `base` is resolved; `columns` are the values of each varied key, one per row.
    """
    kind = find_column_kind(base)
    # Of laws with these numbers, the values of free keys can be validated one by one.
    law = None if kind is None or "law.kind" in columns else kind[0]
    is_free = law is not None and law.Numbers is SequentialNumbers and is_built_in(law)
    free = [key for key in columns if key in FREE_KEYS] if is_free else []
    joint = [key for key in columns if key not in free]
    cases: dict[tuple[Any, ...], _Case | None] = {}
    own = {key: _judge_column(base, key, [columns[key][row] for row in rows]) for key in free}
    taken: list[int] = []
    others: list[int] = []
    found: list[_Case] = []
    for place, row in enumerate(rows):
        key = tuple((type(columns[name][row]), columns[name][row]) for name in joint)
        if any(isinstance(value, dict | list | tuple) for _, value in key):
            # Schedules and points are rarely equal, because each row has its own.
            others.append(row)
            continue
        if key not in cases:
            cases[key] = _judge_case(base, kind, dict(zip(joint, (v for _, v in key), strict=True)))
        case = cases[key]
        # The memory of the loop holds one table and one path.
        is_alike = case is not None and (not found or case.has_memory_of(found[0]))
        if case is None or not is_alike or None in [column[place] for column in own.values()]:
            others.append(row)
        else:
            taken.append(place)
            found.append(case)
    values = {key: [column[place] for place in taken] for key, column in own.items()}
    return _gather([rows[place] for place in taken], others, found, values)


def _gather(
    taken: list[int], others: list[int], cases: list[_Case], free: Mapping[str, Sequence[Any]]
) -> PreparedRows:
    unique = [*dict.fromkeys(cases)]
    numbers = {case: number for number, case in enumerate(unique)}
    of_case = np.array([numbers[case] for case in cases], np.int64)
    settings = np.concatenate([case.settings for case in unique] or [np.empty(0)])[of_case]
    seeds: NDArray[Any] = np.array([case.seed for case in unique], object)[of_case]
    for key, column in free.items() if cases else ():
        if key == "seed":
            seeds = np.array(column, object)
        else:
            table, name = key.split(".")
            settings[table][name] = column
    lines = np.array([case.line for case in unique], LINE)[of_case]
    starts = np.concatenate([case.state for case in unique] or [np.empty(0)])[of_case]
    return PreparedRows(
        rows=np.array(taken, np.int64),
        others=others,
        settings=settings,
        starts=starts,
        states=starts.copy(),
        lines=lines,
        table=cases[0].table if cases else np.empty((0, 0)),
        path=cases[0].path if cases else None,
        seeds=seeds,
        streams=frozenset[str]().union(*(case.streams for case in unique)),
        ticks=max((case.ticks for case in unique), default=1),
        samples=max((case.samples for case in unique), default=1),
    )


def _judge_case(base: Scenario, kind: Kind | None, changes: Mapping[str, Any]) -> _Case | None:
    """Return a combination; None if it is not a valid scenario or has no compiled loop."""
    try:
        scenario = resolve_scenario(build_row_scenario(base, [*changes], [*changes.values()], 0))
    except TurtlelogError:
        return None
    clock = scenario.plant.facts
    if kind is None or find_column_kind(scenario) != kind or find_loop(scenario, clock) is None:
        return None
    if declare_scenario(scenario).loops != declare_scenario(base).loops:
        return None
    return _Case(scenario, clock, kind)


def is_batched(scenario: Scenario, plant: Plant) -> bool:
    """Return whether the batch covers a scenario."""
    return find_column_kind(scenario) is not None and find_loop(scenario, plant) is not None


def _judge_column(base: Scenario, key: str, column: Sequence[Any]) -> Sequence[Any]:
    """Return the values of a free key in the form of a scenario; None if a value is invalid."""
    if {*map(type, column)} in ({int}, {float}):
        least, most = min(column), max(column)
        found = _judge_value(base, key, least), _judge_value(base, key, most)
        # The valid values of a free key form an interval, so values between valid ones are valid.
        if None not in found and all(least <= value <= most for value in column):
            return [*map(type(found[0]), column)]
    known: dict[Any, Any] = {}
    for value in column:
        if (type(value), value) not in known:
            known[type(value), value] = _judge_value(base, key, value)
    return [known[type(value), value] for value in column]


def _judge_value(base: Scenario, key: str, value: Any) -> Any:
    try:
        scenario = resolve_scenario(build_row_scenario(base, [key], [value], 0))
    except TurtlelogError:
        return None
    if key == "seed":
        return scenario.seed
    table, name = key.split(".")
    return getattr(scenario.plant if table == "plant" else scenario.law.parameters, name)
