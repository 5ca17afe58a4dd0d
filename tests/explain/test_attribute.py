import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from tests.explain.logs import add_noise, simulate
from tests.log.runs import find_shared
from turtlelog.errors import ExplainError
from turtlelog.explain import (
    Attribution,
    Contribution,
    attribute_run,
    attribute_scenario,
    find_causes,
    identify_run,
    simulate_without,
)
from turtlelog.explain.causes import FINER, find_resolution, is_present, list_effects
from turtlelog.explain.contributions import find_steady_span, vary_start
from turtlelog.explain.game import turn_start
from turtlelog.laws.sequential_p import DECLARATION
from turtlelog.log import import_log
from turtlelog.measure import DeadTime, find_dead_time, measure_run
from turtlelog.run import Run
from turtlelog.scenario import get_preset, override_scenario

KP10 = get_preset("paper-kp10")
CAUSES = find_causes(KP10)
EFFECTS = list_effects(CAUSES)
ABSENT = {name for name, found in CAUSES.items() if not is_present(KP10, found)}
WRAPPING = {"law.kp_angular": 10.0, "law.kp_linear": 10.0, "goal.x_m": 2.0, "goal.y_m": 5.6}


def attribute(name: str, *causes: str, **options: Any) -> Attribution:
    return attribute_scenario(get_preset(name), causes=causes or None, **options)


def read_shares(found: Attribution) -> dict[str, float]:
    return {share.cause: share.contribution or 0.0 for share in found.contributions}


def read_alone(found: Attribution) -> dict[str, float | None]:
    return {share.cause: share.alone for share in (*found.contributions, *found.others)}


def find_other(found: Attribution, name: str) -> Contribution:
    return next(share for share in found.others if share.cause == name)


def shift_log(run: Run, by_m: float) -> Run:
    """Return a run whose last pose lies further from the goal, beyond its last sample."""
    xy_m = run.poses.xy_m.copy()
    assert run.goal_xy_m is not None
    away = xy_m[-1] - run.goal_xy_m
    xy_m[-1] += by_m * away / np.hypot(*away)
    return replace(run, poses=replace(run.poses, xy_m=xy_m))


def test_without_queue_and_pause_the_gain_of_ten_ends_within_six_millimetres() -> None:
    found = attribute_scenario(KP10)
    assert (found.resimulated, found.without_all) == pytest.approx((0.1067, 0.0051), abs=5e-5)
    assert read_shares(found) == pytest.approx(
        {"queue": 0.05108, "pause": 0.05057, "wrap": 0.0}, abs=1e-5
    )
    together = {case.causes: case.value for case in found.together}
    assert together["queue", "pause"] == pytest.approx(0.0576, abs=1e-4)


def test_a_recorded_run_needs_no_scenario() -> None:
    found = attribute_run(import_log(find_shared("paper", "kp4_210.json")))
    assert found.as_logged == found.resimulated
    assert replace(found, as_logged=None) == attribute("paper-kp4")


def test_effects_share_and_properties_stand_beside_them() -> None:
    found = attribute_scenario(KP10)
    assert (*EFFECTS[:2], *EFFECTS[-2:]) == ("queue", "delay", "pause", "wrap")
    assert found.causes == ("queue", "pause", "wrap")
    assert {share.cause for share in found.others} == {*CAUSES} - {*EFFECTS} - ABSENT


def test_what_is_not_in_the_scenario_takes_no_part() -> None:
    found = attribute("textbook")
    assert (found.causes, found.contributions, found.without_all) == ((), (), found.resimulated)
    assert {share.cause for share in found.others} == {
        "saturation",
        "sampling",
        "float32",
        "tolerance",
    }


def test_the_value_with_one_cause_out_is_that_of_a_simulation_without_it() -> None:
    found = read_alone(attribute_scenario(KP10))
    without = simulate("paper-kp10", law__pause_ticks=0)
    assert found["pause"] == measure_run(without)["final.position_error"].value
    unlimited = simulate("paper-kp10", limits__speed_m_s=math.inf, limits__turn_rate_rad_s=math.inf)
    assert found["saturation"] == measure_run(unlimited)["final.position_error"].value


@pytest.mark.thorough
@settings(max_examples=12, deadline=None, derandomize=True)
@given(
    st.sampled_from(["paper-kp1", "paper-kp2", "paper-kp4", "paper-kp10", "textbook"]),
    st.lists(
        st.sampled_from(["queue", "pause", "saturation", "float32", "tolerance"]),
        min_size=1,
        max_size=3,
        unique=True,
    ),
    st.sampled_from(["final.position_error", "final.heading_error", "run.duration"]),
)
def test_shares_add_up_to_the_last_bit_or_that_of_the_smallest(
    name: str, causes: list[str], metric: str
) -> None:
    """Each of 12 examples simulates all subsets of up to three effects."""
    found = attribute(name, *causes, metric=metric)
    shares = [share for share in read_shares(found).values() if share]
    assert found.resimulated is not None
    assert found.without_all is not None
    total = found.resimulated - found.without_all
    smallest = min(map(abs, shares), default=0.0)
    assert abs(math.fsum(shares) - total) <= (math.ulp(smallest) if smallest > abs(total) else 0.0)


