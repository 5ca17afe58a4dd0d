"""Results of checks as counts, tables, reasons, text and JSON."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import turtlelog as tl
from turtlelog.cli import console
from turtlelog.display import describe_count, format_short, show_angle
from turtlelog.escapes import escape_controls

if TYPE_CHECKING:
    from turtlelog import Spec
    from turtlelog.check import CheckResult, Verdict


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckAnswer:
    """The verdict on all recordings, and every check of each."""

    verdict: str
    results: "Sequence[CheckResult]"


_MOST_FAILURES: Final = 40
"""Largest number of failures that are shown for several recordings: a screen of rows, and one of
reasons."""

_MOST_NAMES: Final = 8
"""Largest number of recordings that are named as failing."""


def _order(result: "CheckResult") -> tuple[bool, bool, float]:
    return result.verdict != "FAIL", result.margin is None, result.margin or 0.0


class CountedResults:
    """Results counted one by one, so that memory does not grow with them.

    Attributes:
        verdicts: Number of each verdict.
        of_checks: Number of each verdict, by check.
        nearest: For each check, the result nearest to its limit, or furthest beyond it; if a file
            fails, a result of a file that fails.
        failures: First failed results.
        told: First checks that pass with a reason, and their reasons.
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
        self.told: dict[tuple[str, str], None] = {}
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
        if result.margin is not None or result.verdict == "FAIL":
            nearest = self.nearest.setdefault(result.check, result)
            self.nearest[result.check] = min(nearest, result, key=_order)
        if result.verdict == "PASS" and result.reason and len(self.told) < _MOST_NAMES:
            self.told[result.check, result.reason] = None
        if result.verdict != "FAIL":
            return
        self.valueless += result.value is None and not result.is_decided
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


def format_results(
    results: "Sequence[CheckResult]",
    *,
    files: int,
    spec: "Spec | None" = None,
    shows_all: bool = False,
    reading: Sequence[str] = (),
) -> str:
    """Return the verdict, then the failed checks. `reading`: options of further commands."""
    counted = CountedResults(results)
    if files > 1 and not shows_all:
        return format_many(counted, files=files, spec=spec, reading=reading)
    shown = [*results] if shows_all else [one for one in results if one.verdict != "PASS"]
    valued = shown if shows_all else [one for one in shown if one.value is not None]
    tables = [*tabulate_files(valued), *(tabulate_matrix(shown) if shows_all else ())]
    tables = [replace(table, title="") for table in tables] if files == 1 else tables
    lines, causes = [*list_verdict_reasons(spec, shown)], [*list_failure_reasons(shown)]
    head = _write_head(counted, files, spec, causes)
    return _join(head, tables, lines, [*_list_next(counted, spec, reading, shows_all=shows_all)])


def format_many(
    counted: CountedResults,
    *,
    files: int,
    spec: "Spec | None",
    shows_all: bool = False,
    reading: Sequence[str] = (),
) -> str:
    """Return the verdict, and for each check the number and the names of failing recordings."""
    tables = [count_checks(counted, shows_all=shows_all)]
    if shows_all:
        tables.append(tabulate_checks(counted.failures, "Failures", names_file=True))
    lines = []
    if counted.failing:
        names = ", ".join(f"{file} ({count})" for file, count in counted.failing.items())
        others = counted.failing_files - len(counted.failing)
        rest = f" and {others} more" if others else ""
        lines.append(f"Recordings in which checks fail, and how many: {names}{rest}")
    lines += list_verdict_reasons(spec, counted.failures)
    lines += list_failure_reasons(counted.failures)
    more = counted.verdicts[tl.check.Verdict.FAIL] - len(counted.failures)
    if more:
        lines.append(f"{more} more failures are not shown: --csv and --json show them")
    tables = [table for table in tables if table.rows]
    head = _write_head(counted, files, spec)
    return _join(head, tables, lines, [*_list_next(counted, spec, reading, shows_all=shows_all)])


def _write_head(
    counted: CountedResults, files: int, spec: "Spec | None", causes: Sequence[str] = ()
) -> str:
    """Return the verdict, facts that qualify it, and why a run differs from its reference."""
    facts = [*_list_facts(counted, spec, files)]
    blocks = [console.fill_lines(facts)] if facts else []
    blocks += [console.fill_lines(causes, indent=2)] if causes else []
    return "\n".join([conclude(counted, files), *blocks])


def _join(
    head: str, tables: "Sequence[tl.compare.Table]", lines: Sequence[str], following: Sequence[str]
) -> str:
    blocks = [console.fit_table(table).strip("\n") for table in tables]
    ends = [console.fill_lines(lines, indent=2)] if lines else []
    ends += ["\n".join(map(escape_controls, following))] if following else []
    return "\n\n".join([head, *blocks, *ends])


