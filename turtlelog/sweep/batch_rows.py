"""From keys that vary to the arrays of the compiled loop."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import TurtlelogError
from turtlelog.measure.measure_settings import SETTLING_BAND
from turtlelog.plants import Plant
from turtlelog.scenario import Scenario, resolve_scenario
from turtlelog.simulate.compiled.fields import (
    AXIS,
    AXIS_KEYS,
    SETTINGS,
    fill_axes,
    fill_settings,
    is_compiled,
    is_sequential,
    mark_terms,
    read_key,
)
from turtlelog.simulate.compiled.law_fields import fill_schedule
from turtlelog.simulate.compiled.memory import SPEED, STATE, TURN, begin
from turtlelog.simulate.compiled.runner import count_rows
from turtlelog.simulate.random_streams import list_streams
from turtlelog.sweep.plan import build_row_scenario

_OF_AXES: Final = {
    **{
        key: (gain, axis) for gain in ("kp", "ki", "kd") for axis, key in enumerate(AXIS_KEYS[gain])
    },
    "plant.speed_gain": ("robot_gain", SPEED),
    "plant.turn_gain": ("robot_gain", TURN),
    "plant.speed_lag_s": ("robot_lag_s", SPEED),
    "plant.turn_lag_s": ("robot_lag_s", TURN),
}
_OF_SETTINGS: Final = (
    *("law.heading_tolerance_rad", "law.position_tolerance_m", "law.pause_ticks", "law.timeout_s"),
    *("law.settled_within_m", "law.settled_for_s", "law.standstill_samples"),
    *("law.standstill_below", "law.derivative_filter_s", "law.tracking_time_s"),
)

FREE_KEYS: Final = frozenset({*_OF_AXES, *_OF_SETTINGS, "seed"})
"""Keys whose values may be judged one by one: no rule names them together with another key, each
may be any number between two bounds, and is a number of the loop by itself. Of all other keys the
combinations are judged."""

LINE: Final = np.dtype(
    [
        (name, np.float64)
        for name in (
            *("x_m", "y_m", "cos", "sin", "length_m", "bearing_rad", "goal_heading_rad", "band"),
        )
    ]
)
"""The line from start to goal, and what else of a scenario only measuring needs."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PreparedRows:
    """Rows as the compiled loop takes them.

    Attributes:
        rows: Their numbers, shape (n,).
        others: Rows that it does not take.
        settings: Shape (n,).
        starts: States in which they begin, shape (n,).
        states: Likewise, which the loop changes.
        axes: Shape (n, 2).
        lines: Shape (n,).
        schedule: Gains that change on the way, which all of them share.
        seeds: Shape (n,).
        streams: Names of the random numbers that any of them needs.
        ticks: Most that any may have.
        samples: Likewise.
    """

    rows: NDArray[np.int64]
    others: list[int]
    settings: NDArray[Any]
    starts: NDArray[Any]
    states: NDArray[Any]
    axes: NDArray[Any]
    lines: NDArray[Any]
    schedule: NDArray[np.float64]
    seeds: NDArray[Any]
    streams: frozenset[str]
    ticks: int
    samples: int

    def begin(self) -> None:
        """Put the states to the start."""
        self.states[:] = self.starts

    def take(self, places: NDArray[np.int64]) -> "PreparedRows":
        """Return some of the rows."""
        names = ("rows", "settings", "starts", "states", "axes", "lines", "seeds")
        return replace(self, **{name: getattr(self, name)[places] for name in names})


class _Case:
    """A combination of the keys that are judged together."""

    def __init__(self, scenario: Scenario, plant: Plant) -> None:
        self.settings, self.state = fill_settings(scenario, plant)[0], begin(scenario)[0]
        self.axes, self.seed = fill_axes(scenario), scenario.seed
        self.schedule = fill_schedule(scenario)
        self.streams = list_streams(scenario)
        self.ticks, self.samples = count_rows(scenario, plant)
        start_xy_m = _find_start(scenario, self.state)
        line = find_line(start_xy_m, (scenario.goal.x_m, scenario.goal.y_m))
        heading_rad = scenario.goal.heading_rad
        self.line = (*line.values(), math.nan if heading_rad is None else heading_rad)


