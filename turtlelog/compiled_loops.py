"""Whether compiled loops are worth loading; everything works without them."""

from functools import cached_property
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from threading import Lock
from typing import Any


class CompiledLoops:
    """A module of loops that numba compiles, loaded once they would have saved what they cost.

    So no process takes more than twice as long as if it had known before how much it has to do.
    """

    def __init__(self, module: str, *, cost_s: float, first_s: float | None = None) -> None:
        """Take the module and what it costs.

        Args:
            module: Its name.
            cost_s: What numba's import and the loops take from their cache [s].
            first_s: What they take before they are in it [s]; None: hardly more.
        """
        self._module, self._cached_s = module, cost_s
        self._first_s = cost_s if first_s is None else first_s
        self._loading = Lock()
        self._saved_s = 0.0
        self._loops: Any = None

    def expect(self, count: int, saving_s: float) -> Any:
        """Count what is done, or will be, with what the loops save of each [s].

        Returns:
            The compiled loops, None without.
        """
        with self._loading:
            before, self._saved_s = self._saved_s, self._saved_s + count * saving_s
            if before < self.cost_s <= self._saved_s:
                self._loops = self.load()
        return self._loops

    @cached_property
    def cost_s(self) -> float:
        """What the loops take to load [s]: more where the cache beside their module lacks them."""
        found = find_spec(self._module)
        source = Path((found and found.origin) or "")
        try:
            changed_s = source.stat().st_mtime
            kept = [*(source.parent / "__pycache__").glob(f"{source.stem}.*.nbi")]
            is_kept = any(index.stat().st_mtime >= changed_s for index in kept)
        except OSError:
            is_kept = False
        return self._cached_s if is_kept else self._first_s

    def find(self) -> Any:
        """Return the compiled loops where they are loaded, otherwise None."""
        return self._loops

    def load(self) -> Any:
        """Return the compiled loops; None without numba, and where it cannot keep what it compiles.

        Without a place for its cache, beside the module or of the user, numba would compile them
        anew in every process.
        """
        try:
            is_off = import_module("numba").config.DISABLE_JIT
            return None if is_off else import_module(self._module)
        # A numba for another numpy raises ImportError, a cache that cannot be written RuntimeError.
        except (ImportError, RuntimeError, OSError):
            return None
