"""Whether the compiled loops of `kernels` are worth loading; everything works without them."""

from importlib import import_module
from threading import Lock
from typing import Any, Final

COST_S: Final = 0.7
"""What numba's import and the loops take from their cache [s]; some 2.5 s before they are in it."""

WALKED_S: Final = 1e-7
"""What they save of a message that no index names [s]: 0.9e-7 in chunks, 1.6e-7 without."""

INDEXED_S: Final = 4e-8
"""What they save of a message that an index names [s]: of a million some 30 ms, of our own 40."""

_loading = Lock()
_saved_s = 0.0
_kernels: Any = None


def expect(messages: int, saving_s: float) -> Any:
    """Count messages that are read, or will be; return the compiled loops, None without.

    They are loaded once they would have saved what they cost. So no process takes more than twice
    as long as if it had known before how much it reads.
    """
    global _saved_s, _kernels
    with _loading:
        before, _saved_s = _saved_s, _saved_s + messages * saving_s
        if before < COST_S <= _saved_s:
            _kernels = load_kernels()
    return _kernels


def find_kernels() -> Any:
    """Return the compiled loops where they are loaded, otherwise None."""
    return _kernels


def load_kernels() -> Any:
    """Return the compiled loops; None without numba, and where it cannot keep what it compiles.

    Their module is `kernels`. Without a place for its cache, beside it or of the user, numba would
    compile them anew in every process.
    """
    try:
        is_off = import_module("numba").config.DISABLE_JIT
        return None if is_off else import_module("turtlelog.log.engine.kernels")
    # A numba for another numpy raises ImportError, a cache that cannot be written RuntimeError.
    except (ImportError, RuntimeError, OSError):
        return None
