"""What `turtlelog check` prints."""

import re
import shlex
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import TYPE_CHECKING, Final

import turtlelog as tl
from turtlelog.cli.output import fill_lines, fit_table, print_json, print_tables, print_verdicts
from turtlelog.display import format_number, format_short, show_angle
from turtlelog.escapes import escape_controls

if TYPE_CHECKING:
    from turtlelog import Spec
    from turtlelog.check import CheckResult, Verdict
    from turtlelog.compare import Table
    from turtlelog.compare.table import Cell


_MOST_FILES: Final = 20
"""Recordings whose checks are held in memory. Of more, checks are counted."""

_MOST_FAILURES: Final = 40
"""Failures that are shown of several recordings: a screen of rows, and one of reasons."""

_MOST_NAMES: Final = 8
"""Recordings that are named as those in which checks fail."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultAnswer:
    """A check of a recording.

    Attributes:
        file: The recording.
        check: Name of the check.
        verdict: PASS, FAIL or SKIPPED.
        expected: Expected formula or tolerance.
        value: Measured value.
        limit: Limit of the value.
        margin: Distance of the value to the limit; negative beyond it.
        unit: Unit of these three.
        value_s: Time of the value [s].
        decided_by: The part of the formula that decides.
        first_violation_s: Time of the first violation [s].
        reason: Why a check fails or is skipped.
        decided: Whether there was enough to judge.
        why: Why the run differs from its reference, in lines; empty without a reference.
    """

    file: str
    check: str
    verdict: str
    expected: str | None
    value: float | None
    limit: float | None
    margin: float | None
    unit: str | None
    value_s: float | None
    decided_by: str | None
    first_violation_s: float | None
    reason: str | None
    decided: bool
    why: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckAnswer:
    """The verdict on all recordings, and every check of each."""

    verdict: str
    results: list[ResultAnswer]


def build_results(results: "Iterable[CheckResult]") -> list[ResultAnswer]:
    """Return results as the answer has them."""
    return [
        ResultAnswer(
            file=result.file,
            check=result.check,
            verdict=result.verdict.value,
            expected=result.expected or None,
            value=result.value,
            limit=result.limit,
            margin=result.margin,
            unit=result.unit or None,
            value_s=result.value_s,
            decided_by=result.decided_by or None,
            first_violation_s=result.first_violation_s,
            reason=result.reason or None,
            decided=result.is_decided,
            why=result.why,
        )
        for result in results
    ]


def print_results(
    spec: "Spec",
    results: "Iterable[CheckResult]",
    *,
    files: int,
    kind: str = "txt",
    shows_all: bool = False,
) -> "Verdict":
    """Print the verdict and what fails, and return the verdict.

    Args:
        spec: Says why a bound is what it is.
        results: Results of all files, in their order; of many they are counted as they come.
        files: Number of files.
        kind: As `FormatOptions` chooses; a file of values has rows and nothing else.
        shows_all: Print what passes, too.
    """
    if kind == "txt" and files > _MOST_FILES:
        counted = CountedResults(results)
        print_verdicts(_format_many(counted, files=files, spec=spec, shows_all=shows_all))
        return counted.verdict
    results = [*results]
    verdict = tl.check.join_verdicts(results)
    if kind == "json":
        print_json(CheckAnswer(verdict=verdict.value, results=build_results(results)))
    elif kind == "csv":
        print_tables([_tabulate_values(spec, results)], kind)
    elif kind == "txt":
        print_verdicts(format_results(results, files=files, spec=spec, shows_all=shows_all))
    else:
        tables = [*_tabulate_files(results), *_tabulate_matrix(results)]
        notes = (conclude(CountedResults(results), files), *_list_reasons(spec, results))
        print_tables([*tables[:-1], replace(tables[-1], notes=notes)], kind)
    return verdict


def print_marks(results: "Iterable[CheckResult]") -> "Verdict":
    """Print a line for each recording as its checks are judged, and return the verdict of all."""
    from turtlelog.check.result import decide_verdict

    counted = []
    for file, of_file in groupby(results, key=lambda result: result.file):
        found = CountedResults(of_file)
        counted.append(found.verdict)
        passed = found.verdicts[tl.check.Verdict.PASS]
        total = found.verdicts.total()
        print_verdicts(f"{found.verdict}  {file}: {passed} of {_count(total, 'check')} passed")
    return decide_verdict(Counter(counted))


def format_results(
    results: "Sequence[CheckResult]",
    *,
    files: int,
    spec: "Spec | None" = None,
    shows_all: bool = False,
) -> str:
    """Return the verdict, then what fails.

    Args:
        results: Results of all files, in their order.
        files: Number of files.
        spec: Says why a bound is what it is; None: nothing is said of bounds.
        shows_all: Return what passes, too.
    """
    counted = CountedResults(results)
    if files > 1 and not shows_all:
        return _format_many(counted, files=files, spec=spec)
    shown = [*results] if shows_all else [one for one in results if one.verdict != "PASS"]
    valued = shown if shows_all else [one for one in shown if one.value is not None]
    tables = [*_tabulate_files(valued), *(_tabulate_matrix(shown) if shows_all else ())]
    tables = [replace(table, title="") for table in tables] if files == 1 else tables
    lines = [*_list_reasons(spec, shown)]
    return _join(counted, files, tables, lines, _list_next(counted, spec, shows_all=shows_all))


def _format_many(
    counted: "CountedResults", *, files: int, spec: "Spec | None", shows_all: bool = False
) -> str:
    """Return the verdict, how often each check fails, and in which recordings."""
    tables = [_count_checks(counted, shows_all=shows_all)]
    if shows_all:
        tables.append(_tabulate(counted.failures, "Failures", names_file=True))
    lines = [*_list_failing(counted), *_list_reasons(spec, counted.failures)]
    more = counted.verdicts[tl.check.Verdict.FAIL] - len(counted.failures)
    if more:
        lines.append(f"{more} more failures are not shown: --csv and --json show them")
    tables = [table for table in tables if table.rows]
    return _join(counted, files, tables, lines, _list_next(counted, spec, shows_all=shows_all))


def _join(
    counted: "CountedResults",
    files: int,
    tables: "Sequence[Table]",
    lines: Sequence[str],
    rest: Iterable[str],
) -> str:
    """Return the verdict and its parts, an empty line between them."""
    blocks = [fit_table(table).strip("\n") for table in tables]
    ends = [fill_lines(lines, indent=2)] if lines else []
    ends += ["\n".join(map(escape_controls, following))] if (following := [*rest]) else []
    return "\n\n".join([conclude(counted, files), *blocks, *ends])


def conclude(counted: "CountedResults", files: int) -> str:
    """Return the verdict, and of how many checks, in one line."""
    verdicts, verdict = counted.verdicts, counted.verdict
    total = verdicts.total()
    failed, skipped = verdicts[tl.check.Verdict.FAIL], verdicts[tl.check.Verdict.SKIPPED]
    place = counted.file if files == 1 and counted.file else f"{files} recordings"
    rest = f", {skipped} {_is_or_are(skipped)} skipped" if skipped else ""
    if failed and total == 1:
        (one,) = counted.failures
        text = f"{one.check} fails, {_tell_value(one)}"
    elif failed:
        verb = "fails" if failed == 1 else "fail"
        lacking = f", {counted.valueless} of them without a value" if counted.valueless else ""
        names = _name_failing(counted)
        text = f"{failed} of {_count(total, 'check')} {verb} ({names}){lacking}{rest}"
    elif verdict == "SKIPPED":
        return f"{verdict}: no check was judged in {place}: {skipped} {_is_or_are(skipped)} skipped"
    elif skipped:
        passed = verdicts[tl.check.Verdict.PASS]
        verb = "passes" if passed == 1 else "pass"
        text = f"{passed} of {_count(total, 'check')} {verb}{rest}"
    elif total == 1:
        text = ", ".join(["the check passes", *map(_tell_value, counted.nearest.values())])
    else:
        text = f"all {total} checks pass"
    return f"{verdict}: {escape_controls(place)}: {text}"


def _name_failing(counted: "CountedResults") -> str:
    """Return the first check that fails, with its value or how many more there are."""
    names = [check for check, found in counted.of_checks.items() if found[tl.check.Verdict.FAIL]]
    first = escape_controls(names[0])
    if counted.verdicts[tl.check.Verdict.FAIL] == 1:
        return f"{first}, {_tell_value(counted.failures[0])}"
    return first if len(names) == 1 else f"{first} and {len(names) - 1} more"


def _tell_value(result: "CheckResult") -> str:
    if result.value is None:
        return "it has no value"
    return f"value {format_short(result.value, result.unit)}"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _is_or_are(number: int) -> str:
    return "is" if number == 1 else "are"


def _list_failing(counted: "CountedResults") -> Iterator[str]:
    """Yield in which recordings checks fail, the first of many."""
    if counted.failing:
        names = ", ".join(f"{file} ({count})" for file, count in counted.failing.items())
        more = counted.failing_files - len(counted.failing)
        rest = f" and {more} more" if more else ""
        yield f"Recordings in which checks fail, and how many: {names}{rest}"


def _list_next(counted: "CountedResults", spec: "Spec | None", *, shows_all: bool) -> Iterator[str]:
    """Yield the smallest margins where all pass, bounds to think about, and what to do next."""
    observed = 0 if spec is None else sum(check.is_observed for check in spec.checks)
    if counted.verdict == "PASS" and (found := counted.find_smallest()) is not None:
        margin = format_number(found.margin, found.unit)
        limit = format_number(found.limit, found.unit)
        yield f"Nearest to its limit: {found.check}, margin {margin}, limit {limit}"
    if spec is not None and observed:
        were = "1 bound was" if observed == 1 else f"{observed} bounds were"
        yield f"{were} read off a good run: look at observed = true in {spec.source}"
    if spec is None:
        return
    measured = next((one for one in counted.failures if one.value is not None), None)
    if measured is not None:
        yield f"Why? {_advise(measured, spec)}"
    if not shows_all and counted.verdicts.total() > 1:
        yield "All checks with their margins: --all"


def _advise(failed: "CheckResult", spec: "Spec") -> str:
    """Return the command that says more of a check that fails."""
    file = shlex.quote(failed.file)
    formulas = (check.formula for check in spec.checks if check.name == failed.check)
    is_error = any(name.startswith(("ate.", "rpe.")) for one in formulas for name in one.names)
    if spec.reference is not None and is_error:
        reference = shlex.quote(str(spec.reference))
        return f"turtlelog compare {file} --reference {reference} --ate --plot FILE.pdf"
    return f"turtlelog explain {file}"


class CountedResults:
    """Results counted one by one: memory does not grow with them.

    Attributes:
        verdicts: Number of each verdict.
        of_checks: Likewise, by check.
        nearest: The one of each check that is nearest to its limit, or the furthest beyond it.
        failures: The first that fail.
        valueless: Number of checks that failed for lack of a value.
        failing: Number of failed checks in each of the first files that fail.
        failing_files: In how many files any does.
        file: The first.
    """

    def __init__(self, results: "Iterable[CheckResult]") -> None:
        """Count results as they come."""
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
        """Return the one that is nearest to its limit, as a part of the limit."""
        parts = [
            (one.margin / abs(one.limit), number)
            for number, one in enumerate(self.nearest.values())
            if one.margin is not None and one.limit
        ]
        return [*self.nearest.values()][min(parts)[1]] if parts else None

    @property
    def verdict(self) -> "Verdict":
        """The verdict of all of them."""
        from turtlelog.check.result import decide_verdict

        return decide_verdict(self.verdicts)


def _count_checks(counted: CountedResults, *, shows_all: bool) -> "Table":
    """Return how often each check passes, and where it is nearest to its limit, or beyond.

    Of those that fail nowhere only where all are asked for.
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
    return tl.compare.Table(
        title="Checks" if shows_all else "Checks that fail",
        columns=tuple(tl.compare.Column(title=title) for title in titles),
        rows=tuple(_count_check(check, counted, verdicts) for check in shown),
    )


