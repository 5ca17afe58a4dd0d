"""Work of a command: processes, progress, large files, tables, and the wait for saved files."""

import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeVar

from cyclopts import Parameter, Token

import turtlelog as tl
from turtlelog.cli.console import print_note, print_run_notes
from turtlelog.cli.usage import read_whole
from turtlelog.errors import TurtlelogError, UsageError
from turtlelog.files.urls import RemotePath
from turtlelog.processes import COMPILING, FILE_S, choose_jobs, count_bytes

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from turtlelog.compare import RunSummary

_DELAY_S: Final = 1.0
_REFRESH_S: Final = 0.1


class ProgressLine:
    """A progress bar, drawn by a separate thread, so that one long step is visible as well.

    Attributes:
        done: Finished work in the unit of `total`, set by the working code.
    """

    def __init__(
        self, label: str, total: float | None, unit: str, *, has_rate: bool = False
    ) -> None:
        """Start waiting for the time when the bar appears."""
        self.done = 0.0
        self._label, self._total, self._unit = label, total, unit
        self._rate = Rate() if has_rate else None
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._draw, name="progress", daemon=True)
        if sys.stderr.isatty() and os.environ.get("TERM") != "dumb":
            self._thread.start()

    def set(self, done: float) -> None:
        """Set the finished work."""
        self.done = done if self._total is None else min(done, self._total)

    def count(self, done: int, total: int) -> None:
        """Set the number of finished steps of all steps, for a bar in percent."""
        self.done = 100.0 * done / total

    def close(self) -> None:
        """Restore the terminal. A second call does nothing."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()

    def _draw(self) -> None:
        # If the terminal disappears, only the bar is lost.
        with suppress(OSError, ValueError):
            if not self._ended.wait(_DELAY_S):
                self._animate()

    def _animate(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress as Bar, TextColumn, TimeElapsedColumn

        columns = TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn()
        with Bar(
            *columns,
            console=Console(file=sys.stderr, force_terminal=True, highlight=False),
            auto_refresh=False,
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
        ) as bar:
            task = bar.add_task(self._describe(), total=self._total)
            while True:
                bar.update(task, completed=self.done, description=self._describe(), refresh=True)
                if self._ended.wait(_REFRESH_S):
                    return

    def _describe(self) -> str:
        text = self._label
        if self._total is not None:
            text = f"{text} {int(self.done)}/{self._total:g} {self._unit}"
        if COMPILING.is_set():
            return f"{text}, compiling once"
        if self._total is None or self._rate is None:
            return text
        return text + self._rate.describe(self.done, self._total)


class Rate:
    """Rate of work since the first call; earlier work does not count."""

    def __init__(self) -> None:
        self._first: tuple[float, float] | None = None

    def describe(self, done: float, total: float) -> str:
        """Return the rate and the remaining time; empty if nothing is done yet."""
        now = time.monotonic()
        if self._first is None:
            self._first = now, done
        begun, before = self._first
        if done <= before or now <= begun:
            return ""
        rate = (done - before) / (now - begun)
        left_s = round((total - done) / rate)
        return f", {rate:.{0 if rate >= 10 else 1}f}/s, {timedelta(seconds=left_s)} left"


_live: Final[list[ProgressLine]] = []


@contextmanager
def show_progress(
    label: str, total: float | None = None, unit: str = "", *, has_rate: bool = False
) -> Iterator[ProgressLine]:
    """Show the progress of a block that takes longer than a second."""
    progress = ProgressLine(label, total, unit, has_rate=has_rate)
    _live.append(progress)
    try:
        yield progress
    finally:
        progress.close()
        _live.remove(progress)


def end_progress() -> None:
    """Remove every bar, including those of iterations that an error interrupted."""
    for progress in _live:
        progress.close()


def watch_ticks(ticks: "Iterable[tl.simulate.Tick]", most_s: float) -> "Iterator[tl.simulate.Tick]":
    """Yield ticks, and show how many of at most `most_s` seconds are simulated."""
    with show_progress("simulated", most_s, "s at most") as progress:
        for tick in ticks:
            progress.done = tick.time_ns / 1e9
            yield tick


def _read_jobs(kind: Any, tokens: Sequence[Token]) -> int:
    count = read_whole(kind, tokens)
    if count < 1:
        raise UsageError(f"--jobs {count}: must be at least 1")
    return count


Jobs = Annotated[int | None, Parameter(name="--jobs", metavar="COUNT", converter=_read_jobs)]

Found = TypeVar("Found")


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class WorkOptions:
    """Options for the processes that do the work.

    Attributes:
        jobs: Number of processes. Default: one per core if that is faster.
        scheduler: Use the Dask cluster of this scheduler. The workers must find the files at the
            same paths. Example: tcp://host:8786.
    """

    jobs: Jobs = None
    scheduler: Annotated[str | None, Parameter(metavar="URL")] = None

    @contextmanager
    def find_place(
        self, files: Sequence[Path], *, file_s: float = FILE_S
    ) -> "Iterator[int | Executor]":
        """Yield a number of processes, or the cluster."""
        if self.scheduler is None:
            yield count_jobs(self.jobs, files, file_s=file_s)
            return
        if self.jobs is not None:
            raise UsageError("--jobs: the cluster of --scheduler has its own; leave --jobs out")
        from turtlelog.sweep.cluster import connect_cluster

        with connect_cluster(self.scheduler) as executor:
            yield executor

    @contextmanager
    def find_any_place(self) -> "Iterator[int | Executor | None]":
        """Yield a number of processes, the cluster, or None without both options.

        For None, the work chooses the number of processes.
        """
        if self.scheduler is None and self.jobs is None:
            yield None
            return
        with self.find_place(()) as place:
            yield place

    def name_files(self, files: Sequence[Path]) -> list[Path]:
        """Return files with paths for workers, which run in other folders."""
        return [*files] if self.scheduler is None else [path.absolute() for path in files]


def watch_summaries(
    found: "Iterator[RunSummary | TurtlelogError]", count: int, errors: list[TurtlelogError]
) -> "Iterator[RunSummary]":
    """Yield run summaries, collect the errors, and show the number of finished files."""
    for summary in watch_files(found, count):
        if isinstance(summary, TurtlelogError):
            errors.append(summary)
        else:
            print_run_notes(summary.file, summary.notes)
            yield summary


def count_jobs(
    asked: int | None,
    files: Sequence[Path],
    *,
    file_s: float = FILE_S,
    count_read: "Callable[[Path], int] | None" = None,
) -> int:
    """Return the number of processes for files: the given number, or else from `choose_jobs`."""
    return asked or choose_jobs(files, file_s=file_s, count_read=count_read)


LARGEST_BYTES: Final = 64 * 2**20
"""Largest bag whose poses are read by default [bytes]; MCAP or SQLite of this size takes less than
a second."""

TRANSFORMS: Final = "tf2_msgs/msg/TFMessage"
_MOST_TRANSFORMS: Final = 20_000
"""Largest number of transforms read by default; each takes about 20 us, more than other
messages."""

_OWN: Final = b"turtlelog"

_HEAD_BYTES: Final = 64
"""Number of bytes at the start of a recording; the first record names the library that wrote it."""


def count_read(path: Path, *, is_asked: bool) -> int:
    """Return the approximate bytes read to describe a file; few for a turtlelog recording."""
    with suppress(OSError), path.open("rb") as stream:  # not a folder, or an unreadable file
        if _OWN in stream.read(_HEAD_BYTES):
            return 0
    size = count_bytes(tl.log.split_topic(path)[0])
    return size if is_asked or size <= LARGEST_BYTES else 0


def find_large(path: Path, info: "tl.log.RecordingInfo") -> str:
    """Return why a file is too large to be read by default; empty if it is small enough."""
    if not info.topics:
        return ""  # tables and logs are always read completely
    path, _ = tl.log.split_topic(path)
    if isinstance(path, RemotePath):
        return "it is behind a URL"
    size = count_bytes(path)
    if size > LARGEST_BYTES:
        return f"{size / 2**20:,.0f} MiB"
    transforms = sum(topic.count for topic in info.topics if topic.type == TRANSFORMS)
    if transforms <= _MOST_TRANSFORMS:
        return ""  # which kinds of poses there are is not asked: it would load the room of bags
    kinds = {topic.type for topic in info.topics if topic.count > 0} - {TRANSFORMS}
    others = kinds.intersection(tl.log.POSE_TYPES)
    return "" if others else f"{transforms:,} messages of transforms"


def watch_files(
    found: "Iterable[Found]", count: int, *, measure: "Callable[[Found], int]" = lambda _: 1
) -> "Iterator[Found]":
    """Yield results, and show the number of finished files; `measure` counts those of a result."""
    # A single file has no share to show.
    with show_progress("reading", count if count > 1 else None, "files") as progress:
        for one in found:
            yield one
            progress.done += measure(one)


def tabulate(
    found: "Sequence[tl.sweep.FoundRecording]",
    output: Path,
    table: "tl.sweep.RecordingTable",
    *,
    work: WorkOptions,
    file_s: float = FILE_S,
) -> "tl.sweep.TabulatedFiles":
    """Write the table of recordings."""
    why = tl.sweep.describe_former(output, table)
    if why is not None:
        print_note(f"{output}: every file is read, because {why}")
    try:
        with work.find_any_place() as place:
            return tl.sweep.tabulate_recordings(
                found,
                output,
                table,
                jobs=place,
                file_s=file_s,
                watch=partial(watch_files, measure=len),
            )
    except KeyboardInterrupt:
        print_note(f"{output}: what was read is kept: the same command goes on from there")
        raise


def summarise_table(done: "tl.sweep.TabulatedFiles") -> str:
    """Return the result of a table in one line."""
    files = "1 file" if done.files == 1 else f"{done.files} files"
    counts = f"{done.read} read, {done.files - done.read} unchanged"
    return f"wrote {done.output}: {files}, {counts}, {done.failed} cannot be read"


_POLL_S: Final = 0.1
"""Time between two checks of the files [s]: too short to notice, and long enough that reading some
kilobytes takes no measurable time."""

_Texts = Mapping[Path, tuple[int, bytes] | None]


def wait_for_save(
    files: Sequence[Path], seen: _Texts, has_ended: Callable[[], bool]
) -> Path | None:
    """Return the first saved file after two equal checks of all files; None once `has_ended`.

    Editors write in several steps, or delete a file and write it again. A file that has changed
    since the last check may change again, and a missing file is not saved yet.
    """
    last: _Texts = {}
    while not has_ended():
        time.sleep(_POLL_S)
        now = read_texts(files)
        saved = [file for file in files if now[file] not in (None, seen.get(file))]
        if saved and now == last:
            return saved[0]
        last = now
    return None


def read_texts(files: Sequence[Path]) -> _Texts:
    """Return time and content of each file; None for a file that cannot be read.

    The time shows a save without changes; the content shows a second save within one tick of the
    file system's clock, which may be two seconds long.
    """
    found: dict[Path, tuple[int, bytes] | None] = {}
    for file in files:
        found[file] = None
        with suppress(OSError):
            found[file] = file.stat().st_mtime_ns, file.read_bytes()
    return found
