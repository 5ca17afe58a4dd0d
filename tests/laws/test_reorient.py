import math
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from tests.laws.sequential_runs import build_run
from turtlelog.charts.curves import list_levels
from turtlelog.errors import LawError
from turtlelog.explain import identify_run
from turtlelog.laws import Goal, Pose, SequentialP, SequentialPParameters
from turtlelog.scenario import override_scenario

BOTH = pytest.mark.parametrize("kind", ["sequential-p", "sequential-pid"])
TICK_NS = 16_000_000
GOAL_RAD = 1.0


def build_reorienting(
    preset: str = "textbook", *, kind: str = "sequential-p", **changes: Any
) -> tl.Scenario:
    values = {"kp_angular": 4.0, "kp_linear": 4.0, "reorient": True, "goal__heading_rad": GOAL_RAD}
    return build_run(preset, kind=kind, **(values | changes))


@BOTH
@pytest.mark.parametrize("heading_rad", [*np.linspace(-math.pi, math.pi, 9).tolist(), 6.0, -6.0])
def test_headings_all_around_are_reached(kind: str, heading_rad: float) -> None:
    run = tl.simulate_run(build_reorienting(kind=kind, goal__heading_rad=heading_rad))
    left_rad = math.remainder(float(run.poses.heading_rad[-1]) - heading_rad, math.tau)
    assert abs(left_rad) <= 0.001 + 1e-6
    assert run.stop_reason == "within_tolerance"
    names = np.array(run.phase_names)[run.samples.phase].tolist()
    assert [*dict.fromkeys(names)] == ["rotate", "translate", "reorient"]
    assert run.samples.speed_m_s[run.samples.phase == run.phase_names.index("reorient")].any() == 0


def test_goal_heading_beyond_the_half_turn_is_reached_without_wrapping_too() -> None:
    # 6 rad is no heading of a pose: an error that is not wrapped would never be less than 2.8 rad.
    run = tl.simulate_run(build_reorienting(goal__heading_rad=6.0, wrap_error=False))
    assert run.stop_reason == "within_tolerance"
    assert run.poses.heading_rad[-1] == pytest.approx(6.0 - math.tau, abs=0.0011)


def test_loop_and_phase_are_declared_only_where_it_reorients() -> None:
    declared = tl.simulate.declare_scenario(build_reorienting())
    assert [*declared.phases] == ["rotate", "pause", "translate", "reorient"]
    loop = declared.find_loop("reorient")
    assert loop is not None
    assert (loop.signal, loop.command, loop.reference) == ("heading", "turn_rate", "goal_heading")
    assert (loop.gain, loop.is_proportional) == ("law.kp_angular", True)
    assert tl.simulate.declare_scenario(build_run()).find_loop("reorient") is None


def test_metrics_are_those_of_a_loop_and_the_final_error_is_that_of_the_goal() -> None:
    run = tl.simulate_run(build_reorienting())
    found = tl.measure.measure_run(run)
    left_rad = GOAL_RAD - float(run.poses.heading_rad[-1])
    assert found["final.heading_error"].value == pytest.approx(abs(math.degrees(left_rad)))
    assert found["reorient.final_error"].value == pytest.approx(abs(math.degrees(left_rad)))
    assert found["reorient.settling_time"].value is not None
    assert found["reorient.duration"].value is not None


@pytest.mark.parametrize("preset", ["textbook", "paper"])
def test_translation_is_that_of_a_run_without(preset: str) -> None:
    run = tl.simulate_run(build_reorienting(preset))
    base = tl.simulate_run(build_reorienting(preset, reorient=False))
    rows = len(base.samples)
    assert base.samples.wanted_speed_m_s is not None
    assert run.samples.wanted_speed_m_s is not None
    assert run.samples.speed_m_s[:rows].tobytes() == base.samples.speed_m_s.tobytes()
    assert run.samples.turn_rate_rad_s[:rows].tobytes() == base.samples.turn_rate_rad_s.tobytes()
    assert base.stop_reason in {"within_tolerance", "standstill", "settled"}
    assert len(run.samples) > rows


@pytest.mark.parametrize(
    ("reason", "changes"),
    [
        ("within_tolerance", {"position_tolerance_m": 0.02}),
        ("settled", {"settled_for_s": 0.1, "position_tolerance_m": 1e-9}),
        ("standstill", {"standstill_below": 0.01, "position_tolerance_m": 1e-9}),
    ],
)
def test_each_end_of_the_translation_but_the_timeout_leads_on(
    reason: str, changes: dict[str, Any]
) -> None:
    assert tl.simulate_run(build_reorienting(**changes, reorient=False)).stop_reason == reason
    run = tl.simulate_run(build_reorienting(**changes))
    assert run.stop_reason == "within_tolerance"
    assert run.phase_names[run.samples.phase[-1]] == "reorient"


