import tracemalloc
from dataclasses import fields
from pathlib import Path

import pytest

from benchmarks.long_runs import write_long_recording
from tests.log.runs import assert_same
from tests.torture.recordings import pack_again
from turtlelog import Run, read_recording

MOST = 1.7  # times the columns of the run that is read
SAMPLES = 100_000  # below, the chunks that are unpacked ahead take as much as the columns


def measure_reading(path: Path) -> tuple[Run, float]:
    """Return a run, and the most memory that reading it takes, by that of its columns."""
    tracemalloc.start()
    run = read_recording(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    tables = (run.poses, run.commands, run.samples)
    columns = [getattr(table, field.name) for table in tables for field in fields(table)]
    return run, peak / sum(values.nbytes for values in columns if values is not None)


@pytest.mark.parametrize("preset", ["paper-kp1", "lagged"])
def test_reading_takes_little_more_memory_than_the_run(tmp_path: Path, preset: str) -> None:
    path = tmp_path / "long.mcap"
    write_long_recording(path, SAMPLES, preset)
    _, ratio = measure_reading(path)
    assert ratio < MOST


def test_recording_without_index_is_read_alike(tmp_path: Path) -> None:
    path, plain = tmp_path / "long.mcap", tmp_path / "plain.mcap"
    write_long_recording(path, 500)
    plain.write_bytes(pack_again(path.read_bytes(), "zstd", has_index=False))
    assert_same(read_recording(plain), read_recording(path))
