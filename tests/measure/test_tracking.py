import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from turtlelog.compare.run_summary import describe_run_end
from turtlelog.measure import Status
from turtlelog.measure.metrics.loop_metrics import find_corner
from turtlelog.measure.response import Track, list_corners
from turtlelog.measure.step_response import find_shift
from turtlelog.scenario import build_scenario

SQUARE: dict[str, Any] = {
    "kind": "polygon",
    "points": [[3.0, 3.0], [8.0, 3.0], [8.0, 8.0], [3.0, 8.0]],
    "speed_m_s": 0.5,
}
LINE: dict[str, Any] = {"kind": "line", "points": [[1.0, 5.0], [10.0, 5.0]]}


def track(path: dict[str, Any], *, law: str = "pure-pursuit", **tables: Any) -> tl.Run:
    x_m, y_m = path["points"][0]
    start = {"x_m": x_m, "y_m": y_m}
    return tl.simulate_run(
        build_scenario({"law": {"kind": law}, "path": path, "start": start, **tables})
    )


@pytest.fixture(scope="module", name="square")
def simulate_square() -> tl.Run:
    return track(SQUARE)


def read(run: tl.Run, name: str) -> float:
    value = tl.measure_run(run, only=[name])[name].value
    assert value is not None
    return value


def test_loops_of_a_tracker_have_no_step_metrics(square: tl.Run) -> None:
    names = tl.measure.list_metrics(square.declaration)
    assert {"along.lag", "along.rms_error", "cross.corner_overshoot", "cross.largest_error"} <= {
        *names
    }
    assert not {"along.overshoot", "cross.settling_time", "cross.lag", "along.corner_overshoot"} & {
        *names
    }


def test_cross_track_error_is_the_distance_from_the_square(square: tl.Run) -> None:
    points = np.array([*SQUARE["points"], SQUARE["points"][0]])
    away_m = tl.measure.references.compute_path_distances(square.poses.xy_m, points)
    found = tl.measure.read_signal(square, "cross_track")
    assert found is not None
    assert np.abs(found.values) == pytest.approx(away_m, abs=1e-9)
    assert read(square, "cross.largest_error") == pytest.approx(away_m.max())
    assert read(square, "run.cross_track_max") == pytest.approx(away_m.max())


def test_along_error_is_the_reference_minus_the_nearest_point(square: tl.Run) -> None:
    arc = tl.measure.read_signal(square, "along_track")
    assert arc is not None
    due_m = np.minimum(0.5 * (square.poses.time_ns - square.start_ns) / 1e9, 20.0)
    assert read(square, "along.largest_error") == pytest.approx(np.abs(due_m - arc.values).max())
    assert read(square, "along.final_error") == pytest.approx(abs(20.0 - arc.values[-1]))


def test_corners_of_later_laps_are_those_of_the_first_and_the_seam(square: tl.Run) -> None:
    path = square.path
    assert path is not None
    track = Track(
        *(np.empty(0), np.empty(0), list_corners(path), path.seam_rad, path.length_m),
        is_closed=True,
        has_speed=False,
    )
    laps = [find_corner(track, number, is_lapped=True) for number in range(8)]
    assert [(arc_m, leg_m) for arc_m, _, leg_m in laps] == [(5.0 * n, 5.0) for n in range(1, 9)]
    assert [turn_rad for _, turn_rad, _ in laps] == pytest.approx([math.pi / 2.0] * 8)
    first = [find_corner(track, number, is_lapped=False) for number in range(3)]
    assert first == [tuple(corner) for corner in path.corners] == laps[:3]


def test_every_value_is_a_plain_number_which_a_table_of_files_can_store(square: tl.Run) -> None:
    values = [metric.value for metric in tl.measure_run(square).values()]
    assert {type(value) for value in values if value is not None} == {float}


@pytest.mark.parametrize("late_s", [0.5, -0.25])
def test_lag_of_a_robot_that_is_late_is_its_delay(late_s: float) -> None:
    time_s = np.arange(0.0, 20.0, 0.016)
    reference, signal = (
        np.sin(0.7 * time_s) + time_s,
        np.sin(0.7 * (time_s - late_s)) + time_s - late_s,
    )
    assert find_shift(time_s, reference, reference - signal, None) == pytest.approx(
        late_s, abs=1e-4
    )