def test_timeout_of_the_translation_ends_the_run() -> None:
    run = tl.simulate_run(build_reorienting(timeout_s=4.0))
    assert run.stop_reason == "timeout"
    assert run.phase_names[run.samples.phase[-1]] == "translate"


@pytest.mark.parametrize(("timeout_s", "reason"), [(1.0, "timeout"), (math.inf, None)])
def test_reorientation_ends_by_the_timeout(timeout_s: float, reason: str | None) -> None:
    parameters = SequentialPParameters(reorient=True, timeout_s=timeout_s)
    law = SequentialP(parameters)
    law.reset(Pose(5.0, 5.0, 0.0), Goal(6.0, 5.0, 1.0), None)
    for pose in (Pose(5.0, 5.0, 0.0), Pose(5.0, 5.0, 0.0), Pose(6.0, 5.0, 0.0)):
        decision = law.step(0, pose)
    assert (decision.ends_phase, decision.stop_reason) == (True, None)
    turning = law.step(1_000_000_000, Pose(6.0, 5.0, 0.0))
    assert (turning.phase, turning.turn_rate_rad_s, turning.stop_reason) == ("reorient", 1.0, None)
    late = law.step(1_000_000_001, Pose(6.0, 5.0, 0.5))
    assert (late.turn_rate_rad_s, late.stop_reason) == (0.5, reason)


@pytest.mark.parametrize(("lacks_rad", "ends"), [(0.00099, True), (0.00101, False)])
def test_reorientation_ends_within_the_heading_tolerance(
    lacks_rad: float,
    ends: bool,  # noqa: FBT001
) -> None:
    law = SequentialP(SequentialPParameters(reorient=True))
    law.reset(Pose(5.0, 5.0, 0.0), Goal(6.0, 5.0, 1.0), None)
    for pose in (Pose(5.0, 5.0, 0.0), Pose(5.0, 5.0, 0.0), Pose(6.0, 5.0, 0.0)):
        law.step(0, pose)
    decision = law.step(TICK_NS, Pose(6.0, 5.0, 1.0 - lacks_rad))
    assert decision.heading_error_rad == pytest.approx(lacks_rad)
    assert (decision.stop_reason == "within_tolerance") is ends
    assert (decision.turn_rate_rad_s == 0.0) is ends


def test_integral_of_the_rotation_does_not_reach_the_reorientation() -> None:
    run = tl.simulate_run(build_reorienting(kind="sequential-pid", ki_angular=1.0, kd_angular=0.2))
    assert run.samples.states is not None
    first = int(np.flatnonzero(run.samples.phase == run.phase_names.index("reorient"))[0])
    assert not run.samples.states[first].any()
    assert run.samples.states[first + 2 :, 1].any()


@BOTH
def test_goal_heading_is_drawn_on_the_turn_on_which_it_is_reached(kind: str) -> None:
    # From 128 deg over the half turn to 303 deg, which is -57.
    run = tl.simulate_run(build_reorienting(kind=kind, goal__heading_rad=-1.0))
    levels = {level.label: level.value for level in list_levels(run, "heading")}
    assert levels["goal heading"] == pytest.approx(360.0 - math.degrees(1.0))
    assert levels["goal bearing"] == pytest.approx(128.5, abs=0.1)


@BOTH
def test_goal_without_heading_is_refused_before_the_run(kind: str) -> None:
    scenario = build_run(kind=kind, reorient=True)
    line = r"\Alaw\.reorient: needs a goal with a heading to turn to \(goal\.heading_rad\)\Z"
    with pytest.raises(LawError, match=line):
        tl.simulate_run(scenario)
    tl.simulate.declare_scenario(override_scenario(scenario, {"goal.heading_rad": 0.0}))


@BOTH
def test_nothing_is_identified_of_a_run_that_reorients(kind: str) -> None:
    run = tl.simulate_run(build_reorienting(kind=kind))
    found = identify_run(run)
    told = [key for key, finding in found.findings.items() if finding.value is not None]
    assert not [key for key in told if key.startswith("law.")]
    assert found.is_recorded
    if kind == "sequential-p":
        assert found.notes[0].endswith("only for sequential-p that rotates and translates")
