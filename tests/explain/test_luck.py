from dataclasses import replace

import numpy as np
import pytest

from tests.draw.rerun.rrds import make_foreign_run
from tests.known import known
from tests.lucky_runs import (
    METRIC,
    NEAR_HALF_A_TURN,
    NOISY,
    attribute_lucky,
    measure_lucky,
    simulate_lucky,
)
from turtlelog.errors import ExplainError
from turtlelog.explain import Luck, measure_luck, simulate_without
from turtlelog.explain.game import SEEDS, turn_start
from turtlelog.measure import measure_run
from turtlelog.scenario import get_preset
from turtlelog.simulate import simulate_run

KP10 = get_preset("paper-kp10")


@pytest.fixture(scope="module")
def kp10() -> Luck:
    return measure_lucky("paper-kp10")


@pytest.mark.thorough
def test_every_fourth_start_is_one_of_the_range_that_explain_prints(kp10: Luck) -> None:
    starts = known(attribute_lucky("paper-kp10").starts)
    assert len(kp10.starts_rad) == 65
    assert kp10.starts_rad[-1] == -kp10.starts_rad[0] == starts.within_rad
    whole, rest = kp10.curves[0].values[::4], kp10.curves[-1].values[::4]
    assert (whole.min(), whole.max()) == (starts.low, starts.high)
    assert (rest.min(), rest.max()) == starts.without_all
    assert starts.is_wide == (kp10.dependence == "wide")


def test_the_curves_are_with_all_without_each_and_without_all(kp10: Luck) -> None:
    without = [curve.without for curve in kp10.curves]
    assert without == [(), ("queue",), ("pause",), ("queue", "pause")]
    assert kp10.acting == ("queue", "pause")
    found = attribute_lucky("paper-kp10")
    assert [curve.values[32] for curve in kp10.curves] == [
        found.resimulated,
        *(one.alone for one in found.contributions if one.cause in kp10.acting),
        found.without_all,
    ]


@pytest.mark.parametrize("row", [0, 20, 64])
def test_a_start_is_the_scenario_turned_and_simulated_again(kp10: Luck, row: int) -> None:
    turned = turn_start(KP10, float(kp10.starts_rad[row]))
    assert turned.start.heading_rad == KP10.start.heading_rad + kp10.starts_rad[row]
    for curve in kp10.curves:
        run = simulate_without(turned, curve.without)
        assert curve.values[row] == measure_run(run, only=[METRIC])[METRIC].value
        assert curve.ends_xy_m[row].tolist() == run.poses.xy_m[-1].tolist()


def test_the_error_is_how_far_the_ends_are_from_the_goal(kp10: Luck) -> None:
    for curve in kp10.curves:
        misses_m = np.hypot(*(curve.ends_xy_m - known(kp10.goal_xy_m)).T)
        np.testing.assert_allclose(misses_m, curve.values, rtol=1e-12)


@pytest.mark.everyday(
    "paper-kp10-final.position_error-wide", "paper-kp4-final.position_error-steady"
)
@pytest.mark.parametrize(
    ("preset", "metric", "dependence"),
    [
        ("paper-kp1", METRIC, "steady"),
        ("paper-kp2", METRIC, "steady"),
        ("paper-kp4", METRIC, "steady"),
        ("paper-kp10", METRIC, "wide"),
        ("paper-kp2", "rotate.rms_error", "follows"),
        ("paper-kp10", "rotate.settling_time", "wide"),
    ],
)
def test_only_what_ranges_as_the_effects_do_depends_on_samples(
    preset: str, metric: str, dependence: str
) -> None:
    """Take two to three seconds: a run is explained, and 65 starts of it are simulated."""
    assert measure_lucky(preset, (), metric).dependence == dependence


@pytest.mark.thorough
def test_a_start_without_a_value_has_the_reason() -> None:
    """Take two to three seconds: a run is explained, and 65 starts of it are simulated."""
    whole, *_, rest = measure_lucky("paper-kp10", (), "rotate.settling_time").curves
    is_missing = np.isnan(whole.values)
    assert 0 < is_missing.sum() < 65
    assert [bool(reason) for reason in whole.reasons] == is_missing.tolist()
    assert not np.isnan(rest.values).any()
    assert np.isfinite(whole.ends_xy_m).all()


@pytest.mark.thorough
def test_an_effect_that_acts_from_other_starts_alone_has_a_curve() -> None:
    """Take two to three seconds: a run is explained, and 65 starts of it are simulated."""
    assert attribute_lucky("paper-kp10", NEAR_HALF_A_TURN).acting == ("queue", "pause")
    luck = measure_lucky("paper-kp10", NEAR_HALF_A_TURN)
    assert luck.acting == ("queue", "pause", "wrap")
    whole, alone = luck.curves[0].values, luck.curves[3].values
    assert whole[32] == alone[32]
    assert 0 < (whole != alone).sum() < 33


def test_of_a_random_effect_the_seeds_are_varied() -> None:
    """Take two seconds: 32 seeds of each combination are simulated."""
    luck = measure_lucky("textbook", NOISY)
    assert (luck.varied, luck.seeds, len(luck.starts_rad)) == ("seed", SEEDS, 0)
    whole, without = luck.curves
    assert len(whole.values) == len(without.values) == 32
    assert np.mean(whole.values) == pytest.approx(
        known(attribute_lucky("textbook", NOISY).seeds).mean
    )
    assert np.ptp(without.values) == 0.0 < np.ptp(whole.values)


@pytest.mark.thorough
def test_without_effects_there_is_one_curve() -> None:
    """Take two to three seconds: a run is explained, and 65 starts of it are simulated."""
    luck = measure_lucky("textbook")
    assert [curve.without for curve in luck.curves] == [()]
    assert (luck.acting, luck.dependence) == ((), "steady")


def test_what_cannot_be_varied_is_refused_with_the_reason() -> None:
    run, found = simulate_lucky("paper-kp10"), attribute_lucky("paper-kp10")
    with pytest.raises(ExplainError, match=r"^nothing reproduces it$"):
        measure_luck(run, found=replace(found, withheld="nothing reproduces it"))
    with pytest.raises(ExplainError, match="no scenario stands for it: "):
        measure_luck(make_foreign_run(50))


def test_a_robot_that_does_not_turn_has_no_other_starts() -> None:
    ahead = replace(KP10, goal=replace(KP10.goal, x_m=8.0, y_m=KP10.start.y_m))
    run = simulate_run(ahead)
    assert not run.samples.turn_rate_rad_s.any()
    with pytest.raises(ExplainError, match="the robot does not turn"):
        measure_luck(run)


def test_a_metric_without_any_value_is_refused() -> None:
    run = simulate_lucky("paper-kp10", (("max_duration_s", 1.0),))
    with pytest.raises(ExplainError, match=r"^rotate\.settling_time has no value: "):
        measure_luck(run, metric="rotate.settling_time")
