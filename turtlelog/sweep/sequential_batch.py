"""Rows of the sequential laws around turtlesim."""

from functools import partial

from turtlelog.simulate.compiled.sequential_loop import run_loop
from turtlelog.sweep import batch_kernel

run_rows = partial(batch_kernel.run_rows, run_loop)
