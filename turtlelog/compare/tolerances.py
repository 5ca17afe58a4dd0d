"""Tolerances: how far signals and metrics may be from a reference's, each with a reason."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from turtlelog.compare.ids import could_be_signal, list_ids_like
from turtlelog.errors import CompareError
from turtlelog.measure import SIGNALS, find_metric_kind
from turtlelog.scenario import describe_unknown_key
from turtlelog.scenario.describe import name_key


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerance:
    """How far one signal or metric may be from the reference's: max(abs, rel |reference|).

    Attributes:
        abs: In the unit of the signal or metric, >= 0.
        rel: As a share of the reference's magnitude, 0 to 1; an angle's is that in [0, pi].
        time_s: A signal passes by any value that the reference takes this close in time [s], >= 0.
        reason: Why so much and no more.

    Raises:
        CompareError: Where a figure is no finite number in its range.
    """

    abs: float = 0.0
    rel: float = 0.0
    time_s: float = 0.0
    reason: str = ""

    def __post_init__(self) -> None:
        for name, most in (("abs", math.inf), ("rel", 1.0), ("time_s", _LONGEST_S)):
            value = getattr(self, name)
            wanted = "a finite number >= 0" if math.isinf(most) else f"a number from 0 to {most:g}"
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            if not is_number or not 0 <= value <= most or value == math.inf:
                raise CompareError(f"{name}: expected {wanted}, found {_describe(value)}")
            object.__setattr__(self, name, float(value))
        if not isinstance(self.reason, str):
            raise CompareError(f"reason: expected text, found {_describe(self.reason)}")


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


_LONGEST_S = 1e6


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


def _describe(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else repr(value)
