import sys
import threading
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

import turtlelog as tl
from tests.draw.laws import TRACKERS, build_scenario, build_tracker, simulate_law, simulate_tracker
from tests.draw.rerun.headless import start_headless
from tests.draw.rerun.rrds import list_entities, read_rows, read_times, simulate_preset
from tests.log.live import start_recording
from turtlelog.draw.rerun import live_viewer
from turtlelog.draw.rerun.live_viewer import GrowingStream, LiveScene
from turtlelog.errors import LogError, ShowError
from turtlelog.simulate import RunCollector, Tick, iterate_ticks

SHORT = tl.override_scenario(tl.load_scenario("paper-kp4"), {"max_duration_s": 1.0})


def read_arrays(path: Path) -> list[object]:
    run = tl.read_recording(path)
    return [run.poses.xy_m.tolist(), run.samples.speed_m_s.tolist(), run.stop_reason, run.events]


def grow(scenario: tl.Scenario, grown: Path) -> None:
    """Draw a run again and again while it grows."""
    stream = GrowingStream("turtlelog")
    stream.save(grown)
    scene, collector = LiveScene(stream), RunCollector(scenario)
    ticks = list(iterate_ticks(scenario))
    for first in range(0, len(ticks), 37):
        collector.take(ticks[first : first + 37])
        scene.update(collector.build_run())
    scene.finish(collector.build_run())
    stream.disconnect()


@pytest.mark.thorough
def test_a_run_drawn_while_it_grows_has_the_rows_of_its_file(tmp_path: Path) -> None:
    """All rows of two files are compared."""
    grown, once = tmp_path / "grown.rrd", tmp_path / "once.rrd"
    grow(tl.load_scenario("paper-kp10"), grown)
    tl.write_run_rrd(simulate_preset("paper-kp10"), once)
    for entity, component in ROWS.items():
        assert read_times(grown, entity).tolist() == read_times(once, entity).tolist(), entity
        assert read_rows(grown, entity, component) == read_rows(once, entity, component), entity
    assert list_entities(grown) == list_entities(once)


@pytest.mark.everyday("OpenLoop")
@pytest.mark.parametrize("kind", ["strange", "Follower", "EightPhases", "OpenLoop", *TRACKERS])
def test_a_run_of_any_law_drawn_while_it_grows_is_its_file(kind: str, tmp_path: Path) -> None:
    """All rows of two files are compared, of a path with many references."""
    is_tracker = kind in TRACKERS
    scenario = build_tracker(kind) if is_tracker else build_scenario(kind)
    grown, once = tmp_path / "grown.rrd", tmp_path / "once.rrd"
    grow(scenario, grown)
    tl.write_run_rrd(simulate_tracker(kind) if is_tracker else simulate_law(kind), once)
    assert list_entities(grown) == list_entities(once)
    moving = {"/heading_deg/reference", "/position/reference", "/state/memory", "/heading_deg"}
    moving |= {"/along_track_error", "/along_track/reference", "/cross_track"}
    for entity in moving & list_entities(once):
        drawn, whole = (
            np.array(read_rows(rrd, entity, "Scalars:scalars")) for rrd in (grown, once)
        )
        np.testing.assert_array_equal(drawn, whole)
    if "/plane/reference_pose" in list_entities(once):
        component = "Arrows2D:origins"
        rows = [read_rows(rrd, "/plane/reference_pose", component) for rrd in (grown, once)]
        assert rows[0] == rows[1]
    if "/plane/error" in list_entities(once):
        ways = [read_rows(rrd, "/plane/error", "Arrows2D:vectors") for rrd in (grown, once)]
        assert ways[0] == ways[1]


def test_path_reference_and_errors_are_there_while_a_tracker_runs(tmp_path: Path) -> None:
    stream = GrowingStream("turtlelog")
    stream.save(tmp_path / "live.rrd")
    scenario = build_tracker("kanayama")
    collector = RunCollector(scenario)
    collector.take(list(iterate_ticks(scenario))[:300])
    LiveScene(stream).update(collector.build_run())
    stream.disconnect()
    shown = list_entities(tmp_path / "live.rrd")
    assert {"/plane/tracked_path", "/plane/reference_pose", "/plane/error"} <= shown
    assert {"/along_track_error", "/along_track/reference", "/cross_track"} <= shown
    assert "/plane/close_up/worst" not in shown


ROWS = {
    "/heading_deg": "Scalars:scalars",
    "/position": "Scalars:scalars",
    "/wanted_speed/wanted": "Scalars:scalars",
    "/turn_rate/applied": "Scalars:scalars",
    "/distance_log10": "Scalars:scalars",
    "/heading_deg/ideal": "Scalars:scalars",
    "/plane/error": "Arrows2D:vectors",
    "/plane/turtle/command": "Arrows2D:vectors",
    "/plane/turtle": "Transform3D:translation",
    "/phase": "StateChange:state",
    "/events": "TextLog:text",
}


