"""Loops around robots with limits: what theory knows of them, and what it leaves out."""

import math
from dataclasses import replace
from typing import Any

import pytest

import turtlelog as tl
from turtlelog.errors import TheoryError
from turtlelog.simulate import list_scenario_notes
from turtlelog.theory import LoopModel, PidGains, StepLimits
from turtlelog.theory.loop_design import TOO_SLOW, LoopDesign, find_p_without_any_overshoot

LIMITS = {"limits.turn_rate_rad_s": 2.0, "limits.speed_m_s": 1.0}
LAG = {"plant.turn_lag_s": 0.1, "plant.speed_lag_s": 0.1}


def build(**changes: Any) -> tl.Scenario:
    values = {key.replace("__", "."): value for key, value in changes.items()}
    return tl.override_scenario(tl.load_scenario("lagged"), {**LIMITS, **LAG, **values})


def model(**changes: Any) -> LoopModel:
    scenario = build(**changes)
    declaration = tl.simulate.declare_scenario(scenario)
    loops = tl.theory.model_loops(declaration, tl.scenario.flatten_scenario(scenario))
    return next(loop for loop in loops if loop.loop.name == "rotate")


INF = float("inf")


@pytest.mark.parametrize(
    ("changes", "acts"),
    [
        ({}, False),
        # 2 rad/s within the time constant of 0.1 s are 20 rad/s^2.
        ({"plant__turn_acceleration": 19.9}, True),
        ({"plant__turn_acceleration": 20.1}, False),
        ({"plant__turn_acceleration": 9.9, "plant__turn_bound": 1.0}, True),
        ({"plant__turn_acceleration": 10.1, "plant__turn_bound": 1.0}, False),
        ({"plant__turn_acceleration": 9.9, "plant__turn_gain": 0.5}, True),
        ({"plant__turn_acceleration": 10.1, "plant__turn_gain": 0.5}, False),
        ({"plant__turn_acceleration": 20.1, "limits__turn_rate_rad_s": INF}, True),
        ({"plant__speed_acceleration": 1.0}, False),
        ({"plant__turn_bound": 0.5}, False),
        ({"limits__turn_acceleration_rad_s2": 4.0}, True),
        ({"limits__turn_jerk_rad_s3": 4.0}, True),
        ({"limits__acceleration_m_s2": 4.0, "limits__jerk_m_s3": 4.0}, False),
    ],
)
def test_limits_of_the_acceleration_count_if_they_act(
    changes: dict[str, float], *, acts: bool
) -> None:
    found = model(**changes)
    assert (found.limits is not None) == acts
    # The loop itself is the linear one, of small steps.
    assert found.require()[1]["process"].lag_s == found.require_latest()["process"].lag_s == 0.1


@pytest.mark.parametrize(
    ("goal", "acceleration", "step_rad"),
    [
        ((2.0, 10.0), 100.0, 2.2318),
        ((9.0, 2.0), 100.0, 0.7854),
        ((9.0, 5.5), 100.0, 0.5 * math.pi),  # no turn to the goal: a quarter turn
        # To 2 rad/s the robot turns by 2^2 / 4 rad, or by more than half a turn.
        ((9.0, 2.0), 4.0, 1.0),
        ((9.0, 2.0), 1.0, math.pi),
    ],
)
def test_the_largest_step_is_that_to_the_goal_or_that_to_the_largest_rate(
    goal: tuple[float, float], acceleration: float, step_rad: float
) -> None:
    start = {"start__x_m": 5.5, "start__y_m": 5.5, "start__heading_rad": 0.0}
    ends = {"goal__x_m": goal[0], "goal__y_m": goal[1]}
    limits = model(**start, **ends, limits__turn_acceleration_rad_s2=acceleration).limits
    assert limits is not None
    assert limits.step == pytest.approx(step_rad, abs=1e-4)
    goal_rad = abs(math.atan2(goal[1] - 5.5, goal[0] - 5.5)) or 0.5 * math.pi
    sizes = [one.step for one in limits.list_steps()]
    assert goal_rad == pytest.approx(sizes[-1] if step_rad > goal_rad + 1e-3 else sizes[0])
    assert min(sizes) == pytest.approx(min(4.0 / acceleration, step_rad) / 4.0, abs=1e-4)


