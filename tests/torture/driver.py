"""A live recording that is about to be killed, and a journal of what was handed to it when."""

import struct
import time
from pathlib import Path

import turtlelog as tl
from turtlelog.log.recording.recorder import Recorder
from turtlelog.simulate import iterate_ticks

ENTRY = struct.Struct("<qq")
"""Wall clock after a tick was handed over, and the tick's own time [ns]."""


def record_live(preset: str, recording: Path, journal: Path) -> None:
    scenario = tl.load_scenario(preset)
    with journal.open("wb", buffering=0) as entries, Recorder(recording, scenario) as recorder:
        start_ns = time.monotonic_ns()
        for tick in iterate_ticks(scenario):
            wait_ns = start_ns + tick.time_ns - time.monotonic_ns()
            time.sleep(max(wait_ns, 0) / 1e9)
            recorder.receive(tick)
            entries.write(ENTRY.pack(time.time_ns(), tick.time_ns))
