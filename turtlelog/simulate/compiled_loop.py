"""A loop compiled for a law and a plant, with all effects, from the same sources as in Python.

Numba stores the loop on disk. The name of a loop contains a stamp of all sources. Older versions of
the same parts are removed.
"""

from dataclasses import dataclass, field, make_dataclass
from functools import cache, lru_cache, partial
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlelog.effects import EFFECTS
from turtlelog.laws import LawPart, find_law
from turtlelog.parts import Plant, PlantPart
from turtlelog.run import Run
from turtlelog.run.path_pieces import PathPiece
from turtlelog.run.paths import Path
from turtlelog.run.stop_reasons import TIMEOUT, name_stop
from turtlelog.scenario import Scenario
from turtlelog.simulate import collect, compiled_entry, loop, loop_parts
from turtlelog.simulate.class_law import declare_scenario, is_built_in
from turtlelog.simulate.compiled_twins import (
    TwinError,
    Twins,
    as_record,
    build_dtype,
    compile_entry,
    describe_numba_error,
    stamp_functions,
)
from turtlelog.simulate.rows import EventRow, SampleRow, TickRow, describe_event
from turtlelog.simulate.step_budget import WatchedCode


class Rows(NamedTuple):
    """The arrays of a loop, by their names in `loop`.

    Attributes:
        ticks: Rows of `TICK`.
        samples: Rows of `SAMPLE`.
        states: The law's states for each row of `samples`.
        events: Rows of `EVENT`.
        waiting: Rows of the plant's `Waiting`.
        table: Table of the law, shape (n, k).
        pieces: Pieces of the path, rows of `PIECE`.
        drawn_ticks: Random numbers of each tick.
        drawn_samples: Random numbers of each sample.
        new: A row of each kind with its defaults, shape (1,).
    """

    ticks: NDArray[Any]
    samples: NDArray[Any]
    states: NDArray[Any]
    events: NDArray[Any]
    waiting: NDArray[Any]
    table: NDArray[np.float64]
    pieces: NDArray[Any]
    drawn_ticks: NDArray[Any]
    drawn_samples: NDArray[Any]
    new: NDArray[Any]


PIECE: Final = np.dtype([(name, np.float64) for name in PathPiece._fields if name != "number"])
"""Record type of a `PathPiece`."""

_EVENTS_PER_TICK: Final = 7
"""Largest number of events in a tick: one of each kind, plus a second one of dropped commands,
which are reported with or without a time."""


@dataclass(frozen=True)
class Kinds:
    """The types of a loop's records.

    Attributes:
        settings: Record of the settings.
        state: Record of the state.
        new: A row of each kind with its defaults, shape (1,).
    """

    settings: np.dtype[Any]
    state: np.dtype[Any]
    new: NDArray[Any]

    def allocate(self, ticks: int, samples: int) -> Rows:
        """Return arrays for the given numbers of rows. Unused rows take no memory."""
        return Rows(
            ticks=np.empty(ticks, TICK),
            samples=np.empty(samples, SAMPLE),
            states=np.empty(samples, self.new.dtype["states"]),
            events=np.empty(_EVENTS_PER_TICK * ticks, EVENT),
            waiting=np.empty(2 * samples, self.new.dtype["waiting"]),
            table=np.empty((0, 0)),
            pieces=np.empty(0, PIECE),
            drawn_ticks=np.zeros(ticks, _OF_TICKS),
            drawn_samples=np.zeros(samples, _OF_SAMPLES),
            new=self.new,
        )


TICK, SAMPLE, EVENT = map(build_dtype, (TickRow, SampleRow, EventRow))
_OF_TICKS, _OF_SAMPLES = (build_dtype(loop_parts.build_events(ticks=one)) for one in (True, False))

_STEPS: Final[dict[str, loop_parts.Function]] = {
    "MOVE_PLANT": loop.move_plant,
    "ANSWER": loop.answer_poses,
    "FINISH_TICK": loop.finish_tick,
}
"""Steps that the outermost function calls."""


