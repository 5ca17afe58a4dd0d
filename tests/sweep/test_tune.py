"""The best values: held against dense grids, their neighbourhood against the thresholds."""

import json
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

import turtlelog as tl
from turtlelog.sweep import tune, tune_candidates, tune_search
from turtlelog.sweep.batch import measure_rows
from turtlelog.sweep.tune_search import explore_best, explore_neighbourhood

PROBLEMS: list[tuple[str, dict[str, Any], dict[str, tuple[float, float]], str, list[str], bool]] = [
    (
        "textbook",
        {},
        {"law.kp_linear": (0.5, 12.0)},
        "translate.settling_time",
        ["translate.overshoot <= 1"],
        False,
    ),
    (
        "textbook",
        {"loop.transport_delay_ticks": 6},
        {"law.kp_linear": (0.5, 20.0)},
        "translate.steady_state_error * translate.steady_state_error + translate.settling_time",
        ["translate.stable == 1"],
        False,
    ),
    ("paper-kp4", {}, {"law.kp_linear": (0.5, 12.0)}, "final.position_error", [], False),
    (
        "textbook",
        {"loop.transport_delay_ticks": 3},
        {"law.kp_linear": (0.5, 12.0), "law.kp_angular": (0.5, 12.0)},
        "run.duration",
        ["rotate.overshoot <= 0.5"],
        False,
    ),
    (
        "textbook",
        {},
        {"loop.transport_delay_ticks": (0, 20)},
        "translate.largest_error - loop.transport_delay_ticks / 100",
        ["translate.stable == 1 or loop.transport_delay_ticks < 3"],
        False,
    ),
    (
        "textbook",
        {"sensing.noise_position_m": 0.002},
        {"law.kp_linear": (0.5, 12.0)},
        "translate.rise_time",
        [],
        True,
    ),
]


def prepare(
    preset: str, changes: dict[str, Any], bounds: dict[str, tuple[float, float]], goal: Any
) -> tuple[tune_candidates.Candidates, tuple[tune_candidates.SearchedKey, ...]]:
    base = tl.scenario.override_scenario(tl.load_scenario(preset), changes, source="test")
    texts = [f"{key}={low}:{high}" for key, (low, high) in bounds.items()]
    known = tl.scenario.flatten_scenario(tl.scenario.resolve_scenario(base))
    keys = tune.parse_searched_keys(texts, known)
    return tune_candidates.Candidates(base, [key.key for key in keys], goal, jobs=1), keys


@pytest.mark.parametrize("problem", PROBLEMS, ids=lambda one: f"{one[0]}-{one[3][:30]}")
def test_the_best_is_never_worse_than_that_of_a_dense_grid(problem: Any) -> None:
    preset, changes, bounds, objective, constraints, is_maximised = problem
    goal = tune_candidates.parse_goal(objective, constraints, is_maximised=is_maximised)
    candidates, keys = prepare(preset, changes, bounds, goal)
    most = 150 * len(keys)
    found = tune_search.search_best(candidates, keys, evaluations=most)
    assert found.best.is_feasible
    assert found.evaluations <= 1.2 * most
    side = 60 if len(keys) == 1 else 14
    grid = [
        tuple(
            key.round(key.low + share * (key.high - key.low))
            for key, share in zip(keys, shares, strict=True)
        )
        for shares in _list_shares(side, len(keys))
    ]
    dense, _ = prepare(preset, changes, bounds, goal)
    dense.evaluate(grid)
    best = tune_search.find_best(dense)
    assert best.objective is not None
    assert found.best.objective is not None
    sign = -1.0 if is_maximised else 1.0
    # A landscape of single samples has needles that no search need hit: 2 % of the best.
    assert sign * found.best.objective <= sign * best.objective + 0.02 * abs(best.objective) + 1e-9


def _list_shares(side: int, count: int) -> list[tuple[float, ...]]:
    steps = [step / (side - 1) for step in range(side)]
    return [(one,) for one in steps] if count == 1 else [(a, b) for a in steps for b in steps]


