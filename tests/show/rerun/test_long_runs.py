from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import turtlelog as tl
from tests.show.rerun.headless import start_headless
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
from turtlelog.show import palette, write_run_rrd
from turtlelog.show.palette import Color, choose_run_colors
from turtlelog.show.rerun import timelines

RUN = simulate_preset("paper-kp10")


def test_long_tables_are_sent_in_chunks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(timelines, "CHUNK_ROWS", 100)
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
    monkeypatch.setattr(timelines, "MOST_ROWS", 500)
    monkeypatch.setattr(timelines, "THINNED_ROWS", 90)
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
    monkeypatch.setattr(timelines, "TRACE_ROWS", 100)
    write_run_rrd(RUN, tmp_path / "run.rrd")
    trace = join_strips(tmp_path / "run.rrd", "/plane/path")
    assert len(trace) <= 101
    np.testing.assert_array_equal(trace.min(axis=0), RUN.poses.xy_m.min(axis=0))
    (text,) = read_static(tmp_path / "run.rrd", "/documents/Drawn", "TextDocument:text")
    assert "about 100 of" in text


@pytest.fixture(scope="module")
def turn_of_ten_minutes() -> tl.Run:
    """Return a run whose heading rises all the way, and ends well below the line of its goal."""
    changes = {"law.kp_angular": 0.004, "law.kp_linear": 0.004, "max_duration_s": 600.0}
    return tl.simulate_run(tl.override_scenario(tl.load_scenario("paper"), changes))


@pytest.mark.viewer
def test_a_run_of_ten_minutes_is_drawn_from_its_beginning_to_its_end(
    turn_of_ten_minutes: tl.Run, tmp_path: Path
) -> None:
    """And so is the short one beside it, which has ended after 2 % of the time."""
    tl.write_comparison_rrd([turn_of_ten_minutes, RUN], tmp_path / "both.rrd")
    picture = picture_heading(tmp_path / "both.rrd", "sim_time")
    long, short = (find_pixels(picture, color) for color in choose_run_colors(2))
    assert_spans(long, picture)
    assert len(short)


@pytest.mark.viewer
def test_ticks_of_a_run_of_ten_minutes_are_drawn_from_first_to_last(
    turn_of_ten_minutes: tl.Run, tmp_path: Path
) -> None:
    tl.write_run_rrd(turn_of_ten_minutes, tmp_path / "run.rrd")
    picture = picture_heading(tmp_path / "run.rrd", "tick")
    assert_spans(find_pixels(picture, palette.MAIN), picture)


def picture_heading(path: Path, timeline: str) -> NDArray[np.float64]:
    """Return the plot of the heading with the cursor at the end, shape (rows, columns, 3)."""
    with start_headless("1200x860") as viewer:
        viewer.open(path)
        viewer.wait_for_end(600 * 10**9)
        return viewer.picture_view("Heading [deg]", timeline)


def find_pixels(picture: NDArray[np.float64], color: Color) -> NDArray[np.int64]:
    """Return row and column of what has a colour, shape (n, 2)."""
    near = np.abs(picture - np.array(color) / 255.0).max(axis=2) < 0.05
    return np.argwhere(near)


def assert_spans(pixels: NDArray[np.int64], picture: NDArray[np.float64]) -> None:
    """Assert that a rising curve is there from end to end; axes and title take the rest."""
    assert len(pixels)
    assert (np.ptp(pixels, axis=0) > np.array([0.6, 0.75]) * picture.shape[:2]).all()
