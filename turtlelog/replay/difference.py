"""What two values of one signal differ by, and where a signal first differs."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from turtlelog.angles import wrap_angle
from turtlelog.errors import ReplayError
from turtlelog.run import Phase

Value = float | int | str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """One recorded value beside the one that a replay has in its place.

    Attributes:
        signal: Its name.
        time_ns: When, by the recording [ns].
        recorded: In the signal's unit; a phase or stop reason by its name; None: none.
        replayed: The same.
    """

    signal: str
    time_ns: int
    recorded: Value
    replayed: Value


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalDifference:
    """How far a signal is from what was recorded, over all rows.

    Attributes:
        signal: Its name.
        unit: Of its values.
        rows: How many were compared.
        differing: How many of them differ by more than the tolerance.
        largest: Largest magnitude of a difference, in `unit`; of a label 1 where it differs.
        at_ns: When that is first reached, by the recording [ns]; None where all are equal.
        first_difference: None where no row differs by more than the tolerance.
    """

    signal: str
    unit: str
    rows: int
    differing: int
    largest: float
    at_ns: int | None
    first_difference: Difference | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pairing:
    """The values of a signal, recorded and replayed, row by row.

    Attributes:
        signal: Its name.
        unit: Of its values.
        time_ns: By the recording [ns], shape (n,), not decreasing.
        recorded: Shape (n,).
        replayed: Shape (n,).
        kind: `number`; `angle`: differences in [-pi, pi); `phase`: equal or not.
    """

    signal: str
    unit: str
    time_ns: NDArray[np.int64]
    recorded: NDArray[np.float64] | NDArray[np.int64]
    replayed: NDArray[np.float64] | NDArray[np.int64]
    kind: Literal["number", "angle", "phase"] = "number"


def compare_pairing(pairing: Pairing, *, tolerance: float) -> SignalDifference:
    """Return how far a signal's rows differ; phases differ whatever the tolerance."""
    apart = _subtract(pairing)
    # What is not within: nan, which a difference beyond the largest number may be, is none.
    outside = ~(apart <= (0.0 if pairing.kind == "phase" else tolerance))
    row = int(apart.argmax()) if len(apart) else 0
    largest = float(apart[row]) if len(apart) else 0.0
    return SignalDifference(
        signal=pairing.signal,
        unit=pairing.unit,
        rows=len(apart),
        differing=int(outside.sum()),
        largest=largest,
        at_ns=int(pairing.time_ns[row]) if largest else None,
        first_difference=_build_first(pairing, int(outside.argmax())) if outside.any() else None,
    )


def find_earliest(differences: Iterable[Difference | None]) -> Difference | None:
    """Return the earliest; of several at one time the one that is named first."""
    found = [difference for difference in differences if difference]
    return min(found, key=lambda difference: difference.time_ns, default=None)


def require_tolerance(tolerance: float) -> None:
    """Refuse a tolerance that is none."""
    if not 0.0 <= tolerance < float("inf"):
        raise ReplayError(f"tolerance: expected a number >= 0, found {tolerance}")


def _subtract(pairing: Pairing) -> NDArray[np.float64]:
    recorded, replayed = pairing.recorded, pairing.replayed
    if pairing.kind == "phase":
        return np.not_equal(recorded, replayed).astype(np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        apart: NDArray[np.float64] = np.subtract(replayed, recorded, dtype=np.float64)
        return np.abs(wrap_angle(apart) if pairing.kind == "angle" else apart)


def _build_first(pairing: Pairing, row: int) -> Difference:
    recorded, replayed = pairing.recorded[row].item(), pairing.replayed[row].item()
    if pairing.kind == "phase":
        recorded, replayed = Phase(recorded).label, Phase(replayed).label
    return Difference(
        signal=pairing.signal,
        time_ns=int(pairing.time_ns[row]),
        recorded=recorded,
        replayed=replayed,
    )
