from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.draw.rerun.rrds import (
    list_entities,
    read_rows,
    read_static,
    read_times,
    read_values,
    simulate_preset,
)
from turtlelog.draw import write_run_rrd
from turtlelog.measure import measure_run

RUN = simulate_preset("paper-kp10")
LINE = RUN.goal_line
assert LINE is not None
BEARING_DEG = float(np.degrees(LINE.bearing_rad))
LENGTH_M = LINE.length_m


def move_backward() -> NDArray[np.bool_]:
    return np.diff(read_values("along_track"), prepend=0.0) < 0.0


POSE_CURVES: dict[str, Callable[[], NDArray[np.float64] | None]] = {
    "/heading_deg": lambda: np.degrees(read_values("heading")),
    "/heading_error_deg": lambda: np.degrees(read_values("heading_error")),
    "/along_track": lambda: read_values("along_track"),
    "/cross_track": lambda: read_values("cross_track"),
    "/distance": lambda: read_values("distance"),
    # turtlesim publishes no sign; the last commands of paper-kp10 oscillate.
    "/speed/applied": lambda: RUN.poses.speed_m_s * np.where(move_backward(), -1.0, 1.0),
    "/turn_rate/applied": lambda: RUN.poses.turn_rate_rad_s,
}


SAMPLE_CURVES: dict[str, Callable[[], NDArray[np.float64] | None]] = {
    "/wanted_speed/wanted": lambda: RUN.samples.wanted_speed_m_s,
    "/speed/commanded": lambda: RUN.samples.speed_m_s,
    "/wanted_turn_rate/wanted": lambda: RUN.samples.wanted_turn_rate_rad_s,
    "/turn_rate/commanded": lambda: RUN.samples.turn_rate_rad_s,
}


@pytest.mark.parametrize("entity", POSE_CURVES)
def test_curves_hold_the_pose_columns_exactly(run_rrd: Path, entity: str) -> None:
    rows = np.array(read_rows(run_rrd, entity, "Scalars:scalars"))
    np.testing.assert_array_equal(rows[:, 0], POSE_CURVES[entity]())
    times_ns = read_times(run_rrd, entity) + RUN.start_ns
    np.testing.assert_array_equal(times_ns, RUN.poses.time_ns)


@pytest.mark.parametrize("entity", SAMPLE_CURVES)
def test_curves_hold_the_sample_columns_exactly(run_rrd: Path, entity: str) -> None:
    rows = np.array(read_rows(run_rrd, entity, "Scalars:scalars"))
    np.testing.assert_array_equal(rows[:, 0], SAMPLE_CURVES[entity]())
    times_ns = read_times(run_rrd, entity) + RUN.start_ns
    np.testing.assert_array_equal(times_ns, RUN.samples.time_ns)


def test_metrics_are_marked_where_they_are(run_rrd: Path) -> None:
    metrics = measure_run(RUN)
    labels = read_static(run_rrd, "/heading_deg/marks", "SeriesPoints:names")
    rows = np.array(read_rows(run_rrd, "/heading_deg/marks", "Scalars:scalars"))
    times_ns = read_times(run_rrd, "/heading_deg/marks")
    heading_deg = np.degrees(read_values("heading"))
    told = {"settling_time": "2.21 s", "overshoot": "1 %", "rise_time": "1.79 s"}
    for number, name in enumerate(told):
        metric = metrics[f"rotate.{name}"]
        assert metric.at_s is not None
        (row,) = np.flatnonzero(np.isfinite(rows[:, number]))
        assert times_ns[row] == round(metric.at_s * 1e9)
        assert told[name] in labels[number]
        level = np.interp(times_ns[row] + RUN.start_ns, RUN.poses.time_ns, heading_deg)
        assert rows[row, number] == pytest.approx(level)


def test_a_peak_is_marked_at_the_top_of_the_curve(run_rrd: Path) -> None:
    rows = np.array(read_rows(run_rrd, "/along_track/marks", "Scalars:scalars"))
    assert np.nanmax(rows[:, 1]) == read_values("along_track").max()


def test_the_ideal_response_stands_beside_the_heading(run_rrd: Path) -> None:
    rows = np.array(read_rows(run_rrd, "/heading_deg/ideal", "Scalars:scalars"))[:, 0]
    time_s = read_times(run_rrd, "/heading_deg/ideal") / 1e9
    np.testing.assert_allclose(rows, BEARING_DEG * (1.0 - np.exp(-10.0 * time_s)), atol=1e-5)


