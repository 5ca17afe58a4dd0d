"""Counts of check results, their tables, and the reasons of failures."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Final

import turtlelog as tl
from turtlelog.cli.output import build_table
from turtlelog.display import show_angle

if TYPE_CHECKING:
    from turtlelog import Spec
    from turtlelog.check import CheckResult, Verdict
    from turtlelog.compare import Column, Table
    from turtlelog.compare.table import Cell


_MOST_FAILURES: Final = 40
"""Largest number of failures that are shown for several recordings: a screen of rows, and one of
reasons."""

_MOST_NAMES: Final = 8
"""Largest number of recordings that are named as failing."""


class CountedResults:
    """Results counted one by one, so that memory does not grow with them.

    Attributes:
        verdicts: Number of each verdict.
        of_checks: Number of each verdict, by check.
        nearest: For each check, the result nearest to its limit, or furthest beyond it.
        failures: First failed results.
        valueless: Number of checks that failed because a value is missing.
        failing: Number of failed checks in each of the first failing files.
        failing_files: Number of files with a failed check.
        file: First file.
    """

    def __init__(self, results: "Iterable[CheckResult]") -> None:
        """Count results one by one."""
        self.verdicts: Counter[Verdict] = Counter()
        self.of_checks: dict[str, Counter[Verdict]] = {}
        self.nearest: dict[str, CheckResult] = {}
        self.failures: list[CheckResult] = []
        self.valueless = 0
        self.failing: dict[str, int] = {}
        self.failing_files = 0
        self._latest = ""
        self.file = ""
        for result in results:
            self._count(result)

    def _count(self, result: "CheckResult") -> None:
        self.file = self.file or result.file
        self.verdicts[result.verdict] += 1
        self.of_checks.setdefault(result.check, Counter())[result.verdict] += 1
        if result.margin is not None:
            nearest = self.nearest.setdefault(result.check, result)
            if result.margin < (nearest.margin or 0.0):
                self.nearest[result.check] = result
        if result.verdict == "FAIL":
            self._count_failure(result)

    def _count_failure(self, result: "CheckResult") -> None:
        self.valueless += result.value is None
        self.failing_files += result.file != self._latest
        self._latest = result.file
        if result.file in self.failing or len(self.failing) < _MOST_NAMES:
            self.failing[result.file] = self.failing.get(result.file, 0) + 1
        if len(self.failures) < _MOST_FAILURES:
            self.failures.append(result)

    def find_smallest(self) -> "CheckResult | None":
        """Return the result nearest to its limit, or furthest beyond, in proportion.

        The margin counts relative to the larger of value and limit, as a limit may be 0.
        """
        parts = [
            (one.margin / max(abs(one.limit), abs(one.value or 0.0)), number)
            for number, one in enumerate(self.nearest.values())
            if one.margin is not None and one.limit is not None and (one.limit or one.value)
        ]
        return [*self.nearest.values()][min(parts)[1]] if parts else None

    @property
    def verdict(self) -> "Verdict":
        """The joint verdict of all results."""
        from turtlelog.check.result import decide_verdict

        return decide_verdict(self.verdicts)


def count_checks(counted: CountedResults, *, shows_all: bool) -> "Table":
    """Return the number of passes of each check, and its result nearest to the limit.

    Checks that never fail are included only with `shows_all`.
    """
    verdicts = [
        one for one in tl.check.Verdict if one != "SKIPPED" or shows_all or counted.verdicts[one]
    ]
    titles = ("check", *verdicts, "unit", "least margin", "file")
    shown = [
        check
        for check, verdicts in counted.of_checks.items()
        if shows_all or verdicts[tl.check.Verdict.FAIL]
    ]
    rows = (_count_check(check, counted, verdicts) for check in shown)
    return build_table("Checks" if shows_all else "Checks that fail", titles, rows)


def _count_check(
    check: str, counted: CountedResults, verdicts: "Iterable[Verdict]"
) -> "tuple[Cell, ...]":
    counts = tuple(counted.of_checks[check][name] for name in verdicts)
    nearest = counted.nearest.get(check)
    if nearest is None:
        return (check, *counts, None, None, None)
    unit, *_, margin = _show(nearest)
    return (check, *counts, unit, margin, nearest.file)


def tabulate_files(results: "Sequence[CheckResult]") -> "list[Table]":
    """Return a table per file, in the order of the first result of each."""
    files = dict.fromkeys(result.file for result in results)
    return [tabulate_checks([one for one in results if one.file == file], file) for file in files]


_HEADS: Final = ("verdict", "file", "check", "unit", "value", "limit", "margin")

_VIOLATED: Final = "first violation"
"""Column [s] after `_HEADS`, which terminal tables have if a check is violated."""


def tabulate_checks(
    results: "Sequence[CheckResult]", title: str, *, names_file: bool = False
) -> "Table":
    """Return results as rows: verdict, optionally file, check, value, limit and margin."""
    heads: list[str | Column] = [*_HEADS]
    if any(result.first_violation_s is not None for result in results):
        lines = tuple(_VIOLATED.split())
        heads.append(tl.compare.Column(title=_VIOLATED, unit="s", digits=3, lines=lines))
    rows = [_list_cells(result)[: len(heads)] for result in results]
    if names_file:
        return build_table(title, heads, rows)
    return build_table(title, ["", *heads[2:]], ((row[0], *row[2:]) for row in rows))


def tabulate_values(spec: "Spec", results: "Sequence[CheckResult]") -> "Table":
    """Return the rows of a CSV file, whose columns are always the same."""
    meant = _read_reasons(spec)
    rows = ((*_list_cells(one), _explain(one, meant)) for one in results)
    return build_table("Checks", (*_HEADS, f"{_VIOLATED} [s]", "reason"), rows)


def _list_cells(result: "CheckResult") -> "tuple[Cell, ...]":
    """Return the cells of `_HEADS`, and the time of the first violation [s]."""
    verdict = result.verdict.value
    return verdict, result.file, result.check, *_show(result), result.first_violation_s


def tabulate_matrix(results: "Sequence[CheckResult]") -> "list[Table]":
    """Return the verdicts of several files, one row each; empty for one file."""
    files = dict.fromkeys(result.file for result in results)
    checks = dict.fromkeys(result.check for result in results)
    verdicts = {(result.file, result.check): result.verdict.value for result in results}
    if len(files) < 2:
        return []
    heads = [tl.compare.Column(title=name, lines=tuple(re.split("[._]", name))) for name in checks]
    rows = ((file, *(verdicts.get((file, check)) for check in checks)) for file in files)
    title = f"{len(files)} recordings, {len(checks)} checks"
    return [build_table(title, ["file", *heads], rows)]


def _show(result: "CheckResult") -> "tuple[str, float | None, float | None, float | None]":
    """Return unit, value, limit and margin for display, angles in degrees."""
    found = (result.value, result.limit, result.margin)
    value, limit, margin = (v if v is None else show_angle(v, result.unit)[0] for v in found)
    return show_angle(0.0, result.unit)[1], value, limit, margin


def list_verdict_reasons(spec: "Spec | None", results: "Sequence[CheckResult]") -> Iterator[str]:
    """Yield the reasons of failed or skipped checks, if their rows do not show them."""
    meant = {} if spec is None else _read_reasons(spec)
    found: dict[tuple[str, str, str], list[str]] = {}
    for result in results:
        if not _is_told_by_row(result, meant) and (reason := _explain(result, meant)):
            alike = result.verdict, result.file, reason.removeprefix(f"{result.check}: ")
            found.setdefault(alike, []).append(result.check)
    for (verdict, file, reason), checks in found.items():
        yield f"{verdict} {file}: {', '.join(checks)}: {reason}"


def list_failure_reasons(results: "Sequence[CheckResult]") -> Iterator[str]:
    """Yield why runs differ from their reference, as far as it was determined."""
    for result in results:
        if result.why:
            yield f"WHY {result.file} against its reference: {result.why[0]}"
            yield from (f"  {line}" for line in result.why[1:])


def _is_told_by_row(result: "CheckResult", meant: Mapping[str, str]) -> bool:
    """Return whether name, value and limit explain a failure, so that it has no other reason."""
    is_named = result.expected.startswith(result.check)
    is_plain = not (result.reason or result.decided_by or meant.get(result.check))
    return is_named and is_plain and result.value is not None and result.limit is not None


def _explain(result: "CheckResult", meant: Mapping[str, str]) -> str:
    """Return the reason of a result; empty for a plain pass. `meant` contains reasons of bounds."""
    why = f" ({meant[result.check]})" if meant.get(result.check) else ""
    if result.reason:
        return result.reason + (why if result.verdict == "FAIL" and result.is_decided else "")
    if result.verdict != "FAIL":
        return ""
    by = f"; decided by {result.decided_by}" if result.decided_by else ""
    return f"expected {result.expected}{why}{by}"


def _read_reasons(spec: "Spec") -> dict[str, str]:
    """Return the reasons of bounds by check, without bounds observed in a run."""
    tolerances = {
        **{f"signals.{name}": found for name, found in spec.tolerances.signals.items()},
        **{f"metrics.{name}": found for name, found in spec.tolerances.metrics.items()},
    }
    bounds = {found.name: found.reason for found in spec.checks if not found.is_observed}
    return bounds | {name: found.reason for name, found in tolerances.items()}
