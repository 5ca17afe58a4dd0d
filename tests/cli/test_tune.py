"""`turtlelog tune`: what it answers, what it refuses, and that it can be stopped."""

import tomllib
from pathlib import Path
from typing import Any

import pytest

import turtlelog as tl
from tests.cli.conftest import Call


@pytest.fixture(autouse=True)
def _stay_in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


VARY = ("--grid", "law.kp_linear=0.5:12")
SETTLING = ("--minimise", "translate.settling_time")


def test_best_values_as_json_and_file(
    call: Call,
) -> None:
    done = call(
        "tune",
        "textbook",
        *VARY,
        *SETTLING,
        "--subject-to",
        "translate.overshoot <= 1",
        "--subject-to",
        "law.kp_linear <= 4",
        "--evaluations",
        "60",
        "--monte-carlo",
        "8",
        "-o",
        "best.toml",
        "--json",
    )
    assert (done.code, done.err) == (0, "")
    found = done.json
    assert 3.9 < found["best"]["law.kp_linear"] <= 4.0
    assert found["is_feasible"] is True
    assert [one["holds"] for one in found["constraints"]] == [True, True]
    assert found["constraints"][1]["value"] == found["best"]["law.kp_linear"]
    assert found["unit"] == "s"
    assert found["neighbourhood"][0]["high_end"] == "law.kp_linear <= 4"
    assert found["spread"]["runs"] == 8
    assert found["spread"]["varied"] == {"loop.transport_delay_ticks": [0, 1]}
    kept = tomllib.loads(Path("best.toml").read_text("utf-8"))
    assert kept["law"]["kp_linear"] == found["best"]["law.kp_linear"]
    run = tl.simulate_run(tl.load_scenario("best.toml"))
    metric = tl.measure_run(run, only=["translate.settling_time"])["translate.settling_time"]
    assert metric.value == found["objective"]


def test_text_tells_bounds_constraints_and_variants(call: Call) -> None:
    done = call(
        "tune",
        "textbook",
        *VARY,
        *SETTLING,
        "--subject-to",
        "translate.stable == 1",
        "--evaluations",
        "40",
        "--monte-carlo",
        "4",
        "--spread",
        "start.heading_rad=0:0.5",
        "--set",
        "sensing.noise_position_m=0.001",
    )
    assert (done.code, done.err) == (0, "")
    assert done.out.startswith("law.kp_linear = 12: translate.settling_time is ")
    assert "s, the smallest of the 82\nof 83 candidates that fulfil the constraints." in done.out
    assert "translate.stable == 1      1       0  yes" in done.out
    assert "4 variants of the best" in done.out
    assert "start.heading_rad from 0 to 0.5" in done.out
    assert "seed from 0 to 3" in done.out
    assert "its seed changes nothing" not in done.out


@pytest.mark.thorough
def test_the_intervals_of_an_identified_robot_are_drawn(call: Call) -> None:
    assert call("run", "lagged", "-o", "bag.mcap").code == 0
    told = call("identify", "bag.mcap", "--scenario", "robot.toml", "--json")
    assert told.code == 0
    Path("robot.json").write_text(told.out, "utf-8")
    words = ("--minimise", "run.duration", "--evaluations", "16", "--monte-carlo", "4", "--json")
    done = call("tune", "robot.toml", *VARY, *words, "--robot", "robot.json")
    assert (done.code, done.err) == (0, "")
    varied = done.json["spread"]["varied"]
    (axis,) = (one for one in told.json["axes"] if one["axis"] == "speed")
    assert varied["plant.speed_lag_s"] == [axis["lag_s"]["low"], axis["lag_s"]["high"]]
    assert {key.split("_")[0] for key in varied} == {"loop.transport", "plant.speed", "plant.turn"}


