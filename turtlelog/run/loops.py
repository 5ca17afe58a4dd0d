"""The declaration of a control law: its loops, phases, states and causes; and its JSON text."""

import math
import re
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields
from functools import partial
from types import MappingProxyType
from typing import Any, Final, Literal

import msgspec

from turtlelog.errors import LogError, RunError

PAUSE: Final = "pause"
"""Phase of every law: from the last sample of a phase to the next answered sample."""

DONE: Final = "done"
"""Phase of every law after the end of the run."""

REFERENCES: Final[Mapping[str, tuple[str, ...]]] = {
    "heading": ("goal_bearing", "bearing_now", "goal_heading", "zero", "path", "recorded"),
    "along_track": ("goal_distance", "zero", "path", "recorded"),
    "cross_track": ("zero", "path", "recorded"),
    "distance": ("zero", "recorded"),
}
"""References that each controlled signal can have.

- `goal_bearing`: the bearing of the goal from the start; `bearing_now`: from the present position.
- `goal_heading`: the heading of the goal pose.
- `goal_distance`: the distance from start to goal.
- `path`: the path that the law tracks. The reference is the path's direction, the arc length where
  the robot should be now, or the path itself for the cross-track error. Each sample records the
  path point where the robot should be: by time, or else the nearest point.
- `recorded`: the reference pose that each sample records: the heading, or the projection on the
  line from start to goal. The signal `distance` is then the distance to this pose, which should be
  0.
"""

SIGNAL_WORDS: Final[Mapping[str, str]] = {
    "heading": "heading",
    "along_track": "along-track",
    "cross_track": "cross-track",
    "distance": "distance to the goal",
}
"""Words for each controlled signal."""

REFERENCE_WORDS: Final[Mapping[str, str]] = {
    "goal_bearing": "goal bearing",
    "bearing_now": "bearing of the goal",
    "goal_heading": "goal heading",
    "goal_distance": "goal",
    "zero": "zero",
    "path": "path",
    "recorded": "reference",
}
"""Words for each reference in texts and legends."""

COMMAND_WORDS: Final = {"turn_rate": "turn rate", "speed": "speed"}
"""Words for each command, in the order of lists."""

COMMAND_UNITS: Final[Mapping[str, str]] = {"turn_rate": "rad/s", "speed": "m/s"}

MOVING: Final = frozenset({"path", "recorded"})
"""References that the law moves: their loops have tracking metrics instead of step metrics."""

RESERVED: Final = frozenset({"run", "final", PAUSE})
"""Names that no loop may have, because metric ids are `<loop, run or final>.<metric>`."""

SIGNAL_NAMES: Final = frozenset(
    {
        *("x", "y", "heading", "speed", "turn_rate", "wanted_speed", "wanted_turn_rate"),
        *("shaped_speed", "shaped_turn_rate", "applied_speed", "applied_turn_rate"),
        *("measured_speed", "measured_turn_rate", "error_x", "error_y", "distance"),
        *("sensed_x", "sensed_y", "sensed_heading"),
        *("heading_error", "along_track", "cross_track", "phase"),
    }
)
"""Names of signals, which no state of a law may have."""

NAME_PATTERN: Final = r"[A-Za-z][A-Za-z0-9_-]{0,59}"
"""Pattern for names of loops and phases."""

STATE_PATTERN: Final = r"[a-z](?:_?[a-z0-9]){0,59}"
"""Pattern for names of states: valid ROS 2 field names."""

_NAME: Final = re.compile(NAME_PATTERN)
_STATE: Final = re.compile(STATE_PATTERN)
_UNIT: Final = re.compile(r"[A-Za-z0-9%/^*. -]{1,20}")

_KEY: Final = re.compile(r"[A-Za-z0-9_-]+(?:\.[A-Za-z0-9_-]+)+")
_MOST_PHASES: Final = 250  # largest number of phases: a sample records its phase in 8 bits

