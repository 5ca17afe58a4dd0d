"""Notes on a scenario before it is run: what they claim is true of theory and of the run."""

import re
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from tests.simulate.pid_law import KIND
from turtlelog.errors import LawError
from turtlelog.simulate import list_scenario_notes, scenario_notes
from turtlelog.theory import (
    PidGains,
    Process,
    compute_stability_gain,
    find_stable_gains,
    is_pid_stable,
)

CLIPPING = "; clipping only bounds its oscillation"
TICK_S = 0.016


def change(name: str, **changes: Any) -> tl.Scenario:
    values = {key.replace("__", "."): value for key, value in changes.items()}
    return tl.override_scenario(tl.load_scenario(name), values)


def build(**changes: Any) -> tl.Scenario:
    """Return a scenario of the law whose loop is any of P to PID."""
    scenario = tl.override_scenario(tl.load_scenario("textbook"), {"law.kind": KIND})
    values = {key.replace("__", "."): value for key, value in changes.items()}
    return tl.override_scenario(scenario, values)


@pytest.mark.parametrize("name", tl.PRESETS)
def test_presets_need_no_note(name: str) -> None:
    assert list_scenario_notes(tl.load_scenario(name)) == ()


def test_a_gain_above_the_limit_gets_a_note() -> None:
    assert list_scenario_notes(change("textbook", law__kp_angular=150.0)) == (
        "rotate: law.kp_angular = 150 is above 125 1/s, where theory's loop with a period of 16 ms"
        f" and no dead time becomes unstable{CLIPPING}",
    )


@pytest.mark.parametrize(
    ("settings", "kp_limit", "words"),
    [
        ({}, 125.0, "a period of 16 ms and no dead time"),
        ({"period_ticks": 4}, 31.25, "a period of 64 ms and no dead time"),
        ({"period_ticks": 63}, 2.0 / (63 * TICK_S), "a period of 1008 ms and no dead time"),
        (
            {"period_ticks": 4, "transport_delay_ticks": 4},
            compute_stability_gain(4 * TICK_S, 1),
            "a period of 64 ms and a dead time of 4 ticks",
        ),
        (
            {"transport_delay_ticks": 1},
            compute_stability_gain(TICK_S, 1),
            "a period of 16 ms and a dead time of 1 tick",
        ),
        (
            {"start_backlog": 5, "queue_policy": "one-per-tick"},
            compute_stability_gain(TICK_S, 4),
            "a period of 16 ms and a dead time of 4 ticks (the least it can be)",
        ),
        (
            {"start_backlog": 9, "queue_policy": "one-per-tick", "transport_delay_ticks": 2},
            compute_stability_gain(TICK_S, 8),
            "a period of 16 ms and a dead time of 8 ticks",
        ),
        (
            {"start_backlog": 9, "queue_policy": "one-per-tick", "pose_queue": 3},
            compute_stability_gain(TICK_S, 2),
            "a period of 16 ms and a dead time of 2 ticks (the least it can be)",
        ),
        (  # a quarter of a sample steadies it
            {"period_ticks": 4, "transport_delay_ticks": 1},
            62.5,
            "a period of 64 ms and a dead time of 1 tick",
        ),
        ({"start_backlog": 5, "queue_policy": "newest"}, 125.0, "a period of 16 ms and no dead"),
        (
            {"start_backlog": 5, "queue_policy": "one-per-tick", "period_ticks": 2},
            62.5,
            "a period of 32 ms and no dead time",
        ),
    ],
)
def test_a_note_begins_at_theorys_limit_for_the_period_and_dead_time_of_the_settings(
    settings: dict[str, Any], kp_limit: float, words: str
) -> None:
    loop = {f"loop__{key}": value for key, value in settings.items()}
    for share, is_noted in [(1.0, False), (1.0 + 0.5e-9, False), (1.0 + 2e-9, True)]:
        notes = list_scenario_notes(change("textbook", law__kp_linear=share * kp_limit, **loop))
        assert len(notes) == is_noted
        if is_noted:
            assert notes[0].startswith("translate: law.kp_linear = ")
            assert f"theory's loop with {words}" in notes[0]
            kp, limit = map(float, re.findall(r" = (\S+) is above (\S+) 1/s", notes[0])[0])
            assert kp > limit
            assert limit == pytest.approx(kp_limit, rel=1e-3)


