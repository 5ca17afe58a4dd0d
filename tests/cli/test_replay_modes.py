import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import turtlelog as tl
from tests.cli.conftest import Call
from tests.log.ros2.bags import make_poses, make_stamped_pose, write_mcap
from tests.log.runs import find_shared
from tests.replay.changes import write_law

EXACT = {"x": 0.0, "y": 0.0, "heading": 0.0}
NOT_COMPARED = {"x": None, "y": None, "heading": None}
ROOT = Path(__file__).parents[2]


def test_the_closed_loop_is_the_default(call: Call, kp4: Path) -> None:
    answer = call("replay", kp4, "--json").json
    assert (answer["file"], answer["mode"], answer["by"]) == (str(kp4), "loop", "tick")
    assert (answer["samples"], answer["max_abs_error"]) == (681, EXACT)
    assert (answer["first_difference"], answer["not_compared"]) == (None, [])
    assert {signal["largest"] for signal in answer["signals"]} == {0.0}
    assert answer["counts"]["commands"] == {"recorded": 681, "replayed": 681}
    assert answer["stop_reason"] == {"recorded": "standstill", "replayed": "standstill"}
    assert [answer[name] for name in ("stretches", "jumps", "gaps")] == [[], [], []]


def test_an_equal_replay_is_told_in_one_sentence(call: Call, kp4: Path) -> None:
    answer = call("replay", kp4)
    assert (answer.code, answer.err) == (0, "")
    lines = answer.out.splitlines()
    assert lines[0] == "kp4.mcap: the replay equals the recording in every column."
    assert lines[-1] == "0 of 23 signals differ: --details"
    assert "final.position_error" not in answer.out
    details = call("replay", kp4, "--details").out
    assert ["turn_rate", "rad/s", "0", "-", "0", "681"] in map(str.split, details.splitlines())
    assert max(map(len, details.splitlines())) <= 80


def test_a_law_answers_in_json(call: Call, kp4: Path) -> None:
    answer = call("replay", kp4, "--law", "--set", "law.kp_linear=4.000004", "--json").json
    assert (answer["mode"], answer["law"], answer["samples"]) == ("law", "sequential-p", 681)
    assert answer["max_abs_error"] == NOT_COMPARED
    assert answer["first_difference"] == {
        "signal": "wanted_speed",
        "time_s": 3.296,
        "recorded": 22.77369061561925,
        "replayed": 22.77371338930986,
    }
    command = answer["first_command_difference"]
    assert (command["signal"], command["time_s"]) == ("speed", 8.752)
    [speed] = [signal for signal in answer["signals"] if signal["signal"] == "speed"]
    assert (speed["unit"], speed["rows"], speed["differing"]) == ("m/s", 681, 153)


def test_a_law_answers_in_text(call: Call, kp4: Path) -> None:
    equal = call("replay", kp4, "--law").out
    assert equal.startswith("kp4.mcap: sequential-p commands what was recorded.\n")
    answer = call("replay", kp4, "--law", "--set", "law.kp_angular=4.000004")
    assert answer.out.startswith("kp4.mcap: sequential-p departs in ")
    assert "recorded 8.97118 rad/s, replayed 8.97119 rad/s" in " ".join(answer.out.split())
    assert "First command: turn rate at 2.016 s" in answer.out


@pytest.mark.parametrize(
    "words", [["FILE", "--law", "KIND"], ["--law", "KIND", "FILE"], ["FILE", "--law=KIND"]], ids=str
)
def test_a_law_of_ones_own_is_put_in(call: Call, kp4: Path, words: list[str]) -> None:
    kind = f"{ROOT / 'examples' / 'turn_and_drive.py'}:TurnAndDrive"
    spoken = [word.replace("KIND", kind).replace("FILE", str(kp4)) for word in words]
    answer = call("replay", *spoken, "--set", "law.kp_angular=2", "--json").json
    assert (answer["law"], answer["samples"]) == (kind, 681)
    assert answer["first_difference"]["signal"] == "wanted_turn_rate"
    assert answer["stop"]["recorded"] == "standstill"


