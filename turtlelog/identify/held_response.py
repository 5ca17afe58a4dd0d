"""The displacement of a robot in response to held commands, and nonlinearities of the response.

rate = exp(-dead_time s) / (c s^2 + b s + 1) of the commands under zero-order hold. Between two
commands the response is a sum of exponentials, so its integral is known at any time: no time grid
is needed, however irregular commands and poses are.
"""

import cmath
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]

_FADED: Final = 1e-18
"""Share of an earlier transient below the resolution of doubles."""

_LEAST_LAG_S: Final = 1e-9
"""Time constant that stands for none [s]: it fades within the resolution of any clock."""

_LEAST_TIGHTNESS: Final = 1e-6
"""Reciprocal of what stands for no limit of an axis without the other [s/m or s/rad]."""

_LEAST_SLOWNESS: Final = 1e-9
"""Time for a unit change that stands for none [s^2/m] or [s^2/rad]."""

_APART: Final = 1e-3
"""Relative difference below which two time constants are separated, because their parts would
cancel. This changes the response by less than a millionth."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Places:
    """Times with the held command at each of them.

    Attributes:
        held: Row of that command, shape (m,).
        since_s: Time since its start [s].
        value: Its value at the time [m/s or rad/s].
        slope: Its rate of change [m/s^2 or rad/s^2]; 0 for a constant command.
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
        slope: Rate of change until the next one, if a limit turns changes into ramps [m/s^2 or
            rad/s^2], shape (n,); otherwise 0.
        way: Integral of the commands up to each of them [m or rad], shape (n,).
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
    """Return held commands without repeated ones.

    Args:
        time_s: Time of each command [s].
        value: Value of each command.
        before: Value before the first command.
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
    return _integrate_commands(time_s.ravel(), value.ravel(), slopes.ravel())


def limit_within(
    commands: HeldInput, slowness: float, lag_s: float, most: float = math.inf
) -> HeldInput:
    """Return the input of a lag for which its rate and acceleration are limited.

    rate' = clip((command - rate) / lag, +-limit) is a lag with the input clip(command, rate +-
    limit lag): a ramp ahead of the rate, until it reaches the command. At the largest rate the
    input rises no further.

    Args:
        commands: Commands to follow.
        slowness: Time for a unit change [s^2/m or s^2/rad]; 0 for no limit.
        lag_s: The time constant [s].
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
    return _integrate_commands(*np.array(rows).T)


def _shape_commands(
    commands: HeldInput,
    structure: "Structure",
    values: Mapping[str, float],
    beside: HeldInput | None,
) -> HeldInput:
    """Return commands after the static nonlinearities of a robot.

    Args:
        commands: Commands to follow.
        structure: Which nonlinearities there are.
        values: Its further parameters by name.
        beside: Commands of the other axis; None if they are 0.
    """
    coupling: Any = 0.0
    if beside is not None and "coupling" in values:
        commands = _join_times(commands, beside)
        coupling = values["coupling"] * np.abs(beside.place(commands.time_s).value)
    size = np.maximum(np.abs(commands.value) - values.get("friction", 0.0), 0.0)
    value = np.where(commands.value < 0.0, -values.get("reverse", 1.0), 1.0) * size
    value[np.abs(commands.value) <= structure.deadband] = 0.0
    tightness = values.get("tightness", 0.0)
    if structure.bound in COUPLED:
        # The gain is that of the smallest command, so without the other axis none is smaller.
        smallest = np.abs(value[value != 0.0]).min(initial=math.inf)
        tightness = min(max(tightness, _LEAST_TIGHTNESS), 1.0 / smallest)
    if structure.bound != "rate" and tightness > 0.0:
        value = _bound_wheels(structure.bound, tightness * value, coupling) / tightness
    return _integrate_commands(commands.time_s, value, commands.slope)


