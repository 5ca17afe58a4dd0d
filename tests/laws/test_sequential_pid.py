import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import turtlelog as tl
from tests.laws.sequential_runs import LINEAR, build_run, keep_law, simulate
from turtlelog.errors import ScenarioError
from turtlelog.laws import Goal, Pose, SequentialPID, SequentialPIDParameters
from turtlelog.laws.base import AskedLaw
from turtlelog.scenario import PRESETS, build_scenario, override_scenario

TICK_NS = 16_000_000
START, GOAL = Pose(5.0, 5.0, 0.0), Goal(2.0, 9.0)
BEARING_RAD = math.atan2(4.0, -3.0)


def begin_rotation(limit: float = math.inf, **parameters: Any) -> AskedLaw:
    law = SequentialPID(SequentialPIDParameters(**parameters))
    law.take_limits(math.inf, limit)
    law.reset(START, GOAL, None)
    law.step(0, START)
    return law


def turn(law: AskedLaw, tick: float, heading_rad: float) -> tuple[float, tuple[float, ...]]:
    decision = law.step(int(tick * TICK_NS), Pose(5.0, 5.0, heading_rad))
    return decision.turn_rate_rad_s, decision.states


def compare_with_p(scenario: tl.Scenario) -> None:
    """Require every column of ControlSample to be that of sequential-p, to the last bit."""
    tables = tl.scenario.nest_scenario(scenario)
    tables["law"]["kind"] = "sequential-pid"
    run, same = tl.simulate_run(scenario), tl.simulate_run(build_scenario(tables))
    assert (run.stop_reason, len(run.samples)) == (same.stop_reason, len(same.samples))
    for field in dataclasses.fields(run.samples):
        column = getattr(run.samples, field.name)
        if isinstance(column, np.ndarray):
            assert column.tobytes() == getattr(same.samples, field.name).tobytes(), field.name


SEQUENTIAL = [name for name in PRESETS if tl.load_scenario(name).law.kind == "sequential-p"]


@pytest.mark.parametrize("preset", SEQUENTIAL)
def test_without_integral_and_derivative_it_is_sequential_p(preset: str) -> None:
    compare_with_p(tl.load_scenario(preset))


@pytest.mark.thorough
@settings(deadline=None, max_examples=30)
@given(
    place=st.tuples(*[st.floats(0.0, 11.0)] * 4),
    heading_rad=st.sampled_from([0.0, math.pi / 2.0, -math.pi / 2.0, 3.1, -2.0]),
    gains=st.tuples(st.floats(0.1, 20.0), st.floats(0.1, 20.0)),
    built=st.booleans(),
)
def test_without_integral_and_derivative_it_is_sequential_p_anywhere(
    place: tuple[float, ...],
    heading_rad: float,
    gains: tuple[float, float],
    built: bool,  # noqa: FBT001
) -> None:
    values = dict(zip(("start.x_m", "start.y_m", "goal.x_m", "goal.y_m"), place, strict=True))
    values |= {"start.heading_rad": heading_rad, "max_duration_s": 20.0}
    values |= {"law.kp_angular": gains[0], "law.kp_linear": gains[1]}
    compare_with_p(override_scenario(tl.load_scenario("paper" if built else "textbook"), values))


@pytest.mark.parametrize(("ki", "kd"), [(0.5, 0.0), (0.0, 0.5), (0.5, 0.5)])
def test_terms_of_one_loop_leave_the_bits_of_the_other(ki: float, kd: float) -> None:
    # Heading 0 and an error straight down: the product with its sine is -0.0.
    place: dict[str, Any] = {"start__y_m": 5.0, "goal__y_m": 5.0, "goal__x_m": 9.0}
    base = simulate(kind="sequential-p", **place)
    found = simulate(ki_angular=ki, kd_angular=kd, **place)
    speeds = [run.samples.wanted_speed_m_s for run in (base, found)]
    assert speeds[0] is not None
    assert speeds[1] is not None
    assert speeds[0].tobytes() == speeds[1].tobytes()


