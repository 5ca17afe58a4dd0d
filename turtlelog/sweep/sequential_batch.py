"""Rows of the sequential laws around turtlesim."""

from typing import Any

from numba import njit

from turtlelog.compiled_loops import sum_up_sources
from turtlelog.simulate.compiled import sequential_loop
from turtlelog.simulate.compiled.sequential_loop import run_loop
from turtlelog.sweep import batch_kernel
from turtlelog.sweep.batch_kernel import run_rows_by

SOURCES = (sequential_loop, *sequential_loop.SOURCES, batch_kernel, *batch_kernel.SOURCES)
"""Whose code and constants stand in the machine code."""


def _build(stamp: int) -> Any:
    """Return the compiled function, whose cache knows the code that it was compiled with."""

    @njit(nogil=True, cache=True, error_model="numpy")
    def run_rows(begun: Any, axes: Any, memory: Any, scratch: Any, entries: Any) -> int:
        """Simulate and measure rows."""
        run_rows_by(run_loop, (begun, axes, memory), scratch, entries)
        return stamp

    return run_rows


run_rows = _build(sum_up_sources(*SOURCES))
