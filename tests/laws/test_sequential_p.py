import math
from dataclasses import FrozenInstanceError
from types import SimpleNamespace
from typing import Any

import pytest

from turtlelog.laws import Decision, Goal, Pose, SequentialP, SequentialPParameters
from turtlelog.laws.base import AskedLaw
from turtlelog.plants.turtlesim import TICK_NS

START, GOAL = Pose(5.5, 5.5, 0.0), Goal(2.0, 10.0)
BEARING_RAD = math.atan2(4.5, -3.5)
SECOND_NS = 1_000_000_000


def begin_run(start: Pose = START, goal: Goal = GOAL, **parameters: Any) -> AskedLaw:
    as_built: dict[str, Any] = {"projection": "bearing", "wrap_error": False}
    law = SequentialP(SequentialPParameters(**(as_built | parameters)))
    law.reset(start, goal, None)
    law.step(0, start)
    return law


def begin_translation(start: Pose = START, goal: Goal = GOAL, **parameters: Any) -> AskedLaw:
    law = begin_run(start, goal, **parameters)
    law.step(0, Pose(start.x_m, start.y_m, math.atan2(goal.y_m - start.y_m, goal.x_m - start.x_m)))
    return law


def stand_from_goal(*, ahead_m: float = 0.0, aside_m: float = 0.0) -> Pose:
    cos, sin = math.cos(BEARING_RAD), math.sin(BEARING_RAD)
    x_m = GOAL.x_m - ahead_m * cos + aside_m * sin
    return Pose(x_m, GOAL.y_m - ahead_m * sin - aside_m * cos, BEARING_RAD)


def step_often(law: AskedLaw, pose: Pose, samples: int) -> list[str | None]:
    return [law.step(sample * TICK_NS, pose).stop_reason for sample in range(samples)]


def get_command(decision: Decision) -> tuple[float, float]:
    return decision.speed_m_s, decision.turn_rate_rad_s


def test_parameters_default_to_the_textbook() -> None:
    parameters = SequentialPParameters()
    assert (parameters.projection, parameters.wrap_error) == ("heading", True)
    assert parameters.pause_ticks == 0


def test_parameters_are_frozen() -> None:
    with pytest.raises(FrozenInstanceError):
        SequentialPParameters().kp_linear = 2.0  # type: ignore[misc]


def test_first_callback_only_computes_the_bearing() -> None:
    law = SequentialP(SequentialPParameters(kp_angular=10.0))
    law.reset(START, GOAL, None)
    decision = law.step(0, START)
    assert get_command(decision) == (0.0, 0.0)
    assert (decision.bearing_rad, decision.heading_error_rad) == (BEARING_RAD, 0.0)
    assert (decision.error_x_m, decision.error_y_m) == (-3.5, 4.5)
    assert (decision.phase, decision.blocks_ticks) == ("rotate", 0)


def test_first_callback_computes_no_command_even_at_the_goal_bearing() -> None:
    law = begin_run(Pose(5.5, 5.5, BEARING_RAD))
    assert law.step(TICK_NS, Pose(5.5, 5.5, BEARING_RAD)).phase == "rotate"
    assert law.step(TICK_NS, Pose(5.5, 5.5, BEARING_RAD)).phase == "translate"


@pytest.mark.parametrize("heading_rad", [0.0, 1.0, 2.9, BEARING_RAD + 0.0011])
def test_rotation_is_proportional_to_the_heading_error(heading_rad: float) -> None:
    decision = begin_run(kp_angular=4.0).step(TICK_NS, Pose(5.5, 5.5, heading_rad))
    assert decision.heading_error_rad == BEARING_RAD - heading_rad
    assert get_command(decision) == (0.0, 4.0 * (BEARING_RAD - heading_rad))
    assert (decision.phase, decision.blocks_ticks) == ("rotate", 0)


def test_wanted_commands_are_not_clipped_by_the_law() -> None:
    assert begin_run(kp_angular=10.0).step(TICK_NS, START).turn_rate_rad_s > 20.0
    far = Pose(9.0, 1.0, BEARING_RAD)
    assert begin_translation(kp_linear=10.0).step(TICK_NS, far).speed_m_s > 20.0


def test_law_keeps_the_bearing_of_its_start() -> None:
    law = begin_run()
    assert law.step(TICK_NS, Pose(1.0, 1.0, 0.0)).bearing_rad == BEARING_RAD


@pytest.mark.parametrize("offset_rad", [-0.0009, 0.0, 0.0009])
def test_rotation_ends_within_its_tolerance_and_pauses(offset_rad: float) -> None:
    law = begin_run(pause_ticks=34)
    decision = law.step(TICK_NS, Pose(5.5, 5.5, BEARING_RAD + offset_rad))
    assert get_command(decision) == (0.0, 0.0)
    assert (decision.phase, decision.blocks_ticks) == ("rotate", 34)
    assert decision.ends_phase
    assert law.step(TICK_NS, Pose(5.5, 5.5, 0.0)).phase == "translate"