@lru_cache(maxsize=64)
def find_kinds(law: LawPart, plant: PlantPart, states: tuple[str, ...]) -> Kinds:
    """Return the types of the records of a loop."""
    state: Any = law.State
    shape = loop_parts.find_shape(state, loop_parts.mirror_law(law).kind, plant, states)
    rows: dict[str, type[Any]] = {
        "tick": TickRow,
        "sample": SampleRow,
        "event": EventRow,
        "states": shape.States,
        "waiting": plant.Waiting or loop_parts.NoNumbers,
    }
    fields = [(name, kind, field(default_factory=kind)) for name, kind in rows.items()]
    return Kinds(
        settings=build_dtype(shape.Settings),
        state=build_dtype(shape.State),
        new=as_record(make_dataclass("New", fields, slots=True)()),
    )


@dataclass(frozen=True, eq=False)
class CompiledLoop:
    """A compiled loop.

    Attributes:
        law: Law for which it is compiled.
        name: Name in numba's cache.
        kinds: Types of the loop's records.
        run: Function of settings, state and rows.
    """

    law: LawPart
    name: str
    kinds: Kinds
    run: Any


@cache
def _bind(
    law: LawPart, plant: PlantPart, states: tuple[str, ...]
) -> tuple[Kinds, loop_parts.Parts, str]:
    from importlib.metadata import version

    kinds = find_kinds(law, plant, states)
    decide, record = loop_parts.bind_step(law.step), loop_parts.bind_states(states)
    parts = loop_parts.bind_parts(plant, decide, record, EFFECTS)
    stamp = stamp_functions(
        [*_STEPS.values(), *parts, compiled_entry.run_loop, compiled_entry.run_rows],
        *(kinds.settings, kinds.state, kinds.new.dtype, PIECE, _OF_TICKS, _OF_SAMPLES),
        *(version("numba"), np.__version__),
    )
    return kinds, parts, stamp


def compile_loop(law: LawPart, plant: PlantPart, states: tuple[str, ...]) -> CompiledLoop:
    """Return the compiled loop of a law with its declared states, from numba's cache if possible.

    Raises:
        TwinError: If numba cannot compile the law or a function that it calls.
    """
    from numba import typeof, types
    from numba.core.errors import NumbaError

    kinds, parts, stamp = _bind(law, plant, states)

    def bind(compiler: Any) -> dict[str, Any]:
        twins = Twins(compiler)
        return {
            **{name: twins.compile(step) for name, step in _STEPS.items()},
            "PARTS": loop_parts.Parts(*map(twins.compile, parts)),
            "STAMP": int(stamp[:12], 16),
        }

    signature = types.int64(*map(typeof, _list_examples(kinds)))
    try:
        name = name_loop(law, plant, states)
        run = compile_entry(compiled_entry.run_loop, name, bind, signature)
    except NumbaError as err:
        raise TwinError(describe_numba_error(str(err))) from err
    return CompiledLoop(law, name, kinds, run)


def compile_rows(loop: CompiledLoop, measure: Any, measures: Any) -> Any:
    """Return a compiled function that simulates rows with a loop and measures them.

    `measure` is a compiled function of the type `measures` that measures a row.
    """
    from numba import typeof, types

    settings, states, rows = map(typeof, _list_examples(loop.kinds))
    facts, _, _, line, loops, memory, (asked, values, reasons) = measures.args
    signature = types.int64(
        types.FunctionType(types.int64(settings, states, rows)),
        types.FunctionType(measures),
        types.Tuple([settings, states, line]),
        rows,
        types.Tuple([facts, loops, memory]),
        types.Tuple([asked, values.copy(ndim=2), reasons.copy(ndim=2)]),
    )
    name, stops = loop.name, loop.law.stops
    timeout = stops.index(TIMEOUT) + 1 if TIMEOUT in stops else 0
    scope = {"STAMP": int(name.rpartition("_")[2][:12], 16), "TIMEOUT": timeout}
    made = compile_entry(compiled_entry.run_rows, f"rows_{name}", lambda _: scope, signature)
    return partial(made, loop.run, measure)


def _list_examples(kinds: Kinds) -> tuple[Any, ...]:
    return np.empty(1, kinds.settings), np.empty(1, kinds.state), kinds.allocate(1, 1)


