"""Views and figures: Rerun recordings against bare `send_columns`, figures against bare Matplotlib.

Bare `send_columns` sends the same rows of the same curves on the same timelines, and nothing else.
The million samples are a run that was stretched.
"""

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import rerun as rr
from numpy.typing import NDArray

import turtlelog as tl
from benchmarks.long_runs import lengthen_run
from benchmarks.table import ROOT, Cost, Row, run_alone, time_calls, time_commands
from turtlelog.draw.rerun.recording_stream import (
    CHUNK_ROWS,
    RunStream,
    build_index,
    build_run_timelines,
)

SAMPLES = 1_000_000
RECORDING = ROOT / "recordings" / "paper" / "kp10.mcap"

BARE_FIGURES = """
import sys
from matplotlib.figure import Figure
for number in range(int(sys.argv[2])):
    figure = Figure()
    figure.subplots(2).tolist()[0].plot([0, 1], label="y")
    figure.legend()
    figure.savefig(f"{sys.argv[1]}/{number}.pdf")
"""

Sent = list[tuple[str, NDArray[np.int64], NDArray[np.float64], Any]]


def collect_sent(run: tl.Run, path: Path) -> Sent:
    """Write a run and return what was sent by rows: entity, times, values, and what built them."""
    sent: Sent = []
    send = RunStream.send

    def keep(self: RunStream, entity: str, time_ns: Any, values: Any, build: Any) -> None:
        sent.append((entity, *self.thin(time_ns, values), build))
        send(self, entity, time_ns, values, build)

    with patch.object(RunStream, "send", keep):
        tl.write_run_rrd(run, path)
    return sent


def send_bare(run: tl.Run, sent: Sent, path: Path) -> None:
    """Send the same columns on the same timelines, and nothing else."""
    timelines = build_run_timelines(run)
    with rr.RecordingStream("turtlelog", send_properties=False) as stream:
        stream.set_log_time_enabled(False)
        stream.save(path)
        for entity, time_ns, values, build in sent:
            for start in range(0, len(values), CHUNK_ROWS):
                part = slice(start, start + CHUNK_ROWS)
                stream.send_columns(
                    entity, build_index(timelines.read(time_ns[part])), build(values[part])
                )


def measure_rrd(name: str, run: tl.Run, folder: Path, repeats: int) -> Row:
    """Return the time to write one run, beside that of bare `send_columns`."""
    path, bare = folder / "run.rrd", folder / "bare.rrd"
    sent = collect_sent(run, path)
    write, send = time_calls(
        lambda: tl.write_run_rrd(run, path), lambda: send_bare(run, sent, bare), repeats=repeats
    )
    return Row(
        job=f".rrd of {name}", value=write, peer=Cost("send_columns", send, is_yardstick=True)
    )


def measure_figures(folder: Path) -> Row:
    """Return the time of all figures of one run as PDF, beside as many of two empty axes."""
    ours = [sys.executable, "-m", "turtlelog", "plot", str(RECORDING), "-o", str(folder)]
    time_commands(ours, repeats=1)
    count = len(list(folder.glob("*.pdf")))
    bare = [sys.executable, "-c", BARE_FIGURES, str(folder), str(count)]
    plot, matplotlib = time_commands(ours, bare, repeats=3)
    return Row(
        job=f"plot, all {count} figures of a run",
        value=plot,
        peer=Cost("empty axes", matplotlib, is_yardstick=True),
        aim=5.0,
        aim_of="value",
    )


def measure(share: float = 1.0) -> Iterator[Row]:
    run = tl.simulate_run(tl.load_scenario("paper-kp10"))
    runs = [tl.simulate_run(tl.load_scenario(name)) for name in tl.scenario.PAPER_RUNS]
    samples = round(SAMPLES * share)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        tl.write_run_rrd(run, folder / "first.rrd")  # the first call loads Rerun
        yield measure_rrd(f"{len(run.samples):,} samples", run, folder, 7)
        (four,) = time_calls(lambda: tl.write_comparison_rrd(runs, folder / "four.rrd"))
        yield Row(job=".rrd of four runs", value=four)
        long = lengthen_run(run, samples)
        yield measure_rrd(f"{samples:,} samples", long, folder, 3)
        size = (folder / "run.rrd").stat().st_size / 1e6
        yield Row(
            job=f"size of the .rrd of {samples:,}", value=size, unit="MB", aim=44, aim_of="value"
        )
        yield measure_figures(folder / "figures")


if __name__ == "__main__":
    run_alone(measure)
