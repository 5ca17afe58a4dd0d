"""What threads of a reader share: they change none of it but under a lock."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from tests.log.engine.files import write_points
from turtlelog.log import read_columns
from turtlelog.log.engine import blocks
from turtlelog.log.engine.channels import Catalogue
from turtlelog.log.engine.limits import UNPACKED, Allowance


class SlowNumber(int):
    """A number from which it takes so long to subtract that other threads come between."""

    def __rsub__(self, other: int) -> int:
        time.sleep(1e-4)
        return other - int(self)


def test_what_threads_spend_at_once_is_all_counted() -> None:
    allowance = Allowance(0)
    before = allowance.count_left(UNPACKED)
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda _: allowance.spend(UNPACKED, SlowNumber(1)), range(40)))
    assert before - allowance.count_left(UNPACKED) == 40


def test_the_thread_that_reads_is_the_only_one_that_fills_the_catalogue(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_points(tmp_path / "a.mcap", range(1000), chunk_size=200)
    seen: dict[str, set[int]] = {}

    def watch(owner: Any, name: str) -> None:
        found = getattr(owner, name)

        def call(*values: Any) -> Any:
            seen.setdefault(name, set()).add(threading.get_ident())
            return found(*values)

        monkeypatch.setattr(owner, name, call)

    for name in ("add", "_merge_plans", "_choose_reading", "check"):
        watch(Catalogue, name)
    read_columns(path)
    others = seen.pop("check") - {threading.get_ident()}
    assert others, "no thread was started"
    assert [*seen.values()] == [{threading.get_ident()}] * 3


def test_what_the_summary_describes_is_not_parsed_again_in_chunks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any) -> None:
        pytest.fail("a schema or channel was parsed")

    path = write_points(tmp_path / "a.mcap", range(1000), chunk_size=200)
    monkeypatch.setattr(blocks, "parse_record", refuse)
    assert len(read_columns(path)["/p"]) == 1000
