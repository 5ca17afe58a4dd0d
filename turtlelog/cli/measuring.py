"""Options of how to measure, and what they stand for."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.options import Whole
from turtlelog.errors import UsageError

if TYPE_CHECKING:
    from turtlelog import MeasureSettings


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class MeasureOptions:
    """How to measure; a value of a loop is in rad where it controls the heading, else in m.

    Attributes:
        only: Ids or patterns, as in rotate.overshoot,final.*
        band: Half-width of the settling band, as a share of the step (0.02).
        initial: Where steps start: NUMBER or LOOP=NUMBER (first value).
        final: Where they lead: reference, last, NUMBER, or LOOP=... (reference).
        reference_path: CSV of x,y in m, for cross-track errors (line to the goal).
        dead_time: Samples of dead time in the delayed ideal loop (as found).
    """

    only: str | None = None
    band: float | None = None
    initial: str | None = None
    final: str | None = None
    reference_path: Path | None = None
    dead_time: Whole | None = None

    def list_patterns(self) -> list[str] | None:
        """Return the ids and patterns that are asked for, None where none are."""
        if self.only is None:
            return None
        patterns = [name.strip() for name in self.only.split(",")]
        if not all(patterns):
            raise UsageError(f"--only: expected ids separated by commas, found {self.only!r}")
        return patterns

    def build_settings(self) -> "MeasureSettings":
        """Return what is asked for as settings."""
        path = self.reference_path
        asked: dict[str, Any] = {
            "band": self.band,
            "initial": None if self.initial is None else _parse_values("--initial", self.initial),
            "final": None if self.final is None else _parse_values("--final", self.final),
            "reference_path_xy_m": None if path is None else tl.read_reference_path(path),
            "dead_time_ticks": self.dead_time,
        }
        return tl.MeasureSettings(
            **{name: value for name, value in asked.items() if value is not None}
        )


Value = float | str


def _parse_values(option: str, text: str) -> Value | Mapping[str, Value]:
    if "=" not in text:
        return _parse_value(option, text)
    pairs = [part.partition("=") for part in text.split(",")]
    return {loop.strip(): _parse_value(option, value) for loop, _, value in pairs}


def _parse_value(option: str, text: str) -> Value:
    text = text.strip()
    if option == "--final" and text in {"reference", "last"}:
        return text
    try:
        return float(text)
    except ValueError as err:
        words = "reference, last, a number" if option == "--final" else "a number"
        raise UsageError(f"{option}: expected {words} or LOOP=VALUE,..., found {text!r}") from err
