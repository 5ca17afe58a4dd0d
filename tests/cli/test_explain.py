import math
from dataclasses import replace
from pathlib import Path

import pytest
from rerun.chunk import RrdReader

import turtlelog as tl
from tests.cli.conftest import Call, read_identified
from tests.explain.logs import add_noise
from tests.log.ros2.bags import make_poses, make_stamped_pose, write_mcap
from tests.log.runs import find_shared


def test_explain_finds_what_was_built_in(call: Call, kp10: Path) -> None:
    answer = call("explain", kp10, "--json").json
    identified = read_identified(answer)
    assert (identified["loop.start_backlog"], identified["law.pause_ticks"]) == (5, 33)
    assert (identified["dead_time.rotate"], identified["dead_time.translate"]) == (4, 6)
    assert (identified["law.kp_angular"], identified["law.kp_linear"]) == (10.0, 10.0)
    assert (identified["limits.speed_m_s"], identified["limits.turn_rate_rad_s"]) == (1.0, 1.0)
    assert (identified["law.projection"], identified["stop_reason"]) == ("bearing", "standstill")
    assert identified["lost_commands"] == 4
    assert answer["resimulation"] == {
        "samples": 770,
        "max_abs_error": {"x": 0.0, "y": 0.0, "heading": 0.0},
        "max_command_error": 0.0,
        "is_exact": True,
    }


@pytest.mark.thorough
def test_explain_names_the_settings_that_it_tried(call: Call, kp10: Path) -> None:
    """That nothing is found shows when the whole search is done."""
    tried = call("explain", kp10, "--json").json["tried"]
    assert tried["loop.transport_delay_ticks"] == [0, 1, 2, 3, 4]
    assert tried["loop.queue_policy"] == ["newest", "one-per-tick"]
    text = " ".join(call("explain", kp10, "--details").out.split())
    assert "Settings tried: queue policy newest, one-per-tick; command queue 2 to 7;" in text
    assert "; transport delay 0 to 4 ticks." in text


def test_a_log_with_a_row_missing_is_explained_as_json(call: Call, tmp_path: Path) -> None:
    rows = find_shared("paper", "kp4_210_main.csv").read_text().splitlines(keepends=True)
    path = tmp_path / "kp4_without_line_300.csv"
    path.write_text("".join(rows[:299] + rows[300:]))
    answer = call("explain", path, "--json")
    assert answer.code == 0
    assert isinstance(answer.json["resimulation"]["is_exact"], bool)


def test_explain_attributes_the_error(call: Call, kp10: Path) -> None:
    found = call("explain", kp10, "--json").json["attribution"]
    assert (found["metric"], found["unit"]) == ("final.position_error", "m")
    assert found["as_logged"] == found["resimulated"] == pytest.approx(0.10673, abs=1e-5)
    assert [one["cause"] for one in found["contributions"]] == ["queue", "pause", "wrap"]
    assert math.fsum(one["contribution"] for one in found["contributions"]) == (
        found["resimulated"] - found["without_all"]
    )
    assert found["without_all"] < 0.006
    assert {one["cause"] for one in found["others"]} == {
        "saturation",
        "sampling",
        "float32",
        "projection",
        "tolerance",
    }
    assert (found["starts"]["is_wide"], found["withheld"]) == (True, None)


def test_withheld_contributions_are_an_empty_list_with_both_values(call: Call) -> None:
    log = find_shared("paper", "kp4_210.json")
    found = call("explain", log, "--metric", "rotate.overshoot", "--json").json["attribution"]
    assert (found["as_logged"], found["resimulated"]) == pytest.approx(
        (0.039355, 0.066729), abs=1e-6
    )
    assert (found["contributions"], "a tenth" in found["withheld"]) == ([], True)


