"""The parts of the closed loop: the declarations of a control law, a plant and an effect.

A part is one file. The `step` of a part is a function of numbers in the subset of Python that numba
compiles. Plain Python runs `step` over objects with slots; compiled code runs it over records with
the same fields. `step` reads `settings`, the scenario as numbers, for example
`settings.law.kp_linear` or `settings.sensing.bias_heading_rad`. A word is represented by its
position in its `Literal`, a missing value by NaN or -1.
"""

import dataclasses
import math
import re
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
"""Metadata of a key that a scenario's text omits while the key has its default. Adding such a key
does not change files that were written before."""

MAY_BE_INFINITE: Final[Mapping[str, bool]] = MappingProxyType({"may_be_infinite": True})
"""Metadata of a key for which inf means no limit."""

LARGEST_M: Final = 1e6
"""Largest distance from the origin at which a robot starts or has its goal [m]. A double resolves
0.1 nm there."""

MOST_RAD_S: Final = 1e3
"""Largest disturbance of a turn rate, 160 turns a second [rad/s]. The distance of a robot model is
integrated turn by turn; a larger disturbance would take minutes."""

MOST_S: Final = 1e6
"""Longest time [s]."""

LARGEST_FLOAT: Final = 3.4e38
"""Largest 32-bit float: poses and applied velocities are published as 32-bit floats."""

NEVER_NS: Final = 2**63 - 1
"""A time later than any time of a run."""

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
"""Place where an effect acts, and what its step returns at this place:

- `lose_pose`, `lose_command`: whether a pose or command is lost; `value` is the answer of earlier
  effects.
- `pose_travel`, `command_travel`: time at which the pose or command arrives [ns].
- `sense`: the pose that the controller reads.
- `shape`, `limit`: the command (speed, turn rate) after shaping or after the limits; `dt_s` is the
  time since the last command [s].
- `repeat`: how often a command arrives.
- `push`: disturbance of the plant's speed and turn rate in the step to a tick; `time_ns` is a time
  in this step, `period_ns` the length of the step.
- `next_push`: the next time after `time_ns` at which the disturbance changes within a step [ns].

`dt_s` is known only at `shape` and `limit`, `time_ns` only at `push` and `next_push`. A step at
`sense` gets neither the tick nor the time; an effect that needs them there counts poses in its
state.
"""

Complaint = tuple[str, str, str]
"""A wrong key, what was expected, and what was found."""


def load_parts(package: str, files: tuple[str, ...]) -> Any:
    """Return the `PART` of each file of a package."""
    return tuple(import_module(f"{package}.{name}").PART for name in files)


def absent(default: Any, *, may_be_infinite: bool = False) -> Any:
    """Return a field that files omit while the field has its default."""
    infinite = MAY_BE_INFINITE if may_be_infinite else {}
    return field(default=default, metadata={**ABSENT_BY_DEFAULT, **infinite})


@dataclass(frozen=True, slots=True, kw_only=True)
class Stream:
    """Random numbers of an effect, drawn for every event, used or not.

    Attributes:
        number: Number of this stream alone. The number and the seed determine all drawn values.
        kind: `uniform`: from 0 to below 1; `normal`: mean 0, standard deviation 1.
        fields: Names of the numbers of one event.
        keys: Keys of the scenario. If all keys are 0, no number of the stream is used.
        is_chance: Whether the keys are probabilities. If all keys are 1, the seed changes nothing.
    """

    number: int
    kind: Literal["uniform", "normal"]
    fields: tuple[str, ...]
    keys: tuple[str, ...]
    is_chance: bool = False


def draw_chance(number: int, key: str) -> Stream:
    """Return a stream for events with the probability of a key, one number for each event."""
    return Stream(number=number, kind="uniform", fields=("chance",), keys=(key,), is_chance=True)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Action:
    """Action of an effect at one place.

    Attributes:
        step: Function of numbers. The arguments are chosen by the names of the parameters:
            `settings`, `state` (of the effect), `drawn` (random numbers), `value`, and the values
            of the place. The function returns the new value; with neutral keys, the received value.
        stream: Random numbers of the action.
        keys: Keys of which at least one must differ from its neutral value for the action to act;
            (): any key of the effect.
    """

    step: Callable[..., Any]
    stream: Stream | None = None
    keys: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Effect:
    """An effect between law and plant. Effects that the loop itself computes have no actions.

    Attributes:
        name: Name of the effect, its state and its random numbers.
        tables: Keys with defaults, bounds and units: a frozen dataclass for each table of a
            scenario.
        actions: Actions by place.
        State: A dataclass with slots and defaults: the memory of the effect.
        causes: Causes that the effect adds to the ideal loop, for `explain`.
        modelled: Keys that theory models, and keys without influence on the loop.
        added: Keys that theory ignores and that cannot make an unstable loop stable.
        judge: Function that yields keys which contradict other keys of a scenario.
        notes: Function that yields sentences on settings without any effect.
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
        """Neutral values of the keys, with which the effect does nothing."""
        return {key: value for one in self.causes for key, value in one.neutral.items()}

    def acts(self, scenario: Any) -> bool:
        """Return whether a scenario has this effect: one of the keys is not neutral."""
        return any(read(scenario) != value for read, value in _list_neutral(self, None))

    def acts_at(self, place: Place, scenario: Any) -> bool:
        """Return whether a scenario has the action of this effect at a place."""
        return any(read(scenario) != value for read, value in _list_neutral(self, place))


@cache
def _list_neutral(
    effect: Effect, place: Place | None
) -> tuple[tuple[Callable[[Any], object], object], ...]:
    """Return readers of the keys of an effect, or of its action at a place, with neutral values."""
    # The result is cached, because every run needs it.
    neutral = effect.neutral
    keys = () if place is None else effect.actions[place].keys
    return tuple((attrgetter(key), neutral[key]) for key in keys or neutral)


Dynamics = Literal["integrator", "first-order", "other"]
"""How the rates of a plant follow its commands:

