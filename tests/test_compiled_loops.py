import os
from pathlib import Path

import pytest

from turtlelog.compiled_loops import CompiledLoops


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "some_loops.py").write_text("value = 1\n", encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path / "some_loops.py"


def test_loops_cost_more_before_they_are_in_the_cache(module: Path) -> None:
    assert CompiledLoops("some_loops", cost_s=1.0, first_s=9.0).cost_s == 9.0
    cache = module.parent / "__pycache__" / "some_loops.run-1.py311.nbi"
    cache.parent.mkdir(exist_ok=True)
    cache.touch()
    os.utime(module, (1e9, 1e9))
    assert CompiledLoops("some_loops", cost_s=1.0, first_s=9.0).cost_s == 1.0


def test_loops_cost_more_where_their_source_has_changed_since(module: Path) -> None:
    cache = module.parent / "__pycache__" / "some_loops.run-1.py311.nbi"
    cache.parent.mkdir(exist_ok=True)
    cache.touch()
    os.utime(cache, (1e9, 1e9))
    assert CompiledLoops("some_loops", cost_s=1.0, first_s=9.0).cost_s == 9.0


def test_loops_that_cost_the_same_either_way_are_loaded_at_once(module: Path) -> None:
    loops = CompiledLoops(module.stem, cost_s=1.0)
    assert loops.expect(1, 0.9) is None
    assert loops.find() is None