def test_the_file_may_follow_the_law_option(call: Call, kp4: Path) -> None:
    assert (
        call("replay", "--law", kp4, "--json").json == call("replay", kp4, "--law", "--json").json
    )


def test_what_if_writes_a_recording_that_says_what_it_is(
    call: Call, kp10: Path, tmp_path: Path
) -> None:
    target = tmp_path / "other.mcap"
    answer = call("replay", kp10, "--set", "loop.queue_policy=newest", "-o", target)
    assert (answer.code, answer.err) == (0, f"wrote {target}\n")
    lines = answer.out.splitlines()
    first = (
        "with loop.queue_policy=newest, it missed the goal by 0.0268 m (allowed: 0.00669 m) after"
        " 10.9 s, not 0.107 m after 12.6 s as recorded."
        " The replay departs in heading at 0.016 s: recorded 0 deg, replayed 0.916733 deg."
    )
    assert " ".join(lines).startswith(f"kp10.mcap: {first}")
    assert len(lines) <= 40
    assert max(map(len, lines)) <= 80
    assert "final.position_error     m      0.10673    0.026837    -0.079891" in answer.out
    run = tl.read_recording(target)
    assert run.name == "paper-kp10 loop.queue_policy=newest"
    assert run.source == "replay of paper-kp10"
    assert call("replay", target, "--expect-equal").code == 0


@pytest.mark.parametrize(
    ("gain", "told"),
    [
        ("5", "by 8.52 mm (allowed: 6.69 mm) after 11.3 s, not after 11.2 s as recorded."),
        ("3.9999", "by 8.52 mm (allowed: 6.69 mm) after 11.2 s, almost as recorded."),
        ("4.0000001", "by 8.52 mm (allowed: 6.69 mm) after 11.2 s, as recorded."),
    ],
)
def test_an_error_that_reads_the_same_is_not_called_another(
    call: Call, kp4: Path, gain: str, told: str
) -> None:
    assert told in call("replay", kp4, "--set", f"law.kp_linear={gain}").flat


def test_what_if_answers_in_json(call: Call, kp10: Path) -> None:
    words = ["--set", "name=short", "--set", "max_duration_s=1", "--kp", "4", "--goal", "3,4"]
    answer = call("replay", kp10, *words, "--json").json
    assert answer["replay"] == "short"
    assert answer["stop_reason"]["replayed"] == "max_duration"
    metrics = {metric["id"]: metric for metric in answer["metrics"]}
    error = metrics["final.position_error"]
    assert error["difference"] == error["replayed"] - error["recorded"]
    duration = metrics["translate.settling_time"]
    assert (duration["replayed"], duration["difference"]) == (None, None)
    assert duration["replayed_status"] == "no_phase"


def test_the_published_logs_replay_with_a_scenario(call: Call) -> None:
    path = find_shared("paper", "kp4_210.json")
    answer = call("replay", path, "--scenario", "paper-kp4", "--json").json
    assert (answer["by"], answer["max_abs_error"], answer["samples"]) == ("sample", EXACT, 681)
    assert answer["first_difference"] is None
    assert (
        "Not in the recording: wanted_speed"
        in call("replay", path, "--law", "--scenario", "paper-kp4", "--details").out
    )


def test_what_a_log_knows_of_its_scenario_stays(call: Call) -> None:
    path = find_shared("paper", "kp4_210.json")
    answer = call("replay", path, "--law", "--scenario", "paper", "--json")
    assert "law.kp_linear = 4.0 (1.0)" in answer.err
    assert answer.json["first_difference"] is None
    changed = call("replay", path, "--law", "--scenario", "paper", "--kp", "5", "--json")
    assert changed.json["first_difference"]["signal"] == "turn_rate"


def test_another_scenario_takes_the_place_of_the_recordings_own(call: Call, kp4: Path) -> None:
    answer = call("replay", kp4, "--scenario", "paper-kp10", "--json").json
    assert (answer["name"], answer["replay"]) == ("paper-kp4", "paper-kp4 as paper-kp10")
    assert answer["counts"]["samples"] == {"recorded": 681, "replayed": 770}


