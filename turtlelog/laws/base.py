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
"""A pose in 32 bits comes no nearer: one step is 9.5e-7 m near 10 m, and 2.4e-7 rad near pi."""

TOLERANCE: Final = Cause(
    name="tolerance",
    kind="design",
    neutral={
        "law.heading_tolerance_rad": _NO_TOLERANCE,
        "law.position_tolerance_m": _NO_TOLERANCE,
    },
    meaning=f"tolerances of {_NO_TOLERANCE:g}",
)
"""Names of the two parameters within which a law ends at its goal."""

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
        heading_rad: Heading, counter-clockwise from +x [rad], None if any will do.
    """

    x_m: float
    y_m: float
    heading_rad: float | None = None


class Decision(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """The answer to one pose, with what it was computed from.

    A speed and a turn rate are enough; the loop fills in what is None.

    Attributes:
        speed_m_s: Wanted speed along the heading, before clipping [m/s].
        turn_rate_rad_s: Wanted turn rate, before clipping, counter-clockwise [rad/s].
        phase: Phase in which the command was computed; None for the first that is declared.
        bearing_rad: Goal bearing [rad]; None for that from the present position.
        heading_error_rad: Reference heading minus heading [rad]; None for the bearing from the
            present position minus the heading, wrapped.
        error_x_m: Goal minus position, world frame [m]; None for just that.
        error_y_m: Goal minus position, world frame [m]; None for just that.
        world_v_x_m_s: Gain times error before projection [m/s]; NaN if there is no such thing.
        world_v_y_m_s: Gain times error before projection [m/s]; likewise.
        states: The law's own numbers, in the order in which it declares them.
        reference: Reference pose, for a law whose reference is `recorded`.
        blocks_ticks: Ticks for which the law blocks before its command is published.
        ends_phase: Whether the next sample is of another phase. A law that blocks says so here, so
            that a live recording shows the pause while it lasts.
        stop_reason: Reason why this is the last sample, in one word; None if it is not.
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
    """A control law. Clipping, queues and delays are the loop's.

    `Parameters`, `__init__`, `reset` and `step` are enough. What else a law may have:

    - `declare(cls, parameters, goal, path) -> Declaration`, a class method: its loops, phases and
      states. Otherwise it has the one phase `control` and no loops.
    - `causes: tuple[Cause, ...]`: what it adds to the ideal loop; `explain` takes each out.
    - `counts_samples: tuple[str, ...]`: its parameters that count samples, which grow with a finer
      clock; otherwise `explain` leaves the clock as it is.
    - `list_unused(cls, parameters) -> tuple[str, ...]`, a class method: tables and keys of a
      scenario that it does not use with these parameters, as in `("path", "goal.heading_rad")`;
      `run` prints a note where one of them is set. Otherwise there is no note.
    - `take_limits(self, speed_m_s, turn_rate_rad_s)`: receives the limits at which the loop clips
      its commands, once, before `reset`; inf: no limit. An integral that must not wind up needs
      them.

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
            goal: Goal of the run; None if the law declares that it uses none.
            path: Path of the scenario's table `[path]`; None if it has none.
        """
        ...

    def step(self, time_ns: int, pose: Pose) -> Decision:
        """Answer one pose. `time_ns` is the controller's clock [ns], not decreasing."""
        ...


Row = Sequence[float]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LawPart:
    """A control law as a function of numbers, which runs plain and compiled.

    Its `step` answers one pose: it enters into `row` what it computed, and returns the wanted speed
    [m/s] and turn rate [rad/s]. The names of its parameters say what it gets, in any order:

    - `settings`: the scenario as numbers: `settings.law` as `prepare` made it, `settings.goal`
      (`x_m`, `y_m`, `heading_rad`, NaN without one), `settings.limits`, `settings.path`;
    - `state`: what it remembers, a `State` at the begin of a run; `row`: of `SampleRow`;
    - `time_ns`: the controller's clock [ns]; `pose`: x [m], y [m], heading [rad];
    - `table`: as `build_table` made it; `pieces`: of the path, for the functions of `path_pieces`.

    Attributes:
        name: Value of `kind` in a scenario.
        meaning: Description in one line.
        Parameters: A frozen dataclass of its keys, as for a law that is a class.
        step: Function that answers one pose.
        declare: Function of parameters, goal and path that returns its loops, phases and states.
        State: A dataclass with slots and defaults. The states that it declares are fields of it.
        stops: Reasons why it ends a run, in words: `row.stop` is the place in this list, from 1.
        causes: Causes that it adds to the ideal loop; `explain` removes each.
        counts_samples: Names of its parameters that count samples.
        list_unused: Function of the parameters that returns tables and keys of a scenario that it
            does not use.
        prepare: Function of the parameters that returns the numbers that `step` reads, an object of
            `Numbers`. By default the parameters themselves.
        Numbers: A dataclass with slots and defaults; None: `Parameters`.
        build_table: Function of the parameters that returns rows of numbers, all of one length.
        needs_path: Whether it runs only on a path.
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
        """Return the law with its parameters, to be asked pose by pose like one that is a class."""
        from turtlelog.laws.asked import build_class  # only who asks it so needs that

        return build_class(self)(parameters)

    def __mro_entries__(self, bases: tuple[object, ...]) -> tuple[type["AskedLaw"]]:
        """Let a law that is a class inherit from it: `class Mine(SequentialP)`."""
        from turtlelog.laws.asked import build_class

        del bases
        return (build_class(self),)


AnyLaw = LawPart | type[Law]
"""A law in either form: a part, or a class."""
