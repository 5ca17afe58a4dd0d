"""What changed since the last tick; as `simulate.event_watch`."""

from typing import Any

from turtlelog.plants.turtlesim import WORLD_SIZE_M
from turtlelog.simulate.compiled.commands import end_stretch
from turtlelog.simulate.compiled.functions import inline
from turtlelog.simulate.compiled.memory import COMMANDS_DROPPED, POSES_DROPPED, STOP, WALL_HIT


@inline
def _note(state: Any, memory: Any, tick: int, kind: int, first: float, second: float) -> None:
    event = memory.events[state.events]
    event[0], event[1], event[2], event[3] = tick, kind, first, second
    state.events += 1


@inline
def watch(settings: Any, state: Any, memory: Any, tick: int, before: int) -> None:
    """Note what changed since the last tick, when there were `before` samples."""
    for kind in range(len(memory.losses)):
        loss = memory.losses[kind]
        if state.stop_reason:
            end_stretch(loss)
        if loss.finished:
            _note(state, memory, tick, kind, loss.finished_since_ns, loss.finished)
            loss.finished = 0
    if state.hit_wall and not state.was_at_wall:
        _note(state, memory, tick, WALL_HIT, state.x_m, WORLD_SIZE_M - state.down_m)
    state.was_at_wall = state.hit_wall
    if state.samples > before and state.poses_dropped > state.poses_told:
        _note(state, memory, tick, POSES_DROPPED, 0.0, state.poses_dropped - state.poses_told)
        state.poses_told = state.poses_dropped
    if state.commands_dropped > state.commands_told and not settings.is_timed:
        lost = state.commands_dropped - state.commands_told
        _note(state, memory, tick, COMMANDS_DROPPED, -1.0, lost)
    state.commands_told = state.commands_dropped
    if state.stop_reason:
        _note(state, memory, tick, STOP, 0.0, state.stop_reason)
