import io
import os
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

import turtlelog as tl
from tests.cli.conftest import Call
from turtlelog.cli.options import iterate_runs
from turtlelog.cli.work import end_progress, show_progress
from turtlelog.processes import COMPILING

ROOT = Path(__file__).parents[2]
on_terminals = pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals there")


class Terminal:
    """A pseudo-terminal: `stream` is what a program writes to."""

    def __init__(self) -> None:
        import pty

        self._outer, inner = pty.openpty()
        self.stream = os.fdopen(inner, "w", encoding="utf-8")

    def read(self) -> str:
        """Close it and return what was written."""
        self.stream.close()
        shown = b""
        with suppress(OSError):  # how a terminal says that nobody writes to it any more
            while found := os.read(self._outer, 1000):
                shown += found
        os.close(self._outer)
        return shown.decode()


Attach = Callable[[], Terminal]


@pytest.fixture
def attach(monkeypatch: pytest.MonkeyPatch) -> Attach:
    """Put stderr on a terminal; within the test, for pytest sets its own before that."""

    def attach_terminal() -> Terminal:
        terminal = Terminal()
        monkeypatch.setenv("TERM", "xterm")
        monkeypatch.setattr(sys, "stderr", terminal.stream)
        return terminal

    return attach_terminal


def work(seconds: float) -> None:
    with show_progress("reading", 4, "files") as progress:
        progress.done = 3
        time.sleep(seconds)


@on_terminals
def test_a_bar_shows_up_after_a_second_and_is_gone_at_the_end(attach: Attach) -> None:
    terminal = attach()
    work(1.4)
    shown = terminal.read()
    assert "reading 3/4 files" in shown
    assert shown.endswith("\x1b[2K")  # the line is erased
    assert shown.rindex("\x1b[?25h") > shown.rindex("\x1b[?25l")  # the cursor is back


@on_terminals
def test_a_bar_says_that_loops_compile(attach: Attach, monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = attach()
    monkeypatch.setattr("turtlelog.cli.work._DELAY_S", 0.0)
    with show_progress("simulated", 3, "rows", has_rate=True):
        COMPILING.set()
        time.sleep(0.3)
        COMPILING.clear()
        time.sleep(0.3)
    first, _, last = terminal.read().rpartition("compiling once")
    assert "simulated 0/3 rows, " in first
    assert "simulated 0/3 rows" in last


@on_terminals
def test_what_is_quick_shows_no_bar(attach: Attach) -> None:
    terminal = attach()
    work(0.05)
    assert terminal.read() == ""


@on_terminals
def test_a_terminal_that_cannot_move_its_cursor_shows_no_bar(
    attach: Attach, monkeypatch: pytest.MonkeyPatch
) -> None:
    terminal = attach()
    monkeypatch.setenv("TERM", "dumb")
    work(1.2)
    assert terminal.read() == ""


def test_no_bar_goes_where_there_is_no_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", stream := io.StringIO())
    work(1.2)
    assert stream.getvalue() == ""


@on_terminals
def test_an_error_stands_on_a_line_of_its_own(
    attach: Attach, call: Call, kp4: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read_slowly(path: Path, **topics: str | None) -> tl.Run:
        time.sleep(0.7)
        return tl.read_recording(path)

    monkeypatch.setattr("turtlelog.log.any_file.read_run", read_slowly)
    terminal = attach()
    answer = call("compare", "--reference", kp4, kp4, "missing.mcap")
    shown = terminal.read()
    assert (answer.code, answer.out) == (2, "")
    assert "reading 1/2 files" in shown
    assert "\x1b[2Kturtlelog: error: missing.mcap: no such file" in shown


@on_terminals
def test_measuring_shows_how_many_files_are_done(
    attach: Attach, call: Call, kp4: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read_slowly(path: str, **topics: str | None) -> tl.Run:
        time.sleep(0.7)
        return tl.read_recording(path)

    monkeypatch.setattr("turtlelog.log.any_file.read_run", read_slowly)
    terminal = attach()
    assert call("metrics", kp4, kp4, kp4).code == 0
    assert "reading 1/3 files" in terminal.read()


@pytest.mark.realtime
@on_terminals
def test_a_live_run_shows_its_seconds_on_a_terminal_and_nothing_elsewhere() -> None:
    """A bar appears after a second by the clock, of two runs."""
    words = ("run", "paper", "--set", "max_duration_s=1.7", "--realtime")
    command = [sys.executable, "-m", "turtlelog", *words]
    terminal, quiet = Terminal(), subprocess.run(command, capture_output=True, cwd=ROOT, check=True)
    loud = subprocess.run(
        command,
        stdout=subprocess.PIPE,
        stderr=terminal.stream,
        cwd=ROOT,
        env={**os.environ, "TERM": "xterm"},
        check=True,
    )
    assert "simulated 1/1.7 s at most" in terminal.read()
    assert quiet.stderr == b""
    assert loud.stdout == quiet.stdout


def test_runs_are_read_one_by_one(kp4: Path) -> None:
    runs = iterate_runs([kp4, Path("missing.mcap")])
    assert next(runs).name == "paper-kp4"
    with pytest.raises(tl.TurtlelogError, match=r"missing\.mcap"):
        next(runs)
    end_progress()
