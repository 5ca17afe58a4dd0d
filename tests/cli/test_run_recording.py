"""`run` and `scenario` of a recording, and recordings without their scenario."""

from pathlib import Path

import pytest
from mcap.reader import make_reader

import turtlelog as tl
from tests.cli.conftest import Call, read_identified
from turtlelog.log.recording.head import HEAD

LAW = """
from pathlib import Path
Path({marker!r}).touch()
from turtlelog.laws import SequentialP
class Mine(SequentialP):
    pass
"""


def test_a_recording_runs_again_to_the_same_bytes(call: Call, kp10: Path, tmp_path: Path) -> None:
    answer = call("run", kp10, "-o", tmp_path / "again.mcap")
    assert answer.code == 0
    assert answer.out.startswith(
        "paper-kp10: missed the goal by 0.107 m (allowed: 0.00669 m) after 12.6 s.\n770 samples."
    )
    assert (tmp_path / "again.mcap").read_bytes() == kp10.read_bytes()


def test_the_scenario_of_a_recording_is_printed_and_changed(call: Call, kp10: Path) -> None:
    assert call("scenario", kp10).out == call("scenario", "paper-kp10").out
    changed = call("scenario", kp10, "--kp", "3", "--goal", "8,8", "--set", "seed=4").out
    assert changed.startswith('name = "paper-kp10 kp=3 goal=8,8 seed=4"')
    found = tl.parse_scenario(changed)
    assert (found.seed, found.goal.x_m) == (4, 8.0)
    assert found.law.parameters.kp_angular == found.law.parameters.kp_linear == 3.0


def test_a_bag_runs_again(call: Call, kp4: Path, tmp_path: Path) -> None:
    call("convert", kp4, "-o", tmp_path / "bag")
    assert "\n681 samples." in call("run", tmp_path / "bag").out


def test_the_law_of_a_recording_runs_when_it_is_trusted(call: Call, tmp_path: Path) -> None:
    marker, law, file = (tmp_path / name for name in ("ran", "law.py", "own.mcap"))
    law.write_text(LAW.format(marker=str(marker)))
    assert call("run", "textbook", "--set", f"law.kind={law}:Mine", "-o", file).code == 0
    marker.unlink()
    answer = call("run", file)
    assert (answer.code, answer.out, answer.err.count("\n")) == (2, "", 1)
    assert "expected a built-in law, or --trust-law" in answer.err
    assert f'kind = "{law}:Mine"' in call("scenario", file, "--kp", "3").out
    assert not marker.exists()
    # The file may have been loaded in this process before: its text decides.
    law.write_text(law.read_text() + "\n# again\n")
    assert call("run", file, "--trust-law").code == 0
    assert marker.exists()


def test_a_stripped_recording_holds_no_scenario(call: Call, tmp_path: Path) -> None:
    riddle = tmp_path / "riddle.mcap"
    words = ("paper", "--kp", "3.25", "--set", "law.pause_ticks=21", "--strip-scenario")
    assert call("run", *words, "-o", riddle).code == 0
    with riddle.open("rb") as stream:
        reader = make_reader(stream)
        assert list(reader.iter_attachments()) == []
        (record,) = reader.iter_metadata()
    assert record.name == HEAD
    assert record.metadata["name"] == "riddle"
    assert "scenario" not in record.metadata
    assert b"3.25" not in riddle.read_bytes()
    assert b"pause_ticks" not in riddle.read_bytes()
    run = tl.read_recording(riddle)
    assert (dict(run.parameters), run.scenario_is_complete) == ({}, False)
    assert call("info", riddle, "--json").json[0]["absent"] == ["parameters"]


def test_a_stripped_recording_is_solved_by_explain(call: Call, tmp_path: Path) -> None:
    riddle = tmp_path / "riddle.mcap"
    words = ("paper", "--kp", "3.25", "--set", "law.pause_ticks=21", "--strip-scenario")
    call("run", *words, "-o", riddle)
    found = call("explain", riddle, "--causes", "pause", "--json").json
    identified = read_identified(found)
    assert (identified["law.kp_angular"], identified["law.kp_linear"]) == (3.25, 3.25)
    assert (identified["law.pause_ticks"], identified["loop.start_backlog"]) == (21, 5)
    assert found["resimulation"]["is_exact"] is True


def test_a_stripped_view_is_called_by_its_file(call: Call, tmp_path: Path) -> None:
    view = tmp_path / "riddle.rrd"
    assert call("run", "paper-kp4", "--strip-scenario", "--rrd", view).code == 0
    assert b"paper-kp4" not in view.read_bytes()


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["riddle.mcap"], "riddle.mcap has no whole scenario to simulate; name a preset"),
        (["poses.csv"], "poses.csv has no whole scenario to simulate; name a preset"),
        (["spec.toml"], "spec.toml is a specification, not a scenario: turtlelog check spec.toml"),
        (["paper", "--duration", "3"], "did you mean --set max_duration_s=3?"),
        (["paper", "--max-duration", "3"], "did you mean --set max_duration_s=3?"),
        (["paper", "--seed", "3"], "did you mean --set seed=3?"),
        (["paper", "--pause=3"], "did you mean --set law.pause_ticks=3?"),
        (["ridle.mcap"], "ridle.mcap: no such file; did you mean riddle.mcap?"),
        (["paper", "--strip-scenario"], "--strip-scenario: needs -o or --rrd"),
        (
            ["paper", "--strip-scenario", "--realtime", "-o", "a.mcap"],
            "--strip-scenario: leave out --realtime, which writes the scenario first",
        ),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_bad_use_is_one_line(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], line: str
) -> None:
    monkeypatch.chdir(tmp_path)
    call("run", "paper-kp4", "--strip-scenario", "-o", "riddle.mcap")
    call("convert", "riddle.mcap", "-o", "poses.csv")
    Path("spec.toml").write_text('format = 1\n[checks.end]\nexpect = "run.duration < 9"\n')
    answer = call("run", *words)
    assert (answer.code, answer.out, answer.err.count("\n")) == (2, "", 1)
    assert line in answer.err
