import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import turtlelog as tl
from tests.cli.conftest import Call
from tests.log.live import ROOT, read_messages

pytestmark = pytest.mark.realtime

SHORT = ("--set", "max_duration_s=0.6")


def test_a_run_at_wall_clock_takes_its_time_and_prints_as_any_other(call: Call) -> None:
    start = time.monotonic()
    answer = call("run", "paper", *SHORT, "--realtime", "--json")
    assert 0.59 < time.monotonic() - start < 10.0
    assert answer.json == call("run", "paper", *SHORT, "--json").json


def test_a_run_at_wall_clock_records_the_same_columns(call: Call, tmp_path: Path) -> None:
    live, once = tmp_path / "live.mcap", tmp_path / "once.mcap"
    answer = call("run", "paper", *SHORT, "--realtime", "-o", live)
    assert (answer.code, answer.err.splitlines()[-1]) == (0, f"wrote {live}")
    assert "samples. The run ended: max duration." in answer.out
    call("run", "paper", *SHORT, "-o", once)
    found, expected = tl.read_recording(live), tl.read_recording(once)
    assert found.poses.xy_m.tolist() == expected.poses.xy_m.tolist()
    assert found.samples.time_ns.tolist() == expected.samples.time_ns.tolist()
    assert found.parameters == expected.parameters


def test_an_existing_file_is_refused_before_anything_runs(call: Call, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"mine")
    start = time.monotonic()
    answer = call("run", "paper", "--realtime", "-o", path)
    assert (answer.code, answer.out) == (2, "")
    assert f"{path}: expected a new file, found one" in answer.err
    assert path.read_bytes() == b"mine"
    assert time.monotonic() - start < 5.0


def start(*words: str | Path) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "turtlelog", "run", "paper", "--realtime", *map(str, words)]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT
    )


OWN_TERMINAL = """
import fcntl, os, sys, termios

os.setsid()
fcntl.ioctl(int(sys.argv[1]), termios.TIOCSCTTY)
for number in range(3):
    os.dup2(int(sys.argv[1]), number)
os.execv(sys.executable, [sys.executable, "-m", "turtlelog", *sys.argv[2:]])
"""


def wait_for_messages(path: Path) -> None:
    """Return when the recording has taken its first second."""
    end = time.monotonic() + 30.0
    while not (path.exists() and read_messages(path)):
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.mark.everyday("SIGINT", "SIGTERM", "SIGQUIT")
@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends processes in other ways")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT"])
def test_an_interrupt_finishes_the_file_and_says_so_in_a_line(name: str, tmp_path: Path) -> None:
    """A command starts, runs by the clock and is interrupted."""
    path = tmp_path / "a.mcap"
    process = start("-o", path)
    wait_for_messages(path)
    process.send_signal(getattr(signal, name))
    out, err = process.communicate(timeout=30)
    run = tl.read_recording(path)
    assert (process.returncode, run.stop_reason) == (130, "interrupted")
    assert "The run ended: interrupted." in out
    lines = err.splitlines()
    assert lines[0] == f"interrupted at {run.end_ns / 1e9:.3f} s"
    assert lines[-1] == f"wrote {path}"


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no terminals of this kind")
def test_a_terminal_that_closes_ends_the_run_as_ctrl_c_does(tmp_path: Path) -> None:
    path, (ours, theirs) = tmp_path / "a.mcap", os.openpty()
    command = [sys.executable, "-c", OWN_TERMINAL, theirs, "run", "paper", "--realtime", "-o", path]
    process = subprocess.Popen(list(map(str, command)), cwd=ROOT, pass_fds=[theirs])
    os.close(theirs)
    wait_for_messages(path)
    os.close(ours)
    assert process.wait(timeout=30) == 130
    assert tl.read_recording(path).stop_reason == "interrupted"


@pytest.mark.skipif(sys.platform == "win32", reason="Windows deletes no file that is open")
def test_a_recording_that_is_deleted_on_the_way_ends_the_run_in_a_line(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    process = start("-o", path)
    wait_for_messages(path)
    path.unlink()
    out, err = process.communicate(timeout=10)  # within a chunk, of 5 s at least
    assert (process.returncode, out, err.count("\n")) == (2, "", 1)
    assert f"error: {path}: expected a file that stays, found it deleted: its " in err
