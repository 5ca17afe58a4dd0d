import math
import os
import subprocess
import sys
from functools import partial
from hashlib import sha1
from pathlib import Path

import pytest

from turtlelog.simulate.compiled_twins import is_kept, remove_stored
from turtlelog.simulate.many import CompiledCode

PYTHON = f"py{sys.version_info.major}{sys.version_info.minor}"
COMPILED = """
import numba


@numba.njit("i8(i8)", cache=True)
def double(value):
    return 2 * value


def get():
    return double
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "some_loops.py").write_text("value = 1\n", encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "some_loops.py"


def find_cost_s(function: str) -> float:
    kept = partial(is_kept, "some_loops", function)
    return CompiledCode(object, kept, cost_s=1.0, first_s=9.0).cost_s


def test_loops_cost_more_before_they_are_in_the_cache(module: Path) -> None:
    assert find_cost_s("run") == 9.0
    cache = module.parent / "__pycache__" / f"some_loops.run-1.{PYTHON}.nbi"
    cache.parent.mkdir(exist_ok=True)
    cache.touch()
    os.utime(module, (1e9, 1e9))
    assert find_cost_s("run") == 1.0


def test_loops_cost_more_where_their_source_has_changed_since(module: Path) -> None:
    cache = module.parent / "__pycache__" / f"some_loops.run-1.{PYTHON}.nbi"
    cache.parent.mkdir(exist_ok=True)
    cache.touch()
    os.utime(cache, (1e9, 1e9))
    assert find_cost_s("run") == 9.0


def test_loops_that_cost_the_same_either_way_are_loaded_at_once(module: Path) -> None:
    loops = CompiledCode(object, lambda: is_kept(module.stem, "run"), cost_s=1.0)
    assert loops.expect(1, 0.9) is None
    assert loops.find() is None


@pytest.mark.parametrize(("function", "cost_s"), [("loop_p_12", 1.0), ("loop_p_13", 9.0)])
def test_a_function_is_kept_by_its_name_whatever_changes_beside_it(
    module: Path, function: str, cost_s: float
) -> None:
    cache = module.parent / "__pycache__" / f"some_loops.loop_p_12-11.{PYTHON}.nbi"
    cache.parent.mkdir(exist_ok=True)
    cache.touch()
    for path, time_s in ((module, 1e9), (cache, 1.1e9)):
        os.utime(path, (time_s, time_s))
    (module.parent / "steps.py").touch()
    assert find_cost_s(function) == cost_s
    os.utime(module, (1.2e9, 1.2e9))
    assert find_cost_s(function) == 9.0


def test_older_versions_of_a_function_are_removed(module: Path) -> None:
    cache = module.parent / "__pycache__"
    cache.mkdir(exist_ok=True)
    names = ["loop_p_11-11.py.nbi", "loop_p_11-11.py.1.nbc", "loop_p_12-11.py.nbi"]
    names += ["loop_p_12-11.py.1.nbc", "loop_pid_11-11.py.nbi", "loop_p_11-11.py.txt"]
    for name in names:
        (cache / f"some_loops.{name}").touch()
    remove_stored("some_loops", "loop_p", kept="loop_p_12")
    assert {path.name.partition(".")[2] for path in cache.iterdir()} == {*names[2:]}


def test_a_loop_that_is_compiled_anew_replaces_its_older_versions(tmp_path: Path) -> None:
    pytest.importorskip("numba")
    (tmp_path / "small.py").write_text("def small(value):\n    return value + STAMP\n", "utf-8")
    code = (
        "from numba import types; import small\n"
        "from turtlelog.simulate import compiled_twins\n"
        "kind = types.int64(types.int64)\n"
        "compiled_twins.compile_entry(small.small, 'rows_p_12', lambda _: {'STAMP': 2}, kind)\n"
    )
    hashed = sha1(str(tmp_path).encode(), usedforsecurity=False).hexdigest()
    cache = tmp_path / "cache" / f"{tmp_path.name}_{hashed}"
    cache.mkdir(parents=True)
    names = ["rows_p_11-1.py311.nbi", "rows_p_11-1.py311.1.nbc", "p_11-1.py311.nbi"]
    for name in names:
        (cache / f"small.{name}").touch()
    paths = os.pathsep.join([str(tmp_path), *sys.path])
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": paths}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)
    found = {path.name.partition("-")[0] for path in cache.iterdir()}
    assert found == {"small.rows_p_12", "small.p_11"}


def test_loops_are_loaded_once_all_work_together_is_worth_it() -> None:
    pytest.importorskip("numba")
    loops = CompiledCode(lambda: "loaded", lambda: True, cost_s=1.0)
    assert (loops.expect(999, 1e-3), loops.find()) == (None, None)
    assert (loops.expect(2, 1e-3), loops.find()) == ("loaded", "loaded")


def test_loops_that_could_not_be_loaded_are_not_tried_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tries: list[None] = []
    loops = CompiledCode(object, lambda: True, cost_s=1.0)
    monkeypatch.setattr(loops, "load", lambda: tries.append(None))
    assert [loops.expect(1, 1.0) for _ in range(3)] == [None] * 3
    assert len(tries) == 1


def test_there_are_no_loops_without_numba_or_where_it_compiles_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    numba = pytest.importorskip("numba")
    loops = CompiledCode(object, lambda: True, cost_s=1.0)
    assert loops.load() is not None
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 1)
    assert loops.load() is None
    monkeypatch.setitem(sys.modules, "numba", None)
    assert loops.load() is None


def test_without_numba_no_work_is_worth_loops_and_no_cache_is_looked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "numba", None)

    def is_kept() -> bool:
        raise AssertionError("the cache is looked for")

    loops = CompiledCode(object, is_kept, cost_s=1.0)
    assert (loops.expect(10**9, 1.0), loops.cost_s) == (None, math.inf)


def test_loops_that_cannot_be_compiled_say_why() -> None:
    pytest.importorskip("numba")
    loops = CompiledCode(lambda: int("no number"), lambda: True, cost_s=1.0)
    assert (loops.problem, loops.expect(2, 1.0), loops.find()) == (None, None, None)
    assert loops.problem == "invalid literal for int() with base 10: 'no number'"


@pytest.mark.parametrize("error", [ImportError, RuntimeError, OSError])
def test_a_numba_that_cannot_load_or_keep_loops_is_no_problem(error: type[Exception]) -> None:
    def load() -> None:
        raise error

    loops = CompiledCode(load, lambda: True, cost_s=1.0)
    assert (loops.load(), loops.problem) == (None, None)


def test_an_index_of_another_python_is_of_no_use(module: Path) -> None:
    cache = module.parent / "__pycache__" / "some_loops.run-1.py27.nbi"
    cache.parent.mkdir(exist_ok=True)
    cache.touch()
    assert find_cost_s("run") == 9.0


@pytest.mark.everyday("beside")
@pytest.mark.parametrize("place", ["beside", "NUMBA_CACHE_DIR", "user"])
def test_loops_are_found_where_numba_keeps_them(
    module: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    """Functions are compiled, and loaded by another process."""
    pytest.importorskip("numba")
    module.write_text(COMPILED, encoding="utf-8")
    if place == "NUMBA_CACHE_DIR":
        monkeypatch.setenv(place, str(module.parent / "kept"))
    elif sys.platform != "linux" and place == "user":
        pytest.skip("the user's cache is known on Linux alone")
    elif place == "user":
        (module.parent / "__pycache__").write_text("no folder", encoding="utf-8")
    assert find_cost_s("double") == 9.0
    subprocess.run([sys.executable, "-c", "import some_loops"], cwd=module.parent, check=True)
    assert find_cost_s("double") == 1.0


PARTS = """
from importlib import import_module

