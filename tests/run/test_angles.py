import math
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray

from turtlelog.errors import FrameError
from turtlelog.laws import Goal, Pose, SequentialP, SequentialPParameters
from turtlelog.plants import Turtle
from turtlelog.plants.turtlesim import TICK_S
from turtlelog.run import PoseColumns
from turtlelog.run.angles import (
    build_rotation,
    find_heading_steps,
    project_on_heading,
    rotate_to_turtle,
    rotate_to_world,
    subtract_headings,
    unwrap_headings,
    wrap_angle,
)

JUST_BELOW_PI = math.nextafter(math.pi, 0.0)
JUST_BELOW_MINUS_PI = math.nextafter(-math.pi, -4.0)

any_angle = st.floats(allow_nan=False, allow_infinity=False)
moderate_angle = st.floats(-1e6, 1e6)
inside_angle = st.floats(-math.pi, math.pi, exclude_max=True)


@given(any_angle)
def test_wrapped_angle_lies_in_the_half_open_turn(angle_rad: float) -> None:
    assert -math.pi <= wrap_angle(angle_rad) < math.pi


@pytest.mark.parametrize(
    "angle_rad", [5e12, -7.3e15, 1e16, 123456789e9, 1e17, -1e300, sys.float_info.max]
)
def test_huge_angle_wraps_into_the_half_open_turn(angle_rad: float) -> None:
    assert -math.pi <= wrap_angle(angle_rad) < math.pi


@given(moderate_angle)
def test_wrapped_angle_points_the_same_way(angle_rad: float) -> None:
    wrapped = wrap_angle(angle_rad)
    assert math.cos(wrapped) == pytest.approx(math.cos(angle_rad), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle_rad), abs=1e-9)


@given(inside_angle)
def test_angle_inside_comes_back_bit_for_bit(angle_rad: float) -> None:
    assert wrap_angle(angle_rad).hex() == angle_rad.hex()


@given(st.lists(inside_angle, max_size=5))
def test_array_inside_comes_back_bit_for_bit(angles_rad: list[float]) -> None:
    angles = np.array(angles_rad)
    assert wrap_angle(angles).tobytes() == angles.tobytes()


@given(inside_angle, st.integers(-1000, 1000))
def test_whole_turns_do_not_change_a_direction(angle_rad: float, turns: int) -> None:
    turned = wrap_angle(angle_rad + turns * math.tau)
    assert abs(subtract_headings(turned, angle_rad)) < 1e-11


@given(st.lists(any_angle, min_size=1, max_size=5))
def test_array_wraps_like_its_scalars(angles_rad: list[float]) -> None:
    wrapped = wrap_angle(np.array(angles_rad))
    assert wrapped.tolist() == [wrap_angle(angle) for angle in angles_rad]


def test_array_keeps_its_shape_and_its_input() -> None:
    angles = np.full((2, 3), 4.0)
    assert wrap_angle(angles).shape == (2, 3)
    assert (angles == 4.0).all()


def test_empty_array_wraps_to_an_empty_array() -> None:
    assert wrap_angle(np.zeros(0)).shape == (0,)


@pytest.mark.parametrize(
    ("angle_rad", "expected_rad"),
    [
        (math.pi, -math.pi),
        (-math.pi, -math.pi),
        (JUST_BELOW_PI, JUST_BELOW_PI),
        (3 * math.pi, -math.pi),
        (-3 * math.pi, -math.pi),
        (0.0, 0.0),
    ],
)
def test_half_turns_wrap_to_minus_pi(angle_rad: float, expected_rad: float) -> None:
    assert wrap_angle(angle_rad) == expected_rad
    assert wrap_angle(np.array([angle_rad])).tolist() == [expected_rad]


def test_just_below_minus_pi_stays_next_to_the_half_turn() -> None:
    wrapped = wrap_angle(JUST_BELOW_MINUS_PI)
    assert abs(wrapped) == pytest.approx(math.pi, abs=1e-15)