def name_loop(law: LawPart, plant: PlantPart, states: tuple[str, ...]) -> str:
    """Return the name of a loop in numba's cache; TwinError if the law cannot be compiled."""
    stamp = _bind(law, plant, states)[2]
    # A user law may have the name of a built-in one, whose loop must stay in the cache.
    owner = "" if is_built_in(law) else "own_"
    return f"{owner}{law.name}_{plant.name}_{stamp}".replace("-", "_")


class CompiledRunner:
    """Simulations with compiled loops, one scenario after another in the same arrays."""

    def __init__(self, step_budget_s: float | None = None) -> None:
        """Store the time that a user law may compute for one answer [s]; None: unlimited."""
        self._rows: dict[Any, Any] = {}
        self._watched = None if step_budget_s is None else WatchedCode(step_budget_s)

    def simulate(self, loop: CompiledLoop, scenario: Scenario, plant: Plant) -> Run | None:
        """Return the run of a scenario from a loop that supports it.

        The law of the scenario must be resolved. The result is None if the law fails or answers no
        pose; the loop in Python then gives the reason.

        Raises:
            StepBudgetError: If a step of a user law does not return within its budget.
        """
        law, declaration = find_law(scenario.law.kind), declare_scenario(scenario)
        _, settings, start = loop_parts.build_settings(scenario, law, declaration, plant)
        ticks, samples = loop_parts.bound_rows(scenario, plant)
        rows = self._rows.get(loop)
        if rows is None or ticks > len(rows.ticks) or samples > len(rows.samples):
            rows = self._rows[loop] = loop.kinds.allocate(ticks, samples)
        draw_streams(rows, loop_parts.list_streams(scenario), scenario.seed, ticks, samples)
        rows = rows._replace(table=build_law_table(scenario), pieces=build_pieces(scenario.path))
        state = as_record(start, loop.kinds.state)
        now = state[0]["now"]
        run = partial(loop.run, as_record(settings, loop.kinds.settings), state, rows)
        if self._watched is None or is_built_in(law):
            run()
        else:
            del self._rows[loop]  # code that never returns keeps its arrays
            self._watched.call(run, lambda: int(now["samples"]))
            self._rows[loop] = rows
        if now["failure"] or not now["samples"]:
            return None
        poses, answers = rows.ticks[: now["ticks"]], rows.samples[: now["samples"]]
        senses, shapes = scenario.has_action("sense", "lose_pose"), scenario.has_action("shape")
        states = None
        if declaration.states:
            states = collect.pair_columns(rows.states[: len(answers)], *declaration.states)
        return collect.build_simulated_run(
            scenario,
            declaration,
            poses=collect.build_poses(
                np.arange(len(poses)) * plant.period_ns, poses, senses=senses
            ),
            commands=collect.collect_commands(answers[: now["published"]]),
            samples=collect.build_samples(answers, states, declaration, has_shaping=shapes),
            stop_reason=name_stop(int(now["stop"]), loop.law.stops),
            events=tuple(
                describe_event(row, plant.period_ns, loop.law.stops)
                for row in rows.events[: now["events"]].view(np.recarray)
            ),
        )


def build_law_table(scenario: Scenario) -> NDArray[np.float64]:
    """Return the table of a law; it is empty for a law without one."""
    build = getattr(find_law(scenario.law.kind), "build_table", None)
    rows = [] if build is None else [*build(scenario.law.parameters)]
    return np.array(rows, np.float64) if rows else np.empty((0, 0))


def build_pieces(path: Path | None) -> NDArray[Any]:
    """Return the pieces of a path as rows of `PIECE`; there are none without a path."""
    return np.array([piece[1:] for piece in (() if path is None else path.ways)], PIECE)


def draw_streams(rows: Any, names: frozenset[str], seed: int, ticks: int, samples: int) -> None:
    """Generate the random numbers of effects, event by event."""
    for name in names:
        of_ticks = name in loop_parts.list_of(ticks=True)
        table, count = (rows.drawn_ticks, ticks) if of_ticks else (rows.drawn_samples, samples)
        drawn = loop_parts.draw_events(seed, loop_parts.STREAMS[name], count)
        for place, column in enumerate(loop_parts.STREAMS[name].fields):
            table[name][column][:count] = drawn[:, place]
