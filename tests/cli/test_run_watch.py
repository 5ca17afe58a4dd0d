"""`run --watch`: a process that runs again on every save, until it is interrupted."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import turtlelog as tl
from tests.cli.conftest import Call
from tests.draw.rerun.headless import start_headless
from tests.log.live import ROOT
from turtlelog.draw.rerun.viewer import ViewerProcess

PATIENCE_S = 60.0

LAW = """
from dataclasses import dataclass
from turtlelog.laws import Decision

@dataclass(frozen=True)
class Parameters:
    gain: float = 1.0

class Own:
    Parameters = Parameters

    def __init__(self, parameters):
        self.gain = parameters.gain

    def reset(self, start, goal, path):
        self.samples = 0

    def step(self, time_ns, pose):
        self.samples += 1
        {line}
        reason = "done" if self.samples == {samples} else None
        return Decision(speed_m_s=self.gain, turn_rate_rad_s=0.0, stop_reason=reason)
"""


def format_law(samples: int, line: str = "pass") -> str:
    return LAW.format(samples=samples, line=line)


class Watch:
    """A process that watches, and what it has printed so far."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self.process = process
        self._texts = ["", ""]
        streams = process.stdout, process.stderr
        self._readers = [
            threading.Thread(target=self._read, args=(number, stream))
            for number, stream in enumerate(streams)
        ]
        for reader in self._readers:
            reader.start()

    @property
    def out(self) -> str:
        return self._texts[0]

    @property
    def err(self) -> str:
        return self._texts[1]

    def _read(self, number: int, stream: "subprocess.IO[str]") -> None:  # type: ignore[name-defined]
        for line in stream:
            self._texts[number] += line

    def wait_for(self, *texts: str) -> None:
        """Return when each text has been printed."""
        deadline = time.monotonic() + PATIENCE_S
        while missing := [text for text in texts if text not in self.out + self.err]:
            assert self.process.poll() is None, (missing, self.out, self.err)
            assert time.monotonic() < deadline, (missing, self.out, self.err)
            time.sleep(0.02)

    def interrupt(self) -> int:
        self.process.send_signal(signal.SIGINT)
        return self.wait()

    def wait(self) -> int:
        code = self.process.wait(PATIENCE_S)
        for reader in self._readers:
            reader.join()
        for stream in (self.process.stdout, self.process.stderr):
            if stream is not None:
                stream.close()
        return code