def test_a_metric_without_a_value_is_explained_by_what_leaves_it_so(
    call: Call, tmp_path: Path
) -> None:
    values = {"law.kp_angular": 10.0, "goal.y_m": 5.6, "max_duration_s": 20.0}
    scenario = tl.override_scenario(tl.load_scenario("paper"), values)
    tl.write_recording(tl.simulate_run(scenario), tmp_path / "wrapping.mcap")
    words = ("explain", tmp_path / "wrapping.mcap", "--metric", "translate.duration")
    found = call(*words, "--json").json["attribution"]
    assert (found["as_logged"], found["resimulated"], found["contributions"]) == (None, None, [])
    assert [case["causes"] for case in found["without_value"]] == [["queue", "wrap"]]
    assert "With queue and wrap it has no value" in call(*words).out


def test_what_is_not_identified_is_null_with_its_reason(call: Call, kp10: Path) -> None:
    answer = call("explain", kp10, "--json").json
    (wrap,) = (one for one in answer["identified"] if one["key"] == "law.wrap_error")
    assert (wrap["value"], wrap["certainty"]) == (None, "unknown")
    assert wrap["evidence"] == "the heading error stays within half a turn"


def test_explain_writes_the_scenario(call: Call, tmp_path: Path, kp10: Path) -> None:
    path = tmp_path / "found.toml"
    assert call("explain", kp10, "--scenario", path).code == 0
    assert tl.load_scenario(path) == tl.load_scenario("paper-kp10")
    assert [*tmp_path.iterdir()] == [path]


@pytest.mark.thorough
def test_explain_draws_the_run_beside_its_what_ifs(call: Call, tmp_path: Path, kp10: Path) -> None:
    answer = call("explain", kp10, "--rrd", tmp_path / "why.rrd")
    assert answer.code == 0
    assert "why.rrd" in answer.err
    entities = {chunk.entity_path for chunk in RrdReader(tmp_path / "why.rrd").stream()}
    ghosts = ["without_queue", "without_pause", "without_queue_and_pause"]
    prefixes = ["/runs/recorded", *(f"/ghosts/{ghost}" for ghost in ghosts)]
    assert {f"{prefix}/plane/path" for prefix in prefixes} < entities
    assert {"/attribution/bar_3", "/attribution/words", "/plane/gap"} < entities
    assert {"/luck/words", "/plane/close_up/luck"} < entities


def test_the_answer_begins_with_the_value_and_its_causes(call: Call, kp10: Path) -> None:
    lines = call("explain", kp10).out.splitlines()
    assert lines[:3] == [
        "kp10.mcap: final.position_error is 0.1067 m: queue and pause add 0.1017 m",
        "",
        "Two effects of the implementation cause it together in this run:",
    ]
    assert lines[3].startswith("  queue  +0.05108 m  commands wait: dead time 4 ticks rotating")
    assert lines[4].startswith("  pause  +0.05057 m  the controller is silent for 0.528 s")
    assert "Without it (tolerances of 1e-06) the value is 0.0009877 m." in " ".join(lines)
    sure = "Confidence: exact. The re-simulation reproduces all 770 samples bit for bit."
    given = "Gains are taken as given. What they change: turtlelog compare --why RUN RUN"
    assert lines[-3:] == [sure, given, "Every cause, setting and its evidence: --details"]


def test_the_details_are_the_table_of_causes_and_of_settings(call: Call, kp10: Path) -> None:
    answer, details = call("explain", kp10).out, call("explain", kp10, "--details").out
    lines = details.splitlines()
    assert details.startswith(answer.rpartition("\nEvery cause")[0])
    assert max(map(len, lines)) <= 80
    assert any(line.startswith("pause                  33 ticks") for line in lines)
    assert any(
        line.startswith("tolerance              -  0.00098771  tolerances") for line in lines
    )
    text = " ".join(details.split())
    assert "differences of the re-simulation, in 770 samples: x 0 m, y 0 m, heading 0 deg" in text


def test_the_answer_fits_a_screen(call: Call, kp10: Path, tmp_path: Path) -> None:
    """Three logs are explained, of which one has noise and one is a robot's."""
    noisy = tl.override_scenario(tl.load_scenario("paper"), {"sensing.noise_heading_rad": 0.01})
    tl.write_recording(tl.simulate_run(noisy), tmp_path / "noisy.mcap")
    for file in (kp10, tmp_path / "noisy.mcap", find_shared("robots", "tb3")):
        lines = call("explain", file).out.splitlines()
        assert lines[0].startswith(f"{file.name}: ")
        assert len(lines) <= 40
        assert max(map(len, lines)) <= 80


