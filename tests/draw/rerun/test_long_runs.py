from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from numpy.typing import NDArray

import turtlelog as tl
from tests.draw.rerun.headless import start_headless
from tests.draw.rerun.rrds import (
    count_chunks,
    join_strips,
    read_rows,
    read_static,
    read_times,
    read_values,
    simulate_preset,
    verify,
)
from turtlelog.charts import palette
from turtlelog.charts.palette import Color, choose_run_colors
from turtlelog.draw import write_run_rrd
from turtlelog.draw.rerun import recording_stream
from turtlelog.run.columns import take_rows

RUN = simulate_preset("paper-kp10")

SCALARS = "Scalars:scalars"


def test_long_tables_are_sent_in_chunks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording_stream, "CHUNK_ROWS", 100)
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
    monkeypatch.setattr(recording_stream, "MOST_ROWS", 90)
    write_run_rrd(RUN, path)
    verify(path)
    rows = np.array(read_rows(path, "/turn_rate/commanded", SCALARS))[:, 0]
    commanded = RUN.samples.turn_rate_rad_s
    borders = 2 * (2 * len(RUN.find_phase_spans()) + len(RUN.events))
    assert len(rows) <= 91 + borders
    assert (rows.min(), rows.max()) == (commanded.min(), commanded.max())
    (text,) = read_static(path, "/documents/Drawn", "TextDocument:text")
    assert f"about 90 of up to {len(RUN.poses)} rows" in text
    assert "the rows beside each border of a phase and each event" in text


def test_borders_of_phases_and_events_of_a_thinned_curve_are_exact(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.rrd"
    monkeypatch.setattr(recording_stream, "MOST_ROWS", 90)
    write_run_rrd(RUN, path)
    spans = [ns for span in RUN.find_phase_spans() for ns in (span.start_ns, span.end_ns)]
    borders_ns = [*spans, *(event.time_ns for event in RUN.events)]
    times_ns = RUN.poses.time_ns
    after = np.searchsorted(times_ns, borders_ns).clip(1, len(times_ns) - 1)
    kept_ns = read_times(path, "/distance") + RUN.start_ns
    assert set(times_ns[after]) | set(times_ns[after - 1]) <= set(kept_ns)
    shown = np.interp(borders_ns, kept_ns, np.ravel(read_rows(path, "/distance", SCALARS)))
    np.testing.assert_array_equal(shown, np.interp(borders_ns, times_ns, read_values("distance")))


class Received:
    """Stands for a recording, and counts the rows that it receives."""

    rows = 0

    def send_columns(self, _: str, index: list[Any], __: object) -> None:
        self.rows += len(index[0].times)


@pytest.mark.parametrize(("rows", "is_thinned"), [(2**18, False), (2**18 + 1, True)])
def test_every_row_of_a_curve_is_sent_up_to_a_quarter_of_a_million(
    rows: int, *, is_thinned: bool
) -> None:
    received: Any = Received()
    stream = recording_stream.RunStream(received, "", recording_stream.Timelines(zero_ns=0))
    values = np.sin(np.arange(rows) / 7.0)
    stream.send("curve", np.arange(rows), values, lambda part: rr.Scalars.columns(scalars=part))
    assert (received.rows < rows) == is_thinned
    assert received.rows > rows / 2


@pytest.mark.parametrize("beyond", [0, 1])
def test_borders_are_kept_up_to_sixteen_thousand(
    monkeypatch: pytest.MonkeyPatch, beyond: int
) -> None:
    """More of them would undo the thinning."""
    monkeypatch.setattr(recording_stream, "MOST_ROWS", 90)
    spans = {ns for span in RUN.find_phase_spans() for ns in (span.start_ns, span.end_ns)}
    times_ns = range(1, 2**14 - len(spans) + beyond + 1)
    events = tuple(tl.run.Event(time_ns=ns, kind="wall_hit", text="") for ns in times_ns)
    found = recording_stream.build_run_timelines(replace(RUN, events=events)).borders_ns
    assert len(found) == (0 if beyond else 2**14)


def test_of_a_run_with_too_many_borders_no_rows_beside_them_are_promised(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(recording_stream, "MOST_ROWS", 90)
    events = tuple(tl.run.Event(time_ns=ns, kind="wall_hit", text="") for ns in range(2**14 + 1))
    crowded = replace(RUN, name="crowded", events=events)
    beside = "the rows beside each border of a phase and each event"
    text = recording_stream.add_thinning({}, [RUN, crowded])["Drawn"]
    assert f"{beside} (not of crowded: more than 16,384)." in text
    assert f"{beside}." in recording_stream.add_thinning({}, [RUN])["Drawn"]
    assert "beside" not in recording_stream.add_thinning({}, [crowded])["Drawn"]
    rows = slice(80)
    short = replace(
        crowded,
        poses=take_rows(RUN.poses, rows),
        samples=take_rows(RUN.samples, rows),
        commands=take_rows(RUN.commands, rows),
    )
    assert f"{beside}." in recording_stream.add_thinning({}, [RUN, short])["Drawn"]


def test_a_long_trace_is_thinned_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording_stream, "TRACE_ROWS", 100)
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


@pytest.mark.thorough
@pytest.mark.viewer
def test_a_run_of_ten_minutes_is_drawn_from_its_beginning_to_its_end(
    turn_of_ten_minutes: tl.Run, tmp_path: Path
) -> None:
    """Rerun's viewer draws ten minutes in software.

    And so is the short one beside it, which has ended after 2 % of the time.
    """
    tl.write_comparison_rrd([turn_of_ten_minutes, RUN], tmp_path / "both.rrd")
    picture = picture_heading(tmp_path / "both.rrd", "sim_time")
    long, short = (find_pixels(picture, color) for color in choose_run_colors(2))
    assert_spans(long, picture)
    assert len(short)


@pytest.mark.thorough
@pytest.mark.viewer
def test_ticks_of_a_run_of_ten_minutes_are_drawn_from_first_to_last(
    turn_of_ten_minutes: tl.Run, tmp_path: Path
) -> None:
    """Rerun's viewer draws ten minutes in software."""
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
