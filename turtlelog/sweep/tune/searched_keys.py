"""The keys of a scenario that are searched, each between two bounds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from turtlelog.errors import TuneError
from turtlelog.sweep.grid import EqualSteps, parse_key_values


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchedKey:
    """A key and where its best value is looked for.

    Attributes:
        key: Dotted, of a scenario.
        low: Least value.
        high: Largest value.
        is_whole: Whether it counts, and takes whole numbers alone.
        steps: The values that it may have; empty where it may have any.
    """

    key: str
    low: float
    high: float
    is_whole: bool = False
    steps: Sequence[float] = ()

    def round(self, value: float) -> float | int:
        """Return the nearest value that the key may have."""
        value = min(max(value, self.low), self.high)
        if self.steps:
            return min(self.steps, key=lambda step: abs(step - value))
        return round(value) if self.is_whole else float(value)


_MOST_STEPS: Final = 10_000
"""Values of a key with a step: each candidate looks for the nearest of them."""


def parse_searched_keys(
    texts: Sequence[str], parameters: Mapping[str, Any], *, source: str = "--grid"
) -> tuple[SearchedKey, ...]:
    """Return what texts such as `law.kp_linear=0.5:12` say.

    Args:
        texts: A key, an equals sign and its bounds, each.
        parameters: Of the scenario that varies, by key: they tell which keys count.
        source: Begins error lines.

    Raises:
        SweepError: Where one cannot be read.
        TuneError: Where there is none, a key stands twice, or has no range.
    """
    if not texts:
        raise TuneError(f"{source}: expected a key and its bounds, as in law.kp_linear=0.5:12")
    found: dict[str, SearchedKey] = {}
    for text in texts:
        one = parse_key_values(text, source=source, is_sampled=True)
        steps = one.values
        if not isinstance(steps, EqualSteps) or (not one.is_open and len(steps) > _MOST_STEPS):
            expected = "two bounds and perhaps a step, as in 0.5:12 or 0.5:12:0.5"
            raise TuneError(f"{source}: {one.key}: expected {expected}, found {one.text[:60]!r}")
        if one.key in found:
            raise TuneError(f"{source}: {one.key}: expected each key once, found it twice")
        low, high = steps[0], steps[-1]
        if not low < high:
            raise TuneError(f"{source}: {one.key}: expected a range, found {one.text[:60]!r}")
        known = parameters.get(one.key)
        if isinstance(known, bool) or not isinstance(known, int | float | None):
            expected = "a key whose values are numbers"
            raise TuneError(f"{source}: {one.key}: expected {expected}, found {known!r}")
        is_whole = isinstance(known, int) and not isinstance(known, bool)
        if is_whole and not (float(low).is_integer() and float(high).is_integer()):
            expected = "whole bounds of a key that counts"
            raise TuneError(f"{source}: {one.key}: expected {expected}, found {one.text[:60]!r}")
        found[one.key] = SearchedKey(
            key=one.key,
            low=low,
            high=high,
            is_whole=is_whole,
            steps=() if one.is_open else tuple(steps),
        )
    return tuple(found.values())
