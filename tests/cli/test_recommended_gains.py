"""Gains that `theory` recommends, and the runs in which it tries them."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

import turtlelog as tl
from tests.cli.conftest import Call
from turtlelog.cli.theory_gains import is_better

ROBOT = ("--gain", "0.9", "--lag", "0.2", "--dead-time-s", "0.08", "--period", "0.05")


def test_gains_are_recommended_with_their_rule_and_source(call: Call) -> None:
    found = call("theory", "--kp", "2", *ROBOT, "--json").json["recommended"]
    rules = [f"{one['controller']} {one['rule']}" for one in found]
    assert rules == [
        *(f"{controller} overshoot" for controller in ("P", "PI", "PD")),
        *(f"{controller} phase-margin" for controller in ("P", "PI", "PD")),
        *("P simc", "PI simc", "PD simc", "P ziegler-nichols"),
    ]
    p, pi, pd, *_ = found
    assert [one["overshoot_percent"] for one in (p, pi, pd)] == pytest.approx([5.0] * 3, abs=1e-5)
    assert (p["kp"], p["ki"], p["kd"]) == (pytest.approx(1.8826, abs=1e-4), 0.0, 0.0)
    assert pd["phase_margin_rad"] == pytest.approx(1.0472, abs=1e-4)
    assert "Skogestad" in found[6]["source"]
    text = call("theory", "--kp", "2", *ROBOT).out
    assert re.search(r"\nP for 5 % overshoot +1.8826 +- +- +5.00 +2.20 +6.09 +62.4\n", text)
    assert "SIMC" not in text
    assert "\nPD by SIMC " in call("theory", "--kp", "2", *ROBOT, "--details").out
    assert max(map(len, text.splitlines())) <= 80


@pytest.mark.parametrize(
    ("words", "rules"),
    [
        (["--overshoot", "2"], {"overshoot"}),
        (["--phase-margin", "45"], {"phase-margin"}),
        (["--overshoot", "2", "--phase-margin", "45"], {"overshoot", "phase-margin"}),
    ],
)
def test_gains_are_recommended_for_what_is_wanted(
    call: Call, words: list[str], rules: set[str]
) -> None:
    found = call("theory", *words, *ROBOT, "--json").json["recommended"]
    assert {one["rule"] for one in found} == rules | {"simc", "ziegler-nichols"}
    for one in found:
        if one["rule"] == "overshoot":
            assert one["overshoot_percent"] == pytest.approx(2.0, abs=1e-5)
        if one["rule"] == "phase-margin":
            assert one["phase_margin_rad"] == pytest.approx(0.25 * 3.14159265, abs=1e-8)


def test_gains_that_do_not_exist_are_null_with_their_reason(call: Call) -> None:
    answer = call("theory", "--dead-time", "6", "--phase-margin", "90", "--json").json
    found = [one for one in answer["recommended"] if one["rule"] == "phase-margin"]
    assert [(one["kp"], one["ki"], one["kd"]) for one in found] == [(None, None, None)] * 3
    assert found[0]["reason"].startswith("the integrator alone lags by 90 deg")
    words = ("theory", "--dead-time", "6", "--phase-margin", "90", "--kp", "1")
    told = " ".join(call(*words).out.split())
    first = "No gains are recommended for 90 deg phase margin: the integrator alone lags by 90 deg"
    assert told.startswith(first)
    assert "SIMC" not in told
    told = " ".join(call("theory", "lagged", "--phase-margin", "90").out.split())
    assert told.startswith("lagged: no gains are recommended for 90 deg phase margin: the integ")
    assert "SIMC" not in told
    text = " ".join(call(*words, "--details").out.split())
    assert "No P for 90 deg margin and PI for 90 deg margin: the integrator alone lags" in text


def test_a_controller_that_cannot_have_the_wanted_overshoot_is_told_in_the_first_sentence(
    call: Call,
) -> None:
    robot = ("--ki", "1", "--lag", "0.1", "--dead-time-s", "0.08", "--period", "0.05")
    told = " ".join(call("theory", "--kp", "2", *robot, "--overshoot", "0").out.split())
    assert told.startswith(
        "Recommended without command limits: P with Kp = 1.58 1/s,"
        " because theory finds no PI for 0 % overshoot."
    )
    assert "On a plant that integrates, an integral always overshoots" in told
    pid = ("--set", "law.kind=sequential-pid", "--set", "law.ki_angular=0.2")
    told = " ".join(call("theory", "lagged", *pid, "--overshoot", "0").out.split())
    assert "theory finds no PI for 0 % overshoot (rotate)" in told.partition(". ")[0]
    wished = " ".join(call("theory", "--kp", "2", *robot).out.split())
    assert wished.startswith("Recommended without command limits: PI with Kp = ")
    assert "because no" not in wished


def test_gains_of_a_very_slow_loop_are_compared_in_every_figure(call: Call) -> None:
    slow = ("theory", "--lag", "40", "--kp")
    told = " ".join(call(*slow, "2").out.split())
    better = "in overshoot (8.77 % instead of 84.1 %), settling time (292 s instead of 312 s),"
    assert f"Better than Kp = 2 1/s {better} gain margin and phase margin." in told
    kept = " ".join(call(*slow, "0.0168").out.split())  # 0.8 % more than the recommended gain
    assert kept.startswith("Without command limits, Kp = 0.0168 1/s needs no change.")
    changed = " ".join(call(*slow, "0.0169").out.split())  # 1.4 % more
    assert changed.startswith("Recommended without command limits: P with Kp = 0.0167 1/s.")


def test_gains_that_no_kp_makes_stable_are_told_as_unstable_at_every_kp(call: Call) -> None:
    out = call("theory", "--kp", "3", "--kd", "2", "--dead-time", "6").out
    assert "\nUnstable at every Kp.\n" in out
    assert "of no value" not in out


def test_ticks_and_seconds_of_dead_time_are_recommended_for_alike(call: Call) -> None:
    ticks = call("theory", "--dead-time", "6", "--json").json["recommended"]
    seconds = call("theory", "--dead-time-s", "0.064", "--dead-time", "2", "--json").json
    assert seconds["recommended"] == ticks
    assert ticks[0]["kp"] == pytest.approx(4.946, abs=1e-3)


@pytest.mark.thorough
def test_each_loop_of_a_robot_has_recommended_gains(call: Call, tmp_path: Path) -> None:
    robot = tmp_path / "robot.toml"
    robot.write_text(
        '[law]\nkind = "sequential-pid"\nderivative_filter_s = 0.02\n'
        '[plant]\nkind = "lagged"\nturn_lag_s = 0.2\nturn_dead_time_s = 0.08\n'
        "speed_gain = 0.9\nspeed_lag_s = 0.1\nperiod_s = 0.05\n"
        '[loop]\nqueue_policy = "newest"\nstart_backlog = 1\n'
    )
    recording = tmp_path / "robot.mcap"
    assert call("run", robot, "-o", recording).code == 0
    wishes = ("--overshoot", "5", "--phase-margin", "60")
    answers = [call("theory", path, *wishes, "--json").json["loops"] for path in (robot, recording)]
    turning = tl.theory.Process(lag_s=0.2, dead_time_s=0.08)
    driving = tl.theory.Process(gain=0.9, lag_s=0.1)
    for loops in answers:
        for loop, process in zip(loops, (turning, driving), strict=True):
            expected = tl.theory.recommend_gains(process, period_s=0.05, filter_s=0.02)
            gains = [(one.gains.kp, one.gains.kd) for one in expected if one.gains]
            found = [(one["kp"], one["kd"]) for one in loop["recommended"] if one["kp"]]
            assert np.array(found) == pytest.approx(np.array(gains))
        assert {one["filter_s"] for one in loops[0]["recommended"][:6]} == {0.0, 0.02}
    text = call("theory", robot).out
    assert text.count("Recommended gains of ") == 2


def test_gains_are_recommended_for_the_most_dead_time_that_queues_allow(call: Call) -> None:
    wish = ("--overshoot", "5", "--json")
    both = call("theory", "paper-kp10", *wish).json["loops"]
    flag = call("theory", "--dead-time", "6", *wish).json["recommended"]
    for loop in both:
        found = [one["kp"] for one in loop["recommended"]]
        expected = [one["kp"] for one in flag]
        assert [one is None for one in found] == [one is None for one in expected]
        assert [one for one in found if one] == pytest.approx([one for one in expected if one])
    text = call("theory", "paper-kp10").out
    assert "Recommended gains of rotate and translate\n" in text
    assert "They are for the most dead time, 96 ms." in text


def test_a_loop_that_theory_does_not_know_has_no_recommended_gains(call: Call) -> None:
    assert [loop["recommended"] for loop in call("theory", "posture", "--json").json["loops"]] == [
        [],
        [],
    ]


def test_the_largest_step_without_clipping_is_told_for_recommended_gains(call: Call) -> None:
    words = " ".join(call("theory", "paper-kp10").out.split())
    # The limit by the recommended gain: 1 rad/s / 3.541 1/s, and 1 m/s / 3.541 1/s.
    told = "commands are clipped for errors above 16.2 deg (rotate) and 0.282 m (translate), which"
    assert f"At the recommended gains, {told} changes overshoot and settling time." in words
    kept = " ".join(call("theory", "paper-kp10", "--kp", "4.95").out.split())
    assert "Commands are clipped for errors above 11.6 deg (rotate)" in kept
    unlimited = ("--set", "limits.turn_rate_rad_s=inf", "--set", "limits.speed_m_s=inf")
    assert "are clipped for errors" not in call("theory", "paper-kp10", *unlimited).out


def test_no_size_of_clipped_errors_is_told_for_an_integral_term(call: Call) -> None:
    pid = ("--set", "law.kind=sequential-pid", "--set", "law.ki_angular=0.2")
    words = " ".join(call("theory", "lagged", *pid).out.split())
    assert "Theory leaves out command limits, which change overshoot and settling time." in words
    assert "are clipped for errors" not in words


def test_a_command_of_two_lines_can_be_pasted(call: Call) -> None:
    lines = call("theory", "paper-kp10").out.splitlines()
    (first,) = [number for number, line in enumerate(lines) if line.startswith("Try them: ")]
    command = "\n".join(lines[first : first + 2]).removeprefix("Try them: ")
    # In a shell, a backslash before the end of a line joins two lines.
    words = shlex.split(command.replace("\\\n", " "))
    assert words == [
        *("turtlelog", "run", "paper-kp10", "--set", "law.kp_angular=3.54"),
        *("--set", "law.kp_linear=3.54"),
    ]


@pytest.mark.parametrize(
    ("words", "wish"),
    [
        (("paper", "--kp", "4"), "at most 5 % overshoot"),
        (("paper", "--kp", "3", "--phase-margin", "60"), "60 deg phase margin"),
        (
            ("lagged", "--set", "plant.speed_lag_s=150"),
            "5 % overshoot (rotate) and 60 deg phase margin (translate)",
        ),
    ],
)
def test_the_wish_is_told_of_each_loop_and_as_a_bound_for_gains_that_are_kept(
    words: tuple[str, ...], wish: str, call: Call
) -> None:
    text = " ".join(call("theory", *words).out.split())
    assert f" for {wish}, without command limits." in text


def test_gains_are_recommended_that_improve_the_simulated_run(call: Call, kp10: Path) -> None:
    """Three runs are simulated, and run again as advised, which takes 2 s or more."""
    answers = [call("theory", word, "--json").json for word in (kp10, "paper-kp10")]
    assert answers[0]["trials"] == answers[1]["trials"]  # the preset is the recording
    first, last = answers[0]["trials"]
    assert [one["is_better"] for one in (first, last)] == [True, True]
    assert first["ending"].startswith("missed the goal by 0.012 m")  # nearer, but not there
    assert last["present_ending"].startswith("missed the goal by 0.107 m")
    changes = [word for key, kp in last["gains"].items() for word in ("--set", f"{key}={kp:.3g}")]
    ending = call("run", kp10, *changes, "--json").json["ending"]
    assert last["ending"].startswith(f"{ending} (settling time: rotate ")
    assert ending.startswith("reached the goal within 5.85 mm")


@pytest.mark.parametrize(("kp", "is_better"), [("1.58", False), ("1", True)])
def test_no_gains_are_recommended_that_make_the_simulated_run_miss_its_goal(
    call: Call, kp: str, *, is_better: bool
) -> None:
    words = ("theory", "lagged", "--kp", kp)
    trials = call(*words, "--json").json["trials"]
    assert trials[0]["ending"].startswith("missed the goal by 6.97 mm")
    assert trials[-1]["present_ending"].startswith("reached the goal within ")
    assert [trials[0]["is_better"], trials[-1]["is_better"]] == [False, is_better]
    text = " ".join(call(*words).out.split())
    assert ("Try them: turtlelog run lagged --kp 1 --set" in text) is is_better
    refused = f"theory knows no better gains for the whole run than Kp = {kp} 1/s"
    assert (refused in text) is not is_better


def test_ends_within_the_tolerances_and_times_within_a_sample_are_equally_good() -> None:
    kp4, kp10 = (tl.simulate_run(name) for name in ("paper-kp4", "paper-kp10"))
    changes = {"law.kp_angular": 4.19, "law.kp_linear": 3.54}
    near = tl.simulate_run("paper-kp4", changes=changes)  # 0.9 mm further off, 4 ms earlier
    loops = ("rotate", "translate")
    assert not is_better(near, kp4, loops)
    assert not is_better(kp4, near, loops)
    assert is_better(kp4, kp10, loops)  # 98 mm nearer, where the tolerances allow 6.7 mm
    assert not is_better(kp10, kp4, loops)
    slow, fast = (tl.simulate_run("textbook", changes={"law.kp_angular": kp}) for kp in (1.0, 1.02))
    assert is_better(fast, slow, ("rotate",))  # 40 ms earlier
    assert not is_better(slow, fast, ("rotate",))


def test_gains_that_settle_earlier_are_no_better_if_the_run_ends_later(call: Call) -> None:
    gains = ("--set", "law.kp_angular=1.94", "--set", "law.kp_linear=4.01")
    (*_, last) = call("theory", "paper", *gains, "--json").json["trials"]
    assert last["ending"].startswith("reached the goal within 5.85 mm after 11.6 s")
    assert "after 11 s (settling time: rotate 2.82 s" in last["present_ending"]
    assert "(settling time: rotate 2.35 s" in last["ending"]
    assert not last["is_better"]


@pytest.mark.parametrize("kp", [30.0, 120.0])
def test_gains_with_which_the_run_ends_earlier_and_nearer_are_better(kp: float, call: Call) -> None:
    """Commands are clipped, so all of these gains settle within a tick of each other."""
    words = ("theory", "textbook", "--kp", f"{kp:g}")
    first, *_ = call(*words, "--json").json["trials"]
    assert first["ending"].startswith("reached the goal within 0.789 mm after 8 s")
    assert first["is_better"]
    assert "recommended Kp = 65.6 1/s (rotate and" in " ".join(call(*words).out.split())
    present, better = (
        tl.simulate_run("textbook", changes={"law.kp_angular": one, "law.kp_linear": one})
        for one in (kp, 65.6)
    )
    assert not is_better(present, better, ("rotate", "translate"))
    assert not is_better(better, better, ("rotate", "translate"))


def test_a_run_that_ends_earlier_but_farther_from_its_goal_is_no_better() -> None:
    coarse, fine = (
        tl.simulate_run("textbook", changes={"law.position_tolerance_m": one})
        for one in (0.01, 0.001)
    )
    assert coarse.duration_s < fine.duration_s - 1.0
    assert not is_better(coarse, fine, ("rotate", "translate"))


def test_gains_of_a_recording_that_cannot_be_simulated_are_not_tried(
    call: Call, tmp_path: Path
) -> None:
    riddle = tmp_path / "riddle.mcap"
    call("run", "paper-kp1", "--strip-scenario", "-o", riddle)
    assert call("theory", riddle, "--json").json["trials"] == []
    assert "Try them" not in call("theory", riddle).out