@pytest.mark.parametrize(
    "settings",
    [
        {"period_ticks": 64},  # turtlesim stops before the next command
        {"transport_delay_ticks": 1001},  # theory ends at 1000
    ],
)
def test_nothing_is_said_of_a_timing_that_theory_does_not_have(settings: dict[str, Any]) -> None:
    loop = {f"loop__{key}": value for key, value in settings.items()}
    assert list_scenario_notes(change("textbook", law__kp_linear=1e6, **loop)) == ()


LAGGED = {
    "plant__kind": "lagged",
    "plant__turn_gain": 0.8,
    "plant__turn_lag_s": 0.2,
    "plant__turn_dead_time_s": 0.08,
}


@pytest.mark.parametrize(
    ("changes", "process", "period_s", "words"),
    [
        (
            LAGGED,
            Process(gain=0.8, lag_s=0.2, dead_time_s=0.08),
            0.05,
            "a period of 50 ms, a lag of 0.2 s and a dead time of 0.08 s",
        ),
        (
            {
                **LAGGED,
                "loop__trigger": "timer",
                "loop__period_s": 0.1,
                "loop__transport_delay_s": 0.03,
                "loop__transport_delay_ticks": 1,
                "sensing__delay_s": 0.05,
                "shaping__low_pass_s": 0.1,
            },
            Process(gain=0.8, lag_s=0.2, dead_time_s=0.21, low_pass_s=0.1),
            0.1,
            "a period of 100 ms, a lag of 0.2 s, a low-pass of 0.1 s and a dead time of 0.21 s",
        ),
        (
            {"loop__transport_delay_s": 0.039, "sensing__delay_s": 0.007, "loop__period_ticks": 2},
            Process(dead_time_s=0.032),  # turtlesim's commands act on ticks
            0.032,
            "a period of 32 ms and a dead time of 2 ticks",
        ),
        (
            {
                **LAGGED,
                "loop__queue_policy": "one-per-tick",
                "loop__command_queue": 1,
                "loop__transport_delay_s": 0.01,
            },
            Process(gain=0.8, lag_s=0.2, dead_time_s=0.13),  # it takes it at its next period
            0.05,
            "a period of 50 ms, a lag of 0.2 s and a dead time of 0.13 s",
        ),
        (
            {"loop__trigger": "timer", "loop__period_s": 0.048, "sensing__bias_heading_rad": 0.1},
            Process(),
            0.048,
            "a period of 48 ms and no dead time",
        ),
    ],
)
def test_lag_timers_and_seconds_of_delay_get_their_own_limit(
    changes: dict[str, Any], process: Process, period_s: float, words: str
) -> None:
    ((_, limit),) = find_stable_gains(PidGains(kp=1.0), period_s=period_s, process=process)
    for share, is_noted in [(1.0 + 0.5e-9, False), (1.0 + 2e-9, True)]:
        notes = list_scenario_notes(change("textbook", law__kp_angular=share * limit, **changes))
        assert len(notes) == is_noted
        if is_noted:
            assert f"theory's loop with {words} becomes unstable" in notes[0]


@pytest.mark.parametrize(
    "changes",
    [
        {"loop__jitter_s": 0.01},
        {"loop__loss_probability": 0.1},
        {"loop__late_probability": 0.1, "loop__late_s": 0.1},
        {"sensing__noise_heading_rad": 0.01},
        {"sensing__jitter_s": 0.01},
        {"sensing__dropout_probability": 0.1},
        {"shaping__dead_zone_turn_rate_rad_s": 0.1},
        {"shaping__quantum_turn_rate_rad_s": 0.1},
        {"disturbance__noise_turn_rate": 0.1},
        {"limits__turn_acceleration_rad_s2": 1.0},
        {"loop__trigger": "timer", "loop__period_s": 0.05},  # no multiple of 16 ms
    ],
)
def test_nothing_is_said_of_what_is_random_or_not_linear(changes: dict[str, Any]) -> None:
    assert list_scenario_notes(change("textbook", law__kp_angular=1e4, **changes)) == ()
    assert len(list_scenario_notes(change("textbook", law__kp_angular=1e4))) == 1