def test_a_law_of_ones_own_shows_the_settings_of_its_causes(call: Call, turn: Path) -> None:
    words = ("explain", turn, "--metric", "run.turn_rate_total_variation", "--trust-law")
    lines = call(*words).out.splitlines()
    size = "run.turn_rate_total_variation is 6.435 rad/s"
    assert lines[0] == f"turn.mcap: {size}: delay +5.4 rad/s"
    assert lines[3] == "  delay  +5.4 rad/s  loop.transport_delay_ticks = 6"


def test_more_causes_take_part(call: Call, kp10: Path) -> None:
    words = ("--causes", "queue, pause,saturation", "--metric", "final.heading_error")
    found = call("explain", kp10, *words, "--json").json["attribution"]
    assert [one["cause"] for one in found["contributions"]] == ["queue", "pause", "saturation"]
    assert found["unit"] == "deg"


TURTLE_WORDS = ("backlog", "Kp", "pause", "projection", "turtlesim's", "tick", "unknown", "metric")


def test_explain_says_of_a_turtlesim_bag_what_its_plant_tells(call: Call) -> None:
    bag = find_shared("ros2", "turtlesim_jazzy")
    answer = call("explain", bag, "--json")
    assert answer.code == 1
    identified = read_identified(answer.json)
    assert (identified["loop.start_backlog"], identified["lost_commands"]) == (None, 0)
    assert answer.json["attribution"] is None
    motion = answer.json["motion"]
    assert (motion["kind"], motion["poses"]["rows"], motion["commands"]["rows"]) == (
        *("turtlesim", 2501, 18),
    )
    assert motion["poses"]["longest_silence_s"] == pytest.approx(1.600373167)
    assert motion["command_delays"]["ticks"] == [{"ticks": 0, "commands": 18}]
    assert (motion["replay"]["within_rounding"], len(motion["replay"]["jumps"])) == (True, 1)
    text = " ".join(call("explain", bag).out.split())
    for sentence in (
        "turtlesim_jazzy: not explained, because there are no samples of a controller.",
        "Turtlesim, run.duration 42.066 s, of /turtle1/pose",
        "The plant reproduces every pose.",
        "Dead time of the 18 commands that a pose shows: 18 in the next tick.",
        "At 15.632 s: jump (spawn) to x = 5.544 m",
        "An explanation needs the samples of the controller",
    ):
        assert sentence in text
    assert not any(word in text for word in ("backlog", "Kp", "projection", "unknown", "metric"))


def test_explain_says_of_a_robot_its_rates_and_nothing_of_a_turtle(call: Call) -> None:
    bag = find_shared("robots", "tb3")
    answer = call("explain", bag)
    text = " ".join(answer.out.split())
    assert answer.code == 1
    assert text.endswith(f"Response to its commands: turtlelog identify {bag}")
    for sentence in (
        "tb3: not explained, because there are no samples of a controller.",
        "A robot, not turtlesim, ",
        "634 commands, usually one every 101.",
        "Largest commands: speed 0.12 m/s at ",
        "The measured turn rate has 1 outlier, -143.6 rad/s at ",
        "1 jump, ",
    ):
        assert sentence in text
    assert not any(word in text for word in TURTLE_WORDS)
    motion = call("explain", bag, "--json").json["motion"]
    assert (motion["replay"], motion["command_delays"], motion["gaps"]) == (None, None, [])
    [jump] = motion["jumps"]
    assert jump["moved"] == pytest.approx(-0.00726, abs=1e-5)
    assert {found["signal"]: found["value"] for found in motion["largest_commands"]} == {
        "speed": pytest.approx(0.12),
        "turn_rate": pytest.approx(0.3),
    }


