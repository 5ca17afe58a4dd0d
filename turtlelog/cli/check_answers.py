"""Text and JSON of `turtlelog check`."""

import shlex
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import TYPE_CHECKING, Final

import turtlelog as tl
from turtlelog.cli.check_tables import (
    CountedResults,
    count_checks,
    list_failure_reasons,
    list_verdict_reasons,
    tabulate_checks,
    tabulate_files,
    tabulate_matrix,
    tabulate_values,
)
from turtlelog.cli.output import (
    copy_fields,
    fill_lines,
    fit_table,
    name_explain,
    print_json,
    print_tables,
    print_verdicts,
    read_law,
)
from turtlelog.display import describe_count, format_short
from turtlelog.escapes import escape_controls

if TYPE_CHECKING:
    from turtlelog import Spec
    from turtlelog.check import CheckResult, Verdict
    from turtlelog.compare import Table


_MOST_FILES: Final = 20
"""Largest number of recordings whose checks are kept in memory; for more, checks are counted."""


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
        reason: Reason why the check fails or is skipped.
        decided: Whether there was enough to judge.
        why: Reason why the run differs from its reference, in lines; empty without a reference.
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
    """Return results as entries of the answer."""
    return [
        copy_fields(
            ResultAnswer,
            result,
            verdict=result.verdict.value,
            expected=result.expected or None,
            unit=result.unit or None,
            decided_by=result.decided_by or None,
            reason=result.reason or None,
            decided=result.is_decided,
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

    Results of many files are counted one by one. CSV contains only rows.
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
        print_tables([tabulate_values(spec, results)], kind)
    elif kind == "txt":
        print_verdicts(format_results(results, files=files, spec=spec, shows_all=shows_all))
    else:
        tables = [*tabulate_files(results), *tabulate_matrix(results)]
        notes = (
            conclude(CountedResults(results), files),
            *list_verdict_reasons(spec, results),
            *list_failure_reasons(results),
        )
        print_tables([*tables[:-1], replace(tables[-1], notes=notes)], kind)
    return verdict


def print_marks(results: "Iterable[CheckResult]") -> "Verdict":
    """Print a line for each recording as soon as it is checked, and return the joint verdict."""
    from turtlelog.check.result import decide_verdict

    counted = []
    for file, of_file in groupby(results, key=lambda result: result.file):
        found = CountedResults(of_file)
        counted.append(found.verdict)
        passed = found.verdicts[tl.check.Verdict.PASS]
        total = found.verdicts.total()
        print_verdicts(
            f"{found.verdict}  {file}: {passed} of {describe_count(total, 'check')} passed"
        )
    return decide_verdict(Counter(counted))


def format_results(
    results: "Sequence[CheckResult]",
    *,
    files: int,
    spec: "Spec | None" = None,
    shows_all: bool = False,
) -> str:
    """Return the verdict, then the failed checks."""
    counted = CountedResults(results)
    if files > 1 and not shows_all:
        return _format_many(counted, files=files, spec=spec)
    shown = [*results] if shows_all else [one for one in results if one.verdict != "PASS"]
    valued = shown if shows_all else [one for one in shown if one.value is not None]
    tables = [*tabulate_files(valued), *(tabulate_matrix(shown) if shows_all else ())]
    tables = [replace(table, title="") for table in tables] if files == 1 else tables
    lines, causes = [*list_verdict_reasons(spec, shown)], [*list_failure_reasons(shown)]
    head = _write_head(counted, files, spec, causes)
    return _join(head, tables, lines, [*_list_next(counted, spec, shows_all=shows_all)])


def _format_many(
    counted: "CountedResults", *, files: int, spec: "Spec | None", shows_all: bool = False
) -> str:
    """Return the verdict, and for each check the number and the names of failing recordings."""
    tables = [count_checks(counted, shows_all=shows_all)]
    if shows_all:
        tables.append(tabulate_checks(counted.failures, "Failures", names_file=True))
    lines = [*_list_failing(counted), *list_verdict_reasons(spec, counted.failures)]
    lines += list_failure_reasons(counted.failures)
    more = counted.verdicts[tl.check.Verdict.FAIL] - len(counted.failures)
    if more:
        lines.append(f"{more} more failures are not shown: --csv and --json show them")
    tables = [table for table in tables if table.rows]
    head = _write_head(counted, files, spec)
    return _join(head, tables, lines, [*_list_next(counted, spec, shows_all=shows_all)])


def _write_head(
    counted: "CountedResults", files: int, spec: "Spec | None", causes: Sequence[str] = ()
) -> str:
    """Return the verdict, facts that qualify it, and why a run differs from its reference."""
    facts = [*_list_facts(counted, spec, files)]
    blocks = [fill_lines(facts)] if facts else []
    blocks += [fill_lines(causes, indent=2)] if causes else []
    return "\n".join([conclude(counted, files), *blocks])


def _join(
    head: str, tables: "Sequence[Table]", lines: Sequence[str], following: Sequence[str]
) -> str:
    """Return the parts of an answer, separated by empty lines."""
    blocks = [fit_table(table).strip("\n") for table in tables]
    ends = [fill_lines(lines, indent=2)] if lines else []
    ends += ["\n".join(map(escape_controls, following))] if following else []
    return "\n\n".join([head, *blocks, *ends])


def conclude(counted: "CountedResults", files: int) -> str:
    """Return the verdict and the number of checks, in one line."""
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
        text = f"{failed} of {describe_count(total, 'check')} {verb}{names}{lacking}{rest}"
    elif verdict == "SKIPPED":
        return f"{verdict}: no check was judged in {place}: {skipped} {_is_or_are(skipped)} skipped"
    elif skipped:
        passed = verdicts[tl.check.Verdict.PASS]
        verb = "passes" if passed == 1 else "pass"
        text = f"{passed} of {describe_count(total, 'check')} {verb}{rest}"
    elif total == 1:
        text = ", ".join(["the check passes", *map(_tell_value, counted.nearest.values())])
    else:
        text = f"all {total} checks pass"
    return f"{verdict}: {escape_controls(place)}: {text}"


def _name_failing(counted: "CountedResults") -> str:
    """Return in brackets the only failed check with its value, or failed checks without limits."""
    if counted.verdicts[tl.check.Verdict.FAIL] == 1:
        one = counted.failures[0]
        told = "it has no value" if one.value is None else _write_value(one, one.value)
        return f" ({escape_controls(one.check)}, {told})"
    if _find_worst(counted) is not None:
        return ""
    names = [check for check, found in counted.of_checks.items() if found[tl.check.Verdict.FAIL]]
    more = f" and {len(names) - 1} more" if len(names) > 1 else ""
    return f" ({escape_controls(names[0])}{more})"


def _find_worst(counted: "CountedResults") -> "CheckResult | None":
    """Return the failed check that is furthest beyond its limit, if several fail."""
    several = counted.verdicts[tl.check.Verdict.FAIL] > 1
    if all(one.limit == 0.0 for one in counted.failures):
        return None  # no proportion differs, as in tests of equality
    worst = counted.find_smallest() if several else None
    return worst if worst is not None and worst.verdict == "FAIL" else None


def _list_facts(counted: "CountedResults", spec: "Spec | None", files: int) -> Iterator[str]:
    """Yield the check furthest beyond or nearest to its limit, and whether limits are observed."""
    worst = _find_worst(counted)
    if worst is not None:
        place = f" in {escape_controls(worst.file)}" if files > 1 else ""
        check = escape_controls(worst.check)
        yield f"Furthest beyond its limit, in proportion: {check}{place}, {_tell_value(worst)}."
    several = counted.verdicts.total() > 1
    if several and counted.verdict == "PASS" and (nearest := counted.find_smallest()) is not None:
        yield f"Nearest to its limit: {escape_controls(nearest.check)}, {_tell_value(nearest)}."
    if observed := _count_observed(counted, spec):
        were = "1 failed limit was" if observed == 1 else f"{observed} failed limits were"
        source = "" if spec is None else spec.source
        yield f"{were} read off a run, not required: observed = true in {source}"


def _count_observed(counted: "CountedResults", spec: "Spec | None") -> int:
    """Return the number of failed checks whose limits were read off a run."""
    names = {check.name for check in spec.checks if check.is_observed} if spec else set()
    return sum(
        name in names and found[tl.check.Verdict.FAIL] > 0
        for name, found in counted.of_checks.items()
    )


def _tell_value(result: "CheckResult") -> str:
    if result.value is None:
        return "it has no value"
    value = _write_value(result, result.value)
    if result.limit is None:
        return value
    return f"{value}, limit {format_short(result.limit, result.unit)}"


def _write_value(result: "CheckResult", value: float) -> str:
    return f"value {format_short(value, result.unit)}"


def _is_or_are(number: int) -> str:
    return "is" if number == 1 else "are"


def _list_failing(counted: "CountedResults") -> Iterator[str]:
    """Yield the recordings in which checks fail, the first ones if there are many."""
    if counted.failing:
        names = ", ".join(f"{file} ({count})" for file, count in counted.failing.items())
        more = counted.failing_files - len(counted.failing)
        rest = f" and {more} more" if more else ""
        yield f"Recordings in which checks fail, and how many: {names}{rest}"


def _list_next(counted: "CountedResults", spec: "Spec | None", *, shows_all: bool) -> Iterator[str]:
    """Yield bounds to confirm, and next commands."""
    observed = 0 if spec is None else sum(check.is_observed for check in spec.checks)
    if spec is not None and observed and not _count_observed(counted, spec):
        were = "1 bound was" if observed == 1 else f"{observed} bounds were"
        yield f"{were} read off a good run: look at observed = true in {spec.source}"
    if spec is None:
        return
    measured = next((one for one in counted.failures if one.value is not None), None)
    if measured is not None:
        has_cause = any(one.why for one in counted.failures)
        question = "Within the run:" if has_cause else "Why?"
        yield f"{question} {_advise(measured, spec)}"
    if not shows_all and counted.verdicts.total() > 1:
        yield "All checks with their margins: --all"


def _advise(failed: "CheckResult", spec: "Spec") -> str:
    """Return the command that explains a failed check."""
    file = shlex.quote(failed.file)
    formulas = (check.formula for check in spec.checks if check.name == failed.check)
    is_error = any(name.startswith(("ate.", "rpe.")) for one in formulas for name in one.names)
    if spec.reference is not None and is_error:
        reference = shlex.quote(str(spec.reference))
        return f"turtlelog compare {file} --reference {reference} --ate --plot FILE.pdf"
    name = failed.check.removeprefix("metrics.")
    is_metric = tl.measure.find_metric_kind(name) is not None
    option = f" --metric {name}" if is_metric and name != "final.position_error" else ""
    return f"{name_explain(failed.file, read_law(failed.file))}{option}"
