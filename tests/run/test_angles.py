import math
import sys

import numpy as np
import pytest
from hypothesis import given, strategies as st

from turtlelog.run.angles import subtract_headings, wrap_angle

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
