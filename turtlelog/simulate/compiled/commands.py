"""Commands on their way: transport, then the plant's queue; as `simulate.transport`."""

from typing import Any

import numpy as np

from turtlelog.simulate.compiled.functions import inline
from turtlelog.simulate.compiled.memory import COMMANDS_DROPPED, COMMANDS_LOST


@inline
def count_lost(loss: Any, time_ns: int) -> None:
    """Count a pose or command that is lost at a time [ns], in a stretch of such."""
    if loss.count == 0:
        loss.since_ns = time_ns
    loss.count += 1


@inline
def end_stretch(loss: Any) -> None:
    """End a stretch of losses, as something came through; stretches of a tick become one event."""
    if loss.count == 0:
        return
    if loss.finished == 0:
        loss.finished_since_ns = loss.since_ns
    loss.finished += loss.count
    loss.count = 0


@inline
def put(settings: Any, state: Any, memory: Any, tick: int, sample: int) -> None:
    """Publish a sample's command."""
    published_ns = memory.samples[sample].published_ns
    memory.samples[state.commands].published = sample
    state.commands += 1
    arrival = tick + settings.loop_transport_delay_ticks
    repeats = False
    if settings.is_timed:
        if settings.loop_loss_probability and (
            memory.samples[sample].loss < settings.loop_loss_probability
        ):
            count_lost(memory.losses[COMMANDS_LOST], published_ns)
            return
        end_stretch(memory.losses[COMMANDS_LOST])
        arrival = published_ns + settings.transport_ns
        if settings.transport_jitter_ns:
            arrival += int(
                np.rint(settings.transport_jitter_ns * memory.samples[sample].transport_jitter)
            )
        if settings.loop_late_probability and (
            memory.samples[sample].late < settings.loop_late_probability
        ):
            arrival += settings.late_ns
        state.command_arrived_ns = arrival = max(arrival, state.command_arrived_ns)
        repeats = bool(settings.loop_repeat_probability) and (
            memory.samples[sample].repeat < settings.loop_repeat_probability
        )
    elif settings.loop_transport_delay_ticks == 0:
        _append(settings, state, memory, sample)
        return
    for _ in range(2 if repeats else 1):
        memory.queued[state.transport_end].transport = sample
        memory.queued[state.transport_end].transport_arrival = arrival
        state.transport_end += 1


@inline
def _append(settings: Any, state: Any, memory: Any, sample: int) -> bool:
    """Queue a command; return whether it pushes one out that the plant would have taken."""
    full = state.queue_end - state.queue_first == settings.loop_command_queue
    state.queue_first += full
    memory.queued[state.queue_end].queue = sample
    state.queue_end += 1
    drops = full and not settings.newest_only
    state.commands_dropped += drops
    return drops


@inline
def take(settings: Any, state: Any, memory: Any, tick: int) -> int:
    """Return the sample whose command a step begins with, -1 where none has arrived."""
    until = tick * settings.period_ns + settings.causal_ns if settings.is_timed else tick
    while (
        state.transport_first < state.transport_end
        and memory.queued[state.transport_first].transport_arrival < until
    ):
        first = state.transport_first
        state.transport_first += 1
        if _append(settings, state, memory, memory.queued[first].transport) and settings.is_timed:
            count_lost(memory.losses[COMMANDS_DROPPED], memory.queued[first].transport_arrival)
    count = state.queue_end - state.queue_first
    if count < settings.loop_command_queue:
        end_stretch(memory.losses[COMMANDS_DROPPED])
    if count == 0:
        return -1
    if settings.newest_only:
        state.queue_first = state.queue_end
        return memory.queued[state.queue_end - 1].queue  # type: ignore[no-any-return]
    state.queue_first += 1
    return memory.queued[state.queue_first - 1].queue  # type: ignore[no-any-return]