def test_the_order_of_the_causes_changes_no_share() -> None:
    forth = attribute("paper-kp10", "queue", "pause", "saturation")
    back = attribute("paper-kp10", "saturation", "pause", "queue")
    assert read_shares(forth) == pytest.approx(read_shares(back), rel=1e-12)


def test_a_transport_delay_is_an_effect() -> None:
    values = {"law.kp_angular": 10.0, "law.kp_linear": 10.0, "loop.transport_delay_ticks": 6}
    found = attribute_scenario(override_scenario(get_preset("textbook"), values))
    assert read_shares(found) == {"delay": pytest.approx(0.0751, abs=1e-4)}


def test_two_effects_that_need_each_other_share_alike() -> None:
    found = attribute_scenario(override_scenario(get_preset("paper"), WRAPPING))
    shares = read_shares(found)
    assert (shares["queue"], shares["wrap"]) == pytest.approx((1.780, 1.744), abs=1e-3)
    assert abs(shares["pause"]) < 0.1 * shares["queue"]
    largest = max(found.together, key=lambda case: case.value)
    assert largest.causes == ("queue", "wrap")


@pytest.mark.thorough
def test_of_more_than_six_those_take_part_that_change_most() -> None:
    """All 64 subsets of six effects are simulated."""
    found = attribute("paper-kp10", *(name for name in CAUSES if name != "wrap"))
    assert found.causes == (
        "queue",
        "saturation",
        "sampling",
        "pause",
        "projection",
        "tolerance",
    )
    assert found.left == ("float32",)
    assert find_other(found, "float32").alone == pytest.approx(0.10673, abs=1e-5)


def test_a_log_cut_short_is_compared_with_a_run_cut_there() -> None:
    run = add_noise(simulate("paper-kp1", max_duration_s=6.3), 1e-4, 1)
    identified = identify_run(run)
    assert identified.build_scenario().max_duration_s == pytest.approx(6.288)
    found = attribute_run(run, identified=identified)
    assert found.as_logged == pytest.approx(5.6935, abs=1e-3)
    assert found.resimulated == pytest.approx(5.6934, abs=1e-3)


def test_the_value_of_the_log_stands_beside_the_re_simulation() -> None:
    run = import_log(find_shared("paper", "kp4_210.json"))
    found = attribute_run(run, metric="rotate.overshoot")
    assert found.as_logged == measure_run(run)["rotate.overshoot"].value
    assert (found.as_logged, found.resimulated) == pytest.approx((0.039355, 0.066729), abs=1e-6)
    assert found.contributions == ()
    assert found.withheld == (
        "log and re-simulation differ by more than a tenth of what the effects add together"
    )


@pytest.mark.parametrize(("part", "is_told"), [(0.099, True), (0.101, False)])
def test_shares_are_told_up_to_a_tenth_of_what_the_effects_add(
    part: float, *, is_told: bool
) -> None:
    """All subsets of the effects are simulated."""
    run, found = simulate("paper-kp10"), attribute_scenario(KP10)
    assert found.resimulated is not None
    assert found.without_all is not None
    shifted = shift_log(run, part * (found.resimulated - found.without_all))
    shares = attribute_run(shifted, identified=identify_run(run)).contributions
    assert bool(shares) == is_told


@pytest.mark.thorough
@pytest.mark.parametrize(("part", "is_told"), [(0.9e-6, True), (1.1e-6, False)])
def test_where_the_effects_add_nothing_a_millionth_is_the_same(
    part: float, *, is_told: bool
) -> None:
    """All subsets of the effects are simulated."""
    run = simulate("textbook", law__wrap_error=False)
    identified = identify_run(run)
    logged = attribute_run(run, identified=identified).as_logged
    assert logged is not None
    found = attribute_run(shift_log(run, part * logged), identified=identified)
    assert bool(found.contributions) == is_told
    assert is_told or found.withheld == (
        "log and re-simulation differ by more than 0.0001 % of the value, and the effects add less"
    )


def test_smallest_sets_stand_for_shares_where_some_have_no_value() -> None:
    scenario = override_scenario(get_preset("paper"), WRAPPING)
    found = attribute_scenario(scenario, metric="translate.duration")
    assert (found.resimulated, found.contributions) == (None, ())
    assert [case.causes for case in found.without_value] == [("queue", "wrap")]
    assert found.without_value[0].reason == "the run has no phase translate"
    assert found.without_all is not None