@pytest.mark.parametrize(
    ("to_rad", "from_rad", "turn_rad"),
    [(0.5, 0.2, 0.3), (-3.0, 3.0, math.tau - 6.0), (3.0, -3.0, 6.0 - math.tau), (1.0, 1.0, 0.0)],
    ids=["plain", "left-across-pi", "right-across-pi", "none"],
)
def test_headings_differ_by_the_shortest_turn(
    to_rad: float, from_rad: float, turn_rad: float
) -> None:
    assert subtract_headings(to_rad, from_rad) == pytest.approx(turn_rad)
    assert subtract_headings(to_rad, np.array([from_rad])) == pytest.approx(turn_rad)


@given(moderate_angle, moderate_angle)
def test_shortest_turn_leads_from_one_heading_to_the_other(to_rad: float, from_rad: float) -> None:
    arrived_rad = from_rad + subtract_headings(to_rad, from_rad)
    assert math.cos(arrived_rad - to_rad) == pytest.approx(1.0)


GOAL_BEARING_RAD = math.atan2(10.0 - 5.5, 2.0 - 5.5)  # the paper's start and goal

headings = st.floats(-7.0, 7.0)
lengths = st.floats(0.01, 100.0)
vectors = st.tuples(st.floats(-100.0, 100.0), st.floats(-100.0, 100.0)).map(np.array)


def point_at(bearing_rad: float) -> NDArray[np.float64]:
    return np.array([math.cos(bearing_rad), math.sin(bearing_rad)])


def measure_turn(from_xy: NDArray[np.float64], to_xy: NDArray[np.float64]) -> float:
    cross = from_xy[0] * to_xy[1] - from_xy[1] * to_xy[0]
    return math.degrees(math.atan2(cross, from_xy @ to_xy))


@given(headings, lengths)
def test_nothing_is_lateral_when_the_turtle_is_aligned_with_the_goal(
    bearing_rad: float, speed_m_s: float
) -> None:
    # Equations 11 and 15.
    forward, left = rotate_to_turtle(speed_m_s * point_at(bearing_rad), bearing_rad)
    assert forward == pytest.approx(speed_m_s)
    assert left == pytest.approx(0.0, abs=1e-12 * speed_m_s)


def test_what_points_left_of_the_heading_is_positive_lateral() -> None:
    # Equation 11, by hand: the turtle faces up, the goal lies at -x.
    forward, left = rotate_to_turtle([-3.0, 0.0], math.pi / 2)
    assert (forward, left) == pytest.approx((0.0, 3.0))


@given(vectors, headings)
def test_forward_speed_is_the_dot_product_with_the_heading(
    world_xy: NDArray[np.float64], heading_rad: float
) -> None:
    # Equation 16.
    forward = project_on_heading(world_xy, heading_rad)
    assert forward == pytest.approx(world_xy @ point_at(heading_rad), abs=1e-10)
    assert forward == rotate_to_turtle(world_xy, heading_rad)[0]


@given(headings, st.floats(-3.1, 3.1), lengths)
def test_forward_speed_is_negative_exactly_when_the_goal_is_behind(
    heading_rad: float, error_rad: float, speed_m_s: float
) -> None:
    # Equation 17.
    forward = project_on_heading(speed_m_s * point_at(heading_rad + error_rad), heading_rad)
    assert forward == pytest.approx(speed_m_s * math.cos(error_rad), abs=1e-10)
    assert (forward < 0.0) == (abs(error_rad) > math.pi / 2)


def test_a_goal_straight_behind_reverses_the_whole_speed() -> None:
    # Equation 17.
    behind = 2.0 * point_at(GOAL_BEARING_RAD + math.pi)
    assert project_on_heading(behind, GOAL_BEARING_RAD) == pytest.approx(-2.0)


def test_the_matrix_is_that_of_equation_7_put_right() -> None:
    cos, sin = point_at(GOAL_BEARING_RAD)
    assert build_rotation(GOAL_BEARING_RAD).tolist() == [[cos, -sin], [sin, cos]]


