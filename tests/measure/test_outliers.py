"""Outliers of measured signals: what is one, and what is none."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.log.runs import find_shared
from turtlelog import read_run
from turtlelog.measure.pose_noise import describe_outliers, list_outliers
from turtlelog.measure.rates import find_outliers
from turtlelog.measure.reductions import compute_median

Values = NDArray[np.float64]

STEP_NS = 50_000_000


def find(values: Values, step_ns: int = STEP_NS) -> list[int]:
    return [*map(int, find_outliers(np.arange(len(values)) * step_ns, values))]


def make_zigzag(count: int = 100, height: float = 0.1) -> Values:
    """Return a signal whose every second value stands out, by up to its height."""
    rows = np.arange(count)
    return np.asarray(height * (rows % 2) * np.abs(np.sin(rows)), dtype=np.float64)


def make_slow_wave(count: int = 200) -> Values:
    return np.asarray(np.sin(np.arange(count) * 0.05), dtype=np.float64)


def test_the_wrap_fault_of_a_real_robot_is_found_and_kept() -> None:
    run = read_run(find_shared("robots", "tb3"))
    (outlier,) = list_outliers(run)
    assert (outlier.signal, round(outlier.value, 1)) == ("measured_turn_rate", -143.6)
    assert run.poses.measured_turn_rate_rad_s is not None
    assert run.poses.measured_turn_rate_rad_s[outlier.row] == outlier.value
    (text,) = describe_outliers(run).values()
    assert text.startswith("1 outlier, -143.6 rad/s at 31.")


@pytest.mark.parametrize(("times", "is_found"), [(5.5, True), (4.5, False)])
def test_an_outlier_stands_out_far_more_than_any_other_value(
    times: float, *, is_found: bool
) -> None:
    values = make_zigzag()
    values[51] = 0.1 * times
    assert find(values) == ([51] if is_found else [])


def test_several_outliers_of_several_sizes_are_found() -> None:
    values = make_slow_wave(400)
    values[[50, 150, 151, 350]] += [100.0, -8.0, 30.0, 2.0]
    # Two in a row, on either side of the signal, stand out each.
    assert find(values) == [50, 150, 151, 350]


@pytest.mark.parametrize(("count", "is_found"), [(4, True), (5, False)])
def test_what_stands_out_often_belongs_to_the_signal(count: int, *, is_found: bool) -> None:
    values = make_slow_wave(400)
    values[20 : 20 + 40 * count : 40] += 50.0
    assert len(find(values)) == (count if is_found else 0)


@pytest.mark.parametrize(("times", "is_found"), [(3.3, True), (2.7, False)])
def test_more_is_needed_where_the_signal_moves_much(times: float, *, is_found: bool) -> None:
    values = np.clip(np.arange(100.0), 40.0, 60.0)
    # Around row 50 the signal moves by 10 within five rows on either side.
    values[50] = 51.0 + 10.0 * times
    assert find(values) == ([50] if is_found else [])


@pytest.mark.parametrize(("ticks", "is_found"), [(6, True), (5, False)])
def test_few_steps_of_a_quantised_signal_are_no_outlier(ticks: int, *, is_found: bool) -> None:
    values = np.asarray(0.1 * (np.arange(200) // 20))
    values[90] += 0.1 * ticks
    assert find(values) == ([90] if is_found else [])


@pytest.mark.parametrize(("noise", "is_found"), [(1e-5, True), (1e-7, False)])
def test_rounding_hides_no_grain(noise: float, *, is_found: bool) -> None:
    values = np.asarray(0.1 * (np.arange(200) // 20 + 1))
    values[90] += 0.5
    values += noise * (np.arange(200) % 2)
    assert find(values) == ([90] if is_found else [])


@pytest.mark.parametrize(("changes", "is_found"), [(8, True), (7, False)])
def test_a_signal_that_hardly_changes_has_no_outlier(changes: int, *, is_found: bool) -> None:
    values = 0.1 * np.minimum(np.arange(200) // 10, changes)
    values[150] = 90.0
    assert find(values) == ([150] if is_found else [])


@pytest.mark.parametrize(("step_ns", "is_found"), [(250_000_000, True), (251_000_000, False)])
def test_what_can_have_happened_between_two_values_is_no_outlier(
    step_ns: int, *, is_found: bool
) -> None:
    values = make_slow_wave()
    values[100] = 90.0
    assert find(values, step_ns) == ([100] if is_found else [])


@pytest.mark.parametrize(("count", "is_found"), [(30, True), (29, False)])
def test_a_short_signal_has_no_outlier(count: int, *, is_found: bool) -> None:
    values = make_slow_wave(count)
    values[12] = 90.0
    assert find(values) == ([12] if is_found else [])


@pytest.mark.parametrize(
    "values",
    [
        np.zeros(0),
        np.array([1.0]),
        np.full(200, 0.3),
        np.repeat([0.0, 1.0, -0.5, 0.2], 50),
        np.clip(np.cumsum(np.where(np.arange(400) % 90 < 45, 0.1, -0.1)), -1.0, 1.0),
        np.isin(np.arange(200), [80, 81]) * 2.0 + make_slow_wave() * 0.1,
        np.isin(np.arange(200), [80]) * 2.0,
        np.r_[90.0, make_slow_wave(), 90.0],
    ],
    ids=["empty", "one", "still", "steps", "limited", "two_rows", "impulse", "ends"],
)
def test_real_motion_has_no_outliers(values: Values) -> None:
    assert find(values) == []


def test_two_hundred_clean_signals_have_no_outliers() -> None:
    random = np.random.default_rng(20)
    found = []
    for number in range(200):
        count = int(random.integers(10, 1500))
        motion = np.repeat(random.normal(0.0, 1.0, count // 20 + 1), 20)[:count]
        if number % 2:
            motion = np.convolve(motion, np.exp(-np.arange(20) / 5.0) / 5.5)[:count]
        draw = (random.normal, random.laplace, random.uniform)[number % 3]
        noise = draw(-1.0, 1.0, count) * 10.0 ** random.uniform(-4.0, -0.5)
        grain = 10.0 ** random.uniform(-6.0, -0.5)
        found += find(np.round((motion + noise) / grain) * grain)
    assert found == []


@pytest.mark.parametrize("count", [1, 2, 3, 8, 9])
@pytest.mark.parametrize("kind", [np.int64, np.float64])
def test_the_median_is_numpys_to_the_bit(count: int, kind: type) -> None:
    values: NDArray[Any] = (np.random.default_rng(count).normal(size=count) * 1e6).astype(kind)
    assert compute_median(values) == np.median(values)


@pytest.mark.parametrize("values", [[], [math.nan], [1.0, math.nan, 2.0]])
def test_the_median_of_nothing_or_of_nan_is_nan(values: list[float]) -> None:
    assert math.isnan(compute_median(np.array(values)))
