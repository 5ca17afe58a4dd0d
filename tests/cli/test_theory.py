import re
from pathlib import Path

import pytest

from tests.cli.conftest import Call


def test_theory_answers_in_json(call: Call) -> None:
    answer = call("theory", "--kp", "1,4,10,16", "--dead-time", "6", "--json").json
    assert (answer["period_s"], answer["dead_time_ticks"]) == (0.016, 6)
    assert round(answer["overshoot_gain"], 2) == 3.54
    assert round(answer["stability_gain"], 2) == 15.07
    gains = answer["gains"]
    assert [gain["kp"] for gain in gains] == [1.0, 4.0, 10.0, 16.0]
    assert [gain["overshoots"] for gain in gains] == [False, True, True, True]
    assert [gain["stable"] for gain in gains] == [True, True, True, False]
    assert [len(gain["poles"]) for gain in gains] == [7] * 4
    assert gains[1]["poles"][0]["im"] == -gains[1]["poles"][1]["im"] != 0.0
    assert (gains[3]["overshoot_percent"], gains[3]["sampled_settling_time_s"]) == (None, None)


def test_theory_tells_the_plant_in_json(call: Call) -> None:
    plant = call("theory", "--json").json["plant"]
    assert plant["bibo_stable"] is False
    ends = {end["input"]: (end["value"], end["status"]) for end in plant["final_values"]}
    assert ends == {
        "impulse": (1.0, "ok"),
        "step": (None, "unbounded"),
        "ramp": (None, "unbounded"),
    }


def test_theory_has_null_where_there_is_no_crossover(call: Call) -> None:
    [gain] = call("theory", "--kp", "130", "--json").json["gains"]
    assert (gain["phase_margin_rad"], gain["delay_margin_s"]) == (None, None)


@pytest.mark.parametrize(("ticks", "left_out"), [("0", "limits or dead time"), ("1", "limits")])
def test_the_first_line_names_what_the_recommended_gains_leave_out(
    ticks: str, left_out: str, call: Call
) -> None:
    text = call("theory", "--dead-time", ticks, "--kp", "4").out
    assert re.match(
        rf"Recommended without command {left_out}: P with Kp = [\d.]+ 1/s\."
        r" This is for 5 % overshoot\.",
        " ".join(text.split()),
    )


@pytest.mark.parametrize(
    ("kp", "first", "kept"),
    [
        ("3.66", "Recommended without command limits: P with Kp = 4.95 1/s.\n", None),
        (
            "3.68",
            "Without command limits, Kp = 3.68 1/s needs no change.\nStep response: no over",
            3.68,
        ),
        (
            "4.95",
            "Without command limits, Kp = 4.95 1/s needs no change.\nStep response: over",
            4.95,
        ),
        ("5", "Recommended without command limits: P with Kp = 4.95 1/s.\n", None),
    ],
)
def test_gains_are_kept_that_overshoot_no_more_and_settle_no_later_than_recommended_ones(
    kp: str, first: str, kept: float | None, call: Call
) -> None:
    words = ("theory", "--dead-time", "6", "--kp", kp)
    assert call(*words).out.startswith(first)
    assert call(*words, "--json").json["kept_kp"] == kept


def test_recommended_gains_say_what_they_cost(call: Call) -> None:
    text = " ".join(call("theory", "--dead-time", "5", "--kp", "4").out.split())
    better = (
        "Better than Kp = 4 1/s in settling time (0.528 s instead of 0.624 s); worse in overshoot"
    )
    assert f"{better} (5 % instead of 0 %), gain margin and phase margin." in text
    text = " ".join(call("theory", "--lag", "0.2", "--dead-time-s", "0.1").out.split())
    assert "worse in overshoot (5 % instead of 0 %)" in text
    assert "Kp = 10: stable, but its slowest part hardly decays." in text
    assert "Kp = 16 1/s is unstable." in call("theory", "--dead-time", "6", "--kp", "16").out


def test_a_scenario_keeps_the_gains_of_one_loop_and_changes_those_of_the_other(
    call: Call,
) -> None:
    words = ("theory", "textbook", "--kp", "64", "--set", "law.kp_angular=4")
    answer = call(*words)
    text = " ".join(answer.out.split())
    assert "Kp = 65.6 1/s (rotate); keep Kp = 64 1/s (translate)." in text
    assert "run textbook --kp 64 --set law.kp_angular=65.6 Poles" in text
    loops = call(*words, "--json").json["loops"]
    assert [loop["kept_kp"] for loop in loops] == [None, 64.0]