@contextmanager
def start(folder: Path, *words: str | Path) -> Iterator[Watch]:
    process = subprocess.Popen(
        [sys.executable, "-m", "turtlelog", "run", "--watch", *map(str, words)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUTF8": "1"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    watch = Watch(process)
    try:
        yield watch
    finally:
        process.kill()
        watch.wait()


@pytest.fixture
def law(tmp_path: Path) -> Path:
    path = tmp_path / "own.py"
    path.write_text(format_law(100), encoding="utf-8")
    return path


pytestmark = pytest.mark.realtime
signals = pytest.mark.skipif(sys.platform == "win32", reason="Windows sends no signal to a process")


@signals
def test_every_save_runs_again_and_says_what_changed(law: Path, tmp_path: Path) -> None:
    with start(tmp_path, "--law", "own.py:Own", "--set", "law.gain=0.5") as watch:
        watch.wait_for("watching own.py: every save runs again, Ctrl-C ends")
        assert watch.out.startswith("textbook: ended ")
        assert "\nChanged: law=own.py:Own law.gain=0.5\n100 samples. " in watch.out
        assert re.search(r"^duration +1\.58 s *$", watch.out, re.M)
        law.write_text(format_law(200), encoding="utf-8")
        watch.wait_for("200 samples. The run ended: done.", "run.path_length")
        watch.wait_for("final.position_error")
        assert watch.interrupt() == 130
    assert re.search(r"^metric +unit +now +before$", watch.out, re.M)
    assert re.search(r"^run\.duration +s +3\.184 +1\.584$", watch.out, re.M)
    assert watch.err.splitlines() == [
        "watching own.py: every save runs again, Ctrl-C ends",
        "saved: own.py",
        "watch ended",
    ]


@signals
def test_errors_of_the_law_are_a_line_each_and_the_watch_goes_on(law: Path, tmp_path: Path) -> None:
    with start(tmp_path, "--law", "own.py:Own", "-o", "a.mcap") as watch:
        watch.wait_for("100 samples", "watching own.py")
        law.write_text("def step(:\n", encoding="utf-8")
        watch.wait_for("own.py cannot be loaded: SyntaxError: ")
        law.write_text(format_law(50, "x = 1 / (20 - self.samples)"), encoding="utf-8")
        watch.wait_for("sample 19: own.py, line 20: ZeroDivisionError")
        assert tl.read_recording(tmp_path / "a.mcap").stop_reason == "law_failed"
        law.write_text(format_law(50, "self.gain = float('nan')"), encoding="utf-8")
        watch.wait_for("expected a finite command (below 3.4e+38), found speed nan m/s")
        law.write_text("import sys\nsys.exit(3)\n", encoding="utf-8")
        watch.wait_for("cannot be loaded: SystemExit: 3")
        law.write_text(format_law(50), encoding="utf-8")
        watch.wait_for("\n50 samples.", "0.784")
        assert watch.interrupt() == 130
    assert "Traceback" not in watch.err
    assert watch.err.count("turtlelog: error: ") == 4
    assert re.search(r"^run\.duration +s +0\.784 +1\.584$", watch.out, re.M)  # the last that ended
    assert len(tl.read_recording(tmp_path / "a.mcap").samples) == 50
    assert {path.name for path in tmp_path.iterdir()} == {"own.py", "a.mcap"}


@signals
def test_a_law_that_is_wrong_at_first_is_waited_for(law: Path, tmp_path: Path) -> None:
    law.write_text("", encoding="utf-8")
    with start(tmp_path, "--law", "own.py:Own") as watch:
        watch.wait_for("own.py has no class Own", "watching own.py")
        law.write_text(format_law(60), encoding="utf-8")
        watch.wait_for("\n60 samples.", "duration  ")
    assert "before" not in watch.out


@signals
def test_the_last_of_two_quick_saves_counts(law: Path, tmp_path: Path) -> None:
    with start(tmp_path, "--law", "own.py:Own") as watch:
        watch.wait_for("watching own.py")
        law.write_text(format_law(300), encoding="utf-8")
        law.write_text(format_law(400), encoding="utf-8")
        watch.wait_for("\n400 samples.")
        law.write_text(format_law(300), encoding="utf-8")
        time.sleep(0.25)  # while the run begins, or has just begun
        law.write_text(format_law(500), encoding="utf-8")
        watch.wait_for("\n500 samples.")


@signals
def test_a_file_that_is_replaced_or_gone_for_a_while_is_waited_for(
    law: Path, tmp_path: Path
) -> None:
    """The watch looks again by the clock, three times."""
    with start(tmp_path, "--law", "own.py:Own") as watch:
        watch.wait_for("watching own.py")
        new = tmp_path / "own.py.new"
        new.write_text(format_law(150), encoding="utf-8")
        new.replace(law)
        watch.wait_for("\n150 samples.")
        law.unlink()
        time.sleep(0.5)
        law.write_text(format_law(250), encoding="utf-8")
        watch.wait_for("\n250 samples.")
        assert watch.interrupt() == 130
    assert "error" not in watch.err


@signals
def test_a_save_that_changes_nothing_runs_again_and_says_so(law: Path, tmp_path: Path) -> None:
    with start(tmp_path, "--law", "own.py:Own") as watch:
        watch.wait_for("watching own.py")
        law.write_text(format_law(100) + "# a remark\n", encoding="utf-8")
        watch.wait_for("100 samples. The run ended: done.\n\nNo metric changed.\n")
        os.utime(law, ns=(0, 0))
        deadline = time.monotonic() + PATIENCE_S
        while watch.out.count("No metric changed.") < 2:
            assert time.monotonic() < deadline
            time.sleep(0.02)


@signals
def test_a_scenario_file_is_watched_with_the_law_that_it_names(law: Path, tmp_path: Path) -> None:
    scenario = tmp_path / "mine.toml"
    text = tl.format_scenario(
        tl.override_scenario(
            tl.load_scenario("textbook"), {"law.kind": "own.py:Own", "name": "mine"}
        )
    )
    scenario.write_text(text, encoding="utf-8")
    with start(tmp_path, scenario.name) as watch:
        watch.wait_for("\n100 samples.", "watching mine.toml, own.py:")
        scenario.write_text(text.replace("textbook", "mine") + "[[", encoding="utf-8")
        watch.wait_for("turtlelog: error: mine.toml")
        law.write_text(format_law(120), encoding="utf-8")
        scenario.write_text(text, encoding="utf-8")
        watch.wait_for("\n120 samples.")
        law.write_text(format_law(140), encoding="utf-8")
        watch.wait_for("\n140 samples.")
        law.rename(tmp_path / "other.py")
        scenario.write_text(text.replace("own.py", "other.py"), encoding="utf-8")
        watch.wait_for("watching mine.toml, other.py:")


@signals
def test_what_is_to_be_known_before_a_run_is_told_each_time(tmp_path: Path) -> None:
    scenario = tmp_path / "mine.toml"
    text = tl.format_scenario(tl.load_scenario("paper-kp10"))
    scenario.write_text(text, encoding="utf-8")
    with start(tmp_path, "mine.toml", "--kp", "40") as watch:
        watch.wait_for("watching mine.toml:")
        told = [line for line in watch.err.splitlines() if "40" in line]
        assert told
        scenario.write_text(text + "\n", encoding="utf-8")
        watch.wait_for("No metric changed.")
        assert watch.interrupt() == 130
    assert [line for line in watch.err.splitlines() if "40" in line] == told * 2


@signals
def test_a_law_without_end_is_ended_by_its_budget_and_the_watch_goes_on(
    law: Path, tmp_path: Path
) -> None:
    """A law without end is ended after its budget of time."""
    words = ("--law", "own.py:Own", "--step-budget-ms", "250")
    with start(tmp_path, *words) as watch:
        watch.wait_for("watching own.py")
        law.write_text(format_law(100, "while True: pass"), encoding="utf-8")
        watch.wait_for("sample 0 took more than 1250 ms of a budget of 250 ms")
        law.write_text(format_law(110), encoding="utf-8")
        watch.wait_for("\n110 samples.")


@signals
def test_an_interrupt_ends_a_law_without_end(law: Path, tmp_path: Path) -> None:
    law.write_text(format_law(100, "open('began', 'w').close()\n        while True: pass"))
    with start(tmp_path, "--law", "own.py:Own") as watch:
        deadline = time.monotonic() + PATIENCE_S
        while not (tmp_path / "began").exists():
            assert time.monotonic() < deadline
            time.sleep(0.02)
        assert watch.interrupt() == 130
    assert watch.err.splitlines() == ["watch ended"]


@signals
def test_scenario_file_is_watched_whatever_its_ending(tmp_path: Path) -> None:
    scenario = tmp_path / "mine.txt"
    scenario.write_text("max_duration_s = 1.0", encoding="utf-8")
    with start(tmp_path, "mine.txt") as watch:
        watch.wait_for("watching mine.txt")
        assert watch.interrupt() == 130


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (
            ("paper",),
            "--watch: the law sequential-p has no file to watch; name a scenario file, or a law"
            " as path.py:Class",
        ),
        (
            ("--law", "sequential-p"),
            "--watch: the law sequential-p has no file to watch; name a scenario file, or a law"
            " as path.py:Class",
        ),
        (
            ("--law", "mine:Law"),
            "--watch: the law mine:Law has no file to watch; name a scenario file, or a law"
            " as path.py:Class",
        ),
        (("--law", "none.py:Law"), "none.py: no such file to watch"),
        (("none.toml",), "none.toml: no such file to watch"),
        (("nosuch",), 'no preset or file "nosuch"'),
        (
            ("--realtime",),
            "--watch: leave out --realtime",
        ),
        (("--json",), "--watch: leave out --json, as there are many runs"),
    ],
)
def test_what_cannot_be_watched_is_one_line(words: tuple[str, ...], error: str, call: Call) -> None:
    answer = call("run", "--watch", *words)
    assert (answer.code, answer.out, answer.err.count("\n")) == (2, "", 1)
    assert answer.err.startswith(f"turtlelog: error: {error}")


