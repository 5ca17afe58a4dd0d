"""What the loop takes: a scenario as numbers, the functions of its parts, and random numbers.

Each table of a scenario has a dataclass with the numbers among its keys. A word is represented by
its index in its `Literal`. A missing value is NaN, or -1 for a whole number. Other values are left
out.

Effects at one place are chained in order. Arguments are passed by parameter name. The texts that
are compiled here contain only such calls, the same for ordinary Python and compiled code. Random
numbers come in separate streams, so that removing one effect changes no other effect.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from functools import cache, lru_cache
from inspect import signature
from operator import attrgetter
from types import FunctionType, SimpleNamespace
from typing import Any, Final, Literal, NamedTuple, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from turtlelog.arithmetic import begin_row
from turtlelog.effects import EFFECTS
from turtlelog.errors import LawError
from turtlelog.laws import AnyLaw, LawPart
from turtlelog.laws.base import GoalNumbers
from turtlelog.parts import Effect, Place, Plant, PlantPart, Stream
from turtlelog.plants import PLANTS
from turtlelog.run.loops import Declaration
from turtlelog.run.path_pieces import PathNumbers
from turtlelog.scenario import Disturbance, Limits, LoopSettings, Scenario, Sensing, Shaping
from turtlelog.simulate.rows import Progress, Scene

_TABLES: Final[dict[str, Any]] = {
    "loop": LoopSettings,
    "limits": Limits,
    "sensing": Sensing,
    "shaping": Shaping,
    "disturbance": Disturbance,
}

Convert = Callable[[Any], Any]


@dataclass(slots=True)
class NoNumbers:
    """A record without numbers: settings of a law in any Python, which reads its own parameters."""


class Mirror(NamedTuple):
    """A dataclass for the numbers of keys, and the function that reads them from an object."""

    kind: Any
    read: Callable[[Any], Any]


@cache
def mirror(keys: Any) -> Mirror:
    """Return the numbers of a dataclass of keys."""
    hints = get_type_hints(keys)
    found: list[tuple[str, type, Any]] = []
    converts: list[tuple[str, Convert | None]] = []
    for one in fields(keys):
        kind, convert = _find_number(hints[one.name])
        if kind is not None:
            found.append((one.name, kind, dataclasses.field(default=_NONE[kind])))
            converts.append((one.name, convert))
    made = dataclasses.make_dataclass(f"{keys.__name__}Numbers", found, slots=True)

    def read(table: Any) -> Any:
        values = (
            getattr(table, name) if convert is None else convert(getattr(table, name))
            for name, convert in converts
        )
        return made(*values)

    return Mirror(made, read)


_NONE: Final[dict[type, Any]] = {float: math.nan, int: -1, bool: False}


def _find_number(hint: Any) -> tuple[type | None, Convert | None]:
    """Return the numeric type of a key, and the function that converts its value."""
    choices = [one for one in get_args(hint) if one is not type(None)]
    if get_origin(hint) is Literal:
        return int, choices.index
    if hint in _NONE:
        return hint, (float if hint is float else None)
    if len(choices) == 1 and choices[0] in _NONE:  # Optional type
        kind, none = choices[0], _NONE[choices[0]]
        return kind, lambda value: none if value is None else kind(value)
    return None, None


class Shape(NamedTuple):
    """The dataclasses of a loop's settings and state, nested by part."""

    Settings: type[Any]
    State: type[Any]
    States: type[Any]


@cache
def find_shape(
    law: type[Any], law_numbers: type[Any], plant: PlantPart, states: tuple[str, ...]
) -> Shape:
    """Return the shape of a loop, from the dataclasses of its law's state and numbers."""
    make, tables = dataclasses.make_dataclass, {**_TABLES, "plant": plant.Keys}
    settings: dict[str, Any] = {"scene": Scene, "goal": GoalNumbers, "path": PathNumbers}
    settings |= {name: mirror(keys).kind for name, keys in tables.items()} | {"law": law_numbers}
    state: dict[str, Any] = {"now": Progress, "plant": plant.State, "law": law}
    state |= {one.name: one.State for one in EFFECTS if one.State is not None}
    return Shape(
        make("Settings", settings.items(), slots=True),
        make("State", state.items(), slots=True),
        find_states(states),
    )


