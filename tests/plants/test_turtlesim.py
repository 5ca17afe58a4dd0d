import math

import pytest
from hypothesis import given, strategies as st

from turtlelog.arithmetic import to_float32
from turtlelog.plants import Turtle
from turtlelog.plants.turtlesim import SPAWN_XY_M, TICK_S, WORLD_SIZE_M

SOURCE_PI = 3.14159265
WEST_RAD, NORTH_RAD, SOUTH_RAD = math.pi, math.pi / 2, -math.pi / 2


def spawn(x_m: float = 5.0, y_m: float = 5.0, heading_rad: float = 0.0) -> Turtle:
    return Turtle(x_m=x_m, y_m=y_m, heading_rad=heading_rad)


def drive(turtle: Turtle, ticks: int = 1) -> tuple[float, float, float]:
    for _ in range(ticks):
        turtle.step()
    return turtle.state[:3]


def test_world_is_499_45ths_of_a_metre_in_32_bits() -> None:
    assert to_float32(499 / 45) == WORLD_SIZE_M
    assert to_float32(WORLD_SIZE_M / 2) == SPAWN_XY_M


def test_turtle_without_a_command_stands_still() -> None:
    assert drive(spawn(SPAWN_XY_M, SPAWN_XY_M), 100) == (SPAWN_XY_M, SPAWN_XY_M, 0.0)


def test_turtle_spawns_in_32_bits() -> None:
    turtle = spawn(0.1, 5.0, 0.1)
    assert turtle.state[:3:2] == (to_float32(0.1), to_float32(0.1))


def test_turtle_turns_before_it_moves_along_the_new_heading() -> None:
    turtle = spawn()
    turtle.take_command(0.5, 1.0)
    expected = (5.0 + 0.5 * math.cos(0.016) * TICK_S, 5.0 + 0.5 * math.sin(0.016) * TICK_S, 0.016)
    assert drive(turtle) == pytest.approx(expected, abs=1e-6)
    assert turtle.state[1] - spawn().state[1] == pytest.approx(0.5 * math.sin(0.016) * TICK_S)


def test_command_is_held_until_the_next_one() -> None:
    turtle = spawn()
    turtle.take_command(0.0, 0.5)
    assert drive(turtle, 10)[2] == pytest.approx(10 * 0.5 * TICK_S)
    turtle.take_command(0.0, -0.5)
    assert drive(turtle, 10)[2] == pytest.approx(0.0)


def test_turtle_is_holonomic() -> None:
    turtle = spawn(heading_rad=NORTH_RAD)
    turtle.take_command(0.0, 0.0, lateral_speed_m_s=0.5)
    x_m, y_m, _ = drive(turtle)
    assert (x_m, y_m) == pytest.approx((5.0 - 0.5 * TICK_S, 5.0), abs=1e-6)


def test_published_speed_is_the_magnitude_of_both_velocities() -> None:
    turtle = spawn()
    turtle.take_command(-3.0, -0.5, lateral_speed_m_s=4.0)
    turtle.step()
    assert turtle.state[3:] == (5.0, -0.5)


def test_plant_has_no_velocity_limit() -> None:
    turtle = spawn()
    turtle.take_command(100.0, 0.0)
    assert drive(turtle)[0] == pytest.approx(6.6)
    turtle.take_command(0.0, 50.0)
    assert drive(turtle)[2] == pytest.approx(0.8)


@pytest.mark.parametrize("turn_rate_rad_s", [0.5, -0.5])
def test_heading_wraps_with_the_pi_of_the_source(turn_rate_rad_s: float) -> None:
    start_rad = math.copysign(3.14, turn_rate_rad_s)
    turtle = spawn(heading_rad=start_rad)
    turtle.take_command(0.0, turn_rate_rad_s)
    beyond_rad = to_float32(start_rad) + turn_rate_rad_s * TICK_S
    assert drive(turtle)[2] == beyond_rad - math.copysign(2 * SOURCE_PI, beyond_rad)


def test_heading_of_pi_itself_is_beyond_the_pi_of_the_source() -> None:
    start_rad = to_float32(math.pi)
    assert drive(spawn(heading_rad=math.pi))[2] == start_rad - 2 * SOURCE_PI


@given(st.floats(-100.0, 100.0), st.floats(-500.0, 500.0))
def test_heading_stays_in_one_turn(heading_rad: float, turn_rate_rad_s: float) -> None:
    turtle = spawn(heading_rad=heading_rad)
    turtle.take_command(0.0, turn_rate_rad_s)
    for _ in range(20):
        assert -SOURCE_PI - 1e-12 <= drive(turtle)[2] <= SOURCE_PI + 1e-12


def test_y_is_kept_downward_from_a_32_bit_height() -> None:
    down_m = to_float32(WORLD_SIZE_M - to_float32(0.1))
    assert drive(spawn(y_m=0.1))[1] == WORLD_SIZE_M - down_m != to_float32(0.1)


def test_position_is_integrated_downward_in_double_precision() -> None:
    turtle = spawn(heading_rad=1.0)
    turtle.take_command(0.1, 0.0)
    heading_rad, down_m = to_float32(1.0), to_float32(WORLD_SIZE_M - 5.0)
    for _ in range(50):
        down_m -= math.sin(heading_rad) * 0.1 * TICK_S
    assert drive(turtle, 50)[1] == WORLD_SIZE_M - down_m


def test_watchdog_stops_the_turtle_at_the_63rd_tick_without_a_command() -> None:
    turtle = spawn()
    turtle.take_command(0.5, 0.2)
    turtle.step()
    drive(turtle, 62)
    assert turtle.state[3:] == (0.5, 0.2)
    before = turtle.state[:3]
    assert drive(turtle, 10) == before
    assert turtle.state[3:] == (0.0, 0.0)


