"""The one line at the end: recordings, checks, worst margins."""

from textwrap import shorten
from typing import TYPE_CHECKING, Any

import pytest

from turtlelog.escapes import escape_controls

if TYPE_CHECKING:
    from turtlelog.check import CheckResult

_MOST = 3
_WIDTH = 60


class SessionSummary:
    """Gathers what the reports of all processes tell."""

    def __init__(self) -> None:
        self._recordings: set[str] = set()
        self._accepted: set[str] = set()
        self._checks: list[dict[str, Any]] = []

    def add(self, told: dict[str, Any] | None) -> None:
        """Take what one report tells, if anything."""
        if not told:
            return
        self._recordings.update(told["recordings"])
        self._accepted.update(told["accepted"])
        self._checks += told["checks"]

    def format_line(self) -> str:
        """Return the line; empty where no recording was used."""
        if not self._recordings:
            return ""
        failed = sum(check["verdict"] == "FAIL" for check in self._checks)
        parts = [
            f"turtlelog: {_count(len(self._recordings), 'recording')}",
            _count(len(self._checks), "check") + (f" ({failed} failed)" if failed else ""),
        ]
        worst = self._describe_worst()
        parts += [f"worst margins: {'; '.join(worst)}"] if worst else []
        accepted = [f"accepted {path}" for path in sorted(self._accepted)]
        return escape_controls(", ".join([*parts, *accepted]))

    def _describe_worst(self) -> list[str]:
        if not self._checks:
            return []
        from turtlelog.check.result import CheckResult, find_worst

        worst = find_worst(CheckResult(**check) for check in self._checks)
        return [_describe(result) for result in worst[:_MOST]]


def _count(number: int, word: str) -> str:
    return f"{number} {word}" if number == 1 else f"{number} {word}s"


def _describe(result: "CheckResult") -> str:
    from turtlelog.check.result import format_number

    name = shorten(result.check, _WIDTH, placeholder="...")
    return f"{format_number(result.margin, result.unit)} {name} ({result.file})"


SUMMARY = pytest.StashKey[SessionSummary]()
