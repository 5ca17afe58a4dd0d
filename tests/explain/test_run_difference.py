import math
import random
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from itertools import permutations
from statistics import fmean
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from tests.explain.changed_pairs import draw_pair
from turtlelog.errors import ExplainError
from turtlelog.explain import Depth, ExplainedDifference, explain_difference
from turtlelog.explain.causes import find_changes, undo_changes
from turtlelog.run import Run, slice_run
from turtlelog.scenario import Scenario, get_preset, override_scenario

BRIEF = Depth(shows_effects=False, shows_starts=False)
KP2, KP10 = get_preset("paper-kp2"), get_preset("paper-kp10")


def change(scenario: Scenario, **values: Any) -> Scenario:
    keys = {key.replace("__", "."): value for key, value in values.items()}
    return override_scenario(scenario, keys, source="here")


@cache
def simulate_preset(name: str) -> Run:
    return tl.simulate_run(get_preset(name))


def explain(first: Scenario, second: Scenario, **options: Any) -> ExplainedDifference:
    runs = (tl.simulate_run(one) for one in (first, second))
    return explain_difference(*runs, **{"depth": BRIEF, **options})


def read(found: ExplainedDifference) -> dict[str, float]:
    return {one.name: one.contribution or 0.0 for one in found.contributions}


def measure(scenario: Scenario, metric: str) -> float:
    value = tl.measure_run(tl.simulate_run(scenario), only=[metric])[metric].value
    assert value is not None
    return value


def test_the_gains_and_the_pause_divide_what_kp10_misses_more_than_kp2() -> None:
    """Takes some 2 s: both runs are explained, too, and simulated from 17 starts."""
    found = explain_difference(simulate_preset("paper-kp2"), simulate_preset("paper-kp10"))
    assert found.sentences[0] == (
        "final.position_error rose from 0.0010 m to 0.1067 m: the gains add 0.1071 m, the shorter"
        " pause takes 0.0014 m away."
    )
    assert {one.cause: round(one.shift, 4) for one in found.effects} == {
        "pause": 0.0547,
        "queue": 0.0515,
    }
    assert found.starts is not None
    assert found.starts.is_wide
    assert found.starts.second == pytest.approx((0.0394, 0.4734), abs=1e-4)
    assert any("depends on single samples" in text for text in found.sentences)


def test_contributions_are_those_over_all_orders_and_add_up() -> None:
    second = change(KP10, goal__x_m=8.0, loop__start_backlog=2)
    found = explain(KP2, second, metric="run.duration")
    changes = find_changes(KP2, second)

    @cache
    def play(inside: frozenset[str]) -> float:
        undone = [one for name, one in changes.items() if name not in inside]
        return measure(undo_changes(second, undone), "run.duration")

    orders = list(permutations(changes))
    expected = {
        name: fmean(
            play(frozenset(order[: order.index(name) + 1]))
            - play(frozenset(order[: order.index(name)]))
            for order in orders
        )
        for name in changes
    }
    assert len(changes) == 4
    assert read(found) == pytest.approx(expected, abs=1e-9)
    assert math.fsum(read(found).values()) == pytest.approx(found.difference, abs=1e-9)


def test_swapped_runs_have_the_opposite_contributions() -> None:
    there, back = explain(KP2, KP10), explain(KP10, KP2)
    assert read(back) == pytest.approx({name: -size for name, size in read(there).items()})
    assert "fell from 0.1067 m to 0.0010 m" in back.sentences[0]
    assert "the longer pause adds 0.0014 m" in back.sentences[0]


@pytest.mark.parametrize(
    ("values", "groups"),
    [
        ({"law.kp_angular": 3.0, "law.kp_linear": 3.0}, ["gains"]),
        ({"law.kp_angular": 3.0, "law.kp_linear": 4.0}, ["law.kp_angular", "law.kp_linear"]),
        ({"loop.start_backlog": 1, "loop.queue_policy": "newest"}, ["queue"]),
        ({"goal.x_m": 3.0, "goal.y_m": 4.0, "start.heading_rad": 1.0}, ["start", "goal"]),
        ({"limits.speed_m_s": 0.5, "limits.turn_rate_rad_s": 0.5}, ["limits"]),
        ({"law.heading_tolerance_rad": 0.1, "law.position_tolerance_m": 0.1}, ["tolerance"]),
        ({"max_duration_s": 9.0}, ["time span"]),
        ({"name": "other", "seed": 7}, []),
    ],
)
def test_settings_are_grouped_as_a_person_changes_them(
    values: Mapping[str, Any], groups: list[str]
) -> None:
    second = override_scenario(KP2, values, source="here")
    assert [*find_changes(KP2, second)] == groups


