"""A robot whose rates follow later and slowly; as `plants.lagged` and its drive."""

import math
from typing import Any

from turtlelog.plants.lagged import LONGEST_PIECE, MOST_TURN_RAD, SETTLED
from turtlelog.simulate.compiled.commands import take
from turtlelog.simulate.compiled.drives import find_push, publish_pose
from turtlelog.simulate.compiled.fields import NEVER_NS
from turtlelog.simulate.compiled.functions import call, inline, least, wrap_angle
from turtlelog.simulate.compiled.memory import SPEED, TURN
from turtlelog.simulate.law_driver import LARGEST_FLOAT

_MOST_PIECES = 2.0**62


@call
def step_lagged(settings: Any, state: Any, memory: Any, tick: int) -> None:
    """Move up to the time of a tick."""
    time_ns = tick * settings.period_ns
    since_ns = time_ns - settings.period_ns
    if settings.newest_only:
        while (
            state.transport_first < state.transport_end
            and memory.queued[state.transport_first].transport_arrival < time_ns
        ):
            arrived = memory.queued[state.transport_first]
            state.transport_first += 1
            _take_command(state, memory, arrived.transport_arrival, arrived.transport)
    else:
        sample = take(settings, state, memory, tick)
        if sample >= 0:
            _take_command(state, memory, since_ns, sample)
    if settings.is_pushed and tick > 0:
        _list_pushes(settings, state, memory, tick, since_ns)
    _advance(state, memory, time_ns)
    speed, turn = memory.axes[SPEED], memory.axes[TURN]
    pose = state.x_m, state.y_m, wrap_angle(state.heading_rad)
    rates = abs(_find_rate(speed)), _find_rate(turn)
    for value in (*pose, *rates):
        if not abs(value) < LARGEST_FLOAT:
            state.has_failed = 1
    publish_pose(settings, state, memory, tick, pose, rates)


@inline
def _take_command(state: Any, memory: Any, time_ns: int, sample: int) -> None:
    """Let a sample's command arrive; both axes read the one queue, each from its own place."""
    entry = memory.queued[state.taken_end]
    entry.taken, entry.taken_ns = sample, time_ns
    state.taken_end += 1
    for axis in memory.axes:
        axis.next_ns = memory.queued[axis.waiting_first].taken_ns + axis.dead_time_ns


@inline
def _list_pushes(settings: Any, state: Any, memory: Any, tick: int, since_ns: int) -> None:
    """Queue the pushes of a step."""
    state.pushes_first = state.pushes_end = 0
    for edge in range(3):
        at_ns = float(since_ns)
        if edge > 0:
            at_ns = settings.push_from_ns if edge == 1 else settings.push_to_ns
            if not since_ns < at_ns < since_ns + settings.period_ns:
                continue
        speed, turn_rate = find_push(settings, memory, tick, int(at_ns))
        if speed != state.pushed_speed or turn_rate != state.pushed_turn_rate:
            state.pushed_speed, state.pushed_turn_rate = speed, turn_rate
            push = memory.pushes[state.pushes_end]
            push.time_ns, push.speed, push.turn_rate = int(at_ns), speed, turn_rate
            state.pushes_end += 1


@inline
def _advance(state: Any, memory: Any, time_ns: int) -> None:
    """Move to a time; what switches at that time has switched."""
    speed, turn = memory.axes[SPEED], memory.axes[TURN]
    while not state.has_failed:
        switch_ns = min(speed.next_ns, turn.next_ns)
        if state.pushes_first < state.pushes_end:
            switch_ns = min(switch_ns, memory.pushes[state.pushes_first].time_ns)
        if switch_ns > time_ns:
            break
        _move_to(state, memory, switch_ns)
        _switch(state, memory, SPEED)
        _switch(state, memory, TURN)
        while (
            state.pushes_first < state.pushes_end
            and memory.pushes[state.pushes_first].time_ns <= state.now_ns
        ):
            push = memory.pushes[state.pushes_first]
            speed.push, turn.push = push.speed, push.turn_rate
            state.pushes_first += 1
    _move_to(state, memory, time_ns)