def test_explain_says_of_poses_alone_how_many_there_are(call: Call, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", [make_stamped_pose()])
    answer = call("explain", path)
    assert answer.code == 1
    assert " ".join(answer.out.split()).endswith(f"turtlelog metrics {path}")
    assert "1 pose.\nNo commands.\n\nAn explanation needs" in answer.out
    assert call("explain", path, "--json").json["motion"]["poses"]["period_s"] is None


@pytest.mark.parametrize(("last_ticks", "is_silence"), [(1.49, False), (1.51, True)])
def test_a_period_and_a_half_is_a_silence(
    call: Call, tmp_path: Path, last_ticks: float, *, is_silence: bool
) -> None:
    *poses, last = make_poses(5)
    last = replace(last, time_ns=poses[-1].time_ns + round(last_ticks * 16e6))
    text = " ".join(call("explain", write_mcap(tmp_path / "a.mcap", [*poses, last])).out.split())
    assert ("the longest silence" in text) is is_silence


def test_poses_that_come_at_no_tick_are_not_turtlesims(call: Call, tmp_path: Path) -> None:
    first_ns = make_poses(1)[0].time_ns
    late = [
        replace(pose, time_ns=first_ns + 10 * (pose.time_ns - first_ns)) for pose in make_poses(5)
    ]
    text = " ".join(call("explain", write_mcap(tmp_path / "a.mcap", late)).out.split())
    assert (
        "A robot that publishes poses as turtlesim does, not turtlesim, run.duration 0.640" in text
    )
    assert "was not driven" not in text


def test_a_recording_with_samples_is_explained_by_them(call: Call, kp10: Path) -> None:
    assert call("explain", kp10, "--json").json["motion"] is None


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--metric", "luck"], 'no metric "luck"; list: turtlelog list metrics'),
        (["--metric", "final.postion_error"], "did you mean final.position_error"),
        (["--causes", "queue,luck"], 'no cause "luck"'),
        (["--causes", "queue,queue"], "causes: expected different ones"),
        (["--rrd", "why.txt"], "the name must end in .rrd"),
        (["--scenario", "found.txt"], "the name must end in .toml"),
        (["--scenario", "no/such/found.toml"], "there is no such folder"),
    ],
    ids=str,
)
def test_bad_usage_is_one_line(call: Call, kp10: Path, words: list[str], line: str) -> None:
    answer = call("explain", kp10, *words)
    assert (answer.code, answer.out, answer.err.count("\n")) == (2, "", 1)
    assert line in answer.err


@pytest.fixture
def turn(tmp_path: Path) -> Path:
    """A recording of the example's law, with a gain and a delay that do not go together."""
    values = {"law.kind": "examples/turn_and_drive.py:TurnAndDrive", "law.kp_angular": 12.0,
              "loop.transport_delay_ticks": 6}  # fmt: skip
    scenario = tl.override_scenario(tl.load_scenario("textbook"), values)
    tl.write_recording(tl.simulate_run(scenario), tmp_path / "turn.mcap")
    return tmp_path / "turn.mcap"


@pytest.fixture
def no_scenario(turn: Path, tmp_path: Path) -> Path:
    """The same, without the rest of its scenario."""
    run = replace(tl.read_recording(turn), scenario_is_complete=False)
    tl.write_recording(run, tmp_path / "part.mcap")
    return tmp_path / "part.mcap"


@pytest.mark.thorough
def test_a_scenario_that_is_not_identified_is_not_written(
    call: Call, no_scenario: Path, tmp_path: Path
) -> None:
    answer = call("explain", no_scenario, "--scenario", tmp_path / "found.toml")
    assert answer.code == 2
    assert "textbook: expected a run of the law sequential-p, or one that its own" in answer.err
    drawn = call("explain", no_scenario, "--rrd", tmp_path / "why.rrd")
    assert (drawn.code, (tmp_path / "why.rrd").exists()) == (2, False)
    assert "why.rrd: there is nothing to draw, because no scenario fits this log" in drawn.err


