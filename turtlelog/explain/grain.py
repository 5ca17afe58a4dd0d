"""How much a metric must change before the change is more than next to nothing."""

import math
from dataclasses import dataclass
from typing import Final

from turtlelog.angles import wrap_angle
from turtlelog.loops import Declaration
from turtlelog.measure import find_metric_kind, list_metrics
from turtlelog.plants.turtlesim import TICK_S
from turtlelog.scenario import DEFAULT_LAW, Scenario

_SHARE: Final = 0.01
"""Of a value that no tolerance and no clock bounds. A phase of the paper's runs has a hundred
samples and more: about what one of them makes of an integral over it."""

_HALF_A_COUNT: Final = 0.5
"""Counts change by one at least."""

_COUNTS: Final = (
    "crossings",
    "reversals",
    "burst_samples",
    "dropped_samples",
    "duplicates",
    "disorder",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Grain:
    """The largest change of a metric that is next to nothing.

    Attributes:
        size: In the metric's unit.
        reason: What makes a change of this size, in one clause.
    """

    size: float
    reason: str


def find_grain(scenario: Scenario, declaration: Declaration, metric: str, value: float) -> Grain:
    """Return the grain of a metric of a scenario, where it has this value.

    Of a law whose tolerances are not known a share of the value stands for what they leave.
    """
    found = list_metrics(declaration).get(metric) or find_metric_kind(metric)
    unit = "" if found is None else found.unit
    if unit == "s":
        return Grain(size=scenario.loop.period_ticks * TICK_S, reason="one sample period")
    if scenario.law.kind == DEFAULT_LAW and unit in {"m", "deg", "%"}:
        return _find_tolerated(scenario, declaration, metric, unit)
    kind = metric.rpartition(".")[2]
    if kind.removeprefix("speed_").removeprefix("turn_rate_") in _COUNTS:
        return Grain(size=_HALF_A_COUNT, reason="half a count")
    return Grain(size=_SHARE * abs(value), reason=f"{100.0 * _SHARE:g} % of the value")


def _find_tolerated(scenario: Scenario, declaration: Declaration, metric: str, unit: str) -> Grain:
    """Return what the tolerances of the sequential law leave."""
    heading_rad = scenario.law.parameters.heading_tolerance_rad
    position_m = scenario.law.parameters.position_tolerance_m
    distance_m, turn_rad = _find_steps(scenario)
    if unit == "m":
        reach = "heading tolerance times distance plus position tolerance"
        return Grain(size=heading_rad * distance_m + position_m, reason=reach)
    if unit == "deg":
        return Grain(size=math.degrees(heading_rad), reason="the heading tolerance")
    loop = declaration.find_loop(metric.rpartition(".")[0])
    turns = loop is not None and loop.signal == "heading"
    tolerance, step = (heading_rad, turn_rad) if turns else (position_m, distance_m)
    return Grain(size=100.0 * tolerance / step, reason="the tolerance over the step")


def _find_steps(scenario: Scenario) -> tuple[float, float]:
    """Return how far away the goal is [m], and how far the robot turns to it [rad]; never 0."""
    start, goal = scenario.start, scenario.goal
    x_m, y_m = goal.x_m - start.x_m, goal.y_m - start.y_m
    turn_rad = math.atan2(y_m, x_m) - start.heading_rad
    if scenario.law.parameters.wrap_error:
        turn_rad = wrap_angle(turn_rad)
    return max(math.hypot(x_m, y_m), math.ulp(1.0)), max(abs(turn_rad), math.ulp(1.0))
