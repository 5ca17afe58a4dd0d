"""Help as a terminal shows it, and errors in the words of a command."""

import re
import textwrap
from pathlib import Path

import pytest
from rich.console import Console

from tests.cli.conftest import Call
from turtlelog.cli.app import app

GROUPS = {
    "Simulate": ["run", "scenario", "sweep", "tune", "theory"],
    "Ask": ["info", "metrics", "compare", "explain", "identify", "replay", "list"],
    "Check": ["check"],
    "Show": ["view", "plot", "report"],
    "Files": ["convert", "demo"],
}
NUMBERS = "INT|FLOAT|GAINS?|SECONDS|SHARE|WIDTH|VALUE|WIDTHxHEIGHT"
COMMANDS = [command for commands in GROUPS.values() for command in commands]


def test_help_groups_the_commands(call: Call) -> None:
    panels = re.findall(r"╭─ ([^─]+) ─+╮\n(.*?)\n╰", call("--help").out, re.S)
    found = {title: re.findall(r"^│ (\S+)", text, re.M) for title, text in panels}
    others = ["help", "--help", "--install-completion", "--version"]
    assert found.pop("Help and completion") == others
    assert found == GROUPS
    assert [*found] == [*GROUPS]


@pytest.mark.everyday("run", "check")
@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_a_command_is_the_same_both_ways(call: Call, command: str) -> None:
    answer = call(command, "--help")
    assert (answer.code, answer.err) == (0, "")
    assert call("help", command) == answer


@pytest.mark.everyday("plot-80", "run-80", "check-200", "tune-100")
@pytest.mark.parametrize("columns", [80, 100, 200])
@pytest.mark.parametrize("command", [*COMMANDS, "help"])
def test_help_fits_and_wraps_each_paragraph_once(
    call: Call, monkeypatch: pytest.MonkeyPatch, command: str, columns: int
) -> None:
    monkeypatch.setattr(app, "_console", Console(width=columns))
    text = call(command, "--help").out
    # Longer lines than 100 characters are hard to read on any terminal.
    width = min(columns, 100)
    assert max(map(len, text.splitlines())) <= width
    above, _, _ = text.partition("╭")
    usage, *paragraphs = above.strip().split("\n\n")
    assert usage.startswith(f"Usage: turtlelog {command}")
    for paragraph in paragraphs:
        joined = " ".join(paragraph.split())
        assert paragraph == textwrap.fill(joined, width, break_on_hyphens=False)
    examples = [text for text in paragraphs if text.startswith("Example: ")]
    assert examples
    assert all(text.startswith(f"Example: turtlelog {command}") for text in examples)
    assert all("\n" not in text for text in examples)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_fits_a_screen_and_names_where_all_of_it_is(
    call: Call, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.setattr(app, "_console", Console(width=80))
    short, whole = call(command, "--help").out, call(command, "--help-all").out
    assert short.count("\n") <= 40
    options = set(re.findall(r"^│ +(?:\* +)?(--\S+)", short, re.M))
    assert options <= set(re.findall(r"^│ +(?:\* +)?(--\S+)", whole, re.M))
    assert (f"turtlelog {command} --help-all" in short) == (short != whole)


def test_there_are_at_most_eighteen_commands() -> None:
    assert len(COMMANDS) <= 18


def test_help_says_that_several_files_are_taken(call: Call) -> None:
    for command in ("info", "metrics", "compare", "view"):
        text = call(command, "--help").out
        assert f"Usage: turtlelog {command} [OPTIONS] FILE..." in text
        assert re.search(r"│ \*  FILE\.\.\. ", text)


@pytest.mark.everyday("run", "plot", "check", "tune")
@pytest.mark.parametrize("command", COMMANDS)
def test_options_that_take_a_number_tell_its_unit(call: Call, command: str) -> None:
    text = call(command, "--help-all").out
    cells = re.sub(r"\s+", " ", re.sub(r"│\n│", " ", text))
    options = re.split(r"(?= --[a-z])", cells)
    numeric = [text for text in options if re.match(rf" --\S+( -\w)? ({NUMBERS})\b", text)]
    assert [text for text in numeric if "[" not in text.partition("[default")[0]] == []
    assert numeric or command not in {"run", "theory", "metrics", "view", "plot", "replay"}


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["theory", "a", "inf"], 'turtlelog theory takes no word "inf". Usage: turtlelog theory'),
        (["run", "a", "b", "c"], 'turtlelog run takes no word "b" and 1 more. Usage: '),
        (
            ["metrics", "a", "--all", "b"],
            'turtlelog metrics: "b" stands apart: name all files together, and join the'
            " values of an option by commas",
        ),
        (["run", "--kp", "x"], "--kp x: must be a number"),
        (["run", "--kp"], "turtlelog run: --kp needs a number"),
        (["run", "--kpp", "3"], "turtlelog run has no option --kpp; did you mean --kp?"),
        (["plot", "--metrics", "a"], "plot has no option --metrics; did you mean --metric?"),
        (["metrics", "--only", "a"], "metrics has no option --only; did you mean --metric?"),
        (
            ["info", "-x"],
            "turtlelog info has no option -x; all options: turtlelog info --help-all",
        ),
        (["run", "--json=3"], '--json: takes no value, not "3"'),
        (["compar"], 'turtlelog has no command "compar"; did you mean compare?'),
        (["explain"], "turtlelog explain needs FILE. Usage: turtlelog explain [OPTIONS] FILE"),
        (["convert", "a"], "turtlelog convert needs --output. Usage: "),
        (
            ["plot", "-o", "x", "--for", "wall"],
            "--for wall: must be column, page or slide",
        ),
        (["theory", "--kp", "1", "--kp=2"], "--kp is given 2 times, but takes one value"),
        (["replay", "--law", "a", "b", "c"], "--law: takes at most 2 words, not 3"),
        (
            ["list", "metric"],
            "KIND metric: must be metrics, signals, presets",
        ),
        (["help", "explane"], 'no command "explane"; did you mean explain'),
        (["frob\x1b[2J"], 'no command "frob\\x1b[2J"'),
        (["theory", "a", "n" * 999], f'no word "{"n" * 60}..."'),
    ],
    ids=lambda value: " ".join(value)[:40] if isinstance(value, list) else "",
)
def test_words_that_are_wrong_are_one_line(call: Call, words: list[str], line: str) -> None:
    answer = call(*words)
    assert (answer.code, answer.out, answer.err.count("\n")) == (2, "", 1)
    assert answer.err.startswith("turtlelog: error: ")
    assert line in answer.err