GOAL = tune_candidates.parse_goal("translate.settling_time", ["translate.overshoot <= 1"])
BOUNDS = {"law.kp_linear": (0.5, 12.0)}


def test_rows_are_those_of_single_runs() -> None:
    candidates, _ = prepare("textbook", {}, BOUNDS, GOAL)
    points = [(1.0,), (3.5,), (12.0,)]
    alone = measure_rows(
        tl.load_scenario("textbook"),
        {"law.kp_linear": [1.0, 3.5, 12.0]},
        ["translate.settling_time"],
        threads=1,
    )
    assert [one.objective for one in candidates.evaluate(points)] == alone.values[
        "translate.settling_time"
    ].tolist()
    assert candidates.evaluations == 3
    candidates.evaluate(points)
    assert candidates.evaluations == 3  # nothing is simulated twice


@pytest.mark.thorough
def test_the_same_seed_gives_the_same_and_processes_change_nothing() -> None:
    found = []
    for jobs in (1, 2):
        base = tl.load_scenario("posture")
        goal = tune_candidates.parse_goal("run.duration")
        candidates = tune_candidates.Candidates(base, ["law.k"], goal, jobs=jobs)
        known = tl.scenario.flatten_scenario(tl.scenario.resolve_scenario(base))
        keys = tune.parse_searched_keys(["law.k=0.5:6"], known)
        found.append(tune_search.search_best(candidates, keys, evaluations=24, seed=3))
    assert found[0] == found[1]


def test_the_neighbourhood_ends_where_the_best_is_a_tenth_worse() -> None:
    candidates, keys = prepare("textbook", {}, BOUNDS, GOAL)
    best = tune_search.search_best(candidates, keys, evaluations=60).best
    found = explore_neighbourhood(candidates, keys, best)
    (around,) = found.ranges
    assert best.objective is not None
    assert found.slack == pytest.approx(0.1 * best.objective)
    assert around.low_end == "objective"
    assert (around.high, around.high_end) == (12.0, "bound")
    slack = 0.1 * best.objective
    inside, outside = candidates.evaluate([(around.low,), (around.low - 0.05,)])
    assert inside.objective is not None
    assert inside.objective <= best.objective + slack
    assert outside.objective is None or outside.objective > best.objective + slack


def test_the_neighbourhood_ends_where_a_constraint_breaks() -> None:
    goal = tune_candidates.parse_goal("translate.settling_time", ["law.kp_linear <= 5"])
    candidates, keys = prepare("textbook", {}, BOUNDS, goal)
    best = tune_search.search_best(candidates, keys, evaluations=100).best
    (around,) = explore_neighbourhood(candidates, keys, best).ranges
    assert around.high == pytest.approx(5.0, abs=0.01)
    assert around.high <= 5.0
    assert (around.high_end, around.high_constraint) == ("constraint", "law.kp_linear <= 5")


@pytest.mark.parametrize(("top", "low"), [(3.2, 3.2), (3.04, 1.0)])
def test_the_range_ends_at_a_bad_place_inside_that_its_scan_sees(top: float, low: float) -> None:
    """Steps of 5/32 from 6 to 1 try 3.1875, not 3.03125; those of the walk try 3.19 as well."""
    goal = tune_candidates.parse_goal(
        "0 * run.duration + 1", [f"law.kp_linear <= 3.035 or law.kp_linear >= {top}"]
    )
    candidates, keys = prepare("textbook", {}, {"law.kp_linear": (1.0, 6.0)}, goal)
    (best,) = candidates.evaluate([(6.0,)])
    (around,) = explore_neighbourhood(candidates, keys, best).ranges
    assert around.low == pytest.approx(low, abs=0.01)
    assert around.low >= low
    assert around.largest_step <= 5.0 / 32.0
    tried = [one for one in candidates.list_known() if one.point[0] >= around.low]
    assert all(one.is_feasible for one in tried)