def test_another_law_is_one_change_with_all_of_its_keys() -> None:
    found = find_changes(KP2, get_preset("posture"))
    assert {"law.kind", "law.kp_linear", "law.gamma"} <= found["law"].neutral.keys()
    assert [name for name in found if name.startswith("law.")] == []


def test_a_path_that_one_law_has_alone_belongs_to_the_law() -> None:
    found = find_changes(KP2, get_preset("track-square"))
    assert "path.kind" in found["law"].neutral
    assert "path" not in found


@pytest.mark.parametrize("name", ["posture", "track-square", "lagged"])
def test_all_changes_undone_are_the_first_scenario(name: str) -> None:
    first, second = KP2, get_preset(name)
    for one, other in ((first, second), (second, first)):
        undone = undo_changes(other, find_changes(one, other).values())
        assert replace(undone, name=one.name, seed=one.seed) == one


def test_keys_that_change_nothing_are_named_apart() -> None:
    found = explain(
        KP2, change(KP2, loop__pose_queue=12, law__kp_linear=3.0), metric="run.duration"
    )
    assert found.idle == ("loop.pose_queue",)
    assert [*read(found)] == ["law.kp_linear"]


def test_equal_runs_are_called_equal_and_runs_with_an_idle_key_are_not() -> None:
    assert "The runs are equal: no setting differs, and no sample." in explain(KP2, KP2).sentences
    idle = explain(KP2, change(KP2, loop__pose_queue=12))
    assert not any("equal" in text for text in idle.sentences)
    assert idle.sentences[0] == "final.position_error is 0.001011 m in both runs."


def test_a_seed_that_draws_nothing_is_no_difference() -> None:
    assert explain(KP2, change(KP2, seed=9)).has_same_settings


@pytest.mark.parametrize(("speed", "is_told"), [(0.9, False), (0.0, True)])
def test_changes_below_the_resolution_are_no_reason(*, speed: float, is_told: bool) -> None:
    second = change(KP2, limits__speed_m_s=speed) if speed else KP10
    text = explain(KP2, second).sentences[0]
    assert ("no change adds more than the resolution" in text) is not is_told


@pytest.mark.parametrize(("tolerance_rad", "is_told"), [(0.0015, False), (0.01, True)])
def test_a_wider_tolerance_does_not_hide_itself(tolerance_rad: float, *, is_told: bool) -> None:
    """It is judged by what the narrower one allows, 6.7 mm."""
    first = get_preset("textbook")
    found = explain(first, change(first, law__heading_tolerance_rad=tolerance_rad))
    assert ("the tolerance adds" in found.sentences[0]) is is_told
    assert found.resolution.size == pytest.approx(0.00669, abs=1e-5)


def test_without_a_value_the_smallest_set_of_changes_is_the_answer() -> None:
    wild = change(KP2, law__kp_angular=200.0, law__kp_linear=200.0, law__pause_ticks=10)
    found = explain(KP2, wild, metric="translate.settling_time")
    assert not found.contributions
    assert [case.causes for case in found.without_value] == [("gains",)]
    assert "the first run has 5.774 s; the second run has no value" in found.sentences[0]


@pytest.mark.thorough
def test_settings_that_contradict_each_other_have_no_value() -> None:
    """A compiled loop of another plant is loaded."""
    far = change(get_preset("lagged"), goal__x_m=50.0, max_duration_s=2.0)
    found = explain(KP2, far, metric="run.duration")
    assert found.withheld
    assert "contradict each other" in " ".join(found.sentences)


def test_noise_is_divided_in_the_mean_and_the_seeds_take_the_rest() -> None:
    """Takes some 3 s: both combinations are simulated with 32 seeds."""
    noisy = change(KP2, sensing__noise_position_m=0.01, sensing__noise_heading_rad=0.01)
    found = explain(KP2, noisy)
    sizes = read(found)
    assert [*sizes] == ["noise", "seed"]
    assert math.fsum(sizes.values()) == pytest.approx(found.difference, abs=1e-12)
    assert found.contributions[0].standard_error
    assert "in the mean over 32 seeds the noise adds" in found.sentences[0]


