"""What a control law is: it reads a pose, answers with a decision, and knows nothing else."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar, Final, Protocol

import msgspec

from turtlelog.run import Phase

ABSENT_BY_DEFAULT: Final[Mapping[str, bool]] = MappingProxyType({"absent_by_default": True})
"""Metadata of a parameter that a scenario's text leaves out while it has its default, so that
adding it to a law changes no file that was written before."""

# msgspec structs instead of dataclasses: the loop makes several per sample, and a frozen
# dataclass costs ten times as much to build.


class Pose(msgspec.Struct, frozen=True, gc=False):
    """Where the turtle is.

    Attributes:
        x_m: World frame [m].
        y_m: World frame [m].
        heading_rad: Counter-clockwise from +x [rad].
    """

    x_m: float
    y_m: float
    heading_rad: float


class Goal(msgspec.Struct, frozen=True, gc=False):
    """Where it should be.

    Attributes:
        x_m: World frame [m].
        y_m: World frame [m].
        heading_rad: Counter-clockwise from +x [rad], None where any will do.
    """

    x_m: float
    y_m: float
    heading_rad: float | None = None


class Decision(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """The answer to one pose, with what it was computed from.

    Attributes:
        speed_m_s: Wanted speed along the heading, before clipping [m/s].
        turn_rate_rad_s: Wanted turn rate, before clipping, counter-clockwise [rad/s].
        phase: Phase in which the command was computed.
        bearing_rad: Goal bearing [rad].
        heading_error_rad: Bearing minus heading [rad].
        error_x_m: Goal minus position, world frame [m].
        error_y_m: Goal minus position, world frame [m].
        world_v_x_m_s: Gain times error before projection [m/s].
        world_v_y_m_s: Gain times error before projection [m/s].
        blocks_ticks: Ticks that the law blocks for before its command goes out.
        ends_phase: Whether the next sample is of another phase. A law that blocks says so here, so
            that a live recording tells of the pause while it lasts.
        stop_reason: Why this is the last sample, in one word; None while it is not.
    """

    speed_m_s: float
    turn_rate_rad_s: float
    phase: Phase
    bearing_rad: float
    heading_error_rad: float
    error_x_m: float
    error_y_m: float
    world_v_x_m_s: float = 0.0
    world_v_y_m_s: float = 0.0
    blocks_ticks: int = 0
    ends_phase: bool = False
    stop_reason: str | None = None


class Law(Protocol):
    """A control law. Clipping, queues and delays are the loop's.

    A law names its parameters: a frozen dataclass whose fields are the keys of a scenario's
    `[law]` table beside `kind`.
    """

    Parameters: ClassVar[type[Any]]

    def __init__(self, parameters: Any, /) -> None:
        """Take the parameters."""
        ...

    def reset(self, start: Pose, goal: Goal) -> None:
        """Begin a run; `start` is the first pose that the controller reads."""
        ...

    def step(self, time_ns: int, pose: Pose) -> Decision:
        """Answer one pose. `time_ns` is the controller's clock [ns], not decreasing."""
        ...
