"""What a table contradicts is said: times that start again, units, headings, reported rates."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.any_file import read_run, read_trajectory
from turtlelog.log.ros2.set_clocks import find_runs
from turtlelog.log.units import find_travel
from turtlelog.run import Run

Values = NDArray[np.float64]
TIME_S = np.linspace(0.0, 20.0, 201)


def drive(turned_rad: float = 3.0, noise_m: float = 0.0) -> tuple[Values, Values, Values]:
    """Return x, y [m] and headings [rad] of a drive along an arc at 0.5 m/s."""
    heading_rad = np.linspace(0.0, turned_rad, len(TIME_S))
    middle_rad = (heading_rad[1:] + heading_rad[:-1]) / 2.0
    rng = np.random.default_rng(1)
    x, y = (
        np.concatenate([[0.0], np.cumsum(0.05 * turn(middle_rad))])
        + rng.normal(0.0, noise_m, len(TIME_S))
        for turn in (np.cos, np.sin)
    )
    return x, y, heading_rad


def read(folder: Path, header: str, *columns: Values) -> Run:
    path = folder / "drive.csv"
    rows = zip(*(column.tolist() for column in columns), strict=True)
    path.write_text("\n".join([header, *(",".join(map(repr, row)) for row in rows)]) + "\n")
    return read_run(path)


ONCE = [*range(40)]


@pytest.mark.parametrize(
    ("times", "runs"),
    [
        (ONCE, [40]),
        ([*ONCE, *ONCE], [40, 40]),
        ([*ONCE, *ONCE, *range(20)], [40, 40, 20]),
        ([*range(3, 43), *ONCE], [40, 40]),  # the second run starts earlier
        ([*range(40, 80), *ONCE], [80]),  # two parts in another order
        ([*ONCE, 5, *range(40, 80)], [81]),  # a row that is late
        ([1, 0, *range(2, 40)], [40]),
        ([*range(20, 40), *range(10, 20), *range(40, 60)], [50]),
        ([*range(10), *range(10)], [10, 10]),  # 10 rows make a run
        ([*range(10), *range(9)], [19]),
        ([*range(9), *range(10)], [19]),
        ([*ONCE, *range(19, 59)], [40, 40]),  # back to half of the run
        ([*ONCE, *range(20, 60)], [80]),
        ([*ONCE, 0, 1, 2, 4, 3, *range(5, 40)], [40, 40]),  # late rows after its start
        ([*ONCE, *range(9), 7, *range(9, 40)], [40, 41]),
        ([*ONCE, *(4 * [*range(9)]), *ONCE], [76, 40]),
        ([*ONCE, 5, *range(40, 80), *ONCE], [81, 40]),
    ],
)
def test_times_that_start_again_begin_a_run(times: list[int], runs: list[int]) -> None:
    found = find_runs(np.array(times, dtype=np.int64))
    assert [rows.stop - rows.start for rows in found] == runs


def test_one_of_two_runs_in_a_table_is_read(tmp_path: Path) -> None:
    x, y, heading_rad = drive()
    twice = [np.concatenate([one, two]) for one, two in ((TIME_S, TIME_S), (x, x + 7), (y, y))]
    run = read(tmp_path, "t,x,y,yaw", *twice, np.concatenate([heading_rad, heading_rad]))
    assert run.poses.xy_m[:, 0].tolist() == x.tolist()
    assert run.notes["sorted_rows"] == "0"
    assert run.notes["restarts"] == (
        "run 1 of 2 in the table is read, lines 2 to 202; times start again at line 203, and 201"
        " rows are left out: save each run to a file of its own"
    )
    assert "restarts" in read_trajectory(tmp_path / "drive.csv").notes


def test_commands_below_the_poses_belong_to_their_run(tmp_path: Path) -> None:
    x, y, heading_rad = drive()
    no = np.full(len(x), np.nan)
    below = ((TIME_S, TIME_S), (x, no), (y, no), (heading_rad, no), (no, x))
    run = read(tmp_path, "t,x,y,yaw,cmd_v", *map(np.concatenate, below))
    assert (len(run.poses), len(run.commands)) == (201, 201)
    assert "restarts" not in run.notes
    twice = [columns * 2 for columns in below]
    run = read(tmp_path, "t,x,y,yaw,cmd_v", *map(np.concatenate, twice))
    assert (len(run.poses), len(run.commands)) == (201, 201)
    assert run.notes["restarts"].startswith("run 1 of 2 in the table is read, lines 2 to 403;")


@pytest.mark.parametrize(
    ("turned_rad", "noise_m", "unit"),
    [
        (math.radians(31.0), 0.0, "deg, as the direction of travel shows"),
        (math.radians(1.2), 0.0, "deg, as the direction of travel shows"),
        (math.radians(0.8), 0.0, "rad, assumed"),  # as radians, nearly along the travel
        (math.radians(191.0), 0.0, "deg, as the direction of travel shows"),
        (math.radians(191.0), 0.005, "deg, as the direction of travel shows"),
        (math.radians(191.0), 0.5, "rad, assumed"),  # nothing but noise
    ],
)
def test_the_direction_of_travel_shows_degrees(
    turned_rad: float, noise_m: float, unit: str, tmp_path: Path
) -> None:
    x, y, heading_rad = drive(turned_rad, noise_m)
    run = read(tmp_path, "t,x,y,yaw", TIME_S, x, y, np.degrees(heading_rad))
    assert f"heading from yaw [{unit}]" in run.notes["columns"]


@pytest.mark.parametrize("aside_rad", [0.0, 0.19, 0.21])
def test_headings_in_degrees_may_be_a_little_off(aside_rad: float, tmp_path: Path) -> None:
    x, y, heading_rad = drive()
    run = read(tmp_path, "t,x,y,yaw", TIME_S, x, y, np.degrees(heading_rad + aside_rad))
    assert ("deg, as the direction" in run.notes["columns"]) == (aside_rad < 0.2)


@pytest.mark.parametrize(("aside_rad", "unit"), [(0.016, "deg, as"), (0.022, "rad, ass")])
def test_few_degrees_are_told_by_headings_that_follow_the_turns(
    aside_rad: float, unit: str, tmp_path: Path
) -> None:
    x, y, heading_rad = drive(math.radians(8.0))
    run = read(tmp_path, "t,x,y,yaw", TIME_S, x, y, np.degrees(heading_rad + aside_rad))
    assert f"heading from yaw [{unit}" in run.notes["columns"]


def test_positions_without_headings_take_the_course(tmp_path: Path) -> None:
    x, y, heading_rad = drive()
    x[::20] += 4.0  # single outliers
    read(tmp_path, "t,x,y,yaw", TIME_S, x, y, 0.0 * x)
    run = read_run(tmp_path / "drive.csv", columns={"heading": "course"})
    assert run.origin.has_courses
    assert run.notes["heading"].startswith("the course over 0.5 m, as asked for; held at either")
    assert np.abs(run.poses.heading_rad[10:-10] - heading_rad[10:-10]).max() < 0.3
    still = read(tmp_path, "t,x,y,yaw", TIME_S, 0.0 * x, 0.0 * y, 0.0 * x)
    assert not still.origin.has_courses
    with pytest.raises(LogError, match=r"drive\.csv: --column heading=course: the robot moves too"):
        read_run(tmp_path / "drive.csv", columns={"heading": "course"})


@pytest.mark.parametrize(
    ("before_s", "after_s", "is_over"), [(59.0, 0.9, True), (59.0, 1.1, False), (0.5, 0.5, True)]
)
def test_times_of_the_day_pass_midnight(
    before_s: float, after_s: float, tmp_path: Path, *, is_over: bool
) -> None:
    x, y, heading_rad = drive()
    time_s = np.concatenate([86400.0 - before_s - TIME_S[100::-1], after_s + TIME_S[:100]])
    run = read(tmp_path, "t,x,y,yaw", time_s, x, y, heading_rad)
    assert ("t from t [s, assumed, over midnight]" in run.notes["columns"]) == is_over
    assert (run.poses.xy_m[0].tolist() == [x[0], y[0]]) == is_over


def test_a_late_row_at_midnight_stays_on_its_day(tmp_path: Path) -> None:
    x, y, heading_rad = drive()
    time_s = (86390.0 + TIME_S) % 86400.0
    for column in (time_s, x, y, heading_rad):
        column[[100, 99]] = column[[99, 100]]
    run = read(tmp_path, "t,x,y,yaw", time_s, x, y, heading_rad)
    assert run.poses.time_ns == pytest.approx(TIME_S * 1e9, abs=10)
    whole_day = np.where(TIME_S < 10.0, TIME_S, TIME_S + 86369.0)  # a gap, and no midnight
    run = read(tmp_path, "t,x,y,yaw", whole_day, x, y, heading_rad)
    assert "over midnight" not in run.notes["columns"]


def test_noise_at_rest_is_no_travel() -> None:
    noise_m = np.random.default_rng(1).normal(0.0, 0.02, (201, 2))
    way_m = np.column_stack(drive()[:2])
    assert find_travel(noise_m) is None
    travel = find_travel(np.vstack([noise_m, way_m + noise_m]))
    assert travel is not None
    assert np.mean(travel.firsts >= 200) > 0.8
    assert find_travel(way_m * 0.012) is None  # within 0.1 m
    assert find_travel(way_m * 0.018) is not None


def test_radians_that_turn_often_stay_radians(tmp_path: Path) -> None:
    x, y, heading_rad = drive(turned_rad=60.0)
    run = read(tmp_path, "t,x,y,yaw", TIME_S, x, y, heading_rad)
    assert "yaw [rad, assumed]" in run.notes["columns"]
    assert "heading_and_travel" not in run.notes


@pytest.mark.parametrize(
    ("header", "turn", "told"),
    [
        ("yaw [rad]", lambda rad: rad, None),
        ("yaw [rad]", lambda rad: rad + math.pi, None),  # backward
        ("yaw [rad]", lambda rad: rad + 0.49, None),
        ("yaw [rad]", lambda rad: rad + 0.51, "the robot drives sideways, or the headings are"),
        ("yaw", lambda rad: rad + 0.51, "drives sideways, or the headings (assumed in rad) are wr"),
        ("yaw [deg]", lambda rad: 90.0 - np.degrees(rad), "--column heading='yaw [deg] [compass]'"),
        ("yaw", lambda rad: 90.0 - np.degrees(rad), "fit a compass (0 is north, clockwise): --col"),
    ],
    ids=[
        "forward",
        "backward",
        "aside",
        "too-far-aside",
        "assumed",
        "compass",
        "compass-without-unit",
    ],
)
def test_headings_that_contradict_the_travel_are_told(
    header: str, turn: Callable[[Values], Values], told: str | None, tmp_path: Path
) -> None:
    x, y, heading_rad = drive()
    run = read(tmp_path, f"t,x,y,{header}", TIME_S, x, y, turn(heading_rad))
    assert (told or "") in run.notes.get("heading_and_travel", "")
    assert ("heading_and_travel" in run.notes) == (told is not None)


@pytest.mark.parametrize("turned_rad", [0.49, 0.55])
def test_a_straight_path_tells_no_compass(turned_rad: float, tmp_path: Path) -> None:
    x, y, heading_rad = drive(turned_rad)
    run = read(tmp_path, "t,x,y,yaw [deg]", TIME_S, x, y, 90.0 - np.degrees(heading_rad))
    assert ("compass" in run.notes["heading_and_travel"]) == (turned_rad > 0.5)


def test_compass_headings_are_read_as_such(tmp_path: Path) -> None:
    x, y, heading_rad = drive()
    read(tmp_path, "t,x,y,yaw", TIME_S, x, y, 90.0 - np.degrees(heading_rad))
    run = read_run(tmp_path / "drive.csv", columns={"heading": "yaw [compass]"})
    assert run.poses.heading_rad == pytest.approx(heading_rad)
    assert "heading_and_travel" not in run.notes


@pytest.mark.parametrize("step_s", [1e-9, 9e-6, 11e-6])
def test_times_with_too_few_digits_are_told(step_s: float, tmp_path: Path) -> None:
    x, y, heading_rad = drive()
    time_s = np.floor(TIME_S) if step_s == 1e-9 else TIME_S * (10.0 * step_s)
    run = read(tmp_path, "t,x,y,yaw", time_s, x, y, heading_rad)
    crowded = run.notes.get("crowded", "")
    if step_s == 1e-9:
        assert crowded.startswith("180 of 201 poses have the time of the pose before, and all")
    else:
        assert ("all 201 poses lie within" in crowded) == (step_s < 1e-5)


@pytest.mark.parametrize(
    ("header", "step", "scale", "told"),
    [
        ("t,x,y,yaw", 4.9, 1.0, ""),
        ("t,x,y,yaw", 5.1, 1.0, "poses are 5.1 s apart; if they are ms: --column t='t [ms]'"),
        ("t [s],x,y,yaw", 5.1, 1.0, ""),
        ("t,x,y,yaw", 0.1, 199.0, ""),
        ("t,x,y,yaw", 0.1, 201.0, "so 100 m/s is usual; if they are mm: --column x='x [mm]'"),
        ("t,x [m],y [m],yaw", 0.1, 201.0, ""),
    ],
)
def test_unlikely_units_are_told(
    header: str, step: float, scale: float, told: str, tmp_path: Path
) -> None:
    x, y, heading_rad = drive()
    time = TIME_S * (10.0 * step)
    run = read(tmp_path, header, time, scale * x, scale * y, heading_rad)
    assert told in run.notes.get("unlikely_units", "")
    assert ("unlikely_units" in run.notes) == bool(told)


@pytest.mark.parametrize(
    ("header", "step", "speed_m_s", "told"),
    [
        ("t,x,y,yaw", 4.0, 0.009, "poses are 4 s apart and the robot drives at most 0.009 m/s;"),
        ("t,x,y,yaw", 2.0, 0.009, "if they are ms: --column t='t [ms]'"),
        ("t,x,y,yaw", 1.0, 0.009, ""),
        ("t,x,y,yaw", 4.0, 0.011, ""),
        ("t,x,y,yaw", 2.5, 0.009, ""),
        ("t [s],x,y,yaw", 4.0, 0.009, ""),
        ("t,x,y,yaw", 4.0, 1e-5, ""),
        ("t,x,y,yaw", 5.0, 6.0, ""),
    ],
)
def test_a_robot_that_only_crawls_in_whole_seconds_is_told(
    header: str, step: float, speed_m_s: float, told: str, tmp_path: Path
) -> None:
    x, y, heading_rad = drive()
    scale = speed_m_s / 0.5 * step * 10.0
    run = read(tmp_path, header, TIME_S * (10.0 * step), scale * x, scale * y, heading_rad)
    assert told in run.notes.get("unlikely_units", "")
    assert ("unlikely_units" in run.notes) == bool(told)


@pytest.mark.parametrize(
    ("header", "speed_m_s", "turn_rate_rad_s", "told"),
    [
        ("t,x,y,yaw", 50.0, 1.05, "m/s^2; if they are cm (or mm):"),
        ("t,x,y,yaw", 50.0, 0.95, ""),
        ("t,x,y,yaw", 33.0, 0.1, ""),
        ("t,x [m],y [m],yaw", 50.0, 1.05, ""),
    ],
)
def test_curves_that_no_robot_drives_are_told(
    header: str, speed_m_s: float, turn_rate_rad_s: float, told: str, tmp_path: Path
) -> None:
    turned_rad = turn_rate_rad_s * TIME_S
    radius_m = speed_m_s / turn_rate_rad_s
    places = radius_m * np.sin(turned_rad), radius_m * (1.0 - np.cos(turned_rad))
    run = read(tmp_path, header, TIME_S, *places, turned_rad)
    assert told in run.notes.get("unlikely_units", "")
    assert ("unlikely_units" in run.notes) == bool(told)


@pytest.mark.parametrize(
    ("header", "scale", "told"),
    [
        ("v", 1.19, ""),
        ("v", 1.3, "the path is 10 m by the poses and 13 m by the reported speed: nothing tells"),
        ("v", 3.6, "36 m by the reported speed, which fits km/h: --column speed='v [km/h]'"),
        ("v [m/s]", 3.6, "the path is 10 m by the poses and 36 m by the reported speed: nothing"),
    ],
)
def test_a_reported_speed_that_the_path_contradicts_is_told(
    header: str, scale: float, told: str, tmp_path: Path
) -> None:
    x, y, heading_rad = drive()
    speed = np.full(len(x), 0.5 * scale)
    run = read(tmp_path, f"t,x,y,yaw,{header}", TIME_S, x, y, heading_rad, speed)
    assert told in run.notes.get("path_by_speed", "")
    assert ("path_by_speed" in run.notes) == bool(told)


@pytest.mark.parametrize(
    ("header", "scale", "told"),
    [
        ("x,y", 123.0, "fits positions in cm: --column x='x [cm]' --column y='y [cm]'"),
        ("x,y", 86.0, "fits positions in cm"),
        ("x,y", 129.0, ""),
        ("x,y", 82.0, ""),
        ("x,y", 1000.0, "fits positions in mm"),
        ("x [m],y [m]", 100.0, ""),
    ],
)
def test_a_reported_speed_shows_the_unit_of_positions(
    header: str, scale: float, told: str, tmp_path: Path
) -> None:
    x, y, heading_rad = drive()
    still = np.repeat(1.0, len(x))  # slow, as above 100 m/s the speed alone shows mm
    columns = (TIME_S, 0.1 * scale * x, 0.1 * scale * y, heading_rad, 0.05 * still)
    notes = read(tmp_path, f"t,{header},yaw,v [m/s]", *columns).notes
    assert told in notes["path_by_speed"]
    assert ("fits" in notes["path_by_speed"]) == bool(told)


@pytest.mark.parametrize(
    ("header", "scale", "told"),
    [
        ("w", 1.19, ""),
        ("w", 1.21, "the reported turn rate is 1.21 times that of the headings"),
        ("w", 0.81, ""),
        ("w", 0.79, "the reported turn rate is 0.79 times that of the headings"),
        ("w", -1.0, "the reported turn rate is -1 times that of the headings"),
        ("w", 57.3, "57.3 times that of the headings, which fits deg/s: --column turn_rate='w [d"),
        ("w [rad/s]", 57.3, "the reported turn rate is 57.3 times that of the headings"),
    ],
)
def test_a_reported_turn_rate_that_the_headings_contradict_is_told(
    header: str, scale: float, told: str, tmp_path: Path
) -> None:
    x, y, heading_rad = drive()
    rate = np.full(len(x), 0.15 * scale)
    run = read(tmp_path, f"t,x,y,yaw,{header}", TIME_S, x, y, heading_rad, rate)
    assert told in run.notes.get("turning_by_rate", "")
    assert ("turning_by_rate" in run.notes) == bool(told)
    assert ("fits" in run.notes.get("turning_by_rate", "")) == ("fits" in told)


@pytest.mark.parametrize("large", [1e30, 1e160, 1e307])
def test_motion_beyond_all_sense_is_read_without_a_word(large: float, tmp_path: Path) -> None:
    x, y, heading_rad = drive()
    names = "t,x,y,yaw,v"
    assert len(read(tmp_path, names, TIME_S, large * x, -large * y, heading_rad, x).poses) == 201
    assert len(read(tmp_path, names, TIME_S, x, y, large * heading_rad, -large * x).poses) == 201


def test_a_first_time_that_was_never_set_costs_no_memory(tmp_path: Path) -> None:
    x, y, heading_rad = drive()
    time_s = np.where(x == 0.0, 0.0, TIME_S + 1.7e9)
    run = read(tmp_path, "t,x,y,yaw,v,w", time_s, x, y, heading_rad, x, x)
    assert "turning_by_rate" in run.notes


@pytest.mark.parametrize("turned_rad", [0.47, 0.53])
def test_little_turning_contradicts_no_rate(turned_rad: float, tmp_path: Path) -> None:
    x, y, heading_rad = drive(turned_rad * 20 / 19)  # the last second is no whole stride
    rate = np.full(len(x), 2.0 * turned_rad / 20)
    run = read(tmp_path, "t,x,y,yaw,w", TIME_S, x, y, heading_rad, rate)
    assert ("turning_by_rate" in run.notes) == (turned_rad > 0.5)


def test_an_error_in_the_second_of_two_runs_names_its_own_line(tmp_path: Path) -> None:
    times = [*np.arange(20) / 10.0, *np.arange(40) / 10.0]
    lines = [f"{time:.1f} {time:.1f} 0 0 0 0 0 {int(row != 25)}" for row, time in enumerate(times)]
    file = tmp_path / "two.tum"
    file.write_text("\n".join(lines) + "\n")
    for read in (read_run, read_trajectory):
        with pytest.raises(LogError, match="line 26, column qw: expected a rotation of a length"):
            read(file)
