"""A robot model whose rates follow commands with dead time and time constant, without walls.

Each axis (speed along the heading, turn rate) has the transfer function gain * exp(-dead_time s) /
(lag s + 1) from command to rate. Each command is held until the next command. The robot can have
the limits that `turtlelog identify` finds; by default no limit is set:

    wanted = 0 where |command| <= deadband or friction,
             else clip(gain (command -+ friction), +-bound), below 0 with reverse_gain
    rate' = clip((wanted - rate) / lag, +-acceleration)

The last line describes a motor controller whose output saturates: a first-order lag with a slew
rate. Without lag, the rate moves to the wanted rate at the given acceleration.

Between two switches a rate is a ramp, then an exponential. Rate, heading, distance and the end of
the ramp have closed forms. The position is the integral of the speed along the heading, by
quadrature. The error is at most 1e-9 m for any duration of a command and any time constant, if one
move turns by at most 1,000 rad. An event acts from its time on: without time constant and dead
time, the rate changes when the command arrives.
"""

import math
from dataclasses import dataclass, field
from typing import Any, Final

from turtlelog.arithmetic import (
    GAUSS_LEGENDRE,
    begin_row,
    called,
    least,
    most,
    rub,
    to_float32,
    to_ns,
    want_rate,
    wrap_angle,
)
from turtlelog.parts import (
    LARGEST_FLOAT,
    LARGEST_M,
    NEVER_NS,
    Offset,
    Period,
    Plant,
    PlantPart,
    Positive,
    Size,
    Time,
    TurnSize,
    absent,
)
from turtlelog.run.loops import Cause

LONGEST_PIECE: Final = 2.0
"""Largest turn of a piece of the quadrature [rad], plus its length in time constants. With 8 nodes
the result is then exact up to rounding: at 4, to 3e-13 of the distance; at 8, the error exceeds
1e-9."""

SETTLED: Final = 1e-15
"""Remaining effect of the transient on position [m] or heading [rad] below which a rate counts as
constant: less than the resolution of a coordinate of 10 m."""

MOST_TURN_RAD: Final = 1000.0
"""Largest turn within one move that is followed [rad], so that a loop that runs away ends."""

_MOST_PIECES: Final = 2.0**62

_SHORTEST_S: Final = 1e-18  # shortest piece [s]: a huge acceleration may end a ramp at once


