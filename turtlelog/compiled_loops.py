"""Whether compiled loops are worth loading; everything works without them."""

import os
import sys
import zlib
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from functools import cached_property
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from threading import Event, Lock
from types import ModuleType
from typing import Any, Final


def sum_up_sources(*modules: ModuleType) -> int:
    """Return a checksum of the files of modules.

    Numba compiles again where the file of a function changed. Where its constants stand in others,
    a function that is built around this number is compiled again for these, too.
    """
    total = 0
    for module in modules:
        total = zlib.crc32(Path(str(module.__file__)).read_bytes(), total)
    return total


COMPILING: Final = Event()
"""Set while loops compile, which takes seconds once: a bar that stands still may say why."""


class CompiledLoops:
    """A module of loops that numba compiles, loaded once they would have saved what they cost.

    So no process takes more than twice as long as if it had known before how much it has to do.
    """

    def __init__(
        self,
        module: str,
        *,
        cost_s: float,
        first_s: float | None = None,
        parts: Sequence[str] = (),
    ) -> None:
        """Take the module and what it costs.

        Args:
            module: Its name.
            cost_s: What numba's import and the loops take from their cache [s].
            first_s: What they take before they are in it [s]; None: hardly more.
            parts: Modules whose loops it puts together, where it has none of its own: they compile
                side by side.
        """
        self._module, self._parts, self._cached_s = module, parts or (module,), cost_s
        self._first_s = cost_s if first_s is None else first_s
        self._loading = Lock()
        self._saved_s = 0.0
        self._loops: Any = None

    def expect(self, count: int, saving_s: float) -> Any:
        """Add work that is done or will be: so many items, and what the loops save of each [s].

        Returns:
            The compiled loops once all work together is worth loading them, otherwise None.
        """
        with self._loading:
            before, self._saved_s = self._saved_s, self._saved_s + count * saving_s
            is_little = self._saved_s < self._cached_s  # nobody looks for a cache then
            if not is_little and before < self.cost_s <= self._saved_s:
                self._loops = self.load()
        return self._loops

    @cached_property
    def cost_s(self) -> float:
        """What the loops take to load [s]: more where numba's cache lacks any of them."""
        return self._cached_s if all(map(_is_kept, self._parts)) else self._first_s

    def find(self) -> Any:
        """Return the compiled loops where they are loaded, otherwise None."""
        return self._loops

    def load(self) -> Any:
        """Return the compiled loops; None without numba, and where it cannot keep what it compiles.

        Without a place for its cache, beside the module or of the user, numba would compile them
        anew in every process.
        """
        try:
            if import_module("numba").config.DISABLE_JIT:
                return None
            if lacking := [part for part in self._parts if not _is_kept(part)]:
                COMPILING.set()
                _compile(lacking)
            return import_module(self._module)
        # A numba for another numpy raises ImportError, a cache that cannot be written RuntimeError.
        except (ImportError, RuntimeError, OSError):
            return None
        finally:
            COMPILING.clear()


_IMPORT: Final = "import sys; sys.path[:] = sys.argv[2:]; __import__(sys.argv[1])"


def _compile(modules: Sequence[str]) -> None:
    """Compile the loops of modules into numba's cache: the first here, each other in a process."""
    import subprocess  # most commands never come here

    with ExitStack() as processes:
        for module in modules[1:]:
            # Where no process starts, or one fails, its loops are compiled where they are imported.
            with suppress(OSError, ValueError):
                command = [sys.executable, "-c", _IMPORT, module, *sys.path]
                nowhere = subprocess.DEVNULL
                processes.enter_context(
                    subprocess.Popen(command, stdin=nowhere, stdout=nowhere, stderr=nowhere)
                )
        for module in modules[:1]:
            import_module(module)


def _is_kept(module: str) -> bool:
    """Whether numba's cache has the loops of a module.

    What is older than a file beside the module may have to be compiled again.
    """
    found = find_spec(module)
    source = Path((found and found.origin) or "").absolute()
    python = f"py{sys.version_info.major}{sys.version_info.minor}"
    try:
        changed_s = max(file.stat().st_mtime for file in source.parent.glob("*.py"))
        return any(
            index.stat().st_mtime >= changed_s
            for folder in _list_cache_folders(source)
            for index in folder.glob(f"{source.stem}.*.{python}*.nbi")
        )
    except OSError:
        return False


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
