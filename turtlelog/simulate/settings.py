"""A scenario as numbers: settings and initial state of a loop, of its law, plant and effects.

Each table has a dataclass with the numbers among its keys. A word is represented by its index in
its `Literal`. A missing value is NaN, or -1 for a whole number. Other values are left out.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, Final, Literal, NamedTuple, get_args, get_origin, get_type_hints

from turtlelog.effects import EFFECTS
from turtlelog.laws import AnyLaw, LawPart
from turtlelog.laws.base import GoalNumbers
from turtlelog.parts import Effect, Plant, PlantPart
from turtlelog.plants.kinds import PLANTS
from turtlelog.run.loops import Declaration
from turtlelog.run.path_pieces import PathNumbers
from turtlelog.scenario import Disturbance, Limits, LoopSettings, Scenario, Sensing, Shaping
from turtlelog.simulate.rows import Progress, Scene

_TABLES: Final[dict[str, Any]] = {
    "loop": LoopSettings,
    "limits": Limits,
    "sensing": Sensing,
    "shaping": Shaping,
    "disturbance": Disturbance,
}

Convert = Callable[[Any], Any]


@dataclass(slots=True)
class NoNumbers:
    """A record without numbers: settings of a law in any Python, which reads its own parameters."""


class Mirror(NamedTuple):
    """A dataclass for the numbers of keys, and the function that reads them from an object."""

    kind: type[Any]
    read: Callable[[Any], Any]


@cache
def mirror(keys: Any) -> Mirror:
    """Return the numbers of a dataclass of keys."""
    hints = get_type_hints(keys)
    found: list[tuple[str, type, Any]] = []
    converts: list[tuple[str, Convert | None]] = []
    for one in fields(keys):
        kind, convert = _find_number(hints[one.name])
        if kind is not None:
            found.append((one.name, kind, dataclasses.field(default=_NONE[kind])))
            converts.append((one.name, convert))
    made = dataclasses.make_dataclass(f"{keys.__name__}Numbers", found, slots=True)

    def read(table: Any) -> Any:
        values = (
            getattr(table, name) if convert is None else convert(getattr(table, name))
            for name, convert in converts
        )
        return made(*values)

    return Mirror(made, read)


_NONE: Final[dict[type, Any]] = {float: math.nan, int: -1, bool: False}


def _find_number(hint: Any) -> tuple[type | None, Convert | None]:
    """Return the numeric type of a key, and the function that converts its value."""
    choices = [one for one in get_args(hint) if one is not type(None)]
    if get_origin(hint) is Literal:
        return int, choices.index
    if hint in _NONE:
        return hint, (float if hint is float else None)
    if len(choices) == 1 and choices[0] in _NONE:  # Optional type
        kind, none = choices[0], _NONE[choices[0]]
        return kind, lambda value: none if value is None else kind(value)
    return None, None


class Shape(NamedTuple):
    """The dataclasses of a loop's settings and state, nested by part."""

    Settings: type[Any]
    State: type[Any]
    States: type[Any]


@cache
def find_shape(
    law: type[Any], law_numbers: type[Any], plant: PlantPart, states: tuple[str, ...]
) -> Shape:
    """Return the shape of a loop, from the dataclasses of its law's state and numbers."""
    make, tables = dataclasses.make_dataclass, {**_TABLES, "plant": plant.Keys}
    settings: dict[str, Any] = {"scene": Scene, "goal": GoalNumbers, "path": PathNumbers}
    settings |= {name: mirror(keys).kind for name, keys in tables.items()} | {"law": law_numbers}
    state: dict[str, Any] = {"now": Progress, "plant": plant.State, "law": law}
    state |= {one.name: one.State for one in EFFECTS if one.State is not None}
    return Shape(
        make("Settings", settings.items(), slots=True),
        make("State", state.items(), slots=True),
        find_states(states),
    )


@cache
def find_states(names: tuple[str, ...]) -> type[Any]:
    """Return the dataclass of the recorded states of a law."""
    found = [(name, float, dataclasses.field(default=math.nan)) for name in names]
    return dataclasses.make_dataclass("States", found, slots=True)


def find_law_numbers(law: AnyLaw) -> Any:
    """Return the dataclass that a law reads as `settings.law`."""
    if not isinstance(law, LawPart):
        return NoNumbers
    keys: Any = law.Parameters
    return law.Numbers or mirror(keys).kind