def test_gains_to_try_are_of_one_controller(call: Call, tmp_path: Path) -> None:
    path = tmp_path / "pid.toml"
    path.write_text('[law]\nkind = "sequential-pid"\nkp_linear = 0.5\nki_linear = 0.3\n')
    keys = ("law.ki_angular=0.1", "law.kd_angular=0.1")
    answer = call("theory", path, *(word for key in keys for word in ("--set", key)))
    assert re.search(
        r"--set law.kp_angular=\S+ --set law.ki_angular=0 --set law.kd_angular=0"
        r" --set law.kp_linear=\S+ --set law.ki_linear=[1-9.]",
        answer.flat,
    )


@pytest.mark.parametrize(
    "words",
    [
        "--kp 4",
        "--kp 300",
        "--kp 4 --dead-time 6",
        "--kp 2 --ki 1 --lag 0.1",
        "paper-kp10",
        "lagged",
    ],
)
def test_the_first_line_is_a_whole_sentence(words: str, call: Call) -> None:
    assert call("theory", *words.split()).out.partition("\n")[0].endswith(".")


def test_theory_reads_well_in_a_terminal(call: Call) -> None:
    answer = call("theory", "--dead-time", "6", "--kp", "1,2,4,10,16")
    assert (answer.code, answer.err) == (0, "")
    lines = answer.out.splitlines()
    assert lines[:7] == [
        "Without command limits, Kp = 4 1/s needs no change.",
        "Step response: overshoots by 0.29 %, settles in 0.512 s.",
        "Kp = 4.95 1/s for 5 % overshoot is no better: overshoots by 5.00 %, settles in",
        "0.624 s.",
        "Overshoot begins above Kp = 3.541 1/s, instability at 15.07 1/s.",
        "Kp = 1, 2: no overshoot. Kp = 4, 10: overshoots, and settles. Kp = 16: unstable.",
        "Sampling period 16 ms, dead time 6 ticks (96 ms).",
    ]
    assert max(map(len, lines)) <= 80
    assert len(lines) <= 40
    details = call("theory", "--dead-time", "6", "--details").out
    assert max(map(len, details.splitlines())) <= 80
    for title in ("The plant 1/s", "The ideal loop Kp / (s + Kp)", "Limits of the gain, sampled"):
        assert title in details
        assert title not in answer.out


def test_theory_shows_the_limits_of_the_dead_time_asked_for(call: Call) -> None:
    limits = call("theory", "--dead-time", "20", "--json").json["limits"]
    assert [limit["dead_time_ticks"] for limit in limits] == [*range(9), 20]


@pytest.mark.thorough
@pytest.mark.parametrize("dead_time_ticks", [0, 1, 1000])
def test_theory_goes_from_no_dead_time_to_the_most(call: Call, dead_time_ticks: int) -> None:
    answer = call("theory", "--dead-time", str(dead_time_ticks), "--kp", "1,62.5,125,1e6")
    assert (answer.code, answer.err) == (0, "")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--kp", "nan"], "--kp nan: must be a gain > 0"),
        (["--kp", "0"], "--kp 0: must be greater than 0"),
        (["--kp=-1"], "--kp -1: must be greater than 0"),
        (["--kp", "inf"], "--kp inf: must be a gain from 1e-100 to 1e+100"),
        (["--kp", "abc"], "--kp abc: must be gains with commas between, as in 1,2,4,10"),
        (["--kp="], "--kp : must be gains with commas between, as in 1,2,4,10"),
        (["--kp", "1,,2"], "--kp 1,,2: must be gains with commas between, as in 1,2,4,10"),
        (["--kp", ",".join(["1"] * 101)], "--kp: takes at most 100 gains, not 101"),
        (["--period", "0"], "--period 0: must be greater than 0"),
        (["--period", "nan"], "--period nan: must be a sampling period > 0"),
        (["--dead-time=-1"], "--dead-time -1: must be 0 or greater"),
        (["--dead-time", "1.5"], "--dead-time 1.5: must be a whole number of ticks"),
        (["--dead-time", "1e9"], "--dead-time 1e9: must be a whole number"),
        (["--lag", "nan"], "--lag nan: must be a number from 0 to 1e+100"),
        (["--lag=-1e-5"], "--lag -1e-05: must be 0 or greater"),
        (["--lag", "1e9"], "--lag 1000000000: must be at most 1.6e+07 s (1e+09 sampling periods)"),
        (["--ki=-1"], "--ki -1: must be 0 or greater"),
        (["--gain", "0"], "--gain 0: must be greater than 0"),
        (
            ["--dead-time-s", "17"],
            "--dead-time-s 17: must be at most 16 s (1000 samples in all)",
        ),
        (
            ["--dead-time-s", "15", "--dead-time", "100"],
            "--dead-time-s 15: must be at most 14.4 s (1000 samples in all)",
        ),
        (
            ["--overshoot", "100"],
            "--overshoot 100.0: must be percent from 0 to below 100",
        ),
        (["--overshoot=-1"], "--overshoot -1.0: must be percent from 0 to below 100"),
        (["--overshoot", "nan"], "--overshoot nan: must be percent from 0 to below 100"),
        (["--phase-margin", "0"], "must be degrees above 0 and below 180"),
        (["--phase-margin", "180"], "must be degrees above 0 and below 180"),
        (["--low-pass", "x"], "--low-pass x: must be a number"),
        (["--set", "law.kp_linear=4"], "--set changes a scenario: turtlelog theory SCENARIO --set"),
        (["textbook", "--lag", "1"], "--lag: leave it out beside SCENARIO, which has its own"),
        (["textbook", "--period", "1"], "--period: leave it out beside SCENARIO"),
        (["textbook", "--dead-time", "1"], "--dead-time: leave it out beside SCENARIO"),
        (["textbook", "--dead-time", "0"], "--dead-time: leave it out beside SCENARIO"),
        (["textbook", "--kp", "1,2"], "--kp: takes one gain with SCENARIO, not 2"),
        (["textbook", "--kp", "nan"], "--kp nan: must be a gain > 0"),
        (["textbook", "--kp=-1"], "--kp -1: must be greater than 0"),
        (["textbuch"], 'no preset or file "textbuch"'),
        (
            ["--dead-time", "1000000000"],
            "--dead-time 1000000000: must be a whole number from 0 to 1000",
        ),
    ],
)
def test_theory_names_what_it_cannot_use(call: Call, words: list[str], expected: str) -> None:
    answer = call("theory", *words)
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.startswith("turtlelog: error: ")
    assert expected in answer.err
    assert answer.err.count("\n") == 1