_MOST_NAMES: Final = 250
"""Largest number of loops or states of a law: each loop has dozens of metrics, each state a
column."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlLoop:
    """One loop of a law.

    Attributes:
        name: Name in metric ids: `rotate`, `translate`, `align`.
        signal: Controlled signal, a key of `REFERENCES`.
        command: Command that acts on the signal: `turn_rate` or `speed`.
        reference: Reference of the signal, one of its entries in `REFERENCES`.
        gain: Scenario key of the proportional gain (`law.kp_angular`); None if the loop has none.
        limit: Scenario key of the command limit; None for the default key of the command.
        is_proportional: Whether the command is only gain times error. The theory of proportional
            loops does not apply to loops with an integral or derivative term (PI, PD, PID).
        integral_gain: Scenario key of the integral gain; None if the loop has none.
        derivative_gain: Scenario key of the derivative gain; None if the loop has none.
        derivative_filter: Scenario key of the time constant of the derivative's first-order filter
            [s]; None if the derivative is not filtered.

    Raises:
        RunError: One line with the field, what was expected and what was found.
    """

    name: str
    signal: str
    command: str
    reference: str
    gain: str | None = None
    limit: str | None = None
    is_proportional: bool = True
    integral_gain: str | None = None
    derivative_gain: str | None = None
    derivative_filter: str | None = None

    def __post_init__(self) -> None:
        _require_name("loop", self.name)
        if self.name in RESERVED:
            taken = ", ".join(sorted(RESERVED))
            raise RunError(f"loop: expected another name than {taken}, found {self.name!r}")
        place = f"loop {self.name}"
        _require_one_of(f"{place}: signal", self.signal, tuple(REFERENCES))
        _require_one_of(f"{place}: command", self.command, tuple(COMMAND_WORDS))
        _require_one_of(f"{place}: reference", self.reference, REFERENCES[self.signal])
        names = ("gain", "limit", "integral_gain", "derivative_gain", "derivative_filter")
        for field_name in names:
            key = getattr(self, field_name)
            if key is not None and not (isinstance(key, str) and _KEY.fullmatch(key)):
                expected = "a key such as law.kp_angular, or None"
                raise RunError(f"{place}: {field_name}: expected {expected}, found {key!r}")
        _require_kind(f"{place}: is_proportional", self.is_proportional, bool, "True or False")

    @property
    def moves(self) -> bool:
        """Whether the law moves the reference."""
        return self.reference in MOVING

    @property
    def is_integrator(self) -> bool:
        """Whether the signal integrates the command, as in theory's loops.

        The integral of a turn rate is a heading; the integral of a speed is an along-track position
        or a distance.
        """
        if self.command == "turn_rate":
            return self.signal == "heading"
        return self.signal in {"along_track", "distance"}

    @property
    def has_theory(self) -> bool:
        """Whether theory describes the loop: an integrator with u = Kp e."""
        return self.is_integrator and self.is_proportional

    @property
    def gain_unit(self) -> str:
        """Unit of the gain: unit of the command divided by unit of the signal."""
        if (self.signal == "heading") == (self.command == "turn_rate"):
            return "1/s"
        return "m/(rad s)" if self.signal == "heading" else "rad/(m s)"

    def read_gain(self, parameters: Mapping[str, object]) -> float | None:
        """Return the gain from a run's parameters; None if the gain is unknown or not positive."""
        kp = None if self.gain is None else parameters.get(self.gain)
        if not isinstance(kp, int | float) or isinstance(kp, bool):
            return None
        return float(kp) if 0.0 < kp < math.inf else None

    @property
    def limit_key(self) -> str:
        """Scenario key of the command's limit."""
        return self.limit or LIMIT_KEYS[self.command]


LIMIT_KEYS: Final[Mapping[str, str]] = {
    "turn_rate": "limits.turn_rate_rad_s",
    "speed": "limits.speed_m_s",
}
"""Scenario keys of the limits of the commands."""

PLANT_KEYS: Final = {"turn_rate": "plant.turn_", "speed": "plant.speed_"}
"""Beginnings of the keys that describe how a robot model follows a command: `gain`, `dead_time_s`,
`lag_s`."""

PUSH_KEYS: Final = tuple(
    f"disturbance.{name}"
    for name in ("speed_m_s", "turn_rate_rad_s", "noise_speed", "noise_turn_rate")
)
"""Keys of disturbances of the plant; there is no disturbance if all of them are 0."""


def read_number(parameters: Mapping[str, object], key: str, default: float = 0.0) -> float:
    """Return a number from the parameters of a run or scenario; the default if it is missing."""
    value = parameters.get(key, default)
    return float(value) if isinstance(value, int | float) else default


def find_disturbance(parameters: Mapping[str, object]) -> tuple[float, float] | None:
    """Return when the plant is disturbed [ns]: the start and, exclusive, the end; None without."""
    if not any(read_number(parameters, key) for key in PUSH_KEYS):
        return None
    from_ns = round(1e9 * read_number(parameters, "disturbance.from_s"))
    to_ns = 1e9 * read_number(parameters, "disturbance.to_s", math.inf)
    return from_ns, round(to_ns) if to_ns < math.inf else to_ns