def read_law(law: AnyLaw, parameters: Any) -> Any:
    """Return the values that a law reads as `settings.law`."""
    if not isinstance(law, LawPart):
        return NoNumbers()
    if law.prepare is not None:
        return law.prepare(parameters)
    keys: Any = law.Parameters
    return mirror(keys).read(parameters)


def build_settings(
    scenario: Scenario, law: AnyLaw, declaration: Declaration, plant: Plant
) -> tuple[Shape, Any, Any]:
    """Return the shape of a loop, its settings, and its initial state; the law is resolved."""
    part, goal, start = PLANTS[scenario.plant.kind], scenario.goal, scenario.start
    state_kind: Any = law.State if isinstance(law, LawPart) else NoNumbers
    shape = find_shape(state_kind, find_law_numbers(law), part, declaration.states)
    keys, place = scenario.plant.keys, (start.x_m, start.y_m, start.heading_rad)
    settings = shape.Settings(
        build_scene(scenario, law, declaration, plant),
        GoalNumbers(goal.x_m, goal.y_m, math.nan if goal.heading_rad is None else goal.heading_rad),
        PathNumbers() if scenario.path is None else scenario.path.numbers,
        *(mirror(table).read(getattr(scenario, name)) for name, table in _TABLES.items()),
        mirror(part.Keys).read(keys),
        read_law(law, scenario.law.parameters),
    )
    state = shape.State(
        Progress(waits_for=scenario.loop.start_backlog),
        part.begin(keys, *place, is_rounded=start.precision == "float32"),
        state_kind(),
        *(one.State() for one in EFFECTS if one.State is not None),
    )
    return shape, settings, state


def build_scene(scenario: Scenario, law: AnyLaw, declaration: Declaration, plant: Plant) -> Scene:
    """Return the values that the loop itself reads from a scenario."""
    loop, part = scenario.loop, PLANTS[scenario.plant.kind]
    tick_ns = scenario.plant.facts.period_ns
    duration_ns = round(scenario.max_duration_s * 1e9)
    delays_poses = loop.period_s is not None or scenario.has_action("pose_travel")
    newest_only = loop.queue_policy == "newest"
    return Scene(
        period_ns=plant.period_ns,
        period_s=plant.period_s,
        tick_ns=tick_ns,
        block=tick_ns if delays_poses else plant.steps_per_tick,
        watchdog_ns=float(plant.watchdog_ns),
        last_tick=duration_ns // plant.period_ns,
        end_ns=duration_ns + 1,
        timer_ns=round((loop.period_s or 0.0) * 1e9),
        first_s=loop.period_s or loop.period_ticks * plant.period_ns / 1e9,
        # turtlesim applies a command to the time since its last pose. A robot cannot: its commands
        # of a period have arrived at the period's start.
        causal_ns=0 if part.acts_in_steps else 1 - plant.period_ns,
        is_exact=loop.pose_precision == "float64",
        newest_only=newest_only,
        is_timed=needs_time(scenario),
        acts_in_steps=part.acts_in_steps,
        acts_on_arrival=newest_only and not part.acts_in_steps,
        delays_poses=delays_poses,
        senses=scenario.has_action("sense", "lose_pose"),
        is_pushed=scenario.has_action("push"),
        shapes=scenario.has_action("shape"),
        has_goal=declaration.uses_goal,
        has_reference=isinstance(law, LawPart) and law.needs_path,
        has_states=bool(declaration.states),
    )


def needs_time(scenario: Scenario) -> bool:
    """Return whether command delays are in nanoseconds instead of whole ticks."""
    return (
        not PLANTS[scenario.plant.kind].acts_in_steps
        or scenario.loop.trigger == "timer"
        or scenario.has_action("pose_travel", "lose_command", "command_travel", "repeat")
    )


def list_acting(scenario: Scenario) -> tuple[Effect, ...]:
    """Return the effects that act in a scenario."""
    return tuple(effect for effect in EFFECTS if effect.actions and effect.acts(scenario))


def bound_rows(scenario: Scenario, plant: Plant) -> tuple[int, int]:
    """Return the largest possible numbers of ticks and of samples in a run."""
    ticks = round(scenario.max_duration_s * 1e9) // plant.period_ns + 1
    period_s = scenario.loop.period_s
    return ticks, ticks if period_s is None else int(scenario.max_duration_s / period_s) + 2
