"""The displacement of a robot in response to held commands, with nonlinearities.

The transfer function from held commands to the rate is exp(-dead_time s) / (c s^2 + b s + 1).
Between two commands the response is a sum of exponentials, so its integral is known at any time. No
time grid is needed, however irregular commands and poses are.
"""

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from turtlelog.effects.acceleration import plan_curve

Values = NDArray[np.float64]

_FADED: Final = 1e-18
"""Share of an earlier transient that is below the resolution of doubles."""

_LEAST_LAG_S: Final = 1e-9
"""Time constant that represents no time constant [s]: it decays within the resolution of any
clock."""

_CURVE_LINES: Final = 4
"""Number of lines for a part of an S-curve; the rate is off by less than 1 % of the change that the
part makes."""

_APART: Final = 1e-3
"""Smallest relative difference of two time constants; smaller differences are enlarged to it,
because the two parts would cancel. The response changes by less than a millionth."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Places:
    """Times, with the command held at each time.

    Attributes:
        held: Row of the held command, shape (m,).
        since_s: Time since the start of the held command [s].
        value: Value of the command at the time [m/s or rad/s].
        slope: Rate of change of the command [m/s^2 or rad/s^2]; 0 for a constant command.
        way: Integral of the commands up to the time [m or rad].
    """

    held: NDArray[np.int64]
    since_s: Values
    value: Values
    slope: Values
    way: Values


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldInput:
    """The commands of one axis under zero-order hold.

    Attributes:
        time_s: Time of each change [s], shape (n,), not decreasing; the first is the value before
            any recorded command.
        value: Commanded rate [m/s or rad/s], shape (n,).
        slope: Rate of change until the next change [m/s^2 or rad/s^2], shape (n,), if a limit turns
            changes into ramps; otherwise 0.
        way: Integral of the commands up to each change [m or rad], shape (n,).
    """

    time_s: Values
    value: Values
    slope: Values
    way: Values

    def place(self, time_s: Values) -> Places:
        """Return the command held at each time; before the first entry, the first entry is held."""
        held = np.maximum(np.searchsorted(self.time_s, time_s, side="right") - 1, 0)
        since_s = time_s - self.time_s[held]
        slope = self.slope[held]
        value = self.value[held] + slope * since_s
        way = self.way[held] + (value - 0.5 * slope * since_s) * since_s
        since_s = np.maximum(since_s, 0.0)
        return Places(held=held, since_s=since_s, value=value, slope=slope, way=way)


def hold_commands(time_s: Values, value: Values, before: float) -> HeldInput:
    """Return held commands without repeated values.

    Args:
        time_s: Time of each command [s].
        value: Value of each command.
        before: Value before the first command.
    """
    changes = np.flatnonzero(np.diff(value, prepend=before))
    first_s = time_s[0] - 1.0 if len(time_s) else 0.0
    value = np.concatenate([[before], value[changes]])
    time_s = np.concatenate([[first_s], time_s[changes]])
    return integrate_commands(time_s, value, np.zeros(len(value)))


def integrate_commands(time_s: Values, value: Values, slope: Values) -> HeldInput:
    """Return commands with their integral."""
    held_s = np.diff(time_s)
    steps = (value[:-1] + 0.5 * slope[:-1] * held_s) * held_s
    way = np.concatenate([[0.0], np.cumsum(steps)])
    return HeldInput(time_s=time_s, value=value, slope=slope, way=way)


def limit_changes(commands: HeldInput, slowness: float) -> HeldInput:
    """Return commands with limited slope: a ramp for each, followed by its final value.

    Args:
        commands: Commands to follow.
        slowness: Time for a unit change [s^2/m or s^2/rad]; 0 for no limit.
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
    return integrate_commands(time_s.ravel(), value.ravel(), slopes.ravel())


