"""The paper's CSV logs: the lists of the JSON layout as columns, without the metadata."""

import csv
from io import StringIO
from pathlib import Path
from types import MappingProxyType
from typing import Final

from turtlelog.errors import LogError
from turtlelog.log.importers.paper_log import NUMBERS, PaperLog, build_columns

_HEADINGS: Final = MappingProxyType(
    {name: name for name in (*NUMBERS, "state")} | {"error_angle": "error_angle_rad"}
)
"""What a list is called in this layout."""


def parse_paper_csv(text: str, path: Path) -> PaperLog:
    """Return the log in a CSV text.

    Raises:
        LogError: Where it is no CSV, or not of this layout.
    """
    heading, *rows = _split(text)
    for name in _HEADINGS.values():
        if heading.count(name) != 1:
            found = f"{heading.count(name)} in {','.join(heading)[:80]!r}"
            raise LogError(f"line 1: expected a column {name}, found {found}")
    for number, row in enumerate(rows):
        if len(row) != len(heading):
            raise LogError(f"row {number}: expected {len(heading)} values, found {len(row)}")
    lists: dict[str, list[object]] = {}
    for name, column in _HEADINGS.items():
        values = [row[heading.index(column)] for row in rows]
        lists[name] = [*values] if name == "state" else [_parse(value) for value in values]
    columns, states = build_columns(lists, _HEADINGS)
    return PaperLog(
        name=path.stem,
        source=f"paper-csv: {path.name}",
        columns=columns,
        states=states,
        absent=("parameters",),
    )


def _split(text: str) -> list[list[str]]:
    try:
        return [row for row in csv.reader(StringIO(text, newline=""), strict=True) if row]
    except csv.Error as err:
        raise LogError(f"expected CSV, found: {err}") from err


def _parse(value: str) -> object:
    """Return a number, or the text where it is none: the check that follows names its place."""
    try:
        return float(value)
    except ValueError:
        return value
