"""Specifications: what a team's recordings are held to."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Literal

from turtlelog.compare import Tolerance
from turtlelog.compare.ids import could_be_signal, list_ids_like
from turtlelog.errors import CompareError
from turtlelog.expressions import Expression
from turtlelog.measure import SIGNALS, find_metric_kind
from turtlelog.scenario import describe_unknown_key
from turtlelog.scenario.describe import name_key


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
class Tolerances:
    """Which signals and metrics are judged, and how.

    Attributes:
        signals: By the name of the signal, or of a law's state.
        metrics: By the id of the metric; of a loop as of any law.

    Raises:
        CompareError: Where no law has such a signal or metric, or its tolerance does not fit it.
    """

    signals: Mapping[str, Tolerance] = field(default_factory=dict)
    metrics: Mapping[str, Tolerance] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for kind in ("signals", "metrics"):
            found = getattr(self, kind)
            for name, tolerance in found.items():
                place = f'{kind}."{name}"' if "." in name else f"{kind}.{name_key(name)}"
                if not is_known(kind, name):
                    known = list_nearby(kind, name)
                    raise CompareError(f"{place}: {describe_unknown_key(name, known)}")
                _require_fitting(kind, name, tolerance, place)
            object.__setattr__(self, kind, MappingProxyType(dict(found)))

    def __bool__(self) -> bool:
        return bool(self.signals or self.metrics)


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


def is_known(kind: str, name: str) -> bool:
    """Return whether runs of any law can have a signal, or a metric, of this name."""
    return could_be_signal(name) if kind == "signals" else find_metric_kind(name) is not None


def list_nearby(kind: str, name: str) -> list[str]:
    """Return the names among which a misspelled one is looked for."""
    return list(SIGNALS) if kind == "signals" else list_ids_like(name)


def _require_fitting(kind: str, name: str, tolerance: Tolerance, place: str) -> None:
    if kind == "metrics" and tolerance.time_s:
        raise CompareError(f"{place}.time_s: expected none for a metric, found {tolerance.time_s}")
    is_label = kind == "signals" and is_label_signal(name)
    if is_label and (tolerance.abs or tolerance.rel):
        key, found = ("abs", tolerance.abs) if tolerance.abs else ("rel", tolerance.rel)
        raise CompareError(f"{place}.{key}: expected none for a label, found {found}")


def is_label_signal(name: str) -> bool:
    """Return whether a signal is a label: equal or not."""
    return name in SIGNALS and SIGNALS[name].compared_as == "label"
