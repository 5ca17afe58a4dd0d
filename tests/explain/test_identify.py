from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from tests.explain.logs import add_noise, as_log, forget, read_values, simulate
from tests.log.runs import find_shared
from turtlelog.errors import ExplainError
from turtlelog.explain import Certainty, Finding, identify_run
from turtlelog.log import import_log, read_run
from turtlelog.scenario import (
    build_scenario,
    flatten_scenario,
    get_preset,
    nest_parameters,
    override_scenario,
    restore_scenario,
)
from turtlelog.simulate import simulate_run

LAW = ("law.", "limits.", "loop.")


PAPER = {"paper-kp1": (6, 34), "paper-kp2": (5, 34), "paper-kp4": (6, 34), "paper-kp10": (5, 33)}


@pytest.mark.parametrize(("file", "kp"), [("kp1_210.json", 1.0), ("kp4_210.json", 4.0)])
def test_a_log_of_the_papers_is_identified_with_no_hint(file: str, kp: float) -> None:
    found = identify_run(replace(import_log(find_shared("paper", file)), parameters={}))
    keys = ("loop.start_backlog", "law.pause_ticks", "dead_time.rotate", "dead_time.translate")
    assert read_values(found, *keys, "lost_commands") == (6, 34, 5, 6, 4)
    assert read_values(found, "law.kp_angular", "law.kp_linear") == (kp, kp)
    assert read_values(found, "limits.speed_m_s", "limits.turn_rate_rad_s") == (1.0, 1.0)
    assert read_values(found, "law.projection", "stop_reason") == ("bearing", "standstill")
    assert found.resimulation is not None
    assert found.resimulation.is_exact
    assert found.notes == ()


@pytest.mark.parametrize("name", PAPER)
def test_a_recording_gives_its_scenario_back(name: str) -> None:
    run = simulate(name)
    found = identify_run(forget(run))
    assert read_values(found, "loop.start_backlog", "law.pause_ticks") == PAPER[name]
    assert found.build_scenario() == get_preset(name)


def test_the_identified_scenario_makes_the_log_again() -> None:
    run = import_log(find_shared("paper", "kp4_210_main.csv"))
    again = simulate_run(identify_run(run).build_scenario())
    read = again.samples.pose_sequence
    assert np.array_equal(again.poses.xy_m[read], run.poses.xy_m)
    assert np.array_equal(again.samples.speed_m_s, run.samples.speed_m_s)


@pytest.mark.thorough
def test_the_textbook_has_no_backlog_and_no_pause() -> None:
    found = identify_run(forget(simulate("textbook")))
    keys = ("loop.start_backlog", "law.pause_ticks", "dead_time.rotate", "law.projection")
    assert read_values(found, *keys) == (1, 0, 0, "heading")
    policy = found.findings["loop.queue_policy"]
    assert (policy.certainty, policy.candidates) == (
        Certainty.AMBIGUOUS,
        ("newest", "one-per-tick"),
    )
    assert found.findings["loop.command_queue"].evidence == "a deeper queue gives the same run"


@pytest.mark.thorough
def test_noise_claims_no_depth_of_a_queue_that_never_fills() -> None:
    changes = {
        "sensing.noise_heading_rad": 0.001,
        "loop.command_queue": 20,
        "loop.pose_queue": 30,
        "goal.x_m": 6.5,
        "goal.y_m": 6.1,
    }
    scenario = override_scenario(get_preset("textbook"), changes)
    found = identify_run(forget(simulate_run(scenario))).findings
    assert found["loop.start_backlog"].certainty is Certainty.FITTED
    for key in ("loop.command_queue", "loop.pose_queue"):
        assert found[key].certainty is Certainty.UNKNOWN
        assert found[key].evidence == "a deeper queue gives the same run"


def test_a_noisy_bound_of_the_heading_tolerance_is_told_in_degrees() -> None:
    changes = {
        "sensing.quantum_heading_rad": 0.01,
        "shaping.quantum_turn_rate_rad_s": 0.05,
        "law.kp_angular": 4.0,
        "max_duration_s": 4.0,
    }
    run = simulate_run(override_scenario(get_preset("textbook"), changes))
    found = identify_run(forget(run)).findings["law.heading_tolerance_rad"]
    assert found.interval is not None
    high_deg = float(np.degrees(found.interval[1]))
    assert found.evidence.endswith(f"below {high_deg:.4g} deg")


def test_the_pause_holds_a_stale_command() -> None:
    found = identify_run(forget(simulate("paper-kp10")))
    held, turned, burst = read_values(
        found, "pause.held_turn_rate_rad_s", "pause.turned_rad", "pause.burst"
    )
    assert (round(held, 4), round(np.degrees(turned), 3), burst) == (-0.03, -1.093, 10)


