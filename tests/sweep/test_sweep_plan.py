import re
from collections.abc import Sequence
from typing import Any

import pytest

from turtlelog.errors import SweepError
from turtlelog.sweep import Sampling, SweepPlan, build_plan
from turtlelog.sweep.sweep_plan import MOST_DRAWN, MOST_ROWS, parse_key_values


def list_values(text: str) -> list[Any]:
    return list(parse_key_values(text, source="--grid").values)


def list_rows(plan: SweepPlan) -> list[tuple[Any, ...]]:
    return [plan.find_values(row) for row in range(plan.row_count)]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a=1:3", [1, 2, 3]),
        ("a=3:1:-1", [3, 2, 1]),
        ("a = 0.1 : 0.4 : 0.1", [0.1, 0.2, 0.3, 0.4]),
        ("a=1:1", [1]),
        ("a=1e-3:2e-3:5e-4", [0.001, 0.0015, 0.002]),
        ("a=1.0:2", [1.0, 2.0]),
        ("a=1,2,4", [1, 2, 4]),
        ("a=1,2.5,inf", [1, 2.5, float("inf")]),
        ("a=newest,one-per-tick", ["newest", "one-per-tick"]),
        ("a=true,false", [True, False]),
        ("law.kind=own.py:Law,posture", ["own.py:Law", "posture"]),
    ],
)
def test_values_of_a_text(text: str, expected: Sequence[Any]) -> None:
    found = list_values(text)
    assert found == expected
    assert [type(value) for value in found] == [type(value) for value in expected]


def test_every_step_is_the_double_that_one_would_type() -> None:
    found = list_values("a=0.5:12:0.05")
    assert len(found) == 231
    assert all(value == float(f"{value:.2f}") for value in found)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a", "expected KEY=A:B"),
        ("=1:2", "expected KEY=A:B"),
        ("a..b=1:2", "expected KEY=A:B"),
        ("a=", "expected KEY=A:B"),
        ("a=2:1", "a: no value from 2 to 1; did you mean 1:2?"),
        ("a=1:2:-1", "did you mean 1:2:1?"),
        ("a=2:1:0.5", "did you mean 1:2:0.5?"),
        ("a=1:2:-1", "a: no value from 1 to 2"),
        ("a=1:2:0", "a: expected a step other than 0, found 0"),
        ("a=0:1:0.3", "found that they lead to 0.9: 0:0.9:0.3 or 0:1.2:0.3"),
        ("a=1,,2", "a value is missing between commas"),
        ("a=1,newest", "expected numbers, texts or truths alone, found '1,newest'"),
        ("a=1,9223372036854775808", "expected numbers, texts or truths alone"),
    ],
)
def test_text_that_says_nothing_is_refused(text: str, message: str) -> None:
    with pytest.raises(SweepError, match="--grid: ") as caught:
        list_values(text)
    assert message in str(caught.value)


def test_last_key_of_a_grid_is_the_fastest_and_zipped_keys_come_last() -> None:
    plan = build_plan(["a=1:2", "b=x,y"], ["c=1:2", "d=5:6"])
    assert plan.keys == ("a", "b", "c", "d")
    assert list_rows(plan)[:5] == [
        (1, "x", 1, 5),
        (1, "x", 2, 6),
        (1, "y", 1, 5),
        (1, "y", 2, 6),
        (2, "x", 1, 5),
    ]
    assert plan.row_count == 8


def test_kp_is_all_gains_of_the_law_together() -> None:
    plan = build_plan(["kp=1:3", "seed=0:1"]).spread_gains(["law.kp_linear", "law.kp_angular"])
    assert plan.keys == ("seed", "law.kp_linear", "law.kp_angular")
    assert list_rows(plan) == [(seed, kp, kp) for seed in (0, 1) for kp in (1, 2, 3)]


def test_a_sampled_kp_is_one_number_for_all_gains() -> None:
    plan = build_plan(["kp=1.5:3.5"], sampling=Sampling(count=20)).spread_gains(["a", "b"])
    rows = list_rows(plan)
    assert all(first == second for first, second in rows)
    assert len(set(rows)) == 20


@pytest.mark.parametrize(
    ("gains", "zipped", "message"),
    [
        ([], [], "--grid: kp: the law declares no gain"),
        (["a", "b"], ["c=1:2"], "--zip: leave it out beside --grid kp, which varies a and b"),
    ],
)
def test_kp_without_a_gain_or_beside_zip_is_refused(
    gains: list[str], zipped: list[str], message: str
) -> None:
    with pytest.raises(SweepError, match=re.escape(message)):
        build_plan(["kp=1:2"], zipped).spread_gains(gains)


@pytest.mark.parametrize(
    ("grid", "zipped", "message"),
    [
        ([], [], "--grid: name a key to vary, for example --grid law.kp_linear=1:12"),
        (["a=1:2", "a=3:4"], [], "a: expected each key once, found it twice"),
        (["a=1:2"], ["a=3:4"], "a: expected each key once, found it twice"),
        (
            [],
            ["a=1:2", "b=1:3"],
            "--zip: expected as many values of each key, found 2 of a, 3 of b",
        ),
        (["a=1:10000", "b=1:10001"], [], f"expected at most {MOST_ROWS:,} rows"),
        (["a=0:1:1e-99"], [], f"expected at most {MOST_ROWS:,} values"),
    ],
)
def test_plan_without_sense_is_refused(grid: list[str], zipped: list[str], message: str) -> None:
    with pytest.raises(SweepError) as caught:
        build_plan(grid, zipped)
    assert message in str(caught.value)


def test_largest_plan_is_made_at_once() -> None:
    assert build_plan(["a=1:10000", "b=1:10000"]).row_count == MOST_ROWS


def test_sample_draws_numbers_between_and_whole_ones_where_ends_are_whole() -> None:
    plan = build_plan(
        ["a=0.5:2.25", "b=1:3", "c=1.0:2:0.25", "d=x,y"], sampling=Sampling(count=400, seed=7)
    )
    reals, wholes, steps, words = zip(*list_rows(plan), strict=True)
    assert all(0.5 <= value <= 2.25 for value in reals)
    assert len(set(reals)) == 400
    assert (set(wholes), set(words)) == ({1, 2, 3}, {"x", "y"})
    assert set(steps) == {1.0, 1.25, 1.5, 1.75, 2.0}


def test_sample_depends_on_its_seed_alone() -> None:
    def draw(seed: int) -> list[tuple[Any, ...]]:
        return list_rows(build_plan(["a=0.5:2"], sampling=Sampling(count=5, seed=seed)))

    assert draw(1) == draw(1)
    assert draw(1) != draw(2)


def test_latin_sample_has_one_value_in_each_part_of_each_range() -> None:
    plan = build_plan(["a=0.0:10.0", "b=0:9"], sampling=Sampling(count=10, is_latin=True))
    reals, wholes = zip(*list_rows(plan.with_reals({"a"})), strict=True)
    assert sorted(map(int, reals)) == sorted(wholes) == list(range(10))
    assert [int(value) for value in reals] != list(range(10))


@pytest.mark.parametrize(("count", "seed"), [(0, 0), (1, -1), (MOST_DRAWN + 1, 0)])
def test_sample_of_nothing_or_too_much_is_refused(count: int, seed: int) -> None:
    with pytest.raises(SweepError, match=r"expected at (least|most)"):
        build_plan(["a=1:2"], sampling=Sampling(count=count, seed=seed))
