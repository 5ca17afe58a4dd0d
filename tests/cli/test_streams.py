"""What a command does when the world around it is hostile: streams, signals, names."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tests.cli.conftest import Call
from turtlelog.cli.console import print_json

ROOT = Path(__file__).parents[2]
COMMAND = [sys.executable, "-m", "turtlelog"]
LONG = "n" * 300
needs_full = pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
needs_posix = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such thing")


@pytest.mark.everyday("fine")
@needs_full
@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["info", "missing.mcap"], 2),
        (["--nosuch"], 2),
        (["run", "textbook", "-o", "a.mcap"], 0),
    ],
    ids=["bad input", "bad usage", "fine"],
)
def test_a_full_stderr_changes_no_exit_code(tmp_path: Path, words: list[str], code: int) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [*COMMAND, *words],
            stdout=subprocess.DEVNULL,
            stderr=full,
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            check=False,
        )
    assert done.returncode == code


@pytest.mark.everyday(">&- 2>&-")
@needs_posix
@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
def test_closed_streams_are_no_error(kp4: Path, closed: str) -> None:
    script = f"{sys.executable} -m turtlelog info {kp4} {closed}"
    done = subprocess.run(["sh", "-c", script], cwd=ROOT, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")


SLOW = """
import sys, time
import turtlelog as tl
from turtlelog.cli.app import main
from turtlelog.log import replace_when_complete
def write_slowly(run, path):
    with replace_when_complete(path) as part:
        part.write_text("half")
        print("writing", flush=True)
        time.sleep(30)
tl.write_recording = write_slowly
main(["run", "textbook", "-o", "a.mcap"])
"""


@pytest.mark.everyday("SIGTERM")
@needs_posix
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_command_that_is_told_to_end_leaves_nothing_half_done(tmp_path: Path, name: str) -> None:
    (tmp_path / "a.mcap").write_bytes(b"mine")
    process = subprocess.Popen(
        [sys.executable, "-c", SLOW],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "writing\n"
    start = time.monotonic()
    process.send_signal(getattr(signal, name))
    _, err = process.communicate(timeout=20)
    assert (process.returncode, err) == (130, "turtlelog: error: interrupted\n")
    assert time.monotonic() - start < 10.0
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]
    assert (tmp_path / "a.mcap").read_bytes() == b"mine"


NAMES = ["a\nb", "a\x1b[31mb", "a\tb", os.fsdecode(b"a\xffb"), "-a", "a b", "a\x9bb"]


@needs_posix
@pytest.mark.parametrize("name", NAMES, ids=ascii)
@pytest.mark.parametrize(
    "words",
    [["info"], ["metrics"], ["replay", "--plant"], ["convert", "--recover", "-o", "b.mcap"]],
    ids=lambda words: "recover" if "--recover" in words else words[0],
)
def test_any_name_is_read_and_steers_no_terminal(
    call: Call,
    kp4: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    words: list[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path(f"{name}.mcap").write_bytes(kp4.read_bytes())
    answer = call(words[0], f"./{name}.mcap", *words[1:])
    assert (answer.code, answer.err) == (0, "")
    assert not {"\x1b", "\x9b"} & set(answer.out)
    missing = call(words[0], f"./{name}.json", *words[1:])
    assert (missing.code, missing.err.count("\n")) == (2, 1)
    assert not {"\x1b", "\x9b"} & set(missing.err)


@pytest.mark.parametrize(
    "words",
    [
        ["info", LONG],
        ["metrics", LONG],
        ["convert", LONG, "-o", "a.mcap"],
        ["convert", "--recover", LONG, "-o", "a.mcap"],
        ["scenario", LONG],
        ["view", LONG],
        ["demo", "-o", LONG],
    ],
    ids=lambda words: "recover" if "--recover" in words else words[0],
)
def test_a_name_that_is_too_long_is_what_the_error_names(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    answer = call(*words)
    assert (answer.code, answer.out, answer.err.count("\n")) == (2, "", 1)
    assert answer.err.startswith(f"turtlelog: error: {LONG}: ")
    assert answer.err.endswith(": File name too long\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", [os.fsdecode(b"a\xff"), "a\nb"], ids=ascii)
def test_a_bag_is_refused_a_name_that_its_description_cannot_hold(
    call: Call, kp4: Path, tmp_path: Path, name: str
) -> None:
    answer = call("convert", kp4, "-o", tmp_path / name)
    assert (answer.code, answer.out, answer.err.count("\n")) == (2, "", 1)
    assert "expected a name of printable characters, found 'a" in answer.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.everyday("check {spec} {kp10}-1")
@needs_posix
@pytest.mark.parametrize(
    ("words", "code"),
    [("check {spec} {kp4}", 0), ("check {spec} {kp4} --json", 0), ("check {spec} {kp10}", 1)],
)
def test_a_reader_that_goes_away_changes_no_verdict(
    kp4: Path, kp10: Path, tmp_path: Path, words: str, code: int
) -> None:
    spec = tmp_path / "spec.toml"
    spec.write_text('format = 1\n[checks.near]\nexpect = "final.position_error < 0.05"\n')
    command = words.format(spec=spec, kp4=kp4, kp10=kp10)
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [*COMMAND, *command.split()], cwd=ROOT, stdout=writer, stderr=subprocess.PIPE, check=False
    )
    os.close(writer)
    assert (done.returncode, done.stderr) == (code, b"")


def test_numbers_of_numpy_are_json_like_any_other(capsys: pytest.CaptureFixture[str]) -> None:
    values = [np.bool_(1), np.int64(3), np.float32(0.5), np.float32("nan"), np.arange(2)]
    print_json({"values": values})
    assert json.loads(capsys.readouterr().out) == {"values": [True, 3, 0.5, None, [0, 1]]}


def test_notes_are_wrapped_on_a_terminal_and_keep_their_line_elsewhere(
    call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ("metrics", "nosuch.mcap", "--final", "a few words that are neither")
    whole = call(*words).err
    assert (whole.count("\n"), len(whole) > 80) == (1, True)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    for columns, longest in (("60", 60), ("200", 80)):
        monkeypatch.setenv("COLUMNS", columns)
        lines = call(*words).err.splitlines()
        assert longest - 20 < max(map(len, lines)) <= longest
        assert all(line.startswith("  ") for line in lines[1:])
        assert " ".join(line.strip() for line in lines) == whole.strip()
