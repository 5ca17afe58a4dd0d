import ast
import importlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from turtlelog.compiled_loops import CompiledLoops

PYTHON = f"py{sys.version_info.major}{sys.version_info.minor}"
COMPILED = """
import numba


@numba.njit("i8(i8)", cache=True)
def double(value):
    return 2 * value
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "some_loops.py").write_text("value = 1\n", encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "some_loops.py"


def test_loops_cost_more_before_they_are_in_the_cache(module: Path) -> None:
    assert CompiledLoops("some_loops", cost_s=1.0, first_s=9.0).cost_s == 9.0
    cache = module.parent / "__pycache__" / f"some_loops.run-1.{PYTHON}.nbi"
    cache.parent.mkdir(exist_ok=True)
    cache.touch()
    os.utime(module, (1e9, 1e9))
    assert CompiledLoops("some_loops", cost_s=1.0, first_s=9.0).cost_s == 1.0


def test_loops_cost_more_where_their_source_has_changed_since(module: Path) -> None:
    cache = module.parent / "__pycache__" / f"some_loops.run-1.{PYTHON}.nbi"
    cache.parent.mkdir(exist_ok=True)
    cache.touch()
    os.utime(cache, (1e9, 1e9))
    assert CompiledLoops("some_loops", cost_s=1.0, first_s=9.0).cost_s == 9.0


def test_loops_cost_more_where_a_file_beside_them_has_changed_since(module: Path) -> None:
    cache = module.parent / "__pycache__" / f"some_loops.run-1.{PYTHON}.nbi"
    cache.parent.mkdir(exist_ok=True)
    cache.touch()
    for path, time_s in ((module, 1e9), (cache, 1.1e9)):
        os.utime(path, (time_s, time_s))
    assert CompiledLoops("some_loops", cost_s=1.0, first_s=9.0).cost_s == 1.0
    (module.parent / "steps.py").touch()
    assert CompiledLoops("some_loops", cost_s=1.0, first_s=9.0).cost_s == 9.0


def test_loops_that_cost_the_same_either_way_are_loaded_at_once(module: Path) -> None:
    loops = CompiledLoops(module.stem, cost_s=1.0)
    assert loops.expect(1, 0.9) is None
    assert loops.find() is None


def test_an_index_of_another_python_is_of_no_use(module: Path) -> None:
    cache = module.parent / "__pycache__" / "some_loops.run-1.py27.nbi"
    cache.parent.mkdir(exist_ok=True)
    cache.touch()
    assert CompiledLoops("some_loops", cost_s=1.0, first_s=9.0).cost_s == 9.0


@pytest.mark.everyday("beside", "NUMBA_CACHE_DIR")
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
    assert CompiledLoops("some_loops", cost_s=1.0, first_s=9.0).cost_s == 9.0
    subprocess.run([sys.executable, "-c", "import some_loops"], cwd=module.parent, check=True)
    assert CompiledLoops("some_loops", cost_s=1.0, first_s=9.0).cost_s == 1.0


PARTS = """
from turtlelog.compiled_loops import COMPILING, CompiledLoops

if __name__ == "__main__":
    loops = CompiledLoops("whole", cost_s=1.0, first_s=9.0, parts=("first_part", "second_part"))
    cost_s, whole = loops.cost_s, loops.load()
    assert not COMPILING.is_set()
    hits = (sum(part.double.stats.cache_hits.values()) for part in (whole.first, whole.second))
    print(cost_s, *hits)
"""


@pytest.mark.everyday("sys.executable")
@pytest.mark.parametrize("executable", ["sys.executable", "''"])
def test_parts_compile_side_by_side_and_here_where_no_process_starts(
    tmp_path: Path, executable: str
) -> None:
    """Functions are compiled, with processes that start."""
    pytest.importorskip("numba")
    for name in ("first_part", "second_part"):
        (tmp_path / f"{name}.py").write_text(COMPILED, "utf-8")
    whole = "import first_part as first, second_part as second\n"
    (tmp_path / "whole.py").write_text(whole, "utf-8")
    script = f"import sys\nsys.executable = {executable}\n{PARTS}"
    found = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", script],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])},
            capture_output=True,
            text=True,
            timeout=120,
            check=True,
        )
        found.append((done.stdout.split(), done.stderr))
    of_other = "1" if executable == "sys.executable" else "0"
    assert found == [(["9.0", "0", of_other], ""), (["1.0", "1", "1"], "")]


FUNCTION = """
import constants
from constants import SIZE
from numba import njit
from turtlelog.compiled_loops import sum_up_sources


def build(stamp):
    @njit("float64()", cache=True)
    def measure():
        return SIZE if stamp else 0.0

    return measure


measure = build(sum_up_sources(constants))
print(measure(), sum(measure.stats.cache_hits.values()))
"""


def test_a_constant_of_another_file_is_compiled_anew(tmp_path: Path) -> None:
    """Functions are compiled, twice."""
    pytest.importorskip("numba")
    (tmp_path / "function.py").write_text(FUNCTION, "utf-8")
    path = os.pathsep.join([str(Path(__file__).parents[1]), str(tmp_path)])
    found = []
    for size in (3.0, 3.0, 4.0):
        (tmp_path / "constants.py").write_text(f"SIZE = {size}\n", "utf-8")
        done = subprocess.run(
            [sys.executable, "-B", "-c", "import function"],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": path},
            capture_output=True,
            text=True,
            timeout=120,
            check=True,
        )
        found.append(done.stdout.split())
    assert found == [["3.0", "0"], ["3.0", "1"], ["4.0", "0"]]


@pytest.mark.parametrize(
    "name",
    [
        "simulate.compiled.sequential_loop",
        "simulate.compiled.any_loop",
        "sweep.batch_kernel",
    ],
)
def test_every_file_that_a_kernel_takes_from_is_summed_up(name: str) -> None:
    pytest.importorskip("numba")
    kernel = importlib.import_module(f"turtlelog.{name}")
    summed_up = {module.__name__ for module in kernel.SOURCES}
    for module in (kernel, *kernel.SOURCES):
        if module is kernel or is_compiled(module):
            assert {*list_taken(module)} <= summed_up
    assert len(summed_up) > 3


def is_compiled(module: ModuleType) -> bool:
    return any(type(value).__name__ == "CPUDispatcher" for value in vars(module).values())


def list_taken(module: ModuleType) -> Iterator[str]:
    """Yield the modules of which a module takes something by its name."""
    for node in ast.walk(ast.parse(Path(str(module.__file__)).read_text("utf-8"))):
        if not isinstance(node, ast.ImportFrom) or node.module == "turtlelog.compiled_loops":
            continue
        if not str(node.module).startswith("turtlelog."):
            continue
        names = [getattr(module, one.asname or one.name) for one in node.names]
        if any(not isinstance(name, ModuleType) for name in names):
            yield str(node.module)
