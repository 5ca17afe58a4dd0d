"""Robots that travel at an angle to their heading, and robots that only seem to."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from turtlelog import identify_robot
from turtlelog.measure import find_travel_direction, measure_run
from turtlelog.run import CommandColumns, Origin, PoseColumns, Run, SampleColumns
from turtlelog.run.angles import wrap_angle

Values = NDArray[np.float64]
STEP_S = 0.02


def draw_commands(seed: int = 1, *, backward: float = 0.0) -> tuple[Values, Values]:
    """Return speed and turn rate for 60 s, by steps of 2 s; a share of the speeds is negative."""
    random = np.random.default_rng(seed)
    speeds = random.choice([0.0, 0.2, 0.35, 0.5], 30) * random.choice(
        [-1.0, 1.0], 30, p=[backward, 1.0 - backward]
    )
    rates = random.choice([-0.8, -0.3, 0.0, 0.4, 0.9], 30)
    hold = round(2.0 / STEP_S)
    return np.repeat(speeds, hold), np.repeat(rates, hold)


def drive(
    speed: Values,
    rate: Values,
    *,
    mounted_deg: float = 0.0,
    aside: Values | float = 0.0,
    commanded_aside: Values | float = 0.0,
    arm_m: tuple[float, float] = (0.0, 0.0),
    noise_m: float = 0.0,
) -> Run:
    """Return a robot with a lag of 0.1 s whose marker is mounted at an angle, on an arm."""
    fade = math.exp(-STEP_S / 0.1)
    lagged = np.zeros((3, len(speed) + 1))
    wanted = np.array([speed, rate, aside + 0.0 * speed])
    for row in range(len(speed)):
        lagged[:, row + 1] = fade * lagged[:, row] + (1.0 - fade) * wanted[:, row]
    v, w, y = lagged
    heading = np.concatenate([[0.0], np.cumsum(w[1:] * STEP_S)])
    middle = heading[:-1] + w[1:] * STEP_S / 2.0
    step = np.column_stack(
        [
            v[1:] * np.cos(middle) - y[1:] * np.sin(middle),
            v[1:] * np.sin(middle) + y[1:] * np.cos(middle),
        ]
    )
    xy_m = np.concatenate([[[0.0, 0.0]], np.cumsum(step * STEP_S, axis=0)])
    cos, sin = np.cos(heading), np.sin(heading)
    xy_m += np.column_stack([cos * arm_m[0] - sin * arm_m[1], sin * arm_m[0] + cos * arm_m[1]])
    xy_m += np.random.default_rng(5).normal(0.0, noise_m, xy_m.shape)
    time_ns = np.rint(np.arange(len(v)) * STEP_S * 1e9).astype(np.int64)
    return Run(
        name="robot",
        source="test",
        poses=PoseColumns(
            time_ns=time_ns,
            xy_m=xy_m,
            heading_rad=wrap_angle(heading + math.radians(mounted_deg)),
            speed_m_s=None,
            turn_rate_rad_s=None,
        ),
        commands=CommandColumns(
            time_ns=time_ns[:-1],
            speed_m_s=speed,
            turn_rate_rad_s=rate,
            lateral_speed_m_s=commanded_aside + 0.0 * speed,
        ),
        samples=SampleColumns.build_empty(),
        absent=("samples", "poses.speed_m_s", "poses.turn_rate_rad_s"),
    )


def find_angle_deg(run: Run) -> float | None:
    found = find_travel_direction(run)
    return None if found is None else math.degrees(found.angle_rad)


@pytest.mark.parametrize("backward", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("noise_m", [0.0, 0.01])
@pytest.mark.parametrize("mounted_deg", [-60.0, -15.0, 15.0, 40.0])
def test_a_turned_marker_shows_forward_and_backward(
    mounted_deg: float, noise_m: float, backward: float
) -> None:
    run = drive(*draw_commands(backward=backward), mounted_deg=mounted_deg, noise_m=noise_m)
    assert find_angle_deg(run) == pytest.approx(-mounted_deg, abs=1.0 if noise_m else 0.1)


@pytest.mark.parametrize("reports", [False, True])
@pytest.mark.parametrize("mounted_deg", [-150.0, -100.0, 80.0, 90.0, 120.0])
def test_the_reported_speed_and_the_commands_show_which_way_is_forward(
    mounted_deg: float, *, reports: bool
) -> None:
    speed, rate = draw_commands(backward=0.2)
    run = drive(speed, rate, mounted_deg=mounted_deg)
    reported = np.append(0.0, speed) if reports else None
    run = replace(run, poses=replace(run.poses, measured_speed_m_s=reported))
    found = find_travel_direction(run)
    assert found is not None
    assert math.degrees(found.angle_rad) == pytest.approx(-mounted_deg, abs=0.5)
    assert ("have the wrong sign" in found.describe()) == (abs(mounted_deg) > 95.0)


def test_a_travel_that_reports_and_commands_tell_apart_is_within_a_quarter_turn() -> None:
    speed, rate = draw_commands()
    run = drive(speed, rate, mounted_deg=120.0)
    backward = np.append(0.0, -speed)
    run = replace(run, poses=replace(run.poses, measured_speed_m_s=backward))
    assert find_angle_deg(run) == pytest.approx(60.0, abs=0.5)


@pytest.mark.parametrize(("mounted_deg", "shows"), [(4.5, False), (5.5, True)])
def test_an_angle_of_five_degrees_is_told(mounted_deg: float, *, shows: bool) -> None:
    found = find_travel_direction(drive(*draw_commands(), mounted_deg=mounted_deg))
    assert (found is not None) == shows
    if found is not None:
        assert found.shortfall == pytest.approx(1.0 - math.cos(math.radians(5.5)), abs=2e-4)


def test_a_marker_beside_the_centre_is_not_turned() -> None:
    assert find_angle_deg(drive(*draw_commands(), arm_m=(0.3, 0.2))) is None
    both = drive(*draw_commands(), arm_m=(0.3, 0.2), mounted_deg=20.0)
    assert find_angle_deg(both) == pytest.approx(-20.0, abs=1.0)


@pytest.mark.parametrize("speed", [0.3, -0.3])
def test_one_circle_does_not_show_whether_a_marker_is_turned(speed: float) -> None:
    run = drive(np.full(3000, speed), np.full(3000, 0.5), arm_m=(0.3, 0.0))
    assert find_angle_deg(run) is None


@pytest.mark.parametrize(
    "slip",
    [
        lambda speed, rate: 0.3 * speed * rate,  # outward in turns, by the centrifugal force
        lambda speed, rate: 0.1 * (np.arange(len(speed)) > 2000) + 0.0 * rate,  # now and then
    ],
    ids=["in-turns", "now-and-then"],
)
def test_a_robot_that_slips_has_no_angle(slip: Callable[[Values, Values], Values]) -> None:
    speed, rate = draw_commands()
    assert find_angle_deg(drive(speed, rate, aside=slip(speed, rate))) is None


def test_a_robot_that_is_sent_sideways_travels_as_it_should() -> None:
    """Takes 2 to 5 s, because a robot is identified."""
    speed, rate = (column[:1500] for column in draw_commands())
    sent = drive(speed, rate, aside=0.5 * speed, commanded_aside=0.5 * speed)
    assert find_angle_deg(sent) is None
    model = identify_robot(sent)
    assert model.speed.gain is not None
    assert model.speed.gain.value == pytest.approx(1.0, abs=0.01)
    assert not [note for note in model.notes if "travels" in note]


def test_too_little_motion_shows_nothing() -> None:
    speed, rate = draw_commands()
    speed[200:] = 0.0
    assert find_angle_deg(drive(speed, rate, mounted_deg=40.0)) is None
    assert find_angle_deg(drive(0.0 * speed, rate, mounted_deg=40.0, noise_m=0.01)) is None


@pytest.mark.parametrize("noise_m", [0.0, 0.002])
def test_identify_measures_the_speed_in_the_direction_of_travel(noise_m: float) -> None:
    """Takes 2 to 4 s, because a robot is identified."""
    speed, rate = (column[:1500] for column in draw_commands())
    model = identify_robot(drive(speed, rate, mounted_deg=40.0, noise_m=noise_m))
    assert model.speed.gain is not None
    assert model.speed.gain.value == pytest.approx(1.0, abs=0.01)
    (note,) = (note for note in model.notes if "travels" in note)
    assert note.startswith("In robot, the robot travels 40.")
    assert "speeds along the heading are 23." in note


def test_metrics_and_measured_rates_are_along_the_heading() -> None:
    turned = drive(*draw_commands(), mounted_deg=60.0)
    fastest = measure_run(turned)["run.measured_speed_max"].value
    assert fastest == pytest.approx(0.25, abs=0.01)
    assert find_travel_direction(replace(turned, origin=Origin(has_leaps=True))) is None


def report(run: Run, mounted_deg: float) -> Run:
    """Return a run whose poses also have the speeds that the wheels report."""
    heading_rad = run.poses.heading_rad - math.radians(mounted_deg)
    step_m = np.diff(run.poses.xy_m, axis=0, prepend=run.poses.xy_m[:1])
    speed = (step_m[:, 0] * np.cos(heading_rad) + step_m[:, 1] * np.sin(heading_rad)) / STEP_S
    return replace(run, poses=replace(run.poses, measured_speed_m_s=speed))


@pytest.mark.parametrize("backward", [0.0, 0.5])
@pytest.mark.parametrize("mounted_deg", [-135.0, -80.0, 90.0, 120.0, 179.0])
def test_reported_speeds_show_which_end_is_ahead(mounted_deg: float, backward: float) -> None:
    run = drive(*draw_commands(backward=backward), mounted_deg=mounted_deg)
    found = find_travel_direction(report(run, mounted_deg))
    assert found is not None
    assert math.degrees(found.angle_rad) == pytest.approx(-mounted_deg, abs=0.3)
    is_left = mounted_deg < 0.0
    assert f"deg to the {'left' if is_left else 'right'} of its heading" in found.describe()


def test_a_heading_that_points_backward_is_no_fault_of_the_driver() -> None:
    """Two robots are identified. One fault, a turned heading, is likelier than two."""
    run = drive(*draw_commands(), mounted_deg=120.0)
    assert "reverse the sign of the speed" not in identify_robot(run).speed.advice
    model = identify_robot(report(run, 120.0))
    assert model.speed.gain is not None
    assert model.speed.gain.value == pytest.approx(1.0, abs=0.01)
    (note,) = [note for note in model.notes if "deg to the right of its heading" in note]
    assert "speeds along the heading have the wrong sign" in note


def test_wheels_that_turn_against_their_commands_keep_the_heading() -> None:
    run = drive(*draw_commands(), mounted_deg=20.0)
    wheels = report(run, 20.0)
    commands = replace(run.commands, speed_m_s=-run.commands.speed_m_s)
    found = find_travel_direction(replace(wheels, commands=commands))
    assert found is not None
    assert math.degrees(found.angle_rad) == pytest.approx(-20.0, abs=0.1)
