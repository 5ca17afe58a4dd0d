"""Conversion of varied keys to the arrays of the compiled loop."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.arithmetic import to_float32
from turtlelog.errors import TurtlelogError
from turtlelog.laws import LawPart, find_law
from turtlelog.laws.sequential import SequentialNumbers
from turtlelog.measure.context import SETTLING_BAND
from turtlelog.parts import Plant, PlantPart
from turtlelog.plants.kinds import PLANTS
from turtlelog.run import CUT_SHORT
from turtlelog.run.paths import Path
from turtlelog.scenario import Scenario, resolve_scenario
from turtlelog.simulate import declare_scenario
from turtlelog.simulate.class_law import is_built_in
from turtlelog.simulate.compiled.compiled_loop import build_table, find_kinds
from turtlelog.simulate.compiled.twins import as_record
from turtlelog.simulate.loop_parts import list_streams
from turtlelog.simulate.many import find_loop
from turtlelog.simulate.settings import bound_rows, build_settings
from turtlelog.sweep.batch.batch_columns import LINE, Coverage, find_coverage
from turtlelog.sweep.plan import build_row_scenario

FREE_KEYS: Final = frozenset(
    {
        *("law.kp_linear", "law.kp_angular", "law.ki_linear", "law.ki_angular"),
        *("law.kd_linear", "law.kd_angular"),
        *(
            "law.heading_tolerance_rad",
            "law.position_tolerance_m",
            "law.pause_ticks",
            "law.timeout_s",
        ),
        *("law.settled_within_m", "law.settled_for_s", "law.standstill_samples"),
        *("law.standstill_below", "law.derivative_filter_s", "law.tracking_time_s"),
        *("plant.speed_gain", "plant.turn_gain", "plant.speed_lag_s", "plant.turn_lag_s"),
        "seed",
    }
)
"""Keys whose values can be validated one by one. No rule combines these keys with others, each may
be any number between two bounds, and each is a number of the loop itself. Other keys are validated
in combination."""

_NOT_COMPARED: Final = (dict, list, tuple)
"""Types of values that are rarely equal, because each row has its own schedule or points."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PreparedRows:
    """Rows as arrays of shape (n,) for the compiled loop.

    Attributes:
        rows: Row numbers.
        others: Rows that the loop cannot simulate.
        starts: Start states.
        states: States that the loop changes.
        lines: Lines from start to goal.
        table: Table of the law, shared by all rows.
        path: Path, shared by all rows; None if they track none.
        streams: Names of the random streams that any row needs.
        ticks: Largest possible number of ticks of a row.
        samples: Largest possible number of samples of a row.
    """

    rows: NDArray[np.int64]
    others: list[int]
    settings: NDArray[Any]
    starts: NDArray[Any]
    states: NDArray[Any]
    lines: NDArray[Any]
    table: NDArray[np.float64]
    path: Path | None
    seeds: NDArray[Any]
    streams: frozenset[str]
    ticks: int
    samples: int

    def begin(self) -> None:
        """Reset the states to the start states."""
        self.states[:] = self.starts

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
    if find_scenario_coverage(scenario) is None:
        return None
    return law, PLANTS[scenario.plant.kind], declare_scenario(scenario).states


def find_scenario_coverage(scenario: Scenario) -> Coverage | None:
    """Return the measurement that covers the law of a scenario; None if there is none."""
    return find_coverage(declare_scenario(scenario), has_path=scenario.path is not None)


def is_free(law: LawPart) -> bool:
    """Return whether the values of `FREE_KEYS` can be validated one by one."""
    return law.Numbers is SequentialNumbers and is_built_in(law)


