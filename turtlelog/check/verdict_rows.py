"""The verdicts on recordings as rows of a table, and as JUnit XML."""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from sys import intern
from typing import Any, Final
from xml.etree import ElementTree as Xml

from turtlelog.check.result import CheckResult, Verdict, describe_result
from turtlelog.check.spec import Spec
from turtlelog.errors import CheckError, LibraryError
from turtlelog.escapes import escape_controls
from turtlelog.log import ReadChoice
from turtlelog.measure import Metric
from turtlelog.sweep import RecordingTable, describe_values, hash_recording
from turtlelog.sweep.file_rows import ERROR, FILE
from turtlelog.sweep.result_table import list_values, open_result_table
from turtlelog.sweep.row_columns import Cell, Key, Row

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
"""1 or 0: whether it is known that the verdict is right."""

_ROWS_AT_ONCE: Final = 4096
"""Of a table that are values of Python at a time."""

_RECORDING: Final = "recording"
"""The check that fails where a recording cannot be read, or has lost something."""

Judge = Callable[[str], Sequence[CheckResult]]


@dataclass(frozen=True, slots=True, kw_only=True)
class _JudgeFile:
    judge: Judge

    def __call__(self, path: str) -> list[Row]:
        try:
            return [_build_row(result) for result in self.judge(path)]
        except LibraryError as err:
            raise CheckError(f"{path}: {err}") from err


def plan_verdict_table(
    spec: Spec, judge: Judge, choice: ReadChoice, *, is_partial: bool
) -> RecordingTable:
    """Return the plan of `tabulate_recordings` for a table with a row for each file and check.

    Args:
        spec: Specification to check.
        judge: Function that returns the results of a file; it can be pickled.
        choice: Settings for reading third-party files.
        is_partial: Whether an incomplete recording may pass.
    """
    held = hashlib.sha256(describe_values(spec).encode()).hexdigest()
    facts = {
        "specification": held,
        "reading": describe_values(choice),
        "partial": str(is_partial),
    }
    if spec.reference is not None:
        facts["reference"] = hash_recording(spec.reference)
    return RecordingTable(
        kind="verdicts",
        facts=facts,
        work=_JudgeFile(judge=judge),
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
    """Yield the results in a table.

    Args:
        path: File of the table.
        files: Names of the files in results, by label in the table.
    """
    keys = (FILE, *_KEYS, _DECIDED)
    names = [key.name for key in keys]
    table = open_result_table(path, kind="verdicts")
    for group, count in enumerate(table.group_rows):
        columns = table.read(names, group)
        for first in range(0, count, _ROWS_AT_ONCE):
            part = {
                one.name: list_values(replace(one, cells=one.cells[first : first + _ROWS_AT_ONCE]))
                for one in columns
            }
            rows: Iterator[Any] = zip(*(part[name] for name in names), strict=True)
            found = (dict(zip(names, row, strict=True)) for row in rows)
            yield from (_build_result(one, files) for one in found if one["verdict"] is not None)


def _build_result(cells: dict[str, Any], files: Mapping[str, str]) -> CheckResult:
    # Texts repeat from file to file, and stand in memory once.
    texts = {key.name: intern(cells[key.name] or "") for key in _KEYS if key.type == "text"}
    cells |= texts
    label, is_decided = cells.pop("file"), bool(cells.pop("decided"))
    verdict = Verdict(cells.pop("verdict"))
    return CheckResult(**cells, file=files[label], verdict=verdict, is_decided=is_decided)


_NO_XML: Final = {0xFFFE: r"\ufffe", 0xFFFF: r"\uffff"}


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckedFile:
    """The results of one recording.

    Attributes:
        file: Name of the recording.
        results: Results in the order of the specification.
        metrics: Metrics by id; empty if the recording could not be measured.
        details: Text for failures, by name of the check.
        started: Start time of its checks; None: the report has no time of day.
        took_s: Time for reading, measuring and checking [s].
        each_s: Time for each check [s], in the order of the results.
    """

    file: str
    results: tuple[CheckResult, ...]
    metrics: Mapping[str, Metric] = field(default_factory=dict)
    details: Mapping[str, str] = field(default_factory=dict)
    started: datetime | None = None
    took_s: float = 0.0
    each_s: tuple[float, ...] = ()


def format_junit(files: Sequence[CheckedFile]) -> str:
    """Return results as JUnit XML, with the times of the files."""
    took_s = sum(found.took_s for found in files)
    counts = _count([result for found in files for result in found.results])
    root = Xml.Element("testsuites", {**counts, "time": f"{took_s:.3f}"})
    root.set("name", "turtlelog check")
    for found in files:
        root.append(_build_suite(found))
    Xml.indent(root)
    text = Xml.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{text}\n'


def _build_suite(found: CheckedFile) -> Xml.Element:
    suite = Xml.Element("testsuite", {"name": _clean(found.file), **_count(found.results)})
    suite.set("time", f"{found.took_s:.3f}")
    if found.started is not None:
        suite.set("timestamp", found.started.isoformat(timespec="seconds"))
    if found.metrics:
        properties = Xml.SubElement(suite, "properties")
        for metric in found.metrics.values():
            value = metric.status.value if metric.value is None else repr(metric.value)
            name = metric.id if metric.unit == "1" else f"{metric.id} [{metric.unit}]"
            Xml.SubElement(properties, "property", {"name": name, "value": value})
    each_s = found.each_s or (0.0,) * len(found.results)
    for result, took_s in zip(found.results, each_s, strict=True):
        suite.append(_build_case(result, found.details.get(result.check, ""), took_s))
    return suite


def _build_case(result: CheckResult, details: str, took_s: float) -> Xml.Element:
    names = {"name": _clean(result.check), "classname": _clean(result.file)}
    case = Xml.Element("testcase", {**names, "time": f"{took_s:.3f}"})
    if result.verdict is Verdict.SKIPPED:
        Xml.SubElement(case, "skipped", {"message": _clean(result.reason)})
    if result.verdict is Verdict.FAIL:
        message = _clean(describe_result(result))
        failure = Xml.SubElement(case, "failure", {"message": message, "type": "check"})
        failure.text = _clean(details or message)
    return case


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
