import re
from pathlib import Path

import numpy as np
import pytest

from tests.show.rerun.rrds import (
    list_entities,
    read_layout,
    read_rows,
    read_static,
    read_times,
    simulate_preset,
    verify,
)
from turtlelog.errors import ShowError
from turtlelog.show import write_explanation_rrd

RUN = simulate_preset("paper-kp10")
RECORDED = "/runs/recorded"


def test_the_recorded_run_stands_beside_its_what_ifs(explanation_rrd: Path) -> None:
    verify(explanation_rrd)
    names = read_static(explanation_rrd, "/__properties/runs", "name")
    assert names == ["recorded", "without pause", "without queue"]
    rows = read_rows(explanation_rrd, f"{RECORDED}/distance", "Scalars:scalars")
    assert len(rows) == len(RUN.poses)
    entity = "/runs/without_pause/distance"
    other = read_rows(explanation_rrd, entity, "Scalars:scalars")
    assert len(other) == len(simulate_preset("paper-kp4").poses)


def test_shares_are_bars_in_the_colours_of_the_runs_without_them(explanation_rrd: Path) -> None:
    view = "Shares of final.position_error [m]"
    assert read_layout(explanation_rrd)[view] == ["/shares/**"]
    colors = read_static(explanation_rrd, "/legend", "Points2D:colors")
    for number, (name, share) in enumerate({"pause": 0.05, "queue": -0.01}.items()):
        (values,) = read_static(explanation_rrd, f"/shares/{name}", "BarChart:values")
        assert share in list(values["buffer"])
        (color,) = read_static(explanation_rrd, f"/shares/{name}", "BarChart:color")
        assert color == colors[number + 1]


def test_pause_and_dead_time_are_marked_on_the_time_axis(explanation_rrd: Path) -> None:
    spans = {span.phase: span for span in RUN.find_phase_spans()}
    pause_ns = read_times(explanation_rrd, f"{RECORDED}/lines/pause") + RUN.start_ns
    assert sorted(set(pause_ns.tolist())) == [spans["pause"].start_ns, spans["pause"].end_ns]
    dead_ns = read_times(explanation_rrd, f"{RECORDED}/dead_time") + RUN.start_ns
    ticks = (np.diff(dead_ns)[::2] // 16_000_000).tolist()
    assert ticks == [4, 6]
    assert dead_ns[::2].tolist() == [spans["rotate"].start_ns, spans["translate"].start_ns]


def test_the_lines_of_pause_and_dead_time_stand_in_every_plot(explanation_rrd: Path) -> None:
    lines = {f"{RECORDED}/lines/pause", f"{RECORDED}/lines/dead_time"}
    layout = read_layout(explanation_rrd)
    plots = [view for view in layout if re.search(r"\[(deg|m|m/s|rad/s)\]$", view)]
    plots.remove("Shares of final.position_error [m]")
    assert len(plots) == 9
    assert all(lines < set(layout[view]) for view in plots)
    assert f"{RECORDED}/dead_time" in layout["Phases (brown: pause, pink: dead time)"]


def test_the_shares_are_a_table_too(explanation_rrd: Path) -> None:
    (text,) = read_static(explanation_rrd, "/documents/Shares", "TextDocument:text")
    assert "final.position_error: 0.10673 m as recorded" in text
    assert "| pause | 0.05 | 0.00852" in text
    assert "Notes" in read_layout(explanation_rrd)


def test_a_run_without_what_ifs_is_shown_alone(tmp_path: Path) -> None:
    write_explanation_rrd(RUN, {}, {}, tmp_path / "alone.rrd")
    verify(tmp_path / "alone.rrd")
    assert not {name for name in list_entities(tmp_path / "alone.rrd") if "shares" in name}


def test_a_metric_that_there_is_not_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ShowError, match=r"metric: expected an id such as .*, found 'speed'"):
        write_explanation_rrd(RUN, {}, {}, tmp_path / "none.rrd", metric="speed")
    assert not list(tmp_path.iterdir())
