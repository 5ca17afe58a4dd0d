"""Whether swings die out: both sides of each threshold, and theory's border in simulated loops."""

import math
from collections.abc import Sequence
from itertools import chain
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from turtlelog.measure import step_response
from turtlelog.measure.reductions import find_crossing_rows
from turtlelog.simulate import simulate_many
from turtlelog.theory.sampled_loop import compute_stability_gain

START = [1.0, 1.0, 0.5]


def swing(peaks: Sequence[float], *, start: Sequence[float] = START) -> np.ndarray[Any, Any]:
    """Return an error that comes from a step and swings to each peak, to either side in turn."""
    signs = [-((-1.0) ** number) for number in range(len(peaks))]
    rows = [
        sign * share for sign, peak in zip(signs, peaks, strict=True) for share in (peak / 2, peak)
    ]
    # The last swing is not whole: it does not count.
    return np.array([*start, *rows, -signs[-1] * 1e-3 if peaks else 1e-3])


def judge(
    peaks: Sequence[float],
    *,
    clipped: int = step_response.NEVER,
    start: Sequence[float] = START,
    most: float = math.inf,
) -> str:
    return judge_errors(swing(peaks, start=start).tolist(), clipped, most)


def decay(share: float, count: int = 9, first: float = 0.5) -> list[float]:
    """Return peaks whose thirds fall by a share from one to the next."""
    return [first * share ** (number / (count // 3)) for number in range(count)]


@pytest.mark.parametrize("count", [6, 9, 30])
def test_swings_die_out_below_90_percent_and_go_on_from_98(count: int) -> None:
    assert judge(decay(0.89, count)) == "rests"
    assert judge(decay(0.91, count)) == "unknown"
    assert judge(decay(0.975, count)) == "unknown"
    assert judge(decay(0.985, count)) == "swings"
    assert judge(decay(1.1, count, first=0.4)) == "swings"


def test_small_swings_go_on_only_where_they_meet_the_limit() -> None:
    small, large = [0.09] * 9, [0.11] * 9
    assert judge(large) == "swings"
    assert judge(small) == "rests"
    assert judge(small, clipped=step_response.NOBODY_KNOWS) == "unknown"
    # Whole swings begin in rows 3, 5, 7 ...; the third before the last with the fourth, in row 9.
    assert judge(small, clipped=9) == "swings"
    assert judge(small, clipped=8) == "rests"
    assert judge([0.01] * 6 + [0.0111] * 3) == "rests"
    assert judge([0.01] * 6 + [0.0112] * 3) == "rests"  # it did not grow before
    assert judge([0.009] * 3 + [0.01] * 3 + [0.0111] * 3) == "rests"
    assert judge([0.009] * 3 + [0.01] * 3 + [0.0112] * 3) == "unknown"


def test_swings_that_do_not_begin_with_their_largest_do_not_decay() -> None:
    falling, rising = [0.5] * 3 + [0.4, 0.4, 0.4, 0.3, 0.3, 0.3], [0.5] * 3 + [0.3, 0.3, 0.4] * 2
    rising[6:] = [0.2, 0.2, 0.3]
    assert judge(falling) == "rests"
    assert judge(rising) == "unknown"
    assert judge([0.5] * 3 + [0.4, 0.3, 0.42] + [0.3, 0.2, 0.31]) == "rests"  # 95 % of it


def test_few_swings_die_out_where_they_halve() -> None:
    assert judge([0.5, 0.4, 0.24]) == "rests"
    assert judge([0.5, 0.4, 0.26]) == "unknown"
    assert judge([0.2, 0.2, 0.22]) == "swings"
    assert judge([0.2, 0.2, 0.205]) == "unknown"


def test_nothing_decays_that_swings_further_than_it_began() -> None:
    assert judge(decay(0.5, first=1.19)) == "rests"
    assert judge(decay(0.5, first=1.21)) == "unknown"
    assert judge(decay(0.5), most=0.9) == "unknown"


@pytest.mark.parametrize(
    ("error", "verdict"),
    [
        ([1.0, 0.5, 0.25, 0.12, 0.019], "rests"),
        ([1.0, 0.5, 0.25, 0.12, 0.021], "slow"),
        ([1.0, 0.74, 0.5, 0.26, 0.0], "passing"),
        ([1.0, 0.6, 0.21, 0.0], "passing"),
        ([1.0, 0.6, 0.19, 0.0], "rests"),
        ([1.0, 0.5, -0.1, -0.15, -0.01], "rests"),
        ([1.0, 1.1, 1.2], "away"),
        ([1.0, 1.2, 1.1], "slow"),
        ([1.0, 1.0, 1.0], "slow"),
    ],
)
def test_less_than_two_swings_rest_where_they_slow_down(error: list[float], verdict: str) -> None:
    assert judge_errors(error) == verdict


def last(durations: Sequence[int], peak: float = 0.5) -> list[float]:
    """Return errors that swing with one peak, each swing for a number of rows."""
    sides = [[(-1.0) ** (number + 1) * peak] * rows for number, rows in enumerate(durations)]
    return [*START, *chain.from_iterable(sides), 1e-3 * (-1.0) ** (len(durations) + 1)]


@pytest.mark.parametrize(("shorter", "verdict"), [(80, "swings"), (79, "irregular")])
def test_swings_of_a_loop_last_about_equally_long(shorter: int, verdict: str) -> None:
    # Each swing is compared with the next to its side.
    assert judge_errors(last([shorter, 500, 100, 400] * 3)) == verdict
    assert judge_errors(last([shorter, shorter, 100, 100] * 3), most=0.9) == "swings"  # it turned
    assert judge_errors([*last([shorter], 0.3)[:-1], *[0.4] * 100, -1e-3]) == verdict
    assert judge_errors(last([50, 100] * 6)) == "swings"


KICKS = {
    "disturbances": {"disturbance.noise_speed": 0.3},
    "at goal": {"disturbance.noise_speed": 0.3, "goal.x_m": 5.6, "goal.y_m": 5.6},
    "noise": {"sensing.noise_position_m": 0.1},
    "outliers": {
        "sensing.outlier_probability": 0.05,
        "sensing.outlier_m": 2.0,
        "sensing.outlier_rad": 3.0,
    },
}


def judge_loops(changes: Sequence[dict[str, float]]) -> list[float | None]:
    """Return `stable` of both loops of the textbook's run after each set of changes."""
    base, names = tl.load_scenario("textbook"), ["rotate.stable", "translate.stable"]
    scenarios = [tl.override_scenario(base, dict(one)) for one in changes]
    runs = [run for run in simulate_many(scenarios) if isinstance(run, tl.Run)]
    assert len(runs) == len(scenarios)
    return [one.value for run in runs for one in tl.measure_run(run, only=names).values()]


@pytest.mark.parametrize("kicks", KICKS.values(), ids=KICKS)
def test_random_kicks_are_no_oscillation_of_a_stable_loop(kicks: dict[str, float]) -> None:
    stable = [{"law.kp_linear": 2.0, "law.kp_angular": 2.0, "seed": n, **kicks} for n in range(4)]
    assert 0.0 not in judge_loops(stable)


def test_an_unstable_loop_oscillates_also_with_noise() -> None:
    noise = {"sensing.noise_position_m": 0.002, "loop.transport_delay_ticks": 6}
    found = judge_loops([{"seed": n, "law.kp_linear": 20.0, **noise} for n in range(4)])[1::2]
    assert found == [0.0] * 4


RATIOS = (0.2, 0.6, 0.9, 0.97, 0.99, 1.01, 1.03, 1.1, 1.5)


@pytest.mark.thorough
@pytest.mark.parametrize(("loop", "other"), [("rotate", "translate"), ("translate", "rotate")])
@pytest.mark.parametrize("limit", [1.0, math.inf])
def test_the_border_of_stability_is_theorys(loop: str, other: str, limit: float) -> None:
    gains = {"rotate": "law.kp_angular", "translate": "law.kp_linear"}
    base = tl.load_scenario("textbook")
    cases, scenarios = [], []
    for delay in (0, 1, 3, 6, 10):
        border = compute_stability_gain(0.016, delay)
        for ratio in RATIOS:
            changes = {
                gains[loop]: ratio * border,
                gains[other]: 0.3 * border,
                "loop.transport_delay_ticks": delay,
                "limits.speed_m_s": limit,
                "limits.turn_rate_rad_s": limit,
            }
            cases.append(ratio)
            scenarios.append(tl.scenario.override_scenario(base, changes, source="test"))
    found = []
    for ratio, run in zip(cases, simulate_many(scenarios), strict=True):
        assert isinstance(run, tl.Run)
        metric = tl.measure_run(run, only=[f"{loop}.stable"])[f"{loop}.stable"]
        assert metric.value in {None, float(ratio < 1.0)}, ratio
        found.append(metric.value)
    # A turn may end as it passes the tolerance, or wrap because nothing limits it.
    assert found.count(None) <= (0 if loop == "translate" else 14)


def test_a_limit_cycle_may_stay_within_the_settling_band() -> None:
    changes = {
        "law.kp_linear": 15.5,
        "law.kp_angular": 4.0,
        "loop.transport_delay_ticks": 6,
    }
    run = tl.simulate_run(
        tl.scenario.override_scenario(tl.load_scenario("textbook"), changes, source="test")
    )
    metrics = tl.measure_run(run, only=["translate.stable", "translate.settling_time"])
    assert metrics["translate.settling_time"].status == "ok"
    assert metrics["translate.stable"].value == 0.0


def test_noise_leaves_a_loop_stable() -> None:
    scenarios = [
        tl.scenario.override_scenario(
            tl.load_scenario("textbook"),
            {"law.kp_linear": gain, "sensing.noise_position_m": 0.001, "seed": seed},
            source="test",
        )
        for gain in (5.0, 10.0, 20.0)
        for seed in range(8)
    ]
    found = [
        tl.measure_run(run, only=["translate.stable"])["translate.stable"].value
        for run in simulate_many(scenarios)
        if isinstance(run, tl.Run)
    ]
    assert set(found) <= {1.0, None}
    assert found.count(1.0) >= 20


def hover(size: float, center: float = 0.3, swings_over: int = 6) -> list[float]:
    """Return errors that swing about another value than 0."""
    return [center + side * size for _ in range(swings_over) for side in (1.0, -1.0)]


def test_what_swings_about_another_value_than_its_reference_does_not_rest() -> None:
    # It ends in a trough near its reference, as a loop does whose line has turned away from it.
    assert judge_errors([1.0, 0.5, -0.2, -0.1, *hover(0.15, 0.16)]) == "unknown"
    assert judge_errors([1.0, 0.5, *hover(0.15, 0.16), 0.012, 0.011]) == "unknown"
    assert (
        judge_errors([1.0, 0.6, -0.5, -0.4, 0.2, 0.1, -0.09, 0.05, 0.01, 0.04, 0.01]) == "unknown"
    )


def test_an_error_may_grow_again_by_2_percent_behind_its_last_crossing() -> None:
    assert judge_errors([1.0, 0.5, -0.2, -0.1, 0.05, 0.0, 0.019, 0.018]) == "rests"
    assert judge_errors([1.0, 0.5, -0.2, -0.1, 0.05, 0.0, 0.021, 0.018]) == "unknown"


def test_the_swing_that_the_end_cuts_is_no_larger_than_the_last_whole_ones() -> None:
    assert judge_errors([1.0, 0.5, -0.5, -0.4, 0.2, 0.1, -0.19]) == "rests"
    assert judge_errors([1.0, 0.5, -0.5, -0.4, 0.2, 0.1, -0.21]) == "unknown"
    assert judge_errors([1.0, 0.5, -0.02, -0.015, 0.005, 0.004, -0.019]) == "rests"


def judge_errors(error: list[float], clipped: int = -1, most: float = math.inf) -> str:
    values = np.array(error)
    rows = find_crossing_rows(values, 0.0, None)
    return step_response.VERDICTS[step_response.judge_swings(values, rows, clipped, most)]