def _count_check(
    check: str, counted: CountedResults, verdicts: "Iterable[Verdict]"
) -> "tuple[Cell, ...]":
    counts = tuple(counted.of_checks[check][name] for name in verdicts)
    nearest = counted.nearest.get(check)
    if nearest is None:
        return (check, *counts, None, None, None)
    unit, *_, margin = _show(nearest)
    return (check, *counts, unit, margin, nearest.file)


def _tabulate_files(results: "Sequence[CheckResult]") -> "list[Table]":
    """Return a table per file, in the order of the first result of each."""
    files = dict.fromkeys(result.file for result in results)
    return [_tabulate([one for one in results if one.file == file], file) for file in files]


_HEADS: Final = ("verdict", "file", "check", "unit", "value", "limit", "margin")
_VIOLATED: Final = "first violation"
"""The column [s] behind `_HEADS`; a table for a terminal has it where a check is violated."""


def _tabulate(results: "Sequence[CheckResult]", title: str, *, names_file: bool = False) -> "Table":
    columns = [tl.compare.Column(title="" if head == "verdict" else head) for head in _HEADS]
    if any(result.first_violation_s is not None for result in results):
        lines = tuple(_VIOLATED.split())
        columns.append(tl.compare.Column(title=_VIOLATED, unit="s", digits=3, lines=lines))
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
    """Yield why checks fail or are skipped, where their rows do not say it."""
    meant = {} if spec is None else _read_reasons(spec)
    found: dict[tuple[str, str, str], list[str]] = {}
    for result in results:
        if not _is_told_by_row(result, meant) and (reason := _explain(result, meant)):
            alike = result.verdict, result.file, reason.removeprefix(f"{result.check}: ")
            found.setdefault(alike, []).append(result.check)
    for (verdict, file, reason), checks in found.items():
        yield f"{verdict} {file}: {', '.join(checks)}: {reason}"
    for result in results:
        if result.why:
            yield f"WHY {result.file}: {result.why[0]}"
            yield from (f"  {line}" for line in result.why[1:])


