"""A robot model whose rates follow commands with dead time and time constant, without walls.

Per axis (speed along the heading, turn rate): rate = gain * exp(-dead_time s) / (lag s + 1) of the
commands, each of which holds until the next one. Between two switches a rate is exponential, and
rate, heading and way are known in closed form; the position is the integral of the speed along the
heading, by quadrature. It is right to 1e-9 m, however long a command holds and however small the
time constant is, for a turn of up to 1,000 rad within one move. Whatever happens at a time acts
from that time on: a robot without time constant and dead time has its new rate at the time at which
the command arrives.
"""

import math
from dataclasses import dataclass, field
from typing import Any, Final

from turtlelog.arithmetic import begin_row, called, clip, least, to_float32, to_ns, wrap_angle
from turtlelog.parts import (
    LARGEST_FLOAT,
    LARGEST_M,
    NEVER_NS,
    Offset,
    Period,
    Plant,
    PlantPart,
    Positive,
    Time,
    absent,
)

LAGGED: Final = "lagged"
"""The kind of plant, as scenarios name it."""

LONGEST_PIECE: Final = 2.0
"""Largest turn of a piece of the quadrature [rad], plus its length in time constants. 8 nodes are
then right to rounding, at 4 to 3e-13 of the way, at 8 no longer to 1e-9."""

SETTLED: Final = 1e-15
"""Remaining effect of the transient on position [m] or heading [rad] below which a rate counts as
constant: less than the resolution of a coordinate of 10 m."""

MOST_TURN_RAD: Final = 1000.0
"""Turn within one move that the quadrature follows [rad]; it would take forever with a loop that
runs away."""

_MOST_PIECES: Final = 2.0**62