@pytest.mark.everyday("kp4_210.json")
@pytest.mark.parametrize("file", ["kp1_210.json", "kp4_210.json"])
def test_noise_leaves_gains_within_two_percent(file: str) -> None:
    clean = import_log(find_shared("paper", file))
    for seed in range(2):
        found = identify_run(add_noise(clean, 1e-3, seed))
        for key in ("law.kp_angular", "law.kp_linear"):
            gain = found.findings[key]
            assert gain.certainty is Certainty.FITTED
            assert gain.value == pytest.approx(clean.parameters[key], rel=0.02)
        assert read_values(found, "dead_time.rotate", "dead_time.translate") == (5, 6)
        assert read_values(found, "loop.start_backlog", "law.pause_ticks") == (6, 34)


@pytest.mark.thorough
@pytest.mark.parametrize(("backlog", "fit"), [(7, (7, 8)), (8, (7, 8)), (9, (9,)), (11, (10, 12))])
def test_backlogs_past_the_queues_depth_look_alike(backlog: int, fit: tuple[int, ...]) -> None:
    """Every backlog that fits alike is simulated."""
    log = as_log(simulate("paper-kp4", loop__start_backlog=backlog), hides_start=True)
    found = identify_run(log).findings["loop.start_backlog"]
    assert {*fit} <= {*(found.candidates or (found.value,))}


@pytest.mark.thorough
def test_a_fit_that_the_clock_contradicts_does_not_stop_the_search() -> None:
    run = simulate("paper-kp4", law__pause_ticks=2, loop__start_backlog=11, loop__command_queue=10)
    found = identify_run(as_log(run))
    keys = ("loop.queue_policy", "loop.transport_delay_ticks", "law.pause_ticks")
    assert read_values(found, *keys) == ("one-per-tick", 0, 2)
    assert 11 in found.findings["loop.start_backlog"].candidates


@pytest.mark.everyday("12")
@pytest.mark.parametrize("depth", [1, 2, 12])
def test_an_unusual_pose_queue_is_found(depth: int) -> None:
    changes = {"loop__pose_queue": depth, "loop__start_backlog": 12}
    found = identify_run(as_log(simulate("paper-kp4", **changes)))
    keys = ("loop.start_backlog", "loop.pose_queue", "law.pause_ticks")
    assert read_values(found, *keys) == (depth, depth, 34)
    assert found.resimulation is not None
    assert found.resimulation.is_exact


def test_a_short_queue_behind_a_transport_delay_is_found() -> None:
    changes = {"loop__command_queue": 3, "loop__transport_delay_ticks": 5}
    found = identify_run(forget(simulate("paper-kp4", **changes)))
    assert read_values(found, "loop.command_queue", "loop.transport_delay_ticks") == (3, 5)


def test_what_no_setting_reproduces_is_not_told_as_if_it_were_known() -> None:
    log = simulate("paper-kp4")
    turned = log.poses.heading_rad + 0.05 * np.sin(np.arange(len(log.poses)) / 40.0)
    found = identify_run(replace(forget(log), poses=replace(log.poses, heading_rad=turned)))
    assert {found.findings[key].value for key in ("law.kp_angular", "loop.start_backlog")} == {None}
    assert "rotating: the commands are not proportional" in found.notes[0]


def test_taking_the_newest_is_the_same_as_a_queue_of_one() -> None:
    found = identify_run(forget(simulate("paper-kp4", loop__command_queue=1)))
    policy = found.findings["loop.queue_policy"]
    assert policy.value == "newest"
    assert policy.evidence == "reproduces all 770 samples; so does a command queue of 1"


@pytest.mark.thorough
def test_a_pause_of_one_tick_looks_like_none() -> None:
    found = identify_run(as_log(simulate("paper-kp4", law__pause_ticks=1)))
    pause = found.findings["law.pause_ticks"]
    assert (pause.certainty, sorted(pause.candidates)) == (Certainty.AMBIGUOUS, [0, 1])
    assert (
        "of law.pause_ticks the values 0, 1 fit alike: each reproduces every sample" in found.notes
    )


def test_a_run_cut_while_rotating_tells_what_it_can() -> None:
    found = identify_run(forget(simulate("paper-kp4", max_duration_s=2.5)))
    assert read_values(found, "law.kp_angular", "stop_reason", "loop.start_backlog") == (
        4.0,
        "cut",
        6,
    )
    assert found.findings["law.kp_linear"].evidence == "no command drives"
    assert found.resimulation is not None
    assert found.resimulation.is_exact


@pytest.mark.parametrize("reason", ["max_duration", "interrupted", "law_failed"])
def test_a_run_whose_controller_did_not_come_to_its_end_was_cut(reason: str) -> None:
    run = replace(simulate("paper-kp1", max_duration_s=15.0), stop_reason=reason)
    assert identify_run(run).findings["stop_reason"].value == "cut"


