"""Rerun recordings, against bare `send_columns` of the same columns and against row by row.

python benchmarks/bench_show.py [samples of the long run, 1000000 otherwise]
"""

import gc
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import rerun as rr
from numpy.typing import NDArray

import turtlelog as tl
from turtlelog.show.rerun.timelines import CHUNK_ROWS, RunStream, build_index, build_run_timelines

LOGGED_ROWS = 2_000

Sent = list[tuple[str, NDArray[np.int64], NDArray[np.float64], Any]]


def measure(call: Callable[[], object], repeats: int) -> tuple[float, float]:
    """Return the median and the least time of a call [s]."""
    times = []
    for _ in range(repeats):
        gc.collect()
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return statistics.median(times), min(times)


def lengthen_run(run: tl.Run, rows: int) -> tl.Run:
    """Return a run of that many samples, each phase as much longer."""
    chosen = np.arange(rows) * len(run.samples) // rows
    time_ns = np.arange(rows, dtype=np.int64) * 16_000_000
    number = np.arange(rows, dtype=np.int64)
    poses = take(run.poses, run.samples.pose_sequence[chosen], time_ns=time_ns)
    commands = take(run.commands, chosen, time_ns=time_ns)
    changed = {"time_ns": time_ns, "sequence": number, "pose_sequence": number}
    samples = take(run.samples, chosen, **changed)
    return replace(run, poses=poses, samples=samples, commands=commands, events=())


def take(columns: Any, rows: NDArray[np.int64], **changed: NDArray[np.int64]) -> Any:
    """Return rows of all columns, some of them changed."""
    taken = {column.name: getattr(columns, column.name) for column in fields(columns)}
    taken = {name: None if found is None else found[rows] for name, found in taken.items()}
    return type(columns)(**{**taken, **changed})


def collect_sent(run: tl.Run, path: Path) -> Sent:
    """Write a run and return what was sent by rows: entity, times, values, and what built them."""
    sent: Sent = []
    send = RunStream.send

    def keep(self: RunStream, *arguments: Any) -> None:
        sent.append(arguments)
        send(self, *arguments)

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


def log_rows(sent: Sent, path: Path) -> int:
    """Log the first rows of the same curves value by value; return how many rows."""
    curves = [(entity, times, values) for entity, times, values, _ in sent if "plane" not in entity]
    with rr.RecordingStream("turtlelog", send_properties=False) as stream:
        stream.save(path)
        for entity, times, values in curves:
            for time_ns, value in zip(times[:LOGGED_ROWS], values[:LOGGED_ROWS], strict=True):
                stream.set_time("sim_time", duration=np.timedelta64(int(time_ns), "ns"))
                stream.log(entity, rr.Scalars(value))
    return sum(len(times[:LOGGED_ROWS]) for _, times, _ in curves)


def bench_run(name: str, run: tl.Run, folder: Path, repeats: int) -> None:
    """Time one run against both other ways."""
    path = folder / "run.rrd"
    sent = collect_sent(run, path)
    rows = sum(len(values) for _, _, values, _ in sent)
    write, least = measure(lambda: tl.write_run_rrd(run, path), repeats)
    size = path.stat().st_size / 1e6
    known, _ = measure(lambda: tl.write_run_rrd(run, path, documents={}), repeats)
    bare, _ = measure(lambda: send_bare(run, sent, folder / "bare.rrd"), repeats)
    start = time.perf_counter()
    logged = log_rows(sent, folder / "rows.rrd")
    by_row = (time.perf_counter() - start) / logged * rows
    print(f"{name}: {len(run.samples):,} samples, {len(sent)} entities, {rows:,} rows")
    print(f"  write_run_rrd       {write * 1e3:9.1f} ms, least {least * 1e3:.1f} ms, {size:.2f} MB")
    print(f"  without documents   {known * 1e3:9.1f} ms")
    print(f"  bare send_columns   {bare * 1e3:9.1f} ms, ratio {write / bare:.2f}")
    print(
        f"  rr.log by row       {by_row * 1e3:9.1f} ms, {by_row / write:.0f} times as long (scaled)"
    )


def main() -> None:
    long_rows = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    run = tl.simulate_run(tl.load_scenario("paper-kp1"))
    runs = [tl.simulate_run(tl.load_scenario(name)) for name in tl.scenario.PAPER_RUNS]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        tl.write_run_rrd(run, folder / "first.rrd")  # the first call loads Rerun
        bench_run("one run", run, folder, 9)
        four, least = measure(lambda: tl.write_comparison_rrd(runs, folder / "four.rrd"), 5)
        size = (folder / "four.rrd").stat().st_size / 1e6
        print(f"four runs: {four * 1e3:.1f} ms, least {least * 1e3:.1f} ms, {size:.2f} MB")
        bench_run("long run", lengthen_run(run, long_rows), folder, 3)


if __name__ == "__main__":
    main()
