"""The rows of a sweep: the keys and their values by row number, and the scenario of a row."""

import json
import math
import re
from collections.abc import Container, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any, Final, overload

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import ScenarioError, SweepError, quote_name
from turtlelog.scenario import Scenario, override_scenario, parse_assignments
from turtlelog.sweep.result_table import ColumnType, choose_type

MOST_DRAWN: Final = 10_000_000
"""Largest number of rows of a sample. A sample is drawn at once and takes 80 MB for each key."""

KP: Final = "kp"  # name that stands for all gains of the law together, as in `--kp`

_BELOW_1: Final = math.nextafter(1.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sampling:
    """Settings of rows that are sampled at random, instead of all combinations.

    With `is_latin`, this is Latin hypercube sampling.
    """

    count: int  # number of rows
    seed: int = 0  # seed of the random numbers
    is_latin: bool = False  # whether each of `count` equal parts of a key's range gets one value

    def __post_init__(self) -> None:
        for option, found, least in (("--sample", self.count, 1), ("--seed", self.seed, 0)):
            if found < least:
                raise SweepError(f"{option}: expected at least {least}, found {found}")
        if self.count > MOST_DRAWN:
            most = f"at most {MOST_DRAWN:,} rows"
            raise SweepError(f"--sample: expected {most}, found {self.count:,}")

    def draw(self, width: int) -> NDArray[np.float64]:
        """Return random fractions in [0, 1): one row per sample, one column per axis."""
        generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(self.seed)))
        drawn = generator.random((self.count, width))
        if not self.is_latin:
            return drawn
        order = np.argsort(generator.random(drawn.shape), axis=0, kind="stable")
        return np.minimum((order + drawn) / self.count, _BELOW_1)


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyValues:
    """A key and its values in a sweep."""

    key: str  # dotted scenario key
    text: str  # values as typed, without the key
    values: Sequence[Any]  # values of one kind: numbers, texts, or truth values
    is_open: bool = False  # whether the values are `A:B`, in which a sample may have any number

    def as_real(self) -> "KeyValues":
        """Return a copy with numbers as floats."""
        if isinstance(self.values, EqualSteps):
            return replace(self, values=replace(self.values, is_whole=False))
        return replace(self, values=[float(value) for value in self.values])


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepPlan:
    """The rows of a sweep.

    The rows are a random sample, or all combinations of `grid` and the steps of `zipped`, with the
    last key changing fastest.
    """

    grid: tuple[KeyValues, ...]  # keys that vary independently
    zipped: tuple[KeyValues, ...] = ()  # keys that vary together, as the last axis of the grid
    sampling: Sampling | None = None  # random sampling of rows. None: all combinations
    _axes: tuple[tuple[KeyValues, ...], ...] = field(init=False, compare=False, repr=False)
    _drawn: NDArray[np.float64] | None = field(init=False, compare=False, repr=False)
    _strides: tuple[int, ...] = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        axes = (*((one,) for one in self.grid), *((self.zipped,) if self.zipped else ()))
        object.__setattr__(self, "_axes", axes)
        _require_sound(self)
        drawn = None if self.sampling is None else self.sampling.draw(len(axes))
        object.__setattr__(self, "_drawn", drawn)
        lengths = [len(axis[0].values) for axis in axes]
        strides = tuple(math.prod(lengths[place + 1 :]) for place in range(len(axes)))
        object.__setattr__(self, "_strides", strides)

    @property
    def keys(self) -> tuple[str, ...]:
        """The varied keys, in the order of their columns."""
        return tuple(one.key for one in (*self.grid, *self.zipped))

    @property
    def row_count(self) -> int:
        """Number of rows."""
        if self.sampling is not None:
            return self.sampling.count
        return math.prod(len(axis[0].values) for axis in self._axes)

    def find_values(self, row: int) -> tuple[Any, ...]:
        """Return the values of a row, in the order of `keys`."""
        return tuple(self.list_values(range(row, row + 1), key)[0] for key in self.keys)

    def list_values(self, rows: range, key: str) -> list[Any]:
        """Return the values of a key in a segment of rows."""
        number, axis, one = self._find(key)
        if self._drawn is not None:
            shares = self._drawn[rows.start : rows.stop, number].tolist()
            values, last = one.values, len(one.values) - 1
            if one.is_open and isinstance(values, EqualSteps) and not values.is_whole:
                width = values[-1] - values[0]
                return [min(values[0] + width * share, values[-1]) for share in shares]
            return [values[min(int(share * len(values)), last)] for share in shares]
        places = np.arange(rows.start, rows.stop) // self._strides[number] % len(axis[0].values)
        different, which = np.unique(places, return_inverse=True)
        found = [one.values[place] for place in different.tolist()]
        return [found[place] for place in which.tolist()]

    def find_type(self, key: str) -> ColumnType:
        """Return the type of the values of a key."""
        values = self._find(key)[2].values
        return choose_type((values[0], values[-1]) if isinstance(values, EqualSteps) else values)

    def _find(self, key: str) -> tuple[int, tuple[KeyValues, ...], KeyValues]:
        """Return the index of a key's axis, the axis, and the values of the key."""
        places = ((number, axis, one) for number, axis in enumerate(self._axes) for one in axis)
        return next(found for found in places if found[2].key == key)

    def list_probes(self) -> tuple[int, ...]:
        """Return the numbers of representative rows: the first, a middle and the last row."""
        return tuple(dict.fromkeys((0, self.row_count // 2, self.row_count - 1)))

    def with_reals(self, keys: Container[str]) -> "SweepPlan":
        """Return the plan with integers converted to floats for keys that have float values."""
        return replace(
            self,
            grid=tuple(one.as_real() if one.key in keys else one for one in self.grid),
            zipped=tuple(one.as_real() if one.key in keys else one for one in self.zipped),
        )

    def spread_gains(self, gains: Sequence[str]) -> "SweepPlan":
        """Return the plan with the key `kp` replaced by the law's gains, which vary together.

        SweepError if the law declares no gain, or other keys already vary together.
        """
        kp = next((one for one in self.grid if one.key == KP), None)
        if kp is None:
            return self
        if not gains:
            raise SweepError("--grid: kp: the law declares no gain; vary its keys by their names")
        if self.zipped:
            raise SweepError(
                "--zip: leave it out beside --grid kp, which varies"
                f" {' and '.join(gains)} together; or name these in --zip"
            )
        others = tuple(one for one in self.grid if one is not kp)
        return replace(self, grid=others, zipped=tuple(replace(kp, key=key) for key in gains))

    def describe(self) -> str:
        """Return the plan as JSON for file metadata."""
        texts = [{one.key: one.text for one in axes} for axes in (self.grid, self.zipped)]
        sample = None
        if (drawn := self.sampling) is not None:
            sample = {"count": drawn.count, "seed": drawn.seed, "latin": drawn.is_latin}
        return json.dumps({"grid": texts[0], "zip": texts[1], "sample": sample})


def build_plan(
    grid: Sequence[str], zipped: Sequence[str] = (), sampling: Sampling | None = None
) -> SweepPlan:
    """Return the plan from texts such as `law.kp_linear=0.5:12:0.25`; SweepError for others."""
    is_sampled = sampling is not None
    own = [parse_key_values(text, source="--grid", is_sampled=is_sampled) for text in grid]
    together = [parse_key_values(text, source="--zip") for text in zipped]
    return SweepPlan(grid=tuple(own), zipped=tuple(together), sampling=sampling)


def _require_sound(plan: SweepPlan) -> None:
    keys = plan.keys
    if not keys:
        raise SweepError("--grid: name a key to vary, for example --grid law.kp_linear=1:12")
    for number, key in enumerate(keys):
        if key in keys[:number]:
            raise SweepError(f"{key}: expected each key once, found it twice")
    counts = {len(one.values) for one in plan.zipped}
    if len(counts) > 1:
        found = ", ".join(f"{len(one.values)} of {one.key}" for one in plan.zipped)
        raise SweepError(f"--zip: expected as many values of each key, found {found}")
    if plan.row_count > MOST_ROWS:
        raise SweepError(
            f"--grid: expected at most {MOST_ROWS:,} rows, found {plan.row_count:,}; --sample draws"
            " some of them"
        )


def build_row_scenario(
    base: Scenario,
    keys: Sequence[str],
    values: Sequence[Any],
    row: int,
    *,
    source: str = "grid",
    trust_law: bool | None = None,
) -> Scenario:
    """Return the scenario of a row, named after the row. No code is loaded.

    `source` is the prefix of error messages. `trust_law` is as in `override_scenario`.
    """
    changes = dict(zip(keys, values, strict=True))
    if "law.kind" in changes:  # another law has other keys, so it is chosen first
        kind = {"law.kind": changes.pop("law.kind")}
        base = override_scenario(base, kind, source=source, trust_law=trust_law)
    changed = override_scenario(base, changes, source=source, trust_law=trust_law)
    return changed if "name" in changes else replace(changed, name=f"{base.name} row {row}")


_NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,2})?"
_RANGE: Final = re.compile(rf"({_NUMBER})\s*:\s*({_NUMBER})(?:\s*:\s*({_NUMBER}))?")
MOST_ROWS: Final = 100_000_000
"""Largest number of rows of a table: six hours of one core if compiled code takes 0.2 ms for each
row, and a file of some gigabytes. The memory of a sweep hardly grows with the rows."""

_EXPECTED: Final = "KEY=A:B, KEY=A:B:STEP or KEY=VALUE,VALUE"


@dataclass(frozen=True, slots=True)
class EqualSteps(Sequence[float]):
    """Equally spaced numbers including both ends, computed on demand.

    Each number is the double nearest to the decimal number, as if typed.
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
        # Whole numbers give the same result as fractions, ten times as fast.
        above = first.numerator * step.denominator + step.numerator * first.denominator * number
        below = first.denominator * step.denominator
        return above // below if self.is_whole else above / below


def parse_key_values(text: str, *, source: str, is_sampled: bool = False) -> KeyValues:
    """Parse a key, an equals sign, and a range or values, such as `law.kp_linear=0.5:12:0.25`.

    If rows are sampled, any number in `A:B` is allowed, so that the steps need not end at B.
    """
    key, equals, rest = (part.strip() for part in text.partition("="))
    if not equals or not all(key.split(".")) or not rest:
        raise SweepError(f"{source}: expected {_EXPECTED}, found {text[:60]!r}")
    place = f"{source}: {key}"
    found = _RANGE.fullmatch(rest)
    # At least one end of a range is a number; `path.py:Class` is a value.
    words = [word.strip() for word in rest.split(":")]
    is_number = re.compile(rf"{_NUMBER}|[-+]?(?:nan|inf)", re.IGNORECASE).fullmatch
    if found is None and 1 < len(words) < 4 and any(map(is_number, words)):
        wrong = next(end for end in rest.split(":") if not re.fullmatch(_NUMBER, end.strip()))
        what = f"{quote_name(wrong)} is not a finite number" if wrong else "a bound is missing"
        raise SweepError(f"{place}={rest[:60]}: {what}; a range is A:B or A:B:STEP")
    if found is not None:
        is_any = is_sampled and found[3] is None and not _are_whole(*found.groups())
        steps = _build_steps(*found.groups(), place=place, is_any=is_any)
        return KeyValues(key=key, text=rest, values=steps, is_open=found[3] is None)
    try:
        texts = [f"value={one.strip()}" for one in rest.split(",")]
        values = [parse_assignments([one], source=place)["value"] for one in texts]
    except ScenarioError as err:
        raise SweepError(f"{place}: a value is missing between commas") from err
    if choose_type(values) == "text" and not all(isinstance(one, str) for one in values):
        raise SweepError(f"{place}: expected numbers, texts or truths alone, found {rest[:60]!r}")
    return KeyValues(key=key, text=rest, values=values)


def _build_steps(
    first: str, last: str, step: str | None, *, place: str, is_any: bool
) -> EqualSteps:
    """Return the steps of a range; if any number in it is allowed, its ends."""
    low, high, width = Fraction(first), Fraction(last), Fraction(step or 1)
    if is_any and high < low:
        raise SweepError(f"{place}: expected a range from low to high, found {first}:{last}")
    if is_any:
        return EqualSteps(low, high - low, 2, is_whole=False)
    if not width:
        raise SweepError(f"{place}: expected a step other than 0, found {step}")
    steps, rest = divmod(high - low, width)
    if steps < 0:
        back = f"{last}:{first}" if width > 0 else f"{first}:{last}"
        end = "" if step is None else f":{step.removeprefix('-')}"
        raise SweepError(f"{place}: no value from {first} to {last}; did you mean {back}{end}?")
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


def _are_whole(*texts: str | None) -> bool:
    return not any(sign in text for text in texts if text for sign in ".eE")