def test_with_lag_a_queue_that_may_grow_is_judged_at_every_dead_time() -> None:
    loop = {"loop__queue_policy": "one-per-tick", "loop__start_backlog": 3}
    (note,) = list_scenario_notes(change("textbook", law__kp_angular=30.0, **LAGGED, **loop))
    assert note == (
        "rotate: with law.kp_angular = 30 theory's loop with a period of 50 ms, a lag of 0.2 s and"
        f" a dead time of 0.18 s (the least it can be) is unstable{CLIPPING}"
    )


def test_a_quarter_of_a_sample_of_dead_time_steadies_a_loop_that_is_unstable_without() -> None:
    # y[k+1] = y[k] - g (3/4 y[k] + 1/4 y[k-1]): stable up to g = 4, without dead time up to 2.
    for gain, is_stable in [(3.9, True), (4.1, False)]:
        roots = np.roots([1.0, 0.75 * gain - 1.0, 0.25 * gain])
        assert (np.abs(roots).max() < 1.0) == is_stable


@pytest.mark.parametrize("backlog", [1, 3, 6])
@pytest.mark.parametrize("pose_queue", [1, 3, 10])
@pytest.mark.parametrize("command_queue", [2, 7])
@pytest.mark.parametrize("pause_ticks", [0, 2, 34])
def test_no_pause_and_no_queue_makes_the_dead_time_less_than_the_note_says(
    backlog: int, pose_queue: int, command_queue: int, pause_ticks: int
) -> None:
    scenario = change(
        "paper",
        loop__start_backlog=backlog,
        loop__pose_queue=pose_queue,
        loop__command_queue=command_queue,
        law__pause_ticks=pause_ticks,
    )
    unstable = tl.override_scenario(scenario, {"law.kp_linear": 1e4})
    (note,) = list_scenario_notes(unstable)
    said = re.search(r"a dead time of (\d+) ticks?( \(the least it can be\))?", note)
    assert said is not None or "no dead time" in note
    least_ticks = 0 if said is None else int(said[1])
    most_ticks = command_queue - 1 if said is not None and said[2] else least_ticks
    run = tl.simulate_run(scenario)
    for loop in ("rotate", "translate"):
        found = tl.measure.find_dead_time(run, loop)
        assert isinstance(found, tl.measure.DeadTime)
        assert least_ticks <= found.ticks <= most_ticks


@pytest.mark.parametrize(("share", "grows"), [(0.97, False), (1.03, True)])
@pytest.mark.parametrize("backlog", [1, 5])
def test_without_clipping_the_error_of_a_run_grows_where_there_is_a_note(
    backlog: int, share: float, *, grows: bool
) -> None:
    scenario = change(
        "textbook",
        law__kp_angular=share * compute_stability_gain(TICK_S, backlog - 1),
        law__heading_tolerance_rad=1e-6,
        start__heading_rad=2.2,
        limits__turn_rate_rad_s=float("inf"),
        loop__start_backlog=backlog,
        loop__queue_policy="one-per-tick",
        max_duration_s=4.0,
    )
    assert bool(list_scenario_notes(scenario)) == grows
    found = tl.simulate_run(scenario).samples.heading_error_rad
    assert found is not None
    error = np.abs(found)
    assert (error[-20:].max() > 2.0 * error[:40].max()) == grows


def test_pi_gets_a_note_above_and_below_its_range_and_none_within() -> None:
    ((low, high),) = find_stable_gains(PidGains(kp=1.0, ki=100.0), period_s=TICK_S)
    assert (low, high) == pytest.approx((1.6, 125.8))
    within = [list_scenario_notes(build(law__kp=kp, law__ki=100.0)) for kp in (1.61, 125.7)]
    assert within == [(), ()]
    assert list_scenario_notes(build(law__kp=126.0, law__ki=100.0)) == (
        "turn: law.kp = 126 is above 125.8 1/s, where theory's loop with law.ki = 100, a period of"
        f" 16 ms and no dead time becomes unstable{CLIPPING}",
    )
    assert list_scenario_notes(build(law__kp=1.5, law__ki=100.0)) == (
        "turn: law.kp = 1.5 is below 1.6 1/s, where theory's loop with law.ki = 100, a period of"
        f" 16 ms and no dead time becomes stable{CLIPPING}",
    )