def test_an_integral_and_a_lag_have_their_range_and_margins(call: Call) -> None:
    loop = ("--ki", "1", "--lag", "0.1", "--dead-time-s", "0.08", "--period", "0.05")
    answer = call("theory", "--kp", "2,30", *loop, "--json").json
    assert answer["process"] == {"gain": 1.0, "lag_s": 0.1, "dead_time_s": 0.08, "low_pass_s": 0.0}
    assert answer["period_s"] == 0.05
    low, fine = answer["gains"]
    assert (low["stable"], fine["stable"]) == (True, False)
    ((least, most),) = low["stable_gains"]
    assert answer["stability_gain"] == most == pytest.approx(10.83, abs=5e-3)
    assert least == pytest.approx(0.2326, abs=5e-5)
    # Of 1.6 samples of dead time two commands wait and a third acts in part; lag, integral, plant.
    assert len(low["poles"]) == 5
    assert (fine["gain_margin"], fine["phase_margin_rad"]) == (None, None)
    text = call("theory", "--kp", "2,30", *loop, "--details").out
    assert re.search(r"stable for Kp \[1/s\] +0.2326 to 10.83  0.2326 to 10.83", text)
    assert re.search(r"overshoots +by 22.43 % +without end", text)
    lines = text.splitlines()
    first = "Recommended without command limits: PI with Kp = 1.58 1/s and Ki = 0.139 1/s^2."
    assert lines[:2] == [first, "This is for 5 % overshoot."]
    assert lines[2].startswith(
        "Better than Kp = 2 1/s and Ki = 1 1/s^2 in overshoot (5 % instead of 22.4 "
    )
    assert "Stable for Kp from 0.2326 to 10.83 1/s." in lines
    assert any(
        line.startswith("Kp = 2: stable, overshoots by 22.43 % at the samples") for line in lines
    )
    assert "Kp = 30: unstable." in lines


def test_neutral_options_answer_as_p_on_an_integrator(call: Call) -> None:
    plain = call("theory", "--kp", "4", "--dead-time", "6", "--json").json["gains"][0]
    found = call("theory", "--kp", "4", "--dead-time-s", "0.096", "--json").json["gains"][0]
    same = ("poles", "stable", "overshoots", "overshoot_percent", "sampled_settling_time_s")
    assert [found[key] for key in same] == [plain[key] for key in same]
    assert found["gain_margin"] == pytest.approx(plain["gain_margin"])
    assert found["delay_margin_s"] == pytest.approx(plain["delay_margin_s"])


