"""Every command as users give it, in processes of its own on two cores: it ends well, in silence.

The commands are those of README, each one with its defaults, and the examples in `--help`. The
former start Python as a user does; the examples are forked from a process that has loaded the
program.
"""

import glob
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import chain, pairwise
from pathlib import Path
from typing import Final

import pytest

import turtlelog as tl
from tests.cli.conftest import SPEC, Call, call as call
from tests.docs.plain_words import find_hard_words, list_lines
from tests.docs.test_pages import README, ROOT, list_console, matches_shown
from tests.fresh_process import run_command
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
    "sweep": "sweep paper-kp4 --grid law.kp_linear=1:12:0.5 -o kp.parquet",
    "tune": "tune paper --grid law.kp_linear=1:9 --minimise run.duration",
    "theory": "theory",
    "info": "info kp1.mcap",
    "metrics": "metrics kp1.mcap kp4.mcap",
    "compare": "compare kp4.mcap kp10.mcap",
    "explain": "explain kp4.mcap",
    "identify": "identify robot_bag",
    "replay": "replay kp4.mcap",
    "list": "list metrics",
    "check": "check spec.toml kp4.mcap",
    "view": "view kp1.mcap kp10.mcap",
    "plot": "plot kp4.mcap -o figs",
    "report": "report kp1.mcap kp10.mcap -o report.html",
    "convert": "convert kp1_210.json -o kp1.mcap",
    "demo": "demo -o demo-out",
    "help": "help",
}
"""Each command with what it cannot do without. Where that is an example of help, it runs once."""

STAND_INS: Final[Mapping[str, str]] = {
    # A viewer opens a window, and stays until somebody closes it.
    r"view [^-]*": r"\g<0> --save view.rrd",
    # All of a run makes 250 pictures, and the usual format packs each for a tenth of a second.
    r"(.*) --movie race\.mp4": r"\1 --movie race.gif --length 1",
}
"""Commands that do not end by themselves, or not soon, and what runs in their place."""

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


def link_files(words: Sequence[str], source: Path, folder: Path) -> None:
    """Put the files that a command reads into its folder; what it writes does not reach others."""
    for before, word in pairwise(("", *words)):
        name = Path(word).parts[0]
        if before in OUTPUTS or not (source / name).exists() or (folder / name).exists():
            continue
        if (source / name).is_dir():
            shutil.copytree(source / name, folder / name, copy_function=os.link)
        else:
            os.link(source / name, folder / name)


Start = Callable[[Sequence[str], Path], tuple[int, str, str]]


def start_python(words: Sequence[str], folder: Path) -> tuple[int, str, str]:
    """Start a command as a shell does; return its exit code and what it wrote."""
    done = subprocess.run(
        [sys.executable, "-m", "turtlelog", *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUTF8": "1"},
        capture_output=True,
        text=True,
        encoding="utf-8",
        timeout=120,
        check=False,
    )
    return done.returncode, done.stdout, done.stderr


def fork(words: Sequence[str], folder: Path) -> tuple[int, str, str]:
    """Run a command as `start_python` does, where the program is loaded already."""
    answer = run_command(*words, folder=folder)
    return answer.returncode, answer.stdout, answer.stderr


def run(
    command: str, folder: Path, source: Path | None = None, start: Start = start_python
) -> Ended:
    """Run a command, or what stands in for it, with the files that it reads."""
    for pattern, other in STAND_INS.items():
        command = re.sub(f"{pattern}$", other, command)
    words = shlex.split(command)
    if source is not None:
        link_files(words, source, folder)
    words = words[: words.index(">")] if ">" in words else words
    found = [sorted(glob.glob(word, root_dir=folder)) or [word] for word in words]  # noqa: PTH207
    return Ended(command, *start([*chain.from_iterable(found)], folder))


def describe_fault(ended: Ended, code: int = 0) -> list[str]:
    """Return what is wrong with how a command ended, and with the words that it printed."""
    name = f"turtlelog {ended.command}"
    faults = find_hard_words(list_lines(ended.out + ended.err), name)
    if ended.code != code or NOISE.search(ended.err) is not None:
        faults.append(f"{name}: exit code {ended.code}\n{ended.err}")
    return faults


def run_readme(folder: Path) -> list[str]:
    """Run the commands of README one after the other, and return what is not as it shows."""
    faults = []
    for command, shown in list_console(README):
        ended = run(command, folder)
        faults += describe_fault(ended, code=int("\nFAIL: " in shown))
        if not matches_shown(shown, ended.out):
            faults.append(f"turtlelog {command}: README shows something else than\n{ended.out}")
    return faults


def list_examples(call: Call) -> list[str]:
    helps = [call(name, "--help-all").out for name in COMMANDS]
    found = [re.findall(r"^Example: turtlelog (.+)$", text, re.M) for text in helps]
    assert all(found)
    return [*chain.from_iterable(found)]


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
    for name, source in {"good": "kp4", "new": "kp2", "run": "kp4"}.items():
        shutil.copy(folder / f"{source}.mcap", folder / f"{name}.mcap")
    for below in ("runs", "handed-in"):
        (folder / below).mkdir()
        for name in ("kp1", "kp2", "kp4"):
            os.link(folder / f"{name}.mcap", folder / below / f"{name}.mcap")
    (folder / "cut.mcap").write_bytes((folder / "kp4.mcap").read_bytes()[:-2000])
    (folder / "spec.toml").write_text(SPEC, "utf-8")
    for name in ("truth", "estimate"):
        tl.log.export_tum(tl.read_recording(folder / "kp4.mcap"), folder / f"{name}.tum")
    short = tl.override_scenario(tl.load_scenario("paper"), {"max_duration_s": 3.0})
    (folder / "mine.toml").write_text(tl.format_scenario(short), "utf-8")
    write_json(make_log(), folder).rename(folder / "kp1_210.json")
    write_table(
        folder / "results.parquet",
        GRID,
        {"translate.stable": is_stable, "translate.overshoot": lambda delay, kp: delay * kp},
        units={"translate.overshoot": "%"},
    )
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


def find_faults(commands: Iterable[str], source: Path, place: Path, start: Start) -> list[str]:
    """Run commands, two at a time, each in a folder of its own; an empty one is those of README."""

    def run_apart(command: str) -> list[str]:
        folder = Path(tempfile.mkdtemp(dir=place))
        if not command:
            return run_readme(folder)
        return describe_fault(run(command, folder, source, start))

    with ThreadPoolExecutor(2) as pool:
        return [*chain.from_iterable(pool.map(run_apart, commands))]


def test_every_command_ends_well_and_says_nothing_strange(files: Path, tmp_path: Path) -> None:
    """Every command starts as a user starts it, and loads all it needs."""
    assert [*DEFAULTS] == COMMANDS
    shown = [command for command, _ in list_console(README)]
    commands = [command for command in DEFAULTS.values() if command not in shown]
    assert find_faults(["", *commands], files, tmp_path, start_python) == []


@pytest.mark.thorough
def test_every_example_of_help_ends_well(files: Path, tmp_path: Path, call: Call) -> None:
    """Some sixty commands run."""
    others = {*DEFAULTS.values(), *(command for command, _ in list_console(README))}
    examples = [command for command in dict.fromkeys(list_examples(call)) if command not in others]
    assert find_faults(examples, files, tmp_path, fork) == []
