"""Scenario: everything that determines a run, frozen and typed."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, make_dataclass
from functools import cache, partial
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal, TypeVar, cast

from msgspec import Meta

from turtlelog.display import fit_line, format_folded, format_html, format_notebook
from turtlelog.effects import EFFECTS
from turtlelog.errors import ParameterError, ScenarioError
from turtlelog.laws import ABSENT_BY_DEFAULT, SequentialPParameters
from turtlelog.parts import Effect, Place, Plant, absent
from turtlelog.plants import PLANTS
from turtlelog.plants.turtlesim import SPAWN_XY_M, TURTLESIM
from turtlelog.run.paths import Path
from turtlelog.scenario.presets import DEFAULT_LAW

_OPTIONS: Final[Any] = {"frozen": True, "slots": True, "kw_only": True}


class _Table:
    """A table whose keys are those of parts."""

    if TYPE_CHECKING:
        __dataclass_fields__: ClassVar[dict[str, Any]]

        def __init__(self, **values: Any) -> None: ...

        def __getattr__(self, name: str) -> Any: ...


_AnyTable = TypeVar("_AnyTable", bound=_Table)


def _take_keys(table: str) -> Callable[[type[_AnyTable]], type[_AnyTable]]:
    """Return the class decorator that makes a dataclass of the effects' keys in a table."""
    # The keys that files always contain come first.
    keys = [one for part in EFFECTS if table in part.tables for one in fields(part.tables[table])]
    keys.sort(key=lambda one: ABSENT_BY_DEFAULT.keys() <= one.metadata.keys())
    found = [
        (one.name, one.type, field(default=one.default, metadata=one.metadata)) for one in keys
    ]
    return partial(_build_table, keys=found)


def _take_plant_keys(kind: type[_AnyTable]) -> type[_AnyTable]:
    """Return a dataclass of the keys of all kinds of plant."""
    kinds: Any = Literal.__getitem__(tuple(PLANTS))
    keys: dict[str, Any] = {"kind": ("kind", kinds, field(default=TURTLESIM.name))}
    for part in PLANTS.values():
        for one in fields(part.Keys):
            default = field(default=None, metadata=one.metadata)
            keys.setdefault(one.name, (one.name, cast("type[Any]", one.type) | None, default))
    return _build_table(kind, keys.values())


def _build_table(kind: type[_AnyTable], keys: Iterable[tuple[Any, ...]]) -> type[_AnyTable]:
    made: Any = make_dataclass(kind.__name__, keys, bases=(kind,), **_OPTIONS)
    made.__doc__, made.__module__ = kind.__doc__, __name__
    return cast("type[_AnyTable]", made)


@_take_keys("loop")
class LoopSettings(_Table):
    """Settings between plant and controller: the table `[loop]`."""


@_take_keys("limits")
class Limits(_Table):
    """Limits of the controller's commands: the table `[limits]`."""


@_take_keys("sensing")
class Sensing(_Table):
    """Effects between the plant's pose and the pose that is read: the table `[sensing]`."""


@_take_keys("shaping")
class Shaping(_Table):
    """Effects on the wanted commands before the limits: the table `[shaping]`."""


@_take_keys("disturbance")
class Disturbance(_Table):
    """Disturbances of the plant's rates, after its lag: the table `[disturbance]`."""


@_take_plant_keys
class PlantChoice(_Table):
    """The plant: the table `[plant]`.

    The table has the keys of all kinds of plant. A missing key of the plant's own kind gets its
    default, or stays None if files omit this key. A key of another kind is an error.
    """

    kind: str

    def __post_init__(self) -> None:
        own = {
            one.name: None if ABSENT_BY_DEFAULT.keys() <= one.metadata.keys() else one.default
            for one in fields(PLANTS[self.kind].Keys)
        }
        for one in fields(self):
            value = getattr(self, one.name)
            if one.name in own and value is None:
                object.__setattr__(self, one.name, own[one.name])
            elif one.name != "kind" and one.name not in own and value is not None:
                expected = f"none, for kind is {self.kind}"
                raise ParameterError(f"{one.name}: expected {expected}, found {value!r}")

    @property
    def keys(self) -> Any:
        """The keys of the plant's kind."""
        kind = PLANTS[self.kind].Keys
        given = {one.name: getattr(self, one.name) for one in fields(kind)}
        return kind(**{name: value for name, value in given.items() if value is not None})

    @property
    def facts(self) -> Plant:
        """The properties of the plant that the loop needs."""
        return PLANTS[self.kind].find_facts(self.keys)


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
        every = format_folded(f"All {len(keys)} keys", format_html([*keys.items()]))
        goal = f"to ({self.goal.x_m:g}, {self.goal.y_m:g}) m"
        return format_notebook(f"{self.name}: {self.law.kind} {goal}", format_html(law), every)


def require_scenario(scenario: object) -> None:
    """Raise a ScenarioError for an argument that is not a scenario."""
    if not isinstance(scenario, Scenario):
        advice = "load_scenario returns the one of a preset or file"
        raise ScenarioError(f"scenario: expected a Scenario, found {scenario!r:.60}; {advice}")
