"""Verdicts on recordings as rows of a stored table."""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from sys import intern
from typing import Any, Final

from turtlelog.check.result import CheckResult, Verdict
from turtlelog.check.spec import Spec
from turtlelog.errors import CheckError, LibraryError
from turtlelog.log import ReadChoice
from turtlelog.log.parquet_file import list_cells
from turtlelog.sweep import RecordingTable, describe_values, hash_recording
from turtlelog.sweep.table.recording_table import ERROR, FILE
from turtlelog.sweep.table.result_table import open_result_table
from turtlelog.sweep.table.stored_rows import Cell, Key, Row

_KEYS: Final = (
    *(Key(name) for name in ("check", "verdict", "expected")),
    *(Key(name, "real") for name in ("value", "limit", "margin")),
    Key("unit"),
    Key("value_s", "real", "s"),
    Key("decided_by"),
    Key("first_violation_s", "real", "s"),
    Key("reason"),
)
_DECIDED: Final = Key("decided", "whole")
"""Column with 1 if the verdict is decided, otherwise 0."""

_ROWS_AT_ONCE: Final = 4096
"""Number of rows of a table that are converted to Python values at once."""

_RECORDING: Final = "recording"
"""Name of the check that fails if a recording cannot be read, or is incomplete."""

Judge = Callable[[str], Sequence[CheckResult]]


def _judge_file(path: str, *, judge: Judge) -> list[Row]:
    try:
        return [_build_row(result) for result in judge(path)]
    except LibraryError as err:
        raise CheckError(f"{path}: {err}") from err


def plan_verdict_table(
    spec: Spec, judge: Judge, choice: ReadChoice, *, is_partial: bool
) -> RecordingTable:
    """Return the plan of `tabulate_recordings` for a table with one row per file and check.

    The judge of files must be picklable. `is_partial`: whether an incomplete recording may pass.
    """
    held = hashlib.sha256(describe_values(spec).encode()).hexdigest()
    facts = {"specification": held, "reading": describe_values(choice), "partial": str(is_partial)}
    if spec.reference is not None:
        facts["reference"] = hash_recording(spec.reference)
    return RecordingTable(
        kind="verdicts",
        facts=facts,
        work=partial(_judge_file, judge=judge),
        order=lambda _keys, _used: (*_KEYS, _DECIDED),
    )


def _build_row(result: CheckResult) -> Row:
    row: dict[Key, Cell] = {key: getattr(result, key.name, None) for key in _KEYS}
    texts = {key: str(cell) or None for key, cell in row.items() if key.type == "text"}
    is_lost = result.check == _RECORDING and not result.is_decided
    return {
        **row,
        **texts,
        _DECIDED: int(result.is_decided),
        ERROR: result.reason if is_lost else None,
    }


def read_verdicts(path: Path, files: Mapping[str, str]) -> Iterator[CheckResult]:
    """Yield the results in a table; `files` are their files' names, by label in the table."""
    keys = (FILE, *_KEYS, _DECIDED)
    names = [key.name for key in keys]
    table = open_result_table(path, kind="verdicts")
    for group, count in enumerate(table.group_rows):
        columns = table.read(names, group)
        for first in range(0, count, _ROWS_AT_ONCE):
            part = {
                one.name: list_cells(one.cells[first : first + _ROWS_AT_ONCE]) for one in columns
            }
            rows: Iterator[Any] = zip(*(part[name] for name in names), strict=True)
            found = (dict(zip(names, row, strict=True)) for row in rows)
            yield from (_build_result(one, files) for one in found if one["verdict"] is not None)


def _build_result(cells: dict[str, Any], files: Mapping[str, str]) -> CheckResult:
    # Texts repeat from file to file, and are stored once in memory.
    texts = {key.name: intern(cells[key.name] or "") for key in _KEYS if key.type == "text"}
    cells |= texts
    label, is_decided = cells.pop("file"), bool(cells.pop("decided"))
    verdict = Verdict(cells.pop("verdict"))
    return CheckResult(**cells, file=files[label], verdict=verdict, is_decided=is_decided)
