"""Rows of any law and plant that is compiled."""

from functools import partial

from turtlelog.simulate.compiled.any_loop import run_loop
from turtlelog.sweep import batch_kernel

run_rows = partial(batch_kernel.run_rows, run_loop)