@pytest.mark.parametrize(("high", "jumps"), [("1.8002", True), ("1.7998", False)])
def test_a_jump_is_a_change_within_a_thousandth_of_the_range(*, high: str, jumps: bool) -> None:
    """Steps are 1/1001 or 1/999 of the range. Between gains of 1.676 and 1.680 the robot begins to
    miss its goal at the first pass, and drives 4 s longer."""
    base = tl.load_scenario("lagged")
    goal = tune_candidates.parse_goal("run.duration", ["final.position_error <= 0.01"])
    keys = tune.parse_searched_keys([f"kp=1.6:{high}:0.0002"], tl.scenario.flatten_scenario(base))
    candidates = tune_candidates.Candidates(base, ["kp"], goal, jobs=1)
    (best,) = candidates.evaluate([(keys[0].round(1.7467),)])
    found = explore_neighbourhood(candidates, keys, best)
    assert (found.jump is not None) is jumps
    if found.jump is not None:
        assert found.jump.change > 4.0
        assert found.jump.high - found.jump.low == pytest.approx(0.0002)


def test_a_smooth_objective_has_no_jump_and_a_single_key_its_largest_step() -> None:
    candidates, keys = prepare("textbook", {}, BOUNDS, GOAL)
    found, around = explore_best(
        candidates, keys, tune_search.search_best(candidates, keys, evaluations=60)
    )
    assert around.jump is None
    tried = sorted(one.point[0] for one in candidates.list_known())
    assert found.largest_step == max(high - low for low, high in pairwise(tried))


@pytest.mark.parametrize(
    ("text", "values", "value", "margin", "holds"),
    [
        ("rotate.overshoot <= 2", {"rotate.overshoot": 1.5}, 1.5, 0.5, True),
        ("rotate.overshoot <= 2", {"rotate.overshoot": 2.5}, 2.5, -0.5, False),
        ("rotate.overshoot <= 2", {"rotate.overshoot": None}, None, -math.inf, False),
        ("1 < rotate.overshoot <= 2", {"rotate.overshoot": 1.25}, 1.0, 0.25, True),
        ("rotate.overshoot == 2", {"rotate.overshoot": 1.5}, 1.5, -0.5, False),
        ("not rotate.overshoot > 2", {"rotate.overshoot": 1.5}, None, 0.5, True),
        (
            "rotate.overshoot < 1 or rotate.overshoot > 3",
            {"rotate.overshoot": 2.5},
            None,
            -0.5,
            False,
        ),
        (
            "rotate.overshoot < 1 and rotate.overshoot > 3",
            {"rotate.overshoot": 2.5},
            None,
            -1.5,
            False,
        ),
        (
            "rotate.overshoot > 2 implies rotate.overshoot > 3",
            {"rotate.overshoot": 2.5},
            None,
            -0.5,
            False,
        ),
        ('law.projection == "heading"', {"law.projection": "heading"}, None, math.inf, True),
        ('law.projection == "heading"', {"law.projection": "bearing"}, None, -math.inf, False),
        ("not rotate.overshoot > 2", {"rotate.overshoot": None}, None, -math.inf, False),
        (
            "rotate.overshoot > 2 implies run.duration < 9",
            {"rotate.overshoot": None, "run.duration": 10.0},
            None,
            -1.0,
            False,
        ),
        (
            "rotate.overshoot > 2 or run.duration < 9",
            {"rotate.overshoot": None, "run.duration": 8.0},
            None,
            1.0,
            True,
        ),
    ],
)
def test_margins_of_constraints(
    text: str,
    values: dict[str, Any],
    value: float | None,
    margin: float,
    holds: bool,  # noqa: FBT001
) -> None:
    (found,) = tune_candidates.parse_goal("run.duration", [text]).judge(values)
    assert (found.value, found.margin, found.holds) == (value, margin, holds)


