from pathlib import Path

import pytest

import turtlelog as tl
from tests.cli.conftest import Call
from tests.sequential import METRICS
from tests.simulate.pid_law import KIND as PID_KIND


def test_run_prints_metrics_and_writes_nothing_unasked(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    answer = call("run", "paper-kp10")
    assert (answer.code, answer.err) == (0, "")
    lines = answer.out.splitlines()
    assert lines[:2] == [
        "paper-kp10: missed the goal by 0.107 m (allowed: 0.00669 m) after 12.6 s.",
        "770 samples. The run ended: standstill.",
    ]
    assert len(lines) <= 40
    assert max(map(len, lines)) <= 80
    assert ["overshoot", "1.01", "%", "0.945", "%"] in [line.split() for line in lines]
    why = "Why? Record the run with -o FILE.mcap, then: turtlelog explain FILE.mcap"
    assert why in lines[:6]
    reached = call("run", "textbook").out.splitlines()
    assert reached[-1] == "To explain, plot or compare this run, record it: -o FILE.mcap"
    assert "Why?" not in " ".join(reached)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "first"),
    [
        (["paper-kp1"], "paper-kp1: reached the goal within 2.52 mm after 20.5 s."),
        (["paper-kp4"], "paper-kp4: missed the goal by 8.52 mm (allowed: 6.69 mm) after 11.2 s."),
        (["posture"], "posture: reached the goal within 0.998 mm after 12.9 s."),
        (
            ["track-square"],
            "track-square: cross-track error 0.0506 m RMS, 0.185 m at most, in 40 s.",
        ),
        (
            ["textbook", "--set", "law.kp_angular=6", "--set", "max_duration_s=4"],
            "textbook: missed the goal by 4.62 m (allowed: 0.00669 m) after 4 s.",
        ),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_the_first_line_tells_how_far_from_the_goal_it_ended(
    call: Call, words: list[str], first: str
) -> None:
    lines = call("run", *words).out.splitlines()
    assert lines[0] == first
    if "--set" in words:
        assert lines[1] == "Changed: law.kp_angular=6 max_duration_s=4"


def test_a_law_that_stops_where_it_believes_the_goal_to_be_did_not_reach_it(call: Call) -> None:
    words = ("--set", "sensing.noise_position_m=0.02", "--set", "seed=3")
    first = call("run", "paper-kp4", *words).out.splitlines()[0]
    assert first == "paper-kp4: missed the goal by 0.0175 m (allowed: 0.00669 m) after 11.4 s."


def test_run_records_what_it_simulates(call: Call, tmp_path: Path) -> None:
    answer = call("run", "paper-kp4", "-o", tmp_path / "a.mcap", "--rrd", tmp_path / "a.rrd")
    assert answer.code == 0
    assert len(tl.read_recording(tmp_path / "a.mcap").samples) == 681
    assert (tmp_path / "a.rrd").stat().st_size > 10_000
    assert answer.err == f"wrote {tmp_path / 'a.mcap'}\nwrote {tmp_path / 'a.rrd'}\n"


def test_run_answers_in_json(call: Call, tmp_path: Path) -> None:
    answer = call("run", "textbook", "--kp", "2", "-o", tmp_path / "a.mcap", "--json").json
    assert answer["name"] == "textbook kp=2"
    assert answer["file"] == str(tmp_path / "a.mcap")
    assert answer["rrd"] is None
    assert {metric["id"] for metric in answer["metrics"]} == set(METRICS)


def test_options_apply_gains_then_goal_then_single_keys(call: Call, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    words = ("--kp", "4", "--goal", "3,4.5", "--set", "law.kp_linear=2", "--set", "seed=7")
    assert call("run", "textbook", *words, "-o", path).code == 0
    found = tl.read_recording(path).parameters
    assert (found["law.kp_angular"], found["law.kp_linear"]) == (4.0, 2.0)
    assert (found["goal.x_m"], found["goal.y_m"], found["seed"]) == (3.0, 4.5, 7)


@pytest.mark.parametrize(
    ("words", "name"),
    [
        ([], "textbook"),
        (["--kp", "4"], "textbook kp=4"),
        (
            ["--goal", "3,4.5", "--set", "law.kp_linear=2", "--set", "seed=7"],
            "textbook goal=3,4.5 law.kp_linear=2 seed=7",
        ),
        (["--kp", "4", "--set", "name=mine"], "mine"),
        (["--set", "law.kp_linear=\n2"], "textbook law.kp_linear=\\n2"),
    ],
)
def test_a_run_is_named_by_its_changes_as_a_replay_is(
    call: Call, tmp_path: Path, words: list[str], name: str
) -> None:
    paths = [tmp_path / file for file in ("run.mcap", "base.mcap", "replay.mcap")]
    assert call("run", "textbook", *words, "-o", paths[0]).code == 0
    assert tl.read_recording(paths[0]).name == name
    tl.write_recording(tl.simulate_run(tl.load_scenario("textbook")), paths[1])
    assert call("replay", paths[1], *words, "-o", paths[2]).code == 0
    assert tl.read_recording(paths[2]).name == name


def test_a_printed_scenario_is_named_by_its_changes(call: Call, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(call("scenario", "paper", "--kp", "3").out)
    assert call("run", path).out == call("run", "paper", "--kp", "3").out


def test_a_printed_scenario_runs_as_a_file(call: Call, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(call("scenario", "paper-kp10").out)
    assert call("run", path).out == call("run", "paper-kp10").out


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["nosuch"], 'no preset or file "nosuch"'),
        (["missing.toml"], "missing.toml: no such file"),
        (["--kp", "-1"], "--kp: law.kp_angular: expected a number > 0, found -1.0"),
        (["--kp", "nan"], "--kp: law.kp_angular: expected a finite number, found nan"),
        (["--kp", "fast"], "--kp fast: must be a number"),
        (["--goal", "3"], "--goal 3: must be X,Y in metres"),
        (["--goal", "3,4,5"], "--goal 3,4,5: must be X,Y in metres"),
        (
            ["--goal", "30,3"],
            "--goal: goal.x_m: expected a number from 0 to 11.08888912, found 30",
        ),
        (["--goal", "nan,3"], "--goal: goal.x_m: expected a finite number, found nan"),
        (
            ["--set", "law.kp_linar=4"],
            "--set: law.kp_linar: unknown key; did you mean kp_linear?",
        ),
        (
            ["--set", "speed_m_s=2"],
            "--set: speed_m_s: unknown key; did you mean limits.speed_m_s or path.speed_m_s?",
        ),
        (
            ["--set", "speed=2"],
            "--set: speed: unknown key; did you mean limits.speed_m_s or path.speed_m_s?",
        ),
        (["--set", "x_m=2"], "--set: x_m: unknown key; did you mean start.x_m or goal.x_m?"),
        (["--set", "sed=2"], "--set: sed: unknown key; did you mean seed or path.closed?"),
        (["--set", "seed"], "--set: expected key=value, found 'seed'"),
        (["--set", "law.kind=a.py:B"], "law.kind: no Python file a.py"),
        (
            ["--set", "max_duration_s=0.05"],
            "paper max_duration_s=0.05: no pose is answered within max_duration_s = 0.05",
        ),
        (["--nope"], "turtlelog run has no option --nope; did you mean --kp?"),
        (["-o"], "turtlelog run: -o needs a path"),
        (["-o", "no/such/folder/a.mcap"], "a.mcap: there is no such folder to write to"),
        (["--rrd", "no/such/folder/a.rrd"], "a.rrd: there is no such folder to write to"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_a_bad_option_is_one_line(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], line: str
) -> None:
    monkeypatch.chdir(tmp_path)
    answer = call("run", *words)
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.startswith("turtlelog: error: ")
    assert line in answer.err
    assert answer.err.count("\n") == 1


COUNTED = """
from dataclasses import dataclass
from turtlelog.laws import Decision
from turtlelog.run.loops import ControlLoop, Declaration


@dataclass(frozen=True)
class Parameters:
    steps: int = 1
    gain: float = 1.0


class Counted:
    Parameters = Parameters

    @classmethod
    def declare(cls, parameters, goal, path):
        turn = ControlLoop(
            name="turn", signal="heading", command="turn_rate", reference="zero", gain="law.steps"
        )
        go = ControlLoop(
            name="go", signal="distance", command="speed", reference="zero", gain="law.gain"
        )
        return Declaration(loops=(turn, go), phases={"one": ("turn", "go")})

    def __init__(self, parameters):
        pass

    def reset(self, start, goal, path):
        pass

    def step(self, time_ns, pose):
        return Decision(speed_m_s=0.0, turn_rate_rad_s=0.0, stop_reason="end")
"""


def write_counted(folder: Path) -> Path:
    (folder / "law.py").write_text(COUNTED)
    path = folder / "a.toml"
    path.write_text(f"[law]\nkind = '{folder / 'law.py'}:Counted'\n")
    return path


@pytest.mark.parametrize("kp", ["3", "9007199254740992"])
def test_kp_sets_a_gain_that_is_a_whole_number(call: Call, tmp_path: Path, kp: str) -> None:
    path = tmp_path / "a.mcap"
    assert call("run", write_counted(tmp_path), "--kp", kp, "-o", path).code == 0
    found = tl.read_recording(path).parameters
    assert (found["law.steps"], found["law.gain"]) == (int(kp), float(kp))
    assert (type(found["law.steps"]), type(found["law.gain"])) == (int, float)


@pytest.mark.parametrize(
    ("kp", "found"), [("2.5", "2.5"), ("9007199254740994", "9007199254740994.0")]
)
def test_kp_that_is_no_whole_number_is_refused_for_such_a_gain(
    call: Call, tmp_path: Path, kp: str, found: str
) -> None:
    refused = call("run", write_counted(tmp_path), "--kp", kp, "-o", tmp_path / "a.mcap")
    assert (refused.code, refused.out) == (2, "")
    assert f"--kp: law.steps: expected a whole number, found {found}\n" in refused.err


def test_run_notes_a_gain_above_theorys_limit_and_changes_nothing_else(
    call: Call, tmp_path: Path
) -> None:
    answer = call("run", "textbook", "--set", "law.kp_angular=125.1", "--json")
    assert answer.code == 0
    assert answer.err == (
        "rotate: law.kp_angular = 125.1 is above 125 1/s, where theory's loop with a period of"
        " 16 ms and no dead time becomes unstable; clipping only bounds its oscillation\n"
    )
    assert answer.json["name"] == "textbook law.kp_angular=125.1"
    assert call("run", "textbook", "--set", "law.kp_angular=125").err == ""


def test_a_live_run_has_the_same_notes_once(call: Call) -> None:
    words = ("--set", "law.kp_linear=150", "--set", "max_duration_s=0.1")
    at_once, live = (
        call("run", "textbook", *words, *option).err for option in ((), ("--realtime",))
    )
    # A busy machine may be late with a tick, which a live run tells as well.
    assert [line for line in live.splitlines() if not line.startswith("late ticks:")] == (
        at_once.splitlines()
    )
    assert at_once.count("translate: law.kp_linear = 150 is above 125 1/s") == 1


def test_run_notes_a_goal_heading_that_its_law_does_not_use(call: Call) -> None:
    answer = call("run", "textbook", "--set", "goal.heading_rad=1.0")
    assert (answer.code, answer.err) == (0, "law sequential-p does not use goal.heading_rad\n")


@pytest.mark.parametrize(
    ("words", "is_noted"),
    [((), False), (("--goal", "2,10"), True), (("--set", "goal.y_m=10"), True)],
)
def test_a_goal_that_is_given_gets_a_note_even_where_it_is_the_default(
    call: Call, words: tuple[str, ...], *, is_noted: bool
) -> None:
    answer = call("run", "textbook", "--set", f"law.kind={PID_KIND}", *words)
    assert answer.err == (f"law {PID_KIND} does not use [goal]\n" if is_noted else "")


def test_a_wall_in_the_way_is_told(call: Call, tmp_path: Path) -> None:
    changes = [
        *("--law", "sequential-pid", "--set", "law.ki_linear=2", "--set", "law.ki_angular=2"),
        *("--set", "law.anti_windup=none"),
    ]
    wall = "The turtle hit the wall at x = 1.132 m, y = 11.089 m, at 18.0 s: the wall held it back"
    recording = tmp_path / "wall.mcap"
    assert wall in call("run", "textbook", *changes, "-o", recording).flat
    assert wall in call("metrics", recording).flat
    assert wall in call("explain", recording).flat
    # It slides on along the wall, and meets it again.
    slides = ["--kp", "20", "--set", "goal.x_m=11.05", "--set", "goal.y_m=9"]
    told = "at 7.3 s, the first of 49 contacts: the wall held it back."
    assert told in call("run", "paper", *slides, "--set", "start.heading_rad=0.3").flat
    # A robot in a world without walls goes on.
    plant = ["--set", "plant.kind=lagged", "--set", "plant.speed_lag_s=0"]
    assert "wall" not in call("run", "textbook", *changes, *plant).flat