HARD = {
    "law.heading_tolerance_rad": 1e-6,
    "law.position_tolerance_m": 1e-6,
    "law.settled_for_s": INF,
    "law.standstill_samples": 1_000_000,
    "loop.pose_precision": "float64",
    "start.x_m": 5.5,
    "start.y_m": 5.5,
    "start.heading_rad": 0.0,
    "goal.y_m": 5.5,
    "max_duration_s": 60.0,
}


def drive(distance_m: float, keys: dict[str, Any]) -> tuple[float, float | None]:
    """Return overshoot [%] and settling time [s] of a simulated drive straight ahead."""
    scenario = tl.override_scenario(
        tl.load_scenario("lagged"), {**HARD, **LIMITS, **keys, "goal.x_m": 5.5 + distance_m}
    )
    metrics = tl.measure_run(tl.simulate_run(scenario))
    overshoot, settling = (metrics[f"translate.{one}"].value for one in ("overshoot", KIND))
    assert isinstance(overshoot, float)
    return overshoot, settling if isinstance(settling, float) else None


KIND = "settling_time"
RAMPS = {
    "acceleration": {"limits.acceleration_m_s2": 0.3},
    "jerk": {"limits.acceleration_m_s2": 0.6, "limits.jerk_m_s3": 0.8},
    "jerk alone": {"limits.jerk_m_s3": 0.5},
    "own acceleration": {"plant.speed_acceleration": 0.3, "plant.speed_bound": 0.7},
    "own acceleration without lag": {"plant.speed_acceleration": 0.3, "plant.speed_lag_s": 0.0},
}


def model_drive(keys: dict[str, Any]) -> LoopModel:
    changes = {key.replace(".", "__"): value for key, value in keys.items()}
    scenario = build(**changes)
    declaration = tl.simulate.declare_scenario(scenario)
    loops = tl.theory.model_loops(declaration, tl.scenario.flatten_scenario(scenario))
    return next(loop for loop in loops if loop.loop.name == "translate")


@pytest.mark.parametrize("kind", RAMPS)
@pytest.mark.parametrize(("kp", "distance_m"), [(0.4, 4.0), (0.7, 1.5), (0.7, 5.0)])
def test_a_limited_step_moves_like_a_simulated_drive(
    kind: str, kp: float, distance_m: float
) -> None:
    found = model_drive(RAMPS[kind])
    assert found.limits is not None
    limits = replace(found.limits, step=distance_m, also=0.0)
    gains = PidGains(kp=kp)
    motion = tl.theory.measure_step_motion(gains, **found.require()[1], limits=limits)
    assert motion is not None
    overshoot, settling_s = drive(distance_m, {**LAG, **RAMPS[kind], "law.kp_linear": kp})
    # A run measures at its poses, which are 50 ms apart.
    assert motion.overshoot_percent == pytest.approx(max(overshoot, 0.0), abs=0.05)
    assert motion.settling_time_s == pytest.approx(settling_s, abs=0.05)


@pytest.mark.parametrize("kind", RAMPS)
def test_recommended_gains_overshoot_as_wanted_in_the_worst_step(kind: str) -> None:
    """Gains are searched, and five drives simulated for each of two, which takes 2 to 5 s."""
    found = model_drive(RAMPS[kind])
    settings = found.require_latest()
    best = tl.theory.recommend_gains(**settings, limits=found.limits)[0]
    assert best.gains is not None
    assert best.motion is not None
    assert best.motion.overshoot_percent == pytest.approx(5.0, abs=1e-3)

    def find_worst(kp: float) -> float:
        keys = {**LAG, **RAMPS[kind], "law.kp_linear": kp}
        return max(drive(share * 6.3, keys)[0] for share in SHARES)

    # The drives lie between the steps that were measured, where a jerk alone overshoots by 5.51 %.
    most = 5.6 if kind == "jerk alone" else 5.5
    assert find_worst(best.gains.kp) < most
    assert find_worst(1.1 * best.gains.kp) > most


SHARES = (0.84, 0.6, 0.42, 0.3, 0.2)