@dataclass(frozen=True, slots=True, kw_only=True)
class LaggedKeys:
    """Parameters of a robot model without walls.

    Attributes:
        period_s: Time between two poses [s]. Default: 0.05.
        speed_gain: Speed that results from a command of 1 m/s [1]. Default: 1.
        speed_dead_time_s: Time from the arrival of a command until the speed begins to follow [s].
        speed_lag_s: Time constant of the speed [s]; 0: the speed follows at once.
        turn_gain: Turn rate that results from a command of 1 rad/s [1]. Default: 1.
        turn_dead_time_s: Dead time of the turn rate [s].
        turn_lag_s: Time constant of the turn rate [s].
        speed_bound: Largest speed that results from a command [m/s]. Default: inf, no limit.
        turn_bound: Largest turn rate that results from a command [rad/s]. Default: inf, no limit.
        speed_acceleration: Largest acceleration within the loop that follows the command [m/s^2].
            Default: inf, no limit.
        turn_acceleration: Largest angular acceleration within the loop that follows the command
            [rad/s^2]. Default: inf, no limit.
        speed_deadband: Magnitude up to which a speed command moves nothing [m/s]. Larger commands
            act in full.
        turn_deadband: Magnitude up to which a turn rate command moves nothing [rad/s].
        speed_friction: What friction takes off the magnitude of each speed command [m/s].
        turn_friction: What friction takes off the magnitude of each turn rate command [rad/s].
        speed_assumed: Whether the log of the robot never commanded the speed, so that its gain,
            dead time and time constant are assumed. Theory then has no model of the speed.
        turn_assumed: Whether those of the turn rate are assumed.
        speed_oscillates: Whether the robot's speed oscillates, in place of which it has a longer
            dead time here. Theory then has no limit of stability.
        turn_oscillates: Whether the robot's turn rate oscillates.
        speed_reverse_gain: Gain of speeds below 0 [1]. Default: `speed_gain`.
        turn_reverse_gain: Gain of turn rates below 0, to the right [1]. Default: `turn_gain`.
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
    speed_acceleration: Positive = absent(math.inf, may_be_infinite=True)
    turn_acceleration: Positive = absent(math.inf, may_be_infinite=True)
    speed_deadband: Size = absent(0.0)
    turn_deadband: TurnSize = absent(0.0)
    speed_friction: Size = absent(0.0)
    turn_friction: TurnSize = absent(0.0)
    speed_assumed: bool = absent(default=False)
    turn_assumed: bool = absent(default=False)
    speed_oscillates: bool = absent(default=False)
    turn_oscillates: bool = absent(default=False)
    speed_reverse_gain: Offset | None = absent(None)
    turn_reverse_gain: Offset | None = absent(None)


def find_facts(keys: Any) -> Plant:
    """Return the facts of a robot model from its keys."""
    return Plant(
        name="lagged",
        period_ns=round(keys.period_s * 1e9),
        low_m=-LARGEST_M,
        high_m=LARGEST_M,
        acts_in_steps=False,
        turns_first=False,
        holds_rates=False,
        dynamics="first-order",
    )


@dataclass(slots=True)
class AxisState:
    """State of one rate: a constant part plus a transient that decays.

    Attributes:
        target: Rate that the command leads to after the transient.
        transient: Difference between the rate and its target.
        push: Disturbance: rate that is added after the low-pass filter.
        next_ns: Time at which the target switches next [ns].
        waiting_first: Number of the first command that still waits for its dead time to pass.
    """

    target: float = 0.0
    transient: float = 0.0
    push: float = 0.0
    next_ns: int = NEVER_NS
    waiting_first: int = 0


@dataclass(slots=True)
class LaggedState:
    """Pose of the robot, and the commands that the robot still follows."""

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
    """A command that waits for its dead time to pass."""

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
    """Accept a command of [m/s] and [rad/s] that arrives at a time [ns] and holds until the next.

    Commands arrive in order, and not before the time to which the robot has moved. Both axes read
    the same queue, each from its own position.
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
    """Add disturbances to the rates from now on [m/s], [rad/s]."""
    state.speed.push, state.turn.push = speed, turn_rate


@called
def move(settings: Any, state: Any, rows: Any, time_ns: int) -> bool:
    """Move to a time that is not in the past [ns]; switches at this time are applied."""
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
    """Return the contents of a pose message, with the present rates including disturbances.

    Position x, y [m], heading in [-pi, pi) [rad], magnitude of the speed [m/s], turn rate [rad/s].
    """
    speed, turn = state.speed, state.turn
    rate = speed.target + speed.transient + speed.push
    turn_rate = turn.target + turn.transient + turn.push
    return state.x_m, state.y_m, wrap_angle(state.heading_rad), abs(rate), turn_rate


def _switch_speed(keys: Any, state: Any, rows: Any) -> None:
    axis = state.speed
    while axis.next_ns <= state.now_ns:
        command = rows.waiting[axis.waiting_first].speed
        command = rub(command, keys.speed_deadband, keys.speed_friction)
        wanted = want_rate(command, keys.speed_gain, keys.speed_reverse_gain, keys.speed_bound)
        _follow(axis, wanted, keys.speed_lag_s, keys.speed_acceleration)
        axis.next_ns = _find_next(axis, state, rows, keys.speed_dead_time_s)


def _switch_turn(keys: Any, state: Any, rows: Any) -> None:
    axis = state.turn
    while axis.next_ns <= state.now_ns:
        command = rows.waiting[axis.waiting_first].turn_rate
        command = rub(command, keys.turn_deadband, keys.turn_friction)
        wanted = want_rate(command, keys.turn_gain, keys.turn_reverse_gain, keys.turn_bound)
        _follow(axis, wanted, keys.turn_lag_s, keys.turn_acceleration)
        axis.next_ns = _find_next(axis, state, rows, keys.turn_dead_time_s)


