"""Peaks of memory, each in a process of its own: reading, streaming, and a log too long to explain.

What the imports took before is left out. The recording is a run that was stretched; a peak is told
as a ratio to the columns of the run, which are the bound: they are what is asked for.
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.bench_engine import write_file
from benchmarks.large_files import write_large_file
from benchmarks.long_runs import write_long_bag, write_long_recording
from benchmarks.table import Cost, Row, run_alone, run_apart

SAMPLES = 1_500_000
CHUNKS_OF = 200_000  # messages, that are repeated in the large file
LARGE = 10**9  # bytes

READ = """
import contextlib, dataclasses, time, turtlelog as tl
from turtlelog.explain import identify_run
with contextlib.suppress(ImportError):
    import numba
tl.read_recording("recordings/paper/kp1.mcap")  # brings all that is imported on the way
before = read_peak()
run = tl.read_recording(arguments[0])
said["peak"] = read_peak() - before
kinds = [run.poses, run.commands, run.samples]
values = [getattr(kind, field.name) for kind in kinds for field in dataclasses.fields(kind)]
said["columns"] = sum(found.nbytes for found in values if found is not None) / 1e6
start = time.process_time()
try:
    identify_run(run)
except tl.errors.TurtlelogError as err:
    said["refused"] = str(err)
said["explain"] = time.process_time() - start
said["both"] = read_peak() - before
"""

STREAM = """
import time, turtlelog.log as log
list(log.iter_columns("recordings/paper/kp1.mcap"))
before = read_peak()
said["rows"] = sum(len(c) for batch in log.iter_columns(arguments[0]) for c in batch.values())
said["peak"] = read_peak() - before
times = []
for _ in range(3):
    start = time.process_time()
    log.read_info(arguments[0])
    times.append(time.process_time() - start)
said["info"] = min(times)
"""


METRICS = """
import turtlelog as tl
def read():
    return tl.measure_run(tl.read_run(arguments.pop(0)))
read()  # a short one brings all that is imported on the way
before = read_peak()
read()
said["peak"] = read_peak() - before
"""

POSES = 1_000_000
POSE_BYTES = 150
"""Memory that `metrics` may take for a pose of a bag without samples [bytes]."""


def measure(share: float = 1.0) -> Iterator[Row]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = folder / "long.mcap"
        samples = round(SAMPLES * share)
        write_long_recording(path, samples)
        said = run_apart(READ, str(path))
        path.unlink()
        columns = Cost("columns", said["columns"])
        job = f"peak of reading {samples:,}"
        yield Row(job=job, value=said["peak"], unit="MB", bound=columns, aim=1.7)
        yield Row(job="peak of explaining them", value=said["both"], unit="MB", bound=columns)
        yield Row(job=f"explain {samples:,} samples", value=said["explain"])
        yield measure_bag(folder, round(POSES * share))
        small, large = folder / "small.mcap", folder / "large.mcap"
        write_file(small, round(CHUNKS_OF * share))
        messages = write_large_file(large, small, round(LARGE * share))
        said = run_apart(STREAM, str(large))
        assert said["rows"] == messages
        size = f"{large.stat().st_size / 1e9:.2g} GB"
        # Whatever the size of the file: a small machine has room for it.
        yield Row(
            job=f"peak of streaming {size}", value=said["peak"], unit="MB", aim=300, aim_of="value"
        )
        yield Row(job=f"info of {size}", value=said["info"], aim=0.2, aim_of="value")


def measure_bag(folder: Path, poses: int) -> Row:
    """Return what the metrics of a long bag without samples take for each pose."""
    short, long = folder / "short_bag.mcap", folder / "long_bag.mcap"
    write_long_bag(short, 1000)
    write_long_bag(long, poses)
    said = run_apart(METRICS, str(short), str(long))
    long.unlink()
    job = f"metrics of {poses:,} poses, each"
    value = said["peak"] * 1e6 / poses
    return Row(job=job, value=value, unit="B", aim=POSE_BYTES, aim_of="value")


if __name__ == "__main__":
    run_alone(measure)
