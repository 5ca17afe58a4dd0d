"""The controller: its queue of poses, its timer, its blocking; as `simulate.controller`."""

from typing import Any

import numpy as np

from turtlelog.simulate.compiled.commands import put
from turtlelog.simulate.compiled.fields import NEVER_NS
from turtlelog.simulate.compiled.functions import inline
from turtlelog.simulate.compiled.samples import answer_pose


@inline
def receive(settings: Any, state: Any, memory: Any, tick: int) -> None:
    """Send the pose of a tick on its way, or queue it."""
    if not settings.delays_poses:
        _queue_pose(settings, state, memory, tick)
        return
    arrival_ns = tick * settings.period_ns + settings.sensing_delay_ns
    if settings.sensing_jitter_ns:
        arrival_ns += int(np.rint(settings.sensing_jitter_ns * memory.ticks[tick].sensing_jitter))
    state.pose_arrived_ns = arrival_ns = max(arrival_ns, state.pose_arrived_ns)
    memory.queued[state.arrivals_end].arrivals = tick
    memory.queued[state.arrivals_end].arrival_ns = arrival_ns
    state.arrivals_end += 1


@inline
def _queue_pose(settings: Any, state: Any, memory: Any, tick: int) -> None:
    if tick % settings.loop_period_ticks:
        return
    full = state.poses_end - state.poses_first == settings.loop_pose_queue
    state.poses_dropped += full
    state.poses_first += full
    memory.queued[state.poses_end].poses = tick
    state.poses_end += 1
    if state.waits_for:
        state.waits_for -= 1


@inline
def answer(settings: Any, state: Any, memory: Any, tick: int, decide: Any) -> None:
    """Answer the poses of a tick, and publish what goes out in it."""
    if settings.delays_poses:
        _answer_timed(settings, state, memory, tick, decide)
        return
    if state.waits_for:
        return
    if state.blocked >= 0:
        if tick < state.free_at:
            return
        put(settings, state, memory, tick, state.blocked)
        state.blocked = -1
    _answer_waiting(settings, state, memory, tick, tick * settings.period_ns, decide)


@inline
def _answer_waiting(
    settings: Any, state: Any, memory: Any, tick: int, time_ns: int, decide: Any
) -> None:
    """Answer the poses that wait, until the law blocks or ends."""
    while state.poses_first < state.poses_end:
        pose = memory.queued[state.poses_first].poses
        state.poses_first += 1
        sample = state.samples
        blocks = answer_pose(settings, state, memory, time_ns, pose, decide)
        if state.has_failed:
            return
        if blocks > 0:
            now = time_ns if settings.delays_poses else tick
            state.free_at, state.blocked = now + blocks * settings.block, sample
            return
        put(settings, state, memory, tick, sample)
        if state.stop_reason:
            return


@inline
def _answer_timed(settings: Any, state: Any, memory: Any, tick: int, decide: Any) -> None:
    before_ns = min((tick + 1) * settings.period_ns, settings.end_ns)
    while not (state.stop_reason or state.has_failed):
        now_ns = _find_next_ns(state, memory)
        if now_ns >= before_ns:
            return
        _deliver(settings, state, memory, now_ns)
        if state.blocked >= 0:
            if now_ns < state.free_at:
                continue
            put(settings, state, memory, tick, state.blocked)
            state.blocked = -1
        if not state.waits_for and _is_due(settings, state, memory):
            _answer_waiting(settings, state, memory, tick, now_ns, decide)


@inline
def _find_next_ns(state: Any, memory: Any) -> int:
    """Return the time at which something happens next [ns]."""
    now_ns = state.fires_ns
    if state.arrivals_first < state.arrivals_end:
        now_ns = min(now_ns, memory.queued[state.arrivals_first].arrival_ns)
    return min(now_ns, state.free_at) if state.blocked >= 0 else now_ns  # type: ignore[no-any-return]


@inline
def _is_due(settings: Any, state: Any, memory: Any) -> bool:
    """Whether poses may be answered; where a timer fired, the newest pose is queued."""
    if not settings.timer_ns:
        return True
    if not state.is_due or state.newest < 0:
        return False
    state.is_due = 0
    memory.queued[state.poses_end].poses = state.newest
    state.poses_end += 1
    return True


@inline
def _deliver(settings: Any, state: Any, memory: Any, now_ns: int) -> None:
    """Queue the poses that have arrived by now; mark an answer as due where the timer fires."""
    while (
        state.arrivals_first < state.arrivals_end
        and memory.queued[state.arrivals_first].arrival_ns <= now_ns
    ):
        pose = memory.queued[state.arrivals_first].arrivals
        state.arrivals_first += 1
        if not settings.timer_ns:
            _queue_pose(settings, state, memory, pose)
            continue
        state.newest = pose
        if state.waits_for:
            state.waits_for -= 1
            state.fires_ns = NEVER_NS if state.waits_for else now_ns
    if settings.timer_ns and state.fires_ns == now_ns:
        state.is_due = 1
        state.fires_ns += settings.timer_ns
