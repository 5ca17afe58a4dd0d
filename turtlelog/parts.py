"""What the closed loop is made of: the declaration of a control law, a plant and an effect.

A part is one file. Its `step` is a function of numbers in the subset of Python that numba compiles.
It runs plain over objects with slots, and compiled over records of the same fields. It reads
`settings`, the scenario as numbers: `settings.law.kp_linear`, `settings.sensing.bias_heading_rad`.
A word is the number of its place in its `Literal`, a key without a value is NaN or -1.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from operator import attrgetter
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal

from msgspec import Meta

from turtlelog.run.loops import Cause

ABSENT_BY_DEFAULT: Final[Mapping[str, bool]] = MappingProxyType({"absent_by_default": True})
"""Metadata of a key that a scenario's text leaves out while it has its default, so that adding it
changes no file that was written before."""

MAY_BE_INFINITE: Final[Mapping[str, bool]] = MappingProxyType({"may_be_infinite": True})
"""Metadata of a key whose inf means that there is no such limit."""

LARGEST_M: Final = 1e6
"""Farthest from the origin that a robot starts or goes [m]: a double tells 0.1 nm apart there."""

MOST_RAD_S: Final = 1e3
"""Fastest push of a turn rate, 160 turns a second [rad/s]: the way of the lagged robot is
integrated turn by turn, and more would take minutes."""

MOST_S: Final = 1e6
"""Longest time [s]."""

LARGEST_FLOAT: Final = 3.4e38
"""Poses and applied velocities are published as 32-bit floats."""

NEVER_NS: Final = 2**63 - 1
"""Later than any time of a run."""

Probability = Annotated[float, Meta(ge=0.0, le=1.0)]
NotNegative = Annotated[float, Meta(ge=0.0)]
Positive = Annotated[float, Meta(gt=0.0)]
Size = Annotated[float, Meta(ge=0.0, le=LARGEST_M)]
Offset = Annotated[float, Meta(ge=-LARGEST_M, le=LARGEST_M)]
TurnSize = Annotated[float, Meta(ge=0.0, le=MOST_RAD_S)]
TurnOffset = Annotated[float, Meta(ge=-MOST_RAD_S, le=MOST_RAD_S)]
Period = Annotated[float, Meta(ge=0.001, le=1.0)]
Time = Annotated[float, Meta(ge=0.0, le=MOST_S)]
Count = Annotated[int, Meta(ge=1, le=1_000_000)]
Ticks = Annotated[int, Meta(ge=0, le=1_000_000)]

Place = Literal[
    "lose_pose",
    "pose_travel",
    "sense",
    "shape",
    "limit",
    "lose_command",
    "command_travel",
    "repeat",
    "push",
    "next_push",
]
"""Where an effect acts, and what its step returns there:

- `lose_pose`, `lose_command`: whether a pose, or a command, is lost; `value` is what is so before.
- `pose_travel`, `command_travel`: when it arrives [ns].
- `sense`: the pose that is read.
- `shape`, `limit`: the command (speed, turn rate) after shaping, after the limits; `dt_s` is the
  time since the last one [s].
- `repeat`: how often a command arrives.
- `push`: what is added to speed and turn rate of the plant in the step to a tick; `time_ns` is a
  time of that step, `period_ns` its length.
