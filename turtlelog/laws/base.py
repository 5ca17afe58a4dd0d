"""The interface of control laws: a law reads a pose and answers with a decision."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Final, Protocol

import msgspec

from turtlelog.parts import (
    ABSENT_BY_DEFAULT as ABSENT_BY_DEFAULT,
    MAY_BE_INFINITE as MAY_BE_INFINITE,
)
from turtlelog.run.loops import Cause, Declaration
from turtlelog.run.paths import Path

if TYPE_CHECKING:
    from turtlelog.laws.asked import AskedLaw

_NO_TOLERANCE: Final = 1e-6
"""Smallest useful tolerance: one step of a 32-bit pose is 9.5e-7 m near 10 m, 2.4e-7 rad near
pi."""

TOLERANCE: Final = Cause(
    name="tolerance",
    kind="design",
    neutral={
        "law.heading_tolerance_rad": _NO_TOLERANCE,
        "law.position_tolerance_m": _NO_TOLERANCE,
    },
    meaning=f"tolerances of {_NO_TOLERANCE:g}",
)
"""Names of the two parameters for the tolerances within which a law ends at its goal."""

# msgspec structs instead of dataclasses: the loop makes several per sample, and a frozen
# dataclass costs ten times as much to build.


class Pose(msgspec.Struct, frozen=True, gc=False):
    """Pose of the turtle.

    Attributes:
        x_m: Position along x, world frame [m].
        y_m: Position along y, world frame [m].
        heading_rad: Heading, counter-clockwise from +x [rad].
    """

    x_m: float
    y_m: float
    heading_rad: float


class Goal(msgspec.Struct, frozen=True, gc=False):
    """Goal pose of the turtle.

    Attributes:
        x_m: Position along x, world frame [m].
        y_m: Position along y, world frame [m].
        heading_rad: Heading, counter-clockwise from +x [rad]; None: any heading.
    """

    x_m: float
    y_m: float
    heading_rad: float | None = None


class Decision(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """The answer to one pose, with the values from which it was computed.

    Only the speed and the turn rate are required. The loop computes fields that are None.

    Attributes:
        speed_m_s: Wanted speed along the heading, before clipping [m/s].
        turn_rate_rad_s: Wanted turn rate, before clipping, counter-clockwise [rad/s].
        phase: Phase in which the command was computed; None: the first declared phase.
        bearing_rad: Goal bearing [rad]; None: the bearing from the present position.
        heading_error_rad: Reference heading minus heading [rad]. None: the bearing from the present
            position minus the heading, wrapped.
        error_x_m: Error along x, world frame [m]; None: goal minus position.
        error_y_m: Error along y, world frame [m]; None: goal minus position.
        world_v_x_m_s: Gain times error along x, before projection [m/s]; NaN if the law has no such
            value.
        world_v_y_m_s: Gain times error along y, before projection [m/s]; NaN if the law has no such
            value.
        states: The law's own numbers, in the declared order.
        reference: Reference pose of a law whose reference is `recorded`.
        blocks_ticks: Ticks for which the law blocks before its command is published.
        ends_phase: Whether the next sample belongs to another phase. A law that blocks sets this
            field, so that a live recording shows the pause while the pause lasts.
        stop_reason: Reason why this sample is the last, in one word; None if it is not the last.
    """

    speed_m_s: float
    turn_rate_rad_s: float
    phase: str | None = None
    bearing_rad: float | None = None
    heading_error_rad: float | None = None
    error_x_m: float | None = None
    error_y_m: float | None = None
    world_v_x_m_s: float = math.nan
    world_v_y_m_s: float = math.nan
    states: tuple[float, ...] = ()
    reference: Pose | None = None
    blocks_ticks: int = 0
    ends_phase: bool = False
    stop_reason: str | None = None


class Law(Protocol):
    """A control law. The loop, not the law, clips, queues and delays commands.

    `Parameters`, `__init__`, `reset` and `step` are enough. Optional members:

    - `declare(cls, parameters, goal, path) -> Declaration`, a class method: the loops, phases and
      states of the law. Default: the one phase `control` and no loops.
    - `causes: tuple[Cause, ...]`: what the law adds to the ideal loop. `explain` removes each
      cause.
    - `counts_samples: tuple[str, ...]`: the parameters that count samples; with a finer clock their
      values are scaled up. Without this attribute `explain` does not refine the clock.
    - `list_unused(cls, parameters) -> tuple[str, ...]`, a class method: tables and keys of a
      scenario that the law does not use with these parameters, for example `("path",
      "goal.heading_rad")`. `run` prints a note for each of them that is set.
    - `take_limits(self, speed_m_s, turn_rate_rad_s)`: receives the limits at which the loop clips
      commands, once, before `reset`; inf: no limit. Anti-windup of an integral needs these limits.

    Attributes:
        Parameters: A frozen dataclass whose fields are the keys of a scenario's `[law]` table
            beside `kind`. A field without a default must be set.
    """

    Parameters: ClassVar[type[Any]]

    def __init__(self, parameters: Any, /) -> None:
        """Take the parameters."""
        ...

    def reset(self, start: Pose, goal: Goal | None, path: Path | None) -> None:
        """Begin a run.

        Args:
            start: The first pose that the controller reads.
            goal: Goal of the run; None if the law declares that it uses no goal.
            path: Path from the scenario's table `[path]`; None if the scenario has no path.
        """
        ...

    def step(self, time_ns: int, pose: Pose) -> Decision:
        """Answer one pose. `time_ns` is the controller's clock [ns], which never decreases."""
        ...


