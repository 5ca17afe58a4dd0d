"""What `turtlelog check` prints."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import turtlelog as tl
from turtlelog.cli.output import format_table, print_json, print_tables, print_verdicts
from turtlelog.display import show_angle
from turtlelog.escapes import escape_controls

if TYPE_CHECKING:
    from turtlelog import CheckResult, Spec
    from turtlelog.check import Verdict
    from turtlelog.compare import Table
    from turtlelog.compare.table import Cell


_MOST_FILES: Final = 20
"""Recordings whose checks are all shown: a table for each fills some ten screens. Of more, checks
are counted, and failures are shown."""

_MOST_FAILURES: Final = 40
"""Failures that are shown then: a screen of rows, and one of reasons."""


def describe_results(verdict: str, results: "Sequence[CheckResult]") -> dict[str, Any]:
    """Return results as the JSON answer."""
    return {
        "verdict": verdict,
        "results": [
            {
                "file": result.file,
                "check": result.check,
                "verdict": result.verdict.value,
                "expected": result.expected or None,
                "value": result.value,
                "limit": result.limit,
                "margin": result.margin,
                "unit": result.unit or None,
                "value_s": result.value_s,
                "decided_by": result.decided_by or None,
                "first_violation_s": result.first_violation_s,
                "reason": result.reason or None,
                "decided": result.is_decided,
            }
            for result in results
        ],
    }


def print_results(
    spec: "Spec", results: "Iterable[CheckResult]", *, files: int, kind: str = "txt"
) -> "Verdict":
    """Print a table per file, of several files the verdicts as a matrix, and return the verdict.

    Args:
        spec: Says why a bound is what it is.
        results: Of all files, in their order; of many they are counted as they come.
        files: How many there are.
        kind: As `FormatOptions` chooses; a file of values has rows and nothing else.
    """
    if kind == "txt" and files > _MOST_FILES:
        counted = CountedResults(results)
        print_verdicts(_format_counted(counted, files=files, spec=spec))
        return counted.verdict
    results = [*results]
    verdict = tl.check.join_verdicts(results)
    if kind == "json":
        print_json(describe_results(verdict, results))
    elif kind == "csv":
        print_tables([_tabulate_values(spec, results)], kind)
    elif kind == "txt":
        print_verdicts(format_results(results, files=files, spec=spec))
    else:
        tables = [*_tabulate_files(results), *_tabulate_matrix(results)]
        notes = (*_list_reasons(spec, results), _summarise(CountedResults(results), files=files))
        print_tables([*tables[:-1], replace(tables[-1], notes=notes)], kind)
    return verdict


def format_results(
    results: "Sequence[CheckResult]", *, files: int, spec: "Spec | None" = None
) -> str:
    """Return what is printed of results in the order of files.

    Args:
        results: Of all files.
        files: How many there are.
        spec: Says why a bound is what it is; None: what passes is left out.
    """
    failed = [result for result in results if result.verdict == "FAIL"]
    shown = failed if spec is None else [*results]
    tables = [*_tabulate_files(shown), *_tabulate_matrix(shown)]
    lines = [*_list_reasons(spec, shown), *_list_worst(shown)]
    return _join(tables, lines, _summarise(CountedResults(results), files=files))


def _format_counted(counted: "CountedResults", *, files: int, spec: "Spec") -> str:
    """Return how often each check passes, the first failures, and how many there are."""
    shown = counted.failures
    tables = [_count_checks(counted, files=files)]
    tables += [_tabulate(shown, "Failures", names_file=True)] if shown else []
    failed = counted.verdicts[tl.check.Verdict.FAIL]
    more = failed - len(shown)
    lines = [*_list_reasons(spec, shown)]
    if more:
        lines.append(f"{more} of {failed} failures are not shown: --csv and --json show them")
    return _join(tables, lines, _summarise(counted, files=files))


def _join(tables: "Sequence[Table]", lines: Sequence[str], summary: str) -> str:
    parts = ["Checks; times from the first sample"] if tables else []
    parts += [format_table(table).rstrip("\n") for table in tables]
    parts += ["\n".join(map(escape_controls, lines))] if lines else []
    return "\n\n".join([*parts, summary])


class CountedResults:
    """Results counted one by one: memory does not grow with them.

    Attributes:
        verdicts: How many there are of each.
        of_checks: Likewise, by check.
        nearest: The one of each check that is nearest to its limit, or the furthest beyond it.
        failures: The first that fail.
    """

    def __init__(self, results: "Iterable[CheckResult]") -> None:
        """Count results as they come."""
        self.verdicts: Counter[Verdict] = Counter()
        self.of_checks: dict[str, Counter[Verdict]] = {}
        self.nearest: dict[str, CheckResult] = {}
        self.failures: list[CheckResult] = []
        for result in results:
            self._count(result)

    def _count(self, result: "CheckResult") -> None:
        self.verdicts[result.verdict] += 1
        self.of_checks.setdefault(result.check, Counter())[result.verdict] += 1
        if result.margin is not None:
            nearest = self.nearest.setdefault(result.check, result)
            if result.margin < (nearest.margin or 0.0):
                self.nearest[result.check] = result
        if result.verdict == "FAIL" and len(self.failures) < _MOST_FAILURES:
            self.failures.append(result)

    @property
    def verdict(self) -> "Verdict":
        """The verdict of all of them."""
        from turtlelog.check.result import decide_verdict

        return decide_verdict(self.verdicts)


def _count_checks(counted: CountedResults, *, files: int) -> "Table":
    """Return how often each check passes, and where it is nearest to its limit, or beyond."""
    titles = ("check", "PASS", "FAIL", "SKIPPED", "unit", "least margin", "file")
    return tl.compare.Table(
        title=f"{files} recordings, {len(counted.of_checks)} checks",
        columns=tuple(tl.compare.Column(title=title) for title in titles),
        rows=tuple(_count_check(check, counted) for check in counted.of_checks),
    )


def _count_check(check: str, counted: CountedResults) -> "tuple[Cell, ...]":
    verdicts = counted.of_checks[check]
    counts = tuple(verdicts[name] for name in tl.check.Verdict)
    nearest = counted.nearest.get(check)
    if nearest is None:
        return (check, *counts, None, None, None)
    unit, *_, margin = _show(nearest)
    return (check, *counts, unit, margin, nearest.file)


def _summarise(counted: CountedResults, *, files: int) -> str:
    words = zip(tl.check.Verdict, ("pass", "fail", "skipped"), strict=True)
    counts = [f"{counted.verdicts[verdict]} {word}" for verdict, word in words]
    recordings = "1 recording" if files == 1 else f"{files} recordings"
    return f"{counted.verdict}: {recordings}, {', '.join(counts)}"


def _tabulate_files(results: "Sequence[CheckResult]") -> "list[Table]":
    """Return a table per file, in the order of the first result of each."""
    files = dict.fromkeys(result.file for result in results)
    return [_tabulate([one for one in results if one.file == file], file) for file in files]


_HEADS: Final = ("verdict", "file", "check", "unit", "value", "limit", "margin")
_VIOLATED: Final = "violated"
"""The column [s] behind `_HEADS`; a table for a terminal has it where a check is violated."""


def _tabulate(results: "Sequence[CheckResult]", title: str, *, names_file: bool = False) -> "Table":
    columns = [tl.compare.Column(title="" if head == "verdict" else head) for head in _HEADS]
    if any(result.first_violation_s is not None for result in results):
        columns.append(tl.compare.Column(title=_VIOLATED, unit="s", digits=3))
    rows = [_list_cells(result) for result in results]
    if names_file:
        columns[0] = tl.compare.Column(title="verdict")
        return tl.compare.Table(
            title=title,
            columns=tuple(columns),
            rows=tuple(row[: len(columns)] for row in rows),
        )
    del columns[1]
    return tl.compare.Table(
        title=title,
        columns=tuple(columns),
        rows=tuple((row[0], *row[2 : len(columns) + 1]) for row in rows),
    )


def _tabulate_values(spec: "Spec", results: "Sequence[CheckResult]") -> "Table":
    """Return the rows of a file of values: the same columns whatever was found."""
    meant = _read_reasons(spec)
    columns = [tl.compare.Column(title=head) for head in _HEADS]
    columns += [
        tl.compare.Column(title=_VIOLATED, unit="s"),
        tl.compare.Column(title="reason"),
    ]
    return tl.compare.Table(
        title="Checks",
        columns=tuple(columns),
        rows=tuple((*_list_cells(one), _explain(one, meant)) for one in results),
    )


def _list_cells(result: "CheckResult") -> "tuple[Cell, ...]":
    """Return the cells below `_HEADS`, and when the check is first violated [s]."""
    verdict = result.verdict.value
    return verdict, result.file, result.check, *_show(result), result.first_violation_s


def _tabulate_matrix(results: "Sequence[CheckResult]") -> "list[Table]":
    """Return the verdicts of several files, a row for each; nothing for one file."""
    files = dict.fromkeys(result.file for result in results)
    checks = dict.fromkeys(result.check for result in results)
    verdicts = {(result.file, result.check): result.verdict.value for result in results}
    if len(files) < 2:
        return []
    heads = [tl.compare.Column(title=name, lines=tuple(re.split("[._]", name))) for name in checks]
    return [
        tl.compare.Table(
            title=f"{len(files)} recordings, {len(checks)} checks",
            columns=(tl.compare.Column(title="file"), *heads),
            rows=tuple(
                (file, *(verdicts.get((file, check)) for check in checks)) for file in files
            ),
        )
    ]


def _show(result: "CheckResult") -> "tuple[str, float | None, float | None, float | None]":
    """Return unit, value, limit and margin as they are printed: angles in degrees."""
    found = (result.value, result.limit, result.margin)
    value, limit, margin = (v if v is None else show_angle(v, result.unit)[0] for v in found)
    return show_angle(0.0, result.unit)[1], value, limit, margin


def _list_reasons(spec: "Spec | None", results: "Sequence[CheckResult]") -> Iterator[str]:
    meant = {} if spec is None else _read_reasons(spec)
    for result in results:
        if reason := _explain(result, meant):
            yield f"{result.verdict} {result.file}: {result.check}: {reason}"
    observed = 0 if spec is None else sum(check.is_observed for check in spec.checks)
    if spec is not None and observed:
        count = "1 bound was" if observed == 1 else f"{observed} bounds were"
        yield f"{count} read off a good run: look at observed = true in {spec.source}"


def _explain(result: "CheckResult", meant: Mapping[str, str]) -> str:
    """Return why a result is what it is, empty where it simply passes; `meant` is why of bounds."""
    why = f" ({meant[result.check]})" if meant.get(result.check) else ""
    if result.reason:
        return result.reason + (why if result.verdict == "FAIL" and result.is_decided else "")
    if result.verdict != "FAIL":
        return ""
    by = f"; decided by {result.decided_by}" if result.decided_by else ""
    return f"expected {result.expected}{why}{by}"


def _read_reasons(spec: "Spec") -> dict[str, str]:
    """Return why each bound is what it is, by the name of the check."""
    tolerances = {
        **{f"signals.{name}": found for name, found in spec.tolerances.signals.items()},
        **{f"metrics.{name}": found for name, found in spec.tolerances.metrics.items()},
    }
    return {found.name: found.reason for found in spec.checks} | {
        name: found.reason for name, found in tolerances.items()
    }


def _list_worst(results: "Sequence[CheckResult]") -> Iterator[str]:
    from turtlelog.check.result import find_worst

    worst = find_worst(results)
    if worst:
        yield "Worst margins"
    for result in worst:
        margin = tl.display.format_number(result.margin, result.unit)
        yield f"  {margin:>12}  {result.check}  {result.file}"
