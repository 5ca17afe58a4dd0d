"""Live recordings killed at random moments, and whether they kept what they must."""

import multiprocessing
import subprocess
import sys
import time
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from pathlib import Path
from random import Random
from typing import Any

import turtlelog as tl
from tests.torture.driver import ENTRY, record_live
from tests.torture.recordings import Record, list_messages
from turtlelog.errors import LogError
from turtlelog.log.recovery import recover_recording

ROOT = Path(__file__).parents[2]
MAY_LOSE_NS = 1_100_000_000
"""Of the last moments before the end; everything older must come back."""

PRESETS = ("paper-kp1", "paper-kp10", "textbook", "paper-kp4")


@dataclass(frozen=True, slots=True, kw_only=True)
class Killed:
    """A recording whose writer was killed.

    Attributes:
        preset: What ran.
        path: The recording.
        journal: What was handed to it when.
        at_ns: When it was killed, wall clock [ns].
    """

    preset: str
    path: Path
    journal: Path
    at_ns: int


def kill_recorders(
    folder: Path, count: int, *, at_once: int, latest_s: float, seed: int
) -> list[Killed]:
    """Start live recordings, some at once; kill each 1.2 to `latest_s` after its first tick."""
    random, killed = Random(seed), []
    for first in range(0, count, at_once):
        numbers = range(first, min(first + at_once, count))
        started = [_start(folder, number) for number in numbers]
        for process, found in started:
            _await_first_tick(process, found)
        begun = time.monotonic()
        moments = sorted(random.uniform(1.2, latest_s) for _ in started)
        for moment, (process, found) in zip(moments, started, strict=True):
            time.sleep(max(begun + moment - time.monotonic(), 0.0))
            at_ns = time.time_ns()
            process.kill()
            process.join()
            killed.append(
                Killed(preset=found.preset, path=found.path, journal=found.journal, at_ns=at_ns)
            )
    return killed


def kill_command(folder: Path, *, after_s: float) -> Killed:
    """Start `turtlelog run --realtime` and kill it some time after its file appeared."""
    path, preset = folder / "command.mcap", PRESETS[0]
    words = [sys.executable, "-m", "turtlelog", "run", preset, "--realtime", "-o", str(path)]
    process = subprocess.Popen(
        words, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    deadline = time.monotonic() + 60.0
    while not path.exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    time.sleep(after_s)
    at_ns = time.time_ns()
    process.kill()
    process.wait()
    return Killed(preset=preset, path=path, journal=path.with_suffix(".journal"), at_ns=at_ns)


def find_fault(killed: Killed, whole: list[Record], output: Path) -> str | None:
    """Return what a killed recording lost or altered beyond what it may, None if nothing."""
    data = killed.journal.read_bytes()
    entries = list(ENTRY.iter_unpack(data[: len(data) // ENTRY.size * ENTRY.size]))
    owed = [tick_ns for at_ns, tick_ns in entries if at_ns <= killed.at_ns - MAY_LOSE_NS]
    try:
        report = recover_recording(killed.path, output)
    except LogError as err:
        return str(err) if owed else None
    if owed and round(report.to_s * 1e9) < owed[-1]:
        return f"expected all up to {owed[-1] / 1e9:.3f} s, found {report.to_s:.3f} s"
    return find_difference(list_messages(output.read_bytes()), whole, owed[-1] if owed else -1)


def simulate_messages(preset: str, folder: Path) -> list[Record]:
    """Return the messages of the same run, simulated and written at once."""
    path = folder / f"{preset}.mcap"
    tl.write_recording(tl.simulate_run(tl.load_scenario(preset)), path)
    return list_messages(path.read_bytes())


def _start(folder: Path, number: int) -> tuple[BaseProcess, Killed]:
    preset = PRESETS[number % len(PRESETS)]
    path, journal = folder / f"{number}.mcap", folder / f"{number}.journal"
    # Forked from a process that has imported all of it, where there is such a thing.
    is_forked = "forkserver" in multiprocessing.get_all_start_methods()
    context: Any = multiprocessing.get_context("forkserver" if is_forked else "spawn")
    context.set_forkserver_preload([record_live.__module__])
    process = context.Process(target=record_live, args=(preset, path, journal), daemon=True)
    process.start()
    return process, Killed(preset=preset, path=path, journal=journal, at_ns=0)


def _await_first_tick(process: BaseProcess, found: Killed) -> None:
    deadline = time.monotonic() + 60.0
    while not (found.journal.exists() and found.journal.stat().st_size):
        if not process.is_alive() or time.monotonic() > deadline:
            process.kill()
            process.join()
            raise RuntimeError(f"expected a recorder that runs, found exit code {process.exitcode}")
        time.sleep(0.01)


def find_difference(found: list[Record], whole: list[Record], owed_ns: int) -> str | None:
    """Return where a topic is no prefix of what it should be, or ends too early."""
    for topic in {message[0] for message in whole}:
        of_topic = [message for message in found if message[0] == topic]
        expected = [message for message in whole if message[0] == topic]
        owed = sum(message[2] <= owed_ns for message in expected)
        if of_topic != expected[: len(of_topic)]:
            return f"{topic}: expected the messages of the same simulation, found others"
        if len(of_topic) < owed:
            return f"{topic}: expected at least {owed} messages, found {len(of_topic)}"
    return None