@dataclass(frozen=True, slots=True, kw_only=True)
class Declaration:
    """Loops, phases and states of a law. The run and the recording contain the declaration.

    Attributes:
        loops: Loops of the law; without loops there are no loop metrics.
        phases: Names of the loops that act in each phase, by phase name, in order; at least one
            phase.
        states: Names of the law's state values, recorded with every sample.
        state_units: Units of the states by name, as in `{"integral": "rad s"}`; 1 for a
            dimensionless number. States without an entry are shown without a unit.
        uses_goal: Whether the law drives to a goal; if False, the run has no goal.

    Raises:
        RunError: One line with the place, what was expected and what was found.
    """

    loops: tuple[ControlLoop, ...] = ()
    phases: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: {"control": ()})
    states: tuple[str, ...] = ()
    state_units: Mapping[str, str] = field(default_factory=dict)
    uses_goal: bool = True
    _hash: int = field(init=False, repr=False, compare=False, default=0)

    def __post_init__(self) -> None:
        _require_kind("phases", self.phases, Mapping, "names of loops by phase")
        _require_kind("uses_goal", self.uses_goal, bool, "True or False")
        phases = {
            name: _list_entries(f"phase {name}", loops) for name, loops in self.phases.items()
        }
        object.__setattr__(self, "phases", MappingProxyType(phases))
        object.__setattr__(self, "loops", _list_entries("loops", self.loops))
        object.__setattr__(self, "states", _list_entries("states", self.states))
        _require_kind("state_units", self.state_units, Mapping, "units by the names of states")
        object.__setattr__(self, "state_units", MappingProxyType({**self.state_units}))
        for loop in self.loops:
            _require_kind("loops", loop, ControlLoop, "a ControlLoop")
        self._require_names()
        # Tables of many runs ask for it a hundred times for each run.
        units = frozenset(self.state_units.items())
        held = self.loops, tuple(phases.items()), self.states, units, self.uses_goal
        object.__setattr__(self, "_hash", hash(held))

    def _require_names(self) -> None:
        names = [loop.name for loop in self.loops]
        _require_distinct("loops", names)
        _require_distinct("states", self.states)
        if not 0 < len(self.phases) <= _MOST_PHASES:
            raise RunError(f"phases: expected 1 to {_MOST_PHASES}, found {len(self.phases)}")
        for phase, loops in self.phases.items():
            _require_name("phase", phase)
            _require_distinct(f"phase {phase}", loops)
            for loop in loops:
                _require_one_of(f"phase {phase}: loop", loop, tuple(names))
        self._require_states()

    def _require_states(self) -> None:
        for state in self.states:
            if not (isinstance(state, str) and _STATE.fullmatch(state)):
                expected = "a field name of ROS 2 such as integral"
                raise RunError(f"state: expected {expected}, found {state!r}")
            if state in SIGNAL_NAMES:
                raise RunError(f"state: expected a name that no signal has, found {state!r}")
        for state, unit in self.state_units.items():
            _require_one_of("state_units", state, self.states)
            if not (isinstance(unit, str) and _UNIT.fullmatch(unit)):
                expected = "a unit such as rad s, up to 20 letters"
                raise RunError(f"state_units: {state}: expected {expected}, found {unit!r:.60}")

    def __hash__(self) -> int:
        return self._hash

    def __reduce__(self) -> tuple[Any, ...]:
        made = partial(Declaration, phases=dict(self.phases), state_units=dict(self.state_units))
        return partial(made, loops=self.loops, states=self.states, uses_goal=self.uses_goal), ()

    @property
    def phase_names(self) -> tuple[str, ...]:
        """Phase names by the index in samples: the declared phases, then the phases of all laws."""
        return (*self.phases, *(name for name in (PAUSE, DONE) if name not in self.phases))

    @property
    def has_reference(self) -> bool:
        """Whether samples record a reference pose."""
        return any(loop.moves for loop in self.loops)

    @property
    def follows_path(self) -> bool:
        """Whether the law tracks the path of the scenario."""
        return any(loop.reference == "path" for loop in self.loops)

    def find_loop(self, name: str) -> ControlLoop | None:
        """Return the loop of this name; None if the law has no such loop."""
        return next((loop for loop in self.loops if loop.name == name), None)

    def list_phases(self, loop: str) -> tuple[str, ...]:
        """Return the phases in which a loop acts, in order."""
        return tuple(phase for phase, loops in self.phases.items() if loop in loops)

    def list_gains(self) -> tuple[str, ...]:
        """Return the scenario keys of the gains: speed loops first, then turn rate loops."""
        loops = sorted(self.loops, key=lambda loop: loop.command != "speed")
        return tuple(dict.fromkeys(loop.gain for loop in loops if loop.gain is not None))

    def list_limits(self, command: str) -> tuple[str, ...]:
        """Return the scenario keys of limits of a command: of its loops, or else the default."""
        keys = [loop.limit_key for loop in self.loops if loop.command == command]
        return tuple(dict.fromkeys(keys)) or (LIMIT_KEYS[command],)


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """An effect or a design parameter of a law or its loop, with the values that remove it.

    Attributes:
        name: Name in explanations: `pause`, `delay`, `saturation`.
        kind: `effect`: an effect of the implementation, which gets a contribution. `design`: a
            design parameter, which every loop of this kind has and which is only removed alone.
        neutral: Values by scenario key that remove the cause: `{"law.pause_ticks": 0}`.
        meaning: Meaning of the run without the cause, in one clause.
    """

    name: str
    kind: Literal["effect", "design"]
    neutral: Mapping[str, object]
    meaning: str


