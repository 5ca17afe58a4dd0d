"""What beside a dead time and a lag may shape how a robot follows its commands."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal

from turtlelog.identify.held_response import (
    HeldInput,
    LaggedResponse,
    limit_changes,
    limit_within,
    shape_commands,
)

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
            commands = shape_commands(
                commands,
                tightness=values.get("tightness", 0.0) if self.bound == "command" else 0.0,
                reverse=values.get("reverse", 1.0),
                friction=values.get("friction", 0.0),
                deadband=self.deadband,
            )
        if self.order == "limited_before":
            commands = limit_changes(commands, values["slowness"])
        elif self.order == "limited_within" or self.bound == "rate":
            tightness = values.get("tightness", 0.0) if self.bound == "rate" else 0.0
            most = 1.0 / tightness if tightness > 0.0 else math.inf
            commands = limit_within(commands, values.get("slowness", 0.0), lag_s, most)
        return LaggedResponse(commands, lag_s, values.get("product", 0.0))


FIRST_ORDER: Final = Structure()
SECOND_ORDER: Final = Structure(order="second_order")
