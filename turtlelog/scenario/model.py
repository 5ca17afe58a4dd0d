"""Scenario: everything that determines a run, frozen and typed."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Annotated, Any, Literal

from msgspec import Meta

from turtlelog.display import fit_line, format_answer, format_details, format_html
from turtlelog.effects import EFFECTS
from turtlelog.errors import ScenarioError
from turtlelog.laws import ABSENT_BY_DEFAULT, SequentialPParameters
from turtlelog.parts import Effect, Place, absent
from turtlelog.plants.turtlesim import SPAWN_XY_M
from turtlelog.run.paths import Path
from turtlelog.scenario.dotted_keys import DEFAULT_LAW
from turtlelog.scenario.scenario_tables import (
    Disturbance,
    Limits,
    LoopSettings,
    PlantChoice,
    Sensing,
    Shaping,
)

# No more than a turn either way: more is most likely meant in degrees.
Heading = Annotated[float, Meta(ge=-2.0 * math.pi, le=2.0 * math.pi)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """Start pose of the turtle.

    Attributes:
        x_m: x in the world frame [m].
        y_m: y in the world frame [m].
        heading_rad: Heading, counter-clockwise from +x [rad].
        precision: `float32`: rounded to 32 bits, like a spawn pose; `float64`: unrounded, for a
            turtle that has moved before.
    """

    x_m: float = SPAWN_XY_M
    y_m: float = SPAWN_XY_M
    heading_rad: Heading = 0.0
    precision: Literal["float32", "float64"] = field(default="float32", metadata=ABSENT_BY_DEFAULT)


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """Goal of the turtle.

    Attributes:
        x_m: x in the world frame [m].
        y_m: y in the world frame [m].
        heading_rad: Final heading [rad]; None for any heading.
    """

    x_m: float = 2.0
    y_m: float = 10.0
    heading_rad: Heading | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class LawTable:
    """The keys of a law whose code has not been loaded yet; `resolve_scenario` loads it.

    Attributes:
        values: Values as written, without `kind`.
        sources: Origins of the values for error lines; the first origin named the law.
        is_trusted: Whether the user named the law. A law that only a recording names is not loaded.
    """

    values: Mapping[str, Any]
    sources: tuple[str, ...] = field(default=("scenario",), compare=False)
    is_trusted: bool = field(default=True, compare=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class LawChoice:
    """A law and its parameters.

    Attributes:
        kind: A built-in kind, `path.py:Class` or `package.module:Class`.
        parameters: Parameters in the law's own frozen dataclass; a `LawTable` until its code is
            loaded.
    """

    kind: str = DEFAULT_LAW
    parameters: Any = field(default_factory=SequentialPParameters)


@cache
def _list_at(place: Place) -> tuple[Effect, ...]:
    """Return the effects that may act at a place."""
    return tuple(effect for effect in EFFECTS if place in effect.actions)


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """Everything that determines a run. The defaults have no implementation effects.

    Attributes:
        name: Short name for tables and legends.
        max_duration_s: Simulated time after which the run is ended [s].
        seed: Seed of the random numbers of effects.
        start: Start pose of the turtle.
        goal: Goal of the turtle.
        law: Control law.
        limits: Limits at which commands are clipped.
        loop: Queues, delays and precision.
        path: Path for a law that tracks a path; None if there is none.
        plant: Plant that is driven.
        disturbance: Disturbances of the plant.
        sensing: Effects of the sensing of poses.
        shaping: Shaping of the law's commands before the limits.
    """

    name: str = "textbook"
    max_duration_s: Annotated[float, Meta(gt=0.0, le=1e6)] = 60.0
    seed: Annotated[int, Meta(ge=0)] = 0
    start: Start = field(default_factory=Start)
    goal: Target = field(default_factory=Target)
    law: LawChoice = field(default_factory=LawChoice)
    limits: Limits = field(default_factory=Limits)
    loop: LoopSettings = field(default_factory=LoopSettings)
    path: Path | None = None
    plant: PlantChoice = absent(PlantChoice())
    disturbance: Disturbance = absent(Disturbance())
    sensing: Sensing = absent(Sensing())
    shaping: Shaping = absent(Shaping())

    def has_action(self, *places: Place) -> bool:
        """Whether an effect acts at one of the places."""
        return any(effect.acts_at(place, self) for place in places for effect in _list_at(place))

    def __repr__(self) -> str:
        goal = f"goal ({self.goal.x_m:g}, {self.goal.y_m:g}) m"
        return fit_line(f"<Scenario {self.name}: {self.law.kind}, {goal}>")

    def _repr_html_(self) -> str:
        from turtlelog.scenario.table_conversion import flatten_scenario  # which needs this file

        keys = flatten_scenario(self)
        law = [(key, value) for key, value in keys.items() if key.startswith("law.")]
        every = format_details(f"All {len(keys)} keys", format_html([*keys.items()]))
        goal = f"to ({self.goal.x_m:g}, {self.goal.y_m:g}) m"
        return format_answer(f"{self.name}: {self.law.kind} {goal}", format_html(law), every)


def require_scenario(scenario: object) -> None:
    """Raise an error for an argument that is not a scenario.

    Raises:
        ScenarioError: If the argument is not a scenario. The message says which function returns a
            scenario.
    """
    if not isinstance(scenario, Scenario):
        advice = "load_scenario returns the one of a preset or file"
        raise ScenarioError(f"scenario: expected a Scenario, found {scenario!r:.60}; {advice}")