def conclude(counted: CountedResults, files: int) -> str:
    """Return the verdict and the number of checks, in one line."""
    verdicts, verdict = counted.verdicts, counted.verdict
    total = verdicts.total()
    failed, skipped = verdicts[tl.check.Verdict.FAIL], verdicts[tl.check.Verdict.SKIPPED]
    place = counted.file if files == 1 and counted.file else f"{files} recordings"
    skips = f"{skipped} {'is' if skipped == 1 else 'are'} skipped"
    rest = f", {skips}" if skipped else ""
    if failed and total == 1:
        (one,) = counted.failures
        text = one.reason if one.is_lost else f"{one.check} fails, {_tell_value(one)}"
    elif failed:
        verb = "fails" if failed == 1 else "fail"
        lacking = f", {counted.valueless} of them without a value" if counted.valueless else ""
        names = _name_failing(counted)
        text = f"{failed} of {describe_count(total, 'check')} {verb}{names}{lacking}{rest}"
    elif verdict == "SKIPPED":
        return f"{verdict}: no check was judged in {place}: {skips}"
    elif skipped:
        passed = verdicts[tl.check.Verdict.PASS]
        verb = "passes" if passed == 1 else "pass"
        text = f"{passed} of {describe_count(total, 'check')} {verb}{rest}"
    elif total == 1:
        text = ", ".join(["the check passes", *map(_tell_value, counted.nearest.values())])
    else:
        text = f"all {total} checks pass"
    return f"{verdict}: {escape_controls(place)}: {text}"


def _name_failing(counted: CountedResults) -> str:
    """Return in brackets the only failed check with its value, or failed checks without limits."""
    if counted.verdicts[tl.check.Verdict.FAIL] == 1:
        one = counted.failures[0]
        told = _tell_value(one, with_limit=False)
        return f" ({escape_controls(one.check)}, {told})"
    if _find_worst(counted) is not None:
        return ""
    names = [check for check, found in counted.of_checks.items() if found[tl.check.Verdict.FAIL]]
    more = f" and {len(names) - 1} more" if len(names) > 1 else ""
    return f" ({escape_controls(names[0])}{more})"


def _find_worst(counted: CountedResults) -> "CheckResult | None":
    """Return the failed check that is furthest beyond its limit, if several fail."""
    several = counted.verdicts[tl.check.Verdict.FAIL] > 1
    if all(one.limit == 0.0 for one in counted.failures):
        return None  # no proportion differs, as in tests of equality
    worst = counted.find_smallest() if several else None
    return worst if worst is not None and worst.verdict == "FAIL" else None


def _list_facts(counted: CountedResults, spec: "Spec | None", files: int) -> Iterator[str]:
    """Yield the check furthest beyond or nearest to its limit, and whether limits are observed."""
    worst = _find_worst(counted)
    if worst is not None:
        place = f" in {escape_controls(worst.file)}" if files > 1 else ""
        check = escape_controls(worst.check)
        yield f"Furthest beyond its limit, in proportion: {check}{place}, {_tell_value(worst)}."
    several = counted.verdicts.total() > 1
    if several and counted.verdict == "PASS" and (nearest := counted.find_smallest()) is not None:
        yield f"Nearest to its limit: {escape_controls(nearest.check)}, {_tell_value(nearest)}."
    yield from (f"{escape_controls(check)}: {reason}." for check, reason in counted.told)
    if spec is not None and (observed := _count_observed(counted, spec)):
        were = "1 failed limit was" if observed == 1 else f"{observed} failed limits were"
        yield f"{were} read off a run, not required: observed = true in {spec.source}"


def _count_observed(counted: CountedResults, spec: "Spec") -> int:
    names = {check.name for check in spec.checks if check.is_observed}
    return sum(
        name in names and found[tl.check.Verdict.FAIL] > 0
        for name, found in counted.of_checks.items()
    )


def _tell_value(result: "CheckResult", *, with_limit: bool = True) -> str:
    if result.value is None and result.is_decided:  # by a text or truth value
        at_s = result.first_violation_s
        return "its value is no number" if at_s is None else f"first violated at {at_s:.3f} s"
    if result.value is None:
        return result.reason if result.is_lost else "it has no value"
    value = f"value {format_short(result.value, result.unit)}"
    if result.limit is None or not with_limit:
        return value
    return f"{value}, limit {format_short(result.limit, result.unit)}"


def _list_next(
    counted: CountedResults, spec: "Spec | None", reading: Sequence[str], *, shows_all: bool
) -> Iterator[str]:
    if spec is None:
        return
    observed = sum(check.is_observed for check in spec.checks)
    if observed and not _count_observed(counted, spec):
        were = "1 bound was" if observed == 1 else f"{observed} bounds were"
        yield f"{were} read off a run: look at observed = true in {spec.source}"
    measured = next((one for one in counted.failures if one.value is not None), None)
    if measured is not None and (advice := _advise(measured, spec, reading)):
        has_cause = any(one.why for one in counted.failures)
        question = "Within the run:" if has_cause else "Why?"
        yield f"{question} {advice}"
    if not shows_all and counted.verdicts.total() > 1:
        yield "All checks with their margins: --all"


