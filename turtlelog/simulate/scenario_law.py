"""The law of a scenario: what it declares, how it is made, and what of an answer is refused."""

from collections.abc import Mapping
from math import isfinite, isinf
from typing import Any, Final

from turtlelog.errors import SimulationError, TurtlelogError
from turtlelog.laws import (
    LAWS,
    AnyLaw,
    Goal,
    Pose,
    declare_law,
    describe_law_error,
    find_law,
    print_to_stderr,
)
from turtlelog.run.loops import Declaration
from turtlelog.scenario import LawChoice, Scenario, resolve_law
from turtlelog.simulate.class_law import describe_command
from turtlelog.simulate.rows import COMMAND_FAILED, NUMBERS_FAILED, REFERENCE_FAILED, SampleRow

_ERRORS: Final = (
    *("bearing_rad", "heading_error_rad", "error_x_m", "error_y_m", "distance_m"),
    *("world_v_x_m_s", "world_v_y_m_s"),
)
"""What a law enters of a sample beside its command, as numbers."""


def is_built_in(law: AnyLaw) -> bool:
    """Whether a law is one of turtlelog's."""
    return law in LAWS.values()


def build_law(choice: LawChoice) -> Any:
    """Return the law of a scenario with its parameters.

    Raises:
        SimulationError: If it does not take them.
        ScenarioError: As `resolve_law`.
        LawError: If there is no such law.
    """
    choice = resolve_law(choice)
    law = find_law(choice.kind)
    try:
        with print_to_stderr():
            return law(choice.parameters)
    except (TurtlelogError, KeyboardInterrupt):
        raise
    except BaseException as err:
        raise SimulationError(f"law {choice.kind}: {describe_law_error(err, law)}") from err


def declare_scenario(scenario: Scenario) -> Declaration:
    """Return what the law of a scenario declares; its code is loaded if need be.

    Raises:
        ScenarioError: As `resolve_law`.
        LawError: If there is no such law, or its declaration is wrong.
    """
    choice = resolve_law(scenario.law)
    law = find_law(choice.kind)
    return declare_law(law, choice.parameters, build_goal(scenario), scenario.path)


def build_goal(scenario: Scenario) -> Goal:
    """Return the goal of a scenario."""
    return Goal(scenario.goal.x_m, scenario.goal.y_m, scenario.goal.heading_rad)


def describe_numbers(failure: int, row: SampleRow, states: Mapping[str, float]) -> str:
    """Return which number of an answer cannot be executed or recorded.

    Args:
        failure: See `rows`.
        row: What the law entered.
        states: States of the sample.
    """
    if failure == COMMAND_FAILED:
        return describe_command(row.wanted_speed_m_s, row.wanted_turn_rate_rad_s)
    if failure == REFERENCE_FAILED:
        pose = Pose(row.reference_x_m, row.reference_y_m, row.reference_heading_rad)
        return f"expected a finite reference pose, found {pose}"
    if failure == NUMBERS_FAILED:
        values = {name: getattr(row, name) for name in _ERRORS}
        bad = {name: value for name, value in values.items() if isinf(value)} or values
        listed = ", ".join(f"{name} {value}" for name, value in bad.items())
        return f"expected finite numbers, found {listed}"
    name, value = next(one for one in states.items() if not isfinite(one[1]))
    return f"expected a finite number as state {name}, found {value}"
