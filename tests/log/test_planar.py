import math

import numpy as np
import pytest

from turtlelog.log.planar_poses import compute_tilt, describe_height


def test_floor_is_a_plane() -> None:
    assert describe_height(None, None) is None
    assert describe_height(np.array([0.3, 0.349, math.nan]), np.array([0.0, -0.0, 0.099])) is None


@pytest.mark.parametrize(("noise_m", "climb_m"), [(0.03, 0.0), (0.03, 0.2), (0.005, 0.06)])
def test_noise_of_a_height_is_not_that_of_a_robot_that_climbs(
    noise_m: float, climb_m: float
) -> None:
    height_m = np.random.default_rng(1).normal(0.0, noise_m, 600) + np.linspace(0.0, climb_m, 600)
    assert float(np.ptp(height_m)) > 0.06
    assert (describe_height(height_m, None) is None) is (climb_m == 0.0)


def test_height_that_varies_is_said() -> None:
    told = describe_height(np.array([0.3, 0.351]), np.zeros(2))
    assert told == (
        "the robot leaves the plane: its height varies by 0.051 m (0.3 to 0.351 m);"
        " most metrics are seen from above"
    )


def test_tilt_is_said() -> None:
    told = describe_height(np.zeros(2), np.array([0.0, 0.101]))
    assert told is not None
    assert "it tilts by 0 to 5.79 deg" in told
    assert "height" not in told
    both = describe_height(np.array([0.0, 2.0]), np.array([0.0, 0.5]))
    assert both is not None
    assert "varies by 2 m (0 to 2 m) and it tilts by 0 to 28.6 deg" in both


@pytest.mark.parametrize(
    ("varies_rad", "words"),
    [
        (0.0, "the robot or its frame is tilted by 177 deg throughout"),
        (0.099, "the robot or its frame is tilted by 171 to 177 deg throughout"),
        (0.101, "the robot leaves the plane: it tilts by 171 to 177 deg"),
    ],
)
def test_a_tilt_that_stays_may_be_of_the_frame(varies_rad: float, words: str) -> None:
    told = describe_height(np.zeros(2), np.array([3.09 - varies_rad, 3.09]))
    assert told == f"{words}; most metrics are seen from above"


@pytest.mark.parametrize("axis", [(1.0, 0.0), (0.0, 1.0), (0.6, 0.8)])
@pytest.mark.parametrize("tilt_rad", [0.0, 1e-9, 0.3, math.pi])
def test_tilt_is_the_angle_about_a_level_axis(axis: tuple[float, float], tilt_rad: float) -> None:
    half = tilt_rad / 2
    x, y = (np.array([3.0 * part * math.sin(half)]) for part in axis)
    found = compute_tilt(x, y, np.zeros(1), np.array([3.0 * math.cos(half)]))
    assert found == pytest.approx(tilt_rad, rel=1e-12, abs=1e-15)


def test_turning_is_no_tilt() -> None:
    half_rad = np.linspace(-3.0, 3.0, 7)
    nothing = np.zeros(7)
    assert not compute_tilt(nothing, nothing, np.sin(half_rad), np.cos(half_rad)).any()
