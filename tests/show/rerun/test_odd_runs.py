from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.show.rerun.rrds import (
    list_entities,
    make_foreign_run,
    read_layout,
    read_rows,
    read_static,
    simulate_preset,
    verify,
)
from turtlelog.run import Run, SampleColumns, take_rows
from turtlelog.show import write_run_rrd

RUN = simulate_preset("paper-kp10")


def test_columns_that_a_log_lacks_are_left_out(tmp_path: Path) -> None:
    samples = replace(RUN.samples, wanted_speed_m_s=None, wanted_turn_rate_rad_s=None)
    poses = replace(RUN.poses, speed_m_s=None, turn_rate_rad_s=None)
    write_run_rrd(replace(RUN, samples=samples, poses=poses), tmp_path / "run.rrd")
    curves = {name for name in list_entities(tmp_path / "run.rrd") if "speed" in name}
    drawn = {"/speed/commanded", "/speed/marks", "/reference/speed", "/plane/path_by_speed"}
    assert curves == drawn


def test_a_run_without_samples_shows_what_it_holds(tmp_path: Path) -> None:
    run, path = make_foreign_run(300), tmp_path / "bag.rrd"
    write_run_rrd(run, path)
    verify(path)
    views = {"Plane", "Heading [deg]", "Turn rate [rad/s]", "Position [m]", "Speed [m/s]"}
    views |= {"Metrics", "Scenario", "By speed, 0 to 0.333 m/s"}
    assert set(read_layout(path)) == views
    rows = np.array(read_rows(path, "/speed/commanded", "Scalars:scalars"))
    np.testing.assert_array_equal(rows[:, 0], run.commands.speed_m_s)


def test_a_single_pose_shows_the_plane_alone(tmp_path: Path) -> None:
    write_run_rrd(make_foreign_run(1), tmp_path / "run.rrd")
    verify(tmp_path / "run.rrd")
    assert set(read_layout(tmp_path / "run.rrd")) == {"Plane", "Metrics", "Scenario"}


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
