"""The way that a robot covers in response to commands that hold, and what may shape it.

rate = exp(-dead_time s) / (c s^2 + b s + 1) of the commands, each of which holds until the next
one. Between two commands the response is a sum of exponentials, so its integral is known at any
time: there is no grid in time, however irregular commands and poses are.
"""

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]

_FADED: Final = 1e-18
"""Share of an earlier transient that no double can tell any more."""

_LEAST_LAG_S: Final = 1e-9
"""What stands for no lag: faded within any time that a clock tells [s]."""

_APART: Final = 1e-3
"""Two lags that differ by less than this share are moved apart: their parts would cancel. It
changes the response by less than a millionth."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Places:
    """Times, and which command holds at each of them.

    Attributes:
        held: Row of that command, shape (m,).
        since_s: For how long it has held [s].
        value: What it says then [m/s] or [rad/s].
        slope: How fast that changes [m/s^2] or [rad/s^2]; 0 of a command that holds.
        way: Integral of the commands up to the time [m] or [rad].
    """

    held: NDArray[np.int64]
    since_s: Values
    value: Values
    slope: Values
    way: Values


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldInput:
    """The commands of one axis, each of which holds until the next one.

    Attributes:
        time_s: Of each change [s], shape (n,), not decreasing; the first is what held before any
            command was recorded.
        value: What was commanded [m/s] or [rad/s], shape (n,).
        slope: How fast that changes until the next one, where a limit makes ramps of changes
            [m/s^2] or [rad/s^2], shape (n,); 0 elsewhere.
        way: Integral of the commands up to each of them [m] or [rad], shape (n,).
    """

    time_s: Values
    value: Values
    slope: Values
    way: Values

    def place(self, time_s: Values) -> Places:
        """Return which command holds at some times; before the first one, it does."""
        held = np.maximum(np.searchsorted(self.time_s, time_s, side="right") - 1, 0)
        since_s = time_s - self.time_s[held]
        slope = self.slope[held]
        value = self.value[held] + slope * since_s
        way = self.way[held] + (value - 0.5 * slope * since_s) * since_s
        since_s = np.maximum(since_s, 0.0)
        return Places(held=held, since_s=since_s, value=value, slope=slope, way=way)


def hold_commands(time_s: Values, value: Values, before: float) -> HeldInput:
    """Return commands that hold, without those that repeat the one before.

    Args:
        time_s: Of each [s].
        value: Of each.
        before: What held until the first one.
    """
    changes = np.flatnonzero(np.diff(value, prepend=before))
    first_s = time_s[0] - 1.0 if len(time_s) else 0.0
    value = np.concatenate([[before], value[changes]])
    time_s = np.concatenate([[first_s], time_s[changes]])
    return _integrate_commands(time_s, value, np.zeros(len(value)))


def _integrate_commands(time_s: Values, value: Values, slope: Values) -> HeldInput:
    held_s = np.diff(time_s)
    steps = (value[:-1] + 0.5 * slope[:-1] * held_s) * held_s
    way = np.concatenate([[0.0], np.cumsum(steps)])
    return HeldInput(time_s=time_s, value=value, slope=slope, way=way)


def _limit_changes(commands: HeldInput, slowness: float) -> HeldInput:
    """Return commands that change no faster than a limit: of each a ramp, and what it leads to.

    Args:
        commands: To follow.
        slowness: Time that a change of 1 takes [s^2/m] or [s^2/rad]; 0 changes nothing.
    """
    if slowness <= 0.0:
        return commands
    begins, left_s = commands.value.copy(), np.append(np.diff(commands.time_s), np.inf)
    reached = float(commands.value[0])
    for row, (value, most) in enumerate(
        zip(commands.value.tolist(), (left_s / slowness).tolist(), strict=True)
    ):
        begins[row] = reached
        reached += min(max(value - reached, -most), most)
    change = commands.value - begins
    ramp_s = np.minimum(np.abs(change) * slowness, left_s)
    slope = np.sign(change) / slowness
    time_s = np.column_stack([commands.time_s, commands.time_s + ramp_s])
    value = np.column_stack([begins, begins + slope * ramp_s])
    slopes = np.column_stack([slope, np.zeros(len(slope))])
    return _integrate_commands(time_s.ravel(), value.ravel(), slopes.ravel())


def limit_within(
    commands: HeldInput, slowness: float, lag_s: float, most: float = math.inf
) -> HeldInput:
    """Return what a lag must be asked for so that its rate, or the rate's change, has a limit.

    rate' = clip((command - rate) / lag, +-limit) is a lag behind clip(command, rate +- limit lag):
    a ramp that is ahead of the rate, and where it reaches the command, the command. Where the rate
    is at its largest, it asks for no more.

    Args:
        commands: To follow.
        slowness: Time that a change of 1 takes [s^2/m] or [s^2/rad]; 0 for no limit of that.
        lag_s: The time constant [s].
        most: The largest rate, of a gain of 1 [m/s] or [rad/s].
    """
    lag_s = max(lag_s, _LEAST_LAG_S)
    ahead = lag_s / slowness if slowness > 0.0 else math.inf
    rate, rows = float(commands.value[0]), []
    ends_s = np.append(commands.time_s[1:], np.inf)
    for begin_s, end_s, value in zip(
        commands.time_s.tolist(), ends_s.tolist(), commands.value.tolist(), strict=True
    ):
        now_s, left_s, off = begin_s, end_s - begin_s, value - rate
        stops, end = abs(value) > most, math.copysign(most, value)
        if abs(off) > ahead:
            way = min(abs(off) - ahead, abs(end - rate) if stops else math.inf)
            took_s = min(way * slowness, left_s)
            slope = math.copysign(1.0 / slowness, off)
            rows.append((now_s, rate + slope * lag_s, slope))
            now_s, left_s, rate = now_s + took_s, left_s - took_s, rate + slope * took_s
            off = value - rate
        if left_s > 0.0:
            ends_after_s = lag_s * math.log(max(off / (value - end), 1.0)) if stops else math.inf
            took_s = min(ends_after_s, left_s)
            rows.append((now_s, value, 0.0))
            now_s, left_s = now_s + took_s, left_s - took_s
            rate = value - off * math.exp(-took_s / lag_s)
        if left_s > 0.0:
            rows.append((now_s, end, 0.0))
            rate = end
    return _integrate_commands(*np.array(rows).T)


def _shape_commands(
    commands: HeldInput, *, tightness: float, reverse: float, friction: float, deadband: float
) -> HeldInput:
    """Return commands as a robot takes them that does not take all alike.

    Args:
        commands: To follow.
        tightness: One by the largest that acts whole [s/m] or [s/rad]; 0 for none.
        reverse: Gain of those below 0 by that of the others [1].
        friction: What each lacks of its magnitude [m/s] or [rad/s].
        deadband: Magnitude up to which they move nothing [m/s] or [rad/s].
    """
    size = np.maximum(np.abs(commands.value) - friction, 0.0)
    value = np.where(commands.value < 0.0, -reverse, 1.0) * size
    value[np.abs(commands.value) <= deadband] = 0.0
    if tightness > 0.0:
        value = np.clip(value, -1.0 / tightness, 1.0 / tightness)
    return _integrate_commands(commands.time_s, value, commands.slope)


class LaggedResponse:
    """The response to commands of a robot with certain lags and a gain of 1."""

    def __init__(self, commands: HeldInput, lag_s: float, product_s2: float = 0.0) -> None:
        """Prepare it.

        Args:
            commands: To follow.
            lag_s: Sum of its time constants, b [s].
            product_s2: Their product, c [s^2]; 0 of a first-order lag.
        """
        self._product_s2 = product_s2
        self._commands, self._lag_s = commands, lag_s
        self._parts = [
            (share, lag, _list_transients(commands, lag))
            for share, lag in _split(lag_s, product_s2)
        ]

    def place(self, time_s: Values) -> Places:
        """Return which command holds at times from which the dead time is subtracted [s]."""
        return self._commands.place(time_s)

    def evaluate(self, places: Places) -> tuple[Values, Values]:
        """Return the integral of the rate, up to a constant, and the rate itself."""
        # What is left where all transients have faded: late by the lag on a ramp.
        rate = places.value - self._lag_s * places.slope
        way = places.way - self._lag_s * rate - self._product_s2 * places.slope
        for share, lag, transients in self._parts:
            left = share * transients[places.held] * np.exp(places.since_s * (-1.0 / lag))
            way, rate = way - (lag * left).real, rate + left.real
        return way, rate


def _split(lag_s: float, product_s2: float) -> list[tuple[Any, Any]]:
    """Return share and lag of the first-order parts, of two conjugate ones the double of one."""
    if product_s2 <= 0.0:
        return [(1.0, max(lag_s, _LEAST_LAG_S))]
    half_s = 0.5 * lag_s
    root = cmath.sqrt(half_s * half_s - product_s2)
    if abs(root) < _APART * half_s:
        root = complex(_APART * half_s)
    if root.imag:
        return [(2.0 * (half_s + root) / (2.0 * root), half_s + root)]
    long_s, short_s = half_s + root.real, max(half_s - root.real, _LEAST_LAG_S)
    return [(long_s / (long_s - short_s), long_s), (short_s / (short_s - long_s), short_s)]


def _list_transients(commands: HeldInput, lag_s: Any) -> NDArray[Any]:
    """Return by how much the rate of a first-order lag differs from each command as it begins.

    It fades by a factor until the next command, which adds its own: a linear recurrence, solved by
    doubling.
    """
    fading = np.exp(np.concatenate([[0.0], commands.time_s[1:] - commands.time_s[:-1]]) / -lag_s)
    fading[0] = 0.0
    ended = commands.value[:-1] + commands.slope[:-1] * np.diff(commands.time_s)
    bent = lag_s * (commands.slope[1:] - commands.slope[:-1])
    left = np.concatenate([[0.0], ended - commands.value[1:] + bent]).astype(fading.dtype)
    reach = 1
    while reach < len(left) and np.abs(fading[reach:]).max() > _FADED:
        left[reach:] = left[reach:] + fading[reach:] * left[:-reach]
        fading[reach:] = fading[reach:] * fading[:-reach]
        reach *= 2
    return left


Order = Literal["first_order", "second_order", "limited_before", "limited_within"]
"""A robot with one lag; with two, whose product is a further parameter [s^2]; with one, that
changes its rate no faster than a limit, before the lag (the command becomes a ramp) or within its
loop (the rate does): the time that it needs per unit of the command is a further parameter
[s^2/m] or [s^2/rad]."""

Bound = Literal["", "command", "rate"]

_STEPS: Final = MappingProxyType(
    {"product": 1e-7, "slowness": 1e-4, "tightness": 1e-4, "reverse": 1e-4, "friction": 1e-5}
)
"""For differences with respect to the further parameters, in their units."""

_OF_ORDER: Final = MappingProxyType(
    {
        "first_order": (),
        "second_order": ("product",),
        "limited_before": ("slowness",),
        "limited_within": ("slowness",),
    }
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Structure:
    """Which further parameters a model has.

    Attributes:
        order: Of its lag, and where its acceleration is limited.
        bound: What ends at a largest: the command, or the rate, which then follows larger commands
            as if it did not end, until it does; the parameter is one by the command that leads
            there [s/m] or [s/rad].
        has_reverse: Whether the gain of commands below 0 is another; the parameter is their ratio.
        has_friction: Whether every command lacks something of its magnitude; the parameter is that
            [m/s] or [rad/s].
        deadband: Magnitude up to which commands move nothing [m/s] or [rad/s].
    """

    order: Order = "first_order"
    bound: Bound = ""
    has_reverse: bool = False
    has_friction: bool = False
    deadband: float = 0.0

    @property
    def is_slow(self) -> bool:
        """Whether commands are followed one by one."""
        return self.order.startswith("limited") or self.bound == "rate"

    @property
    def is_possible(self) -> bool:
        """Whether its parts go together: a rate that ends is that of one lag, without ramps."""
        return self.bound != "rate" or self.order in {"first_order", "limited_within"}

    @property
    def names(self) -> tuple[str, ...]:
        """Of the further parameters, in order."""
        has = {
            "tightness": bool(self.bound),
            "reverse": self.has_reverse,
            "friction": self.has_friction,
        }
        return (*_OF_ORDER[self.order], *(name for name, is_there in has.items() if is_there))

    @property
    def size(self) -> int:
        """How many parameters it has beside gain, dead time and lag."""
        return len(self.names) + (self.deadband > 0.0)

    @property
    def steps(self) -> list[float]:
        """Of differences with respect to the further parameters."""
        return [_STEPS[name] for name in self.names]

    @property
    def bends(self) -> bool:
        """Whether the commands that act depend on the further parameters."""
        return self not in {FIRST_ORDER, SECOND_ORDER}

    def respond(self, commands: HeldInput, lag_s: float, extras: Sequence[float]) -> LaggedResponse:
        """Return the response to commands, with a lag and the further parameters."""
        values = dict(zip(self.names, extras, strict=True))
        if len(self.names) > len(_OF_ORDER[self.order]) or self.deadband:
            commands = _shape_commands(
                commands,
                tightness=values.get("tightness", 0.0) if self.bound == "command" else 0.0,
                reverse=values.get("reverse", 1.0),
                friction=values.get("friction", 0.0),
                deadband=self.deadband,
            )
        if self.order == "limited_before":
            commands = _limit_changes(commands, values["slowness"])
        elif self.order == "limited_within" or self.bound == "rate":
            tightness = values.get("tightness", 0.0) if self.bound == "rate" else 0.0
            most = 1.0 / tightness if tightness > 0.0 else math.inf
            commands = limit_within(commands, values.get("slowness", 0.0), lag_s, most)
        return LaggedResponse(commands, lag_s, values.get("product", 0.0))


SECOND_ORDER: Final = Structure(order="second_order")

FIRST_ORDER: Final = Structure()