from turtlelog.processes import COMPILING
from turtlelog.simulate.compiled_twins import is_kept
from turtlelog.simulate.many import CompiledCode, call_beside

PARTS = "first_part", "second_part"
BESIDE = f"{PARTS[1]}:get"

def load():
    return import_module(PARTS[0]).get(), call_beside(BESIDE)

if __name__ == "__main__":
    loops = CompiledCode(
        load,
        lambda: all(is_kept(part, "double") for part in PARTS),
        cost_s=1.0,
        first_s=9.0,
        beside=[BESIDE],
    )
    cost_s, whole = loops.cost_s, loops.load()
    assert not COMPILING.is_set()
    hits = (sum(double.stats.cache_hits.values()) for double in whole)
    print(cost_s, *hits)
"""


@pytest.mark.thorough
@pytest.mark.everyday("sys.executable")
@pytest.mark.parametrize("executable", ["sys.executable", "''"])
def test_modules_compile_side_by_side_and_here_where_no_process_starts(
    tmp_path: Path, executable: str
) -> None:
    """Functions are compiled, with processes that start."""
    pytest.importorskip("numba")
    for name in ("first_part", "second_part"):
        (tmp_path / f"{name}.py").write_text(COMPILED, "utf-8")
    script = f"import sys\nsys.executable = {executable}\n{PARTS}"
    found = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", script],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
            capture_output=True,
            text=True,
            timeout=120,
            check=True,
        )
        found.append((done.stdout.split(), done.stderr))
    of_other = "1" if executable == "sys.executable" else "0"
    assert found == [(["9.0", "0", of_other], ""), (["1.0", "1", "1"], "")]
