"""The responses that measured ones are laid beside."""

import math
import subprocess
import sys
import time
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray

from turtlelog.errors import TheoryError
from turtlelog.theory import compute_sampled_step_response, compute_step_response

TICK_S = 0.016


def step_by_step(kp: float, count: int, dead_time_ticks: int) -> NDArray[np.float64]:
    y = [0.0]
    for k in range(count - 1):
        answered = k - dead_time_ticks
        y.append(y[k] + (kp * TICK_S * (1.0 - y[answered]) if answered >= 0 else 0.0))
    return np.array(y)


def test_the_ideal_response_is_an_exponential() -> None:
    response = compute_step_response(2.0, [0.0, 0.5, 1.0], initial=3.0, reference=1.0)
    assert response == pytest.approx([3.0, 1.0 + 2.0 / math.e, 1.0 + 2.0 / math.e**2], rel=1e-15)


def test_before_the_step_the_ideal_loop_is_at_rest() -> None:
    assert compute_step_response(4.0, -1.0, initial=2.0, reference=5.0) == 2.0


def test_the_ideal_response_keeps_the_shape_of_its_times() -> None:
    assert compute_step_response(1.0, np.zeros((2, 3))).shape == (2, 3)


def test_the_ideal_response_ends_at_its_reference_however_late() -> None:
    assert compute_step_response(1e100, 1e300, reference=7.0) == 7.0


@pytest.mark.parametrize("dead_time_ticks", [0, 1, 2, 5, 6, 12, 50])
@pytest.mark.parametrize("kp", [0.01, 1.0, 2.0, 4.0, 10.0, 62.5, 100.0])
def test_the_sampled_response_is_the_recursion(kp: float, dead_time_ticks: int) -> None:
    expected = step_by_step(kp, 300, dead_time_ticks)
    response = compute_sampled_step_response(
        kp, 300, period_s=TICK_S, dead_time_ticks=dead_time_ticks
    )
    kept = np.abs(1.0 - response) < 1e9
    assert np.array_equal(kept, np.logical_and.accumulate(np.abs(1.0 - expected) < 1e9))
    assert response[kept] == pytest.approx(expected[kept], rel=1e-11, abs=1e-13)


@given(
    loop_gain=st.floats(1e-6, 3.0),
    dead_time_ticks=st.integers(0, 40),
    count=st.integers(1, 300),
)
def test_the_sampled_response_keeps_its_own_rule(
    loop_gain: float, dead_time_ticks: int, count: int
) -> None:
    y = compute_sampled_step_response(
        loop_gain, count, period_s=1.0, dead_time_ticks=dead_time_ticks
    )
    assert y.shape == (count,)
    assert not y[: dead_time_ticks + 1].any()
    moved = y[dead_time_ticks:-1] + loop_gain * (1.0 - y[: max(count - dead_time_ticks - 1, 0)])
    kept = np.abs(1.0 - y[dead_time_ticks + 1 :]) < 1e9
    scale = np.maximum(1.0, np.maximum.accumulate(np.abs(y))[dead_time_ticks + 1 :])
    error = np.abs(moved - y[dead_time_ticks + 1 :]) / scale
    assert (error[np.logical_and.accumulate(kept)] < 1e-11).all()


def test_the_first_command_moves_the_plant_after_the_dead_time() -> None:
    response = compute_sampled_step_response(
        10.0, 9, period_s=TICK_S, dead_time_ticks=6, initial=2.0, reference=12.0
    )
    assert response == pytest.approx([2.0] * 7 + [3.6, 5.2])


def test_sampling_fast_approaches_the_ideal_loop() -> None:
    time_s = np.arange(100_000) * 1e-5
    sampled = compute_sampled_step_response(4.0, 100_000, period_s=1e-5)
    assert sampled == pytest.approx(compute_step_response(4.0, time_s), abs=1e-5)


def test_an_unstable_response_is_stopped_a_billion_steps_away() -> None:
    response = compute_sampled_step_response(
        20.0, 5000, period_s=TICK_S, dead_time_ticks=6, initial=0.0, reference=2.0
    )
    assert np.isfinite(response).all()
    assert np.abs(response - 2.0).max() == 2e9
    assert (response[-1000:] == response[-1]).all()


@pytest.mark.parametrize("kp", [1e-3, 4.0, 10.0, 20.0])
def test_a_million_samples_take_less_than_a_twentieth_of_a_second(kp: float) -> None:
    def measure_once() -> float:
        begin = time.process_time()
        compute_sampled_step_response(kp, 1_000_000, period_s=TICK_S, dead_time_ticks=6)
        return time.process_time() - begin

    assert min(measure_once() for _ in range(5)) < 0.05


@pytest.mark.parametrize("kp", [0.0, -1.0, math.nan, math.inf, True, "1", None, 1e-200, 1e200])
def test_a_response_needs_a_gain(kp: Any) -> None:
    with pytest.raises(TheoryError, match="kp: expected "):
        compute_step_response(kp, [0.0])
    with pytest.raises(TheoryError, match="kp: expected "):
        compute_sampled_step_response(kp, 1, period_s=TICK_S)


@pytest.mark.parametrize(
    ("changed", "place"),
    [
        ({"count": 0}, "count"),
        ({"count": 2.5}, "count"),
        ({"count": True}, "count"),
        ({"count": 10**12}, "count"),
        ({"period_s": 0.0}, "period_s"),
        ({"period_s": math.nan}, "period_s"),
        ({"dead_time_ticks": -1}, "dead_time_ticks"),
        ({"dead_time_ticks": 1.5}, "dead_time_ticks"),
        ({"dead_time_ticks": 10**9}, "dead_time_ticks"),
        ({"initial": math.inf}, "initial"),
        ({"initial": False}, "initial"),
        ({"reference": math.nan}, "reference"),
        ({"reference": "1"}, "reference"),
    ],
)
def test_a_sampled_response_names_what_it_cannot_use(changed: dict[str, Any], place: str) -> None:
    arguments: dict[str, Any] = {"kp": 1.0, "count": 10, "period_s": TICK_S, **changed}
    with pytest.raises(TheoryError, match=rf"^{place}: expected .*, found "):
        compute_sampled_step_response(**arguments)


@pytest.mark.parametrize("time_s", [[math.nan], [math.inf], ["soon"], [[1.0], [1.0, 2.0]]])
def test_an_ideal_response_needs_times(time_s: Any) -> None:
    with pytest.raises(TheoryError, match="time_s: expected"):
        compute_step_response(1.0, time_s)


def test_responses_cost_neither_control_nor_scipy() -> None:
    code = (
        "import sys, turtlelog.theory; print({'control', 'scipy', 'matplotlib'} & {*sys.modules})"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
