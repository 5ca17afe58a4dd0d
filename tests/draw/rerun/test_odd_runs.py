import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.draw.rerun.rrds import (
    list_entities,
    make_foreign_run,
    read_blueprint_parts,
    read_layout,
    read_rows,
    read_static,
    simulate_preset,
    verify,
)
from turtlelog.draw import document_run, write_run_rrd
from turtlelog.run import PoseColumns, Run, SampleColumns, take_rows

RUN = simulate_preset("paper-kp10")


def test_columns_that_a_log_lacks_are_left_out(tmp_path: Path) -> None:
    samples = replace(RUN.samples, wanted_speed_m_s=None, wanted_turn_rate_rad_s=None)
    poses = replace(RUN.poses, speed_m_s=None, turn_rate_rad_s=None)
    write_run_rrd(replace(RUN, samples=samples, poses=poses), tmp_path / "run.rrd")
    curves = {name for name in list_entities(tmp_path / "run.rrd") if "speed" in name}
    drawn = {"/speed/lines/event"} | {
        "/speed/commanded",
        "/speed/marks",
        "/reference/speed/limits",
        "/plane/path_by_speed",
    }
    assert curves == drawn


def test_a_run_without_samples_shows_what_it_holds(tmp_path: Path) -> None:
    run, path = make_foreign_run(300), tmp_path / "bag.rrd"
    write_run_rrd(run, path)
    verify(path)
    views = {
        "Plane (yellow: command)",
        "Heading [deg]",
        "Turn rate [rad/s]",
        "Position [m]",
        "Speed [m/s]",
    }
    views |= {"Metrics", "Scenario", "By speed, 0 to 0.333 m/s"}
    assert set(read_layout(path)) == views
    rows = np.array(read_rows(path, "/speed/commanded", "Scalars:scalars"))
    np.testing.assert_array_equal(rows[:, 0], run.commands.speed_m_s)


def test_a_single_pose_shows_the_plane_alone(tmp_path: Path) -> None:
    write_run_rrd(make_foreign_run(1), tmp_path / "run.rrd")
    verify(tmp_path / "run.rrd")
    assert set(read_layout(tmp_path / "run.rrd")) == {
        "Plane (yellow: command)",
        "Metrics",
        "Scenario",
    }


def cut_samples(count: int) -> SampleColumns:
    columns = {name: getattr(RUN.samples, name) for name in RUN.samples.__dataclass_fields__}
    kept = {name: rows[:count].copy() for name, rows in columns.items() if rows is not None}
    return replace(RUN.samples, **kept)


def cut_after(count: int) -> Run:
    """Return a run that was cut while rotating, at its nth pose."""
    poses = take_rows(RUN.poses, slice(count))
    end_ns = poses.time_ns[-1]
    samples = cut_samples(int(np.searchsorted(RUN.samples.time_ns, end_ns)))
    rows = RUN.commands.time_ns <= end_ns
    names = RUN.commands.__dataclass_fields__
    commands = replace(RUN.commands, **{name: getattr(RUN.commands, name)[rows] for name in names})
    return replace(
        RUN,
        poses=poses,
        samples=samples,
        commands=commands,
        events=(),
        stop_reason="max_duration",
    )


def test_a_run_with_one_sample_works(tmp_path: Path) -> None:
    write_run_rrd(replace(RUN, samples=cut_samples(1)), tmp_path / "run.rrd")
    verify(tmp_path / "run.rrd")
    assert "/speed/commanded" not in list_entities(tmp_path / "run.rrd")


def test_a_run_that_never_reaches_its_goal_works(tmp_path: Path) -> None:
    cut = cut_after(100)
    write_run_rrd(cut, tmp_path / "run.rrd")
    verify(tmp_path / "run.rrd")
    assert "/along_track/marks" not in list_entities(tmp_path / "run.rrd")
    (text,) = read_static(tmp_path / "run.rrd", "/documents/Metrics", "TextDocument:text")
    assert "the run has no phase translate" in text


@pytest.mark.everyday("size0")
@pytest.mark.parametrize("size", [(999, 700), (1000, 699)])
def test_in_a_small_window_curves_have_the_room_of_legends_phases_and_tables(
    size: tuple[int, int], tmp_path: Path
) -> None:
    run, path = simulate_preset("paper-kp10"), tmp_path / "small.rrd"
    write_run_rrd(run, path, size=size)
    small = read_layout(path)
    assert {"- /plane/error/**", "- /plane/turtle/command/**"} < set(small["Plane"])
    assert "Heading [deg]" in small
    assert "Metrics" not in small
    assert not [name for name in small if name.startswith("Phases")]
    assert not any(read_blueprint_parts(path, "PlotLegend:visible"))
    write_run_rrd(run, path, size=(1000, 700))
    large = read_layout(path)
    assert "Plane (pink: to the goal, yellow: command)" in large
    assert {"Metrics", "Phases (brown: pause)"} < set(large)
    assert any(read_blueprint_parts(path, "PlotLegend:visible"))


def test_curves_are_parted_where_a_turtle_was_put_elsewhere(tmp_path: Path) -> None:
    time_ns = np.arange(40, dtype=np.int64) * 16_000_000
    x_m = np.where(time_ns < time_ns[20], 2.0, 8.0)
    turtle = make_foreign_run(40)
    poses = PoseColumns(
        time_ns=time_ns,
        xy_m=np.column_stack([x_m, x_m]),
        heading_rad=np.where(time_ns < time_ns[20], 0.0, 1.5),
        speed_m_s=np.zeros(40),
        turn_rate_rad_s=np.zeros(40),
    )
    path = tmp_path / "reset.rrd"
    write_run_rrd(replace(turtle, poses=poses), path)
    for plot in ("heading_deg", "position"):
        rows = np.array(read_rows(path, f"/{plot}", "Scalars:scalars"))
        assert np.flatnonzero(np.isnan(rows[:, 0])).tolist() == [20]
        assert len(rows) == 41


def test_what_a_robot_has_no_metrics_of_is_one_line() -> None:
    text = document_run(make_foreign_run(40))["Metrics"]
    (line,) = [line for line in text.splitlines() if "without a value" in line]
    assert re.match(r"\d+ metrics without a value: .*, and \d+ other reasons?\.", line)
    assert "\nNo " not in text
