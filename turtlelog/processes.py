"""Work on many things in several processes: the results in order, never many at once in memory.

Processes are spawned: the same everywhere, and safe beside threads. They import the module that
runs: a script that asks for more than one keeps its own work under `if __name__ == "__main__":`.
Where libraries take a second of each, they are forked instead, on Linux.
"""

import os
import signal
import sys
import traceback
import warnings
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Literal, TypeVar

from turtlelog.errors import ProcessError, RemoteError, describe_error, make_portable
from turtlelog.files.urls import RemotePath, make_path

if TYPE_CHECKING:
    from concurrent.futures import Executor, Future
    from multiprocessing.connection import Connection

T = TypeVar("T")
R = TypeVar("R")

_QUEUED: Final = 3
"""Items that a process holds: one that it works on and two that wait, so that it does not idle
while the caller prints."""

_AHEAD: Final = 64
"""Results for each process that may wait for an earlier one: one slow file does not stop the other
processes, and of ten thousand results no more are in memory."""

_WATCH_S: Final = 2.0
"""Between two questions whether a service is there, while a result is awaited [s]."""

_SUBMITTED: Final = 1024
"""Items that a cluster holds at a time: some for each of a few hundred cores."""

LONG_S: Final = 2.0
"""Work on one core that more processes make shorter [s]: to start one takes 0.5 to 1 s, and two
save half of the work."""

FILE_S: Final = 3e-3
"""To read and measure a usual file [s], besides its bytes."""

_BYTES_PER_S: Final = 100e6
"""How fast one core reads, decompresses and measures files [bytes/s]."""

_REMOTE_S: Final = 0.2
"""To read a file behind a URL [s]: a few requests. Its size is not asked for."""

CAN_FORK: Final = sys.platform == "linux"
"""Whether a process can be forked safely: elsewhere libraries of the system forbid it."""


class Watched(ABC):
    """An executor whose work may end without a word, so that its futures wait for ever.

    Attributes:
        is_gone: Whether it has ended.
    """

    is_gone: bool = False

    @abstractmethod
    def require_alive(self) -> None:
        """Refuse to wait any longer.

        Raises:
            ProcessError: Where the service has ended.
        """


def count_cores() -> int:
    """Return how many cores this process may use; of a worker 1, as it starts no others."""
    loaded = sys.modules.get("multiprocessing")  # not before the first process is started
    if loaded is not None and loaded.current_process().daemon:
        return 1
    if hasattr(os, "process_cpu_count"):
        return int(os.process_cpu_count() or 1)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0)) or 1
    return os.cpu_count() or 1


def choose_jobs(
    paths: Sequence[str | Path],
    *,
    file_s: float = FILE_S,
    count_read: Callable[[Path], int] | None = None,
) -> int:
    """Return how many processes read files soonest: 1 where starting more takes longer than that.

    Args:
        paths: Files and folders; what is missing takes no time.
        file_s: What each takes besides its bytes [s].
        count_read: How many bytes of a path are read; None: all.
    """
    cores = count_cores()
    if cores == 1 or len(paths) < 2:
        return 1
    work_s = 0.0
    for path in paths:
        if isinstance(path, RemotePath):
            work_s += _REMOTE_S
            continue
        work_s += file_s + (count_read or count_bytes)(make_path(path)) / _BYTES_PER_S
        if work_s > LONG_S:
            return min(cores, len(paths))
    return 1


def count_bytes(path: Path) -> int:
    """Return the size of a file, or of all files in a folder; 0 of what is not there."""
    with suppress(OSError, RemoteError):
        files = path.rglob("*") if path.is_dir() else [path]
        return sum(found.stat().st_size for found in files)
    return 0


