"""Verdicts of recordings as files: JUnit XML for continuous integration, and a table."""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from sys import intern
from typing import Any, Final

from turtlelog import sweep
from turtlelog.check.judge_run import CheckedFile
from turtlelog.check.result import CheckResult, Verdict, describe_result
from turtlelog.check.spec import Spec
from turtlelog.errors import CheckError, LibraryError
from turtlelog.escapes import escape_controls
from turtlelog.log import ReadChoice
from turtlelog.log.parquet_file import list_cells
from turtlelog.sweep.partial_table import ERROR, FILE, Cell, Key, Row
from turtlelog.sweep.result_table import open_result_table

_NO_XML: Final = {0xFFFE: r"\ufffe", 0xFFFF: r"\uffff"}


def format_junit(files: Sequence[CheckedFile]) -> str:
    """Return results as JUnit XML, with the times of the files."""
    from xml.etree import ElementTree as Xml  # few checks need it

    counts = _count([result for found in files for result in found.results])
    took_s = sum(found.took_s for found in files)
    root = Xml.Element("testsuites", {**counts, "time": f"{took_s:.3f}"})
    root.set("name", "turtlelog check")
    for found in files:
        facts = {"name": _clean(found.file), **_count(found.results), "time": f"{found.took_s:.3f}"}
        suite = Xml.SubElement(root, "testsuite", facts)
        if found.started is not None:
            suite.set("timestamp", found.started.isoformat(timespec="seconds"))
        if found.metrics:
            properties = Xml.SubElement(suite, "properties")
            for metric in found.metrics.values():
                value = metric.status.value if metric.value is None else repr(metric.value)
                name = metric.id if metric.unit == "1" else f"{metric.id} [{metric.unit}]"
                Xml.SubElement(properties, "property", {"name": name, "value": value})
        each_s = found.each_s or (0.0,) * len(found.results)
        for result, case_s in zip(found.results, each_s, strict=True):
            names = {"name": _clean(result.check), "classname": _clean(result.file)}
            case = Xml.SubElement(suite, "testcase", {**names, "time": f"{case_s:.3f}"})
            if result.verdict is Verdict.SKIPPED:
                Xml.SubElement(case, "skipped", {"message": _clean(result.reason)})
            if result.verdict is Verdict.FAIL:
                message = _clean(describe_result(result))
                failure = Xml.SubElement(case, "failure", {"message": message, "type": "check"})
                failure.text = _clean(found.details.get(result.check, "")) or message
    Xml.indent(root)
    text = Xml.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{text}\n'


def _count(results: Sequence[CheckResult]) -> dict[str, str]:
    verdicts = [result.verdict for result in results]
    return {
        "tests": str(len(verdicts)),
        "failures": str(verdicts.count(Verdict.FAIL)),
        "skipped": str(verdicts.count(Verdict.SKIPPED)),
        "errors": "0",
    }


def _clean(text: str) -> str:
    """Return text with escapes for characters that XML cannot contain or that are invisible."""
    return escape_controls(text, keep="\n").translate(_NO_XML)


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

_AT_ONCE: Final = 4096
"""Number of rows of a table that are converted to Python values at once."""

Judge = Callable[[str], Sequence[CheckResult]]


def _judge_file(path: str, *, judge: Judge) -> list[Row]:
    try:
        return [_build_row(result) for result in judge(path)]
    except LibraryError as err:
        raise CheckError(f"{path}: {err}") from err


def _build_row(result: CheckResult) -> Row:
    row: dict[Key, Cell] = {key: getattr(result, key.name, None) for key in _KEYS}
    row |= {key: str(cell) or None for key, cell in row.items() if key.type == "text"}
    return {
        **row,
        _DECIDED: int(result.is_decided),
        ERROR: result.reason if result.is_lost else None,
    }


def plan_verdict_table(
    spec: Spec, judge: Judge, choice: ReadChoice, *, is_partial: bool
) -> "sweep.RecordingTable":
    """Return the plan of `tabulate_recordings` for a table with one row per file and check.

    The judge of files must be picklable. `is_partial`: whether an incomplete recording may pass.
    """
    held = hashlib.sha256(sweep.describe_values(spec).encode()).hexdigest()
    facts = {"specification": held, "reading": sweep.describe_values(choice)}
    facts["partial"] = str(is_partial)
    if spec.reference is not None:
        facts["reference"] = sweep.hash_recording(spec.reference)
    return sweep.RecordingTable(
        kind="verdicts",
        facts=facts,
        work=partial(_judge_file, judge=judge),
        order=lambda _keys, _used: (*_KEYS, _DECIDED),
    )


def read_verdicts(path: Path, files: Mapping[str, str]) -> Iterator[CheckResult]:
    """Yield the results in a table; `files` are their files' names, by label in the table."""
    keys = (FILE, *_KEYS, _DECIDED)
    names, texts = [key.name for key in keys], [key for key in _KEYS if key.type == "text"]
    table = open_result_table(path, kind="verdicts")
    for group, count in enumerate(table.group_rows):
        columns = table.read(names, group)
        for first in range(0, count, _AT_ONCE):
            part = {one.name: list_cells(one.cells[first : first + _AT_ONCE]) for one in columns}
            for row in zip(*(part[name] for name in names), strict=True):
                cells: dict[str, Any] = dict(zip(names, row, strict=True))
                if cells["verdict"] is None:
                    continue
                # Texts repeat from file to file, and are stored once in memory.
                cells |= {one.name: intern(cells[one.name] or "") for one in texts}
                cells["is_decided"] = bool(cells.pop("decided"))
                cells |= {"file": files[cells["file"]], "verdict": Verdict(cells["verdict"])}
                yield CheckResult(**cells)
