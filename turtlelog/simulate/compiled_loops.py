"""Whether compiled code is worth loading; everything works without it."""

import gc
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import cached_property
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from threading import Event, Lock
from typing import Any, Final

COMPILING: Final = Event()
"""Set while loops compile, which takes seconds once: a bar that stands still may say why."""


class CompiledLoops:
    """Compiled code, loaded once it would have saved what it costs.

    So no process takes more than twice as long as if it had known before how much it has to do.

    Attributes:
        problem: Why it could not be compiled, or is not used any more; None where neither is so.
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
        """Take what loads the code and what it costs.

        Args:
            load: Returns the code. It may raise ImportError or RuntimeError, and what numba raises.
            is_kept: Whether numba's cache has it.
            cost_s: What numba's import and the code take from its cache [s].
            first_s: What they take before it is in it [s]; None: hardly more.
            beside: Modules that compile what it needs when they are imported, each in a process;
                `load` takes them by `import_beside`.
        """
        self._load, self._is_kept, self._cached_s = load, is_kept, cost_s
        self._first_s = cost_s if first_s is None else first_s
        self._beside = beside
        self._loading = Lock()
        self._saved_s = 0.0
        self._loops: Any = None
        self.problem: str | None = None

    def expect(self, count: int, saving_s: float) -> Any:
        """Add work that is done or will be: so many items, and what the code saves of each [s].

        Returns:
            The code once all work together is worth loading it, otherwise None.
        """
        with self._loading:
            before, self._saved_s = self._saved_s, self._saved_s + count * saving_s
            is_little = self._saved_s < self._cached_s  # nobody looks for a cache then
            if not is_little and before < self.cost_s <= self._saved_s:
                self._loops = self.load()
        return self._loops

    @cached_property
    def cost_s(self) -> float:
        """What the code takes to load [s]: more where numba's cache lacks any of it."""
        return self._cached_s if self._is_kept() else self._first_s

    def find(self) -> Any:
        """Return the code where it is loaded, otherwise None."""
        return self._loops

    def give_up(self, problem: str) -> None:
        """Use the code no more."""
        with self._loading:
            self._loops, self.problem = None, problem

    def load(self) -> Any:
        """Return the code; None without numba, and where it cannot keep what it compiles.

        Without a place for its cache, beside the module or of the user, numba would compile anew in
        every process.
        """
        try:
            if import_module("numba").config.DISABLE_JIT:
                return None
            with ExitStack() as processes:
                if not self._is_kept():
                    COMPILING.set()
                    processes.enter_context(_pause_garbage_collection())
                    _start(self._beside, processes)
                return self._load()
        # A numba for another numpy raises ImportError, a cache that cannot be written RuntimeError.
        except (ImportError, RuntimeError, OSError):
            return None
        except Exception as err:
            self.problem = str(err)
            return None
        finally:
            COMPILING.clear()


@contextmanager
def _pause_garbage_collection() -> Iterator[None]:
    """Look for no garbage: numba makes millions of objects that stay; a tenth less time."""
    if not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


_BESIDE: Final[dict[str, Any]] = {}
"""The processes that compile a module, by its name."""

_IMPORT: Final = "import sys; sys.path[:] = sys.argv[2:]; __import__(sys.argv[1])"


def _start(modules: Sequence[str], processes: ExitStack) -> None:
    """Compile what modules have into numba's cache, each in a process that is waited for."""
    import subprocess  # most commands never come here

    for module in modules:
        # Where no process starts, or one fails, the module compiles where it is imported.
        with suppress(OSError, ValueError):
            command = [sys.executable, "-c", _IMPORT, module, *sys.path]
            nowhere = subprocess.DEVNULL
            _BESIDE[module] = processes.enter_context(
                subprocess.Popen(command, stdin=nowhere, stdout=nowhere, stderr=nowhere)
            )


def import_beside(module: str) -> Any:
    """Return a module, once the process that compiles what it has is done, if there is one."""
    if (process := _BESIDE.pop(module, None)) is not None:
        process.wait()
    return import_module(module)


def is_kept(module: str, function: str = "") -> bool:
    """Whether numba's cache has what a module compiles, or a function of it, without loading it.

    What is older than a file beside the module may have to be compiled again.

    Args:
        module: Its name.
        function: Its name, which tells by itself what it was compiled of; empty: any.
    """
    found = find_spec(module)
    source = Path((found and found.origin) or "").absolute()
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
    """Remove what numba's cache has of older versions of a function.

    Args:
        module: Its name.
        function: How the name begins of it and of its older versions.
        kept: Its name.
    """
    found = find_spec(module)
    source = Path((found and found.origin) or "").absolute()
    for folder in _list_cache_folders(source):
        with suppress(OSError):
            for file in folder.glob(f"{source.stem}.{function}_*.nb?"):
                if kept not in file.name:
                    file.unlink(missing_ok=True)


def _list_cache_folders(source: Path) -> list[Path]:
    """Return where numba keeps what it compiles of a module, without loading it.

    In NUMBA_CACHE_DIR; unless that is set beside the module, or, where it cannot write there, in
    the user's cache, which is known here but for Windows and macOS.
    """
    from hashlib import sha1  # most commands never come here

    hashed = sha1(str(source.parent).encode(), usedforsecurity=False).hexdigest()
    name = f"{source.parent.name}_{hashed}"
    if folder := os.environ.get("NUMBA_CACHE_DIR"):
        return [Path(folder) / name]
    of_user = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    return [source.parent / "__pycache__", of_user / "numba" / name]
