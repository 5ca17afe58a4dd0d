"""Reading by the compiled loops, or without."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from turtlelog.log.engine.load_kernels import KERNELS


@contextmanager
def use_kernels(kernels: Any) -> Iterator[None]:
    """Read by these loops, without any where None."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(KERNELS, "_loops", kernels)
        # From here on nothing is worth loading.
        patch.setattr(KERNELS, "_saved_s", 1e9)
        yield


def load_kernels() -> Any:
    """Return the compiled loops; skips where numba is not installed."""
    pytest.importorskip("numba")
    kernels = KERNELS.load()
    assert kernels is not None
    return kernels