def prepare_rows(
    base: Scenario, columns: Mapping[str, Sequence[Any]], rows: Sequence[int], plant: Plant | None
) -> PreparedRows:
    """Return rows as arrays, those that are not compiled or no scenario apart."""
    if "law.schedule" in columns:  # the memory of the loop holds one
        return _gather([], [*rows], [], {})
    free = [] if "law.kind" in columns else [key for key in columns if key in FREE_KEYS]
    joint = [key for key in columns if key not in free]
    cases: dict[tuple[Any, ...], _Case | None] = {}
    own = {key: _judge_column(base, key, [columns[key][row] for row in rows]) for key in free}
    taken, others, found = [], [], []
    for place, row in enumerate(rows):
        key = tuple((type(columns[name][row]), columns[name][row]) for name in joint)
        if key not in cases:
            cases[key] = _judge_case(base, joint, [value for _, value in key], plant)
        case = cases[key]
        if case is None or any(column[place] is None for column in own.values()):
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
    settings = np.array([case.settings for case in unique], SETTINGS)[of_case]
    axes = np.array([case.axes for case in unique], AXIS).reshape(-1, 2)[of_case]
    seeds: NDArray[Any] = np.array([case.seed for case in unique], object)[of_case]
    for key, column in free.items():
        if key == "seed":
            seeds = np.array(column, object)
        elif key in _OF_AXES:
            name, axis = _OF_AXES[key]
            axes[name][:, axis] = column
        else:
            settings[key.replace(".", "_")] = column
    schedule = cases[0].schedule if cases else np.empty((0, 0))
    settings["finds_distance"] = len(schedule) > 0  # no metric of the batch reads it: 20 ns
    mark_terms(axes, schedule)
    lines = np.array([(*case.line, SETTLING_BAND) for case in unique], LINE)[of_case]
    starts = np.array([case.state for case in unique], STATE)[of_case]
    return PreparedRows(
        rows=np.array(taken, np.int64),
        others=others,
        settings=settings,
        starts=starts,
        states=starts.copy(),
        axes=axes,
        lines=lines,
        schedule=schedule,
        seeds=seeds,
        streams=frozenset[str]().union(*(case.streams for case in unique)),
        ticks=max((case.ticks for case in unique), default=1),
        samples=max((case.samples for case in unique), default=1),
    )


def _judge_case(
    base: Scenario, keys: Sequence[str], values: Sequence[Any], plant: Plant | None
) -> _Case | None:
    """Return a combination, None where it is no scenario or not compiled."""
    try:
        scenario = resolve_scenario(build_row_scenario(base, keys, values, 0))
    except TurtlelogError:
        return None
    clock = scenario.plant.facts if plant is None else plant
    is_measured = is_sequential(scenario) and is_compiled(scenario, clock)
    return _Case(scenario, clock) if is_measured else None


def _judge_column(base: Scenario, key: str, column: Sequence[Any]) -> Sequence[Any]:
    """Return the values of a free key as a scenario has them, None where it cannot have one."""
    if {*map(type, column)} in ({int}, {float}):
        least, most = min(column), max(column)
        found = _judge_value(base, key, least), _judge_value(base, key, most)
        # What a free key may be is an interval: what lies between two of its values is one, too.
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
    if key.startswith("plant."):
        return getattr(scenario.plant, key.removeprefix("plant."))
    return scenario.seed if key == "seed" else read_key(scenario, key)


def _find_start(scenario: Scenario, state: Any) -> tuple[float, float]:
    """Return where a robot that stands still is read for the first time."""
    from turtlelog.plants import round_to_float32
    from turtlelog.plants.turtlesim import WORLD_SIZE_M

    x_m, y_m = float(state["x_m"]), float(state["y_m"])
    if scenario.plant.kind == "turtlesim":
        y_m = WORLD_SIZE_M - float(state["down_m"])
    if scenario.loop.pose_precision == "float64":
        return x_m, y_m
    return round_to_float32(x_m), round_to_float32(y_m)


def find_line(start_xy_m: tuple[float, float], goal_xy_m: tuple[float, float]) -> dict[str, float]:
    """Return the line from start to goal as runs have it, and as signals are projected on it."""
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