def test_a_value_that_only_an_effect_makes_is_said() -> None:
    scenario = override_scenario(KP10, {"law.heading_tolerance_rad": 1e-6})
    found = attribute_scenario(scenario, metric="rotate.decay_ratio")
    assert [case.causes for case in found.without_value] == [()]
    assert [case.causes for case in found.with_value] == [("queue",)]
    assert found.resimulated is not None


@pytest.mark.parametrize(
    ("metric", "resolution"),
    [
        ("final.position_error", 0.001 * math.hypot(3.5444446, 4.4555554) + 0.001),
        ("final.heading_error", math.degrees(0.001)),
        ("rotate.overshoot", 100.0 * 0.001 / 2.2427942),
        ("translate.overshoot", 100.0 * 0.001 / math.hypot(3.5444446, 4.4555554)),
        ("rotate.settling_time", 0.016),
        ("rotate.crossings", 0.5),
        ("run.iae", 0.02),
    ],
)
def test_each_metric_has_its_resolution(metric: str, resolution: float) -> None:
    assert find_resolution(KP10, DECLARATION, metric, 2.0).size == pytest.approx(
        resolution, rel=1e-6
    )


def test_the_resolution_of_a_time_is_one_sample_period() -> None:
    scenario = override_scenario(KP10, {"loop.period_ticks": 3})
    assert find_resolution(scenario, DECLARATION, "run.duration", 12.0).size == pytest.approx(0.048)


def test_the_gain_of_ten_depends_on_single_samples() -> None:
    starts = attribute_scenario(KP10).starts
    assert starts is not None
    assert starts.is_wide
    assert starts.count == 17
    assert starts.within_rad == pytest.approx(0.008)
    assert (starts.low, starts.high) == pytest.approx((0.0394, 0.4734), abs=1e-4)
    assert (starts.parts[0].low, starts.parts[0].high) == pytest.approx((0.161, 0.615), abs=1e-3)
    assert starts.without_all == pytest.approx((0.00482, 0.00568), abs=1e-5)


@pytest.mark.parametrize(("kp", "has_starts"), [(43.0, True), (45.0, False)])
def test_starts_further_apart_than_a_quarter_turn_are_not_compared(
    kp: float, *, has_starts: bool
) -> None:
    # The robot turns by up to 2.24 rad times kp each second, for one sample of 16 ms.
    scenario = override_scenario(
        get_preset("textbook"),
        {"law.kp_angular": kp, "limits.turn_rate_rad_s": math.inf, "max_duration_s": 2.0},
    )
    assert (attribute_scenario(scenario, metric="run.duration").starts is not None) == has_starts


def test_a_start_beyond_a_full_turn_is_the_same_heading() -> None:
    scenario = override_scenario(KP10, {"start.heading_rad": 6.28})
    turned = turn_start(scenario, 0.01)
    assert turned.start.heading_rad == pytest.approx(6.29 - 2.0 * math.pi)
    assert turn_start(scenario, 0.003).start.heading_rad == 6.283


def test_a_cause_without_which_the_run_diverges_leaves_no_value() -> None:
    changes = {"law.kp_linear": 60.0, "limits.speed_m_s": math.inf, "max_duration_s": 60.0}
    unlimited = {"law.kp_angular": 60.0, "limits.turn_rate_rad_s": math.inf}
    found = attribute_scenario(override_scenario(get_preset("lagged"), changes | unlimited))
    assert "expected a finite command" in (find_other(found, "sampling").ending or "")


@pytest.mark.parametrize(("part", "is_wide"), [(0.49, False), (0.51, True)])
def test_a_value_depends_on_samples_from_half_of_what_is_added_on(
    part: float, *, is_wide: bool
) -> None:
    found = attribute_scenario(KP10).starts
    assert found is not None
    width, acting = found.high - found.low, ["queue", "pause"]
    starts = vary_start(
        KP10, "final.position_error", added=width / part, resolution=0.0, acting=acting
    )
    assert starts is not None
    assert starts.is_wide == is_wide


@pytest.mark.parametrize(("part", "is_wide"), [(0.99, True), (1.01, False)])
def test_a_lucky_start_depends_on_samples_if_others_range_over_the_resolution(
    part: float, *, is_wide: bool
) -> None:
    found = attribute_scenario(KP10).starts
    assert found is not None
    resolution = part * (found.high - found.low)
    options: dict[str, Any] = {"added": 0.0, "resolution": resolution, "acting": ["queue", "pause"]}
    starts = vary_start(KP10, "final.position_error", **options)
    assert starts is not None
    assert starts.is_wide == is_wide


