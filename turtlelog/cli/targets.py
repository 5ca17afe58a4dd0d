"""Outputs of commands: checks before any work, and tables of recordings that grow by new files."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.options import Output, WorkOptions, find_files, list_files
from turtlelog.cli.output import copy_fields, print_note
from turtlelog.cli.progress import show_progress
from turtlelog.errors import RemoteError, UsageError
from turtlelog.files.urls import RemotePath
from turtlelog.libraries import load_library
from turtlelog.processes import FILE_S

if TYPE_CHECKING:
    from turtlelog.sweep import FoundRecording, RecordingTable, TabulatedFiles

_LIBRARIES: Final = MappingProxyType({".html": "bokeh", ".parquet": "pyarrow", ".rrd": "rerun"})
"""Libraries that write files of a suffix, and that a slim installation does not have."""

PICTURES: Final = frozenset({".pdf", ".png", ".svg"})
"""Suffixes of figures."""


def require_new_target(target: Path | None, inputs: Sequence[Path], *, suffix: str) -> None:
    """Refuse a file that could not be written, is an input, or has another suffix.

    An existing file is accepted, and is replaced when the new file is complete.

    Raises:
        UsageError: If the file is refused.
        LibraryError: If the library that writes such files is not installed.
    """
    if target is None:
        return
    with _name_target(target):
        if target.suffix.lower() != suffix:
            raise UsageError(f"the name must end in {suffix}")
        _require_writable(target, inputs)
    if suffix in _LIBRARIES:
        load_library(_LIBRARIES[suffix])


def require_pictures(
    plot: Path | None, rrd: Path | None, inputs: Sequence[Path], *, drawn: Sequence[Path], of: str
) -> None:
    """Refuse pictures of a robot that could not be written, or pictures of several files.

    Raises:
        UsageError: If a picture is refused.
        LibraryError: If the library that writes it is not installed.
    """
    for name, target in (("--plot", plot), ("--rrd", rrd)):
        if target is not None and len(drawn) > 1:
            raise UsageError(f"{name}: draws one {of}, not {len(drawn)}")
    if plot is not None and plot.suffix.lower() not in PICTURES:
        raise UsageError(f"--plot {plot}: the name must end in .pdf, .png or .svg")
    require_new_target(plot, inputs, suffix="" if plot is None else plot.suffix.lower())
    require_new_target(rrd, inputs, suffix=".rrd")


def require_new_folder(target: Path) -> None:
    """Refuse a folder that could not be created, or that contains files."""
    with _name_target(target):
        if isinstance(target, RemotePath):
            raise UsageError("a URL names a file here, not a folder")
        _require_place(_resolve(target))
        if target.is_dir():
            if any(target.iterdir()):
                raise UsageError("this folder has files; name a new one")
        elif target.exists() or target.is_symlink():
            raise UsageError("this is a file; name a new folder")


def require_apart(targets: Sequence[Path]) -> None:
    """Refuse outputs that are equal, or that would be inside each other."""
    places = [_resolve(target) for target in targets]
    for number, place in enumerate(places):
        for other in places[:number]:
            if place == other or place in other.parents or other in place.parents:
                raise UsageError(
                    f"{targets[number]}: another output is written there; name another place"
                )


def _resolve(target: Path) -> Path:
    """Return the target of a path. Links that form a circle stay unchanged."""
    return target if isinstance(target, RemotePath) else Path(os.path.realpath(target))


def _require_writable(target: Path, inputs: Sequence[Path]) -> None:
    if isinstance(target, RemotePath):
        from turtlelog.files.requests import require_writable

        require_writable(target.url)
        if any(tl.log.split_topic(path)[0] == target for path in inputs):
            raise UsageError("this is the input; name another file to write")
        return
    _require_place(_resolve(target))
    if not target.exists():
        return
    if not target.is_file():
        kind = "folder" if target.is_dir() else "device"
        raise UsageError(f"this is a {kind}; name a file to write")
    if not os.access(target, os.W_OK):
        raise UsageError("this file is write-protected; name another file to write")
    for path in inputs:
        with suppress(OSError):  # the reading of a missing input gives the error
            if target.samefile(tl.log.split_topic(path)[0]):
                raise UsageError("this is the input; name another file to write")


def _require_place(target: Path) -> None:
    """Refuse a path that cannot be written, by creating and removing a file there."""
    folder = target.absolute().parent
    if not folder.is_dir():
        raise UsageError("there is no such folder to write to; create it first")
    probe = folder / f".turtlelog-{os.urandom(6).hex()}.part"
    # Permissions are not sufficient: the disk may be read-only, or the name too long.
    probe.touch(exist_ok=False)
    probe.unlink()
    with suppress(FileNotFoundError):
        target.lstat()


@contextmanager
def _name_target(target: Path) -> Iterator[None]:
    try:
        yield
    except (UsageError, RemoteError) as err:
        raise UsageError(f"{target}: {err}") from err
    except OSError as err:
        raise UsageError(f"{target}: cannot be written: {err.strerror or err}") from err


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
    """Write the table of recordings. Invalid paths are errors before any file is read."""
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
    return copy_fields(TableAnswer, done, output=str(done.output), unchanged=done.files - done.read)
