"""A law of one's own at the command line: `run --law`, and the time that its steps may take."""

from pathlib import Path

import pytest

import turtlelog as tl
from tests.cli.conftest import Call

OWN = Path(__file__).parents[2] / "examples" / "turn_and_drive.py"
KIND = f"{OWN}:TurnAndDrive"
GAIN = ("--set", "law.kp_angular=3")


def test_a_law_by_option_is_that_of_set_under_a_shorter_name(call: Call) -> None:
    short = call("run", "textbook", "--law", KIND, *GAIN, "--json").json
    whole = call("run", "textbook", "--set", f"law.kind={KIND}", *GAIN, "--json").json
    assert short.pop("name") == f"textbook law={KIND} law.kp_angular=3"
    assert whole.pop("name") == f"textbook law.kind={KIND} law.kp_angular=3"
    assert short == whole


@pytest.mark.parametrize(
    ("words", "name"),
    [
        ((), "paper"),
        (("--law", "sequential-p"), "textbook law=sequential-p"),
        (("paper", "--law", "sequential-p"), "paper law=sequential-p"),
        (("--law", KIND, "--kp", "2"), f"textbook law={KIND} kp=2"),
        (("--set", f"law.kind={KIND}"), f"paper law.kind={KIND}"),
    ],
)
def test_without_a_scenario_a_law_drives_the_textbook_loop(
    words: tuple[str, ...], name: str, call: Call
) -> None:
    text = call("scenario", *words).out
    scenario = tl.parse_scenario(text)
    assert scenario.name == name
    assert scenario.loop == tl.load_scenario(name.split()[0]).loop


def test_a_law_drives_what_a_recording_recorded(call: Call, kp4: Path, tmp_path: Path) -> None:
    path = tmp_path / "own.mcap"
    answer = call("run", kp4, "--law", KIND, "--kp", "2", "-o", path)
    assert (answer.code, tl.read_recording(path).name) == (0, f"paper-kp4 law={KIND} kp=2")
    assert tl.read_recording(path).parameters["law.kp_angular"] == 2.0


def test_the_same_law_by_both_options_is_one_law(call: Call) -> None:
    assert call("scenario", "--law", KIND, "--set", f"law.kind={KIND}").code == 0


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (
            ("--law", "a.py:A", "--set", "law.kind=b.py:B"),
            "--law a.py:A and --set law.kind=b.py:B: choose one",
        ),
        (
            ("--law", "none.py:A"),
            "--law: law.kind: no Python file none.py",
        ),
        (
            ("--law", "turn"),
            '--law: law.kind: no law "turn"; list: turtlelog list laws.'
            " A law of your own is path.py:Class or package.module:Class",
        ),
    ],
)
def test_a_law_that_is_none_is_one_line(words: tuple[str, ...], error: str, call: Call) -> None:
    answer = call("run", *words)
    assert (answer.code, answer.out, answer.err) == (2, "", f"turtlelog: error: {error}\n")


SLOW = """
from turtlelog.laws import SequentialP

class Slow(SequentialP):
    samples = -1

    def step(self, time_ns, pose):
        self.samples += 1
        while self.samples == 12:
            pass
        return super().step(time_ns, pose)
"""


@pytest.mark.parametrize("more", [(), ("--realtime",)], ids=["at once", "live"])
def test_a_law_without_end_ends_the_run_with_its_recording(
    more: tuple[str, ...], call: Call, tmp_path: Path
) -> None:
    (tmp_path / "slow.py").write_text(SLOW, encoding="utf-8")
    law, path = f"{tmp_path / 'slow.py'}:Slow", tmp_path / "a.mcap"
    answer = call("run", "--law", law, "--step-budget-ms", "250", "-o", path, *more)
    told = (
        f"law {law}, sample 12 took more than 1250 ms of a budget of 250 ms, at 0.192 s; a slow law"
        " needs more: --step-budget-ms 1500, in Python step_budget_s=1.5"
    )
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.splitlines() == [f"wrote {path}", f"turtlelog: error: {told}"]
    run = tl.read_recording(path)
    assert (len(run.samples), run.stop_reason) == (12, "step_budget")
    assert run.events[-1].text == f"The run ended: step budget: {told}."
    assert not any("budget" in key for key in run.parameters)  # the clock is no part of a scenario


def test_a_law_in_time_is_as_without_a_budget(call: Call) -> None:
    answer = call("run", "textbook", "--step-budget-ms", "5e3", "--json")
    assert answer.json == call("run", "textbook", "--json").json


@pytest.mark.parametrize("value", ["0", "-1", "nan", "inf", "text", "1e-400"])
def test_a_budget_that_is_no_time_is_one_line(value: str, call: Call) -> None:
    answer = call("run", "--step-budget-ms", value)
    line = f"--step-budget-ms {value}: must be a time above 0 in milliseconds"
    assert (answer.code, answer.out) == (2, "")
    assert answer.err == f"turtlelog: error: {line}\n"


def test_the_command_that_explains_a_law_of_ones_own_works_as_printed(
    call: Call, kp4: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Eleven commands; two of them explain a run."""
    monkeypatch.chdir(tmp_path)
    told = call("run", "--law", KIND, *GAIN, "-o", "own.mcap").flat
    command = "turtlelog explain own.mcap --trust-law"
    assert command in told
    for words in (["metrics", "own.mcap"], ["info", "own.mcap"]):
        assert command in call(*words).flat
    assert call("explain", "own.mcap").code == 2
    assert call(*command.split()[1:]).code == 0
    failed = call("check", "own.mcap", "--expect", "run.duration < 1")
    assert f"Why? {command}" in failed.flat
    reached = str(kp4)
    for words in (
        ["metrics", reached],
        ["info", reached],
        ["check", reached, "--expect", "run.duration < 1"],
    ):
        answer = call(*words).flat
        assert "turtlelog explain" in answer
        assert "--trust-law" not in answer