@pytest.mark.thorough
def test_nothing_is_said_of_a_law_that_is_another(call: Call, no_scenario: Path) -> None:
    answer = call("explain", no_scenario, "--json").json
    identified = read_identified(answer)
    assert (identified["law.kp_angular"], identified["law.projection"]) == (None, None)
    assert (identified["dead_time.align"], identified["dead_time.approach"]) == (6, 6)
    (gain,) = (one for one in answer["identified"] if one["key"] == "law.kp_linear")
    assert (gain["value"], gain["evidence"]) == (None, answer["notes"][0])
    assert "examples/turn_and_drive.py:TurnAndDrive" in answer["notes"][0]
    assert (answer["resimulation"], answer["attribution"]) == (None, None)
    text = call("explain", no_scenario).out
    assert "no command that turns" not in text
    assert text.startswith("part.mcap: final.position_error is 0.004927 m")
    assert "; its causes are unknown\n" in text
    assert "dead time of align 6 ticks" in " ".join(text.split())


def test_another_law_is_explained_with_trust_only(call: Call, turn: Path) -> None:
    words = ("explain", turn, "--metric", "run.turn_rate_total_variation")
    refused = call(*words)
    assert (refused.code, refused.out, refused.err.count("\n")) == (2, "", 1)
    assert "--trust-law" in refused.err
    found = call(*words, "--trust-law", "--json").json
    assert found["attribution"]["as_logged"] == pytest.approx(6.435, abs=1e-3)
    assert found["attribution"]["without_all"] == pytest.approx(1.034, abs=1e-3)
    assert [one["cause"] for one in found["attribution"]["contributions"]] == ["delay"]
    assert read_identified(found).get("law.kp_linear") is None
    text = " ".join(call(*words, "--trust-law").out.split())
    other = ("Kp", "heading tolerance", "position tolerance", "projection")
    assert not [word for word in other if word in text]
    assert "Without delay it would be 1.034 rad/s." in text


@pytest.mark.thorough
def test_a_law_that_was_changed_is_said_to_depart(call: Call, turn: Path, tmp_path: Path) -> None:
    run = tl.read_recording(turn)
    changed = replace(run, parameters={**run.parameters, "law.kp_angular": 11.0})
    tl.write_recording(changed, tmp_path / "changed.mcap")
    words = ("explain", tmp_path / "changed.mcap", "--trust-law")
    text = " ".join(call(*words, "--details").out.split())
    assert "departs at 0.000 s: nothing is claimed of the law" not in text
    assert "The recorded scenario reproduces the first " in text
    assert "No scenario fits this log. The plant was driven with its commands." in text
    assert "Settings tried: initial queue 1, 7 poses; queue policy newest, one-per-tick" in text
    assert "; its causes are unknown" in call(*words).out.splitlines()[0]


def test_a_metric_of_a_loop_that_the_run_does_not_declare_is_refused_at_once(
    call: Call, kp10: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("turtlelog.identify_run", None)
    refused = call("explain", kp10, "--metric", "a.overshoot")
    assert (refused.code, refused.out) == (2, "")
    assert 'no metric "a.overshoot"; did you mean rotate' in refused.err
    assert "rotate.overshoot" in refused.err


@pytest.mark.parametrize(
    ("late_us", "told"),
    [(1, "usually one every 16 ms."), (100, "usually one every 16.1 ms; nine of ten within 15.9")],
)
def test_the_spread_of_periods_is_told_where_it_shows(
    call: Call, tmp_path: Path, late_us: int, told: str
) -> None:
    said = [
        replace(pose, time_ns=pose.time_ns + 1000 * late_us * (row % 2))
        for row, pose in enumerate(make_poses(200, topic="/pose"))
    ]
    assert told in " ".join(call("explain", write_mcap(tmp_path / "bag.mcap", said)).out.split())


def test_the_confidence_is_fitted_where_no_sample_is_reproduced_exactly(
    call: Call, kp10: Path, tmp_path: Path
) -> None:
    """The search tries all settings, as none reproduces every sample."""
    noisy = add_noise(tl.read_recording(kp10), 1e-4, 1)
    tl.write_recording(
        replace(noisy, parameters={}, scenario_is_complete=False), tmp_path / "a.mcap"
    )
    text = " ".join(call("explain", tmp_path / "a.mcap").out.split())
    assert "None reproduces every sample." in text
    assert "Confidence: fitted. Largest differences of the re-simulation, in 770 samples: " in text
    assert "exact" not in text
