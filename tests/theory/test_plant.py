"""The plant 1/s: its responses, where they end, and whether it is stable."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from turtlelog.errors import TheoryError
from turtlelog.theory import (
    PLANT,
    PLANT_INPUTS,
    FinalValueStatus,
    compute_plant_response,
    find_final_value,
    find_plant_final_value,
    judge_bibo,
)

TIME_S = np.linspace(0.0, 5.0, 101)


@pytest.mark.parametrize(
    ("kind", "expected"), [("impulse", TIME_S**0), ("step", TIME_S), ("ramp", TIME_S**2 / 2.0)]
)
def test_the_plant_integrates_its_input(kind: str, expected: NDArray[np.float64]) -> None:
    assert compute_plant_response(kind, TIME_S) == pytest.approx(expected, abs=1e-12)


def test_the_plant_keeps_an_impulse_and_nothing_else_is_bounded() -> None:
    ends = [find_plant_final_value(kind) for kind in PLANT_INPUTS]
    assert [end.value for end in ends] == [1.0, None, None]
    assert [end.status.value for end in ends] == ["ok", "unbounded", "unbounded"]
    assert "pole at the origin: the theorem does not apply" in ends[1].reason


def test_the_plant_is_not_stable_from_bounded_inputs_to_bounded_outputs() -> None:
    verdict = judge_bibo(*PLANT)
    assert not verdict.stable
    assert "pole at the origin: a bounded step gives an unbounded ramp" in verdict.reason


@pytest.mark.parametrize(
    ("numerator", "denominator", "value", "status"),
    [
        ([4.0], [1.0, 4.0, 0.0], 1.0, FinalValueStatus.OK),
        ([3.0], [1.0, 2.0], 0.0, FinalValueStatus.OK),
        ([2.0, 0.0], [1.0, 4.0, 0.0], 0.0, FinalValueStatus.OK),
        ([0.0], [1.0, -1.0], 0.0, FinalValueStatus.OK),
        ([1.0], [1.0, 0.0, 1.0], None, FinalValueStatus.OSCILLATES),
        ([1.0], [1.0, 0.0, 1.0, 0.0, 0.0], None, FinalValueStatus.UNBOUNDED),
        ([1.0], [1.0, -1.0], None, FinalValueStatus.UNBOUNDED),
    ],
)
def test_the_theorem_is_used_only_where_it_applies(
    numerator: list[float], denominator: list[float], value: float | None, status: FinalValueStatus
) -> None:
    end = find_final_value(numerator, denominator)
    assert (end.value, end.status) == (value, status)


@pytest.mark.parametrize(
    ("numerator", "denominator", "reason"),
    [
        ([1.0], [1.0, 0.0, 1.0], "on the imaginary axis"),
        ([1.0], [1.0, -2.0], "in the right half plane"),
        ([1.0, 0.0, 0.0], [1.0, 1.0], "differentiates"),
    ],
)
def test_the_verdict_says_why_a_system_is_not_stable(
    numerator: list[float], denominator: list[float], reason: str
) -> None:
    verdict = judge_bibo(numerator, denominator)
    assert not verdict.stable
    assert reason in verdict.reason


@pytest.mark.parametrize(
    ("numerator", "denominator"), [([4.0], [1.0, 4.0]), ([1.0, 0.0], [1.0, 0.0])]
)
def test_poles_in_the_left_half_plane_make_it_stable(
    numerator: list[float], denominator: list[float]
) -> None:
    assert judge_bibo(numerator, denominator).stable


@pytest.mark.parametrize("denominator", [[], [0.0], [np.nan], ["s"], [[1.0], [2.0]]])
def test_a_transfer_function_needs_a_denominator(denominator: Any) -> None:
    with pytest.raises(TheoryError, match="transfer function: expected"):
        find_final_value([1.0], denominator)


def test_an_unknown_input_is_refused_with_the_known_ones() -> None:
    with pytest.raises(TheoryError, match="input: expected one of impulse, step, ramp, found 'x'"):
        compute_plant_response("x", TIME_S)


def test_a_coefficient_beyond_every_double_is_refused() -> None:
    with pytest.raises(TheoryError, match=r"^transfer function: expected coefficients, found "):
        judge_bibo([10**400], [1.0])


def test_a_transfer_function_names_the_coefficient_that_is_not_finite() -> None:
    with pytest.raises(TheoryError, match=r"expected finite coefficients, found inf at index 1$"):
        find_final_value([1.0], [1.0, np.inf])


@pytest.mark.parametrize(
    ("time_s", "found"),
    [([0.0], "1, the first 0.0"), ([1.0, 2.0], "2, the first 1.0"), ([], "none")],
)
def test_responses_need_times_from_zero(time_s: list[float], found: str) -> None:
    with pytest.raises(TheoryError, match=f"start at 0 and have at least 2 values, found {found}$"):
        compute_plant_response("step", time_s)


@pytest.mark.parametrize("time_s", [[0.0, 1.0, 1.5], [0.0, -1.0], [0.0, np.nan], [[0.0, 1.0]]])
def test_responses_need_even_times(time_s: list[float]) -> None:
    with pytest.raises(TheoryError, match="time_s: expected"):
        compute_plant_response("step", time_s)
