"""The software that simulated a run: versions, platform and the code of its law."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

LAW: Final = "law"
"""Entry for a law that is not built in: a digest of its code."""

_WORDS: Final = {"python": "Python", "numpy": "NumPy", "platform": ""}
"""Words for the entries; a platform needs no word, and `turtlelog` is one itself."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SoftwareChange:
    """An entry of `Run.simulated_by` that differs between two runs.

    Attributes:
        name: Name of the entry: `turtlelog`, `python`, `numpy`, `platform` or `law`.
        first: Value in the first run; None if that run has no such entry.
        second: Value in the second run; None if that run has no such entry.
    """

    name: str
    first: str | None
    second: str | None


def list_software_changes(
    first: Mapping[str, str], second: Mapping[str, str]
) -> tuple[SoftwareChange, ...]:
    """Return the entries that differ between two runs; empty if one run names no software."""
    if not first or not second:
        return ()
    return tuple(
        SoftwareChange(name=name, first=first.get(name), second=second.get(name))
        for name in {**first, **second}
        if first.get(name) != second.get(name)
    )


def describe_software(software: Mapping[str, str]) -> str:
    """Return versions and platform: `turtlelog 0.1.0, Python 3.12.3, NumPy 2.1.3, Linux x86_64`."""
    return ", ".join(_name(name, text) for name, text in software.items() if name != LAW)


def describe_changes(changes: Sequence[SoftwareChange]) -> str:
    """Return the differences as text, versions with both values: `NumPy 2.1.3, then 2.2.0`."""
    return "; ".join(
        "the code of the law"
        if one.name == LAW
        else _name(one.name, f"{one.first or 'unknown'}, then {one.second or 'unknown'}")
        for one in changes
    )


def _name(name: str, text: str) -> str:
    return f"{_WORDS.get(name, name)} {text}".strip()
