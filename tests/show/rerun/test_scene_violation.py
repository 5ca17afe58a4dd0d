from pathlib import Path

import numpy as np
import pytest

from tests.show.rerun.headless import start_headless
from tests.show.rerun.rrds import (
    list_entities,
    read_blueprint,
    read_rows,
    read_static,
    read_times,
    simulate_preset,
    verify,
)
from turtlelog.show import write_run_rrd, write_violation_rrd

RUN = simulate_preset("paper-kp10")
AT_S = 3.2
AT_NS = 3_200_000_000


def test_the_mark_is_where_the_turtle_was(violation_rrd: Path) -> None:
    verify(violation_rrd)
    (place,) = read_static(violation_rrd, "/plane/violation", "Points2D:positions")
    row = int(np.searchsorted(RUN.poses.time_ns, RUN.start_ns + AT_NS, side="right")) - 1
    np.testing.assert_array_equal(place, RUN.poses.xy_m[row])
    labels = read_static(violation_rrd, "/plane/violation", "Points2D:labels")
    assert labels == ["speed <= 0.5"]


def test_the_layout_holds_the_cursor_at_the_violation(violation_rrd: Path) -> None:
    panel = read_blueprint(violation_rrd, "/time_panel")
    assert panel["TimePanelBlueprint:timeline"] == ["sim_time"]
    (selection,) = panel["TimePanelBlueprint:time_selection"]
    assert selection == {"min": AT_NS, "max": AT_NS}


@pytest.mark.viewer
def test_the_viewer_opens_at_the_violation(violation_rrd: Path) -> None:
    with start_headless() as viewer:
        viewer.open(violation_rrd)
        viewer.wait_for_time(AT_NS)
        assert "/plane/violation" in viewer.list_entities()


def test_the_violation_is_an_event_among_the_others(violation_rrd: Path) -> None:
    texts = [row[0] for row in read_rows(violation_rrd, "/events", "TextLog:text")]
    times_ns = read_times(violation_rrd, "/events").tolist()
    assert times_ns == sorted(times_ns)
    assert texts[times_ns.index(AT_NS)] == "Violation: speed <= 0.5"
    assert len(texts) == len(RUN.events) + 1
    assert AT_NS in read_times(violation_rrd, "/lines/event")


def test_the_message_is_the_first_document(violation_rrd: Path) -> None:
    (text,) = read_static(violation_rrd, "/documents/Violation", "TextDocument:text")
    assert text == "```\nspeed <= 0.5: found 1 m/s\n```"


def test_all_else_is_as_in_the_recording_of_the_run(violation_rrd: Path, tmp_path: Path) -> None:
    write_run_rrd(RUN, tmp_path / "run.rrd")
    more = {"/plane/violation", "/documents/Violation"}
    assert list_entities(violation_rrd) == list_entities(tmp_path / "run.rrd") | more


@pytest.mark.parametrize("at_s", [-1.0, 0.0, 1e6])
def test_a_violation_beyond_the_run_is_marked_at_its_end(at_s: float, tmp_path: Path) -> None:
    path = tmp_path / "x.rrd"
    write_violation_rrd(RUN, path, at_s=at_s, title="t", message="m")
    (place,) = read_static(path, "/plane/violation", "Points2D:positions")
    expected = RUN.poses.xy_m[-1 if at_s > 1.0 else 0]
    np.testing.assert_allclose(place, expected, atol=1e-6)
