"""What crosses from one process to another: of every command that shares work, and every error.

Here nothing is started, which takes a second: work, items and answers are packed as for processes.
"""

import ast
import importlib
import inspect
import pickle
import shutil
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any

import pytest

from tests.cli.conftest import SPEC, Call, call as call
from tests.cli.step_robots import write_robot
from turtlelog import processes
from turtlelog.errors import make_portable

PACKAGE = Path(processes.__file__).parent
ALL = ["kp4.mcap", "table.csv", "bag.mcap", "cut.mcap", "none.mcap"]
"""A file of every kind, of which some cannot be read."""
BRIEF = ["--metric", "final.*"]
GRID = ["--grid", "law.kp_linear=-1,4", "--grid", "max_duration_s=2,3"]
TUNE = ["--grid", "law.k=1:4", "--minimise", "run.path_length", "--evaluations", "8"]
SHARERS = {
    "turtlelog.cli.info": [["info", *ALL]],
    "turtlelog.compare.run_summary": [["metrics", *ALL, *BRIEF], ["compare", *ALL, *BRIEF]],
    "turtlelog.cli.compare_reference": [["compare", *ALL[:3], "--reference", "kp10.mcap"]],
    "turtlelog.cli.check": [["check", "spec.toml", *ALL, "--junit", "junit.xml"]],
    "turtlelog.sweep.recording_table": [
        ["metrics", *ALL, *BRIEF, "-o", "metrics.parquet"],
        ["check", "spec.toml", *ALL, "-o", "verdicts.parquet"],
    ],
    "turtlelog.sweep.sweep_scenario": [
        ["sweep", "paper", *GRID, "--record", "runs", "-o", "s.parquet"]
    ],
    "turtlelog.sweep.tune_candidates": [["tune", "posture", *TUNE, "--set", "max_duration_s=2"]],
    "turtlelog.explain.game": [["explain", "kp10.mcap", "--jobs", "2"]],
    "turtlelog.draw.figures.writing": [["plot", "kp10.mcap", "-o", "figs", "--only", "heading"]],
}
"""Commands for each module that hands out work."""


def find_modules(is_meant: Callable[[ast.AST], bool], word: str) -> set[str]:
    """Return the modules with such a place in their code, which has a word in its text."""
    texts = {path: path.read_text("utf-8") for path in PACKAGE.rglob("*.py")}
    return {
        ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
        for path, text in texts.items()
        if word in text and any(map(is_meant, ast.walk(ast.parse(text))))
    }


def hands_out(node: ast.AST) -> bool:
    return isinstance(node, ast.Call) and ast.unparse(node.func) == "map_in_processes"


def defines_error(node: ast.AST) -> bool:
    bases = node.bases if isinstance(node, ast.ClassDef) else []
    return any(ast.unparse(base).endswith(("Error", "Exception")) for base in bases)


def cross(
    used: list[str], module: str, work: Any, items: Sequence[Any], *_: Any, **options: Any
) -> Iterator[Any]:
    """Stand for `map_in_processes` in a module."""
    used.append(module)
    if not options.get("is_forked"):
        work = ForkingPickler.loads(ForkingPickler.dumps(work))
    for item in items:
        answer = ForkingPickler.loads(processes._answer(work, bytes(ForkingPickler.dumps(item))))
        if answer[1]:
            raise answer[0]
        yield answer[0]


@pytest.fixture
def files(kp4: Path, kp10: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(kp4, "kp4.mcap")
    shutil.copy(kp10, "kp10.mcap")
    Path("spec.toml").write_text(SPEC, "utf-8")
    Path("table.csv").write_text("time_s,x_m,y_m,heading_rad\n0,1,1,0\n0.1,1.1,1,0\n", "utf-8")
    Path("cut.mcap").write_bytes(kp4.read_bytes()[:20_000])
    write_robot(Path("bag.mcap"))


@pytest.mark.usefixtures("files")
def test_what_every_command_shares_and_gathers_crosses_as_it_is(
    call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each command that hands out work runs once, in this process."""
    assert set(SHARERS) == find_modules(hands_out, "map_in_processes")
    processes._pickle_read_only_mappings()
    used: list[str] = []
    for name in SHARERS:
        module = importlib.import_module(name)
        monkeypatch.setattr(module, "map_in_processes", partial(cross, used, name))
    commands = [words for found in SHARERS.values() for words in found]
    failed = {" ".join(words): found.err for words in commands if (found := call(*words)).code > 2}
    assert failed == {}
    assert set(used) == set(SHARERS)


def list_errors() -> list[type[Exception]]:
    modules = map(importlib.import_module, sorted(find_modules(defines_error, "class ")))
    return [
        kind
        for module in modules
        for _, kind in inspect.getmembers(module, inspect.isclass)
        if issubclass(kind, Exception) and kind.__module__ == module.__name__
    ]


def test_every_error_is_the_same_in_another_process() -> None:
    """Takes over 2 s on a slow machine: all of the package is parsed and imported."""
    kinds = list_errors()
    assert len(kinds) > 30
    for kind in kinds:
        err = kind("kp4.mcap: expected a recording")
        assert make_portable(err) is err
        found = pickle.loads(pickle.dumps(err))
        assert (type(found), str(found), vars(found)) == (kind, str(err), vars(err))