def test_a_difference_fails_only_where_equality_is_expected(call: Call, kp4: Path) -> None:
    change = ["--law", "--set", "law.kp_linear=4.000004"]
    assert call("replay", kp4, *change).code == 0
    assert call("replay", kp4, *change, "--expect-equal").code == 1
    assert call("replay", kp4, *change, "--expect-equal", "--tolerance", "1e-4").code == 0
    assert call("replay", kp4, "--plant", "--expect-equal").code == 0


@pytest.mark.parametrize("mode", [[], ["--law"]], ids=["loop", "law"])
def test_the_verdict_on_a_replay_is_that_of_check(call: Call, kp4: Path, mode: list[str]) -> None:
    words = ["replay", kp4, *mode, "--set", "law.kp_linear=4.000004"]
    answer = call(*words, "--expect-equal", "--json").json
    name = mode[0].strip("-") if mode else "loop"
    differing = {found["signal"]: found for found in answer["signals"] if found["differing"]}
    failed = {found["check"]: found for found in answer["results"] if found["verdict"] == "FAIL"}
    assert answer["verdict"] == "FAIL"
    assert {f"{name}.{signal}" for signal in differing} == {*failed}
    assert len(answer["results"]) == len(answer["signals"]) > len(failed)
    for signal, found in differing.items():
        result = failed[f"{name}.{signal}"]
        assert (result["value"], result["value_s"]) == (found["largest"], found["at_s"])
        assert result["margin"] == -found["largest"]
        assert result["first_violation_s"] == found["first_difference"]["time_s"]
    text = call(*words, "--expect-equal").out
    counts = f"{len(failed)} of {len(answer['results'])} checks fail"
    names = f"{next(iter(failed))} and {len(failed) - 1} more"
    assert f"\nFAIL: {kp4}: {counts} ({names})\n" in text
    assert call(*words).out.rstrip() in text
    assert "PASS" not in text
    unasked = call(*words, "--json").json
    assert (unasked["verdict"], unasked["results"]) == (None, None)


def test_a_replay_that_ends_elsewhere_fails_by_its_counts_and_end(call: Call, kp4: Path) -> None:
    words = ["replay", kp4, "--scenario", "paper-kp10", "--expect-equal", "--json"]
    results = {found["check"]: found for found in call(*words).json["results"]}
    assert results["loop.samples"]["reason"] == "recorded 681, replayed 770"
    assert results["loop.samples"]["first_violation_s"] == 11.184


def test_rounding_is_the_limit_of_a_replay_through_the_plant(call: Call, kp4: Path) -> None:
    answer = call("replay", kp4, "--plant", "--expect-equal", "--json").json
    (stretch,) = answer["stretches"]
    found = [(result["check"], result["limit"]) for result in answer["results"]]
    rounding = stretch["rounding"]
    limits = [rounding["position"], rounding["position"], rounding["heading"]]
    assert found == list(zip(["plant.x", "plant.y", "plant.heading"], limits, strict=True))
    assert answer["verdict"] == "PASS"