def test_a_scenario_is_answered_loop_by_loop(call: Call) -> None:
    answer = call("theory", "paper-kp10", "--json").json
    assert (answer["name"], answer["source"]) == ("paper-kp10", "scenario")
    rotate, translate = answer["loops"]
    assert (rotate["loop"], rotate["signal"], rotate["status"]) == ("rotate", "heading", "ok")
    assert (rotate["sampled"]["kp"], rotate["sampled"]["dead_time_s"]) == (10.0, 0.064)
    assert rotate["most_dead_time_s"] == pytest.approx(0.096)
    assert rotate["left_out"] == ["limits.turn_rate_rad_s = 1"]
    assert translate["left_out"] == ["limits.speed_m_s = 1"]
    assert {translate["sources"][key] for key in ("gains", "plant")} == {"from the scenario"}
    assert translate["sources"]["dead_time_s"] == "measured in the simulated run, 6 ticks"


def test_a_recording_gives_its_own_dead_times_and_says_where_they_are_from(
    call: Call, kp10: Path
) -> None:
    rotate, translate = call("theory", kp10, "--json").json["loops"]
    dead_times_s = [loop["sampled"]["dead_time_s"] for loop in (rotate, translate)]
    assert dead_times_s == pytest.approx([0.064, 0.096])
    assert rotate["sources"]["dead_time_s"] == "measured in the recording, 4 ticks"
    assert rotate["sources"]["gains"] == "from the scenario"
    lines = call("theory", kp10).out.splitlines()
    words = " ".join(lines)
    first = "kp10.mcap: recommended Kp = 3.54 1/s (rotate and translate)."
    assert lines[:2] == [first, "This is for 0 % overshoot, without command limits."]
    assert "rotate: better than Kp = 10 1/s in overshoot (0 % instead of 54.2 %), settling" in words
    assert "gain margin and phase margin; stable for Kp below 15.07 1/s." in words
    assert "--set law.kp_angular=3.54 --set law.kp_linear=3.54" in words
    assert len(lines) <= 40
    assert max(map(len, [line for line in lines if str(kp10) not in line])) <= 80
    details = " ".join(call("theory", kp10, "--details").out.split())
    assert "dead time measured in the recording, 6 ticks" in details


def test_a_recording_without_its_scenario_has_gains_identified(call: Call, tmp_path: Path) -> None:
    riddle = tmp_path / "riddle.mcap"
    call("run", "paper-kp4", "--strip-scenario", "-o", riddle)
    for loop in call("theory", riddle, "--json").json["loops"]:
        assert loop["sampled"]["kp"] == pytest.approx(4.0)
        assert loop["sources"]["gains"] == "identified from the commands"
        assert loop["sources"]["plant"] == "assumed, as the recording names no plant"


def test_a_loop_that_the_recording_does_not_show_has_the_dead_time_of_its_scenario(
    call: Call, tmp_path: Path
) -> None:
    """The loop oscillates, so the recording ends while it rotates."""
    late = ("textbook", "--kp", "15", "--set", "loop.transport_delay_ticks=12")
    cut = tmp_path / "cut.mcap"
    call("run", *late, "--set", "max_duration_s=20", "-o", cut)
    told = " ".join(call("theory", cut).out.split())
    assert told.startswith("cut.mcap: recommended Kp = 1.84 1/s (rotate and translate).")
    assert "the simulated run reached the goal within 2.27 mm" in told
    assert (
        "translate (along-track): the dead time cannot be measured: the run has no phase translate."
        " The dead time is from the scenario." in told
    )
    _, translate = call("theory", cut, "--json").json["loops"]
    assert translate["sampled"]["dead_time_s"] == pytest.approx(12 * 0.016)
    assert "cannot be measured" not in call("theory", *late).out


def test_a_law_that_theory_does_not_know_is_said_to_be_unknown(call: Call) -> None:
    answer = call("theory", "posture")
    assert answer.out.startswith("posture: theory has no linear model of its loops.\n")
    assert (answer.code, answer.out.count("is unknown: the law declares")) == (0, 2)
    loops = call("theory", "posture", "--json").json["loops"]
    assert [loop["status"] for loop in loops] == ["unknown", "unknown"]
    assert loops[0]["sampled"] is None
    assert "no loop is declared" in call("theory", "plant-step").out


