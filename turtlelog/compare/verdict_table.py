"""The table of verdicts on one run."""

from collections.abc import Sequence
from typing import Final

from turtlelog.compare.difference import Comparison
from turtlelog.compare.table import Cell, Column, Table
from turtlelog.compare.verdict import Finding

_COLUMNS: Final = (
    Column(title=""),
    Column(title="signal or metric"),
    Column(title="unit"),
    Column(title="value"),
    Column(title="reference"),
    Column(title="off"),
    Column(title="limit"),
    Column(title="excess"),
    Column(title="at", unit="s", digits=2),
    Column(title="outside from", unit="s", digits=2, lines=("outside", "from")),
)

_ALWAYS: Final = ("value", "reference", "off", "limit")

_ALIGNMENT_WORDS: Final = {
    "first_sample": "from the first samples on",
    "recorded": "by recorded time",
    "sample": "sample by sample",
}


def describe_alignment(alignment: str) -> str:
    """Return an alignment in words: `from the start of translate on`."""
    phase = alignment.removeprefix("phase:")
    return _ALIGNMENT_WORDS.get(alignment, f"from the start of {phase} on")


def tabulate_findings(comparison: Comparison, *, name: str, reference: str) -> Table:
    """Return a row for every finding, what fails first, and the reasons of what fails below.

    Args:
        comparison: With findings.
        name: Of the run, as it heads the table.
        reference: Of the reference.
    """
    findings = sorted(comparison.findings, key=lambda finding: finding.within)
    start_s, length_s = comparison.overlap_from_s, comparison.overlap_s
    rows = [_list_cells(finding) for finding in findings]
    # Where nothing fails, nothing is too much, and nowhere.
    used = [
        index
        for index, column in enumerate(_COLUMNS)
        if column.title in _ALWAYS or any(row[index] is not None for row in rows)
    ]
    return Table(
        title=(
            f"{(comparison.verdict or 'not judged').upper()}: {name} against {reference},"
            f" {describe_alignment(comparison.alignment)},"
            f" {start_s:.2f} to {start_s + length_s:.2f} s"
        ),
        columns=tuple(_COLUMNS[index] for index in used),
        rows=tuple(tuple(row[index] for index in used) for row in rows),
        notes=(*_list_notes(findings), *comparison.notes),
    )


def tabulate_all_findings(comparisons: Sequence[Comparison], *, names: Sequence[str]) -> Table:
    """Return the findings of all runs in one table, for files; `names` are those of the runs."""
    return Table(
        title="Verdicts",
        columns=(Column(title="run"), Column(title="verdict"), *_COLUMNS[1:]),
        rows=tuple(
            (name, *_list_cells(finding))
            for name, comparison in zip(names, comparisons, strict=True)
            for finding in comparison.findings
        ),
    )


def _list_cells(finding: Finding) -> tuple[Cell, ...]:
    margin = finding.margin
    return (
        "PASS" if finding.within else "FAIL",
        finding.name,
        finding.unit,
        finding.value,
        finding.reference,
        finding.off,
        finding.limit,
        -margin if margin is not None and margin < 0 else None,
        finding.at_s,
        finding.first_outside_s,
    )


def _list_notes(findings: Sequence[Finding]) -> list[str]:
    told = [f"{finding.name}: {finding.reason}." for finding in findings if finding.reason]
    limits = [
        f"{finding.name} is held to {_describe_limits(finding)}: {finding.tolerance.reason}."
        for finding in findings
        if not finding.within and finding.tolerance.reason
    ]
    return told + limits


def _describe_limits(finding: Finding) -> str:
    given = finding.tolerance
    unit = "" if finding.unit == "1" else f" {finding.unit}"
    parts = [f"{given.abs:g}{unit}"] if given.abs or not given.rel else []
    parts += [f"{given.rel:g} of the reference"] if given.rel else []
    window = f" within {given.time_s:g} s" if given.time_s else ""
    return " or ".join(parts) + window
