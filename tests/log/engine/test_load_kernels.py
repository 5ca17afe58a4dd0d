import sys

import pytest

from turtlelog.log.engine.load_kernels import COST_S, KERNELS


@pytest.fixture(autouse=True)
def fresh(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(KERNELS, "_loops", None)
    monkeypatch.setattr(KERNELS, "_saved_s", 0.0)
    monkeypatch.setattr(KERNELS, "load", lambda: "loaded")
    monkeypatch.setitem(KERNELS.__dict__, "cost_s", COST_S)


def test_loops_are_loaded_once_they_would_have_saved_what_they_cost() -> None:
    assert KERNELS.expect(999, COST_S / 1000) is None
    assert KERNELS.find() is None
    assert KERNELS.expect(2, COST_S / 1000) == "loaded"
    assert KERNELS.find() == "loaded"


def test_what_could_not_be_loaded_is_not_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    tries: list[None] = []
    monkeypatch.setattr(KERNELS, "load", lambda: tries.append(None))
    for _ in range(3):
        assert KERNELS.expect(1, COST_S) is None
    assert len(tries) == 1


def test_without_numba_there_are_no_loops(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    monkeypatch.setitem(sys.modules, "numba", None)
    assert KERNELS.load() is None


def test_where_numba_compiles_nothing_there_are_no_loops(monkeypatch: pytest.MonkeyPatch) -> None:
    numba = pytest.importorskip("numba")
    monkeypatch.undo()
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 1)
    assert KERNELS.load() is None


def test_without_a_place_to_keep_them_there_are_no_loops(monkeypatch: pytest.MonkeyPatch) -> None:
    caching = pytest.importorskip("numba.core.caching")
    monkeypatch.undo()
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    monkeypatch.delitem(sys.modules, "turtlelog.log.engine.kernels", raising=False)
    assert KERNELS.load() is None