@cache
def find_states(names: tuple[str, ...]) -> type[Any]:
    """Return the dataclass of the recorded states of a law."""
    found = [(name, float, dataclasses.field(default=math.nan)) for name in names]
    return dataclasses.make_dataclass("States", found, slots=True)


def mirror_law(law: AnyLaw) -> Mirror:
    """Return the numbers that a law reads as `settings.law`, from its parameters."""
    if not isinstance(law, LawPart):
        return Mirror(NoNumbers, lambda _: NoNumbers())
    keys: Any = law.Parameters
    return Mirror(law.Numbers or mirror(keys).kind, law.prepare or mirror(keys).read)


def build_settings(
    scenario: Scenario, law: AnyLaw, declaration: Declaration, plant: Plant
) -> tuple[Shape, Any, Any]:
    """Return the shape of a loop, its settings, and its initial state; the law is resolved."""
    part, goal, start = PLANTS[scenario.plant.kind], scenario.goal, scenario.start
    state_kind: Any = law.State if isinstance(law, LawPart) else NoNumbers
    shape = find_shape(state_kind, mirror_law(law).kind, part, declaration.states)
    keys, place = scenario.plant.keys, (start.x_m, start.y_m, start.heading_rad)
    settings = shape.Settings(
        build_scene(scenario, law, declaration, plant),
        GoalNumbers(goal.x_m, goal.y_m, math.nan if goal.heading_rad is None else goal.heading_rad),
        PathNumbers() if scenario.path is None else scenario.path.numbers,
        *(mirror(table).read(getattr(scenario, name)) for name, table in _TABLES.items()),
        mirror(part.Keys).read(keys),
        mirror_law(law).read(scenario.law.parameters),
    )
    state = shape.State(
        Progress(waits_for=scenario.loop.start_backlog),
        part.begin(keys, *place, is_rounded=start.precision == "float32"),
        state_kind(),
        *(one.State() for one in EFFECTS if one.State is not None),
    )
    return shape, settings, state


def build_scene(scenario: Scenario, law: AnyLaw, declaration: Declaration, plant: Plant) -> Scene:
    """Return the values that the loop itself reads from a scenario."""
    loop = scenario.loop
    tick_ns = scenario.plant.facts.period_ns
    duration_ns = round(scenario.max_duration_s * 1e9)
    delays_poses = loop.period_s is not None or scenario.has_action("pose_travel")
    newest_only = loop.queue_policy == "newest"
    return Scene(
        period_ns=plant.period_ns,
        period_s=plant.period_s,
        tick_ns=tick_ns,
        block=tick_ns if delays_poses else plant.steps_per_tick,
        watchdog_ns=float(plant.watchdog_ns),
        last_tick=duration_ns // plant.period_ns,
        end_ns=duration_ns + 1,
        timer_ns=round((loop.period_s or 0.0) * 1e9),
        first_s=loop.period_s or loop.period_ticks * plant.period_ns / 1e9,
        # turtlesim applies a command to the time since its last pose. A robot cannot: its commands
        # of a period have arrived at the period's start.
        causal_ns=0 if plant.acts_in_steps else 1 - plant.period_ns,
        is_exact=loop.pose_precision == "float64",
        newest_only=newest_only,
        is_timed=needs_time(scenario),
        acts_in_steps=plant.acts_in_steps,
        acts_on_arrival=newest_only and not plant.acts_in_steps,
        delays_poses=delays_poses,
        senses=scenario.has_action("sense", "lose_pose"),
        is_pushed=scenario.has_action("push"),
        shapes=scenario.has_action("shape"),
        has_goal=declaration.uses_goal,
        has_reference=isinstance(law, LawPart) and law.needs_path,
        has_states=bool(declaration.states),
    )


def needs_time(scenario: Scenario) -> bool:
    """Return whether command delays are in nanoseconds instead of whole ticks."""
    return (
        not scenario.plant.facts.acts_in_steps
        or scenario.loop.trigger == "timer"
        or scenario.has_action("pose_travel", "lose_command", "command_travel", "repeat")
    )


def list_acting(scenario: Scenario) -> tuple[Effect, ...]:
    """Return the effects that act in a scenario."""
    return tuple(effect for effect in EFFECTS if effect.actions and effect.acts(scenario))


