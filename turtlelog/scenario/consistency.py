"""What the values of a scenario must be to each other, whatever their types allow."""

from collections.abc import Callable, Iterator
from typing import Any

from turtlelog.effects import EFFECTS
from turtlelog.effects.delay import judge_delays
from turtlelog.errors import ScenarioError
from turtlelog.parts import Complaint
from turtlelog.plants.kinds import PLANTS
from turtlelog.scenario.model import Scenario


def require_consistent(scenario: Scenario, source: str) -> None:
    """Refuse a scenario whose values contradict each other; of its law nothing is judged.

    Raises:
        ScenarioError: `source: key: expected ..., found ...`, for the first key that is wrong.
    """
    for judge in (_judge_places, _judge_path, *_list_judges(), _judge_dead_times):
        for key, expected, found in judge(scenario):
            raise ScenarioError(f"{source}: {key}: expected {expected}, found {found}")


Complaints = Iterator[Complaint]
Judge = Callable[[Any], Complaints]


def _list_judges() -> Iterator[Judge]:
    return (effect.judge for effect in EFFECTS if effect.judge is not None)


def _judge_places(scenario: Scenario) -> Complaints:
    """Start and goal lie in the plant's world."""
    low_m, high_m = scenario.plant.facts.low_m, scenario.plant.facts.high_m
    expected = f"a number from {low_m:.10g} to {high_m:.10g}"
    for table in ("start", "goal"):
        for name in ("x_m", "y_m"):
            value = getattr(getattr(scenario, table), name)
            if not low_m <= value <= high_m:
                yield f"{table}.{name}", expected, f"{value:.10g}"


def _judge_path(scenario: Scenario) -> Complaints:
    if scenario.path is None:
        return
    low_m, high_m = scenario.plant.facts.low_m, scenario.plant.facts.high_m
    bounds_m = scenario.path.bounds_m
    for name, least_m, most_m in (("x", *bounds_m[:2]), ("y", *bounds_m[2:])):
        if least_m < low_m or most_m > high_m:
            within = f"{name} from {low_m:.10g} to {high_m:.10g} m"
            yield "path", within, f"{least_m:.10g} to {most_m:.10g} m"


def _judge_dead_times(scenario: Scenario) -> Complaints:
    """Dead times of a robot end within the run."""
    keys = PLANTS[scenario.plant.kind].delays
    delays = {f"plant.{key}": getattr(scenario.plant, key) for key in keys}
    yield from judge_delays(delays, scenario.max_duration_s)
