"""The steps of the loop, tick by tick, around any plant and law; as `simulate.closed_loop`."""

from types import ModuleType
from typing import Any

from turtlelog.plants import turtlesim
from turtlelog.simulate import law_driver
from turtlelog.simulate.compiled import (
    commands,
    controller,
    drives,
    events,
    fields,
    functions,
    memory as arrays,
    samples,
    sensing,
    signature,
)
from turtlelog.simulate.compiled.controller import answer, receive
from turtlelog.simulate.compiled.events import watch
from turtlelog.simulate.compiled.functions import inline
from turtlelog.simulate.compiled.memory import MAX_DURATION
from turtlelog.simulate.compiled.sensing import sense

SOURCES: tuple[ModuleType, ...] = (
    *(commands, controller, drives, events, fields, functions, arrays, samples, sensing),
    *(signature, law_driver, turtlesim),
)
"""Whose code and constants stand in the machine code of every loop."""


@inline
def simulate(settings: Any, state: Any, memory: Any, step: Any, decide: Any) -> None:
    """Simulate a scenario into `memory`; into the state how it ends, and of what how much.

    `step` moves the plant to a tick; `decide` is the law's answer to a pose.
    """
    for tick in range(settings.last_tick + 1):
        step(settings, state, memory, tick)
        if not settings.has_sensor or sense(settings, memory, tick):
            receive(settings, state, memory, tick)
        before = state.samples
        answer(settings, state, memory, tick, decide)
        if state.has_failed:
            return
        if state.stop_reason == 0 and tick == settings.last_tick:
            state.stop_reason = MAX_DURATION
        watch(settings, state, memory, tick, before)
        state.ticks += 1
        if state.stop_reason:
            return
