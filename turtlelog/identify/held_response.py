"""The displacement of a robot in response to held commands, and the parameters of its model.

The transfer function from held commands to the rate is exp(-dead_time s) / (c s^2 + b s + 1).
Between two commands the response is a sum of exponentials, so its integral is known at any time. No
time grid is needed, however irregular commands and poses are. A `Structure` adds further
parameters: limits, a bound, friction, a deadband, a drift.
"""

import cmath
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from turtlelog.effects.acceleration import plan_curve

Values = NDArray[np.float64]

_FADED: Final = 1e-18  # share of an earlier transient that is below the resolution of doubles

_LEAST_LAG_S: Final = 1e-9  # stands for no time constant [s]: below the resolution of any clock

_CURVE_LINES: Final = 4  # for a part of an S-curve, whose rate is then off by less than 1 %

_APART: Final = 1e-3
"""Smallest relative difference of two time constants, because equal parts would cancel. It changes
the response by less than a millionth."""


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
        since_s, slope = time_s - self.time_s[held], self.slope[held]
        value = self.value[held] + slope * since_s
        way = self.way[held] + (value - 0.5 * slope * since_s) * since_s
        since_s = np.maximum(since_s, 0.0)
        return Places(held=held, since_s=since_s, value=value, slope=slope, way=way)

    def list_held(self) -> Iterable[tuple[float, float, float]]:
        """Return the begin [s], end [s] and value of each command."""
        ends_s = [*self.time_s[1:].tolist(), math.inf]
        return zip(self.time_s.tolist(), ends_s, self.value.tolist(), strict=True)


def hold_commands(time_s: Values, value: Values) -> HeldInput:
    """Return held commands without repeated values; the command before the first is 0."""
    changes = np.flatnonzero(np.diff(value, prepend=0.0))
    first_s = time_s[0] - 1.0 if len(time_s) else 0.0
    value = np.concatenate([[0.0], value[changes]])
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

    `slowness` is the time for a unit change [s^2/m or s^2/rad]; 0 for no limit.
    """
    if slowness <= 0.0:
        return commands
    begins, left_s = commands.value.copy(), np.append(np.diff(commands.time_s), np.inf)
    reached = float(commands.value[0])
    values = zip(commands.value.tolist(), (left_s / slowness).tolist(), strict=True)
    for row, (value, most) in enumerate(values):
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

    Parts with a constant jerk are lines with the same integral. `slowness` is the time for a unit
    change at the largest slope [s^2/m or s^2/rad], `jerk_time_s` the time in which the slope builds
    up [s]; 0 for no limit of the jerk.
    """
    if min(slowness, jerk_time_s) <= 0.0:
        return limit_changes(commands, slowness)
    rates = 1.0 / slowness, 1.0 / (slowness * jerk_time_s)
    value, slope, rows = float(commands.value[0]), 0.0, []
    for now_s, end_s, wanted in commands.list_held():
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
    largest rate the input rises no further. `slowness` is the time for a unit change [s^2/m or
    s^2/rad]; 0 for no limit. `most` is the largest rate for a gain of 1 [m/s or rad/s].
    """
    lag_s = max(lag_s, _LEAST_LAG_S)
    ahead = lag_s / slowness if slowness > 0.0 else math.inf
    rate, rows = float(commands.value[0]), []
    for begin_s, end_s, value in commands.list_held():
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


class HeldResponse:
    """The displacement of a robot with given time constants and a gain of 1.

    The response to several inputs, the wheels' commands, is the mean of the responses to each.
    """

    def __init__(
        self, inputs: Sequence[HeldInput], lag_s: float, product_s2: float = 0.0, drift: float = 0.0
    ) -> None:
        """Store inputs, sum b [s] and product c [s^2] of the time constants, and an added rate."""
        self._inputs, self._drift = inputs, drift
        self._lag_s, self._product_s2 = lag_s, product_s2
        split = _split(lag_s, product_s2)
        self._parts = [
            [(share, lag, _list_transients(one, lag)) for share, lag in split] for one in inputs
        ]

    def place(self, time_s: Values) -> tuple[Values, list[Places]]:
        """Return times minus the dead time [s], and where they are among the inputs."""
        return time_s, [commands.place(time_s) for commands in self._inputs]

    def evaluate(self, heard: tuple[Values, list[Places]]) -> tuple[Values, Values]:
        """Return the integral of the rate, up to a constant, and the rate itself."""
        time_s, places = heard
        responses = [*map(self._respond, places, self._parts)]
        way, rate = responses[0] if len(responses) == 1 else np.mean(responses, axis=0)
        if self._drift:
            return way + self._drift * time_s, rate + self._drift
        return way, rate

    def _respond(
        self, places: Places, parts: Sequence[tuple[Any, Any, NDArray[Any]]]
    ) -> tuple[Values, Values]:
        # Rate after all transients have faded: on a ramp it lags by the time constant.
        rate = places.value - self._lag_s * places.slope
        way = places.way - self._lag_s * rate - self._product_s2 * places.slope
        for share, lag, transients in parts:
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
    """Return the initial difference between the rate of a first-order lag and each command."""
    # Each difference decays by a factor until the next command, which adds a new difference. This
    # linear recurrence is solved by doubling.
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


_LEAST_TIGHTNESS: Final = 1e-6
"""Reciprocal of what stands for no limit of an axis without the other [s/m or s/rad]."""

_LEAST_SLOWNESS: Final = 1e-9  # time for a unit change that stands for none [s^2/m] or [s^2/rad]

Order = Literal[
    "first_order", "second_order",
    "limited_before", "limited_softly", "limited_within", "limited_wheels",
]  # fmt: skip
"""Order of a robot model.