def map_in_processes(
    work: Callable[[T], R],
    items: Sequence[T],
    jobs: "int | Executor",
    *,
    name: Callable[[T], str] = str,
    is_forked: bool = False,
) -> Generator[R, None, None]:
    """Yield what work makes of every item, in their order, as `map` does.

    Args:
        work: It can be pickled unless processes are forked, as can items and results. What it
            raises is raised here, where its result would stand.
        items: What to work on.
        jobs: Processes; with 1, or of one item, the work is done in this one. Or what takes the
            work, as `connect_cluster` yields it.
        name: What an item is called in an error.
        is_forked: Whether processes begin with all that this one has loaded; see `CAN_FORK`.

    Raises:
        ProcessError: Where a process ends before its work does, as one that runs out of memory.
    """
    if not isinstance(jobs, int):
        yield from _map_on(jobs, work, items, name)
        return
    if jobs == 1 or len(items) < 2:
        yield from map(work, items)
        return
    workers: list[_Worker] = []
    try:
        for _ in range(min(jobs, len(items))):
            workers.append(
                _Worker(work, name, "fork" if is_forked else "spawn")
            )  # one by one: those that run are ended below
        yield from _collect(workers, items)
    finally:
        for worker in workers:
            worker.end()


def start_pool(jobs: int) -> "Executor":
    """Return processes that take work again and again; they end when nobody holds them any more.

    For `map_in_processes`, where it is called many times and would start them each time.
    """
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    _pickle_read_only_mappings()
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(jobs, mp_context=context, initializer=_prepare_worker)
    with _block_signals(_OF_PARENT):
        pool.submit(os.getpid)  # starts all of them
    return pool


def _list_signals(*names: str) -> tuple[signal.Signals, ...]:
    return tuple(signal.Signals[name] for name in names if hasattr(signal, name))


_OF_PARENT: Final = _list_signals("SIGINT", "SIGHUP")
"""Ctrl-C and the end of a terminal reach all processes; the parent ends the others."""


def _prepare_worker() -> None:
    """Leave Ctrl-C to the parent, end in silence as it asks, let warnings be notes, not places.

    A forked process has the handlers of its parent, which raise KeyboardInterrupt.
    """
    _pickle_read_only_mappings()
    for number in _OF_PARENT:
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
    warnings.formatwarning = lambda message, *_, **__: f"{message}\n"


def _map_on(
    executor: "Executor", work: Callable[[T], R], items: Sequence[T], name: Callable[[T], str]
) -> Iterator[R]:
    waiting: deque[tuple[T, Future[R]]] = deque()
    left = iter(items)
    try:
        while True:
            waiting.extend(
                (item, executor.submit(work, item))
                for item in islice(left, _SUBMITTED - len(waiting))
            )
            if not waiting:
                return
            item, future = waiting.popleft()
            yield _await_result(executor, future, name(item))
    finally:
        # Nothing cancels the work of a service that has ended.
        is_gone = isinstance(executor, Watched) and executor.is_gone
        for _, future in () if is_gone else waiting:
            future.cancel()


def _await_result(executor: "Executor", future: "Future[R]", name: str) -> R:
    from concurrent.futures import BrokenExecutor, CancelledError, wait

    watched = executor if isinstance(executor, Watched) else None
    while watched is not None and wait([future], _WATCH_S).not_done:
        watched.require_alive()
    try:
        return future.result()
    except BrokenExecutor as err:
        raise ProcessError(f"{name}: no result, because a process ended") from err
    except CancelledError as err:
        if watched is not None:
            watched.require_alive()
        raise ProcessError(f"{name}: no result, because the work was cancelled") from err
    except Exception as err:
        if type(err).__module__.startswith("distributed."):
            if watched is not None:
                watched.require_alive()
            raise ProcessError(f"{name}: no result of the cluster: {describe_error(err)}") from err
        raise


