"""Simulation of many scenarios, in threads, with compiled code if loading it is worth its cost."""

import gc
import math
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence, Sized
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from functools import cache, cached_property, partial
from importlib import import_module
from importlib.util import find_spec
from threading import Lock
from typing import Any, Final

import numpy as np

from turtlelog.display import format_number
from turtlelog.errors import SimulationError
from turtlelog.laws import LawPart, find_law
from turtlelog.parts import Plant, PlantPart
from turtlelog.plants import PLANTS
from turtlelog.processes import COMPILING, count_cores
from turtlelog.run import Run
from turtlelog.scenario import Scenario, resolve_scenario
from turtlelog.simulate.class_law import declare_scenario, is_built_in
from turtlelog.simulate.collect import simulate_run
from turtlelog.simulate.compiled_loop import CompiledRunner, compile_loop, name_loop
from turtlelog.simulate.compiled_twins import is_kept
from turtlelog.simulate.step_budget import STEP_BUDGET_S, StepBudgetError

COST_S: Final = 1.0
"""Time to import numba and load a loop from the cache [s]."""

FIRST_S: Final = 6.0
"""Time if the loop is not in the cache [s]: numba compiles it for 4 to 6 s."""

_SAVED_S: Final = 1.2e-5
"""Least time that a compiled loop saves per sample for turtlesim [s]. With the columns of its run,
a sample takes 15 us plain and 1 us compiled; some processors are faster."""

_STEPPED_SAVED_S: Final = 3e-5
"""Least time saved per sample for a robot model with a time constant, and for a path [s]: 33 to 44
us plain, 1 to 3 us compiled."""

MOST_TICKS: Final = 1_000_000
"""Longest scenario that is compiled [ticks]: the arrays have 600 bytes per tick, for all ticks at
once."""

_AHEAD: Final = 4
"""Largest number of finished runs that wait per thread: this limits memory, and keeps all threads
busy."""


class CompiledCode:
    """Compiled code, loaded as soon as the expected work justifies its cost.

    With this rule, no process takes more than twice as long as with perfect knowledge of its work.

    Attributes:
        problem: Reason why the code could not be compiled or is no longer used; None if it can be
            used.
    """

    def __init__(
        self,
        load: Callable[[], Any],
        is_kept: Callable[[], bool],
        *,
        cost_s: float,
        first_s: float | None = None,
        beside: Sequence[str] = (),
    ) -> None:
        """Store the loader of the code and its cost.

        Args:
            load: Function that returns the code. The function may raise ImportError, RuntimeError,
                and errors of numba.
            is_kept: Function that returns whether numba's cache contains the code.
            cost_s: Time to import numba and load the code from its cache [s].
            first_s: Time if the code is not in the cache [s]; None: hardly more.
            beside: Functions that compile parts of the code, as `module:function`, each called in a
                process; `load` calls them by `call_beside`.
        """
        self._load, self._is_kept, self._cached_s = load, is_kept, cost_s
        self._first_s = cost_s if first_s is None else first_s
        self._beside = beside
        self._loading = Lock()
        self._saved_s = 0.0
        self._loops: Any = None
        self.problem: str | None = None

    def expect(self, count: int, saving_s: float) -> Any:
        """Add expected work: a number of items, and the time that the code saves on each [s].

        Returns:
            The code as soon as the total work is worth loading it, otherwise None.
        """
        with self._loading:
            before, self._saved_s = self._saved_s, self._saved_s + count * saving_s
            is_little = self._saved_s < self._cached_s  # the cache is not searched then
            if not is_little and before < self.cost_s <= self._saved_s:
                self._loops = self.load()
        return self._loops

    @cached_property
    def cost_s(self) -> float:
        """Time to load the code [s]: more if parts are not in numba's cache, inf without numba."""
        if find_spec("numba") is None:
            return math.inf
        return self._cached_s if self._is_kept() else self._first_s

    def find(self) -> Any:
        """Return the code if it is loaded, else None."""
        return self._loops

    def give_up(self, problem: str) -> None:
        """Stop using the code."""
        with self._loading:
            self._loops, self.problem = None, problem

    def load(self) -> Any:
        """Return the code; None without numba, or if numba cannot store compiled code.

        Without a writable folder for its cache, numba would compile again in every process.
        """
        try:
            if import_module("numba").config.DISABLE_JIT:
                return None
            with ExitStack() as processes:
                if not self._is_kept():
                    COMPILING.set()
                    if gc.isenabled():  # saves 10 %: numba creates millions of permanent objects
                        gc.disable()
                        processes.callback(gc.enable)
                    _start(self._beside, processes)
                return self._load()
        # numba for another numpy raises ImportError, a read-only cache RuntimeError.
        except (ImportError, RuntimeError, OSError):
            return None
        except Exception as err:
            self.problem = str(err)
            return None
        finally:
            COMPILING.clear()


