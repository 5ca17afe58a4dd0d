"""Programs that record while a test ends them, and what an unfinished file holds."""

import subprocess
import sys
import textwrap
from pathlib import Path

from mcap.records import Message
from mcap.stream_reader import StreamReader

ROOT = Path(__file__).parents[2]

PROGRAM = """
import sys
from turtlelog.log.recording.recorder import Recorder
from turtlelog.simulate.collect import run_live
from turtlelog.scenario import get_preset, override_scenario

class Reporter:
    def receive(self, tick):
        sys.stdout.write(f"{tick.time_ns}\\n")
        sys.stdout.flush()
    def close(self, notes):
        pass

scenario = override_scenario(get_preset("paper"), {"law.kp_angular": 0.0001})
with Recorder(sys.argv[1], scenario) as recorder:
    run_live(scenario, [recorder, Reporter()], realtime=True)
"""


def start_recording(path: Path, program: str = PROGRAM) -> "subprocess.Popen[str]":
    """Start a program that records to `path` at wall clock and prints the time of every tick."""
    command = [sys.executable, "-c", textwrap.dedent(program), str(path)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT)


def wait_for_tick(process: "subprocess.Popen[str]", time_s: float) -> None:
    """Return when the program has simulated so much."""
    assert process.stdout is not None
    for line in process.stdout:
        if int(line) >= time_s * 1e9:
            return


def read_rest(process: "subprocess.Popen[str]") -> int:
    """Return the time of the last tick that an ended program has printed [ns]."""
    out, _ = process.communicate(timeout=30)
    lines = [line for line in out.split("\n")[:-1] if line]
    return int(lines[-1]) if lines else 0


def read_messages(path: Path) -> list[Message]:
    """Return the messages of a file up to the place where it ends, finished or not."""
    messages: list[Message] = []
    with path.open("rb") as stream:
        try:
            for record in StreamReader(stream, validate_crcs=True).records:
                if isinstance(record, Message):
                    messages.append(record)
        except Exception:
            return messages
    return messages