def test_lag_of_a_slow_robot_is_what_its_speed_limit_costs() -> None:
    limits = {"speed_m_s": 0.25, "turn_rate_rad_s": 1.0}
    run = track({**LINE, "speed_m_s": 0.5}, limits=limits)
    # The reference needs 18 s for the way, the robot drives half of it: s = v t / 2.
    assert read(run, "along.final_error") == pytest.approx(4.5, abs=0.01)
    assert read(run, "along.lag") > 4.0


def test_a_lag_beyond_the_largest_shift_that_is_tried_is_not_a_number() -> None:
    # The reference passes the line of 9 m in 1.8 s, and the robot drives 1 m/s.
    run = track({**LINE, "speed_m_s": 5.0})
    metric = tl.measure_run(run, only=["along.lag"])["along.lag"]
    assert (metric.value, metric.status) == (None, Status.UNDETERMINED)
    assert metric.reason == "the best shift is the largest that is tried, half of the duration"


@pytest.mark.parametrize(("speed_m_s", "is_told"), [(5.0, True), (0.5, False)])
def test_the_end_of_a_path_tells_the_error_along_it_if_it_is_the_larger(
    speed_m_s: float, *, is_told: bool
) -> None:
    run = track({**SQUARE, "speed_m_s": speed_m_s})
    told = describe_run_end(run)
    assert ("along-track error" in told) == is_told
    assert told.startswith("cross-track error ")
    if is_told:
        assert told == (
            "cross-track error 0 m RMS, 0 m at most, along-track error 16 m at most, in 4 s"
        )


@pytest.mark.parametrize(("moved_m", "status"), [(0.9e-6, Status.NO_STEP), (1.1e-6, Status.OK)])
def test_reference_that_moves_less_than_poses_are_rounded_by_has_no_lag(
    moved_m: float, status: Status
) -> None:
    run = track({**LINE, "speed_m_s": moved_m / 2.0}, max_duration_s=2.0)
    run = replace(run, stop_reason="path_end")
    assert run.duration_s == pytest.approx(2.0, rel=0.02)
    metric = tl.measure_run(run, only=["along.lag"])["along.lag"]
    assert metric.status == status
    assert (metric.reason == "the reference does not move") == (status is Status.NO_STEP)


def test_path_without_a_speed_has_no_error_along_it() -> None:
    run = track(LINE)
    metric = tl.measure_run(run, only=["along.rms_error"])["along.rms_error"]
    assert (metric.status, metric.value) == (Status.ABSENT, None)
    assert metric.reason == "the path has no speed, which would say where the robot should be when"


@pytest.mark.parametrize("period_s", [1.0, 2.0, 5.0])
def test_lag_of_a_reference_that_repeats_is_no_period_off(period_s: float) -> None:
    time_s = np.arange(0.0, 40.0, 0.016)
    rate = 2.0 * np.pi / period_s
    late_s = np.arctan(rate / 3.0) / rate  # of a first-order loop with Kp = 3 1/s
    reference = 0.1 * np.sin(rate * time_s)
    signal = 0.1 * np.sin(rate * (time_s - late_s)) * (1.0 - np.exp(-3.0 * time_s))
    assert find_shift(time_s, reference, reference - signal, None) == pytest.approx(
        late_s, abs=0.01
    )


@pytest.mark.parametrize("begin_rad", [0.5, 3.0, -2.0])
def test_circle_is_entered_where_the_robot_stands(begin_rad: float) -> None:
    x_m, y_m = 5.5 + 2.0 * math.cos(begin_rad), 5.5 + 2.0 * math.sin(begin_rad)
    start = {"x_m": x_m, "y_m": y_m, "heading_rad": begin_rad + math.pi / 2.0}
    circle = {"kind": "circle", "center_x_m": 5.5, "center_y_m": 5.5, "size_m": 2.0}
    tables = {"law": {"kind": "pure-pursuit"}, "path": circle, "start": start}
    run = tl.simulate_run(build_scenario(tables))
    assert run.stop_reason == "path_end"
    assert run.duration_s == pytest.approx(4.0 * math.pi / 0.5, rel=0.01)
    assert read(run, "cross.largest_error") < 0.005


