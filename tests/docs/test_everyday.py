"""Every command as users give it, in processes of its own on two cores: it ends well, in silence.

The commands are those of README and of the examples in `--help`, and each one with its defaults.
"""

import glob
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pytest

import turtlelog as tl
from tests.cli.conftest import SPEC, Call, call as call
from tests.docs.test_pages import ROOT, matches_shown
from tests.identify.robots import Log, Truth, make_run, write_bag
from tests.log.ros2.bags import write_metadata
from tests.log.test_importers import make_log, write_json
from tests.sweep.swept_tables import write_table
from tests.sweep.test_gain_borders import GRID, is_stable
from turtlelog.cli.app import app

COMMANDS: Final = [name for name in app if not name.startswith("-")]
DEFAULTS: Final[Mapping[str, str]] = {
    "run": "run",
    "scenario": "scenario",
    "sweep": "sweep --grid law.kp_linear=1:4 -o s.parquet",
    "tune": "tune --vary law.kp_linear=1:9 --minimise run.duration",
    "theory": "theory",
    "info": "info kp4.mcap",
    "metrics": "metrics kp4.mcap",
    "compare": "compare kp1.mcap kp4.mcap",
    "explain": "explain kp4.mcap",
    "identify": "identify robot_bag",
    "replay": "replay kp4.mcap",
    "list": "list signals",
    "check": "check spec.toml kp4.mcap",
    "view": "view kp4.mcap",
    "plot": "plot kp4.mcap -o figs",
    "map": "map results.parquet",
    "report": "report kp4.mcap -o report.html",
    "convert": "convert kp4.mcap -o kp4.csv",
    "recover": "recover cut.mcap -o whole.mcap",
    "demo": "demo",
    "help": "help",
}
"""Each command with what it cannot do without."""

SHORTER: Final[Mapping[str, str]] = {
    "--movie": "--length 1",  # of ten seconds each picture would be drawn, for a minute
}
NEAREST: Final[Mapping[str, str]] = {
    "view": "--save view.rrd",  # a viewer opens a window and stays until somebody closes it
}
"""What commands get that would not end by themselves, or not soon."""

OUTPUTS: Final = {"-o", "--output", "--record", "--movie", "--junit", "--scenario", ">"}
"""What follows is written: it is not there before."""

NOISE: Final = re.compile(r"Traceback|Warning|Exception|turtlelog: error|\bdefect\b")
"""What no command that ends well may say on stderr."""


@dataclass(frozen=True, slots=True)
class Ended:
    """What a command came to."""

    command: str
    code: int
    out: str
    err: str


def list_words(command: str) -> list[str]:
    """Return the words of a command in the form that ends by itself."""
    words = shlex.split(command)
    for option, more in SHORTER.items():
        words += shlex.split(more) if option in words else []
    stays = words[0] in NEAREST and not any(word in words for word in ("--movie", "--snapshot"))
    return words + (shlex.split(NEAREST[words[0]]) if stays else [])


def link_files(words: Sequence[str], source: Path, folder: Path) -> None:
    """Put the files that a command reads into its folder; what it writes does not reach others."""
    for before, word in zip(("", *words), words, strict=False):
        name = Path(word).parts[0] if word else ""
        if before in OUTPUTS or not (source / name).exists() or (folder / name).exists():
            continue
        if (source / name).is_dir():
            shutil.copytree(source / name, folder / name, copy_function=os.link)
        else:
            os.link(source / name, folder / name)


