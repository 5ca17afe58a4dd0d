"""The sequential laws around turtlesim: what most sweeps ask for, by itself compiled in half."""

from typing import Any

from numba import njit

from turtlelog.compiled_loops import sum_up_sources
from turtlelog.simulate.compiled import loop, sequential, signature, turtle
from turtlelog.simulate.compiled.loop import simulate
from turtlelog.simulate.compiled.sequential import decide_sequential
from turtlelog.simulate.compiled.turtle import step_turtle

SOURCES = (*loop.SOURCES, loop, sequential, turtle)
"""Whose code and constants stand in the machine code."""


def _build(stamp: int) -> Any:
    """Return the loop, whose cache knows the code that it was compiled with."""

    @njit(signature.LOOP, nogil=True, cache=True, error_model="numpy", _nrt=False)
    def run_loop(all_settings: Any, states: Any, memory: Any) -> int:
        """Simulate a scenario."""
        simulate(all_settings[0], states[0], memory, step_turtle, decide_sequential)
        return stamp

    return run_loop


run_loop = _build(sum_up_sources(*SOURCES))