def test_runs_that_differ_by_their_seed_alone_name_no_cause() -> None:
    noisy = change(KP2, sensing__noise_position_m=0.01, sensing__noise_heading_rad=0.01, seed=1)
    found = explain(noisy, change(noisy, seed=2))
    assert [*read(found)] == ["seed"]
    assert "No setting differs but the seed of the random effects." in found.sentences


def test_sampled_orders_add_up_and_their_errors_hold_the_exact_value() -> None:
    second = change(KP10, goal__x_m=8.0, loop__start_backlog=2, limits__speed_m_s=0.7)
    exact = read(explain(KP2, second, metric="run.duration"))
    depth = replace(BRIEF, most_exact=2)
    found = explain(KP2, second, metric="run.duration", depth=depth)
    assert found.orders == 256
    assert math.fsum(read(found).values()) == pytest.approx(found.difference, abs=1e-9)
    for one in found.contributions:
        assert one.standard_error is not None
        apart = abs((one.contribution or 0.0) - exact[one.name])
        assert apart <= 3.0 * one.standard_error + 1e-9


def test_a_log_without_its_scenario_is_explained_as_identified() -> None:
    log = replace(simulate_preset("paper-kp10"), scenario_is_complete=False, parameters={})
    found = explain_difference(simulate_preset("paper-kp2"), log, depth=BRIEF)
    assert (found.first.basis, found.second.basis) == ("recorded", "identified")
    assert read(found) == pytest.approx({"gains": 0.1071, "pause": -0.0014}, abs=1e-4)
    assert "law.wrap_error" in found.second.unknown


def test_what_a_cut_log_does_not_show_is_no_change() -> None:
    run = simulate_preset("paper-kp10")
    cut = slice_run(run, end_ns=run.start_ns + 6 * 10**9)
    found = explain_difference(run, cut, metric="run.path_length", depth=BRIEF)
    assert [*read(found)] == ["time span"]
    assert "law.kp_linear" in found.second.unknown


def test_a_recording_that_claims_other_settings_is_explained_by_its_samples() -> None:
    run = tl.simulate_run(change(KP10, law__kp_linear=4.0))
    claims = replace(run, parameters=simulate_preset("paper-kp10").parameters)
    found = explain_difference(simulate_preset("paper-kp10"), claims, depth=BRIEF)
    assert [*read(found)] == ["law.kp_linear"]
    assert "identified from its samples: the recorded scenario reproduces" in found.sentences[-1]


def spoil(run: Run, *, part: str) -> Run:
    if part == "controller":
        speed = run.samples.speed_m_s.copy()
        speed[400:] *= 0.999
        return replace(run, samples=replace(run.samples, speed_m_s=speed))
    xy_m = run.poses.xy_m.copy()
    xy_m[0 if part == "start" else 500 :] += 0.01
    return replace(run, poses=replace(run.poses, xy_m=xy_m))


@pytest.mark.parametrize(
    ("part", "at_s", "cause"),
    [
        ("controller", 6.704, "the cause lies in the controller"),
        (
            "robot",
            7.936,
            "lies outside the controller: in the transport of commands, in the robot,",
        ),
        ("robot", 7.936, "in what acts on it, or in the measurement of its poses."),
        ("start", -0.064, "They start from other poses"),
    ],
)
def test_runs_of_one_scenario_are_explained_by_where_they_depart(
    part: str, at_s: float, cause: str
) -> None:
    run = simulate_preset("paper-kp10")
    for pair in ((run, spoil(run, part=part)), (spoil(run, part=part), run)):
        found = explain_difference(*pair, depth=BRIEF)
        assert found.departure is not None
        assert found.departure.part == part
        assert found.departure.time_s == pytest.approx(at_s)
        text = " ".join(found.sentences)
        assert cause in text
        assert "Simulated again, that scenario reproduces the" in text