def test_another_kind_of_controller_is_told_from_the_sequential_one() -> None:
    values = {"law.kind": "examples/turn_and_drive.py:TurnAndDrive"}
    scenario = build_scenario(nest_parameters(values), trust_law=True)
    found = identify_run(simulate_run(scenario))
    name = "examples/turn_and_drive.py:TurnAndDrive"
    told = "parameters are identified from commands only for sequential-p"
    assert found.notes[0] == f"its law is {name}: {told}"
    assert (found.scenario, found.resimulation) == (None, None)
    claims = {key: value for key, value in found.findings.items() if key.startswith("law.")}
    assert len(claims) == 7
    assert {finding.certainty for finding in claims.values()} == {Certainty.UNKNOWN}
    assert {finding.evidence for finding in claims.values()} == {found.notes[0]}
    assert read_values(found, "dead_time.align", "dead_time.approach") == (0, 0)
    with pytest.raises(ExplainError, match="or one that its own scenario reproduces"):
        found.build_scenario()


def test_commands_that_do_not_follow_the_error_are_no_proportional_law() -> None:
    run = simulate("paper-kp4")
    rng = np.random.default_rng(0)
    random = rng.uniform(-1.0, 1.0, len(run.samples))
    found = identify_run(replace(run, samples=replace(run.samples, turn_rate_rad_s=random)))
    assert "not proportional to the error" in found.notes[0]


def test_a_real_turtlesim_tells_what_became_of_its_commands() -> None:
    found = identify_run(read_run(find_shared("ros2", "turtlesim_jazzy")))
    assert found.findings["lost_commands"].value == 0
    assert "which pose a command answers is not known" in found.notes[0]
    assert "the largest of 18 commands is 2" in found.findings["limits.speed_m_s"].evidence


def test_an_unclipped_run_has_no_limit() -> None:
    found = identify_run(forget(simulate("textbook", limits__speed_m_s=float("inf"))))
    assert found.findings["limits.speed_m_s"] == Finding(
        certainty=Certainty.UNKNOWN,
        evidence=found.findings["limits.speed_m_s"].evidence,
        assumed=float("inf"),
    )
    assert (
        "no command is clipped; the largest is 5.6" in found.findings["limits.speed_m_s"].evidence
    )


@pytest.mark.parametrize(
    ("changes", "expected"),
    [({"start__heading_rad": 3.0, "goal__y_m": 5.0, "law__wrap_error": True}, True),
     ({"start__heading_rad": 3.0, "goal__y_m": 5.0, "law__wrap_error": False}, False)],
    ids=["wrapped", "plain"],
)  # fmt: skip
def test_wrapping_shows_beyond_half_a_turn(changes: dict[str, Any], expected: bool) -> None:  # noqa: FBT001
    found = identify_run(forget(simulate("textbook", **changes)))
    wrap = found.findings["law.wrap_error"]
    assert (wrap.value, wrap.certainty) == (expected, Certainty.EXACT)


SCENARIOS = st.fixed_dictionaries(
    {
        "goal.x_m": st.integers(5, 105).map(lambda tenths: tenths / 10.0),
        "goal.y_m": st.integers(5, 105).map(lambda tenths: tenths / 10.0),
        "law.kp_angular": st.one_of(st.sampled_from([1.0, 4.0, 10.0]), st.floats(0.5, 12.0)),
        "law.kp_linear": st.one_of(st.sampled_from([1.0, 4.0, 10.0]), st.floats(0.5, 12.0)),
        "law.pause_ticks": st.integers(0, 60),
        "law.projection": st.sampled_from(["bearing", "heading"]),
        "law.wrap_error": st.booleans(),
        "limits.speed_m_s": st.sampled_from([0.5, 1.0, 2.5, float("inf")]),
        "limits.turn_rate_rad_s": st.sampled_from([0.5, 1.0, 2.5, float("inf")]),
        "loop.start_backlog": st.integers(1, 12),
        "loop.queue_policy": st.sampled_from(["newest", "one-per-tick"]),
    }
)


@pytest.mark.thorough
@settings(max_examples=25, deadline=None, derandomize=True)
@given(SCENARIOS, st.booleans(), st.integers(0, 2_000_000), st.integers(0, 2**32 - 1))
def test_what_was_put_in_comes_back_or_the_log_cannot_tell(
    values: dict[str, Any], is_log: bool, jitter_ns: int, seed: int  # noqa: FBT001
) -> None:  # fmt: skip
    """25 random scenarios are searched for: each takes half a second."""
    run = simulate_run(build_scenario(nest_parameters(values)))
    truth = flatten_scenario(restore_scenario(run))
    found = identify_run(as_log(run, jitter_ns=jitter_ns, seed=seed) if is_log else forget(run))
    for key, finding in found.findings.items():
        if key in truth and finding.value is not None:
            assert agrees(key, finding, truth[key]), (key, finding, truth[key])
    assert found.resimulation is not None
    assert found.resimulation.max_abs_error.heading_rad < 1e-6


def agrees(key: str, finding: Finding, truth: Any) -> bool:
    if finding.certainty is Certainty.AMBIGUOUS:
        return truth in finding.candidates
    if finding.certainty is Certainty.BOUNDED:
        assert finding.interval is not None
        return bool(finding.interval[0] <= truth < finding.interval[1])
    if key.startswith(("law.kp", "start")):
        return bool(np.isclose(finding.value, truth, rtol=1e-7, atol=1e-9))
    return bool(finding.value == truth)