def _advise(failed: "CheckResult", spec: "Spec", reading: Sequence[str]) -> str | None:
    formulas = (check.formula for check in spec.checks if check.name == failed.check)
    is_error = any(name.startswith(("ate.", "rpe.")) for one in formulas for name in one.names)
    if spec.reference is not None and is_error:
        from turtlelog.cli.compare_trajectories import list_setting_words

        settings = list_setting_words(spec.trajectory)
        words = console.quote_file(failed.file, "--reference", spec.reference, *settings, *reading)
        return f"turtlelog compare {words} --plot FILE.pdf"
    name = failed.check.removeprefix("metrics.")
    is_metric = tl.measure.find_metric_kind(name) is not None
    option = f" --metric {name}" if is_metric and name != "final.position_error" else ""
    command = console.advise_explain(failed.file, reading)
    return command and f"{command}{option}"


def count_checks(counted: CountedResults, *, shows_all: bool) -> "tl.compare.Table":
    """Return the number of passes of each check, and its worst result with the margin and file.

    Checks that never fail are included only with `shows_all`.
    """
    verdicts = [
        one for one in tl.check.Verdict if one != "SKIPPED" or shows_all or counted.verdicts[one]
    ]
    rows: list[tuple[tl.compare.Cell, ...]] = []
    for check, counts in counted.of_checks.items():
        if shows_all or counts[tl.check.Verdict.FAIL]:
            nearest = counted.nearest.get(check)
            unit, *_, margin = (None,) * 4 if nearest is None else _show(nearest)
            file = None if nearest is None else nearest.file
            rows.append((check, *(counts[one] for one in verdicts), unit, margin, file))
    titles = ("check", *verdicts, "unit", "least margin", "file")
    return console.build_table("Checks" if shows_all else "Checks that fail", titles, rows)


def tabulate_files(results: "Sequence[CheckResult]") -> "list[tl.compare.Table]":
    """Return a table per file, in the order of the first result of each."""
    files = dict.fromkeys(result.file for result in results)
    return [tabulate_checks([one for one in results if one.file == file], file) for file in files]


_HEADS: Final = ("verdict", "file", "check", "unit", "value", "limit", "margin")

_VIOLATED: Final = "first violation"
"""Column [s] after `_HEADS`, which terminal tables have if a check is violated."""


def tabulate_checks(
    results: "Sequence[CheckResult]", title: str, *, names_file: bool = False
) -> "tl.compare.Table":
    """Return results as rows: verdict, optionally file, check, value, limit and margin."""
    heads: list[str | tl.compare.Column] = [*_HEADS]
    if any(result.first_violation_s is not None for result in results):
        lines = tuple(_VIOLATED.split())
        heads.append(tl.compare.Column(title=_VIOLATED, unit="s", digits=3, lines=lines))
    rows = [_list_cells(result)[: len(heads)] for result in results]
    if names_file:
        return console.build_table(title, heads, rows)
    return console.build_table(title, ["", *heads[2:]], ((row[0], *row[2:]) for row in rows))


def tabulate_values(spec: "Spec", results: "Sequence[CheckResult]") -> "tl.compare.Table":
    """Return the rows of a CSV file, whose columns are always the same."""
    meant = _read_reasons(spec)
    rows = ((*_list_cells(one), _explain(one, meant)) for one in results)
    return console.build_table("Checks", (*_HEADS, f"{_VIOLATED} [s]", "reason"), rows)


def _list_cells(result: "CheckResult") -> "tuple[tl.compare.Cell, ...]":
    """Return the cells of `_HEADS`, and the time of the first violation [s]."""
    verdict = result.verdict.value
    return verdict, result.file, result.check, *_show(result), result.first_violation_s


def tabulate_matrix(results: "Sequence[CheckResult]") -> "list[tl.compare.Table]":
    """Return the verdicts of several files, one row each; empty for one file."""
    files = dict.fromkeys(result.file for result in results)
    checks = dict.fromkeys(result.check for result in results)
    verdicts = {(result.file, result.check): result.verdict.value for result in results}
    if len(files) < 2:
        return []
    heads = [tl.compare.Column(title=name, lines=tuple(re.split("[._]", name))) for name in checks]
    rows = ((file, *(verdicts.get((file, check)) for check in checks)) for file in files)
    title = f"{len(files)} recordings, {len(checks)} checks"
    return [console.build_table(title, ["file", *heads], rows)]


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
        if result.verdict == "PASS":  # the head tells its reason
            continue
        # Name, value and limit explain a failure by a plain bound.
        is_named = result.expected.startswith(result.check)
        is_plain = not (result.reason or result.decided_by or meant.get(result.check))
        has_values = result.value is not None and result.limit is not None
        is_told = is_named and is_plain and has_values
        if not is_told and (reason := _explain(result, meant)):
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
    reasons = {found.name: found.reason for found in spec.checks if not found.is_observed}
    of_signals, of_metrics = spec.tolerances.signals, spec.tolerances.metrics
    reasons |= {f"signals.{name}": found.reason for name, found in of_signals.items()}
    return reasons | {f"metrics.{name}": found.reason for name, found in of_metrics.items()}