def test_first_commands_of_the_phases_are_those_of_the_p_law() -> None:
    gains = {"ki_angular": 2.0, "kd_angular": 0.4, "ki_linear": 2.0, "kd_linear": 0.4}
    run = simulate("paper-kp2", **(keep_law("paper-kp2") | gains), anti_windup="none")
    samples, names = run.samples, np.array(run.phase_names)
    assert samples.states is not None
    assert samples.wanted_speed_m_s is not None
    assert samples.error_xy_m is not None
    assert samples.bearing_rad is not None
    drive = int(np.flatnonzero(names[samples.phase] == "translate")[0])
    assert not samples.states[drive].any()
    b = float(samples.bearing_rad[0])
    x, y = samples.error_xy_m[drive].tolist()
    assert samples.wanted_speed_m_s[drive] == 2.0 * x * math.cos(b) + 2.0 * y * math.sin(b)
    # The ten poses that waited are answered at once: no time passes, and the derivative is 0.
    assert (samples.time_ns[drive : drive + 10] == samples.time_ns[drive]).all()
    assert not samples.states[drive : drive + 10].any()
    assert samples.states[drive + 10, 2] > 0.0
    turn_rate = samples.wanted_turn_rate_rad_s
    assert turn_rate is not None
    assert turn_rate[1] == 2.0 * samples.heading_error_rad[1]  # type: ignore[index]


def test_integral_sums_the_errors_before_a_sample() -> None:
    law = begin_rotation(ki_angular=0.5)
    error_rad = [BEARING_RAD - heading_rad for heading_rad in (0.0, 0.1, 0.3)]
    assert turn(law, 1, 0.0)[0] == error_rad[0]
    assert turn(law, 2, 0.1)[0] == pytest.approx(error_rad[1] + 0.5 * 0.016 * error_rad[0])
    found = turn(law, 4, 0.3)[1][0]
    assert found == pytest.approx(0.5 * (0.016 * error_rad[0] + 0.032 * error_rad[1]), rel=1e-15)


def test_derivative_is_that_of_the_measurement() -> None:
    law = begin_rotation(kd_angular=0.5)
    turn(law, 1, 0.0)
    assert turn(law, 2, 0.01)[1][1] == pytest.approx(-0.5 * 0.01 / 0.016)
    assert turn(law, 3, 0.01)[1][1] == 0.0


def test_filter_of_the_derivative_is_of_first_order() -> None:
    law = begin_rotation(kd_angular=0.5, derivative_filter_s=0.048)
    turn(law, 1, 0.0)
    first = -0.5 * 0.01 / 0.064
    assert turn(law, 2, 0.01)[1][1] == pytest.approx(first)
    assert turn(law, 3, 0.01)[1][1] == pytest.approx(0.75 * first)


@pytest.mark.parametrize("filter_s", [0.0, 0.1])
def test_burst_of_one_time_holds_integral_and_derivative(filter_s: float) -> None:
    law = begin_rotation(ki_angular=0.5, kd_angular=0.5, derivative_filter_s=filter_s)
    turn(law, 1, 0.0)
    held = turn(law, 2, 0.01)[1]
    assert held[0] > 0.0 > held[1]
    for heading_rad in (0.02, 0.03, 0.04):
        assert turn(law, 2, heading_rad)[1] == held
    # The next difference begins at the last pose of the burst: 0.01 rad in one tick, not 0.04.
    integral, derivative, *_ = turn(law, 3, 0.05)[1]
    past = filter_s * held[1] - 0.5 * 0.01
    assert derivative == pytest.approx(past / (filter_s + 0.016))
    assert integral == pytest.approx(held[0] + 0.5 * 0.016 * (BEARING_RAD - 0.04))


WINDUP: dict[str, Any] = {"kp_angular": 1.0, "ki_angular": 0.4, "timeout_s": 60.0}


def measure_windup(rule: str, limit: float) -> tuple[float, float, float]:
    """Return overshoot [% of the step], and the largest and least integral [rad/s]."""
    scenario = build_run(anti_windup=rule, **WINDUP)
    scenario = override_scenario(scenario, {**LINEAR, "limits.turn_rate_rad_s": limit})
    run = tl.simulate_run(scenario)
    assert run.samples.states is not None
    assert run.samples.bearing_rad is not None
    integral = run.samples.states[:, 0]
    peak = np.unwrap(run.poses.heading_rad).max() / run.samples.bearing_rad[0]
    return 100.0 * (float(peak) - 1.0), float(integral.max()), float(integral.min())


def test_integral_winds_up_at_the_limit_and_both_cures_hold_it() -> None:
    wound = measure_windup("none", 0.5)
    clamped = measure_windup("clamping", 0.5)
    tracked = measure_windup("back-calculation", 0.5)
    assert wound == pytest.approx((54.89, 2.0192, -0.0322), abs=0.01)
    assert clamped == pytest.approx((4.10, 0.1355, -0.0024), abs=0.01)
    assert tracked == pytest.approx((2.79, 0.0920, -0.4469), abs=0.01)


