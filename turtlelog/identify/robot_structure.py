"""The further parameters of a robot's model, and its response with them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, Literal

import numpy as np

from turtlelog.identify.held_response import (
    HeldInput,
    HeldResponse,
    LaggedResponse,
    MeanResponse,
    Values,
    integrate_commands,
    limit_changes,
    limit_softly,
    limit_within,
)

_LEAST_TIGHTNESS: Final = 1e-6
"""Reciprocal of what stands for no limit of an axis without the other [s/m or s/rad]."""

_LEAST_SLOWNESS: Final = 1e-9
"""Time for a unit change that stands for none [s^2/m] or [s^2/rad]."""

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
lag, by S-curves with a limited jerk; the parameter is the time in which the slope builds up [s].
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
    ) -> HeldResponse:
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
        if self.order == "limited_before":
            commands = limit_changes(commands, values["slowness"])
        elif self.order == "limited_softly":
            commands = limit_softly(commands, values["slowness"], values["jerk_time"])
        elif self.order in {"limited_within", "limited_wheels"} or self.bound == "rate":
            tightness = values.get("tightness", 0.0) if self.bound == "rate" else 0.0
            most = 1.0 / tightness if tightness > 0.0 else math.inf
            commands = limit_within(commands, values.get("slowness", 0.0), lag_s, most)
        return LaggedResponse(commands, lag_s, values.get("product", 0.0))

    def _respond_wheels(
        self, commands: HeldInput, lag_s: float, values: Mapping[str, float], beside: HeldInput
    ) -> MeanResponse:
        """Return the mean response of both wheels, each with a limit of its acceleration."""
        slowness = max(values["slowness"], _LEAST_SLOWNESS)
        commands = _join_times(commands, beside)
        turns = values["slowness_beside"] / slowness * beside.place(commands.time_s).value
        wheels = [
            integrate_commands(commands.time_s, commands.value + way * turns, commands.slope)
            for way in (-1.0, 1.0)
        ]
        limited = [limit_within(wheel, slowness, lag_s) for wheel in wheels]
        return MeanResponse([LaggedResponse(wheel, lag_s) for wheel in limited])


SECOND_ORDER: Final = Structure(order="second_order")

LIMITED_WHEELS: Final = Structure(order="limited_wheels")

FIRST_ORDER: Final = Structure()


def _shape_commands(
    commands: HeldInput,
    structure: Structure,
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
    return integrate_commands(commands.time_s, value, commands.slope)


def _bound_wheels(bound: Bound, value: Values, beside: Any) -> Values:
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
    return integrate_commands(time_s, value, np.zeros(len(value)))