def test_a_lagged_robot_is_answered_from_its_file(call: Call, tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(
        '[law]\nkind = "sequential-pid"\nkp_angular = 4.0\nkp_linear = 2.0\nki_linear = 0.5\n'
        '[plant]\nkind = "lagged"\nturn_lag_s = 0.1\nturn_dead_time_s = 0.08\nspeed_gain = 0.9\n'
        "[loop]\ntransport_delay_s = 0.03\njitter_s = 0.01\n[shaping]\nlow_pass_s = 0.05\n"
        "dead_zone_speed_m_s = 0.01\n"
    )
    rotate, translate = call("theory", path, "--json").json["loops"]
    assert rotate["sampled"]["process"] == {
        "gain": 1.0,
        "lag_s": 0.1,
        "dead_time_s": pytest.approx(0.115),  # the mean of the jitter is 5 ms
        "low_pass_s": 0.05,
    }
    assert translate["sampled"]["process"]["gain"] == 0.9
    assert rotate["left_out"] == ["limits.turn_rate_rad_s = 1", "loop.jitter_s = 0.01"]
    assert "shaping.dead_zone_speed_m_s = 0.01" in translate["left_out"]
    gained = call("theory", path, "--kp", "40", "--json").json["loops"]
    assert [loop["sampled"]["stable"] for loop in gained] == [False, False]
    slow = call("theory", path, "--set", "plant.turn_lag_s=0.5", "--json").json["loops"][0]
    assert slow["sampled"]["process"]["lag_s"] == 0.5


def test_gains_of_a_scenario_belong_to_no_recording(call: Call, kp10: Path) -> None:
    for words in (["--kp", "3"], ["--set", "law.kp_linear=3"]):
        answer = call("theory", kp10, *words)
        assert answer.code == 2
        assert f"{words[0]}: needs a scenario;" in answer.err


def test_many_gains_with_other_terms_stand_in_tables_that_fit(call: Call) -> None:
    answer = call("theory", "--kp", "1,2,3,4,5,6,7,8,9", "--ki", "0.1", "--lag", "0.1")
    rows = answer.out.partition("The sampled loop")[2].partition("---\n")[2].splitlines()[:9]
    assert [row.split()[0] for row in rows] == [*"123456789"]
    details = call("theory", "--kp", "1,2,3,4,5,6,7,8,9", "--ki", "0.1", "--details")
    assert details.out.count("Loop by loop") == 3
    for out in (answer.out, details.out):
        assert max(map(len, out.splitlines())) <= 80


def test_no_more_than_forty_lines_advise_on_four_gains(call: Call) -> None:
    answer = call("theory", "--lag", "0.2", "--dead-time-s", "0.1", "--ki", "0.01")
    assert len(answer.out.splitlines()) <= 40


@pytest.mark.thorough
@pytest.mark.parametrize(("kp", "words"), [("3.04", "no"), ("3.05", "by 0.01 %")])
def test_an_overshoot_that_no_digit_shows_is_none(call: Call, kp: str, words: str) -> None:
    options = ("--lag", "0.09", "--period", "0.001", "--low-pass", "0")
    found = call("theory", "--kp", kp, *options, "--json").json["gains"][0]
    assert found["overshoots"] == (words != "no")
    text = call("theory", "--kp", kp, *options, "--details").out
    assert re.search(rf"overshoots +{words}\n", text)


@pytest.mark.parametrize(("period_s", "limit"), [(0.1, "20"), (0.05, "40")])
def test_a_timer_is_stable_at_every_age_of_its_poses_up_to_the_told_gain(
    call: Call, period_s: float, limit: str
) -> None:
    words = " ".join(
        call(
            *("theory", "textbook", "--set", "loop.trigger=timer"),
            *("--set", f"loop.period_s={period_s}"),
        ).out.split()
    )
    # 2 / T, the limit with a new pose; old poses allow more between two samples.
    assert f"stable for Kp below {limit} 1/s at dead times up to 16 ms." in words


@pytest.mark.parametrize(
    ("kp", "verdict"),
    [
        ("33.1", "better than Kp = 33.1 1/s"),
        ("33.3", "Kp = 33.3 1/s is stable at a dead time of 16 ms, unstable at 32 ms. The dead"),
        ("62.4", "Kp = 62.4 1/s is stable at a dead time of 16 ms, unstable at 32 ms. The dead"),
        ("62.6", "Kp = 62.6 1/s is unstable"),
    ],
)
def test_no_verdict_is_told_between_the_limits_of_the_oldest_and_the_newest_pose(
    kp: str, verdict: str, call: Call
) -> None:
    timer = ("loop.trigger=timer", "loop.period_s=0.03", "sensing.delay_s=0.02")
    words = [word for key in timer for word in ("--set", key)]
    text = " ".join(call("theory", "textbook", *words, "--kp", kp, "--details").out.split())
    assert f"rotate and translate: {verdict}" in text
    assert "stable for Kp below 33.19 1/s at the most dead time, 32 ms." in text
    assert "sensing.delay_s=0.02, at the least dead time rotate translate" in text