def _follow(axis: Any, wanted: float, lag_s: float, acceleration: float) -> None:
    if lag_s != 0.0 or not math.isinf(acceleration):
        axis.transient += axis.target - wanted
    axis.target = wanted
    axis.waiting_first += 1


def _find_next(axis: Any, state: Any, rows: Any, dead_time_s: float) -> int:
    """Return the time at which an axis begins to follow the next waiting command [ns]."""
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
    while left_s > 0.0 and not state.runs_away:
        # Where a ramp ends, a rate has a bend, over which no quadrature goes.
        piece_s = left_s
        if _is_ramp(speed, keys.speed_lag_s, keys.speed_acceleration):
            ramp_s = _find_ramp_s(speed, keys.speed_lag_s, keys.speed_acceleration)
            piece_s = least(piece_s, most(ramp_s, _SHORTEST_S))
        if _is_ramp(turn, keys.turn_lag_s, keys.turn_acceleration):
            ramp_s = _find_ramp_s(turn, keys.turn_lag_s, keys.turn_acceleration)
            piece_s = least(piece_s, most(ramp_s, _SHORTEST_S))
        _move_smoothly(keys, state, piece_s)
        left_s -= piece_s
    state.now_ns = time_ns


@called
def _move_smoothly(keys: Any, state: Any, left_s: float) -> None:
    """Move for a time in which no ramp ends."""
    speed, turn = state.speed, state.turn
    is_ramp = _is_ramp(speed, keys.speed_lag_s, keys.speed_acceleration)
    is_turn_ramp = _is_ramp(turn, keys.turn_lag_s, keys.turn_acceleration)
    turn_limit = MOST_TURN_RAD / left_s
    while True:
        speed_settles = not is_ramp and _is_settled(speed, keys.speed_lag_s)
        turn_settles = not is_turn_ramp and _is_settled(turn, keys.turn_lag_s)
        is_straight = turn_settles and turn.target + turn.push == 0.0
        is_spin = speed_settles and speed.target + speed.push == 0.0
        if is_straight or is_spin or (speed_settles and turn_settles):
            _move_along_arc(keys, state, left_s)
            break
        pace = least(abs(turn.target + turn.push) + abs(turn.transient), turn_limit)
        if not speed_settles and not is_ramp:
            pace += 1.0 / keys.speed_lag_s
        if not turn_settles and not is_turn_ramp:
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


def _move_along_arc(keys: Any, state: Any, duration_s: float) -> None:
    """Drive a circle or line. The rest of a transient adds to the length and the turn."""
    way_m = _let_pass(state.speed, keys.speed_lag_s, keys.speed_acceleration, duration_s)
    half_rad = 0.5 * _let_pass(state.turn, keys.turn_lag_s, keys.turn_acceleration, duration_s)
    chord_m = way_m * (math.sin(half_rad) / half_rad) if half_rad != 0.0 else way_m
    middle_rad = state.heading_rad + half_rad
    state.x_m += chord_m * math.cos(middle_rad)
    state.y_m += chord_m * math.sin(middle_rad)
    state.heading_rad = wrap_angle(state.heading_rad + 2.0 * half_rad)


def _move_by_quadrature(keys: Any, state: Any, duration_s: float) -> None:
    speed, turn = state.speed, state.turn
    x_m = y_m = 0.0
    for node, weight in GAUSS_LEGENDRE:
        time_s = node * duration_s
        turned_rad = _integrate(turn, keys.turn_lag_s, keys.turn_acceleration, time_s)
        heading_rad = state.heading_rad + turned_rad
        rate = speed.target + speed.push
        if speed.transient != 0.0:
            rate += _fade(speed, keys.speed_lag_s, keys.speed_acceleration, time_s)
        way_m = weight * rate
        x_m += way_m * math.cos(heading_rad)
        y_m += way_m * math.sin(heading_rad)
    state.x_m += duration_s * x_m
    state.y_m += duration_s * y_m
    _let_pass(speed, keys.speed_lag_s, keys.speed_acceleration, duration_s)
    turned_rad = _let_pass(turn, keys.turn_lag_s, keys.turn_acceleration, duration_s)
    state.heading_rad = wrap_angle(state.heading_rad + turned_rad)


