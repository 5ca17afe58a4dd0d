"""Gain schedule: gains from a table over the distance to the goal, or over the heading error."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Final, Literal, NoReturn

from turtlelog.errors import ParameterError

DISTANCE: Final = "distance"

MOST_ENTRIES: Final = 1000
"""Largest number of entries of a schedule, whose table is part of every recording and scenario
text. 1,000 entries are one per 16 mm of the longest path in turtlesim's world, and 10 KB of text
for each gain."""

_POSITIVE: Final = ("kp_angular", "kp_linear")
"""Gains that must be above 0, like the constant ones; other gains may be 0."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GainSchedule:
    """Gain schedule of a sequential law. Gains that are left out stay constant.

    Gains are linearly interpolated between entries. Outside the table, the first or last entry
    holds.

    Attributes:
        over: Variable of the gains: the `distance` from the pose to the goal [m], or the magnitude
            of the `heading_error` [rad].
        at: Distances or heading errors of the entries, rising, >= 0 [m or rad].
        kp_angular: Gain of the heading loops at each entry, > 0 [1/s].
        kp_linear: Gain of the position loop at each entry, > 0 [1/s].

    Raises:
        ParameterError: One line with the key, what was expected and what was found.
    """

    over: Literal["distance", "heading_error"]
    at: tuple[float, ...]
    kp_angular: tuple[float, ...] | None = None
    kp_linear: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if self.over not in {DISTANCE, "heading_error"}:
            _refuse("over", "distance or heading_error", self.over)
        for name in ("at", *self.gains):
            object.__setattr__(self, name, _read_numbers(name, getattr(self, name)))
        self._require_places()
        for name in self.gains:
            if len(getattr(self, name)) != len(self.at):
                entries = f"{len(self.at)} entries, one for each of at"
                _refuse(name, entries, len(getattr(self, name)))
        if not self.gains:
            known = " or ".join(_list_gains(self))
            raise ParameterError(f"over: expected {known} beside it, found no gain")

    def _require_places(self) -> None:
        if not 2 <= len(self.at) <= MOST_ENTRIES:
            _refuse("at", f"2 to {MOST_ENTRIES} entries", len(self.at))
        for low, high in zip(self.at[:-1], self.at[1:], strict=True):
            if not low < high:
                _refuse("at", "rising numbers", f"{high:g} after {low:g}")

    @property
    def gains(self) -> tuple[str, ...]:
        """Names of the gains that are scheduled."""
        return tuple(name for name in _list_gains(self) if getattr(self, name) is not None)


@dataclass(frozen=True, slots=True, kw_only=True)
class PIDGainSchedule(GainSchedule):
    """Gain schedule of `sequential-pid`. Gains that are left out stay constant.

    Attributes:
        ki_angular: Integral gain of the heading loops at each entry of `at`, >= 0 [1/s^2].
        kd_angular: Derivative gain of the heading loops, >= 0 [1].
        ki_linear: Integral gain of the position loop, >= 0 [1/s^2].
        kd_linear: Derivative gain of the position loop, >= 0 [1].
    """

    ki_angular: tuple[float, ...] | None = None
    kd_angular: tuple[float, ...] | None = None
    ki_linear: tuple[float, ...] | None = None
    kd_linear: tuple[float, ...] | None = None


def _list_gains(schedule: GainSchedule) -> list[str]:
    return [field.name for field in fields(schedule) if field.name not in {"over", "at"}]


def _read_numbers(name: str, values: Any) -> tuple[float, ...]:
    """Return numbers as floats. Refuse negative numbers, and proportional gains of 0."""
    if isinstance(values, str) or not isinstance(values, Sequence):
        _refuse(name, "a list of numbers", values)
    least = "> 0" if name in _POSITIVE else ">= 0"
    for value in values:
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not (is_number and math.isfinite(value) and value >= 0):
            _refuse(name, f"finite numbers {least}", value)
        if value == 0 and name in _POSITIVE:
            _refuse(name, f"finite numbers {least}", value)
    return tuple(map(float, values))


def _refuse(name: str, expected: str, found: object) -> NoReturn:
    raise ParameterError(f"{name}: expected {expected}, found {found!s:.60}")