def test_a_loop_without_any_stable_gain_is_called_so() -> None:
    assert list_scenario_notes(build(law__kd=1.01)) == (
        "turn: at any law.kp theory's loop with law.kd = 1.01, a period of 16 ms and no dead time"
        f" is unstable{CLIPPING}",
    )
    assert list_scenario_notes(build(law__kd=0.99, law__kp=1.0)) == ()
    filtered = build(law__kd=1.01, law__tf_s=0.1, law__kp=1.0)
    assert list_scenario_notes(filtered) == ()


def test_a_derivative_is_judged_at_every_dead_time_that_there_may_be() -> None:
    loop = {"loop__start_backlog": 5, "loop__queue_policy": "one-per-tick"}
    gains = PidGains(kp=30.0, kd=0.1, filter_s=0.1)
    stable = [is_pid_stable(gains, period_s=TICK_S, dead_time_ticks=ticks) for ticks in range(4, 7)]
    assert stable == [False, False, False]
    assert list_scenario_notes(build(law__kp=30.0, law__kd=0.1, law__tf_s=0.1, **loop)) == (
        "turn: with law.kp = 30 theory's loop with law.kd = 0.1, a period of 16 ms and a dead time"
        f" of 4 ticks (the least it can be) is unstable{CLIPPING}",
    )
    gains = PidGains(kp=20.0, kd=0.1, filter_s=0.1)  # stable at 4 ticks, not at 6
    assert is_pid_stable(gains, period_s=TICK_S, dead_time_ticks=4)
    assert not is_pid_stable(gains, period_s=TICK_S, dead_time_ticks=6)
    assert list_scenario_notes(build(law__kp=20.0, law__kd=0.1, law__tf_s=0.1, **loop)) == ()


@pytest.mark.parametrize(
    "changes",
    [
        {"law__tells": "gain"},  # not proportional, and that is all it says
        {"law__ki": "much"},
        {"law__ki": -1.0},
        {"law__ki": True},
        {"law__signal": "cross_track"},  # no integrator
        {"law__kd": 1e60},
    ],
)
def test_nothing_is_said_of_a_loop_whose_theory_is_unknown(changes: dict[str, Any]) -> None:
    assert len(list_scenario_notes(build(law__kp=150.0))) == 1
    assert list_scenario_notes(build(law__kp=150.0, **changes)) == ()


def test_a_scheduled_gain_gets_no_note_and_the_constant_one_beside_it_does() -> None:
    table = {"law__schedule__over": "distance", "law__schedule__at": [0.0, 1.0]}
    gains = {"law__kp_angular": 150.0, "law__kp_linear": 150.0}
    scheduled = change("textbook", law__schedule__kp_linear=[150.0, 150.0], **table, **gains)
    (note,) = list_scenario_notes(scheduled)
    assert note.startswith("rotate: law.kp_angular = 150 is above 125 1/s")


def test_pd_that_names_no_integral_is_known() -> None:
    (note,) = list_scenario_notes(build(law__kp=150.0, law__tells="pd", law__ki=1e5))
    assert "law.ki" not in note