@pytest.mark.parametrize(
    ("of_first", "of_second", "sentence"),
    [
        ({}, {}, "No setting differs: both ran with turtlelog"),
        ({"law": "1"}, {"law": "1"}, "glibc 2.36, by the same code of the law. The runs depart"),
        ({"law": "1"}, {"law": "2"}, "No setting differs, but the code of the law does. The runs"),
        (
            {"numpy": "1.0", "law": "1"},
            {"numpy": "2.0", "law": "2"},
            "but the software does: NumPy 1.0, then 2.0; the code of the law. The runs depart",
        ),
        (
            {"platform": "Linux x86_64"},
            {"platform": "Linux aarch64"},
            "the software does: Linux x86_64, then Linux aarch64. The runs depart at 6.704 s",
        ),
        ({"law": "1"}, None, "and the second run does not name the versions used. The runs depart"),
        (None, None, "and the first run and the second run do not name the versions used."),
    ],
)
def test_what_differs_before_two_runs_depart_is_named_as_far_as_both_name_it(
    of_first: dict[str, str] | None, of_second: dict[str, str] | None, sentence: str
) -> None:
    runs = simulate_preset("paper-kp10"), spoil(simulate_preset("paper-kp10"), part="controller")
    known = {**runs[0].simulated_by, "platform": "Linux x86_64 glibc 2.36"}
    first, second = (
        replace(run, simulated_by={} if more is None else {**known, **more})
        for run, more in zip(runs, (of_first, of_second), strict=True)
    )
    text = " ".join(explain_difference(first, second, depth=BRIEF).sentences)
    assert sentence in text
    is_other = bool(of_first and of_second and of_first.get("law") != of_second.get("law"))
    assert ("the controller, whose code differs." in text) == is_other


def test_software_that_differs_is_named_where_no_run_is_reproduced() -> None:
    first = simulate_preset("paper-kp10")
    settings = {**first.parameters, "law.kp_linear": 9.0}
    second = replace(spoil(first, part="robot"), parameters=settings)
    second = replace(second, simulated_by={**first.simulated_by, "turtlelog": "0.0.1"})
    found = explain_difference(first, second, depth=replace(BRIEF, identifies=False))
    change = f"The software differs, too: turtlelog {tl.__version__}, then 0.0.1."
    assert change in " ".join(found.sentences)
    same = replace(second, simulated_by=first.simulated_by)
    found = explain_difference(first, same, depth=replace(BRIEF, identifies=False))
    assert "software" not in " ".join(found.sentences)


def test_a_run_without_samples_has_no_cause_and_says_what_is_missing() -> None:
    run = simulate_preset("paper-kp10")
    none = {
        name: value[:0]
        for name in run.samples.__dataclass_fields__
        if isinstance(value := getattr(run.samples, name), np.ndarray)
    }
    bag = replace(run, samples=replace(run.samples, **none), scenario_is_complete=False)
    found = explain_difference(run, replace(bag, goal_xy_m=None), depth=BRIEF)
    assert found.metric == "run.path_length"
    assert found.withheld is not None
    assert "without controller samples no scenario is known" in found.withheld


def test_a_metric_that_one_run_lacks_is_refused() -> None:
    with pytest.raises(ExplainError, match=r"posture: no metric .rotate.overshoot."):
        explain(KP2, get_preset("posture"), metric="rotate.overshoot")


def test_laws_that_nobody_trusts_do_not_run() -> None:
    run = simulate_preset("paper-kp10")
    other = replace(run, parameters={**run.parameters, "law.kind": "mine.py:Law"})
    found = explain_difference(run, other)
    assert found.contributions == ()
    assert [one.name for one in found.changes] == ["law"]
    assert found.withheld == "mine.py:Law runs only if its code is trusted (--trust-law)"


@pytest.mark.thorough
@pytest.mark.parametrize("seed", range(4))
def test_pairs_of_known_changes_are_divided_as_brute_force_does(seed: int) -> None:
    """Four pairs are simulated in every combination, twice."""
    source = random.Random(seed)
    for _ in range(4):
        pair = draw_pair(source)
        truth = pair.divide()
        found = explain(pair.first, pair.second, metric=pair.metric)
        if truth is None:
            assert found.contributions == ()
            continue
        sizes = read(found)
        assert sizes.keys() <= truth.keys()
        assert {name: sizes.get(name, 0.0) for name in truth} == pytest.approx(truth, abs=1e-9)
        assert math.fsum(sizes.values()) == pytest.approx(found.difference, abs=1e-9)