def test_the_printed_matrix_sends_an_aligned_turtle_104_degrees_away_from_the_goal() -> None:
    # Equations 7 and 10 print the matrix transposed; at 128 degrees that is no small matter.
    rotation = build_rotation(GOAL_BEARING_RAD)
    ahead, to_goal = np.array([1.0, 0.0]), point_at(GOAL_BEARING_RAD)
    assert measure_turn(to_goal, rotation @ ahead) == pytest.approx(0.0, abs=1e-9)
    assert measure_turn(to_goal, rotation.T @ ahead) == pytest.approx(104.250, abs=0.001)


@given(headings)
def test_the_printed_matrix_is_wrong_by_twice_the_heading(heading_rad: float) -> None:
    rotation = build_rotation(heading_rad)
    error = np.linalg.norm((rotation - rotation.T) @ [1.0, 0.0])
    assert error == pytest.approx(2.0 * abs(math.sin(heading_rad)), abs=1e-12)


@pytest.mark.parametrize("heading_rad", [0.0, math.pi, -math.pi])
def test_the_printed_matrix_is_right_only_along_the_x_axis(heading_rad: float) -> None:
    rotation = build_rotation(heading_rad)
    assert rotation == pytest.approx(rotation.T, abs=1e-15)


@given(headings)
def test_the_transposed_matrix_is_the_inverse(heading_rad: float) -> None:
    rotation = build_rotation(heading_rad)
    assert rotation @ rotation.T == pytest.approx(np.eye(2), abs=1e-15)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


@given(vectors, headings)
def test_rotations_agree_with_the_matrix(
    vector_xy: NDArray[np.float64], heading_rad: float
) -> None:
    rotation = build_rotation(heading_rad)
    assert rotate_to_world(vector_xy, heading_rad) == pytest.approx(rotation @ vector_xy, abs=1e-10)
    to_turtle = rotate_to_turtle(vector_xy, heading_rad)
    assert to_turtle == pytest.approx(rotation.T @ vector_xy, abs=1e-10)


@given(vectors, headings)
def test_there_and_back_is_where_it_was(vector_xy: NDArray[np.float64], heading_rad: float) -> None:
    there = rotate_to_turtle(vector_xy, heading_rad)
    assert rotate_to_world(there, heading_rad) == pytest.approx(vector_xy, abs=1e-10)
    there = rotate_to_world(vector_xy, heading_rad)
    assert rotate_to_turtle(there, heading_rad) == pytest.approx(vector_xy, abs=1e-10)


@given(vectors, headings)
def test_lengths_are_kept(vector_xy: NDArray[np.float64], heading_rad: float) -> None:
    length = np.hypot(*vector_xy)
    assert np.hypot(*rotate_to_turtle(vector_xy, heading_rad)) == pytest.approx(length)
    assert np.hypot(*rotate_to_world(vector_xy, heading_rad)) == pytest.approx(length)


def test_one_vector_meets_many_headings() -> None:
    heading_rad = np.linspace(-3.0, 3.0, 7)
    assert rotate_to_turtle([1.0, 0.0], heading_rad).shape == (7, 2)
    assert rotate_to_world([1.0, 0.0], heading_rad).shape == (7, 2)
    assert project_on_heading([1.0, 0.0], heading_rad) == pytest.approx(np.cos(heading_rad))


def test_many_vectors_meet_one_heading() -> None:
    world_xy = np.arange(12.0).reshape(3, 2, 2)
    rows = rotate_to_turtle(world_xy, GOAL_BEARING_RAD)
    assert rows.shape == (3, 2, 2)
    assert rows[2, 1] == pytest.approx(rotate_to_turtle(world_xy[2, 1], GOAL_BEARING_RAD))


def test_rows_and_headings_are_paired() -> None:
    world_xy, heading_rad = np.array([[1.0, 0.0], [0.0, 2.0]]), np.array([0.0, math.pi / 2])
    assert rotate_to_turtle(world_xy, heading_rad) == pytest.approx(np.array([[1, 0], [2, 0]]))
    assert build_rotation(heading_rad).shape == (2, 2, 2)
    assert build_rotation(0.0).shape == (2, 2)


