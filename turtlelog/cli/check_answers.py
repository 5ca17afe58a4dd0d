"""What `turtlelog check` prints."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final

import turtlelog as tl
from turtlelog.cli.output import format_table, print_text

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
    ordered = sorted(results, key=lambda result: result.verdict != "FAIL")
    print_text(format_table(_tabulate(ordered)))
    lines = [*_list_reasons(spec, ordered), *_list_worst(results)]
    if lines:
        print_text("\n" + "\n".join(lines))
    counts = [
        f"{sum(result.verdict == verdict for result in results)} {word}"
        for verdict, word in (("PASS", "pass"), ("FAIL", "fail"), ("SKIPPED", "skipped"))
    ]
    recordings = "1 recording" if files == 1 else f"{files} recordings"
    print_text(f"\n{tl.join_verdicts(results)}: {recordings}, {', '.join(counts)}")


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


def _list_reasons(spec: "Spec", results: "Sequence[CheckResult]") -> Iterator[str]:
    meant = {check.name: check.reason for check in spec.checks}
    observed = {check.name for check in spec.checks if check.is_observed}
    for result in results:
        if result.reason:
            yield f"{result.verdict} {result.file}: {result.check}: {result.reason}"
        elif result.verdict == "FAIL":
            why = f" ({meant[result.check]})" if meant.get(result.check) else ""
            by = f"; decided by {result.decided_by}" if result.decided_by else ""
            yield f"FAIL {result.file}: {result.check}: expected {result.expected}{why}{by}"
    if observed:
        count = "1 bound was" if len(observed) == 1 else f"{len(observed)} bounds were"
        yield f"{count} read off a good run: look at observed = true in {spec.source}"


def _list_worst(results: "Sequence[CheckResult]") -> Iterator[str]:
    from turtlelog.check.result import find_worst

    worst = find_worst(results)
    if worst:
        yield "Worst margins"
    for result in worst:
        margin = tl.format_number(result.margin, result.unit)
        yield f"  {margin:>12}  {result.check}  {result.file}"
