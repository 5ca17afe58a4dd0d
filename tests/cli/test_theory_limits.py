"""Answers of `theory` for robots whose limits, jitter or gains the linear loop leaves out."""

import pytest

from tests.cli.conftest import Call

JERK = "--set", "limits.jerk_m_s3=0.8", "--set", "loop.period_ticks=3"


def test_gains_allow_for_a_jerk_limit_and_say_so(call: Call) -> None:
    """The overshoot of tens of steps is searched, which takes 2 to 6 s."""
    text = " ".join(call("theory", "textbook", *JERK, "--kp", "2").out.split())
    assert "without command limits (rotate), with all limits of speed and acceleration" in text
    assert "translate: better than Kp = 2 1/s in overshoot (5 % instead of" in text
    assert "stable in small steps for Kp below" in text
    assert "are the largest of 49 steps of 0.559 m to 5.69 m, with all limits" in text
    assert "leaves out" not in text


def test_a_gain_that_oscillates_on_under_a_limit_has_no_settling_time(call: Call) -> None:
    """The overshoot of tens of steps is searched, which takes 2 to 6 s."""
    told = call("theory", "textbook", *JERK, "--kp", "3", "--details").out
    text = " ".join(told.split())
    assert " s instead of none)" in text
    assert "Without a settling time: the loop still moves after 10 oscillations." in text
    assert "translate (along-track): the table of loops is for small steps." in text
    assert "theory's linear loop leaves out limits.speed_m_s = 1, limits.jerk_m_s3 = 0.8." in text


def test_a_loop_whose_steps_oscillate_on_at_each_gain_has_no_gains(call: Call) -> None:
    """Tens of steps are simulated for each gain, which takes 2 to 6 s."""
    words = "--kp", "3", "--phase-margin", "60"
    text = " ".join(call("theory", "textbook", *JERK, *words).out.split())
    assert " (rotate); no gains for translate. This is for 60 deg phase margin" in text
    assert ", does not settle; stable in small steps for Kp below" in text


@pytest.mark.parametrize(("jerk", "step"), [("0.8", 5.693), ("inf", None)])
def test_the_largest_step_is_in_json(call: Call, jerk: str, step: float | None) -> None:
    """The overshoot of tens of steps is searched, which takes 2 to 6 s."""
    words = "--set", f"limits.jerk_m_s3={jerk}", "--set", "loop.period_ticks=5"
    loops = call("theory", "textbook", *words, "--overshoot", "5", "--json").json["loops"]
    assert loops[0]["largest_step"] is None
    assert loops[1]["largest_step"] == (step and pytest.approx(step, abs=1e-3))


def test_jitter_lowers_the_limit_of_stability(call: Call) -> None:
    text = " ".join(call("theory", "textbook", "--set", "loop.jitter_s=0.05").out.split())
    assert "stable for Kp below 59.53 1/s" in text
    assert "rotate (heading): jitter counts as its mean delay, 19.7 ms" in text
    assert "leaves out" not in text


@pytest.mark.parametrize(
    ("key", "is_late"),
    [("sensing.dropout_probability=0.1", True), ("sensing.noise_position_m=0.1", False)],
)
def test_random_delays_that_are_left_out_may_make_a_loop_unstable(
    call: Call, key: str, *, is_late: bool
) -> None:
    text = " ".join(call("theory", "textbook", "--set", key).out.split())
    assert f"leaves out {key.replace('=', ' = ')}" in text
    assert (", which may make it unstable at smaller gains." in text) is is_late


@pytest.mark.parametrize(
    ("words", "is_between"),
    [
        (("--dead-time-s", "0.016", "--period", "0.08"), True),
        (("--dead-time-s", "0.16", "--period", "0.08", "--low-pass", "0.1"), False),
        (("--lag", "0.1", "--dead-time", "2", "--period", "0.08"), True),
    ],
)
def test_an_overshoot_at_the_samples_is_told_from_that_of_the_motion(
    call: Call, words: tuple[str, ...], *, is_between: bool
) -> None:
    text = " ".join(call("theory", "--kp", "2.5", *words).out.split())
    assert (" at the samples, settles in" in text) is is_between
    assert ("The sampled loop, at its samples" in text) is is_between
    details = " ".join(call("theory", "--kp", "2.5", *words, "--details").out.split())
    assert ("Overshoot is at the samples; between samples" in details) is is_between


def test_an_axis_that_no_log_shows_has_no_recommended_gains(call: Call) -> None:
    words = ("theory", "lagged", "--set", "plant.turn_assumed=true")
    rotate, translate = call(*words, "--json").json["loops"]
    assert (rotate["status"], rotate["recommended"]) == ("unknown", [])
    assert (translate["status"], len(translate["recommended"])) == ("ok", 10)
    text = " ".join(call(*words).out.split())
    assert "rotate (heading) is unknown: no log shows how the turn rate follows commands" in text
    assert "law.kp_angular" not in text


def test_no_limit_is_told_of_a_robot_that_oscillates(call: Call) -> None:
    words = ("theory", "lagged", "--set", "plant.speed_oscillates=true")
    text = " ".join(call(*words).out.split())
    assert "translate: Kp = 1 1/s: the robot oscillates. Theory has a longer dead time" in text
    assert "rotate: better than Kp = 1 1/s in settling time" in text
    assert text.count("stable for Kp below") == 1
    assert "simulated run" not in text  # the simulated robot does not oscillate


def test_a_robot_with_friction_stops_short_of_its_goal_and_theory_says_so(call: Call) -> None:
    text = " ".join(call("theory", "lagged", "--set", "plant.speed_friction=0.1").out.split())
    assert "theory's linear loop leaves out plant.speed_friction = 0.1" in text
    # It rests where Kp times the error is the friction, 0.1 m before the goal at Kp = 1.
    assert "With the present gains it missed the goal by 0.1 m (allowed" in text


@pytest.mark.parametrize("noise_rad", [0.0, 0.003])
def test_advice_from_one_random_run_names_its_seed(noise_rad: float, call: Call) -> None:
    keys = ("--set", "loop.transport_delay_ticks=6", "--set", "seed=2")
    noise = ("--set", f"sensing.noise_heading_rad={noise_rad}")
    text = " ".join(call("theory", "textbook", "--kp", "3", *keys, *noise).out.split())
    told = "These are single runs with random effects (seed 2): others may differ."
    assert (told in text) is (noise_rad > 0.0)
