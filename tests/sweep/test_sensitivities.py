from pathlib import Path

import numpy as np
import pytest
from scipy.stats import spearmanr

from tests.sweep.swept_tables import write_table
from turtlelog.sweep import (
    Sampling,
    SweptResults,
    build_plan,
    find_sensitivities,
    read_swept_results,
)

KP, DELAY, GOAL = "law.kp_linear", "loop.transport_delay_ticks", "goal.x_m"


def sample(path: Path, count: int, compute: object) -> SweptResults:
    plan = build_plan([f"{KP}=1.0:9.0", f"{GOAL}=1.0:9.0"], (), Sampling(count=count, seed=3))
    return read_swept_results(write_table(path, plan, {"run.duration": compute}))  # type: ignore[dict-item]


def test_a_grid_has_the_range_along_each_key_through_where_the_others_are_held(
    tmp_path: Path,
) -> None:
    # The base has no delay; of the gains 4, 6 and 8 the middle is held.
    path = write_table(
        tmp_path / "t.parquet",
        [f"{KP}=4,6,8", f"{DELAY}=0:2"],
        {"run.duration": lambda kp, delay: kp * (1 + delay)},
    )
    results = read_swept_results(path)
    found = find_sensitivities(results, results.metrics[0])
    assert [one.axis.keys for one in found.keys] == [(DELAY,), (KP,)]
    first, second = found.keys
    assert (first.least, first.most, first.others) == (6.0, 18.0, (8.0, 16.0))
    assert (second.least, second.most, second.others) == (4.0, 8.0, (4.0, 12.0))
    assert (found.center, second.least_place, second.most_place) == (6.0, 0, 2)
    held = {axis: len(axis) - 1 for axis in results.axes}
    assert [one.size for one in find_sensitivities(results, results.metrics[0], held).keys] == [
        16,
        12,
    ]


def test_values_that_are_missing_are_left_out_and_said(tmp_path: Path) -> None:
    path = write_table(
        tmp_path / "t.parquet",
        [f"{KP}=1:4"],
        {"run.duration": lambda kp: kp if kp < 4 else "too_short"},
    )
    results = read_swept_results(path)
    found = find_sensitivities(results, results.metrics[0])
    assert (found.keys[0].size, found.keys[0].left_out) == (2.0, 1)
    assert found.notes == (f"run.duration: 1 of 4 values of {KP} have no value and are left out",)


def test_a_sample_has_spearmans_correlation(tmp_path: Path) -> None:
    results = sample(tmp_path / "t.parquet", 50, lambda kp, goal: kp**3 - 2.0 * round(goal))
    found = find_sensitivities(results, results.metrics[0])
    for one in found.keys:
        expected = spearmanr(one.axis.numbers[one.axis.places], results.metrics[0].values)
        assert one.correlation == pytest.approx(expected.statistic)
    assert found.keys[0].axis.keys == (KP,)
    assert found.chance == pytest.approx(1.96 / 7.0, rel=1e-4)


def test_what_keys_explain_together_falls_with_interaction(tmp_path: Path) -> None:
    alone = sample(tmp_path / "a.parquet", 60, lambda kp, goal: 2.0 * kp + goal)
    mixed = sample(tmp_path / "b.parquet", 60, lambda kp, goal: (kp - 5.0) * (goal - 5.0))
    shares = [find_sensitivities(one, one.metrics[0]).explained for one in (alone, mixed)]
    assert shares[0] is not None
    assert shares[1] is not None
    assert shares[0] > 0.95
    assert shares[1] < 0.2


@pytest.mark.parametrize(("count", "has_values"), [(9, False), (10, True)])
def test_few_rows_have_no_correlation(*, count: int, has_values: bool, tmp_path: Path) -> None:
    results = sample(tmp_path / "t.parquet", count, lambda kp, goal: kp + goal)
    found = find_sensitivities(results, results.metrics[0])
    assert bool(found.keys) is has_values
    assert (found.notes == ()) is has_values


@pytest.mark.thorough
def test_grey_holds_95_percent_of_keys_without_influence() -> None:
    generator = np.random.default_rng(5)
    drawn = [spearmanr(*generator.random((2, 30))).statistic for _ in range(2000)]
    share = np.mean(np.abs(drawn) <= 1.959964 / np.sqrt(29.0))
    assert 0.935 < share < 0.965
