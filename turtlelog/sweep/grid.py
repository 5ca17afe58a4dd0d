"""What a key is swept over, as text: `A:B`, `A:B:STEP`, or values separated by commas."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, Final, overload

from turtlelog.errors import ScenarioError, SweepError, quote_name
from turtlelog.scenario import parse_assignments
from turtlelog.sweep.result_table import choose_type

_NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,2})?"
_RANGE: Final = re.compile(rf"({_NUMBER})\s*:\s*({_NUMBER})(?:\s*:\s*({_NUMBER}))?")
MOST_ROWS: Final = 100_000_000
"""Rows of one table: six hours of one core where compiled code takes 0.2 ms for each, and a file of
some gigabytes. What stands in memory of a sweep hardly grows with them."""

_EXPECTED: Final = "KEY=A:B, KEY=A:B:STEP or KEY=VALUE,VALUE"


@dataclass(frozen=True, slots=True)
class EqualSteps(Sequence[float]):
    """The numbers from one to another in equal steps, both included; none is kept in memory.

    Each is the double nearest to the decimal number, as if it had been typed.
    """

    first: Fraction
    step: Fraction
    length: int
    is_whole: bool

    def __len__(self) -> int:
        return self.length

    @overload
    def __getitem__(self, place: int) -> float: ...
    @overload
    def __getitem__(self, place: slice) -> Sequence[float]: ...
    def __getitem__(self, place: int | slice) -> float | Sequence[float]:
        if isinstance(place, slice):
            return [self[number] for number in range(*place.indices(self.length))]
        first, step, number = self.first, self.step, range(self.length)[place]
        # In whole numbers, which is what fractions do, but ten times as fast.
        above = first.numerator * step.denominator + step.numerator * first.denominator * number
        below = first.denominator * step.denominator
        return above // below if self.is_whole else above / below


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyValues:
    """A key and what it is swept over.

    Attributes:
        key: Dotted, of a scenario.
        text: As typed, without the key.
        values: Of one kind: numbers, texts, or truths.
        is_open: Whether it is `A:B`, of which a sample may draw every number between.
    """

    key: str
    text: str
    values: Sequence[Any]
    is_open: bool = False

    def as_real(self) -> "KeyValues":
        """Return the same with its numbers as floats."""
        if isinstance(self.values, EqualSteps):
            return replace(self, values=replace(self.values, is_whole=False))
        return replace(self, values=[float(value) for value in self.values])


def parse_key_values(text: str, *, source: str, is_sampled: bool = False) -> KeyValues:
    """Return what a text such as `law.kp_linear=0.5:12:0.25` says.

    Args:
        text: Key, equals sign, and a range, of which both ends belong to it, or values.
        source: Begins error lines.
        is_sampled: Whether any number of `A:B` will do, so that no steps need lead to B.

    Raises:
        SweepError: Where it says nothing to sweep over.
    """
    key, equals, rest = (part.strip() for part in text.partition("="))
    if not equals or not all(key.split(".")) or not rest:
        raise SweepError(f"{source}: expected {_EXPECTED}, found {text[:60]!r}")
    place = f"{source}: {key}"
    found = _RANGE.fullmatch(rest)
    if found is None and _is_meant_as_range(rest):
        wrong = next(end for end in rest.split(":") if not re.fullmatch(_NUMBER, end.strip()))
        what = f"{quote_name(wrong)} is not a finite number" if wrong else "a bound is missing"
        raise SweepError(f"{place}={rest[:60]}: {what}; a range is A:B or A:B:STEP")
    if found is not None:
        is_any = is_sampled and found[3] is None and not _are_whole(*found.groups())
        steps = (_span if is_any else _build_steps)(*found.groups(), place=place)
        return KeyValues(key=key, text=rest, values=steps, is_open=found[3] is None)
    values = [_parse_value(one.strip(), place=place) for one in rest.split(",")]
    if choose_type(values) == "text" and not all(isinstance(one, str) for one in values):
        raise SweepError(f"{place}: expected numbers, texts or truths alone, found {rest[:60]!r}")
    return KeyValues(key=key, text=rest, values=values)


def _is_meant_as_range(text: str) -> bool:
    """Return whether one end is a number at least: path.py:Class is a value."""
    words = [word.strip() for word in text.split(":")]
    is_number = re.compile(rf"{_NUMBER}|[-+]?(?:nan|inf)", re.IGNORECASE).fullmatch
    return 1 < len(words) < 4 and any(map(is_number, words))


def _build_steps(first: str, last: str, step: str | None, *, place: str) -> EqualSteps:
    low, high, width = Fraction(first), Fraction(last), Fraction(step or 1)
    if not width:
        raise SweepError(f"{place}: expected a step other than 0, found {step}")
    steps, rest = divmod(high - low, width)
    if steps < 0:
        raise SweepError(f"{place}: no value from {first} to {last}")
    if steps >= MOST_ROWS:
        raise SweepError(f"{place}: expected at most {MOST_ROWS:,} values, found {steps + 1:,}")
    if rest:
        near, beyond = (f"{float(low + width * count):.12g}" for count in (steps, steps + 1))
        step = step or "1"
        raise SweepError(
            f"{place}: expected steps of {step} that lead from {first} to {last}, found that they"
            f" lead to {near}: {first}:{near}:{step} or {first}:{beyond}:{step}"
        )
    return EqualSteps(low, width, int(steps) + 1, _are_whole(first, last, step))


def _span(first: str, last: str, _: str | None, *, place: str) -> EqualSteps:
    """Return both ends of a range."""
    width = Fraction(last) - Fraction(first)
    if width < 0:
        raise SweepError(f"{place}: expected a range from low to high, found {first}:{last}")
    return EqualSteps(Fraction(first), width, 2, is_whole=False)


def _are_whole(*texts: str | None) -> bool:
    return not any(sign in text for text in texts if text for sign in ".eE")


def _parse_value(text: str, *, place: str) -> Any:
    try:
        (value,) = parse_assignments([f"value={text}"], source=place).values()
    except ScenarioError as err:
        raise SweepError(f"{place}: a value is missing between commas") from err
    return value