@pytest.mark.parametrize("wrong", [1.0, [1.0], [1.0, 2.0, 3.0]], ids=["scalar", "one", "three"])
def test_a_vector_without_two_coordinates_is_refused(wrong: float | list[float]) -> None:
    with pytest.raises(FrameError, match=r"expected vectors of shape \(\.\.\., 2\)"):
        rotate_to_turtle(wrong, 0.0)


def test_the_plant_moves_by_the_turtle_vector_in_the_world_frame() -> None:
    turtle = Turtle(x_m=5.0, y_m=5.0, heading_rad=2.0)
    before_xy = np.array(turtle.state[:2])
    turtle.take_command(0.75, 0.0, lateral_speed_m_s=-0.5)
    turtle.step()
    moved_xy = np.array(turtle.state[:2]) - before_xy
    assert moved_xy == pytest.approx(rotate_to_world([0.75, -0.5], 2.0) * TICK_S, abs=1e-12)


def test_the_law_as_its_equation_says_projects_on_the_heading() -> None:
    law = SequentialP(SequentialPParameters(kp_linear=4.0, heading_tolerance_rad=1.0))
    pose = Pose(5.5, 5.5, GOAL_BEARING_RAD - 0.1)
    law.reset(pose, Goal(2.0, 10.0), None)
    decision = [law.step(0, pose) for _ in range(3)][-1]
    assert decision.phase == "translate"
    world_xy = [decision.world_v_x_m_s, decision.world_v_y_m_s]
    assert decision.speed_m_s == project_on_heading(world_xy, pose.heading_rad)


def turn(turned_rad: list[float], rates: list[float], last_s: float = 1.0) -> PoseColumns:
    """Return poses one second apart, except the last, that turn by angles at rates."""
    count = len(turned_rad) + 1
    heading_rad = wrap_angle(np.append(0.0, np.cumsum(turned_rad)))
    time_ns = np.arange(count) * 1_000_000_000
    time_ns[-1] = time_ns[-2] + round(last_s * 1e9)
    return PoseColumns(
        time_ns=time_ns,
        xy_m=np.zeros((count, 2)),
        heading_rad=heading_rad,
        turn_rate_rad_s=np.append(0.0, rates),
    )


def test_the_turn_rate_counts_the_full_turns_between_poses() -> None:
    turned_rad = [4.46, -4.42, 40.0, 3.2, -3.2, 0.5]
    poses = turn(turned_rad, turned_rad)
    assert np.diff(unwrap_headings(poses)) == pytest.approx(turned_rad)
    assert find_heading_steps(poses).is_fast.tolist() == [True] * 5 + [False]
    shortest = np.diff(unwrap_headings(replace(poses, turn_rate_rad_s=None)))
    assert shortest[0] == pytest.approx(4.46 - 2.0 * math.pi)


@pytest.mark.parametrize(
    ("rate", "last_s", "is_fast", "is_lost"),
    [
        (4.09, 1.0, True, False),
        (4.11, 1.0, True, True),  # more than 0.1 rad from the turn
        (3.15, 1.0, True, True),
        (3.14, 1.0, False, False),
        (4.0 / 1.49, 1.49, True, False),
        (4.0 / 1.51, 1.51, False, False),  # during a silence the rate is unknown
    ],
)
def test_a_rate_counts_turns_that_it_explains_in_usual_steps(
    rate: float,
    last_s: float,
    is_fast: bool,  # noqa: FBT001
    is_lost: bool,  # noqa: FBT001
) -> None:
    poses = turn([0.1, 0.1, 4.0], [0.1, 0.1, rate], last_s)
    steps = find_heading_steps(poses)
    assert (steps.is_fast[-1], steps.is_lost[-1]) == (is_fast, is_lost)
    found = 4.0 if is_fast and not is_lost else 4.0 - 2.0 * math.pi
    assert np.diff(unwrap_headings(poses))[-1] == pytest.approx(found)
