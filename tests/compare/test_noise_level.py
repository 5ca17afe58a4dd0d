"""Noise that doubled or halved is told; the same noise, and another robot, are not called noise."""

from dataclasses import replace

import numpy as np
import pytest

from tests.compare.test_robot_prediction import add_noise, make_scenario, simulate
from tests.identify.test_robot_scenario import LOG, build, drive_with_noise
from turtlelog.compare import compare_robot
from turtlelog.compare.robot_comparison import NoiseLevel, compare_noise

SEEDS, PIECES = 39, 400


def draw(rng: np.random.Generator, times: float, pieces: int = PIECES) -> np.ndarray:
    return times * np.abs(rng.normal(size=pieces))


def compare(times: float, later: float | None = None, *, pieces: int = PIECES) -> str:
    """Return the level of noise that is so many times as simulated, and later so many times."""
    rng = np.random.default_rng(7)
    simulated = np.abs(rng.normal(size=(SEEDS, PIECES)))
    short = draw(rng, times, pieces), simulated[:, :pieces]
    long = draw(rng, times if later is None else later), np.abs(rng.normal(size=(SEEDS, PIECES)))
    level = compare_noise("heading", 0.1, short, long)
    return "unknown" if level is None else level.level


@pytest.mark.parametrize(
    ("times", "level"),
    [
        *((1.0, "as simulated"), (1.25, "as simulated"), (0.8, "as simulated")),
        *((1.7, "noisier"), (0.6, "quieter")),
    ],
)
def test_noise_is_told_from_halfway_to_the_double_or_half_on(times: float, level: str) -> None:
    assert compare(times) == level


def test_errors_that_grow_as_those_of_a_wrong_model_are_not_called_noise() -> None:
    assert compare(2.0, 2.2) == "noisier"
    assert compare(2.0, 4.0) == "as simulated"


def test_thirty_errors_are_enough_and_one_less_is_not() -> None:
    assert compare(4.0, 3.0, pieces=30) == "noisier"
    assert compare(4.0, 3.0, pieces=29) == "unknown"


def test_a_ratio_in_the_hundreds_has_no_exponent() -> None:
    found = NoiseLevel(
        quantity="heading", after_s=0.1, ratio=403.0, low=8.76, high=1234.0, level="noisier"
    )
    assert found.text.endswith("400 times as much (8.8 to 1200).")


def test_errors_that_are_all_zero_say_nothing_of_noise() -> None:
    none = np.zeros(PIECES), np.zeros((SEEDS, PIECES))
    assert compare_noise("position", 0.1, none, none) is None


@pytest.mark.parametrize(("times", "level"), [(0.5, "quieter"), (1.0, ""), (2.0, "noisier")])
def test_noise_of_a_robot_is_told_from_a_run_of_a_minute(times: float, level: str) -> None:
    """Simulate 39 seeds of a minute: the band of the noise needs them all."""
    scenario = add_noise(make_scenario())
    run = simulate(add_noise(make_scenario(), times), seed=3, duration_s=60.0)
    levels = {one.level for one in compare_robot(run, scenario).noise}
    assert levels == {level or "as simulated"}


@pytest.mark.thorough
@pytest.mark.parametrize("times", [0.5, 2.0])
def test_noise_beside_that_of_an_identified_robot_is_told(times: float) -> None:
    """Identify a robot, and drive another log with other noise: fits take seconds."""
    rates, sensing = np.array([0.01, 0.02]), np.array([1e-3, 2e-3])
    log = replace(LOG, duration_s=60.0)
    fitted = drive_with_noise(1, rates=tuple(rates), sensing=tuple(sensing), log=log)
    other = drive_with_noise(2, rates=tuple(times * rates), sensing=tuple(times * sensing), log=log)
    found = compare_robot(other, build(fitted).scenario).noise
    assert {one.level for one in found} == {"noisier" if times > 1.0 else "quieter"}
    for one in found:
        assert one.low < one.ratio < one.high
        assert f"{one.ratio:.2g} times as much" in one.text


@pytest.mark.parametrize("key", ["plant__speed_gain", "plant__turn_gain"])
def test_another_gain_with_the_same_noise_is_not_called_noise(key: str) -> None:
    """Simulate 39 seeds of a minute: the band of the noise needs them all."""
    scenario = add_noise(make_scenario())
    run = simulate(add_noise(make_scenario(**{key: 0.8})), seed=4, duration_s=60.0)
    assert "noisier" not in {one.level for one in compare_robot(run, scenario).noise}