def limit_softly(commands: HeldInput, slowness: float, jerk_time_s: float) -> HeldInput:
    """Return commands with limited slope and jerk: an S-curve for each, then its final value.

    Parts with a constant jerk are lines with the same integral.

    Args:
        commands: Commands to follow.
        slowness: Time for a unit change at the largest slope [s^2/m or s^2/rad].
        jerk_time_s: Time in which the slope builds up [s]; 0 for no limit of the jerk.
    """
    if min(slowness, jerk_time_s) <= 0.0:
        return limit_changes(commands, slowness)
    rates = 1.0 / slowness, 1.0 / (slowness * jerk_time_s)
    value, slope, rows = float(commands.value[0]), 0.0, []
    ends_s = np.append(commands.time_s[1:], np.inf)
    for now_s, end_s, wanted in zip(
        commands.time_s.tolist(), ends_s.tolist(), commands.value.tolist(), strict=True
    ):
        jerk, *durations_s = plan_curve(value, slope, rates, wanted)
        for bend, duration_s in zip((jerk, 0.0, -jerk), durations_s, strict=True):
            part_s = max(min(duration_s, end_s - now_s), 0.0)
            count = _CURVE_LINES if bend else 1
            for line in range(count):
                line_s = part_s / count
                mean = slope + 0.5 * bend * line_s
                rows.append((now_s + line * line_s, value - bend * line_s**2 / 12.0, mean))
                value, slope = value + mean * line_s, slope + bend * line_s
            if part_s < duration_s:
                break
            now_s += part_s
        else:
            rows.append((now_s, wanted, 0.0))
            value, slope = wanted, 0.0
    return integrate_commands(*np.array(rows).T)


def limit_within(
    commands: HeldInput, slowness: float, lag_s: float, most: float = math.inf
) -> HeldInput:
    """Return the input of a lag for which its rate and acceleration are limited.

    rate' = clip((command - rate) / lag, +-limit) is a lag with the input clip(command, rate +-
    limit lag). This input is a ramp ahead of the rate, until the ramp reaches the command. At the
    largest rate the input rises no further.

    Args:
        commands: Commands to follow.
        slowness: Time for a unit change [s^2/m or s^2/rad]; 0 for no limit.
        lag_s: Time constant [s].
        most: Largest rate for a gain of 1 [m/s or rad/s].
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
    return integrate_commands(*np.array(rows).T)


class HeldResponse(Protocol):
    """The displacement of a robot with a gain of 1."""

    def place(self, time_s: Values) -> Any:
        """Return the command that is held at each time minus the dead time [s]."""

    def evaluate(self, places: Any) -> tuple[Values, Values]:
        """Return the integral of the rate, up to a constant, and the rate itself."""


class LaggedResponse:
    """The response of a robot with given time constants and a gain of 1."""

    def __init__(self, commands: HeldInput, lag_s: float, product_s2: float = 0.0) -> None:
        """Prepare the response.

        Args:
            commands: Commands to follow.
            lag_s: Sum b of the time constants [s].
            product_s2: Product c of the time constants [s^2]; 0 for first order.
        """
        self._product_s2 = product_s2
        self._commands, self._lag_s = commands, lag_s
        self._parts = [
            (share, lag, _list_transients(commands, lag))
            for share, lag in _split(lag_s, product_s2)
        ]

    def place(self, time_s: Values) -> Places:
        """Return the command that is held at each time minus the dead time [s]."""
        return self._commands.place(time_s)

    def evaluate(self, places: Places) -> tuple[Values, Values]:
        """Return the integral of the rate, up to a constant, and the rate itself."""
        # Rate after all transients have faded: on a ramp it lags by the time constant.
        rate = places.value - self._lag_s * places.slope
        way = places.way - self._lag_s * rate - self._product_s2 * places.slope
        for share, lag, transients in self._parts:
            left = share * transients[places.held] * np.exp(places.since_s * (-1.0 / lag))
            way, rate = way - (lag * left).real, rate + left.real
        return way, rate


def _split(lag_s: float, product_s2: float) -> list[tuple[Any, Any]]:
    """Return weight and time constant of first-order parts; one doubled for a conjugate pair."""
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
    """Return the initial difference between the rate of a first-order lag and each command.

    Each difference decays by a factor until the next command, which adds a new difference. This
    linear recurrence is solved by doubling.
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


class MeanResponse:
    """The mean of responses: the speed of two wheels."""

    def __init__(self, parts: Sequence[LaggedResponse]) -> None:
        """Take the responses."""
        self._parts = parts

    def place(self, time_s: Values) -> list[Places]:
        """Return the commands that are held at each time minus the dead time [s]."""
        return [response.place(time_s) for response in self._parts]

    def evaluate(self, places: list[Places]) -> tuple[Values, Values]:
        """Return the integral of the rate, up to a constant, and the rate itself."""
        both = [
            np.stack(response.evaluate(place))
            for response, place in zip(self._parts, places, strict=True)
        ]
        way, rate = np.mean(both, axis=0)
        return way, rate