def is_loop_name(text: str) -> bool:
    """Return whether a loop of any law may have this name."""
    return _NAME.fullmatch(text) is not None and text not in RESERVED


def _list_entries(place: str, entries: Any) -> tuple[Any, ...]:
    """Return the entries of a list or tuple. A text is not accepted as a list of letters."""
    _require_kind(place, entries, list | tuple, "a tuple")
    return tuple(entries)


def _require_kind(place: str, value: object, kind: Any, expected: str) -> None:
    if not isinstance(value, kind):
        raise RunError(f"{place}: expected {expected}, found {value!r:.60}")


def _require_name(what: str, name: object) -> None:
    if not (isinstance(name, str) and _NAME.fullmatch(name)):
        expected = "a name of letters, digits, - and _, up to 60"
        raise RunError(f"{what}: expected {expected}, found {name!r}")


def _require_one_of(place: str, value: object, known: tuple[str, ...]) -> None:
    if value not in known:
        expected = f"one of {', '.join(known)}" if known else "none"
        raise RunError(f"{place}: expected {expected}, found {value!r}")


def _require_distinct(place: str, names: Any) -> None:
    if len(names) > _MOST_NAMES:
        raise RunError(f"{place}: expected up to {_MOST_NAMES}, found {len(names)}")
    for name in names:
        if list(names).count(name) > 1:
            raise RunError(f"{place}: expected each name once, found {name!r} twice")


# JSON: in recordings, and in the metadata of tables.

_LONGEST_REASON: Final = 300
"""Largest number of characters in an error line: a found value may be as long as the record."""


_Loop = msgspec.defstruct(
    "_Loop",
    [
        (one.name, one.type, *(() if one.default is MISSING else (one.default,)))
        for one in fields(ControlLoop)
    ],
    forbid_unknown_fields=True,
    omit_defaults=True,
)


class _Phase(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    loops: tuple[str, ...]


class _Entry(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    loops: tuple[_Loop, ...]  # type: ignore[valid-type]
    phases: tuple[_Phase, ...]
    states: tuple[str, ...]
    uses_goal: bool
    state_units: dict[str, str] = {}


def format_declaration(declaration: Declaration) -> str:
    """Return a declaration as JSON; phases are a list because their order matters."""
    entry = _Entry(
        loops=tuple(_Loop(**asdict(loop)) for loop in declaration.loops),
        phases=tuple(_Phase(name=name, loops=of) for name, of in declaration.phases.items()),
        states=declaration.states,
        uses_goal=declaration.uses_goal,
        state_units={**declaration.state_units},
    )
    return msgspec.json.encode(entry).decode()


def parse_declaration(text: str) -> Declaration:
    """Return the declaration in a JSON text; a LogError gives the place of a mistake in it."""
    try:
        entry = msgspec.json.decode(text, type=_Entry)
        declared = Declaration(
            loops=tuple(ControlLoop(**msgspec.structs.asdict(loop)) for loop in entry.loops),
            phases={phase.name: phase.loops for phase in entry.phases},
            states=entry.states,
            state_units=entry.state_units,
            uses_goal=entry.uses_goal,
        )
        _require_distinct("phases", [phase.name for phase in entry.phases])
    except msgspec.MsgspecError as err:
        raise LogError(f"{_shorten(str(err))}, found {text[:60]!r}") from err
    except RunError as err:
        raise LogError(_shorten(str(err))) from err
    return declared


def _shorten(text: str) -> str:
    return text if len(text) <= _LONGEST_REASON else f"{text[: _LONGEST_REASON - 3]}..."
