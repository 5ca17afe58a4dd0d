"""Progress of a command: after a second, a bar on stderr, if stderr is a terminal."""

import os
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from datetime import timedelta
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from turtlelog.simulate import Tick

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
        from turtlelog.simulate.compiled import COMPILING

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


def watch_ticks(ticks: "Iterable[Tick]", most_s: float) -> "Iterator[Tick]":
    """Yield ticks, and show how many of at most `most_s` seconds are simulated."""
    with show_progress("simulated", most_s, "s at most") as progress:
        for tick in ticks:
            progress.done = tick.time_ns / 1e9
            yield tick