def test_steps_between_the_simulated_ones_overshoot_at_most_half_more() -> None:
    """Hundreds of steps are simulated, which takes 1 to 4 s."""
    limits = StepLimits(step=2.25, command=1.0, acceleration=2.0, jerk=10.0)
    process = tl.theory.Process(dead_time_s=0.05)
    best = tl.theory.recommend_gains(process, period_s=0.05, limits=limits)[0]
    assert best.gains is not None

    def find_worst(kp: float) -> float:
        """Return the largest overshoot [%] of steps that differ by 1 %."""
        sizes = (replace(limits, step=2.25 * 0.99**one) for one in range(200))
        gains = PidGains(kp=kp)
        motions = [
            tl.theory.measure_step_motion(
                gains, period_s=0.05, process=process, to_rest=False, limits=one
            )
            for one in sizes
        ]
        return max(one.overshoot_percent for one in motions if one)

    assert 4.9 < find_worst(best.gains.kp) < 7.5
    assert find_worst(1.2 * best.gains.kp) > 7.5


@pytest.mark.parametrize(
    ("limit", "fast", "slow"),
    [("command", 0.063, 0.062), ("acceleration", 0.0079, 0.0077), ("jerk", 0.0005, 0.00048)],
)
def test_limits_that_make_a_step_last_too_long_leave_no_gains(
    limit: str, fast: float, slow: float
) -> None:
    rest = {"command": 1.0, "acceleration": 2.0} if limit == "command" else {"command": INF}

    def is_slow(value: float) -> bool:
        limits = StepLimits(step=2.0, **{**rest, limit: value})
        return LoopDesign(process=tl.theory.Process(), period_s=0.016, limits=limits).is_slow

    assert not is_slow(fast)
    assert is_slow(slow)
    limits = StepLimits(step=2.0, **{**rest, limit: slow})
    found = tl.theory.recommend_gains(period_s=0.016, limits=limits)
    assert TOO_SLOW in {one.reason for one in found}
    assert not any(one.gains for one in found)


