"""Any plant and law that is compiled: chosen by numbers of the scenario, step by step."""

from typing import Any

from numba import njit

from turtlelog import path_pieces, paths as path
from turtlelog.compiled_loops import sum_up_sources
from turtlelog.laws import posture as posture_law
from turtlelog.plants import lagged as plant
from turtlelog.simulate.compiled import (
    lagged,
    law_fields,
    loop,
    open_loop,
    path_tracking,
    paths,
    posture,
    sequential,
    signature,
    turtle,
)
from turtlelog.simulate.compiled.functions import inline
from turtlelog.simulate.compiled.lagged import step_lagged
from turtlelog.simulate.compiled.law_fields import OPEN_LOOP, POSTURE, SEQUENTIAL
from turtlelog.simulate.compiled.loop import simulate
from turtlelog.simulate.compiled.open_loop import decide_open_loop
from turtlelog.simulate.compiled.path_tracking import decide_tracking
from turtlelog.simulate.compiled.posture import decide_posture
from turtlelog.simulate.compiled.sequential import decide_sequential
from turtlelog.simulate.compiled.turtle import step_turtle

SOURCES = (
    *(*loop.SOURCES, loop, lagged, plant, law_fields, open_loop, path_tracking, paths),
    *(path, path_pieces, posture, posture_law, sequential, turtle),
)
"""Whose code and constants stand in the machine code."""


@inline
def _step(settings: Any, state: Any, memory: Any, tick: int) -> None:
    if settings.is_lagged:
        step_lagged(settings, state, memory, tick)
    else:
        step_turtle(settings, state, memory, tick)


@inline
def _decide(
    settings: Any,
    state: Any,
    memory: Any,
    sample: Any,
    time_ns: int,
    pose: tuple[float, float, float],
) -> tuple[int, float, float]:
    if settings.law == SEQUENTIAL:
        return decide_sequential(settings, state, memory, sample, time_ns, pose)  # type: ignore[no-any-return]
    if settings.law == POSTURE:
        return decide_posture(settings, state, sample, time_ns, pose)  # type: ignore[no-any-return]
    if settings.law == OPEN_LOOP:
        return decide_open_loop(settings, state, memory, sample, time_ns)  # type: ignore[no-any-return]
    return decide_tracking(settings, state, memory, sample, time_ns, pose)  # type: ignore[no-any-return]


def _build(stamp: int) -> Any:
    """Return the loop, whose cache knows the code that it was compiled with."""

    @njit(signature.LOOP, nogil=True, cache=True, error_model="numpy", _nrt=False)
    def run_loop(all_settings: Any, states: Any, memory: Any) -> int:
        """Simulate a scenario."""
        simulate(all_settings[0], states[0], memory, _step, _decide)
        return stamp

    return run_loop


run_loop = _build(sum_up_sources(*SOURCES))
