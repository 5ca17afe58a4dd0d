"""Commands on many recordings: search of folders, and tables that grow by new files."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.options import Output, WorkOptions, find_files, list_files
from turtlelog.cli.output import print_note
from turtlelog.cli.progress import show_progress
from turtlelog.processes import FILE_S

if TYPE_CHECKING:
    from turtlelog.sweep import FoundRecording, RecordingTable, TabulatedFiles


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class FolderOptions(WorkOptions):
    """Options for many recordings.

    Attributes:
        output: Write a row for every file to this .parquet table, and print a summary alone. Files
            that have not changed since the table was written are not read again.
    """

    output: Output = None

    def find(self, paths: Sequence[Path]) -> "list[FoundRecording]":
        """Return the given recordings, and those below given folders."""
        return find_files(self.name_files(paths), self.output)

    def list_files(self, paths: Sequence[Path]) -> list[Path]:
        """Return the files that are given, or those below folders."""
        return list_files(self.name_files(paths))


def tabulate(
    found: "Sequence[FoundRecording]",
    output: Path,
    table: "RecordingTable",
    *,
    work: WorkOptions,
    file_s: float = FILE_S,
) -> "TabulatedFiles":
    """Write the table of recordings. Invalid paths are errors before any file is read.

    Args:
        found: Recordings of the table.
        output: Path of the table.
        table: Kind and columns of the table.
        work: Processes or cluster that read files.
        file_s: Time per file, as in `tabulate_recordings`.
    """
    from turtlelog.cli.targets import require_new_target

    require_new_target(output, [Path(one.path) for one in found], suffix=".parquet")
    why = tl.sweep.describe_former(output, table)
    if why is not None:
        print_note(f"{output}: every file is read, because {why}")
    try:
        with work.find_any_place() as place:
            return tl.sweep.tabulate_recordings(
                found, output, table, jobs=place, file_s=file_s, watch=_watch
            )
    except KeyboardInterrupt:
        print_note(f"{output}: what was read is kept: the same command goes on from there")
        raise


def _watch(chunks: Iterator[Any], count: int) -> Iterator[Any]:
    with show_progress("reading", count if count > 1 else None, "files") as progress:
        for chunk in chunks:
            yield chunk
            progress.done += len(chunk)


def summarise_table(done: "TabulatedFiles") -> str:
    """Return the result of a table in one line."""
    files = "1 file" if done.files == 1 else f"{done.files} files"
    counts = f"{done.read} read, {done.files - done.read} unchanged"
    return f"wrote {done.output}: {files}, {counts}, {done.failed} cannot be read"


@dataclass(frozen=True, slots=True, kw_only=True)
class TableAnswer:
    """Result of a table of recordings: numbers of read, unchanged and unreadable files."""

    output: str
    files: int
    read: int
    unchanged: int
    failed: int


def build_table_answer(done: "TabulatedFiles") -> TableAnswer:
    """Return the result of a table as data."""
    return TableAnswer(
        output=str(done.output),
        files=done.files,
        read=done.read,
        unchanged=done.files - done.read,
        failed=done.failed,
    )
