import pickle
import pkgutil
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from turtlelog.arithmetic import called, hypot, wrap_angle
from turtlelog.simulate.compiled_twins import Twins, compile_entry, stamp_functions

ENTRY = """
def measure(x, y):
    return STEP(x, y)
"""


def step(x: float, y: float) -> float:
    return add(hypot(x, y), wrap_angle(x))


def add(left: float, right: float) -> float:
    return left + right if left < 3.0 else left - right


def step_with_function(x: float, y: float) -> float:
    """Return a sum by a function inside, which takes a pass that only numba's compiler has."""

    def double(value: float) -> float:
        return 2.0 * value

    return double(x) + double(y)


@pytest.fixture
def compile_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[Any], Any]:
    numba = pytest.importorskip("numba")
    (tmp_path / "small_entry.py").write_text(ENTRY, "utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.delitem(sys.modules, "small_entry", raising=False)
    entry = import_module("small_entry").measure

    def compile_it(function: Any) -> Any:
        kind = numba.float64(numba.float64, numba.float64)
        return compile_entry(
            entry, "measure_1", lambda compiler: {"STEP": Twins(compiler).compile(function)}, kind
        )

    return compile_it


def name_library(made: Any) -> str:
    return type(made.overloads[made.signatures[0]].library).__name__


@pytest.mark.parametrize(("x", "y"), [(0.3, 0.4), (-7.1, 2.3), (1e-3, 3.9)])
def test_entry_is_compiled_with_its_twins(
    compile_step: Callable[[Any], Any], x: float, y: float
) -> None:
    made = compile_step(step)
    assert made(x, y) == step(x, y)
    assert name_library(made) == "_EntryLibrary"


def test_entry_from_the_cache_calls_its_own_twins(compile_step: Callable[[Any], Any]) -> None:
    first, second = compile_step(step), compile_step(step)
    assert not first.stats.cache_hits
    assert second.stats.cache_hits
    assert second(0.3, 0.4) == first(0.3, 0.4)


@pytest.mark.parametrize("gone", [b"cno_such_module\nKind\n.", b"cpickle\nNoSuchKind\n."])
def test_code_stored_with_a_class_that_has_moved_is_compiled_again(
    compile_step: Callable[[Any], Any], tmp_path: Path, gone: bytes
) -> None:
    compile_step(step)
    (index,) = tmp_path.rglob("*.nbi")
    version = pickle.dumps(sys.modules["numba"].__version__, protocol=-1)
    assert index.read_bytes().startswith(version)
    index.write_bytes(version + gone)
    made = compile_step(step)
    assert made(0.3, 0.4) == step(0.3, 0.4)
    assert not made.stats.cache_hits
    assert compile_step(step).stats.cache_hits


def test_other_numba_compiles_with_its_own_compiler(
    compile_step: Callable[[Any], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "turtlelog.simulate.twin_compiler", None)
    made = compile_step(step)
    assert made(0.3, 0.4) == step(0.3, 0.4)
    assert name_library(made) == "JITCodeLibrary"


def test_code_that_only_numba_compiles_is_compiled_by_numba(
    compile_step: Callable[[Any], Any],
) -> None:
    made = compile_step(step_with_function)
    assert made(0.25, 0.5) == 1.5
    assert name_library(made) == "JITCodeLibrary"


def write_step(lines: int) -> Any:
    """Return a step that is lowered to two instructions for each line, and three more."""
    scope: dict[str, Any] = {"__name__": __name__}
    text = "".join(f"    x = x * y + {number}.5\n" for number in range(lines))
    exec(f"def long_step(x, y):\n{text}    return x\n", scope)
    return called(scope["long_step"])


@pytest.mark.parametrize(("lines", "is_repeated"), [(190, True), (205, False)])
def test_large_twin_is_not_repeated_where_it_is_called(
    compile_step: Callable[[Any], Any], lines: int, *, is_repeated: bool
) -> None:
    """A step of two hundred lines is compiled."""
    long_step = write_step(lines)
    made = compile_step(long_step)
    code = made.overloads[made.signatures[0]].library.get_llvm_str()
    assert made(1.0, 0.5) == long_step(1.0, 0.5)
    assert ("define internal" in code) != is_repeated


@pytest.mark.parametrize("file", ["compiled_twins.py", "twin_compiler.py"])
def test_stamp_changes_with_the_files_that_compile(
    monkeypatch: pytest.MonkeyPatch, file: str
) -> None:
    before, read = stamp_functions([step]), pkgutil.get_data

    def read_edited(package: str, name: str) -> bytes | None:
        return b"edited" if name == file else read(package, name)

    assert stamp_functions([step]) == before
    monkeypatch.setattr(pkgutil, "get_data", read_edited)
    assert stamp_functions([step]) != before


def test_stamp_needs_no_sources(monkeypatch: pytest.MonkeyPatch) -> None:
    def read_none(package: str, name: str) -> bytes:
        raise FileNotFoundError(name)

    monkeypatch.setattr(pkgutil, "get_data", read_none)
    assert stamp_functions([step]) != stamp_functions([add])