def test_a_recovered_recording_is_replayed_as_far_as_it_goes(call: Call, tmp_path: Path) -> None:
    live, cut, whole = (tmp_path / f"{name}.mcap" for name in ("live", "cut", "whole"))
    scenario = tl.load_scenario("paper-kp4")
    with tl.Recorder(live, scenario) as recorder:
        tl.simulate.run_live(scenario, [recorder], realtime=False)
    cut.write_bytes(live.read_bytes()[: live.stat().st_size // 2])
    answer = call("replay", cut)
    assert (answer.code, f"turtlelog convert --recover {cut} -o OUT" in answer.err) == (2, True)
    assert call("convert", "--recover", cut, "-o", whole).code == 0
    answer = call("replay", whole, "--expect-equal")
    assert answer.code == 0
    assert "in every column, as far as that goes." in answer.flat
    assert call("replay", whole, "--law", "--expect-equal").code == 0


def test_a_replay_that_departs_says_whether_code_or_versions_differ(
    call: Call, tmp_path: Path
) -> None:
    law, path, other = tmp_path / "law.py", tmp_path / "a.mcap", tmp_path / "b.mcap"
    kind = write_law(law)
    assert call("run", "textbook", "--set", f"law.kind={kind}", "-o", path).code == 0
    law.write_text(law.read_text("utf-8").replace("speed_m_s=0.0", "speed_m_s=0.5"), "utf-8")
    words = ["replay", path, "--trust-law"]
    for mode in ([], ["--law", kind]):
        assert "The code of the law is not the recorded one." in call(*words, *mode).flat
    run = tl.read_recording(path)
    tl.write_recording(replace(run, simulated_by={**run.simulated_by, "numpy": "1.0"}), other)
    text = call("replay", other, "--trust-law").flat
    assert "by different software: NumPy 1.0, then " in text
    assert "; the code of the law." in text
    changed = call("replay", path, "--trust-law", "--json").json["software"]
    assert [one["name"] for one in changed] == ["law"]


def test_a_replay_that_departs_by_itself_names_the_software_of_both(
    call: Call, kp4: Path, tmp_path: Path
) -> None:
    run = tl.read_recording(kp4)
    speed = run.samples.speed_m_s.copy()
    speed[300] += 1e-3
    spoilt = replace(run, samples=replace(run.samples, speed_m_s=speed))
    tl.write_recording(spoilt, tmp_path / "a.mcap")
    tl.write_recording(replace(spoilt, simulated_by={}), tmp_path / "b.mcap")
    assert "Recorded and replayed by turtlelog " in call("replay", tmp_path / "a.mcap").flat
    assert "replayed by" not in call("replay", tmp_path / "b.mcap").flat
    assert "replayed by" not in call("replay", tmp_path / "a.mcap", "--set", "seed=2").flat


def test_a_recording_of_a_law_that_is_gone_says_so(call: Call, tmp_path: Path) -> None:
    law, path = tmp_path / "law.py", tmp_path / "a.mcap"
    kind = write_law(law)
    assert call("run", "textbook", "--set", f"law.kind={kind}", "-o", path).code == 0
    law.unlink()
    answer = call("replay", path, "--trust-law")
    assert (answer.code, answer.err.count("\n")) == (2, 1)
    assert f"law.kind: no Python file {law}\n" in answer.err
    assert call("replay", path, "--law", "sequential-p").code == 0


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (
            ["bag.mcap"],
            "bag.mcap: replay needs turtlesim's pose of each tick (16 ms) or the samples",
        ),
        (["bag.mcap", "--law"], "(topic /turtle1/control)"),
        (
            ["ticks.mcap"],
            "ticks.mcap: expected a run with its whole scenario, found mcap: ticks.mcap",
        ),
        (
            ["ticks.mcap", "--law", "--kp", "1"],
            "ticks.mcap: expected a run with its whole scenario",
        ),
        ([], "replay needs a recording: turtlelog replay FILE"),
        (["--law"], "replay needs a recording: turtlelog replay FILE"),
        (["--law", "a:B", "kp4.mcap", "x"], "--law: takes at most 2 words, not 3"),
        (["kp4.mcap", "--law", "a:B", "c:D"], "--law: takes one KIND, not a:B c:D"),
        (
            ["kp4.mcap", "--law", "kp4.mcap"],
            'no law "kp4.mcap"; list: turtlelog list laws. A law of your own is path.py:Class or',
        ),
        (["kp4.mcap", "--law", "--plant"], "--plant and --law: choose one"),
        (["kp4.mcap", "--law", "-o", "b.mcap"], "--output: leave out --law, which makes no run"),
        (
            ["kp4.mcap", "--plant", "-o", "b.mcap"],
            "--output: leave out --plant, which makes no run",
        ),
        (
            ["kp4.mcap", "--plant", "--kp", "3"],
            "--plant: leave out --kp; the recorded commands are used as",
        ),
        (
            ["kp4.mcap", "--plant", "--tolerance", "0"],
            "--plant: leave out --tolerance; the recorded commands",
        ),
        (["kp4.mcap", "-o", "kp4.mcap"], "kp4.mcap: this is the input; name another file to write"),
        (["kp4.mcap", "-o", "b.txt"], "b.txt: the name must end in .mcap"),
        (
            ["kp4.mcap", "--law", "--set", "loop.period_ticks=2"],
            "--set loop.period_ticks: must be a key of law, shaping, limits, goal, because",
        ),
        (
            ["kp4.mcap", "--set", "law.kp=2"],
            "sequential-p has no key law.kp; did you mean",
        ),
        (["kp4.mcap", "--set", "law.kp_linear=nan"], "--set: law.kp_linear: expected a finite num"),
        (["kp4.mcap", "--scenario", "no"], 'no preset or file "no"'),
        (["kp4.mcap", "--tolerance", "nan"], "expected a finite number >= 0, found nan"),
        (["kp4.mcap", "--tolerance", "inf"], "expected a finite number >= 0, found inf"),
        (
            ["kp4.mcap", "--set", "max_duration_s=0.01"],
            "no pose is answered within max_duration_s = 0.01",
        ),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_bad_input_is_one_line(
    call: Call,
    kp4: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    line: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(kp4, "kp4.mcap")
    write_mcap(Path("bag.mcap"), [make_stamped_pose()])
    write_mcap(Path("ticks.mcap"), make_poses(5))
    answer = call("replay", *words)
    assert (answer.code, answer.out) == (2, "")
    *read, last = answer.err.splitlines()
    assert line in last
    assert not [text for text in read if "error" in text]


def test_commands_published_otherwise_are_not_what_the_law_answers(
    call: Call, kp4: Path, tmp_path: Path
) -> None:
    run = tl.read_recording(kp4)
    none = np.zeros(len(run.commands))
    commands = replace(run.commands, speed_m_s=none, turn_rate_rad_s=none)
    tl.write_recording(replace(run, commands=commands), tmp_path / "zero.mcap")
    answer = call("replay", tmp_path / "zero.mcap", "--law", "--expect-equal")
    assert answer.code == 1
    line = "The commands as published differ from the law's in command_speed, command_turn_rate."
    assert line in " ".join(answer.out.split())
    assert call("replay", kp4, "--law", "--expect-equal").code == 0
    driven = tl.Recording(tmp_path / "zero.mcap")
    found = driven.driven_by().matches(driven)
    assert [result.check for result in found.failures] == [
        "law.command_speed",
        "law.command_turn_rate",
    ]


def test_commands_that_are_missing_are_not_what_the_law_answers(
    call: Call, kp4: Path, tmp_path: Path
) -> None:
    run = tl.read_recording(kp4)
    names = ("time_ns", "speed_m_s", "lateral_speed_m_s", "turn_rate_rad_s")
    fewer = {name: getattr(run.commands, name)[:9] for name in names}
    commands = replace(run.commands, **fewer)
    tl.write_recording(replace(run, commands=commands), tmp_path / "few.mcap")
    answer = call("replay", tmp_path / "few.mcap", "--law", "--expect-equal")
    assert answer.code == 1
    assert "departs in commands at 11.184 s: recorded 9, replayed 681." in " ".join(
        answer.out.split()
    )
    assert "published are not one per sample, and are not compared." in answer.out
    driven = tl.Recording(tmp_path / "few.mcap")
    (result,) = driven.driven_by().matches(driven).failures
    assert (result.check, result.reason) == ("law.commands", "recorded 9, the law answers 681")


def test_shaping_can_be_changed_as_limits_can(call: Call, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    assert call("run", "textbook", "--set", "max_duration_s=0.5", "-o", path).code == 0
    answer = call("replay", path, "--law", "--set", "shaping.low_pass_s=0.1", "--json").json
    assert answer["first_difference"]["signal"] == "turn_rate"
    assert answer["not_compared"] == ["shaped_speed", "shaped_turn_rate"]


def test_a_law_that_ends_before_the_recording_does_is_told_so(call: Call, kp10: Path) -> None:
    told = call("replay", kp10, "--law", "--set", "law.kp_linear=4").flat
    assert "The end: stop at " in told
    assert "recorded no end yet, replayed standstill." in told
