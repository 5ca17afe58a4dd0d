"""A law of one's own at the command line: `run --law`, and the time that its steps may take."""

from pathlib import Path

import pytest

import turtlelog as tl
from tests.cli.conftest import Call
from turtlelog.laws import LAWS

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
            "--law: expected one law, found a.py:A and --set law.kind=b.py:B",
        ),
        (
            ("--law", "none.py:A"),
            "--law: law.kind: expected a Python file at none.py, found none",
        ),
        (
            ("--law", "turn"),
            f"--law: law.kind: expected {', '.join(LAWS)}, path.py:Class or package.module:Class,"
            " found 'turn'",
        ),
    ],
)
def test_a_law_that_is_none_is_one_line(words: tuple[str, ...], error: str, call: Call) -> None:
    answer = call("run", *words)
    assert (answer.code, answer.out, answer.err) == (2, "", f"turtlelog: error: {error}\n")
