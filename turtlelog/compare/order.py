"""The order in which several runs stand in one table or picture, however they were named."""

import math
import re
from collections.abc import Sequence
from typing import TypeVar

from turtlelog.compare.summary import RunSummary
from turtlelog.run import Run

AnyRun = TypeVar("AnyRun", Run, RunSummary)


def order_by_gain(runs: Sequence[AnyRun]) -> tuple[AnyRun, ...]:
    """Return runs in rising order of the gains that their laws declare, that of the speed first.

    Runs of the same gains stand in the natural order of their names (`run2` before `run10`), those
    of one name as they were; a run without gains comes after those that have them.
    """
    return tuple(sorted(runs, key=lambda run: (_get_gains(run), _split_numbers(run.name))))


def _get_gains(run: Run | RunSummary) -> tuple[float, ...]:
    gains = [run.parameters.get(key) for key in run.declaration.list_gains()]
    known = [float(gain) if isinstance(gain, int | float) else math.inf for gain in gains]
    return tuple(known) if known else (math.inf,)


def _split_numbers(name: str) -> list[str | tuple[int, str]]:
    """Return text and numbers by turns, beginning with text, so that names can be compared.

    A number is how many digits it has and these: Python reads no int of many thousand.
    """
    parts = re.split(r"0*([0-9]+)", name)
    return [(len(part), part) if index % 2 else part for index, part in enumerate(parts)]