def test_a_small_range_of_what_effects_hardly_change_is_steady() -> None:
    assert find_steady_span([1.0, None, -4.0], 0.1, 0.1) == 2.0
    assert find_steady_span([1.0, None, -4.0], 0.11, 0.1) == 0.055
    assert find_steady_span([1.0, None, -4.0], 0.0, 2.1) == 2.1
    assert find_steady_span([None], 0.0, 0.1) == 0.1


def test_a_value_that_only_follows_the_start_is_steady() -> None:
    found = attribute("paper-kp2", metric="rotate.rms_error")
    assert found.resimulated is not None
    assert found.without_all is not None
    assert found.starts is not None
    added, width = found.resimulated - found.without_all, found.starts.high - found.starts.low
    assert width > 0.5 * abs(added) > found.resolution.size
    assert not found.starts.is_wide


def test_dead_times_are_not_read_from_a_finer_clock() -> None:
    found = find_other(attribute_scenario(KP10, metric="translate.dead_time"), "sampling")
    assert (found.alone, found.ending) == (None, "dead times are not measured on a finer clock")


@pytest.mark.parametrize("name", ["paper-kp1", "paper-kp2", "paper-kp4"])
def test_the_lower_gains_are_steady(name: str) -> None:
    found = attribute(name)
    assert found.starts is not None
    assert not found.starts.is_wide
    assert found.starts.parts == ()


@pytest.mark.thorough
def test_a_property_that_leaves_another_phase_without_end_is_said() -> None:
    scenario = override_scenario(get_preset("paper"), WRAPPING)
    assert find_other(attribute_scenario(scenario), "sampling").ending == (
        "the rotation ends within 60 s"
    )
    shorter = override_scenario(KP10, {"max_duration_s": 3.2})
    assert find_other(attribute_scenario(shorter), "tolerance").ending == (
        "the pause no longer ends within 3.2 s"
    )
    assert find_other(attribute_scenario(KP10), "saturation").ending is None


@pytest.mark.thorough
def test_settings_that_fit_alike_are_named() -> None:
    run = add_noise(simulate("paper-kp10"), 1e-4, 1)
    assert attribute_run(run).doubts == (
        "Contributions are those of the likeliest settings. None reproduces every sample.",
    )
    assert attribute_run(simulate("paper-kp10")).doubts == ()


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"metric": "final.speed"}, 'no metric "final.speed"; did you mean '),
        ({"causes": ["puase"]}, 'no cause "puase"; did you mean pause'),
        ({"causes": ["luck"]}, 'no cause "luck"; list: turtlelog list causes'),
        ({"causes": []}, "causes: expected different ones, found"),
        ({"causes": ["queue", "queue"]}, "expected different ones, found queue, queue"),
    ],
    ids=str,
)
def test_what_is_not_known_is_refused(options: dict[str, Any], line: str) -> None:
    with pytest.raises(ExplainError, match=line):
        attribute_scenario(get_preset("textbook"), **options)


@pytest.mark.parametrize("name", ["paper-kp1", "paper-kp4"])
def test_a_finer_clock_leaves_the_dead_times(name: str) -> None:
    coarse, fine = simulate(name), simulate_without(get_preset(name), ["sampling"])
    assert np.diff(fine.poses.time_ns).max() * FINER == np.diff(coarse.poses.time_ns).max()
    for phase in ("rotate", "translate"):
        before = find_dead_time(coarse, phase)
        assert isinstance(before, DeadTime)
        sent = fine.samples.turn_rate_rad_s if phase == "rotate" else fine.samples.speed_m_s
        applied = fine.poses.turn_rate_rad_s if phase == "rotate" else fine.poses.speed_m_s
        assert applied is not None
        rows = np.flatnonzero(fine.samples.phase == fine.phase_names.index(phase))[:-1][40:]
        at = fine.samples.pose_sequence[rows] + before.ticks * FINER + 1
        rows, at = rows[at < len(applied)], at[at < len(applied)]
        assert np.array_equal(applied[at], np.abs(np.float32(sent[rows])))


def test_a_finer_clock_comes_nearer_to_the_ideal_loop() -> None:
    values = {"limits.turn_rate_rad_s": math.inf, "law.kp_angular": 10.0}
    scenario = override_scenario(get_preset("textbook"), values)
    errors = []
    for run in (simulate("textbook", **{key.replace(".", "__"): v for key, v in values.items()}),
                simulate_without(scenario, ["sampling"])):  # fmt: skip
        rotating = run.samples.phase == run.phase_names.index("rotate")
        time_s = run.samples.time_ns[rotating] / 1e9
        heading = run.poses.heading_rad[run.samples.pose_sequence[rotating]]
        assert run.goal_line is not None
        ideal = run.goal_line.bearing_rad * (1.0 - np.exp(-10.0 * time_s))
        errors.append(float(np.abs(heading - ideal).max()))
    assert errors[1] < 0.2 * errors[0]