`first_order`: one time constant. `second_order`: two, and their product [s^2]. `limited_before`,
`limited_within`: one, and the time per unit of the command [s^2/m] or [s^2/rad] by a limit of the
change of rate, before the lag (the command becomes a ramp) or within its loop (the rate does).
`limited_softly`: before the lag, also with the time in which the slope builds up [s].
`limited_wheels`: within the loop of each wheel, also with the time per unit of the other axis."""

Bound = Literal["", "command", "rate", "scaled", "clipped", "yielding", "reduced"]

COUPLED: Final[tuple[Bound, ...]] = ("reduced", "scaled", "clipped", "yielding")
"""Bounds of the wheels, which both axes share: a command beyond scales both axes, clips each wheel,
or leaves this axis what the other does not need; or the other axis alone decides by how much this
one is reduced: all that commands of one size show."""

_STEP: Final = 1e-4  # step for derivatives with respect to a further parameter, in its unit
_FINE_STEPS: Final = {"product": 1e-7, "friction": 1e-5}  # same for small parameters

_OF_ORDER: Final = {
    "first_order": (),
    "second_order": ("product",),
    "limited_before": ("slowness",),
    "limited_softly": ("slowness", "jerk_time"),
    "limited_within": ("slowness",),
    "limited_wheels": ("slowness", "slowness_beside"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Structure:
    """The further parameters of a model.

    Attributes:
        order: Order of its lag, and the place of its acceleration limit.
        bound: Limited quantity: command, wheels, or rate, which follows larger commands up to it.
            The parameter is the reciprocal of the command that leads there [s/m or s/rad]; for the
            wheels also that of the other axis.
        has_reverse: Whether the gain of negative commands differs; the parameter is the ratio.
        has_friction: Whether each command is reduced, by the parameter [m/s or rad/s].
        deadband: Magnitude up to which commands cause no motion [m/s or rad/s].
        has_drift: Whether a constant rate is added to the response; the parameter is the command
            that would cause this rate [m/s or rad/s], the only one that may be negative.
    """

    order: Order = "first_order"
    bound: Bound = ""
    has_reverse: bool = False
    has_friction: bool = False
    deadband: float = 0.0
    has_drift: bool = False

    @property
    def is_slow(self) -> bool:
        """Whether commands must be evaluated one by one."""
        return self.order.startswith("limited") or self.bound == "rate"

    @property
    def rounds_by_lag(self) -> bool:
        """Whether the time constant only rounds the ends of ramps, which it otherwise delays."""
        return self.order in {"limited_within", "limited_wheels"}

    @property
    def is_possible(self) -> bool:
        """Whether its parts are compatible: a rate limit needs a first-order lag without ramps.

        A limit of the wheels' acceleration stands alone, because other limits would be the wheels'.
        """
        if self.order == "limited_wheels":
            return self == LIMITED_WHEELS
        return self.bound != "rate" or self.order in {"first_order", "limited_within"}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the further parameters, in order."""
        has = {
            "tightness": bool(self.bound) and self.bound != "reduced",
            "coupling": self.bound in COUPLED,
            "reverse": self.has_reverse,
            "friction": self.has_friction,
            "drift": self.has_drift,
        }
        return (*_OF_ORDER[self.order], *(name for name, is_there in has.items() if is_there))

    @property
    def size(self) -> int:
        """Number of parameters in addition to gain, dead time and time constant."""
        return len(self.names) + (self.deadband > 0.0)

    @property
    def steps(self) -> list[float]:
        """Step sizes for differences with respect to the further parameters."""
        return [_FINE_STEPS.get(name, _STEP) for name in self.names]

    @property
    def bends(self) -> bool:
        """Whether the effective commands depend on the further parameters."""
        return replace(self, has_drift=False) not in {FIRST_ORDER, SECOND_ORDER}

    def respond(
        self, commands: HeldInput, lag_s: float, extras: Sequence[float], beside: HeldInput | None
    ) -> HeldResponse:
        """Return the response to commands for a time constant and the further parameters.

        `beside` are the commands of the other axis; None if they are 0.
        """
        values = dict(zip(self.names, extras, strict=True))
        if self.order == "limited_wheels" and beside is not None:
            inputs = _limit_wheels(commands, lag_s, values, beside)
        else:
            inputs = [self._limit(self._shape(commands, values, beside), lag_s, values)]
        return HeldResponse(inputs, lag_s, values.get("product", 0.0), values.get("drift", 0.0))

    def _shape(
        self, commands: HeldInput, values: Mapping[str, float], beside: HeldInput | None
    ) -> HeldInput:
        if not (self.bound or self.has_reverse or self.has_friction or self.deadband):
            return commands
        coupling: Any = 0.0
        if beside is not None and "coupling" in values:
            commands = _join_times(commands, beside)
            coupling = values["coupling"] * np.abs(beside.place(commands.time_s).value)
        size = np.maximum(np.abs(commands.value) - values.get("friction", 0.0), 0.0)
        value = np.where(commands.value < 0.0, -values.get("reverse", 1.0), 1.0) * size
        value[np.abs(commands.value) <= self.deadband] = 0.0
        tightness = values.get("tightness", 0.0)
        if self.bound in COUPLED:
            # The gain is that of the smallest command, so without the other axis none is smaller.
            smallest = np.abs(value[value != 0.0]).min(initial=math.inf)
            tightness = min(max(tightness, _LEAST_TIGHTNESS), 1.0 / smallest)
        if self.bound != "rate" and tightness > 0.0:
            value = _bound_wheels(self.bound, tightness * value, coupling) / tightness
        return integrate_commands(commands.time_s, value, commands.slope)

    def _limit(self, commands: HeldInput, lag_s: float, values: Mapping[str, float]) -> HeldInput:
        if self.order == "limited_before":
            return limit_changes(commands, values["slowness"])
        if self.order == "limited_softly":
            return limit_softly(commands, values["slowness"], values["jerk_time"])
        if self.order in {"limited_within", "limited_wheels"} or self.bound == "rate":
            tightness = values.get("tightness", 0.0) if self.bound == "rate" else 0.0
            most = 1.0 / tightness if tightness > 0.0 else math.inf
            return limit_within(commands, values.get("slowness", 0.0), lag_s, most)
        return commands


