"""Specifications: what a team's recordings are held to."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from turtlelog.compare import Tolerances
from turtlelog.expressions import Expression


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """One thing that is to hold.

    Attributes:
        name: Of its table.
        kind: `expect`: over metrics and parameters; `holds`: over signals and time, too.
        formula: What is to hold.
        phase: The stretch that `holds` looks at: `pause`, or a phase of the run's law, the pause
            after it included; None for the whole run.
        when: Otherwise the check is skipped; None: it never is.
        reason: Why so much and no more.
        is_observed: Whether the bound was read off a good run and nobody has thought about it yet.
    """

    name: str
    kind: Literal["expect", "holds"]
    formula: Expression
    phase: str | None = None
    when: Expression | None = None
    reason: str = ""
    is_observed: bool = False

    def describe(self) -> str:
        """Return what is to hold, and where."""
        return self.formula.text if self.phase is None else f"{self.formula.text} in {self.phase}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """What recordings are held to.

    Attributes:
        checks: In the order of the file.
        tolerances: How far signals and metrics may be from the reference's.
        reference: The recording that tolerances are taken from; None where there are none.
        alignment: How runs and reference are brought together.
        source: The file, for messages.
    """

    checks: tuple[Check, ...] = ()
    tolerances: Tolerances = field(default_factory=Tolerances)
    reference: Path | None = None
    alignment: str = "first_sample"
    source: str = "specification"