@pytest.mark.viewer
@pytest.mark.realtime
def test_a_live_run_has_the_entities_of_its_file(tmp_path: Path) -> None:
    with start_headless() as viewer:
        sink = tl.draw.LiveViewer(SHORT, viewer.url)
        run = tl.simulate.run_live(SHORT, [sink], realtime=True)
        assert sink.lost == ""
        viewer.wait_for_end(run.end_ns - run.start_ns)
        shown = viewer.list_entities()
        reports = [report for view in viewer.client.get_state().views for report in view.reports]
    tl.write_run_rrd(run, tmp_path / "run.rrd")
    assert shown >= {name for name in list_entities(tmp_path / "run.rrd") if "__" not in name}
    assert not reports


@pytest.mark.viewer
@pytest.mark.realtime
def test_a_viewer_that_is_killed_does_the_recording_no_harm(tmp_path: Path) -> None:
    with start_headless() as viewer:
        sink = tl.draw.LiveViewer(SHORT, viewer.url)
        killer = threading.Timer(0.4, viewer.kill)
        with tl.Recorder(tmp_path / "live.mcap", SHORT) as recorder:
            killer.start()
            run = tl.simulate.run_live(SHORT, [recorder, sink], realtime=True)
        killer.join()
    assert sink.lost == "the connection has ended"
    assert run.stop_reason == "max_duration"
    with tl.Recorder(tmp_path / "alone.mcap", SHORT) as recorder:
        tl.simulate.run_live(SHORT, [recorder], realtime=False)
    assert read_arrays(tmp_path / "live.mcap") == read_arrays(tmp_path / "alone.mcap")


@pytest.mark.viewer
@pytest.mark.realtime
@pytest.mark.skipif(sys.platform == "win32", reason="Windows cannot stop a process for a while")
def test_a_viewer_that_hangs_holds_nothing_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Eight seconds are simulated by the clock: that fills the connection."""
    monkeypatch.setattr(live_viewer, "_FLUSH_S", 0.5)
    # Long enough to fill what a connection takes without an answer, however few batches it makes.
    scenario = tl.override_scenario(SHORT, {"max_duration_s": 8.0})
    lags_s: list[float] = []
    taken_s: list[float] = []

    class Watch:
        """Hands the ticks on, and notes how long that takes and how late the loop is."""

        def __init__(self, sink: tl.draw.LiveViewer) -> None:
            self.sink = sink

        def receive(self, tick: Tick) -> None:
            before_s = time.monotonic()
            self.sink.receive(tick)
            taken_s.append(time.monotonic() - before_s)
            lags_s.append(before_s - start_s - tick.time_ns / 1e9)

        def close(self, notes: Mapping[str, str]) -> None:
            self.sink.close(notes)

    with start_headless() as viewer, viewer.hold():
        sink = tl.draw.LiveViewer(scenario, viewer.url)
        start_s = time.monotonic()
        tl.simulate.run_live(scenario, [Watch(sink)], realtime=True)
        assert time.monotonic() - start_s < 20.0
    assert sink.lost == "no answer for 0.5 s"
    assert max(taken_s) < 0.25  # One wait for the viewer would take 0.5 s.
    assert max(lags_s) < 1.0


@pytest.mark.viewer
@pytest.mark.realtime
def test_a_recording_in_progress_is_followed_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    recorder = start_recording(path, PROGRAM)
    try:
        with start_headless() as viewer:
            wait_for_file(path)
            run = tl.draw.follow_recording(path, viewer.url)
            viewer.wait_for_end(run.end_ns - run.start_ns)
            assert {"/speed/commanded", "/plane/path", "/phase"} <= viewer.list_entities()
    finally:
        recorder.communicate(timeout=30)
    assert run.stop_reason == "max_duration"
    assert run.poses.xy_m.tolist() == tl.read_recording(path).poses.xy_m.tolist()


PROGRAM = """
import sys
import turtlelog as tl

scenario = tl.override_scenario(tl.load_scenario("paper-kp4"), {"max_duration_s": 1.2})
with tl.Recorder(sys.argv[1], scenario, flush_s=0.2) as recorder:
    tl.simulate.run_live(scenario, [recorder], realtime=True)
"""


def wait_for_file(path: Path) -> None:
    deadline = time.monotonic() + 20.0
    while not (path.exists() and path.stat().st_size > 500):
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.parametrize(
    ("url", "found"),
    [
        ("rerun+http://127.0.0.1:9/proxy", "expected a viewer that runs, found"),
        ("127.0.0.1", "expected a viewer's address, as rerun"),
        ("http://[", "expected a viewer's address, as rerun"),
        ("rerun+http://127.0.0.1:99999/proxy", "expected a viewer's address, as rerun"),
    ],
)
def test_an_address_without_a_viewer_is_refused_before_anything_runs(url: str, found: str) -> None:
    with pytest.raises(ShowError, match=found):
        tl.draw.LiveViewer(SHORT, url)


def test_following_names_what_is_no_recording(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"no recording at all")
    with pytest.raises(LogError, match=r"a\.mcap: "):
        tl.draw.follow_recording(tmp_path / "a.mcap")
    with pytest.raises(ShowError, match=r"none\.mcap: expected a recording, found no such file"):
        tl.draw.follow_recording(tmp_path / "none.mcap")