@signals
@pytest.mark.viewer
def test_one_viewer_shows_run_after_run(law: Path, tmp_path: Path) -> None:
    """Rerun's viewer starts, and two runs are drawn."""
    with start_headless() as viewer:
        words = ("--law", "own.py:Own", "--connect", viewer.url)
        with start(tmp_path, *words) as watch:
            watch.wait_for("watching own.py")
            viewer.wait_for_end(99 * 16_000_000)
            law.write_text(format_law(200), encoding="utf-8")
            watch.wait_for("\n200 samples.")
            viewer.wait_for_end(199 * 16_000_000)
            assert watch.interrupt() == 130
        state = viewer.client.get_state()
        shown = {
            recording.store_id: line.end or 0
            for recording in state.recordings
            for line in recording.timelines
            if line.name == "sim_time"
        }
        assert len(shown) == 2
        assert max(shown, key=lambda name: shown[name]) == state.active_recording


@pytest.mark.viewer
def test_a_window_that_is_closed_ends_the_watch(
    law: Path, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    with start_headless() as viewer:

        @contextmanager
        def open_window(advice: str) -> Iterator[tuple[ViewerProcess, str]]:
            yield viewer.process, viewer.url

        def save_and_close() -> None:
            viewer.wait_for_end(99 * 16_000_000)
            law.write_text(format_law(200), encoding="utf-8")
            viewer.wait_for_end(199 * 16_000_000)
            viewer.process.end()

        monkeypatch.setattr(tl.draw, "open_window", open_window)
        user = threading.Thread(target=save_and_close)
        user.start()
        answer = call("run", "--watch", "--live", "--law", f"{law}:Own")
        user.join()
    assert (answer.code, "error" in answer.err) == (0, False)
    assert answer.out.count(" samples. The run ended: done.") == 2


@signals
def test_each_run_of_a_watch_has_the_notes_on_its_scenario(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("[law]\nkp_angular = 150.0\n", encoding="utf-8")
    with start(tmp_path, "mine.toml", "--set", "max_duration_s=0.5") as watch:
        watch.wait_for("rotate: law.kp_angular = 150 is above 125 1/s", "Final heading error")
        path.write_text("[law]\nkp_angular = 140.0\n", encoding="utf-8")
        watch.wait_for("rotate: law.kp_angular = 140 is above 125 1/s")
        assert watch.interrupt() == 130
