"""Differences of a signal from a reference: a recording, or another run."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import format_html, format_notebook, show_angle
from turtlelog.errors import ReplayError
from turtlelog.run.angles import wrap_angle

Value = float | int | str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """A value of the reference, and the value of a replay or another run in its place.

    Attributes:
        signal: Name of the signal.
        time_ns: Time of the values [ns]: on the recording's clock for a replay, on the common clock
            for two runs.
        recorded: Value of the reference, in the unit of the signal. A phase or stop reason is given
            by name, a declaration in words. None: no value.
        replayed: Value of the replay or the other run, in the same form.
    """

    signal: str
    time_ns: int
    recorded: Value
    replayed: Value


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalDifference:
    """Difference of a signal from the reference, over all rows.

    Attributes:
        signal: Name of the signal.
        unit: Unit of the values.
        rows: Number of compared rows.
        differing: Number of rows that differ by more than the limit, or have a value on one side
            only.
        largest: Largest magnitude of a difference, in `unit`; 1 for a label that differs. If limits
            differ from row to row, the difference in the row with the smallest margin.
        limit: Largest tolerated difference in that row, in `unit`.
        largest_difference: First row of the largest difference; None if the largest difference is
            0.
        first_difference: First row beyond its limit; None if no row is beyond its limit.
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
        """Time at which the largest difference is first reached [ns]; None if all are equal."""
        return None if self.largest_difference is None else self.largest_difference.time_ns

    @property
    def at_s(self) -> float | None:
        """Time at which the largest difference is first reached [s]."""
        return None if self.at_ns is None else self.at_ns / 1e9


@dataclass(frozen=True, slots=True, eq=False)
class Pairing:
    """Recorded and replayed values of a signal, row by row.

    Attributes:
        signal: Name of the signal.
        unit: Unit of the values.
        time_ns: Time on the recording's clock [ns], shape (n,), not decreasing.
        recorded: Recorded values, shape (n,); NaN: no value.
        replayed: Replayed values, shape (n,); NaN: no value.
        kind: `number`; `angle`: differences in [-pi, pi); `label`: names that are equal or not.
    """

    signal: str
    unit: str
    time_ns: NDArray[np.int64]
    recorded: NDArray[np.float64] | NDArray[np.int64] | NDArray[np.str_]
    replayed: NDArray[np.float64] | NDArray[np.int64] | NDArray[np.str_]
    kind: Literal["number", "angle", "label"] = "number"


def compare_pairing(pairing: Pairing, *, tolerance: float) -> SignalDifference:
    """Return the difference of a signal's rows. Unequal labels differ at any tolerance."""
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
    """Return the earliest difference; of several at one time, the difference named first."""
    found = [difference for difference in differences if difference]
    return min(found, key=lambda difference: difference.time_ns, default=None)


def require_tolerance(tolerance: float) -> None:
    """Refuse an invalid tolerance."""
    if not 0.0 <= tolerance < float("inf"):
        raise ReplayError(f"tolerance: expected a number >= 0, found {tolerance}")


def _subtract(pairing: Pairing) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the differences, 0 if both sides have no value, and the rows with one value only."""
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
    """Return the result of a replay in a few words."""
    found = "no difference" if first is None else f"first differs in {first.signal}"
    return f"{samples} compared, {found}"


def format_replay_html(
    name: str, samples: int, first: Difference | None, signals: Iterable[SignalDifference]
) -> str:
    """Return the HTML that a notebook shows for a replay: its result and differing signals."""
    rows = [
        (one.signal, *show_angle(one.largest, one.unit)[::-1], one.differing, one.rows)
        for one in signals
        if one.differing
    ]
    heads = ("signal", "unit", "largest difference", "rows that differ", "of")
    table = format_html(rows, heads=heads) if rows else ""
    return format_notebook(f"{name}: {describe_replay(samples, first)}.", table)