@pytest.mark.everyday("bash")
@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_written_where_asked(call: Call, tmp_path: Path, shell: str) -> None:
    answer = call("--install-completion", "--shell", shell, "--output", tmp_path / "completion")
    assert answer.code == 0
    text = (tmp_path / "completion").read_text()
    assert "metrics" in text
    assert "__complete" in text


@pytest.mark.parametrize(
    ("words", "candidate"),
    [
        (["run", ""], "paper-kp10"),
        (["run", "--set", ""], "limits.speed_m_s="),
        (["scenario", "pap"], "textbook"),
        (["run", "--law", ""], "sequential-p"),
        (["metrics", "a.mcap", "--metric", ""], "rotate.overshoot"),
        (
            ["metrics", "--metric", "final.position_error,rot"],
            "final.position_error,rotate.peak",
        ),
        (["compare", "a.mcap", "b.mcap", "--sort", ""], "run.duration"),
        (["explain", "a.mcap", "--metric", ""], "final.heading_error"),
        (["explain", "a.mcap", "--causes", "queue,"], "queue,pause"),
        (["plot", "a.mcap", "-o", "x", "--only", ""], "step-responses"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_completion_knows_names(call: Call, words: list[str], candidate: str) -> None:
    answer = call("__complete", *words)
    assert candidate in [line.partition("\t")[0] for line in answer.out.splitlines()]


def test_completion_offers_scenario_files_and_recordings(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("mine.toml", "run.mcap", "notes.txt"):
        (tmp_path / name).touch()
    offered = [line.partition("\t")[0] for line in call("__complete", "run", "").out.splitlines()]
    assert {"mine.toml", "run.mcap", "paper"} < {*offered}
    assert "notes.txt" not in offered


def test_completion_offers_python_files_as_laws_and_runs_none(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text("raise SystemExit(3)", encoding="utf-8")
    (tmp_path / "mine.toml").touch()
    offered = call("__complete", "scenario", "--law", "")
    names = [line.partition("\t")[0] for line in offered.out.splitlines()]
    assert "mine.py" in names
    assert "mine.toml" not in names
