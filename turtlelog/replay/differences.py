"""How far a signal is from that of a reference: a recording, or another run."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import format_answer, format_html, show_angle
from turtlelog.errors import ReplayError
from turtlelog.run.angles import wrap_angle

Value = float | int | str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """A value of a reference beside the one that a replay, or another run, has in its place.

    Attributes:
        signal: Its name.
        time_ns: When [ns]: of a replay by the recording, of two runs on their common clock.
        recorded: Of the reference, in the signal's unit; a phase or stop reason by its name, a
            declaration in words; None: none.
        replayed: Of the replay or the other run, the same.
    """

    signal: str
    time_ns: int
    recorded: Value
    replayed: Value


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalDifference:
    """How far a signal is from the reference's, over all rows.

    Attributes:
        signal: Its name.
        unit: Of its values.
        rows: How many were compared.
        differing: How many of them differ by more than the limit, or have a value on one side only.
        largest: Largest magnitude of a difference, in `unit`; of a label 1 where it differs. Where
            limits differ from row to row, that of the row with the least margin.
        limit: Differences up to this one are tolerated in that row, in `unit`.
        largest_difference: The first row of that difference; None where it is 0.
        first_difference: The first row beyond its limit; None where there is none.
    """

    signal: str
    unit: str
    rows: int
    differing: int
    largest: float
    limit: float
    largest_difference: Difference | None
    first_difference: Difference | None

    @property
    def at_ns(self) -> int | None:
        """When the largest difference is first reached [ns]; None where all are equal."""
        return None if self.largest_difference is None else self.largest_difference.time_ns

    @property
    def at_s(self) -> float | None:
        """The same [s]."""
        return None if self.at_ns is None else self.at_ns / 1e9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pairing:
    """The values of a signal, recorded and replayed, row by row.

    Attributes:
        signal: Its name.
        unit: Of its values.
        time_ns: By the recording [ns], shape (n,), not decreasing.
        recorded: Shape (n,); NaN: none.
        replayed: Shape (n,); NaN: none.
        kind: `number`; `angle`: differences in [-pi, pi); `label`: names, equal or not.
    """

    signal: str
    unit: str
    time_ns: NDArray[np.int64]
    recorded: NDArray[np.float64] | NDArray[np.int64] | NDArray[np.str_]
    replayed: NDArray[np.float64] | NDArray[np.int64] | NDArray[np.str_]
    kind: Literal["number", "angle", "label"] = "number"


def compare_pairing(pairing: Pairing, *, tolerance: float) -> SignalDifference:
    """Return how far a signal's rows differ; labels differ whatever the tolerance."""
    apart, is_one_sided = _subtract(pairing)
    limit = 0.0 if pairing.kind == "label" else tolerance
    # What is not within: nan, which a difference beyond the largest number may be, is none.
    outside = ~(apart <= limit) | is_one_sided
    row = int(apart.argmax()) if len(apart) else 0
    largest = float(apart[row]) if len(apart) else 0.0
    return SignalDifference(
        signal=pairing.signal,
        unit=pairing.unit,
        rows=len(apart),
        differing=int(outside.sum()),
        largest=largest,
        limit=limit,
        largest_difference=_read_row(pairing, row) if largest else None,
        first_difference=_read_row(pairing, int(outside.argmax())) if outside.any() else None,
    )


def find_earliest(differences: Iterable[Difference | None]) -> Difference | None:
    """Return the earliest; of several at one time the one that is named first."""
    found = [difference for difference in differences if difference]
    return min(found, key=lambda difference: difference.time_ns, default=None)


def require_tolerance(tolerance: float) -> None:
    """Refuse a tolerance that is none."""
    if not 0.0 <= tolerance < float("inf"):
        raise ReplayError(f"tolerance: expected a number >= 0, found {tolerance}")


def _subtract(pairing: Pairing) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return how far apart the values are, 0 where a side has none, and where only one has."""
    recorded, replayed = pairing.recorded, pairing.replayed
    if pairing.kind == "label":
        differs = np.not_equal(recorded, replayed)
        return differs.astype(np.float64), np.zeros_like(differs)
    missing = np.isnan(recorded), np.isnan(replayed)
    with np.errstate(over="ignore", invalid="ignore"):
        apart: NDArray[np.float64] = np.subtract(replayed, recorded, dtype=np.float64)
        apart = np.abs(wrap_angle(apart) if pairing.kind == "angle" else apart)
    return np.where(missing[0] | missing[1], 0.0, apart), missing[0] != missing[1]


def _read_row(pairing: Pairing, row: int) -> Difference:
    # A NaN, which no other value equals, is no value.
    recorded, replayed = (
        value if value == value else None  # noqa: PLR0124
        for value in (pairing.recorded[row].item(), pairing.replayed[row].item())
    )
    return Difference(
        signal=pairing.signal,
        time_ns=int(pairing.time_ns[row]),
        recorded=recorded,
        replayed=replayed,
    )


def describe_replay(samples: int, first: Difference | None) -> str:
    """Return what a replay came to, in a few words."""
    found = "no difference" if first is None else f"first differs in {first.signal}"
    return f"{samples} compared, {found}"


def format_replay_html(
    name: str, samples: int, first: Difference | None, signals: Iterable[SignalDifference]
) -> str:
    """Return what a notebook shows of a replay: what it came to, and the signals that differ."""
    rows = [
        (one.signal, *show_angle(one.largest, one.unit)[::-1], one.differing, one.rows)
        for one in signals
        if one.differing
    ]
    heads = ("signal", "unit", "largest difference", "rows that differ", "of")
    table = format_html(rows, heads=heads) if rows else ""
    return format_answer(f"{name}: {describe_replay(samples, first)}.", table)
