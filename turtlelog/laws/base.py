"""The interface of control laws: a law reads a pose and answers with a decision."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from inspect import signature
from types import SimpleNamespace
from typing import Any, ClassVar, Final, Protocol

import msgspec

from turtlelog.errors import LawError
from turtlelog.parts import (
    ABSENT_BY_DEFAULT as ABSENT_BY_DEFAULT,
    MAY_BE_INFINITE as MAY_BE_INFINITE,
)
from turtlelog.run.loops import Cause, Declaration
from turtlelog.run.path_pieces import PathNumbers
from turtlelog.run.paths import Path

_NO_TOLERANCE: Final = 1e-6
"""Smallest useful tolerance: one step of a 32-bit pose is 9.5e-7 m near 10 m, 2.4e-7 rad near
pi."""

TOLERANCE: Final = Cause(
    name="tolerance",
    kind="design",
    neutral={"law.heading_tolerance_rad": _NO_TOLERANCE, "law.position_tolerance_m": _NO_TOLERANCE},
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


@dataclass(slots=True)
class GoalNumbers:
    """Goal of the robot; the heading is NaN for any heading."""

    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = math.nan


@dataclass(slots=True)
class LawRow:
    """Values that a law writes for one sample. A value that it does not set is NaN, or 0.

    Attributes:
        phase: Index of the phase in the declaration's `phase_names`.
        blocks_ticks: Number of ticks for which the law blocks before its command is published.
        stop: Why this sample is the last: index into the law's `stops`, from 1; 0: it is not the
            last.
        ends_phase: Whether the next sample belongs to another phase.
        bearing_rad: Goal bearing [rad].
        heading_error_rad: Reference heading minus heading [rad].
        error_x_m: Goal minus position in the world frame [m]; likewise `error_y_m`.
        distance_m: Distance from the pose to the goal [m].
        world_v_x_m_s: Gain times error before projection [m/s]; likewise `world_v_y_m_s`.
        reference_x_m: Reference position [m]; likewise `reference_y_m`.
        reference_heading_rad: Reference heading [rad].
    """

    phase: int = 0
    blocks_ticks: int = 0
    stop: int = 0
    ends_phase: bool = False
    bearing_rad: float = math.nan
    heading_error_rad: float = math.nan
    error_x_m: float = math.nan
    error_y_m: float = math.nan
    distance_m: float = math.nan
    world_v_x_m_s: float = math.nan
    world_v_y_m_s: float = math.nan
    reference_x_m: float = math.nan
    reference_y_m: float = math.nan
    reference_heading_rad: float = math.nan


Row = Sequence[float]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LawPart:
    """A control law as a function of numbers, which runs in plain Python and compiled.

    `step` answers one pose: it writes computed values into `row` and returns the wanted speed [m/s]
    and turn rate [rad/s]. The parameters of `step`, in any order, are chosen by name:

    - `settings`: the scenario as numbers: `settings.law` from `prepare`, `settings.goal` (`x_m`,
      `y_m`, `heading_rad`; NaN without a goal), `settings.limits`, `settings.path`;
    - `state`: memory of the law, a new `State` for each run; `row`: a `LawRow`;
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
        return _build_class(self)(parameters)

    def __mro_entries__(self, bases: tuple[object, ...]) -> tuple[type["AskedLaw"]]:
        """Let a law that is a class inherit from this part: `class Mine(SequentialP)`."""
        del bases
        return (_build_class(self),)


AnyLaw = LawPart | type[Law]
"""A law in either form: a part, or a class."""


class AskedLaw:
    """A law with its parameters. Each part has a subclass of its own.

    Attributes:
        parameters: Parameters of the law.
    """

    Parameters: ClassVar[type[Any]]
    _part: ClassVar[LawPart]

    def __init__(self, parameters: Any) -> None:
        """Store the parameters. Without `take_limits`, commands are not clipped."""
        part, self.parameters = self._part, parameters
        numbers = parameters if part.prepare is None else part.prepare(parameters)
        self._settings = SimpleNamespace(law=numbers, goal=GoalNumbers(), path=PathNumbers())
        self.take_limits(math.inf, math.inf)
        self._table = () if part.build_table is None else part.build_table(parameters)
        self._names = [*signature(part.step).parameters]

    def take_limits(self, speed_m_s: float, turn_rate_rad_s: float) -> None:
        """Set the limits at which the loop clips the commands."""
        limits = SimpleNamespace(speed_m_s=speed_m_s, turn_rate_rad_s=turn_rate_rad_s)
        self._settings.limits = limits

    def reset(self, start: Pose, goal: Goal | None, path: Path | None) -> None:
        """Begin a run; raise a LawError if the law needs a goal or a path that is missing."""
        del start
        declaration = self._part.declare(self.parameters, goal, path)
        if declaration.uses_goal and goal is None:
            raise LawError("the law needs a goal: set goal.x_m and goal.y_m")
        if goal is not None:
            heading_rad = math.nan if goal.heading_rad is None else goal.heading_rad
            self._settings.goal = GoalNumbers(goal.x_m, goal.y_m, heading_rad)
        self._settings.path = PathNumbers() if path is None else path.numbers
        self._pieces = () if path is None else path.ways
        self._phases, self._states = declaration.phase_names, declaration.states
        self._state = self._part.State()

    def step(self, time_ns: int, pose: Pose) -> Decision:
        """Answer one pose."""
        row, state = LawRow(), self._state
        given = {
            "settings": self._settings,
            "state": state,
            "table": self._table,
            "pieces": self._pieces,
            "row": row,
            "time_ns": time_ns,
            "pose": (pose.x_m, pose.y_m, pose.heading_rad),
        }
        speed, turn_rate = self._part.step(*(given[name] for name in self._names))
        reference = None
        if not math.isnan(row.reference_x_m):
            reference = Pose(row.reference_x_m, row.reference_y_m, row.reference_heading_rad)
        return Decision(
            speed_m_s=speed,
            turn_rate_rad_s=turn_rate,
            phase=self._phases[row.phase],
            bearing_rad=_read_error(row.bearing_rad),
            heading_error_rad=_read_error(row.heading_error_rad),
            error_x_m=_read_error(row.error_x_m),
            error_y_m=_read_error(row.error_y_m),
            world_v_x_m_s=row.world_v_x_m_s,
            world_v_y_m_s=row.world_v_y_m_s,
            states=tuple(getattr(state, name) for name in self._states),
            reference=reference,
            blocks_ticks=row.blocks_ticks,
            ends_phase=row.ends_phase,
            stop_reason=self._part.stops[row.stop - 1] if row.stop else None,
        )


def find_part(law: Any) -> LawPart | None:
    """Return the part that a law with its parameters is; None for any other law."""
    part: LawPart | None = getattr(type(law), "_part", None)
    return part if part is not None and type(law) is _build_class(part) else None


def _read_error(value: float) -> float | None:
    """Return a value that a step wrote, or None if the step did not write it."""
    return None if math.isnan(value) else value


@cache
def _build_class(part: LawPart) -> type[AskedLaw]:
    """Return a class for a part, with the same declarations as a law that is a class."""
    members = {
        "__doc__": part.meaning,
        "__module__": part.step.__module__,
        "_part": part,
        "Parameters": part.Parameters,
        "declare": staticmethod(part.declare),
        "causes": part.causes,
        "counts_samples": part.counts_samples,
        "list_unused": staticmethod(part.list_unused),
    }
    return type(part.name, (AskedLaw,), members)
