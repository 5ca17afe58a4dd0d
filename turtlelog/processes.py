"""Work on many items in several processes.

Results come in order, and never many of them are in memory.

Processes are spawned, which works on every system and beside threads. Each process imports the main
module: a script that uses several processes keeps its own work under `if __name__ == "__main__":`.
If loading libraries would take a second per process, Linux forks the processes instead.
"""

import os
import signal
import sys
import threading
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
"""Number of items that a process holds: one in work and two that wait, so that the process is not
idle while the caller prints."""

_AHEAD: Final = 64
"""Largest number of results per process that may wait for an earlier result. One slow file does not
stop the other processes, and of ten thousand results only a few are in memory."""

_WATCH_S: Final = 2.0
"""Time between two checks of a service while a result is awaited [s]."""

_SUBMITTED: Final = 1024
"""Number of items that a cluster holds at a time: several for each of a few hundred cores."""

LONG_S: Final = 2.0
"""Work on one core from which more processes save time [s]. Starting a process takes 0.5 to 1 s,
and two processes save half of the work."""

FILE_S: Final = 3e-3
"""Time to read and measure a typical file, in addition to the time for its bytes [s]."""

_BYTES_PER_S: Final = 100e6
"""Rate at which one core reads, decompresses and measures files [bytes/s]."""

_REMOTE_S: Final = 0.2
"""Time to read a file behind a URL [s]: a few requests. The size of the file is not requested."""

CAN_FORK: Final = sys.platform == "linux"
"""Whether a process can be forked safely: on other systems, system libraries forbid it."""

COMPILING: Final = threading.Event()
"""Set while this process compiles code, which takes seconds once: a progress bar shows this."""


class Watched(ABC):
    """An executor whose service may end without an error, so that its futures would wait forever.

    Attributes:
        is_gone: Whether the service has ended.
    """

    is_gone: bool = False

    @abstractmethod
    def require_alive(self) -> None:
        """Raise an error if the service has ended, instead of waiting any longer.

        Raises:
            ProcessError: If the service has ended.
        """


def count_cores() -> int:
    """Return how many cores this process may use; 1 in a worker, which starts no processes."""
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
    """Return the number of processes that read files fastest; 1 if starting more takes too long.

    Args:
        paths: Files and folders; missing paths take no time.
        file_s: Time for each file, in addition to the time for its bytes [s].
        count_read: Function that returns how many bytes of a path are read; None: all.
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
    """Return the size of a file, or of all files in a folder; 0 if the path does not exist."""
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
    """Yield the result of the work for each item, in order, like `map`.

    Args:
        work: Function of one item. Unless processes are forked, the function, the items and the
            results must be picklable. An exception is raised again at the place of the result.
        items: Items to work on.
        jobs: Number of processes. With 1, or for one item, this process does the work. An executor
            is also possible, as `connect_cluster` yields it.
        name: Word for an item in errors.
        is_forked: Whether processes begin with all modules that this process has loaded; see
            `CAN_FORK`.

    Raises:
        ProcessError: If a process ends before its work is done, for example because memory is used
            up.
    """
    if not isinstance(jobs, int):
        yield from _map_on(jobs, work, items, name)
        return
    if jobs == 1 or len(items) < 2:
        yield from map(work, items)
        return
    workers: list[_Worker] = []
    try:
        for _ in range(min(jobs, len(items))):  # one by one: those that run are ended below
            workers.append(_Worker(work, name, "fork" if is_forked else "spawn"))
        yield from _collect(workers, items)
    finally:
        for worker in workers:
            worker.end()


def start_pool(jobs: int) -> "Executor":
    """Return processes that can be used repeatedly, and that end when no longer referenced.

    Many calls of `map_in_processes` share these processes instead of starting new ones.
    """
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    _pickle_read_only_mappings()
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(jobs, mp_context=context, initializer=_prepare_worker)
    with block_signals(_OF_PARENT):
        pool.submit(os.getpid)  # starts all of them
    return pool


def find_signals(*names: str) -> tuple[signal.Signals, ...]:
    """Return the signals with these names that exist, because Windows lacks some."""
    return tuple(getattr(signal, name) for name in names if hasattr(signal, name))


_OF_PARENT: Final = find_signals("SIGINT", "SIGHUP")
"""Signals that reach all processes: Ctrl-C and the end of a terminal. The parent ends others."""


def _prepare_worker() -> None:
    """Ignore Ctrl-C, end silently when the parent asks, and print warnings without their place."""
    # A forked process inherits the handlers of its parent, which raise KeyboardInterrupt.
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
    """A process and the items that it holds; it works on the first item."""

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
        with block_signals((*_OF_PARENT, *until_prepared)), warnings.catch_warnings():
            # Newer Pythons warn of a fork beside threads, such as those of a library that is idle.
            warnings.simplefilter("ignore", DeprecationWarning)
            self._process.start()
        theirs.close()

    def hand_out(self, place: int, item: Any) -> None:
        self.held.append((place, item))
        with suppress(OSError):  # it has ended, and what it found before that is still to be taken
            self.pipe.send(item)

    def take(self) -> tuple[int, Any, bool]:
        """Return the position of a result, the result, and whether the result is an error."""
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
    """Yield results in order, and keep the workers busy."""
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
            place, result, is_error = busy[pipe].take()
            found[place] = result, is_error
        while done in found:
            result, is_error = found.pop(done)
            if is_error:
                raise result
            done += 1
            yield result


def _serve(pipe: "Connection", work: Callable[[Any], Any]) -> None:
    """Work until the connection to the parent ends for any reason."""
    _prepare_worker()
    with suppress(EOFError, OSError):
        while True:
            pipe.send_bytes(_answer(work, pipe.recv_bytes()))


def _answer(work: Callable[[Any], Any], packed: bytes) -> Any:
    """Return the packed result of an item and False, or the packed error and True."""
    import traceback
    from multiprocessing.reduction import ForkingPickler

    try:
        return ForkingPickler.dumps((work(ForkingPickler.loads(packed)), False))
    except Exception as err:
        told = make_portable(err)
        told.add_note("".join(traceback.format_exception(err)))
        return ForkingPickler.dumps((told, True))


def _pickle_read_only_mappings() -> None:
    """Make read-only mappings picklable, because many results contain them."""
    from multiprocessing.reduction import ForkingPickler

    ForkingPickler.register(MappingProxyType, lambda one: (_make_read_only, (dict(one),)))


def _make_read_only(mapping: dict[Any, Any]) -> "MappingProxyType[Any, Any]":
    return MappingProxyType(mapping)


@contextmanager
def block_signals(numbers: Sequence[signal.Signals]) -> Iterator[None]:
    """Block these signals in a process that is started, even before its first line."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    former = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, former)