SECOND_ORDER: Final = Structure(order="second_order")
LIMITED_WHEELS: Final = Structure(order="limited_wheels")
FIRST_ORDER: Final = Structure()


def _bound_wheels(bound: Bound, value: Values, beside: Any) -> Values:
    """Return bounded commands, each divided by the largest one without the other axis."""
    if bound in {"scaled", "reduced"}:
        return np.asarray(value / np.maximum(np.abs(value) + beside, 1.0))
    if bound == "clipped":
        wheels = [np.clip(value + way * beside, -1.0, 1.0) for way in (1.0, -1.0)]
        return np.asarray(0.5 * (wheels[0] + wheels[1]))
    most = np.maximum(1.0 - beside, 0.0) if bound == "yielding" else 1.0
    return np.asarray(np.clip(value, -most, most))


def _limit_wheels(
    commands: HeldInput, lag_s: float, values: Mapping[str, float], beside: HeldInput
) -> list[HeldInput]:
    """Return the inputs of both wheels, each with a limit of its acceleration."""
    slowness = max(values["slowness"], _LEAST_SLOWNESS)
    commands = _join_times(commands, beside)
    turns = values["slowness_beside"] / slowness * beside.place(commands.time_s).value
    wheels = (
        integrate_commands(commands.time_s, commands.value + way * turns, commands.slope)
        for way in (-1.0, 1.0)
    )
    return [limit_within(wheel, slowness, lag_s) for wheel in wheels]


def _join_times(commands: HeldInput, beside: HeldInput) -> HeldInput:
    """Return commands of one axis that also change, to the same value, where the other does."""
    time_s = np.union1d(commands.time_s, beside.time_s)
    value = commands.place(time_s).value
    return integrate_commands(time_s, value, np.zeros(len(value)))