class _Case:
    """A combination of the keys that are validated together."""

    def __init__(self, scenario: Scenario, plant: Plant, kind: Kind) -> None:
        law, part, _ = kind
        declaration = declare_scenario(scenario)
        _, settings, start = build_settings(scenario, law, declaration, plant)
        kinds = find_kinds(*kind)
        self.settings = as_record(settings, kinds.settings)
        self.state, self.seed = as_record(start, kinds.state), scenario.seed
        self.table = build_table(scenario)
        self.streams = list_streams(scenario)
        self.ticks, self.samples = bound_rows(scenario, plant)
        x_m, y_m = part.read(start.plant)[:2]
        exact = scenario.loop.pose_precision == "float64"
        start_xy_m = (x_m, y_m) if exact else (to_float32(x_m), to_float32(y_m))
        line = find_line(start_xy_m, (scenario.goal.x_m, scenario.goal.y_m))
        heading_rad = math.nan if scenario.goal.heading_rad is None else scenario.goal.heading_rad
        goal = scenario.goal.x_m, scenario.goal.y_m, heading_rad
        self.path = scenario.path
        if self.path is not None:  # a law that tracks a path has no goal
            goal = math.nan, math.nan, math.nan
        self.line = (*line.values(), *goal, SETTLING_BAND)


def prepare_rows(
    base: Scenario, columns: Mapping[str, Sequence[Any]], rows: Sequence[int]
) -> PreparedRows:
    """Return rows as arrays, with a separate list of rows that the loop of `base` cannot simulate.

    The law of `base` is resolved; `columns` are the values of each varied key, one per row.
    """
    kind = find_column_kind(base)
    may_be_free = kind is not None and is_free(kind[0]) and "law.kind" not in columns
    free = [key for key in columns if key in FREE_KEYS] if may_be_free else []
    joint = [key for key in columns if key not in free]
    cases: dict[tuple[Any, ...], _Case | None] = {}
    own = {key: _judge_column(base, key, [columns[key][row] for row in rows]) for key in free}
    taken: list[int] = []
    others: list[int] = []
    found: list[_Case] = []
    for place, row in enumerate(rows):
        key = tuple((type(columns[name][row]), columns[name][row]) for name in joint)
        if any(kind in _NOT_COMPARED for kind, _ in key):
            others.append(row)
            continue
        if key not in cases:
            cases[key] = _judge_case(base, kind, dict(zip(joint, (v for _, v in key), strict=True)))
        case = cases[key]
        # The memory of the loop holds one table and one path.
        has_other = case is not None and bool(found) and not is_alike(case, found[0])
        if case is None or has_other or any(column[place] is None for column in own.values()):
            others.append(row)
        else:
            taken.append(place)
            found.append(case)
    values = {key: [column[place] for place in taken] for key, column in own.items()}
    return _gather([rows[place] for place in taken], others, found, values)


def is_alike(case: _Case, other: _Case) -> bool:
    """Return whether the laws of two cases have the same table and the same path."""
    if case is other:
        return True
    return case.path == other.path and np.array_equal(case.table, other.table, equal_nan=True)


_NONE: Final = np.empty(0)


def _gather(
    taken: list[int], others: list[int], cases: list[_Case], free: Mapping[str, Sequence[Any]]
) -> PreparedRows:
    unique = [*dict.fromkeys(cases)]
    numbers = {case: number for number, case in enumerate(unique)}
    of_case = np.array([numbers[case] for case in cases], np.int64)
    settings = np.concatenate([case.settings for case in unique] or [_NONE])[of_case]
    seeds: NDArray[Any] = np.array([case.seed for case in unique], object)[of_case]
    for key, column in free.items() if cases else ():
        if key == "seed":
            seeds = np.array(column, object)
        else:
            table, name = key.split(".")
            settings[table][name] = column
    lines = np.array([case.line for case in unique], LINE)[of_case]
    starts = np.concatenate([case.state for case in unique] or [_NONE])[of_case]
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


def find_line(start_xy_m: tuple[float, float], goal_xy_m: tuple[float, float]) -> dict[str, float]:
    """Return the line from start to goal as in `Run`, and as used for projecting signals."""
    x_m, y_m = start_xy_m
    ahead_m, left_m = goal_xy_m[0] - x_m, goal_xy_m[1] - y_m
    bearing_rad = math.atan2(left_m, ahead_m)
    return {
        "x_m": x_m,
        "y_m": y_m,
        "cos": float(np.cos(bearing_rad)),
        "sin": float(np.sin(bearing_rad)),
        "length_m": float(np.hypot(ahead_m, left_m)),
        "bearing_rad": bearing_rad,
    }