def test_the_search_of_a_gain_ends_where_no_motion_can_end(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("step_motion", "loop_design"):
        monkeypatch.setattr(f"turtlelog.theory.{name}.LONGEST_MOTION", 300)
    limits = StepLimits(step=5.0, command=1.0, acceleration=1e-5)
    design = LoopDesign(process=tl.theory.Process(), period_s=0.016, limits=limits)
    with pytest.raises(TheoryError, match="comes to rest"):
        find_p_without_any_overshoot(design)


@pytest.mark.parametrize(
    ("acceleration", "jerk", "kp"), [(0.5, INF, 1.0), (0.5, 1.0, 0.8), (INF, 0.3, 0.548)]
)
def test_p_without_overshoot_is_at_most_the_gain_of_a_ramp_or_s_curve(
    acceleration: float, jerk: float, kp: float
) -> None:
    """Kp is 2 divided by the duration of the ramp to 1 m/s, for a long distance."""
    limits = StepLimits(step=20.0, command=1.0, acceleration=acceleration, jerk=jerk)
    (one, *_) = tl.theory.recommend_gains(period_s=0.016, overshoot_percent=0.0, limits=limits)
    assert one.gains is not None
    assert 0.5 * kp < one.gains.kp <= kp


def test_a_step_that_oscillates_on_has_no_settling_time() -> None:
    limits = StepLimits(step=5.693, command=1.0, jerk=0.3)

    def settle(kp: float) -> float | None:
        gains = PidGains(kp=kp)
        motion = tl.theory.measure_step_motion(gains, period_s=0.05, limits=limits)
        assert motion is not None
        return motion.settling_time_s

    assert settle(0.8) is not None
    assert settle(1.0) is None
    found = tl.theory.recommend_gains(period_s=0.05, overshoot_percent=None, limits=limits)
    reason = "under the limits of acceleration, a step oscillates and does not settle"
    assert {one.reason for one in found if one.controller == "P"} == {reason}
    given = tl.theory.measure_gains(PidGains(kp=1.0), period_s=0.05, limits=limits)
    assert given.gains is not None


def test_a_loop_has_the_larger_gain_of_both_directions() -> None:
    gains = [(0.9, 0.7), (0.7, 0.9)]
    found = [model(plant__turn_gain=one, plant__turn_reverse_gain=other) for one, other in gains]
    assert [one.require()[1]["process"].gain for one in found] == [0.9, 0.9]
    assert "plant.turn_reverse_gain = 0.7" in [one.describe() for one in found[0].left_out]


def test_what_theory_leaves_out_of_a_robot_with_limits_is_named() -> None:
    limits = {
        "plant__turn_acceleration": 4.0,
        "plant__turn_bound": 1.0,
        "plant__turn_deadband": 0.1,
    }
    found = model(**limits, plant__speed_bound=0.5).left_out
    own = [one.describe() for one in found if one.key.startswith("plant.")]
    assert own == [
        "plant.turn_bound = 1",
        "plant.turn_acceleration = 4",
        "plant.turn_deadband = 0.1",
    ]


@pytest.mark.parametrize(
    ("limits", "is_told"),
    [
        ({}, True),
        ({"plant__turn_bound": 0.5, "plant__turn_acceleration": 2.0}, True),
        # The loop may come to rest within a deadband, and have the smaller gain.
        ({"plant__turn_deadband": 0.1}, False),
        ({"plant__turn_reverse_gain": 0.1}, False),
    ],
)
def test_a_loop_is_called_unstable_where_no_limit_can_steady_it(
    limits: dict[str, float], *, is_told: bool
) -> None:
    notes = list_scenario_notes(build(law__kp_angular=30.0, **limits))
    assert any("becomes unstable" in note for note in notes) is is_told


def test_a_gain_backwards_of_the_wrong_sign_is_told() -> None:
    notes = list_scenario_notes(build(plant__turn_reverse_gain=-0.5))
    assert any("plant.turn_reverse_gain = -0.5 feeds the error back" in note for note in notes)


@pytest.mark.parametrize("key", ["plant.turn_gain", "plant.turn_reverse_gain"])
def test_a_gain_of_the_wrong_sign_has_no_model(key: str) -> None:
    name = key.replace(".", "__")
    wrong = model(**{name: -0.01})
    assert wrong.reason == (
        f"{key} = -0.01 feeds the error back with the wrong sign, so no gain above 0 is stable"
    )
    assert not model(**{name: 0.01}).reason


@pytest.mark.parametrize(
    ("jitter_s", "mean_s"),
    [
        (0.016, 0.0),
        (0.02, 0.2 * 0.016),  # later than a tick with a probability of 0.2
        (0.032, 0.5 * 0.016),
        (0.192, 0.1273),
        # Up to 2000 periods, the mean is computed.
        (2000 * 0.016, 31.1085),
        (2001 * 0.016, 32.016),
    ],
)
@pytest.mark.parametrize("table", ["loop", "sensing"])
def test_jitter_counts_as_the_mean_delay_of_messages_in_order(
    table: str, jitter_s: float, mean_s: float
) -> None:
    parameters = tl.scenario.flatten_scenario(tl.load_scenario("textbook"))
    timing = tl.theory.find_timing({**parameters, f"{table}.jitter_s": jitter_s})
    assert not isinstance(timing, str)
    assert timing.jitter_s == pytest.approx(mean_s, rel=2e-3, abs=1e-9)
    assert timing.least_s == timing.jitter_s


@pytest.mark.parametrize(("jitter_s", "is_late"), [(0.063, False), (0.065, True)])
def test_jitter_within_the_wait_in_a_queue_delays_nothing(
    jitter_s: float, *, is_late: bool
) -> None:
    parameters = tl.scenario.flatten_scenario(tl.load_scenario("paper"))
    timing = tl.theory.find_timing({**parameters, "loop.jitter_s": jitter_s})
    assert not isinstance(timing, str)
    assert (timing.jitter_s > 0.0) is is_late
    assert (timing.least_s > 0.064) is is_late


def test_a_robot_has_all_of_the_mean_delay() -> None:
    timing = model(loop__jitter_s=0.05, plant__period_s=0.05)
    assert timing.require()[1]["process"].dead_time_s == pytest.approx(0.08 + 0.025)
    assert timing.counts_as_delay("loop.jitter_s")
    assert not model().counts_as_delay("loop.jitter_s")
