"""Any plant and law that is compiled: chosen by numbers of the scenario, step by step."""

from typing import Any

from numba import njit

from turtlelog.compiled_loops import sum_up_sources
from turtlelog.plants import lagged as plant
from turtlelog.simulate.compiled import lagged, loop, sequential, turtle
from turtlelog.simulate.compiled.functions import inline
from turtlelog.simulate.compiled.lagged import step_lagged
from turtlelog.simulate.compiled.loop import SIGNATURE, simulate
from turtlelog.simulate.compiled.sequential import decide_sequential
from turtlelog.simulate.compiled.turtle import step_turtle

SOURCES = (*loop.SOURCES, loop, lagged, plant, sequential, turtle)
"""Whose code and constants stand in the machine code."""


@inline
def _step(settings: Any, state: Any, memory: Any, tick: int) -> None:
    if settings.is_lagged:
        step_lagged(settings, state, memory, tick)
    else:
        step_turtle(settings, state, memory, tick)


def _build(stamp: int) -> Any:
    """Return the loop, whose cache knows the code that it was compiled with."""

    @njit(SIGNATURE, nogil=True, cache=True, error_model="numpy", _nrt=False)
    def run_loop(all_settings: Any, states: Any, memory: Any) -> int:
        """Simulate a scenario."""
        simulate(all_settings[0], states[0], memory, _step, decide_sequential)
        return stamp

    return run_loop


run_loop = _build(sum_up_sources(*SOURCES))
