"""The one line at the end: recordings, checks, worst margins."""

from textwrap import shorten
from typing import Any

import pytest

_MOST = 3
_WIDTH = 60


class Summary:
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
        worst = [_describe(check) for check in self._find_worst()]
        parts += [f"worst margins: {'; '.join(worst)}"] if worst else []
        accepted = [f"accepted {path}" for path in sorted(self._accepted)]
        return ", ".join([*parts, *accepted])

    def _find_worst(self) -> list[dict[str, Any]]:
        """Return the least margin of each unit, as metres and seconds have no order."""
        worst: dict[str, dict[str, Any]] = {}
        for check in self._checks:
            if check["margin"] is None:
                continue
            known = worst.get(check["unit"])
            if known is None or check["margin"] < known["margin"]:
                worst[check["unit"]] = check
        return sorted(worst.values(), key=lambda check: bool(check["margin"] >= 0))[:_MOST]


def _count(number: int, word: str) -> str:
    return f"{number} {word}" if number == 1 else f"{number} {word}s"


def _describe(check: dict[str, Any]) -> str:
    unit = "" if check["unit"] in {"", "1"} else f" {check['unit']}"
    name = shorten(check["check"], _WIDTH, placeholder="...")
    return f"{check['margin']:.5g}{unit} {name} ({check['file']})"


SUMMARY = pytest.StashKey[Summary]()
