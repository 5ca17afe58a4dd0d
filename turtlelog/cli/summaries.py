"""Runs in short, file by file: a file that cannot be read does not stop the others."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from turtlelog.cli.output import print_run_notes
from turtlelog.cli.progress import show_progress
from turtlelog.errors import TurtlelogError

if TYPE_CHECKING:
    from turtlelog import RunSummary


def watch_summaries(
    found: "Iterator[RunSummary | TurtlelogError]", count: int, errors: list[TurtlelogError]
) -> "Iterator[RunSummary]":
    """Yield what was measured, keep the errors, and show how many of the files are done."""
    with show_progress("reading", count if count > 1 else None, "files") as progress:
        for number, summary in enumerate(found, start=1):
            if isinstance(summary, TurtlelogError):
                errors.append(summary)
            else:
                print_run_notes(summary.file, summary.notes)
                yield summary
            progress.done = number