_GAUSS: Final = (
    (0.019855071751231912, 0.05061426814518853),
    (0.10166676129318664, 0.11119051722668721),
    (0.2372337950418355, 0.15685332293894344),
    (0.4082826787521751, 0.18134189168918083),
    (0.5917173212478248, 0.18134189168918083),
    (0.7627662049581645, 0.15685332293894344),
    (0.8983332387068134, 0.11119051722668721),
    (0.9801449282487681, 0.05061426814518853),
)
"""Nodes and weights of Gauss and Legendre on [0, 1]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LaggedKeys:
    """Parameters of a robot model without walls.

    Per axis its rate is the command that it holds, times a gain, later by a dead time and behind a
    low-pass of first order.

    Attributes:
        period_s: Time between two poses [s]; 0.05 where it is not given.
        speed_gain: Speed that a command of 1 m/s leads to [1]; 1 where it is not given.
        speed_dead_time_s: Time from the arrival of a command until the speed begins to follow [s].
        speed_lag_s: Time constant with which it follows [s]; 0: at once.
        turn_gain: Turn rate that a command of 1 rad/s leads to [1]; 1 where it is not given.
        turn_dead_time_s: Dead time of the turn rate [s].
        turn_lag_s: Time constant of the turn rate [s].
        speed_bound: Largest speed that a command leads to [m/s]; inf, where it is not given: none.
        turn_bound: Largest turn rate likewise [rad/s].
    """

    period_s: Period = 0.05
    speed_gain: Offset = 1.0
    speed_dead_time_s: Time = 0.0
    speed_lag_s: Time = 0.0
    turn_gain: Offset = 1.0
    turn_dead_time_s: Time = 0.0
    turn_lag_s: Time = 0.0
    speed_bound: Positive = absent(math.inf, may_be_infinite=True)
    turn_bound: Positive = absent(math.inf, may_be_infinite=True)


def find_facts(keys: Any) -> Plant:
    """Return the facts of such a robot."""
    return build_facts(round(keys.period_s * 1e9))


def build_facts(period_ns: int) -> Plant:
    """Return the facts of such a robot that publishes a pose per period [ns]."""
    return Plant(name=LAGGED, period_ns=period_ns, low_m=-LARGEST_M, high_m=LARGEST_M)


@dataclass(slots=True)
class AxisState:
    """One rate: a constant part, and a transient that fades with the time constant.

    Attributes:
        target: Rate that the command leads to.
        transient: Difference of the rate to its target.
        push: Disturbance: rate that is added after the low-pass.
        next_ns: Time at which the target switches next [ns].
        waiting_first: The first command whose dead time is not over.
    """

    target: float = 0.0
    transient: float = 0.0
    push: float = 0.0
    next_ns: int = NEVER_NS
    waiting_first: int = 0


@dataclass(slots=True)
class LaggedState:
    """Pose of the robot, and the commands that it still follows."""

    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0
    now_ns: int = 0
    waiting_first: int = 0
    waiting_end: int = 0
    hit_wall: bool = False
    runs_away: bool = False
    speed: AxisState = field(default_factory=AxisState)
    turn: AxisState = field(default_factory=AxisState)


@dataclass(slots=True)
class Waiting:
    """A command whose dead time is not over."""

    time_ns: int = 0
    speed: float = 0.0
    turn_rate: float = 0.0


def begin(
    keys: Any, x_m: float, y_m: float, heading_rad: float, *, is_rounded: bool
) -> LaggedState:
    """Return a robot that stands still at a pose at time 0."""
    del keys
    if is_rounded:
        x_m, y_m, heading_rad = to_float32(x_m), to_float32(y_m), to_float32(heading_rad)
    return LaggedState(x_m=x_m, y_m=y_m, heading_rad=heading_rad)


def hold(
    settings: Any, state: Any, rows: Any, time_ns: int, speed: float, turn_rate: float
) -> None:
    """Let a command arrive [ns], [m/s], [rad/s]; it holds until the next one.

    No command arrives before an earlier one did, nor before the time to which the robot has moved.
    Both axes read the one queue, each from its own place.
    """
    row = begin_row(rows.waiting, rows.new[0].waiting, state.waiting_end)
    row.time_ns, row.speed, row.turn_rate = time_ns, speed, turn_rate
    state.waiting_end += 1
    keys, speed_axis, turn_axis = settings.plant, state.speed, state.turn
    if speed_axis.next_ns == NEVER_NS:
        speed_axis.next_ns = time_ns + to_ns(keys.speed_dead_time_s)
    if turn_axis.next_ns == NEVER_NS:
        turn_axis.next_ns = time_ns + to_ns(keys.turn_dead_time_s)


def push(settings: Any, state: Any, speed: float, turn_rate: float) -> None:
    """Add these disturbances to the rates, from now on [m/s], [rad/s]."""
    state.speed.push, state.turn.push = speed, turn_rate


@called
def move(settings: Any, state: Any, rows: Any, time_ns: int) -> bool:
    """Move to a time that is not in the past [ns]; what switches at that time has switched."""
    keys, speed, turn = settings.plant, state.speed, state.turn
    while not state.runs_away:
        switch_ns = min(speed.next_ns, turn.next_ns)
        if switch_ns > time_ns:
            break
        _move_to(keys, state, switch_ns)
        _switch_speed(keys, state, rows)
        _switch_turn(keys, state, rows)
        state.waiting_first = min(speed.waiting_first, turn.waiting_first)
    _move_to(keys, state, time_ns)
    x_m, y_m, heading_rad, rate, turn_rate = read(state)
    return not state.runs_away and (
        abs(x_m) < LARGEST_FLOAT
        and abs(y_m) < LARGEST_FLOAT
        and abs(heading_rad) < LARGEST_FLOAT
        and rate < LARGEST_FLOAT
        and abs(turn_rate) < LARGEST_FLOAT
    )


def read(state: Any) -> tuple[float, float, float, float, float]:
    """Return the contents of a pose message: rates of this instant, disturbances included.

    Position x, y [m], heading in [-pi, pi) [rad], magnitude of the speed [m/s], turn rate [rad/s].
    """
    speed, turn = state.speed, state.turn
    rate = speed.target + speed.transient + speed.push
    turn_rate = turn.target + turn.transient + turn.push
    return state.x_m, state.y_m, wrap_angle(state.heading_rad), abs(rate), turn_rate


def _switch_speed(keys: Any, state: Any, rows: Any) -> None:
    """Follow the commands whose dead time is over."""
    axis = state.speed
    while axis.next_ns <= state.now_ns:
        wanted = keys.speed_gain * rows.waiting[axis.waiting_first].speed
        _follow(axis, clip(wanted, keys.speed_bound), keys.speed_lag_s)
        axis.next_ns = _find_next(axis, state, rows, keys.speed_dead_time_s)


def _switch_turn(keys: Any, state: Any, rows: Any) -> None:
    axis = state.turn
    while axis.next_ns <= state.now_ns:
        wanted = keys.turn_gain * rows.waiting[axis.waiting_first].turn_rate
        _follow(axis, clip(wanted, keys.turn_bound), keys.turn_lag_s)
        axis.next_ns = _find_next(axis, state, rows, keys.turn_dead_time_s)


def _follow(axis: Any, wanted: float, lag_s: float) -> None:
    before = axis.target
    axis.target = wanted
    if lag_s != 0.0:
        axis.transient += before - wanted
    axis.waiting_first += 1


def _find_next(axis: Any, state: Any, rows: Any, dead_time_s: float) -> int:
    """Return when an axis begins to follow the next command that waits [ns]."""
    if axis.waiting_first == state.waiting_end:
        return NEVER_NS
    arrived_ns: int = rows.waiting[axis.waiting_first].time_ns
    return arrived_ns + to_ns(dead_time_s)


@called
def _move_to(keys: Any, state: Any, time_ns: int) -> None:
    left_s = (time_ns - state.now_ns) / 1e9
    if left_s <= 0.0:
        return
    speed, turn = state.speed, state.turn
    turn_limit = MOST_TURN_RAD / left_s
    while True:
        speed_settles = _is_settled(speed, keys.speed_lag_s)
        turn_settles = _is_settled(turn, keys.turn_lag_s)
        is_straight = turn_settles and turn.target + turn.push == 0.0
        is_spin = speed_settles and speed.target + speed.push == 0.0
        if is_straight or is_spin or (speed_settles and turn_settles):
            _move_along_arc(keys, state, left_s)
            break
        pace = least(abs(turn.target + turn.push) + abs(turn.transient), turn_limit)
        if not speed_settles:
            pace += 1.0 / keys.speed_lag_s
        if not turn_settles:
            pace += 1.0 / keys.turn_lag_s
        wanted = left_s * pace / LONGEST_PIECE
        if not wanted < _MOST_PIECES:
            state.runs_away = True
            break
        pieces = int(wanted) + 1
        _move_by_quadrature(keys, state, left_s / pieces)
        if pieces == 1:
            break
        left_s -= left_s / pieces
    state.now_ns = time_ns


def _move_along_arc(keys: Any, state: Any, duration_s: float) -> None:
    """Drive a circle, or a line; the rest of a transient adds to its length and its turn."""
    way_m = _let_pass(state.speed, keys.speed_lag_s, duration_s)
    half_rad = 0.5 * _let_pass(state.turn, keys.turn_lag_s, duration_s)
    chord_m = way_m * (math.sin(half_rad) / half_rad) if half_rad != 0.0 else way_m
    middle_rad = state.heading_rad + half_rad
    state.x_m += chord_m * math.cos(middle_rad)
    state.y_m += chord_m * math.sin(middle_rad)
    state.heading_rad = wrap_angle(state.heading_rad + 2.0 * half_rad)


def _move_by_quadrature(keys: Any, state: Any, duration_s: float) -> None:
    speed, turn = state.speed, state.turn
    x_m = y_m = 0.0
    for node, weight in _GAUSS:
        time_s = node * duration_s
        heading_rad = state.heading_rad + _integrate(turn, keys.turn_lag_s, time_s)
        rate = speed.target + speed.push
        if speed.transient != 0.0:
            rate += speed.transient * math.exp(-time_s / keys.speed_lag_s)
        way_m = weight * rate
        x_m += way_m * math.cos(heading_rad)
        y_m += way_m * math.sin(heading_rad)
    state.x_m += duration_s * x_m
    state.y_m += duration_s * y_m
    _let_pass(speed, keys.speed_lag_s, duration_s)
    state.heading_rad = wrap_angle(state.heading_rad + _let_pass(turn, keys.turn_lag_s, duration_s))


def _is_settled(axis: Any, lag_s: float) -> bool:
    settles: bool = abs(axis.transient) * lag_s <= SETTLED
    return settles


def _integrate(axis: Any, lag_s: float, time_s: float) -> float:
    """Return the way, or turn, within a time [s] without a switch."""
    way: float = (axis.target + axis.push) * time_s
    if axis.transient == 0.0:
        return way
    faded = -math.expm1(-time_s / lag_s)
    way += axis.transient * lag_s * faded
    return way


def _let_pass(axis: Any, lag_s: float, time_s: float) -> float:
    """Let a time pass [s]; return the way, or turn, within it."""
    way = _integrate(axis, lag_s, time_s)
    if axis.transient != 0.0:
        axis.transient *= math.exp(-time_s / lag_s)
    return way


PART: Final = PlantPart(
    name=LAGGED,
    meaning="a robot whose rates follow commands after a dead time and with a time constant",
    Keys=LaggedKeys,
    find_facts=find_facts,
    State=LaggedState,
    begin=begin,
    hold=hold,
    push=push,
    move=move,
    read=read,
    acts_in_steps=False,
    Waiting=Waiting,
    delays=("speed_dead_time_s", "turn_dead_time_s"),
)
