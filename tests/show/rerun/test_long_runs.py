from pathlib import Path

import numpy as np
import pytest

from tests.show.rerun.rrds import (
    count_chunks,
    join_strips,
    read_rows,
    read_static,
    read_times,
    read_values,
    simulate_preset,
    verify,
)
from turtlelog.show import write_run_rrd
from turtlelog.show.rerun import run_stream

RUN = simulate_preset("paper-kp10")


def test_long_tables_are_sent_in_chunks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_stream, "CHUNK_ROWS", 100)
    write_run_rrd(RUN, tmp_path / "run.rrd")
    assert count_chunks(tmp_path / "run.rrd", "/distance") == -(-len(RUN.poses) // 100)
    rows = np.array(read_rows(tmp_path / "run.rrd", "/distance", "Scalars:scalars"))[:, 0]
    np.testing.assert_array_equal(rows, read_values("distance"))
    times_ns = read_times(tmp_path / "run.rrd", "/distance") + RUN.start_ns
    np.testing.assert_array_equal(times_ns, RUN.poses.time_ns)


def test_what_is_too_long_is_thinned_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.rrd"
    monkeypatch.setattr(run_stream, "MOST_ROWS", 500)
    monkeypatch.setattr(run_stream, "THINNED_ROWS", 90)
    write_run_rrd(RUN, path)
    verify(path)
    rows = np.array(read_rows(path, "/turn_rate/commanded", "Scalars:scalars"))[:, 0]
    commanded = RUN.samples.turn_rate_rad_s
    assert len(rows) <= 91
    assert (rows.min(), rows.max()) == (commanded.min(), commanded.max())
    (text,) = read_static(path, "/documents/Drawn", "TextDocument:text")
    assert f"about 90 of up to {len(RUN.poses)} rows" in text


def test_a_long_trace_is_thinned_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_stream, "TRACE_ROWS", 100)
    write_run_rrd(RUN, tmp_path / "run.rrd")
    trace = join_strips(tmp_path / "run.rrd", "/plane/path")
    assert len(trace) <= 101
    np.testing.assert_array_equal(trace.min(axis=0), RUN.poses.xy_m.min(axis=0))
    (text,) = read_static(tmp_path / "run.rrd", "/documents/Drawn", "TextDocument:text")
    assert "about 100 of" in text