def test_rules_against_windup_are_one_where_nothing_is_clipped() -> None:
    found = [measure_windup(rule, math.inf) for rule in ("none", "clamping", "back-calculation")]
    assert found[0] == found[1] == found[2]
    assert found[0][0] == pytest.approx(18.44, abs=0.01)


def test_clamping_holds_only_what_drives_further_beyond_the_limit() -> None:
    law = begin_rotation(0.1, ki_angular=0.5, kd_angular=10.0)
    turn(law, 1, 2.0)  # wants 0.21, clipped: held
    assert turn(law, 2, 2.0)[1][0] == 0.0
    command, states = turn(law, 3, 2.1)  # the derivative drives back beyond the other limit
    assert command < -0.1
    assert states[0] == 0.0
    assert turn(law, 4, 2.1)[1][0] == pytest.approx(0.5 * 0.016 * (BEARING_RAD - 2.1))


def test_back_calculation_tracks_the_limit() -> None:
    law = begin_rotation(0.5, ki_angular=0.5, anti_windup="back-calculation", tracking_time_s=0.16)
    error_rad = BEARING_RAD
    turn(law, 1, 0.0)
    expected = 0.016 * 0.5 * error_rad - 0.1 * (error_rad - 0.5)
    assert turn(law, 2, 0.0)[1][0] == pytest.approx(expected)


def test_tracking_faster_than_samples_goes_back_to_the_limit_and_not_beyond() -> None:
    law = begin_rotation(0.5, ki_angular=0.5, anti_windup="back-calculation", tracking_time_s=1e-9)
    for tick in range(1, 200):
        command = turn(law, tick, 0.0)[0]
    assert command == pytest.approx(0.5 + 0.016 * 0.5 * BEARING_RAD)


def test_derivative_alone_has_no_integral_that_tracks() -> None:
    law = begin_rotation(0.5, kd_angular=0.5, anti_windup="back-calculation")
    assert [turn(law, tick, 0.0)[1][0] for tick in range(1, 5)] == [0.0] * 4


def test_law_forgets_its_last_run() -> None:
    law = begin_rotation(ki_angular=0.5, kd_angular=0.5)
    first = [turn(law, tick, 0.1 * tick) for tick in range(1, 6)]
    law.reset(START, GOAL, None)
    law.step(0, START)
    assert [turn(law, tick, 0.1 * tick) for tick in range(1, 6)] == first


def test_loops_declare_their_gains_and_are_proportional_only_without_more() -> None:
    declared = tl.simulate.declare_scenario(build_run(ki_linear=0.1))
    rotate, translate = declared.loops
    assert (rotate.is_proportional, translate.is_proportional) == (True, False)
    assert translate.integral_gain == "law.ki_linear"
    assert translate.derivative_gain == "law.kd_linear"
    assert translate.derivative_filter == "law.derivative_filter_s"
    assert rotate.integral_gain == "law.ki_angular"
    assert declared.list_gains() == ("law.kp_linear", "law.kp_angular")
    with_derivative = tl.simulate.declare_scenario(build_run(kd_angular=0.1))
    assert [loop.is_proportional for loop in with_derivative.loops] == [False, True]


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        *((key, -0.1, "a number >= 0") for key in ("ki_angular", "kd_angular")),
        *((key, -0.1, "a number >= 0") for key in ("ki_linear", "kd_linear")),
        ("derivative_filter_s", -1e-9, "a number >= 0"),
        ("derivative_filter_s", "slow", "a number >= 0"),
        ("derivative_filter_s", math.inf, "a finite number"),
        ("ki_linear", math.inf, "a finite number"),
        ("kd_linear", math.nan, "a finite number"),
        ("anti_windup", "clamp", "none or clamping or back-calculation"),
        ("tracking_time_s", 0.0, "a number > 0"),
        ("tracking_time_s", math.inf, "a finite number"),
        ("kp_linear", 0.0, "a number > 0"),
    ],
)
def test_wrong_parameter_is_named(key: str, value: Any, expected: str) -> None:
    line = rf"\Achanges: law\.{key}: expected {expected}, found [^\n]+\Z"
    with pytest.raises(ScenarioError, match=line):
        build_run(**{key: value})


def test_run_of_the_law_round_trips() -> None:
    scenario = build_run(ki_linear=0.3, anti_windup="back-calculation", kd_angular=0.1)
    assert tl.scenario.parse_scenario(tl.scenario.format_scenario(scenario)) == scenario