def _bound_wheels(bound: "Bound", value: Values, beside: Any) -> Values:
    """Return bounded commands, each divided by the largest one without the other axis."""
    if bound in {"scaled", "reduced"}:
        return np.asarray(value / np.maximum(np.abs(value) + beside, 1.0))
    if bound == "clipped":
        return np.asarray(
            0.5 * (np.clip(value + beside, -1.0, 1.0) + np.clip(value - beside, -1.0, 1.0))
        )
    most = np.maximum(1.0 - beside, 0.0) if bound == "yielding" else 1.0
    return np.asarray(np.clip(value, -most, most))


def _join_times(commands: HeldInput, beside: HeldInput) -> HeldInput:
    """Return commands of one axis that also change, to the same value, where the other does."""
    time_s = np.union1d(commands.time_s, beside.time_s)
    value = commands.place(time_s).value
    return _integrate_commands(time_s, value, np.zeros(len(value)))


class LaggedResponse:
    """The response of a robot with given time constants and a gain of 1."""

    def __init__(self, commands: HeldInput, lag_s: float, product_s2: float = 0.0) -> None:
        """Prepare the response.

        Args:
            commands: Commands to follow.
            lag_s: Sum of its time constants, b [s].
            product_s2: Product of its time constants, c [s^2]; 0 for first order.
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

    Each difference decays by a factor until the next command, which adds its own. This is a linear
    recurrence, solved by doubling.
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
    """The weighted mean of responses, each some time later.

    Two wheels have a mean speed. A limit of the jerk makes each ramp the mean of later ramps.
    """

    def __init__(self, parts: Sequence[tuple[float, LaggedResponse, float]]) -> None:
        """Take the weight of each response, and its delay [s]."""
        self._parts = parts

    def place(self, time_s: Values) -> list[Places]:
        """Return the commands that are held at each time minus the dead time [s]."""
        return [response.place(time_s - later_s) for _, response, later_s in self._parts]

    def evaluate(self, places: list[Places]) -> tuple[Values, Values]:
        """Return the integral of the rate, up to a constant, and the rate itself."""
        both = [
            weight * np.stack(response.evaluate(place))
            for (weight, response, _), place in zip(self._parts, places, strict=True)
        ]
        way, rate = np.sum(both, axis=0)
        return way, rate


_GAUSS: Final = (
    (0.06943184420297371, 0.17392742256872693),
    (0.33000947820757187, 0.32607257743127307),
    (0.6699905217924281, 0.32607257743127307),
    (0.9305681557970263, 0.17392742256872693),
)
"""Nodes and weights of Gauss and Legendre on [0, 1]."""

Order = Literal[
    "first_order",
    "second_order",
    "limited_before",
    "limited_softly",
    "limited_within",
    "limited_wheels",
]
"""Order of a robot model.

`first_order`: one time constant. `second_order`: two, with their product as a further parameter
[s^2]. `limited_before` and `limited_within`: one time constant and a limit of the change of rate,
before the lag (the command becomes a ramp) or within its loop (the rate does). Their further
parameter is the time per unit of the command [s^2/m] or [s^2/rad]. `limited_softly`: before the
lag, by ramps with a limited jerk; the parameter is the time in which the slope builds up [s].
`limited_wheels`: within the loop of each wheel; the parameter is the time per unit of the other
axis's command, which the same limit of the wheels sets."""

Bound = Literal["", "command", "rate", "scaled", "clipped", "yielding", "reduced"]

COUPLED: Final[tuple[Bound, ...]] = ("reduced", "scaled", "clipped", "yielding")
"""Bounds of the wheels, which both axes share: a command beyond scales both axes, clips each wheel,
or leaves this axis what the other does not need; or the other axis alone decides by how much this
one is reduced: all that commands of one size show."""

_STEPS: Final = MappingProxyType(
    {"product": 1e-7, "slowness": 1e-4, "tightness": 1e-4, "coupling": 1e-4, "reverse": 1e-4}
    | {"friction": 1e-5, "jerk_time": 1e-4, "slowness_beside": 1e-4}
)
"""Steps for derivatives with respect to the further parameters, in their units."""