def test_nothing_that_fulfils_the_constraints_is_exit_code_1(call: Call) -> None:
    done = call(
        "tune",
        "textbook",
        *VARY,
        *SETTLING,
        "--subject-to",
        "translate.settling_time < 2",
        "--evaluations",
        "40",
        "--monte-carlo",
        "4",
    )
    assert (done.code, done.err) == (1, "")
    assert (
        done.out.splitlines()[0]
        == "None of 32 candidates fulfils the constraints; law.kp_linear = 12 comes nearest."
    )
    assert "variants" not in done.out


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ((*VARY,), "tune needs --grid KEY=A:B and --minimise or --maximise"),
        (
            (*VARY, *SETTLING, "--maximise", "run.duration"),
            "--minimise or --maximise, not both",
        ),
        ((*SETTLING,), "--grid: expected a key and its bounds"),
        (
            ("--grid", "law.kp=1:2", *SETTLING),
            "--grid: law.kp: unknown key; did you mean",
        ),
        (("--grid", "law.kp_linear=-2:-1", *SETTLING), "expected a number > 0"),
        (("--grid", "name=1:2", *SETTLING), "--grid: name: expected a key whose values are num"),
        (("--grid", "law.wrap_error=0:1", *SETTLING), "whose values are numbers, found True"),
        ((*VARY, "--minimise", "nothing"), 'unknown name "nothing"'),
        ((*VARY, "--minimise", "final.position_eror"), "final.position_error"),
        ((*VARY, "--minimise", "along.overshoot"), "which has no such loop"),
        ((*VARY, "--minimise", "rotate."), "expected a number, name"),
        ((*VARY, *SETTLING, "--subject-to", "translate.overshoot"), "expected a condition"),
        ((*VARY, *SETTLING, "--subject-to", "translate.overshoot <"), "--subject-to"),
        (
            (*VARY, *SETTLING, "--set", "law.kp_linear=2"),
            "--set: law.kp_linear is tuned by --grid; leave one of them out",
        ),
        ((*VARY, *SETTLING, "--evaluations", "3"), "--evaluations 3: must be at least 8"),
        ((*VARY, *SETTLING, "--seed", "-1"), "--seed -1: must be 0 or greater"),
        (
            (*VARY, *SETTLING, "--spread", "law.kp_angular=1:2"),
            "--spread: needs --monte-carlo COUNT",
        ),
        ((*VARY, *SETTLING, "--robot", "r.json"), "--robot: needs --monte-carlo COUNT"),
        ((*VARY, *SETTLING, "--monte-carlo", "0"), "from 1 to 1,000,000"),
        (
            (*VARY, *SETTLING, "--monte-carlo", "2", "--spread", "law.kp_linear=1:2"),
            "--spread: law.kp_linear is tuned by --grid; leave one of them out",
        ),
        ((*VARY, *SETTLING, "-o", "best.json"), "best.json: the name must end in .toml"),
        ((*VARY, *SETTLING, "-o", "none/best.toml"), "no such folder"),
        ((*VARY, *SETTLING, "--jobs", "2", "--scheduler", "tcp://127.0.0.1:1"), "--jobs"),
    ],
)
def test_what_it_refuses(
    call: Call,
    words: tuple[str, ...],
    reason: str,
) -> None:
    done = call("tune", "textbook", *words)
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith("turtlelog: error: ")
    assert done.err.count("\n") == 1
    assert reason in done.err


def test_what_no_candidate_has_is_said_with_its_reason(call: Call) -> None:
    done = call(
        "tune", "textbook", *VARY, *SETTLING, "--set", "max_duration_s=1", "--evaluations", "16"
    )
    assert (done.code, done.out) == (2, "")
    assert "no candidate has a value to compare" in done.err
    assert "translate.settling_time: no_phase" in done.err


LAW = """
from dataclasses import dataclass
from turtlelog.laws import Decision


@dataclass(frozen=True, kw_only=True)
class Parameters:
    gain: float


class Steer:
    Parameters = Parameters

    def __init__(self, parameters):
        self.parameters = parameters

    def reset(self, start, goal, path):
        self.goal = goal

    def step(self, time_ns, pose):
        left_m = self.goal.x_m - pose.x_m
        reason = "arrived" if abs(left_m) < 0.01 else None
        speed = self.parameters.gain * left_m
        return Decision(speed_m_s=speed, turn_rate_rad_s=0.0, stop_reason=reason)
"""


def test_a_key_without_a_default_is_tuned_and_the_name_tells_it(call: Call) -> None:
    Path("mine.py").write_text(LAW, "utf-8")
    words = ("--law", "mine.py:Steer", "--goal", "7,5.5", "--minimise", "run.duration")
    done = call(
        "tune",
        *words,
        "--grid",
        "law.gain=0.5:4",
        "--evaluations",
        "8",
        "-o",
        "best.toml",
        "--json",
    )
    assert (done.code, done.err) == (0, "")
    best = done.json["best"]["law.gain"]
    kept = tomllib.loads(Path("best.toml").read_text("utf-8"))
    assert kept["law"]["gain"] == best
    assert kept["name"] == f"textbook law=mine.py:Steer goal=7,5.5 law.gain={best:.6g}"


def test_candidates_that_fail_are_counted_with_a_reason(call: Call) -> None:
    law = LAW.replace(
        "        left_m =", "        1 / (self.parameters.gain < 2)\n        left_m ="
    )
    Path("mine.py").write_text(law, "utf-8")
    words = ("--law", "mine.py:Steer", "--goal", "7,5.5", "--minimise", "run.duration")
    done = call("tune", *words, "--grid", "law.gain=0.5:4", "--evaluations", "8")
    assert (done.code, done.err) == (0, "")
    assert "candidates failed, the first: law mine.py:Steer" in done.out
    assert "ZeroDivisionError" in done.out.replace("\n", " ")


def test_values_that_make_no_scenario_are_told_by_their_option(call: Call) -> None:
    words = ("--grid", "start.x_m=-9:9", "--minimise", "run.duration", "--evaluations", "16")
    done = call("tune", "textbook", *words)
    assert (done.code, done.err) == (0, "")
    assert "failed, the first: --grid: start.x_m: expected a number from 0 to" in done.out


