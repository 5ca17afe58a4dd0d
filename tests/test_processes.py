import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import MappingProxyType, SimpleNamespace

import pytest

from turtlelog import processes
from turtlelog.errors import ProcessError
from turtlelog.processes import choose_jobs, count_cores, map_in_processes

forked = pytest.mark.skipif(not processes.CAN_FORK, reason="processes are not forked here")
needs_signals = pytest.mark.skipif(sys.platform == "win32", reason="there are no such signals")


class Watched(Sequence[float]):
    """Items that tell which of them was handed out last."""

    def __init__(self, items: list[float]) -> None:
        self.items, self.last = items, -1

    def __len__(self) -> int:
        return len(self.items)

    def __getitem__(self, place: int) -> float:  # type: ignore[override]
        self.last = place
        return self.items[place]


def test_results_keep_their_order_and_an_error_its_place() -> None:
    words = [str(number) for number in range(400)]
    found = map_in_processes(int, [*words, "five", "6"], 2)
    assert [next(found) for _ in words] == list(range(400))
    with pytest.raises(ValueError, match="'five'") as failed:
        next(found)
    assert "processes.py" in failed.value.__notes__[0]  # where it was raised


def test_one_slow_item_leaves_few_results_in_memory() -> None:
    items = Watched([0.3, *([0.0] * 1000)])
    found = map_in_processes(time.sleep, items, 2)
    next(found)
    assert items.last < 2 * processes._AHEAD
    assert len(list(found)) == 1000


@needs_signals
@pytest.mark.parametrize("before", [0, 1, 20])
def test_a_process_that_is_killed_is_one_line_with_its_item(before: int) -> None:
    wanted = [signal.SIGCONT] * before + [signal.SIGKILL] + [signal.SIGCONT] * 20
    found = "expected a result, found that the process at work on it was ended by SIGKILL"
    line = f"SIGKILL: {found}; fewer --jobs take less memory"
    with pytest.raises(ProcessError, match=f"^{line}$"):
        list(map_in_processes(signal.raise_signal, wanted, 2, name=lambda one: one.name))


@pytest.mark.parametrize(
    ("work", "item", "end"),
    [
        pytest.param(
            signal.raise_signal, signal.SIGTERM, "was ended by SIGTERM", marks=needs_signals
        ),
        (os._exit, 3, "ended with 3"),
    ],
    ids=["terminated", "left"],
)
def test_of_memory_nothing_is_said_where_it_was_not_the_reason(
    work: Callable[[int], None], item: int, end: str
) -> None:
    line = f"{item:d}: expected a result, found that the process at work on it {end}"
    with pytest.raises(ProcessError, match=f"^{line}$"):
        list(map_in_processes(work, [item, item], 2, name=lambda one: f"{one:d}"))


_SLEEP = """
import sys, time
from turtlelog.processes import map_in_processes
try:
    for _ in map_in_processes(time.sleep, [0.0, 60.0, 60.0, 60.0], 2):
        print(flush=True)
except KeyboardInterrupt:
    sys.exit(130)
"""


@needs_signals
def test_an_interrupt_of_the_terminal_ends_every_process_in_silence() -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", _SLEEP],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    assert process.stdout is not None
    process.stdout.readline()
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=30.0)
    assert (process.returncode, err) == (130, b"")  # a worker would hold the streams open


def test_more_processes_start_only_for_long_work(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(processes, "count_cores", lambda: 4)
    missing = [tmp_path / f"{number}.mcap" for number in range(667)]
    assert (choose_jobs(missing[:666]), choose_jobs(missing)) == (1, 4)
    assert (
        choose_jobs(missing[:200], file_s=0.0099),
        choose_jobs(missing[:200], file_s=0.0101),
    ) == (1, 4)
    large = tmp_path / "bag" / "large.mcap"
    large.parent.mkdir()
    large.touch()
    os.truncate(large, 199_300_000)
    assert choose_jobs([large.parent, "other.mcap"]) == 1
    os.truncate(large, 199_500_000)
    assert choose_jobs([large.parent, "other.mcap"]) == 2
    assert choose_jobs([large]) == 1
    monkeypatch.setattr(processes, "count_cores", lambda: 1)
    assert choose_jobs(missing) == 1


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="no cores can be chosen here")
def test_cores_are_those_that_this_process_may_use() -> None:
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(allowed)})
    try:
        assert count_cores() == 1
    finally:
        os.sched_setaffinity(0, allowed)
    assert count_cores() == len(allowed)


def test_a_process_at_work_starts_no_others(monkeypatch: pytest.MonkeyPatch) -> None:
    worker = SimpleNamespace(daemon=True)
    monkeypatch.setattr(multiprocessing, "current_process", lambda: worker)
    assert count_cores() == 1


_FORKED = """
import signal
from turtlelog.processes import map_in_processes

def stop(*_):
    raise KeyboardInterrupt

ends = [signal.SIGTERM, signal.SIGHUP, signal.SIGINT]
for number in ends:
    signal.signal(number, stop)
print(*(handler.name for handler in map_in_processes(signal.getsignal, ends, 2, is_forked=True)))
"""


@forked
def test_forked_processes_end_in_silence_and_leave_the_terminal_to_their_parent() -> None:
    answer = subprocess.run([sys.executable, "-c", _FORKED], capture_output=True, check=False)
    assert (answer.stdout, answer.stderr) == (b"SIG_DFL SIG_IGN SIG_IGN\n", b"")


class LostArgumentError(Exception):
    """Packed it keeps its text, which its constructor does not take."""

    def __init__(self) -> None:
        super().__init__("the disk is gone")


def raise_strange_error(_: int) -> None:
    raise LostArgumentError


def return_it(item: object) -> object:
    return item


def return_generator(_: int) -> Iterator[int]:
    return iter(number for number in [1])


@pytest.mark.parametrize(
    ("work", "line"),
    [
        (raise_strange_error, "LostArgumentError: the disk is gone"),
        (return_generator, "cannot pickle 'generator' object"),
    ],
)
def test_an_error_that_does_not_fit_through_a_pipe_is_told_in_a_line(
    work: Callable[[int], object], line: str
) -> None:
    # Not forked: where a test of clusters was before, Dask has taught this process to pack errors.
    with pytest.raises((RuntimeError, TypeError), match=line) as failed:
        list(map_in_processes(work, [1, 2], 2))
    assert "test_processes.py" in failed.value.__notes__[0] or "pickle" in line


@forked
def test_read_only_mappings_cross_as_such() -> None:
    numbers = [MappingProxyType({"a": 1}), MappingProxyType({"b": 2})]
    found = [*map_in_processes(return_it, numbers, 2, is_forked=True)]
    assert found == numbers
    assert {type(one) for one in found} == {MappingProxyType}