_OF_ORDER: Final = MappingProxyType(
    {
        "first_order": (),
        "second_order": ("product",),
        "limited_before": ("slowness",),
        "limited_softly": ("slowness", "jerk_time"),
        "limited_within": ("slowness",),
        "limited_wheels": ("slowness", "slowness_beside"),
    }
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Structure:
    """The further parameters of a model.

    Attributes:
        order: Order of its lag, and the place of its acceleration limit.
        bound: Limited quantity: the command, the wheels, or the rate, which follows larger commands
            as without the limit until it reaches it. The parameter is the reciprocal of the command
            that leads there [s/m or s/rad]; for the wheels also that of the other axis.
        has_reverse: Whether the gain of negative commands differs; the parameter is the ratio.
        has_friction: Whether the magnitude of every command is reduced; the parameter is the
            reduction [m/s or rad/s].
        deadband: Magnitude up to which commands cause no motion [m/s or rad/s].
    """

    order: Order = "first_order"
    bound: Bound = ""
    has_reverse: bool = False
    has_friction: bool = False
    deadband: float = 0.0

    @property
    def is_slow(self) -> bool:
        """Whether commands must be evaluated one by one."""
        return self.order.startswith("limited") or self.bound == "rate"

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
        }
        return (*_OF_ORDER[self.order], *(name for name, is_there in has.items() if is_there))

    @property
    def size(self) -> int:
        """Number of parameters in addition to gain, dead time and time constant."""
        return len(self.names) + (self.deadband > 0.0)

    @property
    def steps(self) -> list[float]:
        """Step sizes for differences with respect to the further parameters."""
        return [_STEPS[name] for name in self.names]

    @property
    def bends(self) -> bool:
        """Whether the effective commands depend on the further parameters."""
        return self not in {FIRST_ORDER, SECOND_ORDER}

    def respond(
        self,
        commands: HeldInput,
        lag_s: float,
        extras: Sequence[float],
        beside: HeldInput | None = None,
    ) -> LaggedResponse | MeanResponse:
        """Return the response to commands for a time constant and the further parameters.

        Args:
            commands: Commands to follow.
            lag_s: Time constant [s].
            extras: Values of the further parameters.
            beside: Commands of the other axis; None if they are 0.
        """
        values = dict(zip(self.names, extras, strict=True))
        if self.order == "limited_wheels" and beside is not None:
            return self._respond_wheels(commands, lag_s, values, beside)
        if len(self.names) > len(_OF_ORDER[self.order]) or self.deadband:
            commands = _shape_commands(commands, self, values, beside)
        if self.order in {"limited_before", "limited_softly"}:
            commands = _limit_changes(commands, values["slowness"])
        elif self.order in {"limited_within", "limited_wheels"} or self.bound == "rate":
            tightness = values.get("tightness", 0.0) if self.bound == "rate" else 0.0
            most = 1.0 / tightness if tightness > 0.0 else math.inf
            commands = limit_within(commands, values.get("slowness", 0.0), lag_s, most)
        response = LaggedResponse(commands, lag_s, values.get("product", 0.0))
        if "jerk_time" in values:
            longest_s = values["jerk_time"]
            return MeanResponse([(part, response, longest_s * node) for node, part in _GAUSS])
        return response

    def _respond_wheels(
        self, commands: HeldInput, lag_s: float, values: Mapping[str, float], beside: HeldInput
    ) -> MeanResponse:
        """Return the mean response of both wheels, each with a limit of its acceleration."""
        slowness = max(values["slowness"], _LEAST_SLOWNESS)
        commands = _join_times(commands, beside)
        turns = values["slowness_beside"] / slowness * beside.place(commands.time_s).value
        wheels = [
            _integrate_commands(commands.time_s, commands.value + way * turns, commands.slope)
            for way in (-1.0, 1.0)
        ]
        limited = [limit_within(wheel, slowness, lag_s) for wheel in wheels]
        return MeanResponse([(0.5, LaggedResponse(wheel, lag_s), 0.0) for wheel in limited])


SECOND_ORDER: Final = Structure(order="second_order")

LIMITED_WHEELS: Final = Structure(order="limited_wheels")

FIRST_ORDER: Final = Structure()
