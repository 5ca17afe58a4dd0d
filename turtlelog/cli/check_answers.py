"""What `turtlelog check` prints."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final

import turtlelog as tl
from turtlelog.cli.output import format_table, print_text
from turtlelog.escapes import escape_controls

if TYPE_CHECKING:
    from turtlelog import CheckResult, Spec, Table

_TITLES: Final = ("", "file", "check", "unit", "value", "limit", "margin")


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


def print_results(spec: "Spec", results: "Sequence[CheckResult]", *, files: int) -> None:
    """Print a line per result, what fails first, the worst margins and the verdict."""
    print_text(format_results(results, files=files, spec=spec))


def format_results(
    results: "Sequence[CheckResult]", *, files: int, spec: "Spec | None" = None
) -> str:
    """Return what is printed of results, those that fail first; without a specification no others.

    Args:
        results: Of all files.
        files: How many there are.
        spec: Says why a bound is what it is.
    """
    ordered = sorted(results, key=lambda result: result.verdict != "FAIL")
    if spec is None:
        ordered = [result for result in ordered if result.verdict == "FAIL"]
    lines = [*_list_reasons(spec, ordered), *_list_worst(ordered if spec is None else results)]
    counts = [
        f"{sum(result.verdict == verdict for result in results)} {word}"
        for verdict, word in (("PASS", "pass"), ("FAIL", "fail"), ("SKIPPED", "skipped"))
    ]
    recordings = "1 recording" if files == 1 else f"{files} recordings"
    parts = [format_table(_tabulate(ordered)).rstrip("\n")] if ordered else []
    parts += ["\n".join(map(escape_controls, lines))] if lines else []
    parts += [f"{tl.join_verdicts(results)}: {recordings}, {', '.join(counts)}"]
    return "\n\n".join(parts)


def _tabulate(results: "Sequence[CheckResult]") -> "Table":
    columns = [tl.Column(title=title) for title in _TITLES]
    if any(result.first_violation_s is not None for result in results):
        columns.append(tl.Column(title="violated", unit="s", digits=3))
    rows = (
        (
            result.verdict.value,
            result.file,
            result.check,
            result.unit,
            result.value,
            result.limit,
            result.margin,
            result.first_violation_s,
        )
        for result in results
    )
    return tl.Table(
        title="Checks; times from the first sample",
        columns=tuple(columns),
        rows=tuple(row[: len(columns)] for row in rows),
    )


def _list_reasons(spec: "Spec | None", results: "Sequence[CheckResult]") -> Iterator[str]:
    meant = {} if spec is None else _read_reasons(spec)
    for result in results:
        why = f" ({meant[result.check]})" if meant.get(result.check) else ""
        if result.reason:
            why = why if result.verdict == "FAIL" and result.is_decided else ""
            yield f"{result.verdict} {result.file}: {result.check}: {result.reason}{why}"
        elif result.verdict == "FAIL":
            by = f"; decided by {result.decided_by}" if result.decided_by else ""
            yield f"FAIL {result.file}: {result.check}: expected {result.expected}{why}{by}"
    observed = 0 if spec is None else sum(check.is_observed for check in spec.checks)
    if spec is not None and observed:
        count = "1 bound was" if observed == 1 else f"{observed} bounds were"
        yield f"{count} read off a good run: look at observed = true in {spec.source}"


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
        margin = tl.format_number(result.margin, result.unit)
        yield f"  {margin:>12}  {result.check}  {result.file}"