@pytest.mark.parametrize(
    ("wrap_error", "error_rad"),
    [(False, -6.0), (True, math.tau - 6.0)],
    ids=["as-built", "wrapped"],
)
def test_error_across_the_half_turn_is_wrapped_on_request(
    wrap_error: bool,  # noqa: FBT001
    error_rad: float,
) -> None:
    start = Pose(5.0, 5.0, 3.0)
    goal = Goal(5.0 + 3.0 * math.cos(3.0), 5.0 - 3.0 * math.sin(3.0))
    decision = begin_run(start, goal, kp_angular=2.0, wrap_error=wrap_error).step(TICK_NS, start)
    assert decision.heading_error_rad == pytest.approx(error_rad)
    assert decision.turn_rate_rad_s == pytest.approx(2.0 * error_rad)


def test_translation_as_built_projects_on_the_bearing() -> None:
    decision = begin_translation(kp_linear=2.0).step(TICK_NS, Pose(4.0, 7.0, 0.3))
    along = 2.0 * -2.0 * math.cos(BEARING_RAD) + 2.0 * 3.0 * math.sin(BEARING_RAD)
    assert get_command(decision) == pytest.approx((along, 0.0))
    assert (decision.world_v_x_m_s, decision.world_v_y_m_s) == (-4.0, 6.0)


def test_translation_as_equation_16_projects_on_the_heading() -> None:
    law = begin_translation(kp_linear=2.0, projection="heading")
    decision = law.step(TICK_NS, Pose(4.0, 7.0, 0.3))
    assert decision.speed_m_s == pytest.approx(-4.0 * math.cos(0.3) + 6.0 * math.sin(0.3))


def test_projections_agree_on_the_goal_bearing() -> None:
    pose = Pose(4.0, 7.0, BEARING_RAD)
    speeds = [
        begin_translation(projection=name).step(TICK_NS, pose).speed_m_s
        for name in ("bearing", "heading")
    ]
    assert speeds[0] == speeds[1]


def test_translation_holds_the_last_heading_error() -> None:
    law = begin_run()
    held_rad = law.step(TICK_NS, Pose(5.5, 5.5, BEARING_RAD - 0.0005)).heading_error_rad
    assert held_rad == pytest.approx(0.0005)
    assert law.step(TICK_NS, Pose(5.5, 5.5, 0.0)).heading_error_rad == held_rad


def test_run_stops_within_the_position_tolerance_with_command_zero() -> None:
    law = begin_translation()
    before = law.step(TICK_NS, Pose(2.002, 10.0, BEARING_RAD))
    decision = law.step(TICK_NS, Pose(2.0009, 9.9991, BEARING_RAD))
    assert (decision.stop_reason, decision.speed_m_s) == ("within_tolerance", 0.0)
    assert decision.world_v_x_m_s == before.world_v_x_m_s != 0.0
    assert decision.error_x_m == pytest.approx(-0.0009)


@pytest.mark.parametrize("pose", [Pose(2.0011, 10.0, 0.0), Pose(2.0, 9.9989, 0.0)], ids="xy")
def test_run_goes_on_while_one_error_is_larger(pose: Pose) -> None:
    assert begin_translation().step(TICK_NS, pose).stop_reason is None


def test_run_stops_after_more_than_100_samples_of_standstill() -> None:
    stops = step_often(begin_translation(), stand_from_goal(ahead_m=0.0009, aside_m=0.5), 101)
    assert stops == [None] * 100 + ["standstill"]


def test_standstill_repeats_its_last_command() -> None:
    law, pose = begin_translation(), stand_from_goal(ahead_m=0.0009, aside_m=0.5)
    step_often(law, pose, 100)
    assert law.step(100 * TICK_NS, pose).speed_m_s == pytest.approx(0.0009)


def test_standstill_counts_consecutive_samples() -> None:
    law, still = begin_translation(), stand_from_goal(aside_m=0.5)
    step_often(law, still, 100)
    assert law.step(0, stand_from_goal(ahead_m=0.5)).stop_reason is None
    assert step_often(law, still, 101) == [None] * 100 + ["standstill"]


def test_standstill_needs_a_small_command() -> None:
    slow = stand_from_goal(ahead_m=0.0011, aside_m=0.5)
    assert set(step_often(begin_translation(), slow, 200)) == {None}


@pytest.mark.parametrize(
    ("after_ns", "stop_reason"), [(5 * SECOND_NS, None), (5 * SECOND_NS + 1, "settled")]
)
def test_run_stops_when_settled_for_more_than_5_s(after_ns: int, stop_reason: str | None) -> None:
    law, close = begin_translation(), stand_from_goal(ahead_m=0.009)
    assert law.step(SECOND_NS, close).stop_reason is None
    decision = law.step(SECOND_NS + after_ns, close)
    assert decision.stop_reason == stop_reason
    assert decision.speed_m_s == pytest.approx(0.009)