_BESIDE: Final[dict[str, Any]] = {}
"""Processes that compile what a function returns, by `module:function`."""

_CALL: Final = (
    "import gc, sys; gc.disable(); sys.path[:] = sys.argv[2:];"
    " from pkgutil import resolve_name; resolve_name(sys.argv[1])()"
)


def _start(functions: Sequence[str], processes: ExitStack) -> None:
    """Compile what functions return into numba's cache, each in a process, and wait for them."""
    import subprocess  # most commands do not need it

    for function in functions:
        # If a process does not start or fails, the function compiles when it is called here.
        with suppress(OSError, ValueError):
            command = [sys.executable, "-c", _CALL, function, *sys.path]
            nowhere = subprocess.DEVNULL
            _BESIDE[function] = processes.enter_context(
                subprocess.Popen(command, stdin=nowhere, stdout=nowhere, stderr=nowhere)
            )


def call_beside(function: str) -> Any:
    """Return what a function compiles, after the end of the process that compiles it, if any."""
    from pkgutil import resolve_name

    if (process := _BESIDE.pop(function, None)) is not None:
        process.wait()
    return resolve_name(function)()


Simulated = Run | SimulationError


class ManyRuns(Iterator[Simulated]):
    """The runs of scenarios, in order; a failed run is replaced by its SimulationError.

    Only a few runs are in memory at a time.

    Attributes:
        compiled: Number of runs that compiled loops have simulated.
        interpreted: Number of runs simulated in ordinary Python: laws that are classes, failed
            runs, runs without numba, and runs before loading a compiled loop is worthwhile.
        notes: Notes on the compiled loops, one line each.
    """

    def __init__(
        self,
        scenarios: Iterable[Scenario],
        *,
        plant: Plant | None = None,
        threads: int | None,
        step_budget_s: float | None,
        expected: int | None = None,
    ) -> None:
        """Begin as `simulate_many` does. `expected`: number of runs. Default: of the scenarios."""
        self.compiled = self.interpreted = 0
        self.notes: list[str] = []
        self._threads = count_cores() if threads is None else threads
        if self._threads < 1:
            raise SimulationError(f"threads: expected at least 1, found {threads}")
        self._count = expected or (len(scenarios) if isinstance(scenarios, Sized) else 1)
        self._plant, self._step_budget_s = plant, step_budget_s
        self._scenarios = iter(scenarios)
        self._waiting: deque[Simulated | Future[Simulated]] = deque()
        self._pool: ThreadPoolExecutor | None = None
        self._local, self._counting = threading.local(), threading.Lock()
        self._compared: set[CompiledCode] = set()
        self._noted: set[CompiledCode] = set()

    def __iter__(self) -> "ManyRuns":
        return self

    def __next__(self) -> Simulated:
        while len(self._waiting) < self._threads * _AHEAD:
            try:
                scenario = next(self._scenarios)
            except StopIteration:
                break
            self._waiting.append(self._start(resolve_scenario(scenario)))
            if not isinstance(self._waiting[-1], Future):
                break
        if not self._waiting:
            if self._pool is not None:
                self._pool.shutdown()
            raise StopIteration
        found = self._waiting.popleft()
        return found.result() if isinstance(found, Future) else found

    def _start(self, scenario: Scenario) -> Simulated | Future[Simulated]:
        """Simulate a scenario, or start it in a thread."""
        plant = scenario.plant.facts if self._plant is None else self._plant
        loop = find_loop(scenario, plant)
        if loop is None or loop.find() is None:
            return self._interpret(scenario, plant, loop)
        is_own = not is_built_in(find_law(scenario.law.kind))
        if is_own and loop not in self._compared:
            return self._simulate_twice(loop, scenario, plant)
        if self._threads == 1:
            return self._compile(loop, scenario, plant)
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self._threads, thread_name_prefix="simulate")
        return self._pool.submit(self._compile, loop, scenario, plant)

    def _compile(self, loop: CompiledCode, scenario: Scenario, plant: Plant) -> Simulated:
        if not hasattr(self._local, "runner"):
            self._local.runner = CompiledRunner(self._step_budget_s)
        run: Run | None = None
        if (kernel := loop.find()) is not None:
            try:
                run = self._local.runner.simulate(kernel, scenario, plant)
            except StepBudgetError as err:
                loop.give_up(f"when compiled, one step {err}")
                self._note_problem(scenario, loop)
        with self._counting:
            self.compiled += run is not None
            self.interpreted += run is None
        return self._simulate(scenario, plant) if run is None else run

    def _simulate_twice(self, loop: CompiledCode, scenario: Scenario, plant: Plant) -> Simulated:
        """Simulate a user law in ordinary Python and compiled, and record a difference as a note.

        The arithmetic of numba and Python may differ in the last bits: for `x**3` in a quarter of
        cases.
        """
        found = self._simulate(scenario, plant)
        if isinstance(found, SimulationError):
            with self._counting:
                self.interpreted += 1
            return found
        self._compared.add(loop)
        again = self._compile(loop, scenario, plant)
        if isinstance(again, Run):
            self.notes += describe_compiled_difference(scenario.law.kind, found, again)
        return again

    def _interpret(self, scenario: Scenario, plant: Plant, loop: CompiledCode | None) -> Simulated:
        """Simulate in Python, and decide whether a compiled loop is worth loading for others."""
        with self._counting:
            self.interpreted += 1
        found = self._simulate(scenario, plant)
        if isinstance(found, Run) and loop is not None:
            # The first run shows the expected length of the others; later ones count themselves.
            runs = self._count if self.interpreted == 1 else 1
            loop.expect(len(found.samples) * runs, find_saving(scenario))
            self._note_problem(scenario, loop)
        return found

    def _note_problem(self, scenario: Scenario, loop: CompiledCode) -> None:
        with self._counting:
            if loop.problem is not None and loop not in self._noted:
                self._noted.add(loop)
                self.notes.append(f"law {scenario.law.kind} runs plain: {loop.problem}")

    def _simulate(self, scenario: Scenario, plant: Plant) -> Simulated:
        try:
            return simulate_run(scenario, plant, step_budget_s=self._step_budget_s)
        except SimulationError as err:
            return err