def test_a_name_that_is_set_stays(call: Call) -> None:
    words = (*VARY, *SETTLING, "--evaluations", "8", "--set", "name=mine", "-o", "best.toml")
    assert call("tune", "textbook", *words).code == 0
    assert tomllib.loads(Path("best.toml").read_text("utf-8"))["name"] == "mine"


def test_keys_that_change_nothing_are_told(call: Call) -> None:
    done = call("tune", "textbook", *VARY, "--maximise", "rotate.stable", "--evaluations", "8")
    assert (done.code, done.err) == (0, "")
    first = " ".join(done.out.split("\n\n")[0].split())
    assert first.startswith("rotate.stable is 1 for all ")
    assert first.endswith(" candidates that can be compared: no key changes it.")
    assert "at its bound" not in done.out


def test_a_best_value_at_a_bound_is_told_before_the_table(call: Call) -> None:
    words = ("tune", "textbook", "--grid", "kp=1:4", *SETTLING, "--evaluations", "12")
    assert call(*words).out.splitlines()[1] == "kp is at its bound: beyond 4 it may be better."
    assert "to 4 (its bound) is at most " in call(*words).out
    inner = ("tune", "textbook", "--grid", "kp=0.5:12", *SETTLING, "--evaluations", "40")
    queue = ("--grid", "loop.start_backlog=1:7", "--minimise", "final.position_error")
    least = call("tune", "paper", "--kp", "10", *queue).out  # no queue is shorter than 1
    assert "loop.start_backlog = 1: " in least
    assert "at its bound: beyond" not in least
    best = call(*inner, "--json").json
    assert best["at_bounds"] == []
    assert "at its bound" not in call(*inner).out


@pytest.mark.parametrize(
    ("word", "metric", "told"),
    [
        ("--minimise", "final.cross_track", 1),
        ("--maximise", "final.cross_track", 0),
        ("--minimise", "final.position_error", 0),
    ],
)
def test_the_least_of_a_metric_with_a_sign_is_told(
    call: Call, word: str, metric: str, told: int
) -> None:
    done = call("tune", "textbook", "--grid", "goal.x_m=2:9", word, metric, "--evaluations", "8")
    assert (done.code, done.err) == (0, "")
    assert done.out.count(f"{metric} has a sign: abs({metric}) is least") == told


def test_ctrl_c_says_the_best_so_far(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("turtlelog.sweep.tune_search._Search.refine", stop)
    done = call("tune", "textbook", *VARY, *SETTLING, "--evaluations", "16")
    assert done.code == 130
    assert "candidates so far: law.kp_linear = " in done.err


def test_kp_tunes_all_gains_together(call: Call) -> None:
    """Search, and simulate the best again: some 70 runs (2.4 s)."""
    words = ("--minimise", "run.duration", "--evaluations", "20", "--json", "-o", "best.toml")
    done = call("tune", "textbook", "--grid", "kp=1:4", *words)
    assert (done.code, done.err) == (0, "")
    best = done.json["best"]["kp"]
    law = tl.load_scenario("best.toml").law.parameters
    assert law.kp_angular == law.kp_linear == best
    value = tl.measure_run(tl.simulate_run("best.toml"))["run.duration"].value
    assert value == done.json["objective"]
    bound = ("--evaluations", "8", "--subject-to", "law.kp_linear <= 9")
    done = call("tune", "textbook", "--grid", "kp=1:4", *words[:2], *bound)
    text = " ".join(done.out.split())
    assert "candidates, which all fulfil the constraints." in text


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--grid", "law.kp_linear=1:4"], "--grid: kp sets law.kp_linear too; leave one of them"),
        (["--kp", "3"], "--kp: the gains are tuned by --grid kp; leave one of them out"),
        (["--set", "law.kind=open-loop"], "kp: the law declares no gain"),
    ],
)
def test_kp_beside_a_gain_is_refused(call: Call, words: list[str], line: str) -> None:
    done = call("tune", "textbook", "--grid", "kp=1:4", *words, "--minimise", "run.duration")
    assert done.code == 2
    assert line in done.err


def test_keys_that_decide_whether_there_is_a_value_are_not_said_to_change_nothing(
    call: Call,
) -> None:
    pause = ("--grid", "law.pause_ticks=0:40", "--minimise", "rotate.settling_time")
    first = call("tune", "paper", "--kp", "20", *pause, "--evaluations", "20").out.split("\n\n")[0]
    assert "no key changes it" not in first
    assert " others have no value or break a constraint." in " ".join(first.split())


def test_candidates_of_one_seed_are_told_if_chance_has_a_part(call: Call) -> None:
    told = "Every candidate has the same random effects, of seed 0."
    few, noise = ("--evaluations", "8"), ("--set", "sensing.noise_position_m=0.01")
    noisy = call("tune", "textbook", *VARY, *SETTLING, *few, *noise)
    assert told in " ".join(noisy.out.split())
    spread = call("tune", "textbook", *VARY, *SETTLING, *few, *noise, "--monte-carlo", "4")
    exact = call("tune", "textbook", *VARY, *SETTLING, *few)
    assert "random effects, of" not in spread.out + exact.out
