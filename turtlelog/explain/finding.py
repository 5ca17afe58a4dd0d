"""What was identified: a value, how sure it is, and by what evidence; or why there is none."""

import enum
from dataclasses import dataclass
from typing import Any


class Certainty(enum.StrEnum):
    """How sure a finding is."""

    EXACT = "exact"
    """It alone reproduces every row that it concerns, bit for bit or to the poses' rounding."""
    FITTED = "fitted"
    """Least squares, with its standard error."""
    BRACKETED = "bracketed"
    """Anything in an interval fits; the value is the roundest in it."""
    AMBIGUOUS = "ambiguous"
    """Several values fit alike; they are the candidates, and the value is the likeliest."""
    UNKNOWN = "unknown"
    """The log does not tell it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One identified value.

    Attributes:
        value: In the unit of its key; None exactly where `certainty` is UNKNOWN.
        certainty: How sure it is.
        evidence: One clause: by what it is known, or why it is not.
        interval: From and to, where it is bracketed: [low, high).
        candidates: All values that fit, where several do.
        assumed: What a re-simulation uses where the value is unknown and does not show.
    """

    value: Any = None
    certainty: Certainty
    evidence: str
    interval: tuple[float, float] | None = None
    candidates: tuple[Any, ...] = ()
    assumed: Any = None

    @property
    def used(self) -> Any:
        """What a re-simulation uses: the value, or else what is assumed."""
        return self.assumed if self.value is None else self.value


def find_exactly(value: Any, evidence: str) -> Finding:
    """Return a value that is beyond doubt."""
    return Finding(value=value, certainty=Certainty.EXACT, evidence=evidence)


def miss(evidence: str, assumed: Any = None) -> Finding:
    """Return why there is no value, and what a re-simulation takes in its place."""
    return Finding(certainty=Certainty.UNKNOWN, evidence=evidence, assumed=assumed)
