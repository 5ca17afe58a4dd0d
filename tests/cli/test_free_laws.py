"""Runs of the laws posture and open-loop at the command line, those without a goal above all."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import turtlelog as tl

Call = Callable[..., Any]
STEP = "step.mcap"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work where a run without a goal and the paper's run at Kp = 4 are recorded."""
    monkeypatch.chdir(tmp_path)
    for name, preset in {STEP: "plant-step", "kp4.mcap": "paper-kp4"}.items():
        tl.write_recording(tl.simulate_run(tl.load_scenario(preset)), tmp_path / name)
    return tmp_path


def test_metrics_of_a_run_without_a_goal_have_values(call: Call) -> None:
    out = call("metrics", STEP).out
    assert "absent" not in out
    assert "final." not in out
    found = call("metrics", STEP, "--all").out
    assert re.search(r"run\.turn_rate_effort +rad\^2/s +2\.4", found)


def test_metrics_along_a_path_need_no_goal(call: Call, folder: Path) -> None:
    (folder / "path.csv").write_text("x,y\n0,5\n9,5\n", encoding="utf-8")
    out = call("metrics", STEP, "--reference-path", "path.csv").out
    assert "cross-track error 0.544 m at most" in out
    assert "absent" not in out


def test_comparison_of_runs_without_a_goal_shows_what_they_have(call: Call) -> None:
    call("run", "plant-ramp", "-o", "ramp.mcap")
    out = call("compare", "--reference", STEP, "ramp.mcap").out
    assert "absent" not in out
    assert "effort" in out


def test_comparison_with_a_run_that_has_a_goal_shows_its_errors(call: Call) -> None:
    out = call("compare", "--reference", "kp4.mcap", STEP).out
    assert "0.0085202" in out


def test_explanation_of_a_run_without_a_goal_is_of_its_way(call: Call) -> None:
    out = " ".join(call("explain", STEP, "--details").out.split())
    assert "Its law is open-loop: parameters are identified from commands only for" in out
    assert out.startswith("step.mcap: run.path_length is 0 m: no effect changes it")


def test_explanation_of_a_metric_without_a_value_has_no_table_of_dashes(call: Call) -> None:
    out = call("explain", STEP, "--metric", "final.position_error").out
    assert out.startswith("step.mcap: final.position_error has no value: the goal is not known.\n")
    assert (
        "---"
        not in call("explain", STEP, "--metric", "final.position_error", "--details").out.partition(
            "Identified"
        )[0]
    )


def test_explanation_tells_the_dead_time_of_commands_that_change(call: Call) -> None:
    call("run", "textbook", "--commands", "kp4.mcap", "-o", "again.mcap")
    out = call("explain", "again.mcap", "--details").out
    assert "dead time of excite  0 ticks        exact" in out


def test_explanation_of_posture_claims_no_parameter(call: Call) -> None:
    call("run", "posture", "-o", "posture.mcap")
    out = " ".join(call("explain", "posture.mcap", "--details").out.split())
    assert "Its law is posture: parameters are identified from commands only for" in out
    assert "The recorded scenario reproduces all 810 samples." in out
    assert "gamma" not in out


def test_first_specification_of_a_run_without_a_goal_asks_for_none(call: Call) -> None:
    out = call("check", "--init", STEP).out
    assert "goal" not in out
    assert 'expect = "run.duration <= 2.7"' in out


def test_first_specification_is_passed(call: Call, folder: Path) -> None:
    (folder / "spec.toml").write_text(call("check", "--init", STEP).out, encoding="utf-8")
    assert call("check", "spec.toml", STEP).code == 0


@pytest.mark.parametrize("mode", [[], ["--plant"], ["--law"]])
def test_run_without_a_goal_is_replayed_equal(call: Call, mode: list[str]) -> None:
    assert call("replay", STEP, *mode, "--expect-equal").code == 0


def test_changed_replay_shows_what_changed(call: Call) -> None:
    out = call("replay", STEP, "--set", "law.amplitude=0.5").out
    assert "run.turn_rate_effort  rad^2/s       2.4       0.6        -1.8" in out


