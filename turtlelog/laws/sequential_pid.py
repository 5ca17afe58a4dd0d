"""The sequential law with P, PI, PD or PID control in each loop."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Final, Literal

from msgspec import Meta

from turtlelog.laws.base import Goal
from turtlelog.laws.sequential import PIDGainSchedule
from turtlelog.laws.sequential_p import (
    DECLARATION,
    PART as SEQUENTIAL_P,
    SequentialPParameters,
    declare_loops,
)
from turtlelog.parts import ABSENT_BY_DEFAULT
from turtlelog.run.loops import ControlLoop, Declaration
from turtlelog.run.paths import Path

_STATES: Final[Mapping[str, str]] = {
    "integral_angular": "rad/s",
    "derivative_angular": "rad/s",
    "integral_linear": "m/s",
    "derivative_linear": "m/s",
}
"""States of the integral and derivative terms: their contributions to the commands, with units."""

NonNegative = Annotated[float, Meta(ge=0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class SequentialPIDParameters(SequentialPParameters):
    """Parameters of the sequential PID law, in addition to those of `sequential-p`.

    The default is `clamping`: limits clip most commands of these runs, so an integral without
    anti-windup winds up. Unlike `back-calculation`, `clamping` needs no time constant.

    Attributes:
        ki_angular: Integral gain of the heading loops [1/s^2]; 0: no integral.
        kd_angular: Derivative gain of the heading loops, on the measured turn rate [1]; 0: no
            derivative.
        ki_linear: Integral gain of the position loop [1/s^2]; 0: no integral.
        kd_linear: Derivative gain of the position loop, on the measured speed [1]; 0: no
            derivative.
        derivative_filter_s: Time constant of the derivative's first-order filter [s]; 0: the
            difference of two samples without a filter.
        anti_windup: Behaviour of the integral while the command is clipped. `none`: the integral
            continues. `clamping`: the integral stops if the error would drive the command further
            beyond the limit. `back-calculation`: the integral tracks the clipped command.
        tracking_time_s: Time constant of `back-calculation` [s].
        schedule: Gain schedule, which replaces the constant gains; None: no schedule.
    """

    ki_angular: NonNegative = 0.0
    kd_angular: NonNegative = 0.0
    ki_linear: NonNegative = 0.0
    kd_linear: NonNegative = 0.0
    derivative_filter_s: NonNegative = 0.0
    anti_windup: Literal["none", "clamping", "back-calculation"] = "clamping"
    tracking_time_s: Annotated[float, Meta(gt=0)] = 1.0
    schedule: PIDGainSchedule | None = field(default=None, metadata=ABSENT_BY_DEFAULT)


def declare(parameters: Any, goal: Goal | None, path: Path | None) -> Declaration:
    """Return the loops of `sequential-p` with the gains of this law, and the law's states."""
    del path
    rotate, translate = DECLARATION.loops
    loops = (
        _add_keys(rotate, "angular", parameters.ki_angular, parameters.kd_angular),
        _add_keys(translate, "linear", parameters.ki_linear, parameters.kd_linear),
    )
    base = replace(DECLARATION, loops=loops, states=(*_STATES,), state_units=_STATES)
    return declare_loops(base, goal, parameters.schedule, reorient=parameters.reorient)


def _add_keys(loop: ControlLoop, axis: str, *gains: float) -> ControlLoop:
    """Return a loop of `sequential-p` with the keys of the PID gains."""
    return replace(
        loop,
        integral_gain=f"law.ki_{axis}",
        derivative_gain=f"law.kd_{axis}",
        derivative_filter="law.derivative_filter_s",
        is_proportional=not any(gains),
    )


PART: Final = replace(
    SEQUENTIAL_P,
    name="sequential-pid",
    meaning="Rotate to the goal bearing, then drive, each with u = P + I + D.",
    Parameters=SequentialPIDParameters,
    declare=declare,
)

SequentialPID: Final = PART
"""The sequential PID law as a Python class; `SequentialPID(SequentialPIDParameters(...))` is a
law."""
