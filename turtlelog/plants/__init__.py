"""Plants, one per file, and the plant of a run."""

import dataclasses
from collections.abc import Mapping
from typing import Final

from turtlelog.parts import Plant as Plant, PlantPart as PlantPart, load_parts
from turtlelog.plants.turtlesim import TURTLESIM as TURTLESIM, Turtle as Turtle
from turtlelog.run import Run

_FILES: Final = (
    "turtlesim",
    "lagged",
)

PLANTS: Final[Mapping[str, PlantPart]] = {part.name: part for part in load_parts(__name__, _FILES)}
"""The `PART` of each file of plants, by kind."""


def find_plant(run: Run) -> Plant:
    """Return the plant of a run. The plant of a recorded robot is unknown."""
    return read_plant(run.parameters)


def read_plant(parameters: Mapping[str, object]) -> Plant:
    """Return the plant from the parameters of a run or scenario. Default: turtlesim."""
    part = PLANTS.get(str(parameters.get("plant.kind")))
    names = [] if part is None else [field.name for field in dataclasses.fields(part.Keys)]
    given = {name: parameters.get(f"plant.{name}") for name in names}
    numbers = {key: float(one) for key, one in given.items() if isinstance(one, int | float)}
    if part is None or ("period_s" in given and not numbers.get("period_s")):
        return TURTLESIM
    facts = part.find_facts(part.Keys(**numbers))
    return dataclasses.replace(facts, period_ns=max(facts.period_ns, 1))