class _Worker:
    """A process, and the items that it holds, the first of which it works on."""

    def __init__(
        self,
        work: Callable[[Any], Any],
        name: Callable[[Any], str],
        start: Literal["fork", "spawn"],
    ) -> None:
        import multiprocessing

        _pickle_read_only_mappings()
        context: Any = multiprocessing.get_context(start)
        self.pipe, theirs = context.Pipe()
        self.held: deque[tuple[int, Any]] = deque()
        self._name = name
        self._process = context.Process(target=_serve, args=(theirs, work), daemon=True)
        # A forked process has handlers of its parent until it is prepared.
        until_prepared = (signal.SIGTERM,) if start == "fork" else ()
        with _block_signals((*_OF_PARENT, *until_prepared)), warnings.catch_warnings():
            # Newer Pythons warn of a fork beside threads, such as those of a library that is idle.
            warnings.simplefilter("ignore", DeprecationWarning)
            self._process.start()
        theirs.close()

    def hand_out(self, place: int, item: Any) -> None:
        self.held.append((place, item))
        with suppress(OSError):  # it has ended, and what it found before that is still to be taken
            self.pipe.send(item)

    def take(self) -> tuple[int, Any, bool]:
        """Return the place of a result, the result, and whether it is an error."""
        try:
            result, is_error = self.pipe.recv()
        except (EOFError, OSError) as err:
            raise self._describe_end() from err
        place, _ = self.held.popleft()
        return place, result, is_error

    def end(self) -> None:
        self.pipe.close()
        self._process.terminate()
        self._process.join()

    def _describe_end(self) -> ProcessError:
        self._process.join()
        code, (_, item) = self._process.exitcode or 0, self.held[0]
        how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with {code}"
        # A system that is out of memory kills by this signal.
        advice = "; fewer --jobs take less memory" if how.endswith("SIGKILL") else ""
        return ProcessError(
            f"{self._name(item)}: expected a result, found that the process at work on it {how}"
            f"{advice}"
        )


def _collect(workers: Sequence[_Worker], items: Sequence[Any]) -> Iterator[Any]:
    """Yield results in order while the workers are kept busy."""
    from multiprocessing.connection import wait

    found: dict[int, tuple[Any, bool]] = {}
    done = started = 0
    while done < len(items):
        last = min(len(items), done + _AHEAD * len(workers))
        while started < last:
            worker = min(workers, key=lambda one: len(one.held))
            if len(worker.held) == _QUEUED:
                break
            worker.hand_out(started, items[started])
            started += 1
        busy = {worker.pipe: worker for worker in workers if worker.held}
        for pipe in wait(list(busy)):
            place, *outcome = busy[pipe].take()
            found[place] = (outcome[0], outcome[1])
        while done in found:
            result, is_error = found.pop(done)
            if is_error:
                raise result
            done += 1
            yield result


def _serve(pipe: "Connection", work: Callable[[Any], Any]) -> None:
    """Work until the other side ends, however it does."""
    _prepare_worker()
    with suppress(EOFError, OSError):
        while True:
            pipe.send_bytes(_answer(work, pipe.recv_bytes()))


def _answer(work: Callable[[Any], Any], packed: bytes) -> Any:
    """Return the result of an item and False, or its error and True; both are packed."""
    from multiprocessing.reduction import ForkingPickler

    try:
        return ForkingPickler.dumps((work(ForkingPickler.loads(packed)), False))
    except Exception as err:
        told = make_portable(err)
        told.add_note("".join(traceback.format_exception(err)))
        return ForkingPickler.dumps((told, True))


def _pickle_read_only_mappings() -> None:
    """Let read-only mappings, which many results hold, go from one process to another."""
    from multiprocessing.reduction import ForkingPickler

    ForkingPickler.register(MappingProxyType, _reduce_mapping)


def _reduce_mapping(mapping: "MappingProxyType[Any, Any]") -> tuple[Any, ...]:
    return _make_read_only, (dict(mapping),)


def _make_read_only(mapping: dict[Any, Any]) -> "MappingProxyType[Any, Any]":
    return MappingProxyType(mapping)


@contextmanager
def _block_signals(numbers: Sequence[signal.Signals]) -> Iterator[None]:
    """Let no signal of these reach a process that is started, not even before its first line."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    former = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, former)