def bound_rows(scenario: Scenario, plant: Plant) -> tuple[int, int]:
    """Return the largest possible numbers of ticks and of samples in a run."""
    ticks = round(scenario.max_duration_s * 1e9) // plant.period_ns + 1
    period_s = scenario.loop.period_s
    return ticks, ticks if period_s is None else int(scenario.max_duration_s / period_s) + 2


PLACES: Final[tuple[Place, ...]] = get_args(Place)

OF_TICKS: Final = frozenset({"lose_pose", "sense", "pose_travel", "push"})
"""Places whose events are poses; at all other places, events are samples."""

_AT_PLACES: Final = {
    "settings": "settings",
    "state": "state.{effect}",
    "drawn": "rows.{drawn}[number].{stream}",
    "value": "value",
    "dt_s": "extra",
    "time_ns": "extra",
    "period_ns": "settings.scene.period_ns",
}
_OF_LAW: Final = {
    "settings": "settings",
    "state": "state.law",
    "table": "rows.table",
    "pieces": "rows.pieces",
    "row": "row",
    "time_ns": "time_ns",
    "pose": "pose",
}
"""Arguments of a law's step by the names of its parameters."""

Function = Callable[..., Any]


class Parts(NamedTuple):
    """The functions that the loop calls: of the law, of the plant, and of the effects by place."""

    decide: Function
    record: Function
    hold: Function
    apply_push: Function
    move: Function
    read: Function
    lose_pose: Function
    pose_travel: Function
    sense: Function
    shape: Function
    limit: Function
    lose_command: Function
    command_travel: Function
    repeat: Function
    push: Function
    next_push: Function


def name_stream(effect: Effect, place: Place) -> str:
    """Return the name of a stream's rows of random numbers."""
    return f"{effect.name}_{place}"


def bind_parts(
    plant: PlantPart, decide: Function, record: Function, effects: Iterable[Effect]
) -> Parts:
    """Return the functions of a loop: one for each place, from the effects that act there."""
    chosen = tuple(effects)
    return Parts(
        decide=decide,
        record=record,
        hold=plant.hold,
        apply_push=plant.push,
        move=plant.move,
        read=plant.read,
        **{place: _chain(place, chosen) for place in PLACES},
    )


@lru_cache(maxsize=256)
def _chain(place: Place, effects: tuple[Effect, ...]) -> Function:
    """Return a function that applies the effects at a place to a value, in order."""
    lines, names = [], {}
    for effect in effects:
        if place not in effect.actions:
            continue
        drawn = "drawn_ticks" if place in OF_TICKS else "drawn_samples"
        words = {"effect": effect.name, "stream": name_stream(effect, place), "drawn": drawn}
        step = effect.actions[place].step
        lines.append(f"    value = do_{effect.name}({_list_arguments(step, _AT_PLACES, **words)})")
        names[f"do_{effect.name}"] = step
    head = f"def {place}(settings, state, rows, number, extra, value):"
    return compile_text(place, [head, *lines, "    return value"], names)


@lru_cache(maxsize=64)
def bind_step(step: Function) -> Function:
    """Return the function that calls the step of a law that is a part."""
    if unknown := [name for name in signature(step).parameters if name not in _OF_LAW]:
        code = step.__code__
        place = f"{code.co_filename}, line {code.co_firstlineno}: {step.__qualname__}"
        raise LawError(
            f"{place}: expected parameters among {', '.join(_OF_LAW)}, found {unknown[0]}"
        )
    call = f"    return step({_list_arguments(step, _OF_LAW)})"
    head = "def decide(settings, state, rows, row, time_ns, pose):"
    return compile_text("decide", [head, call], {"step": step})


@lru_cache(maxsize=64)
def bind_states(states: tuple[str, ...]) -> Function:
    """Return a function that records the states of a law and returns whether all are finite."""
    lines = ["def record(state, rows, number):"]
    if states:
        lines.append("    row = begin_row(rows.states, rows.new[0].states, number)")
        lines += [f"    row.{name} = state.{name}" for name in states]
    known = " and ".join(f"math.isfinite(state.{name})" for name in states)
    lines.append(f"    return {known or True}")
    return compile_text("record", lines, {"begin_row": begin_row, "math": math})


def _list_arguments(step: Function, known: dict[str, str], **words: str) -> str:
    return ", ".join(known[name].format(**words) for name in signature(step).parameters)


