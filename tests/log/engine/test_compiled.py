import sys

import pytest

from turtlelog.log.engine import compiled
from turtlelog.log.engine.compiled import COST_S, expect, find_kernels


@pytest.fixture(autouse=True)
def fresh(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "_kernels", None)
    monkeypatch.setattr(compiled, "_saved_s", 0.0)
    monkeypatch.setattr(compiled, "load_kernels", lambda: "loaded")


def test_loops_are_loaded_once_they_would_have_saved_what_they_cost() -> None:
    assert expect(999, COST_S / 1000) is None
    assert find_kernels() is None
    assert expect(2, COST_S / 1000) == "loaded"
    assert find_kernels() == "loaded"


def test_what_could_not_be_loaded_is_not_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    tries: list[None] = []
    monkeypatch.setattr(compiled, "load_kernels", lambda: tries.append(None))
    for _ in range(3):
        assert expect(1, COST_S) is None
    assert len(tries) == 1


def test_without_numba_there_are_no_loops(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    monkeypatch.setitem(sys.modules, "numba", None)
    assert compiled.load_kernels() is None


def test_where_numba_compiles_nothing_there_are_no_loops(monkeypatch: pytest.MonkeyPatch) -> None:
    numba = pytest.importorskip("numba")
    monkeypatch.undo()
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 1)
    assert compiled.load_kernels() is None


def test_without_a_place_to_keep_them_there_are_no_loops(monkeypatch: pytest.MonkeyPatch) -> None:
    caching = pytest.importorskip("numba.core.caching")
    monkeypatch.undo()
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    monkeypatch.delitem(sys.modules, "turtlelog.log.engine.kernels", raising=False)
    assert compiled.load_kernels() is None