def run(command: str, folder: Path) -> Ended:
    """Run a command as a shell does, with patterns of files and what it prints kept."""
    words = list_words(command)
    if ">" in words:
        words = words[: words.index(">")]
    named = [glob.glob(word, root_dir=folder) if "/*" in word else [word] for word in words]
    done = subprocess.run(
        [sys.executable, "-m", "turtlelog", *(word for found in named for word in found)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUTF8": "1"},
        capture_output=True,
        text=True,
        encoding="utf-8",
        timeout=120,
        check=False,
    )
    return Ended(command, done.returncode, done.stdout, done.stderr)


def run_apart(commands: Sequence[str], files: Path, folder: Path) -> list[Ended]:
    """Run commands two at a time, each in a folder of its own with the files that it reads."""

    def run_one(number: int) -> Ended:
        place = folder / str(number)
        place.mkdir()
        link_files(list_words(commands[number]), files, place)
        return run(commands[number], place)

    with ThreadPoolExecutor(2) as pool:
        return [*pool.map(run_one, range(len(commands)))]


def list_faults(ended: Sequence[Ended], code: int = 0) -> list[str]:
    return [
        f"turtlelog {one.command}: exit code {one.code}\n{one.err}"
        for one in ended
        if one.code != code or NOISE.search(one.err)
    ]


@pytest.fixture(scope="module", autouse=True)
def _two_cores() -> Iterator[None]:
    """Let the commands use two cores, as many users have: then some start processes."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, sorted(allowed)[:2])
    yield
    os.sched_setaffinity(0, allowed)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with all files that the examples name."""
    folder = tmp_path_factory.mktemp("files")
    for name in ("kp1", "kp2", "kp4", "kp10"):
        shutil.copy(ROOT / "recordings" / "paper" / f"{name}.mcap", folder)
    for name, source in {"good": "kp4", "new": "kp2", "run": "kp1"}.items():
        shutil.copy(folder / f"{source}.mcap", folder / f"{name}.mcap")
    (folder / "runs").mkdir()
    for name in ("kp1", "kp2", "kp4"):
        os.link(folder / f"{name}.mcap", folder / "runs" / f"{name}.mcap")
    (folder / "cut.mcap").write_bytes((folder / "kp4.mcap").read_bytes()[:-2000])
    (folder / "spec.toml").write_text(SPEC, "utf-8")
    (folder / "mine.toml").write_text(tl.format_scenario(tl.load_scenario("paper")), "utf-8")
    write_json(make_log(), folder).rename(folder / "kp1_210.json")
    values = {
        "translate.stable": is_stable,
        "translate.overshoot": lambda delay, kp: delay * kp,
    }
    write_table(folder / "results.parquet", GRID, values, units={"translate.overshoot": "%"})
    _write_robot(folder)
    return folder


def _write_robot(folder: Path) -> None:
    axis = Truth(gain=0.9, dead_time_s=0.08, lag_s=0.12)
    log = Log(speed=axis, turn_rate=axis, duration_s=12.0, poses_hz=20.0, commands_hz=10.0)
    robot = make_run(log, 6)
    for name in ("robot_bag", "my_bag"):
        (folder / name).mkdir()
        write_bag(robot, folder / name / "a.mcap")
        write_metadata(folder / name, ["a.mcap"])
    plant = {"plant.kind": "lagged", "plant.speed_lag_s": 0.12, "plant.turn_lag_s": 0.12}
    scenario = tl.override_scenario(tl.load_scenario("textbook"), plant)
    (folder / "robot.toml").write_text(tl.format_scenario(scenario), "utf-8")


def test_each_command_ends_well_with_its_defaults(files: Path, tmp_path: Path) -> None:
    assert [*DEFAULTS] == COMMANDS
    assert list_faults(run_apart([*DEFAULTS.values()], files, tmp_path)) == []


def list_examples(call: Call) -> list[str]:
    found = [
        re.findall(r"^Example: turtlelog (.+)$", call(name, "--help").out, re.M)
        for name in COMMANDS
    ]
    assert all(found)
    return [example for examples in found for example in examples]


def test_every_example_of_help_ends_well(files: Path, tmp_path: Path, call: Call) -> None:
    assert list_faults(run_apart(list_examples(call), files, tmp_path)) == []


def test_the_commands_of_the_readme_end_as_they_show(tmp_path: Path) -> None:
    blocks = re.findall(
        r"^```console\n(.*?)^```$", (ROOT / "README.md").read_text("utf-8"), re.M | re.S
    )
    shown = re.findall(r"^\$ turtlelog (.*)\n((?:(?!\$ ).*\n)*)", "".join(blocks), re.M)
    assert shown
    for command, text in shown:
        ended = run(command, tmp_path)
        assert list_faults([ended], code=int("\nFAIL: " in text)) == []
        assert matches_shown(text, ended.out), ended.out