def compile_text(name: str, lines: list[str], names: dict[str, Any]) -> Function:
    """Return the function in source lines; it calls other functions by name."""
    scope: dict[str, Any] = {**names, "__name__": __name__}
    text = "\n".join(lines)
    exec(compile(text, f"<{name} of the loop>", "exec"), scope)
    made: FunctionType = scope[name]
    made.source = text  # type: ignore[attr-defined]
    return made


# Random numbers.


_PLACED: Final = [
    (name_stream(effect, place), place, action.stream)
    for effect in EFFECTS
    for place, action in effect.actions.items()
    if action.stream is not None
]

STREAMS: Final[Mapping[str, Stream]] = {name: one for name, _, one in _PLACED}
"""Streams of random numbers by the names of their rows in the loop."""

RANDOM_KEYS: Final[frozenset[str]] = frozenset(
    key for stream in STREAMS.values() for key in stream.keys
)
"""Scenario keys with random effects."""

_READ: Final = {name: tuple(map(attrgetter, one.keys)) for name, one in STREAMS.items()}

_BLOCK: Final = 256  # number of events whose random numbers are drawn at once


def list_streams(scenario: Scenario) -> frozenset[str]:
    """Return the names of the streams that a scenario uses."""
    return frozenset(name for name, keys in _READ.items() if any(read(scenario) for read in keys))


@cache
def build_row(stream: Stream) -> type[Any]:
    """Return the dataclass of the random numbers of a stream for one event."""
    found = [(name, float, dataclasses.field(default=0.0)) for name in stream.fields]
    return dataclasses.make_dataclass("Drawn", found, slots=True)


@cache
def list_of(*, ticks: bool) -> tuple[str, ...]:
    """Return the names of the streams whose events are poses, or samples."""
    return tuple(name for name, place, _ in _PLACED if (place in OF_TICKS) == ticks)


@cache
def build_events(*, ticks: bool) -> type[Any]:
    """Return the dataclass of the numbers of all streams for one pose, or for one sample."""
    rows = {name: build_row(STREAMS[name]) for name in list_of(ticks=ticks)}
    found = [(name, row, dataclasses.field(default_factory=row)) for name, row in rows.items()]
    return dataclasses.make_dataclass("Events", found, slots=True)


class DrawnEvents:
    """The random numbers of the streams for poses, or for samples, by number of the event.

    The streams that a scenario does not use are None.
    """

    __slots__ = ("_event", "_number", "_streams")

    def __init__(self, seed: int, used: frozenset[str], *, ticks: bool) -> None:
        """Start the streams that a scenario uses."""
        names = list_of(ticks=ticks)
        self._event = SimpleNamespace(**dict.fromkeys(names))
        self._streams = [(name, _DrawnRows(seed, STREAMS[name])) for name in names if name in used]
        self._number = -1

    def __getitem__(self, number: int) -> Any:
        """Return the numbers of an event. Later calls cannot go back to earlier events."""
        if number != self._number:
            self._number = number
            for name, rows in self._streams:
                setattr(self._event, name, rows[number])
        return self._event


class _DrawnRows:
    """The random numbers of a stream for every event, used or not, by number of the event."""

    __slots__ = ("_draw", "_first", "_kind", "_rows", "_width")

    def __init__(self, seed: int, stream: Stream) -> None:
        self._draw, self._width = _begin_stream(seed, stream), len(stream.fields)
        self._kind, self._first = build_row(stream), 0
        self._rows: list[Any] = []

    def __getitem__(self, number: int) -> Any:
        while number >= self._first + len(self._rows):
            self._first += len(self._rows)
            drawn = self._draw((_BLOCK, self._width)).tolist()
            self._rows = [self._kind(*row) for row in drawn]
        if number < self._first:
            raise IndexError(f"event {number} comes before {self._first}")
        return self._rows[number - self._first]


def draw_events(seed: int, stream: Stream, events: int) -> NDArray[np.float64]:
    """Return the random numbers of a stream's first events as one array, shape (events, width)."""
    width = len(stream.fields)
    return _begin_stream(seed, stream)((events, width)) if events else np.empty((0, width))


def _begin_stream(seed: int, stream: Stream) -> Callable[[tuple[int, int]], NDArray[np.float64]]:
    sequence = np.random.SeedSequence(entropy=seed, spawn_key=(stream.number,))
    generator = np.random.Generator(np.random.PCG64(sequence))
    return generator.random if stream.kind == "uniform" else generator.standard_normal
