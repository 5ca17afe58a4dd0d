"""Decision whether to load compiled code. Everything also works without this code."""

import gc
import math
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from functools import cached_property
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from threading import Event, Lock
from typing import Any, Final

COMPILING: Final = Event()
"""Set during compilation, which takes seconds once, so that a progress bar can show this."""


class CompiledCode:
    """Compiled code, loaded as soon as the expected work justifies its cost.

    With this rule, no process takes more than twice as long as with perfect knowledge of its work.

    Attributes:
        problem: Reason why the code could not be compiled or is no longer used; None if it can be
            used.
    """

    def __init__(
        self,
        load: Callable[[], Any],
        is_kept: Callable[[], bool],
        *,
        cost_s: float,
        first_s: float | None = None,
        beside: Sequence[str] = (),
    ) -> None:
        """Store the loader of the code and its cost.

        Args:
            load: Function that returns the code. The function may raise ImportError, RuntimeError,
                and errors of numba.
            is_kept: Function that returns whether numba's cache contains the code.
            cost_s: Time to import numba and load the code from its cache [s].
            first_s: Time if the code is not in the cache [s]; None: hardly more.
            beside: Functions that compile parts of the code, as `module:function`, each called in a
                process; `load` calls them by `call_beside`.
        """
        self._load, self._is_kept, self._cached_s = load, is_kept, cost_s
        self._first_s = cost_s if first_s is None else first_s
        self._beside = beside
        self._loading = Lock()
        self._saved_s = 0.0
        self._loops: Any = None
        self.problem: str | None = None

    def expect(self, count: int, saving_s: float) -> Any:
        """Add expected work: a number of items, and the time that the code saves on each [s].

        Returns:
            The code as soon as the total work is worth loading it, otherwise None.
        """
        with self._loading:
            before, self._saved_s = self._saved_s, self._saved_s + count * saving_s
            is_little = self._saved_s < self._cached_s  # the cache is not searched then
            if not is_little and before < self.cost_s <= self._saved_s:
                self._loops = self.load()
        return self._loops

    @cached_property
    def cost_s(self) -> float:
        """Time to load the code [s]: more if parts are not in numba's cache, inf without numba."""
        if find_spec("numba") is None:
            return math.inf
        return self._cached_s if self._is_kept() else self._first_s

    def find(self) -> Any:
        """Return the code if it is loaded, else None."""
        return self._loops

    def give_up(self, problem: str) -> None:
        """Stop using the code."""
        with self._loading:
            self._loops, self.problem = None, problem

    def load(self) -> Any:
        """Return the code; None without numba, or if numba cannot store compiled code.

        Without a writable folder for its cache, numba would compile again in every process.
        """
        try:
            if import_module("numba").config.DISABLE_JIT:
                return None
            with ExitStack() as processes:
                if not self._is_kept():
                    COMPILING.set()
                    if gc.isenabled():  # saves 10 %: numba creates millions of permanent objects
                        gc.disable()
                        processes.callback(gc.enable)
                    _start(self._beside, processes)
                return self._load()
        # numba for another numpy raises ImportError, a read-only cache RuntimeError.
        except (ImportError, RuntimeError, OSError):
            return None
        except Exception as err:
            self.problem = str(err)
            return None
        finally:
            COMPILING.clear()


_BESIDE: Final[dict[str, Any]] = {}
"""Processes that compile what a function returns, by `module:function`."""

_CALL: Final = (
    "import gc, sys; gc.disable(); sys.path[:] = sys.argv[2:];"
    " from pkgutil import resolve_name; resolve_name(sys.argv[1])()"
)


def _start(functions: Sequence[str], processes: ExitStack) -> None:
    """Compile what functions return into numba's cache, each in a process, and wait for them."""
    import subprocess  # most commands do not need it

    for function in functions:
        # If a process does not start or fails, the function compiles when it is called here.
        with suppress(OSError, ValueError):
            command = [sys.executable, "-c", _CALL, function, *sys.path]
            nowhere = subprocess.DEVNULL
            _BESIDE[function] = processes.enter_context(
                subprocess.Popen(command, stdin=nowhere, stdout=nowhere, stderr=nowhere)
            )


def call_beside(function: str) -> Any:
    """Return what a function compiles, after the end of the process that compiles it, if any."""
    from pkgutil import resolve_name

    if (process := _BESIDE.pop(function, None)) is not None:
        process.wait()
    return resolve_name(function)()


def is_kept(module: str, function: str = "") -> bool:
    """Return whether numba's cache has the code of a module or of a function, without loading it.

    Code older than a file in the module's folder may need to be compiled again, unless the name of
    the function is given, which contains the stamp.
    """
    source = _find_source(module)
    python = f"py{sys.version_info.major}{sys.version_info.minor}"
    try:
        files = [source] if function else source.parent.glob("*.py")
        changed_s = max(file.stat().st_mtime for file in files)
        return any(
            index.stat().st_mtime >= changed_s
            for folder in _list_cache_folders(source)
            for index in folder.glob(f"{source.stem}.{function}*.{python}*.nbi")
        )
    except OSError:
        return False


def remove_others(module: str, function: str, kept: str) -> None:
    """Remove versions of a function from numba's cache, except the one whose name has `kept`."""
    source = _find_source(module)
    for folder in _list_cache_folders(source):
        with suppress(OSError):
            for file in folder.glob(f"{source.stem}.{function}_*.nb?"):
                if kept not in file.name:
                    file.unlink(missing_ok=True)


def _find_source(module: str) -> Path:
    found = find_spec(module)
    return Path((found and found.origin) or "").absolute()


def _list_cache_folders(source: Path) -> list[Path]:
    """Return the folders in which numba stores compiled code of a module, without loading it.

    The folder is NUMBA_CACHE_DIR if set, or else the module's folder. If that is not writable, it
    is the user's cache, whose place is unknown here on Windows and macOS.
    """
    from hashlib import sha1  # most commands do not need it

    hashed = sha1(str(source.parent).encode(), usedforsecurity=False).hexdigest()
    name = f"{source.parent.name}_{hashed}"
    if folder := os.environ.get("NUMBA_CACHE_DIR"):
        return [Path(folder) / name]
    of_user = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    return [source.parent / "__pycache__", of_user / "numba" / name]