@inline
def _switch(state: Any, memory: Any, number: int) -> None:
    """Follow the commands whose dead time is over."""
    axis = memory.axes[number]
    while axis.next_ns <= state.now_ns:
        before = axis.target
        sample = memory.samples[memory.queued[axis.waiting_first].taken]
        axis.target = axis.robot_gain * (sample.speed if number == SPEED else sample.turn_rate)
        if axis.robot_lag_s != 0.0:
            axis.transient += before - axis.target
        axis.waiting_first += 1
        axis.next_ns = NEVER_NS
        if axis.waiting_first < state.taken_end:
            axis.next_ns = memory.queued[axis.waiting_first].taken_ns + axis.dead_time_ns


@call
def _move_to(state: Any, memory: Any, time_ns: int) -> None:
    left_s = (time_ns - state.now_ns) / 1e9
    if left_s <= 0.0:
        return
    speed, turn = memory.axes[SPEED], memory.axes[TURN]
    turn_limit = MOST_TURN_RAD / left_s
    while True:
        is_straight = _is_settled(turn) and turn.target + turn.push == 0.0
        is_spin = _is_settled(speed) and speed.target + speed.push == 0.0
        if is_straight or is_spin or (_is_settled(speed) and _is_settled(turn)):
            _move_along_arc(state, speed, turn, left_s)
            break
        pace = least(abs(turn.target + turn.push) + abs(turn.transient), turn_limit)
        if not _is_settled(speed):
            pace += 1.0 / speed.robot_lag_s
        if not _is_settled(turn):
            pace += 1.0 / turn.robot_lag_s
        wanted = left_s * pace / LONGEST_PIECE
        if not wanted < _MOST_PIECES:
            state.has_failed = 1
            break
        pieces = int(wanted) + 1
        _move_by_quadrature(state, memory, speed, turn, left_s / pieces)
        if pieces == 1:
            break
        left_s -= left_s / pieces
    state.now_ns = time_ns


@inline
def _move_along_arc(state: Any, speed: Any, turn: Any, duration_s: float) -> None:
    way_m = _let_pass(speed, duration_s)
    half_rad = 0.5 * _let_pass(turn, duration_s)
    chord_m = way_m * (math.sin(half_rad) / half_rad) if half_rad != 0.0 else way_m
    middle_rad = state.heading_rad + half_rad
    state.x_m += chord_m * math.cos(middle_rad)
    state.y_m += chord_m * math.sin(middle_rad)
    state.heading_rad = wrap_angle(state.heading_rad + 2.0 * half_rad)


@inline
def _move_by_quadrature(state: Any, memory: Any, speed: Any, turn: Any, duration_s: float) -> None:
    x_m = y_m = 0.0
    for row in range(len(memory.gauss)):
        time_s = memory.gauss[row, 0] * duration_s
        heading_rad = state.heading_rad + _integrate(turn, time_s)
        rate = speed.target + speed.push
        if speed.transient != 0.0:
            rate += speed.transient * math.exp(-time_s / speed.robot_lag_s)
        way_m = memory.gauss[row, 1] * rate
        x_m += way_m * math.cos(heading_rad)
        y_m += way_m * math.sin(heading_rad)
    state.x_m += duration_s * x_m
    state.y_m += duration_s * y_m
    _let_pass(speed, duration_s)
    state.heading_rad = wrap_angle(state.heading_rad + _let_pass(turn, duration_s))


@inline
def _find_rate(axis: Any) -> float:
    return axis.target + axis.transient + axis.push  # type: ignore[no-any-return]


@inline
def _is_settled(axis: Any) -> bool:
    return abs(axis.transient) * axis.robot_lag_s <= SETTLED  # type: ignore[no-any-return]


@inline
def _integrate(axis: Any, time_s: float) -> float:
    """Return the way, or turn, within a time without a switch."""
    constant = axis.target + axis.push
    if axis.transient == 0.0:
        return constant * time_s  # type: ignore[no-any-return]
    faded = -math.expm1(-time_s / axis.robot_lag_s)
    return constant * time_s + axis.transient * axis.robot_lag_s * faded  # type: ignore[no-any-return]


@inline
def _let_pass(axis: Any, time_s: float) -> float:
    """Let a time pass; return the way, or turn, within it."""
    way = _integrate(axis, time_s)
    if axis.transient != 0.0:
        axis.transient *= math.exp(-time_s / axis.robot_lag_s)
    return way  # type: ignore[no-any-return]
