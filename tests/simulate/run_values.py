"""What a run holds, to be compared to the last bit."""

import dataclasses
from typing import Any

import numpy as np

from turtlelog.run import Run


def list_values(run: Run) -> dict[str, Any]:
    """Return all that a run holds, its arrays as bytes."""
    found: dict[str, Any] = {
        field.name: getattr(run, field.name)
        for field in dataclasses.fields(run)
        if field.name not in {"poses", "commands", "samples"}
    }
    for part in ("poses", "commands", "samples"):
        for field in dataclasses.fields(getattr(run, part)):
            value = getattr(getattr(run, part), field.name)
            found[f"{part}.{field.name}"] = value if value is None else describe(value)
    return found


def describe(value: np.ndarray[Any, Any]) -> tuple[Any, ...]:
    return value.shape, value.dtype.str, value.flags.c_contiguous, value.tobytes()