def test_settling_starts_again_after_an_error_of_a_centimetre() -> None:
    law, close = begin_translation(), stand_from_goal(ahead_m=0.009)
    law.step(0, close)
    law.step(3 * SECOND_NS, Pose(GOAL.x_m, GOAL.y_m - 0.011, BEARING_RAD))
    assert law.step(6 * SECOND_NS, close).stop_reason is None
    assert law.step(11 * SECOND_NS, close).stop_reason is None
    assert law.step(11 * SECOND_NS + 1, close).stop_reason == "settled"


def test_run_stops_30_s_after_its_first_sample() -> None:
    law, far = SequentialP(SequentialPParameters()), Pose(5.5, 5.5, BEARING_RAD)
    law.reset(START, GOAL, None)
    law.step(7 * SECOND_NS, START)
    law.step(8 * SECOND_NS, far)
    assert law.step(37 * SECOND_NS - TICK_NS, far).stop_reason is None
    decision = law.step(37 * SECOND_NS + TICK_NS, far)
    assert decision.stop_reason == "timeout"
    assert decision.speed_m_s == pytest.approx(math.hypot(3.5, 4.5))


@pytest.mark.parametrize("timeout_s", [8.0, 45.0, math.inf])
def test_the_timeout_is_a_parameter(timeout_s: float) -> None:
    law, far = begin_translation(timeout_s=timeout_s), stand_from_goal(ahead_m=3.0)
    at_ns = int(min(timeout_s, 1e6) * SECOND_NS)
    assert law.step(at_ns, far).stop_reason is None
    after = law.step(at_ns + 1, far).stop_reason
    assert after == (None if math.isinf(timeout_s) else "timeout")


def test_settling_is_judged_by_its_parameters() -> None:
    law, close = begin_translation(settled_within_m=0.05, settled_for_s=2.0), Pose(2.04, 9.96, 0.0)
    assert law.step(0, close).stop_reason is None
    assert law.step(2 * SECOND_NS, close).stop_reason is None
    assert law.step(2 * SECOND_NS + 1, close).stop_reason == "settled"
    outside = begin_translation(settled_within_m=0.04, settled_for_s=2.0)
    assert {outside.step(second * SECOND_NS, close).stop_reason for second in range(9)} == {None}


def test_a_standstill_is_judged_by_its_parameters() -> None:
    slow = stand_from_goal(ahead_m=0.0019, aside_m=0.5)
    law = begin_translation(standstill_samples=20, standstill_below=0.002)
    assert step_often(law, slow, 21) == [None] * 20 + ["standstill"]
    law = begin_translation(standstill_samples=20, standstill_below=0.0018)
    assert {*step_often(law, slow, 200)} == {None}


def test_nothing_limits_how_long_rotating_may_take() -> None:
    assert begin_run().step(1000 * SECOND_NS, START).stop_reason is None


def reset_and_translate(law: AskedLaw, time_ns: int) -> None:
    law.reset(START, GOAL, None)
    law.step(time_ns, START)
    law.step(time_ns, Pose(START.x_m, START.y_m, BEARING_RAD))


def test_reset_begins_with_a_new_bearing() -> None:
    law = begin_translation()
    law.reset(Pose(1.0, 1.0, 0.0), Goal(1.0, 2.0), None)
    decision = law.step(0, Pose(1.0, 1.0, 0.0))
    assert (decision.phase, decision.bearing_rad) == ("rotate", math.pi / 2)
    assert decision.heading_error_rad == 0.0


def test_reset_forgets_the_standstill() -> None:
    law, still = begin_translation(), stand_from_goal(aside_m=0.5)
    step_often(law, still, 100)
    reset_and_translate(law, 0)
    assert step_often(law, still, 101) == [None] * 100 + ["standstill"]


def test_reset_forgets_the_settling() -> None:
    law, close = begin_translation(), stand_from_goal(ahead_m=0.009)
    law.step(0, close)
    reset_and_translate(law, 6 * SECOND_NS)
    assert law.step(6 * SECOND_NS, close).stop_reason is None


def test_reset_forgets_the_first_sample() -> None:
    law = begin_translation()
    reset_and_translate(law, 40 * SECOND_NS)
    assert law.step(41 * SECOND_NS, Pose(4.0, 7.0, BEARING_RAD)).stop_reason is None


def test_reset_forgets_the_held_velocity() -> None:
    law = begin_translation()
    assert law.step(0, Pose(4.0, 7.0, BEARING_RAD)).world_v_x_m_s == -2.0
    reset_and_translate(law, 0)
    assert law.step(0, Pose(GOAL.x_m, GOAL.y_m, BEARING_RAD)).world_v_x_m_s == 0.0


def test_it_does_not_use_the_goal_heading_unless_it_turns_to_it_at_the_end() -> None:
    assert SequentialP.list_unused(SequentialPParameters()) == ("path", "goal.heading_rad")
    turning: Any = SimpleNamespace(reorient=True)
    assert SequentialP.list_unused(turning) == ("path",)