@pytest.mark.parametrize("law", ["kanayama", "pure-pursuit"])
def test_open_path_is_entered_at_its_beginning_and_driven_to_its_end(law: str) -> None:
    path = {"kind": "waypoints", "points": [[4.0, 8.0], [7.0, 8.0], [7.0, 9.0]]}
    start = {"x_m": 2.0, "y_m": 8.0}
    run = tl.simulate_run(build_scenario({"law": {"kind": law}, "path": path, "start": start}))
    offset = tl.measure.read_signal(run, "cross_track")
    assert run.stop_reason == "path_end"
    assert offset is not None
    assert abs(offset.values[0]) == pytest.approx(2.0)  # from the beginning of the path
    assert np.hypot(*(run.poses.xy_m[-1] - (7.0, 9.0))) < 0.05
    points = np.array(path["points"])
    away_m = tl.measure.references.compute_path_distances(run.poses.xy_m, points)
    joined = int(np.argmax(away_m <= 0.5))
    assert np.abs(offset.values[joined:]) == pytest.approx(away_m[joined:], abs=1e-9)


def test_corner_overshoot_leaves_the_cut_of_the_next_corner_out() -> None:
    points = [[1.0, 4.0], [3.0, 7.0], [5.0, 4.0], [7.0, 7.0], [9.0, 4.0]]
    start = {"x_m": 1.0, "y_m": 4.0, "heading_rad": 0.9828}
    law = {"kind": "pure-pursuit", "lookahead_m": 1.0}
    path = {"kind": "waypoints", "points": points, "speed_m_s": 0.4}
    run = tl.simulate_run(build_scenario({"law": law, "path": path, "start": start}))
    assert 0.1 < read(run, "cross.corner_overshoot") < 0.2
    assert read(run, "cross.largest_error") > 0.4


def test_corner_overshoot_counts_the_outer_side_alone(square: tl.Run) -> None:
    offset = tl.measure.read_signal(square, "cross_track")
    arc = tl.measure.read_signal(square, "along_track")
    assert offset is not None
    assert arc is not None
    passed = arc.values >= 5.0
    # All corners turn left: the outer side is the right one.
    assert read(square, "cross.corner_overshoot") == pytest.approx(-offset.values[passed].min())


def test_corner_overshoot_to_the_right_counts_the_left_side() -> None:
    mirrored = {**SQUARE, "points": [[x, 11.0 - y] for x, y in SQUARE["points"]]}
    run, other = track(SQUARE), track(mirrored)
    found, twin = (read(one, "cross.corner_overshoot") for one in (run, other))
    assert found == pytest.approx(twin, rel=1e-3)
    assert found > 0.1


@pytest.mark.parametrize(
    ("path", "reason"),
    [
        (LINE, "the path has no corner"),
        (
            {"kind": "waypoints", "points": [[1, 5], [9, 5], [9, 9]]},
            "no corner of the path was passed",
        ),
    ],
)
def test_corner_overshoot_without_a_corner_has_a_reason(path: dict[str, Any], reason: str) -> None:
    run = track({**path, "speed_m_s": 0.5}, max_duration_s=5.0)
    run = replace(run, stop_reason="path_end")
    metric = tl.measure_run(run, only=["cross.corner_overshoot"])["cross.corner_overshoot"]
    assert (metric.value, metric.reason) == (None, reason)


def test_run_without_its_beginning_is_measured_from_the_same_path(square: tl.Run) -> None:
    part = square.slice(12.0, 30.0)
    whole, found = (tl.measure.read_signal(one, "cross_track") for one in (square, part))
    assert whole is not None
    assert found is not None
    first = int(np.searchsorted(whole.time_ns, found.time_ns[0]))
    assert found.values == pytest.approx(whole.values[first : first + len(found.values)], abs=1e-9)
    reference = tl.measure.read_reference(part, part.declaration.loops[0])
    due_m = 0.5 * (part.poses.time_ns - square.start_ns) / 1e9
    assert reference == pytest.approx(due_m, abs=0.5 * 0.017)


def test_recording_gives_the_path_back(square: tl.Run, tmp_path: Any) -> None:
    file = tmp_path / "square.mcap"
    tl.write_recording(square, file)
    found = tl.read_run(file)
    assert found.path == square.path
    assert found.path is not None
    assert found.path.length_m == pytest.approx(20.0)
    assert [*tl.measure_run(found).values()] == [*tl.measure_run(square).values()]


def test_path_that_the_law_does_not_track_is_no_path_of_the_run() -> None:
    run = tl.simulate_run(build_scenario({"path": SQUARE}))
    assert run.path is None
    assert run.parameters["path.kind"] == "polygon"
    assert math.isclose(
        read(run, "run.cross_track_max"),
        read(tl.simulate_run(tl.Scenario()), "run.cross_track_max"),
    )