def test_both_bounds_are_candidates_to_their_last_digit() -> None:
    """0.2 + 1.0 * (0.9 - 0.2) is not 0.9."""
    candidates, keys = prepare("textbook", {}, {"law.kp_linear": (0.2, 0.9)}, GOAL)
    found = tune_search.search_best(candidates, keys, evaluations=16)
    assert found.best.point == (0.9,)
    assert found.at_bounds == ("law.kp_linear",)


def test_a_better_one_in_the_neighbourhood_is_taken() -> None:
    goal = tune_candidates.parse_goal("final.position_error")
    candidates, keys = prepare("paper-kp10", {}, {"law.kp_angular": (1.0, 12.0)}, goal)
    first = tune_search.search_best(candidates, keys, evaluations=12)
    found, around = explore_best(candidates, keys, first)
    assert first.best.objective is not None
    assert found.best.objective is not None
    assert found.best.objective < first.best.objective
    assert found.evaluations == candidates.evaluations
    (one,) = around.ranges
    assert one.low <= found.best.point[0] <= one.high


def test_where_no_candidate_fulfils_the_constraints_the_nearest_is_told() -> None:
    goal = tune_candidates.parse_goal("run.duration", ["translate.settling_time <= 5"])
    candidates, keys = prepare("textbook", {}, BOUNDS, goal)
    found = tune_search.search_best(candidates, keys, evaluations=64)
    assert not found.best.is_feasible
    assert found.feasible == 0
    values = [one.constraints[0].value for one in candidates.list_known()]
    assert found.best.constraints[0].value == min(one for one in values if one is not None)


def test_a_missing_value_is_no_success() -> None:
    """Slow gains do not settle before the run ends."""
    goal = tune_candidates.parse_goal("translate.settling_time")
    candidates, keys = prepare(
        "textbook", {"law.timeout_s": 20.0}, {"law.kp_linear": (0.1, 12.0)}, goal
    )
    found = tune_search.search_best(candidates, keys, evaluations=64)
    assert any(one.objective is None for one in candidates.list_known())
    assert found.best.objective is not None


def test_an_overshoot_below_0_is_no_better_than_none() -> None:
    """The slowest gain never arrives: it is furthest from overshooting, and no better for that."""
    goal = tune_candidates.parse_goal("translate.overshoot")
    candidates, keys = prepare("textbook", {}, {"law.kp_linear": (0.05, 20.0)}, goal)
    found = tune_search.search_best(candidates, keys, evaluations=16)
    assert found.best.objective == 0.0
    assert found.is_flat
    assert found.best.point[0] > 1.0


def test_a_formula_of_an_overshoot_is_taken_as_it_is() -> None:
    values = {"translate.overshoot": -30.0}
    assert tune_candidates.parse_goal("translate.overshoot").compute_objective(values) == 0.0
    assert tune_candidates.parse_goal("2 * translate.overshoot").compute_objective(values) == -60.0
    largest = tune_candidates.parse_goal("translate.overshoot", is_maximised=True)
    assert largest.compute_objective(values) == -30.0


def test_what_differs_is_not_flat() -> None:
    goal = tune_candidates.parse_goal("translate.settling_time")
    candidates, keys = prepare("textbook", {}, BOUNDS, goal)
    assert not tune_search.search_best(candidates, keys, evaluations=16).is_flat


@pytest.mark.parametrize(
    ("texts", "reason"),
    [
        ([], "expected a key and its bounds"),
        (["law.kp_linear"], "expected KEY=A:B"),
        (["law.kp_linear=1,2"], "expected two bounds"),
        (["law.kp_linear=1:2:0.00001"], "expected two bounds and perhaps a step"),
        (["law.kp_linear=2:2"], "expected a range"),
        (["law.kp_linear=3:2"], "3"),
        (["law.kp_linear=1:nan"], "is not a finite number"),
        (["law.kp_linear=1:2", "law.kp_linear=1:3"], "found it twice"),
        (["loop.transport_delay_ticks=0.5:3"], "whole bounds"),
    ],
)
def test_ranges_that_are_none_are_refused(texts: list[str], reason: str) -> None:
    known = tl.scenario.flatten_scenario(tl.load_scenario("textbook"))
    with pytest.raises((tl.errors.TuneError, tl.errors.SweepError), match=reason):
        tune.parse_searched_keys(texts, known)


