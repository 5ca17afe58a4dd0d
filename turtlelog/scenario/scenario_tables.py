"""The tables of a scenario that are derived from its parts: keys of effects and of the plant."""

import dataclasses
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal, cast

from turtlelog.effects import EFFECTS
from turtlelog.errors import ParameterError
from turtlelog.parts import ABSENT_BY_DEFAULT, Plant
from turtlelog.plants.kinds import PLANTS
from turtlelog.plants.turtlesim import TURTLESIM

_OPTIONS: Final[Any] = {"frozen": True, "slots": True, "kw_only": True}


def _build_table(name: str, table: str, meaning: str) -> type[Any]:
    """Return the dataclass of a table: the keys that files always contain, then the others."""
    keys = [
        one for part in EFFECTS if table in part.tables for one in list_keys(part.tables[table])
    ]
    keys.sort(key=lambda one: ABSENT_BY_DEFAULT.keys() <= one.metadata.keys())
    fields = [
        (one.name, one.type, dataclasses.field(default=one.default, metadata=one.metadata))
        for one in keys
    ]
    made = dataclasses.make_dataclass(name, fields, **_OPTIONS)
    made.__doc__, made.__module__ = meaning, __name__
    return made


def list_keys(kind: type) -> tuple[dataclasses.Field[Any], ...]:
    """Return the fields of a dataclass of keys."""
    return dataclasses.fields(kind)


class _PlantTable:
    """The plant: the table `[plant]`.

    The table has the keys of all kinds of plant. A missing key of the plant's own kind gets its
    default, or stays None if files omit this key. A key of another kind is an error.
    """

    __slots__ = ()

    kind: str

    def __post_init__(self) -> None:
        fields = list_keys(PLANTS[self.kind].Keys)
        own = {
            one.name: None if ABSENT_BY_DEFAULT.keys() <= one.metadata.keys() else one.default
            for one in fields
        }
        for one in list_keys(type(self)):
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
        given = {one.name: getattr(self, one.name) for one in list_keys(kind)}
        return kind(**{name: value for name, value in given.items() if value is not None})

    @property
    def facts(self) -> Plant:
        """The properties of the plant that the loop needs."""
        return PLANTS[self.kind].find_facts(self.keys)


def _build_plant_table() -> type[Any]:
    kinds: Any = Literal.__getitem__(tuple(PLANTS))
    fields: dict[str, Any] = {
        "kind": ("kind", kinds, dataclasses.field(default=TURTLESIM.name)),
    }
    for part in PLANTS.values():
        for one in list_keys(part.Keys):
            default = dataclasses.field(default=None, metadata=one.metadata)
            kind = cast("type[Any]", one.type)
            fields.setdefault(one.name, (one.name, kind | None, default))
    made = dataclasses.make_dataclass(
        "PlantChoice",
        fields.values(),
        bases=(_PlantTable,),
        **_OPTIONS,
    )
    made.__doc__, made.__module__ = _PlantTable.__doc__, __name__
    return made


if TYPE_CHECKING:

    class _Table:
        """A table whose keys are derived from the parts."""

        __dataclass_fields__: ClassVar[dict[str, Any]]

        def __init__(self, **values: Any) -> None: ...

        def __getattr__(self, name: str) -> Any: ...

    class LoopSettings(_Table):
        """Settings between plant and controller."""

    class Limits(_Table):
        """Limits of the controller's commands."""

    class Sensing(_Table):
        """Effects between the plant's pose and the pose that the controller reads."""

    class Shaping(_Table):
        """Effects on the wanted commands before the limits."""

    class Disturbance(_Table):
        """Disturbances of the plant."""

    class PlantChoice(_Table):
        """Choice of the plant and its parameters."""

        kind: str
        facts: Plant

else:
    LoopSettings = _build_table(
        "LoopSettings", "loop", "What lies between plant and controller: the table `[loop]`."
    )
    Limits = _build_table(
        "Limits", "limits", "Where the controller bounds its commands: the table `[limits]`."
    )
    Sensing = _build_table(
        "Sensing",
        "sensing",
        "What lies between the plant's pose and the pose that is read: the table `[sensing]`.",
    )
    Shaping = _build_table(
        "Shaping",
        "shaping",
        "What becomes of the wanted commands before the limits: the table `[shaping]`.",
    )
    Disturbance = _build_table(
        "Disturbance",
        "disturbance",
        "What is added to the rates of the plant, after its lag: the table `[disturbance]`.",
    )
    PlantChoice = _build_plant_table()