Row = Sequence[float]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LawPart:
    """A control law as a function of numbers, which runs in plain Python and compiled.

    `step` answers one pose: it writes computed values into `row` and returns the wanted speed [m/s]
    and turn rate [rad/s]. The parameters of `step`, in any order, are chosen by name:

    - `settings`: the scenario as numbers: `settings.law` from `prepare`, `settings.goal` (`x_m`,
      `y_m`, `heading_rad`; NaN without a goal), `settings.limits`, `settings.path`;
    - `state`: memory of the law, a new `State` for each run; `row`: a `SampleRow`;
    - `time_ns`: the controller's clock [ns]; `pose`: x [m], y [m], heading [rad];
    - `table`: rows from `build_table`; `pieces`: pieces of the path, for functions of
      `path_pieces`.

    Attributes:
        name: Value of `kind` in a scenario.
        meaning: Description in one line.
        Parameters: A frozen dataclass of the law's keys, as for a law that is a class.
        step: Function that answers one pose.
        declare: Function of parameters, goal and path that returns the loops, phases and states.
        State: A dataclass with slots and defaults. The declared states are among its fields.
        stops: Reasons why the law ends a run, in words. `row.stop` is the position in this list,
            from 1.
        causes: Causes that the law adds to the ideal loop; `explain` removes each.
        counts_samples: Names of the parameters that count samples.
        list_unused: Function of the parameters that returns the tables and keys of a scenario that
            the law does not use.
        prepare: Function of the parameters that returns the numbers that `step` reads, as a
            `Numbers` object. Default: the parameters themselves.
        Numbers: A dataclass with slots and defaults; None: `Parameters`.
        build_table: Function of the parameters that returns rows of numbers, all rows of one
            length.
        needs_path: Whether the law runs only on a path.
    """

    name: str
    meaning: str
    Parameters: type[Any]
    step: Callable[..., tuple[float, float]]
    declare: Callable[[Any, Goal | None, Path | None], Declaration]
    State: type[Any]
    stops: tuple[str, ...] = ()
    causes: tuple[Cause, ...] = ()
    counts_samples: tuple[str, ...] | None = None
    list_unused: Callable[[Any], tuple[str, ...]] = lambda _: ()
    prepare: Callable[[Any], Any] | None = None
    Numbers: type[Any] | None = None
    build_table: Callable[[Any], Sequence[Row]] | None = None
    needs_path: bool = False

    def __call__(self, parameters: Any) -> "AskedLaw":
        """Return the law with its parameters, with a method `step` like a law that is a class."""
        from turtlelog.laws.asked import build_class  # only who asks it so needs that

        return build_class(self)(parameters)

    def __mro_entries__(self, bases: tuple[object, ...]) -> tuple[type["AskedLaw"]]:
        """Let a law that is a class inherit from this part: `class Mine(SequentialP)`."""
        from turtlelog.laws.asked import build_class

        del bases
        return (build_class(self),)


AnyLaw = LawPart | type[Law]
"""A law in either form: a part, or a class."""