def _is_told_by_row(result: "CheckResult", meant: Mapping[str, str]) -> bool:
    """Whether its name, value and limit say why a check fails: it has no other reason."""
    is_named = result.expected.startswith(result.check)
    is_plain = not (result.reason or result.decided_by or meant.get(result.check))
    return is_named and is_plain and result.value is not None and result.limit is not None


def _explain(result: "CheckResult", meant: Mapping[str, str]) -> str:
    """Return why a result is what it is, empty if it simply passes; `meant` is why of bounds."""
    why = f" ({meant[result.check]})" if meant.get(result.check) else ""
    if result.reason:
        return result.reason + (why if result.verdict == "FAIL" and result.is_decided else "")
    if result.verdict != "FAIL":
        return ""
    by = f"; decided by {result.decided_by}" if result.decided_by else ""
    return f"expected {result.expected}{why}{by}"


def _read_reasons(spec: "Spec") -> dict[str, str]:
    """Return why bounds are what they are, by the names of checks; not of those read off a run."""
    tolerances = {
        **{f"signals.{name}": found for name, found in spec.tolerances.signals.items()},
        **{f"metrics.{name}": found for name, found in spec.tolerances.metrics.items()},
    }
    bounds = {found.name: found.reason for found in spec.checks if not found.is_observed}
    return bounds | {name: found.reason for name, found in tolerances.items()}
