import math
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from turtlelog.errors import LibraryError, TheoryError
from turtlelog.theory import (
    compute_closed_loop_response,
    compute_exact_settling_time,
    compute_plant_response,
    compute_root_locus,
    compute_saturated_settling_time,
    compute_settling_time,
    compute_step_response,
    compute_time_constant,
)


@pytest.mark.parametrize(("kp", "tau_s"), [(1.0, 1.0), (2.0, 0.5), (4.0, 0.25), (10.0, 0.1)])
def test_the_ideal_loop_has_the_time_constants_of_table_1(kp: float, tau_s: float) -> None:
    assert compute_time_constant(kp) == tau_s
    assert compute_settling_time(kp) == 4.0 * tau_s
    assert compute_exact_settling_time(kp) == pytest.approx(3.912023005428146 * tau_s)


@pytest.mark.parametrize("kp", [0.0, -1.0, math.nan])
def test_a_gain_that_is_not_positive_has_no_time_constant(kp: float) -> None:
    with pytest.raises(TheoryError, match="kp: expected a gain > 0, found"):
        compute_time_constant(kp)


@pytest.mark.parametrize("kp", [1.0, 2.0, 4.0, 10.0])
def test_python_controls_step_response_is_the_exponential(kp: float) -> None:
    time_s = np.linspace(0.0, 5.0, 101)
    expected = compute_step_response(kp, time_s)
    assert compute_closed_loop_response(kp, time_s) == pytest.approx(expected, abs=1e-12)


def test_the_root_locus_leads_from_the_origin_to_the_left() -> None:
    gains = np.linspace(0.0, 10.0, 11)
    assert compute_root_locus(gains) == pytest.approx(-gains + 0j)


@pytest.mark.parametrize(
    ("kp", "expected"),
    [
        ([], r"a list of gains, found an array of shape \(0,\)"),
        ([[1.0]], r"a list of gains, found an array of shape \(1, 1\)"),
        ([1.0, -1.0], r"gains from 0 to 1e\+100, found -1.0 at index 1$"),
        ([math.nan], r"gains from 0 to 1e\+100, found nan at index 0$"),
        (["a"], "an array of gains, found "),
    ],
)
def test_a_root_locus_needs_gains(kp: Any, expected: str) -> None:
    with pytest.raises(TheoryError, match=f"^kp: expected {expected}"):
        compute_root_locus(kp)


@pytest.mark.parametrize("kp", [0.1, 0.5, 1.0, 4.0, 10.0, 100.0])
@pytest.mark.parametrize("step", [0.3, 2.2428, 5.693])
def test_the_saturated_loop_settles_as_a_fine_simulation_does(kp: float, step: float) -> None:
    error, time_s, tick_s = step, 0.0, 1e-4
    while error > 0.02 * step:
        error -= min(kp * error, 1.0) * tick_s
        time_s += tick_s
    assert compute_saturated_settling_time(kp, step=step, limit=1.0) == pytest.approx(
        time_s, rel=1e-3
    )


@pytest.mark.parametrize("changed", [{"step": 0.0}, {"limit": -1.0}, {"step": math.nan}])
def test_the_saturated_loop_needs_a_step_and_a_limit(changed: dict[str, float]) -> None:
    with pytest.raises(TheoryError, match="expected a number > 0"):
        compute_saturated_settling_time(1.0, **{"step": 1.0, "limit": 1.0, **changed})


@pytest.mark.parametrize(
    "compute",
    [
        lambda: compute_closed_loop_response(1.0, [0.0, 1.0]),
        lambda: compute_plant_response("ramp", [0.0, 1.0]),
    ],
    ids=["step", "plant"],
)
def test_without_python_control_one_line_says_what_to_install(
    compute: Callable[[], object], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(LibraryError, match=r"control: needed .* `pip install control`"):
        compute()