def test_goals_that_are_none_are_refused() -> None:
    base = tl.load_scenario("textbook")
    for text, constraints, reason in (
        ("law.kp_linear", [], "expected a metric"),
        ("rotate.overshoot > 2", [], "expected a number"),
        ("along.overshoot", [], "no such loop"),
        ("run.duration", ["rotate.overshoot"], "expected a condition"),
        ("run.duration", ["always(speed < 1)"], "signals over time"),
        ("run.duration", ["nothing > 1"], "unknown name"),
    ):
        with pytest.raises(tl.TurtlelogError, match=reason):
            tune_candidates.Candidates(
                base, ["law.kp_linear"], tune_candidates.parse_goal(text, constraints)
            )


def test_variants_draw_what_they_say() -> None:
    base = tl.scenario.override_scenario(
        tl.load_scenario("textbook"), {"sensing.noise_position_m": 0.002, "seed": 5}, source="test"
    )
    goal = tune_candidates.parse_goal("final.position_error", ["final.position_error <= 0.01"])
    variations = tune.choose_variations(base, 12)
    assert [(one.key, one.low, one.high) for one in variations] == [
        ("seed", 5, 16),
        ("loop.transport_delay_ticks", 0, 1),
    ]
    spread = tune.simulate_variants(base, goal, variations, runs=12, jobs=1)
    again = tune.simulate_variants(base, goal, variations, runs=12, jobs=2)
    assert spread == again
    assert spread.runs == spread.with_value == 12
    assert spread.low is not None
    assert spread.median is not None
    assert spread.low < spread.median < (spread.high or 0.0) <= (spread.worst or 0.0)
    assert 0 <= spread.holds <= 12
    noisy = [tune.Variation(key="sensing.noise_position_m", low=0.0, high=0.01)]
    drawn = tune.choose_variations(tl.load_scenario("textbook"), 12, noisy)
    assert drawn[0].key == "seed"
    calm = tune.choose_variations(tl.load_scenario("textbook"), 12)
    assert [one.key for one in calm] == ["loop.transport_delay_ticks"]


def test_intervals_of_a_robot(tmp_path: Path) -> None:
    base = tl.load_scenario("lagged")
    axes = [
        {"axis": "speed", "gain": {"low": 0.9, "high": 1.1}, "lag_s": {"low": -0.01, "high": 0.1}},
        {"axis": "turn_rate", "gain": {"low": 0.95, "high": None}, "dead_time_s": None},
    ]
    path = tmp_path / "robot.json"
    path.write_text(json.dumps({"axes": axes}), "utf-8")
    found = tune.read_intervals(path, base)
    assert [(one.key, one.low, one.high) for one in found] == [
        ("plant.speed_gain", 0.9, 1.1),
        ("plant.speed_lag_s", 0.0, 0.1),
    ]
    with pytest.raises(tl.errors.TuneError, match="has no intervals"):
        tune.read_intervals(path, tl.load_scenario("textbook"))
    for text in ("", "[]", "{}", '{"axes": 3}', '{"axes": [{"axis": "wheel", "gain": {}}]}'):
        path.write_text(text, "utf-8")
        with pytest.raises(tl.errors.TuneError, match="is not what"):
            tune.read_intervals(path, base)
    with pytest.raises(tl.errors.TuneError, match="No such file"):
        tune.read_intervals(tmp_path / "none.json", base)


def test_a_key_with_a_step_takes_its_values_alone() -> None:
    (key,) = tune.parse_searched_keys(["law.kp_linear=1:4:0.5"], {"law.kp_linear": 2.0})
    assert [key.round(value) for value in (0.0, 1.2, 1.3, 9.0)] == [1.0, 1.0, 1.5, 4.0]
