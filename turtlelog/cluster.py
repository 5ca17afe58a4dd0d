"""Work on a Dask cluster that is there already, handed out as `concurrent.futures` does."""

import logging
import socket
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from typing import Any, Final, TypeVar

from turtlelog.errors import ProcessError, describe_error, make_portable
from turtlelog.libraries import load_library
from turtlelog.version import __version__

T = TypeVar("T")

_CONNECT_S: Final = 3.0
"""To hear of a scheduler, to connect to it, and for a worker [s]: who mistyped an address is told
within 10 s."""


@contextmanager
def connect_cluster(address: str) -> Iterator[Executor]:
    """Connect to a Dask scheduler, as in `tcp://host:8786`; yield what takes work.

    What a worker that ends had done or was doing is done again by others. One with another
    turtlelog does nothing, also where it joins later.

    Raises:
        LibraryError: Where dask.distributed is not installed.
        ProcessError: Where no scheduler or no worker answers, or one has another turtlelog.
    """
    distributed = load_library("distributed")
    # What matters is raised, and said in one line; a client goes on logging after its end.
    for handler in logging.getLogger("distributed").handlers:
        handler.setLevel(logging.CRITICAL + 1)
    client = _connect(distributed, address)
    try:
        _require_same_version(client, address)
        try:
            yield _SameVersion(client.get_executor(pure=False))
        except Exception:
            _require_same_version(client, address)  # of a worker that came later, by its name
            raise
    finally:
        client.close(timeout=2)


class _SameVersion(Executor):
    """Hands work to workers, which refuse it where they have another turtlelog."""

    def __init__(self, executor: Any) -> None:
        self._executor = executor

    def submit(self, work: Callable[..., T], /, *args: Any, **kwargs: Any) -> "Future[T]":
        found: Future[T] = self._executor.submit(_work_as, __version__, work, *args, **kwargs)
        return found


def _work_as(version: str, work: Callable[..., T], *args: Any, **kwargs: Any) -> T:
    """Work, on a worker, for a turtlelog of the same version."""
    if version != __version__:
        raise ProcessError(
            f"expected turtlelog {version} on every worker, found {__version__} on one"
        )
    try:
        return work(*args, **kwargs)
    except Exception as err:
        told = make_portable(err)
        raise told from (None if told is err else err)


def _connect(distributed: Any, address: str) -> Any:
    try:
        _hear(address)
        return distributed.Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as err:
        raise ProcessError(
            f"{address}: expected a Dask scheduler, as in tcp://host:8786, found none that answers"
            f" within {_CONNECT_S:g} s"
        ) from err


def _hear(address: str) -> None:
    """Wait until a scheduler speaks, as it does first; a client waits without end for who does not.

    Raises:
        OSError: Where nobody is there, or is silent, as the port of a web page is.
    """
    scheme, mark, place = address.rpartition("://")
    host, colon, port = place.rpartition(":")
    if not colon or (mark and scheme != "tcp"):
        return
    with socket.create_connection((host.strip("[]"), int(port)), _CONNECT_S) as line:
        if not line.recv(1):
            raise ConnectionError("nobody speaks")


def _require_same_version(client: Any, address: str) -> None:
    """Refuse a cluster without workers, or with one whose answers may be others."""
    try:
        client.wait_for_workers(1, timeout=_CONNECT_S)
    except TimeoutError as err:
        raise ProcessError(f"{address}: expected a worker, found none in {_CONNECT_S:g} s") from err
    # By name, because a worker without turtlelog could not unpickle a function of its.
    ask = "__import__('turtlelog.version').version.__version__"
    for worker, found in client.run(eval, ask, on_error="return").items():
        if found != __version__:
            told = found if isinstance(found, str) else describe_error(found)
            raise ProcessError(
                f"{address}: expected turtlelog {__version__} on every worker,"
                f" found {told} on {worker}"
            )