def _is_settled(axis: Any, lag_s: float) -> bool:
    settles: bool = abs(axis.transient) * lag_s <= SETTLED
    return settles


def _is_ramp(axis: Any, lag_s: float, acceleration: float) -> bool:
    """Return whether the largest acceleration limits the decay of the transient, not the lag."""
    is_limited: bool = not math.isinf(acceleration)
    return is_limited and abs(axis.transient) > acceleration * lag_s


def _find_ramp_s(axis: Any, lag_s: float, acceleration: float) -> float:
    """Return how long a transient remains a ramp [s]."""
    above: float = abs(axis.transient) - acceleration * lag_s
    return above / acceleration


def _fade(axis: Any, lag_s: float, acceleration: float, time_s: float) -> float:
    """Return the rest of a transient after a time in which no ramp ends [s]."""
    left: float = axis.transient
    if not _is_ramp(axis, lag_s, acceleration):
        left *= math.exp(-time_s / lag_s)
    elif time_s < _find_ramp_s(axis, lag_s, acceleration):
        left -= math.copysign(acceleration, left) * time_s
    else:  # exactly there, so that no ramp is left by rounding
        left = math.copysign(acceleration * lag_s, left)
    return left


def _integrate(axis: Any, lag_s: float, acceleration: float, time_s: float) -> float:
    """Return the distance or turn within a time without a switch in which no ramp ends [s]."""
    way: float = (axis.target + axis.push) * time_s
    if axis.transient == 0.0:
        return way
    if _is_ramp(axis, lag_s, acceleration):
        ramp_s = least(time_s, _find_ramp_s(axis, lag_s, acceleration))
        slope = math.copysign(acceleration, axis.transient)
        way += (axis.transient - 0.5 * slope * ramp_s) * ramp_s
    else:
        way += axis.transient * lag_s * -math.expm1(-time_s / lag_s)
    return way


def _let_pass(axis: Any, lag_s: float, acceleration: float, time_s: float) -> float:
    """Advance by a time in which no ramp ends [s]; return the distance or turn within this time."""
    way = _integrate(axis, lag_s, acceleration, time_s)
    if axis.transient != 0.0:
        axis.transient = _fade(axis, lag_s, acceleration, time_s)
    return way


_AXES: Final = ("speed", "turn")


def _build_cause(name: str, meaning: str) -> Cause:
    """Return a limit of both axes as a cause. A key of None has no limit."""
    keys = dict.fromkeys(f"plant.{axis}_{name}" for axis in _AXES)
    name = f"robot-{name.replace('_', '-')}"
    return Cause(name=name, kind="design", neutral=keys, meaning=meaning)


PART: Final = PlantPart(
    name="lagged",
    meaning="a robot whose rates follow commands after a dead time and with a time constant",
    Keys=LaggedKeys,
    find_facts=find_facts,
    State=LaggedState,
    begin=begin,
    hold=hold,
    push=push,
    move=move,
    read=read,
    Waiting=Waiting,
    delays=("speed_dead_time_s", "turn_dead_time_s"),
    causes=(
        _build_cause("acceleration", "no limit of the robot's own acceleration"),
        _build_cause("bound", "no bound of the robot's own speed and turn rate"),
        _build_cause("deadband", "small commands move the robot, too"),
        _build_cause("friction", "the robot has no friction"),
        _build_cause("reverse_gain", "the robot has one gain in both directions"),
    ),
    added=tuple(f"plant.{axis}_{name}" for name in ("bound", "acceleration") for axis in _AXES),
)