@pytest.mark.thorough
def test_figures_of_a_run_without_a_goal_have_no_column_of_dashes(call: Call) -> None:
    call("plot", STEP, "-o", "plot", "--format", "svg")
    table = Path("plot/whole-runs.tex").read_text(encoding="utf-8")
    assert "To the end of each run: duration" in table
    assert " - " not in table


def test_long_lists_of_a_scenario_are_shortened(call: Call) -> None:
    call("run", "textbook", "--commands", "kp4.mcap", "-o", "again.mcap")
    told = call("info", "again.mcap", "--parameters").out.splitlines()
    assert [line for line in told if "law.time_s" in line] == [
        "  law.time_s = [0.0, 2.016, 2.032, 2.048, 2.064, 2.08, 2.096, 2.112, ...]: 141 values"
    ]
    (entry,) = call("info", "again.mcap", "--json").json
    assert len(entry["parameters"]["law.time_s"]) == 141


def test_commands_of_a_recording_are_run(call: Call) -> None:
    out = call("run", "textbook", "--commands", "kp4.mcap").out
    assert out.startswith("textbook commands=kp4: the path is 5.6 m long and takes 11.2 s.\n")
    assert "\n700 samples. The run ended: end of signal.\n" in out


def test_commands_of_a_recording_are_printed_as_a_scenario(call: Call, folder: Path) -> None:
    text = call("scenario", "textbook", "--commands", "kp4.mcap").out
    (folder / "again.toml").write_text(text, encoding="utf-8")
    assert tl.load_scenario("again.toml").law.kind == "open-loop"


def test_law_gives_the_recorded_poses_the_recorded_commands(call: Call) -> None:
    found = call("replay", "--law", "--commands", "kp4.mcap", "--json", "kp4.mcap").json
    assert found["samples"] == 681


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (
            ["run", "--commands", "nowhere.mcap"],
            "nowhere.mcap: no such file",
        ),
        (
            ["replay", "--plant", STEP, "--commands", STEP],
            "--plant: leave out --commands; the recorded commands are used as they are",
        ),
        (
            ["run", "textbook", "--commands", STEP, "--kp", "3"],
            "--kp: this law declares no gain; set its keys with --set",
        ),
        (
            ["run", "plant-step", "--set", "law.signal=prbs", "--set", "law.order=8"],
            "--set: law.order: expected one of 2, 3, 4, 5, 6, 7, 9, 10, 11, 15, found 8",
        ),
    ],
)
def test_wrong_use_is_one_line(call: Call, words: list[str], line: str) -> None:
    found = call(*words)
    assert found.code == 2
    assert found.err.splitlines()[-1] == f"turtlelog: error: {line}"


def test_wrong_line_of_a_file_of_commands_is_named(call: Call, folder: Path) -> None:
    (folder / "drive.toml").write_text(
        '[law]\nkind = "open-loop"\nfile = "commands.csv"\n', encoding="utf-8"
    )
    (folder / "commands.csv").write_text("time_s,speed_m_s\n0,1\n1,x\n", encoding="utf-8")
    found = call("run", "drive.toml")
    assert found.code == 2
    expected = "commands.csv: line 3: speed_m_s: expected a finite number, found 'x'"
    assert found.err == f"turtlelog: error: {expected}\n"


def test_run_along_a_path_keeps_its_distance_from_it(call: Call, folder: Path) -> None:
    text = '[law]\nkind = "kanayama"\n[path]\nkind = "line"\npoints = [[5.6, 5.6], [7.0, 5.6]]\n'
    (folder / "path.toml").write_text(text, encoding="utf-8")
    out = call("run", "path.toml", "-o", "path.mcap").out
    assert out.startswith("textbook: cross-track error 0.0187 m RMS, 0.0786 m at most, in 2.82 s.")
    assert "goal" not in out
    assert '[checks."run.cross_track_max"]' in call("check", "--init", "path.mcap").out
