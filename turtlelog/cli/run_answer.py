"""The answer of `turtlelog run`: as an object, and in words."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import turtlelog as tl
from turtlelog.cli.output import describe_metrics, fill_lines, fit_table
from turtlelog.display import describe_count

if TYPE_CHECKING:
    from turtlelog import Run

_LONGEST: Final = 24
"""Of a name [characters]: of a longer one the changes have a line of their own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunAnswer:
    """How a simulated run ended.

    Attributes:
        name: Name of the run.
        file: The recording that was written; None without one.
        rrd: The Rerun recording that was written; None without one.
        samples: Number of samples.
        stop_reason: Why it ended.
        metrics: All its metrics.
    """

    name: str
    file: str | None
    rrd: str | None
    samples: int
    stop_reason: str | None
    metrics: list[dict[str, Any]]


def build_answer(run: "Run", *, output: Path | None, rrd: Path | None) -> RunAnswer:
    """Return the answer."""
    return RunAnswer(
        name=run.name,
        file=None if output is None else str(output),
        rrd=None if rrd is None else str(rrd),
        samples=len(run.samples),
        stop_reason=run.stop_reason,
        metrics=describe_metrics(tl.measure_run(run)),
    )


def write_end(run: "Run") -> str:
    """Return how far from the goal a run ended and when, and why it ended."""
    name, changes = _split_name(run)
    lines = [f"{name}: {tl.charts.describe_end(run)}."]
    lines += [f"Changed: {changes}"] if changes else []
    lines += [f"{describe_count(len(run.samples), 'sample')}. {run.events[-1].text}"]
    return fill_lines(lines)


def _split_name(run: "Run") -> tuple[str, str]:
    """Return a name that fits a table, and the changes that a longer one tells."""
    base, _, changes = run.name.partition(" ")
    return (run.name, "") if len(run.name) <= _LONGEST or not changes else (base, changes)


def format_run(run: "Run") -> str:
    """Return the essential metrics as a table."""
    only = tl.measure.list_essential_metrics(run.declaration)
    named = replace(run, name=_split_name(run)[0])
    return fit_table(tl.compare.tabulate_metrics([named], only=only))