- `next_push`: the next time [ns] after `time_ns` at which that changes within a step.
"""

Complaint = tuple[str, str, str]
"""A key that is wrong, what was expected there, and what was found."""


def load_parts(package: str, files: tuple[str, ...]) -> Any:
    """Return the `PART` of each file of a package."""
    return tuple(import_module(f"{package}.{name}").PART for name in files)


def absent(default: Any, *, may_be_infinite: bool = False) -> Any:
    """Return a field that stays out of a file while it has its default."""
    infinite = MAY_BE_INFINITE if may_be_infinite else {}
    return field(default=default, metadata={**ABSENT_BY_DEFAULT, **infinite})


@dataclass(frozen=True, slots=True, kw_only=True)
class Stream:
    """Random numbers of an effect, drawn for each of its events whether it uses them or not.

    Attributes:
        number: Of this stream alone. It and the seed determine all that is drawn, for good.
        kind: `uniform`: from 0 to below 1; `normal`: of mean 0 and standard deviation 1.
        fields: Names of the numbers of one event.
        keys: The scenario's keys: where all of them are 0, none of its numbers is used.
        is_chance: Whether its keys are probabilities: where they are 1, the seed changes nothing.
    """

    number: int
    kind: Literal["uniform", "normal"]
    fields: tuple[str, ...]
    keys: tuple[str, ...]
    is_chance: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Action:
    """What an effect does at one place.

    Attributes:
        step: A function of numbers. The names of its parameters say what it gets: `settings`,
            `state` (of its effect), `drawn` (its random numbers), `value`, and what belongs to the
            place. It returns the new value; where its keys are neutral, what it got.
        stream: Its random numbers.
        keys: Those of which one must differ from its neutral value for it to act; (): any of the
            effect's.
    """

    step: Callable[..., Any]
    stream: Stream | None = None
    keys: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Effect:
    """What lies between law and plant; of the loop's own settings there are no actions.

    Attributes:
        name: Of its state and of its random numbers.
        tables: Its keys with defaults, bounds and units: a frozen dataclass for each table of a
            scenario.
        actions: By place.
        State: A dataclass with slots and defaults: what it remembers.
        causes: Of `explain`: what it adds to the ideal loop.
        modelled: Keys whose part in the loop theory knows, or that have none.
        added: Keys that theory leaves out, and that make no unstable loop stable.
        judge: Yields the keys that contradict others of a scenario.
        notes: Yields settings that have no effect, in words.
    """

    name: str
    tables: Mapping[str, type]
    actions: Mapping[Place, Action] = field(default_factory=dict)
    State: type | None = None
    causes: tuple[Cause, ...] = ()
    modelled: tuple[str, ...] = ()
    added: tuple[str, ...] = ()
    judge: Callable[[Any], Iterator[Complaint]] | None = None
    notes: Callable[[Any], Iterator[str]] | None = None

    @property
    def neutral(self) -> Mapping[str, object]:
        """Values of its keys without it."""
        return {key: value for one in self.causes for key, value in one.neutral.items()}

    def acts(self, scenario: Any) -> bool:
        """Whether a scenario has it: one of its keys is not neutral."""
        return any(read(scenario) != value for read, value in _list_neutral(self, None))

    def acts_at(self, place: Place, scenario: Any) -> bool:
        """Whether a scenario has what it does at a place."""
        return any(read(scenario) != value for read, value in _list_neutral(self, place))


@cache
def _list_neutral(
    effect: Effect, place: Place | None
) -> tuple[tuple[Callable[[Any], object], object], ...]:
    """Return what reads the keys of an effect, or of what it does at a place, with neutral values.

    Every run asks for them.
    """
    neutral = effect.neutral
    keys = () if place is None else effect.actions[place].keys
    return tuple((attrgetter(key), neutral[key]) for key in keys or neutral)


@dataclass(frozen=True, slots=True, kw_only=True)
class Plant:
    """The facts of a plant that the loop around it needs.

    Attributes:
        name: As people call it.
        period_ns: One step [ns].
        low_m: The least coordinate of start and goal [m].
        high_m: The largest [m].
        watchdog_ns: The plant stops when more than this has passed since it last took a command
            [ns], whatever its period; inf: it never does.
        steps_per_tick: Steps that take as long as one tick of the plant as it is; 1 but for a finer
            clock.
    """

    name: str
    period_ns: int
    low_m: float
    high_m: float
    watchdog_ns: float = math.inf
    steps_per_tick: int = 1

    @property
    def period_s(self) -> float:
        """One step [s]."""
        return self.period_ns / 1e9

    def refine(self, times: int) -> "Plant":
        """Return the same plant with a clock that is so many times finer."""
        period_ns, rest = divmod(self.period_ns, times)
        if rest:
            raise ValueError(f"expected a divisor of {self.period_ns} ns, found {times}")
        steps = self.steps_per_tick * times
        return dataclasses.replace(self, period_ns=period_ns, steps_per_tick=steps)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlantPart:
    """What is driven.

    Attributes:
        name: Its `kind` in a scenario.
        meaning: What it is, in one line.
        Keys: Its keys of the table `[plant]`: a frozen dataclass.
        find_facts: What the loop needs to know, of its keys.
        State: A dataclass with slots and defaults: what it remembers, and `hit_wall`. One with
            `waiting_first` needs no earlier row of `waiting` any more.
        Waiting: A dataclass with slots and defaults: a command that the plant follows later.
        begin: Returns the state at the start: of keys, x [m], y [m], heading [rad], and whether
            these are rounded to 32 bits.
        hold: `(settings, state, rows, time_ns, speed, turn_rate)`: a command arrives. The
            plant may add it to `rows.waiting`, with `begin_row` and `rows.new[0].waiting`.
        push: `(settings, state, speed, turn_rate)`: what is added to its rates from now on.
        move: `(settings, state, rows, time_ns)`: move to a time; False where it cannot.
        read: Returns x [m], y [m], heading [rad], magnitude of the velocity [m/s] and turn rate
            [rad/s] of a state.
        acts_in_steps: Whether a command, and a push, acts on the whole step in which it arrives:
            one is taken each step. Otherwise both act from the time at which they come.
        delays: Its keys that are delays, which last no longer than a run.
        causes: Of `explain`: limits that it may have, by keys that are None without them.
        added: Keys that theory leaves out, and that make no unstable loop stable.
    """

    name: str
    meaning: str
    Keys: type
    find_facts: Callable[[Any], Plant]
    State: type
    begin: Callable[..., Any]
    hold: Callable[..., Any]
    push: Callable[..., Any]
    move: Callable[..., Any]
    read: Callable[..., Any]
    acts_in_steps: bool
    Waiting: type | None = None
    delays: tuple[str, ...] = ()
    causes: tuple[Cause, ...] = ()
    added: tuple[str, ...] = ()