ENTRY: Final = "turtlelog.simulate.compiled_entry"


def is_loop_kept(law: LawPart, plant: PlantPart, states: tuple[str, ...]) -> bool:
    """Return whether numba's cache has the loop of a law and a plant."""
    try:
        return is_kept(ENTRY, name_loop(law, plant, states))
    except TypeError:  # not compilable; the compilation reports it
        return False


@cache
def _find_loop(*kind: Any) -> CompiledCode:
    load, find = partial(compile_loop, *kind), partial(is_loop_kept, *kind)
    return CompiledCode(load, find, cost_s=COST_S, first_s=FIRST_S)


def find_loop(scenario: Scenario, plant: Plant) -> CompiledCode | None:
    """Return the compiled loop for a scenario with a resolved law; None if there is none."""
    law = find_law(scenario.law.kind)
    if not isinstance(law, LawPart) or (law.needs_path and scenario.path is None):
        return None
    ticks = round(scenario.max_duration_s * 1e9) // plant.period_ns
    period_s = scenario.loop.period_s or 1.0
    if ticks >= MOST_TICKS or period_s * MOST_TICKS <= scenario.max_duration_s:
        return None
    return _find_loop(law, PLANTS[scenario.plant.kind], declare_scenario(scenario).states)


def find_saving(scenario: Scenario) -> float:
    """Return the approximate time that a compiled loop saves per sample of a scenario [s]."""
    is_quick = scenario.plant.facts.acts_in_steps and scenario.path is None
    return _SAVED_S if is_quick else _STEPPED_SAVED_S


def describe_compiled_difference(kind: str, plain: Run, compiled: Run) -> Iterator[str]:
    """Yield the differences between a law's first compiled run and the same run in Python."""
    if len(plain.samples) != len(compiled.samples):
        counts = f"{len(compiled.samples)} samples instead of {len(plain.samples)}"
        yield f"law {kind}: its first run has {counts} when compiled"
        return
    largest = {}
    for unit, name in (("m/s", "wanted_speed_m_s"), ("rad/s", "wanted_turn_rate_rad_s")):
        one, other = getattr(plain.samples, name), getattr(compiled.samples, name)
        largest[unit] = float(np.abs(one - other).max())
    if any(largest.values()):
        sizes = " and ".join(f"{format_number(one)} {unit}" for unit, one in largest.items())
        yield f"law {kind}: commands of its first run differ by up to {sizes} when compiled"


def simulate_many(
    scenarios: Iterable[Scenario],
    *,
    plant: Plant | None = None,
    threads: int | None = None,
    step_budget_s: float | None = STEP_BUDGET_S,
) -> ManyRuns:
    """Simulate scenarios one after another, with the same bits as `simulate_run`.

    With the extra `fast`, laws that are parts run in a compiled loop as soon as loading it is
    worthwhile. Laws that are classes run in ordinary Python.

    Args:
        scenarios: Scenarios to simulate; they are read as runs are requested.
        plant: Plant whose clock is used. Default: the plant of each scenario.
        threads: Number of threads. Default: one per core.
        step_budget_s: Time for computing one answer of a law [s]; None: unlimited.

    Returns:
        An iterator of runs; a failed run is replaced by its SimulationError, whose `run` is the run
            so far.

    Raises:
        SimulationError: If `threads` is not a number above 0.
        ScenarioError: While iterating, if a law cannot be loaded or may not run.
    """
    return ManyRuns(scenarios, plant=plant, threads=threads, step_budget_s=step_budget_s)