@pytest.mark.parametrize("key", ["plant.kind", "plant.mass_kg", "limits.jerk_m_s3"])
def test_nothing_is_said_where_a_key_is_not_understood(
    key: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = change("textbook", law__kp_angular=150.0)
    parameters = {**tl.scenario.flatten_scenario(scenario), "path.kind": "line"}
    monkeypatch.setattr(scenario_notes, "flatten_scenario", lambda _: parameters)
    assert len(list_scenario_notes(scenario)) == 2  # the gain, and the path
    parameters[key] = "new"
    assert list_scenario_notes(scenario) == ("law sequential-p does not use [path]",)


def test_a_goal_heading_that_the_sequential_law_ignores_gets_a_note() -> None:
    assert list_scenario_notes(change("textbook", goal__heading_rad=1.0)) == (
        "law sequential-p does not use goal.heading_rad",
    )


@pytest.mark.parametrize(
    ("law", "unused"),
    [
        ("sequential-p", "[path]"),
        ("posture", "[path]"),
        ("open-loop", "[goal] and [path]"),
        ("pure-pursuit", "[goal]"),
        ("kanayama", "[goal]"),
    ],
)
def test_of_path_and_goal_what_a_built_in_law_does_not_use_gets_a_note(
    law: str, unused: str
) -> None:
    points = [[5.5, 5.5], [7.0, 5.5]]
    values = {"law.kind": law, "path.kind": "waypoints", "path.points": points, "goal.x_m": 3.0}
    scenario = tl.override_scenario(tl.load_scenario("textbook"), values)
    assert list_scenario_notes(scenario) == (f"law {law} does not use {unused}",)


def test_a_goal_gets_a_note_of_a_law_without_one_where_the_user_set_it() -> None:
    note = (f"law {KIND} does not use [goal]",)
    assert list_scenario_notes(build()) == ()
    assert list_scenario_notes(build(goal__x_m=3.0)) == note
    assert list_scenario_notes(build(goal__heading_rad=1.0)) == note
    assert list_scenario_notes(build(), given=["goal.x_m"]) == note
    assert list_scenario_notes(build(), given=["law.kp"]) == ()


def test_unused_tables_and_keys_stand_in_one_line_each_once() -> None:
    unused = ["goal.heading_rad", "goal", "limits.speed_m_s", "goalkeeper"]
    scenario = build(law__unused=unused, goal__heading_rad=1.0, limits__speed_m_s=2.0)
    assert list_scenario_notes(scenario) == (
        f"law {KIND} does not use [goal] and limits.speed_m_s",
    )


@pytest.mark.parametrize("unused", [["law.kp"], ["law"], ["Goal"], [1], ["goal."]])
def test_a_law_that_names_no_key_as_unused_is_told_so(unused: list[Any]) -> None:
    with pytest.raises(LawError, match=r"^PidLaw.list_unused: expected a tuple of tables and keys"):
        list_scenario_notes(build(law__unused=unused))


def test_a_law_that_cannot_say_what_it_does_not_use_is_named() -> None:
    with pytest.raises(LawError, match=r"^PidLaw.list_unused: .*pid_law.py, line \d+: TypeError"):
        list_scenario_notes(build(law__unused=5))


def test_a_plant_that_turns_the_feedback_around_is_named_and_drives_away() -> None:
    turned = change("lagged", plant__turn_gain=-0.5, max_duration_s=20.0)
    assert list_scenario_notes(turned) == (
        "rotate: plant.turn_gain = -0.5 feeds the error back with the wrong sign: theory's loop is"
        " unstable at any law.kp_angular above 0",
    )
    error_rad = tl.simulate_run(turned).samples.heading_error_rad
    assert error_rad is not None
    assert abs(error_rad[-1]) > abs(error_rad[0])
    assert list_scenario_notes(change("lagged", plant__turn_gain=0.5)) == ()


@pytest.mark.parametrize(
    ("values", "note"),
    [
        ({"loop.late_s": 0.1}, "loop.late_s has no effect, for loop.late_probability is 0"),
        (
            {"sensing.outlier_m": 0.1, "sensing.outlier_rad": 0.1},
            "sensing.outlier_m and sensing.outlier_rad have no effect,"
            " for sensing.outlier_probability is 0",
        ),
        ({"disturbance.from_s": 2}, "disturbance.from_s: there is no disturbance and no noise to"),
    ],
)
def test_what_has_no_effect_alone_is_named(values: dict[str, Any], note: str) -> None:
    (found,) = list_scenario_notes(tl.override_scenario(tl.load_scenario("textbook"), values))
    assert found.startswith(note)
    partners = {"loop.late_probability": 0.1, "disturbance.speed_m_s": 0.1}
    partners["sensing.outlier_probability"] = 0.1
    partner = {
        key: value
        for key, value in partners.items()
        if key.partition(".")[0] == next(iter(values)).partition(".")[0]
    }
    acting = tl.override_scenario(tl.load_scenario("textbook"), values | partner)
    assert list_scenario_notes(acting) == ()
