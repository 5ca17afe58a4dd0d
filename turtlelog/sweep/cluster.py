"""Work on an existing Dask cluster, with the interface of `concurrent.futures`."""

import logging
import re
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager, suppress
from typing import Any, Final, TypeVar

from turtlelog.errors import ProcessError, describe_error, make_portable
from turtlelog.libraries import __version__, load_library
from turtlelog.processes import Watched

T = TypeVar("T")

_CONNECT_S: Final = 3.0  # time limit for answers [s]: a wrong address gives an error within 10 s

_SILENT_S: Final = 30.0
"""Time from which a silent scheduler counts as gone [s]; a busy one answers in 1 s."""

_EXAMPLE: Final = "tcp://host:8786"

_ADDRESS: Final = re.compile(r"(?:[a-z]+://)?(?:\[[0-9A-Fa-f:.]+\]|[^\s/:@\[\]]+):([0-9]{1,5})")
"""Address of a scheduler: an optional scheme, a host or IPv6 address, and a port."""


@contextmanager
def connect_cluster(address: str) -> Iterator[Executor]:
    """Connect to a Dask scheduler such as `tcp://host:8786` and yield an executor.

    If a worker ends, other workers repeat its work. Workers with another version of turtlelog get
    no work, even if they join later.

    Raises:
        LibraryError: If dask.distributed is not installed.
        ProcessError: If the address is invalid, no scheduler or worker answers, a worker has
            another version of turtlelog, or the scheduler ends before the work.
    """
    _require_address(address)
    distributed = load_library("distributed")
    # Relevant errors are raised and printed in one line; a client would log even after its end.
    for handler in logging.getLogger("distributed").handlers:
        handler.setLevel(logging.CRITICAL + 1)
    client = _connect(distributed, address)
    cluster = _Cluster(client, address)
    try:
        cluster.require_workers()
        try:
            yield cluster
        except ProcessError:
            if not cluster.is_gone:
                cluster.require_workers()  # includes workers that joined later, by name
            raise
    finally:
        with suppress(OSError):  # there is no answer any more
            client.close(timeout=2)


def _require_address(address: str) -> None:
    """Refuse an invalid address before Dask is loaded. The message contains no password."""
    secrets, _, place = address.rpartition("@")
    scheme, mark, _ = secrets.partition("://")
    shown = re.split(r"[?#]", f"{scheme}{mark}{place}" if mark and scheme.isalpha() else place)[0]
    found = _ADDRESS.fullmatch(shown)
    if found is None or not 0 < int(found[1]) < 2**16:
        raise ProcessError(
            f"--scheduler {shown or repr(shown)}: this is not the address of a Dask scheduler;"
            f" type one such as {_EXAMPLE}"
        )
    if shown != address:
        raise ProcessError(
            f"--scheduler {shown}: the address of a Dask scheduler has no user, password or"
            " query; type it without them"
        )


class _Cluster(Executor, Watched):
    """Executor on workers. A worker refuses work if its version of turtlelog differs.

    `is_gone` tells whether the scheduler has ended or was replaced at its address.
    """

    def __init__(self, client: Any, address: str) -> None:
        self.is_gone = False
        self._client, self._address = client, address
        self._executor = client.get_executor(pure=False)
        self._identity = self._ask_identity()

    def submit(self, work: Callable[..., T], /, *args: Any, **kwargs: Any) -> "Future[T]":
        try:
            found: Future[T] = self._executor.submit(_work_as, __version__, work, *args, **kwargs)
        except Exception:
            self.require_alive()
            raise
        return found

    def require_alive(self) -> None:
        """Raise ProcessError instead of waiting for a scheduler that has ended."""
        if self._client.status != "running" or self._ask_identity() != self._identity:
            raise self._describe_end()

    def require_workers(self) -> None:
        """Refuse a cluster without workers or with a worker of another version."""
        try:
            self._client.wait_for_workers(1, timeout=_CONNECT_S)
            # As text, because a worker without turtlelog could not unpickle a function of
            # turtlelog.
            ask = "__import__('turtlelog.libraries').libraries.__version__"
            versions = self._client.run(eval, ask, on_error="return")
        except TimeoutError as err:
            raise ProcessError(
                f"--scheduler {self._address}: the scheduler has no worker after {_CONNECT_S:g} s;"
                f" start one: dask worker {self._address}"
            ) from err
        except OSError as err:
            raise self._describe_end() from err
        for worker, found in versions.items():
            if found != __version__:
                told = found if isinstance(found, str) else describe_error(found)
                raise ProcessError(
                    f"{self._address}: expected turtlelog {__version__} on every worker,"
                    f" found {told} on {worker}"
                )

    def _ask_identity(self) -> str | None:
        """Return the scheduler's own id; None if the scheduler does not answer."""
        ask = self._client.scheduler.identity
        try:
            return str(self._client.sync(ask, callback_timeout=_SILENT_S)["id"])
        except (OSError, RuntimeError):
            return None

    def _describe_end(self) -> ProcessError:
        self.is_gone = True
        return ProcessError(
            f"--scheduler {self._address}: the Dask scheduler ended before the work was done; start"
            " it and repeat the command, which continues a table that was begun"
        )


def _work_as(version: str, work: Callable[..., T], *args: Any, **kwargs: Any) -> T:
    """Do work on a worker, or refuse the work if the worker's version of turtlelog differs."""
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
    class Client(distributed.Client):  # type: ignore[misc]
        def start(self, **options: Any) -> None:
            """Connect within a time limit, and clean up if that fails: nothing blocks the exit."""
            try:
                # Without this limit it would wait for ever for a server that is not a scheduler.
                super().start(callback_timeout=2 * _CONNECT_S, **options)
            except BaseException:
                with suppress(Exception):
                    self.close(timeout=1)
                raise

    try:
        return Client(address, timeout=_CONNECT_S, set_as_default=False)
    except OSError as err:
        raise ProcessError(
            f"--scheduler {address}: no Dask scheduler answers within {_CONNECT_S:g} s; start one"
            f" (dask scheduler), or type its address, such as {_EXAMPLE}"
        ) from err
    except Exception as err:
        raise ProcessError(
            f"--scheduler {address}: Dask cannot use this address ({describe_error(err)});"
            f" type one such as {_EXAMPLE}"
        ) from err
