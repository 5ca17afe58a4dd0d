import subprocess
import sys
from pathlib import Path

import pytest

import turtlelog as tl
from tests.cli.conftest import Call

COMMANDS = ("demo", "run", "scenario", "import", "info", "metrics", "compare", "view")


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_with_an_example(call: Call, command: str) -> None:
    answer = call(command, "--help")
    assert (answer.code, answer.err) == (0, "")
    assert f"Example: turtlelog {command}" in answer.out


def test_help_lists_every_command(call: Call) -> None:
    assert all(f" {command} " in call("--help").out for command in COMMANDS)


def test_the_version_is_the_packages(call: Call) -> None:
    assert call("--version").out == f"turtlelog {tl.__version__}\n"


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_written_where_asked(call: Call, tmp_path: Path, shell: str) -> None:
    answer = call("--install-completion", "--shell", shell, "--output", tmp_path / "completion")
    assert answer.code == 0
    assert "metrics" in (tmp_path / "completion").read_text()


@pytest.mark.parametrize("code", ["import turtlelog", "import turtlelog.cli.app"])
def test_starting_up_loads_nothing_heavy(code: str) -> None:
    heavy = "{'numpy', 'rerun', 'mcap', 'msgspec', 'pyarrow'}"
    check = f"{code}, sys\nassert not {heavy} & set(sys.modules), set(sys.modules)"
    subprocess.run([sys.executable, "-c", check], check=True, timeout=60)


def test_every_public_name_can_be_used() -> None:
    assert all(getattr(tl, name) is not None for name in tl.__all__)
    assert set(tl.__all__) <= set(dir(tl))
    with pytest.raises(AttributeError, match="no attribute 'nosuch'"):
        _ = tl.nosuch


def test_a_reader_that_goes_away_ends_the_command_quietly(tmp_path: Path) -> None:
    command = f"{sys.executable} -m turtlelog run textbook --json"
    script = f"{command} | {sys.executable} -c 'import sys; sys.stdin.read(10)'"
    done = subprocess.run(
        ["sh", "-c", script], check=True, timeout=60, capture_output=True, text=True
    )
    assert done.stderr == ""


def test_the_demo_writes_recordings_views_and_table_1(call: Call, tmp_path: Path) -> None:
    answer = call("demo", "-o", tmp_path / "out")
    assert answer.code == 0
    runs = ("kp1", "kp2", "kp4", "kp10")
    expected = {f"{run}.{suffix}" for run in runs for suffix in ("mcap", "rrd")}
    expected |= {"comparison.rrd", "table1.txt", "table1.md", "table1.csv", "table1.tex"}
    assert {path.name for path in (tmp_path / "out").iterdir()} == expected
    assert (tmp_path / "out" / "table1.txt").read_text() in answer.out
    assert "view" in answer.out.splitlines()[-4]


def test_the_demo_refuses_a_file_for_its_folder(call: Call, tmp_path: Path) -> None:
    (tmp_path / "out").touch()
    answer = call("demo", "-o", tmp_path / "out")
    assert answer.code == 2
    assert "expected a folder to write into: File exists" in answer.err