@pytest.mark.parametrize(
    ("plot", "phase", "ticks"), [("heading_deg", "rotate", 4), ("along_track", "translate", 6)]
)
def test_the_sampled_response_waits_for_the_dead_time(
    run_rrd: Path, plot: str, phase: str, ticks: int
) -> None:
    rows = np.array(read_rows(run_rrd, f"/{plot}/sampled", "Scalars:scalars"))[:, 0]
    times_ns = read_times(run_rrd, f"/{plot}/sampled") + RUN.start_ns
    assert times_ns[0] == next(s.start_ns for s in RUN.find_phase_spans() if s.phase == phase)
    assert set(np.diff(times_ns).tolist()) == {16_000_000}
    assert np.flatnonzero(np.diff(rows))[0] == ticks


def test_without_a_gain_there_is_no_response_of_theory(tmp_path: Path) -> None:
    write_run_rrd(replace(RUN, parameters={}), tmp_path / "run.rrd")
    assert not {name for name in list_entities(tmp_path / "run.rrd") if "ideal" in name}


@pytest.mark.parametrize(
    ("entity", "error"),
    [
        ("/heading_error_log10", lambda: np.degrees(read_values("heading_error"))),
        ("/distance_log10", lambda: read_values("distance")),
    ],
)
def test_errors_stand_on_a_logarithmic_scale_too(
    run_rrd: Path, entity: str, error: Callable[[], NDArray[np.float64]]
) -> None:
    rows = np.array(read_rows(run_rrd, entity, "Scalars:scalars"))[:, 0]
    np.testing.assert_allclose(10.0**rows, np.abs(error()), rtol=1e-12)


def test_an_error_of_zero_leaves_a_gap_on_the_logarithmic_scale(tmp_path: Path) -> None:
    goal_xy_m = tuple(RUN.poses.xy_m[100].tolist())
    write_run_rrd(replace(RUN, goal_xy_m=goal_xy_m), tmp_path / "run.rrd")
    rows = np.array(read_rows(tmp_path / "run.rrd", "/distance_log10", "Scalars:scalars"))[:, 0]
    assert np.isnan(rows[100])
    assert np.isfinite(rows[200:]).all()


def test_what_has_a_value_along_x_and_y_comes_in_pairs(run_rrd: Path) -> None:
    errors = np.array(read_rows(run_rrd, "/position_error", "Scalars:scalars"))
    np.testing.assert_array_equal(errors, np.array([2.0, 10.0]) - RUN.poses.xy_m)
    velocity = np.array(read_rows(run_rrd, "/world_velocity", "Scalars:scalars"))
    np.testing.assert_array_equal(velocity, RUN.samples.world_velocity_m_s)


def test_references_lie_at_bearing_goal_and_limits(run_rrd: Path) -> None:
    expected = {
        "/reference/heading_deg": [BEARING_DEG],
        "/reference/position": [2.0, 10.0],
        "/reference/along_track": [LENGTH_M],
        "/reference/speed/limits": [-1.0, 1.0],
        "/reference/turn_rate/limits": [-1.0, 1.0],
    }
    for entity, levels in expected.items():
        assert read_rows(run_rrd, entity, "Scalars:scalars") == [levels, levels]


def test_limit_that_no_robot_meets_draws_no_line(tmp_path: Path) -> None:
    for limit, levels in ((0.99e9, [[-0.99e9, 0.99e9]] * 2), (1e9, [])):
        parameters = {**RUN.parameters, "limits.speed_m_s": limit}
        write_run_rrd(replace(RUN, parameters=parameters), tmp_path / "run.rrd")
        has_line = "/reference/speed/limits" in list_entities(tmp_path / "run.rrd")
        assert has_line == bool(levels)
        if has_line:
            found = read_rows(tmp_path / "run.rrd", "/reference/speed/limits", "Scalars:scalars")
            assert found == levels


def test_infinite_limits_draw_no_line(tmp_path: Path) -> None:
    limits = {"limits.speed_m_s": float("inf"), "limits.turn_rate_rad_s": float("inf")}
    write_run_rrd(replace(RUN, parameters={**RUN.parameters, **limits}), tmp_path / "run.rrd")
    assert not {"/reference/speed/limits", "/reference/turn_rate/limits"} & list_entities(
        tmp_path / "run.rrd"
    )