- `integrator`: each rate is the held command, so heading and distance are its integral, 1/s.
- `first-order`: each rate follows with the gain, dead time, time constant and limits in the keys
  `speed_gain`, `turn_lag_s` and so on of `plants/lagged.py`.
- `other`: in another way, of which theory has no model.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Plant:
    """The facts of a plant that the loop around it needs.

    Attributes:
        name: Name of the plant in texts for users.
        period_ns: Duration of one step [ns].
        low_m: Smallest allowed coordinate of start and goal [m].
        high_m: Largest allowed coordinate of start and goal [m].
        acts_in_steps: Whether a command or disturbance acts on the whole step in which it arrives;
            one command is taken per step. Otherwise both act from their time of arrival.
        turns_first: Whether each step turns the robot, then moves it along the new heading.
            Otherwise the robot turns while it moves, along an arc if its rates are constant.
        holds_rates: Whether the rates are constant within a step, so that a pose reports the rates
            of the step before it. Otherwise a pose reports the rates at its time.
        dynamics: How the rates follow the commands.
        watchdog_ns: Time after the last taken command beyond which the plant stops, for any period
            [ns]; inf: the plant never stops.
        has_live_logs: Whether others log this plant, with the jitter of a wall clock. Otherwise
            only simulations have it, on their exact clock.
        steps_per_tick: Number of steps per tick of the original plant; 1 unless the clock is finer.
    """

    name: str
    period_ns: int
    low_m: float
    high_m: float
    acts_in_steps: bool
    turns_first: bool
    holds_rates: bool
    dynamics: Dynamics
    watchdog_ns: float = math.inf
    has_live_logs: bool = False
    steps_per_tick: int = 1

    @property
    def period_s(self) -> float:
        """Duration of one step [s]."""
        return self.period_ns / 1e9

    def refine(self, times: int) -> "Plant":
        """Return the same plant with a clock that is finer by a factor."""
        period_ns, rest = divmod(self.period_ns, times)
        if rest:
            raise ValueError(f"expected a divisor of {self.period_ns} ns, found {times}")
        steps = self.steps_per_tick * times
        return dataclasses.replace(self, period_ns=period_ns, steps_per_tick=steps)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlantPart:
    """A kind of plant, as a scenario names it.

    Attributes:
        name: `kind` of the plant in a scenario.
        meaning: Description of the plant in one line.
        Keys: Keys of the table `[plant]`: a frozen dataclass.
        find_facts: Function of the keys that returns the facts that the loop needs.
        State: A dataclass with slots and defaults: the memory of the plant, including `hit_wall`.
            If it has `waiting_first`, earlier rows of `waiting` are no longer needed.
        Waiting: A dataclass with slots and defaults: a command that the plant follows later.
        begin: Function of the keys, x [m], y [m], heading [rad], and whether these are rounded to
            32 bits; returns the state at the start.
        hold: `(settings, state, rows, time_ns, speed, turn_rate)`: accept a command that arrives.
            The plant may add the command to `rows.waiting`, with `begin_row` and
            `rows.new[0].waiting`.
        push: `(settings, state, speed, turn_rate)`: set the disturbance of the rates from now on.
        move: `(settings, state, rows, time_ns)`: move to a time; return False if that is
            impossible.
        read: Function of a state that returns x [m], y [m], heading [rad], magnitude of the
            velocity [m/s] and turn rate [rad/s].
        delays: Keys of delays, which must not be longer than a run.
        causes: Causes for `explain`: optional limits of the plant, with keys that are None without
            a limit.
        added: Keys that theory ignores and that cannot make an unstable loop stable.
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
    Waiting: type | None = None
    delays: tuple[str, ...] = ()
    causes: tuple[Cause, ...] = ()
    added: tuple[str, ...] = ()


def split_key_unit(key: str) -> tuple[str, str]:
    """Return a key without the unit at the end of its name, and the unit; empty if it has none."""
    found = _UNIT.search(key)
    if found is None:
        return key, ""
    unit = found[1].replace("_s", "/s", 1) if found[1] != "s" else "s"
    return key[: found.start()], _POWER.sub(r"^\1", unit)


_UNIT: Final = re.compile(r"_((?:m|rad)(?:_s[23]?)?|s|ticks)$")

_POWER: Final = re.compile(r"(\d)$")