def test_every_command_winds_the_watchdog() -> None:
    turtle = spawn()
    for _ in range(3):
        turtle.take_command(0.0, 0.1)
        drive(turtle, 63)
        assert turtle.state[3:] == (0.0, 0.1)
    turtle.step()
    assert turtle.state[3:] == (0.0, 0.0)


def test_turtle_moves_again_after_the_watchdog() -> None:
    turtle = spawn()
    drive(turtle, 200)
    turtle.take_command(0.5, 0.0)
    assert drive(turtle)[0] == 5.0 + 0.5 * TICK_S


@pytest.mark.parametrize(
    ("x_m", "y_m", "heading_rad", "expected"),
    [
        (11.08, 5.0, 0.0, (WORLD_SIZE_M, 5.0)),
        (0.005, 5.0, WEST_RAD, (0.0, 5.0)),
        (5.0, 11.08, NORTH_RAD, (5.0, WORLD_SIZE_M)),
        (5.0, 0.005, SOUTH_RAD, (5.0, 0.0)),
    ],
    ids=["right", "left", "top", "bottom"],
)
def test_wall_holds_the_turtle(
    x_m: float, y_m: float, heading_rad: float, expected: tuple[float, float]
) -> None:
    turtle = spawn(x_m, y_m, heading_rad)
    turtle.take_command(1.0, 0.0)
    drive(turtle)
    assert turtle.hit_wall
    assert turtle.state[:2] == pytest.approx(expected, abs=1e-6)
    wall = 0 if heading_rad in {0.0, WEST_RAD} else 1
    assert turtle.state[wall] == expected[wall]


def test_turtle_slides_along_a_wall() -> None:
    turtle = spawn(WORLD_SIZE_M, 5.0, 1.0)
    turtle.take_command(1.0, 0.0)
    x_m, y_m, _ = drive(turtle, 10)
    assert x_m == WORLD_SIZE_M
    assert y_m == pytest.approx(5.0 + 10 * math.sin(1.0) * TICK_S, abs=1e-6)


def test_turtle_leaves_a_wall() -> None:
    turtle = spawn(0.0, 5.0)
    turtle.take_command(-1.0, 0.0)
    drive(turtle)
    assert turtle.hit_wall
    turtle.take_command(1.0, 0.0)
    assert drive(turtle)[0] == TICK_S
    assert not turtle.hit_wall


def test_touching_a_wall_is_no_hit() -> None:
    turtle = spawn(WORLD_SIZE_M, WORLD_SIZE_M)
    turtle.step()
    assert not turtle.hit_wall


def test_teleport_waits_for_the_next_step() -> None:
    turtle = spawn()
    turtle.teleport_to(2.0, 3.0, 1.0)
    assert turtle.state[0] == 5.0
    assert drive(turtle) == pytest.approx((2.0, 3.0, 1.0), abs=1e-6)
    assert turtle.state[2] == 1.0


def test_teleport_comes_before_the_motion_of_its_tick() -> None:
    turtle = spawn()
    turtle.take_command(1.0, 0.0)
    turtle.teleport_to(2.0, 5.0, 0.0)
    assert drive(turtle)[0] == 2.0 + TICK_S


def test_relative_teleport_turns_before_it_moves() -> None:
    turtle = spawn()
    turtle.teleport_by(1.5, NORTH_RAD)
    assert drive(turtle) == pytest.approx((5.0, 6.5, NORTH_RAD), abs=1e-6)


def test_relative_teleports_add_up() -> None:
    turtle = spawn()
    for _ in range(2):
        turtle.teleport_by(1.0, NORTH_RAD)
    assert drive(turtle)[:2] == pytest.approx((4.0, 6.0), abs=1e-6)


def test_teleports_are_applied_in_order() -> None:
    first, last = spawn(), spawn()
    first.teleport_by(1.0, 0.0)
    first.teleport_to(2.0, 5.0, 0.0)
    last.teleport_to(2.0, 5.0, 0.0)
    last.teleport_by(1.0, 0.0)
    assert (drive(first)[0], drive(last)[0]) == (2.0, 3.0)


def test_teleport_happens_once() -> None:
    turtle = spawn()
    turtle.teleport_by(1.0, 0.0)
    assert drive(turtle, 5)[0] == 6.0


def test_teleport_beyond_a_wall_ends_at_it() -> None:
    turtle = spawn()
    turtle.teleport_to(20.0, 20.0, 0.0)
    assert drive(turtle)[:2] == (WORLD_SIZE_M, WORLD_SIZE_M)
    assert turtle.hit_wall


def test_teleport_above_the_world_is_cut_before_the_wall_is_hit() -> None:
    turtle = spawn()
    turtle.teleport_to(5.0, 20.0, 0.0)
    assert drive(turtle)[1] == WORLD_SIZE_M
    assert not turtle.hit_wall


def test_teleport_does_not_wind_the_watchdog() -> None:
    turtle = spawn()
    turtle.take_command(0.5, 0.0)
    drive(turtle, 63)
    turtle.teleport_to(2.0, 5.0, 0.0)
    assert drive(turtle)[0] == 2.0


@given(st.floats(-1e6, 1e6), st.floats(-1e3, 1e3), st.floats(-1e6, 1e6))
def test_no_command_drives_the_turtle_out_of_the_world(
    speed_m_s: float, turn_rate_rad_s: float, lateral_speed_m_s: float
) -> None:
    turtle = spawn()
    turtle.take_command(speed_m_s, turn_rate_rad_s, lateral_speed_m_s)
    x_m, y_m, _ = drive(turtle, 10)
    assert 0.0 <= x_m <= WORLD_SIZE_M
    assert 0.0 <= y_m <= WORLD_SIZE_M
