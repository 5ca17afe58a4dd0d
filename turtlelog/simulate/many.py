"""Many scenarios simulated: by the compiled loop where that is worth it, in threads."""

import threading
from collections import deque
from collections.abc import Iterable, Iterator, Sized
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Final

from turtlelog.compiled_loops import CompiledLoops
from turtlelog.errors import SimulationError
from turtlelog.plants import LAGGED, Plant
from turtlelog.processes import count_cores
from turtlelog.run import Run
from turtlelog.scenario import Scenario, resolve_scenario
from turtlelog.simulate.collect import simulate_run
from turtlelog.simulate.compiled.fields import is_common, is_compiled
from turtlelog.simulate.compiled.runner import KernelRunner
from turtlelog.simulate.step_budget import STEP_BUDGET_S

COST_S: Final = 1.0
"""What numba's import and the loop take from their cache [s]."""

_SAVED_S: Final = 4e-6
"""What the compiled loop saves of a sample of a sequential law around turtlesim, at least [s]."""

_ANY_SAVED_S: Final = 1.5e-5
"""Likewise of others [s]: 17e-6 of the posture law and of the open loop."""

_STEPPED_SAVED_S: Final = 4e-5
"""Likewise of a lagged robot, which steps through its lag, and of a path that is searched [s]."""

FIRST_S: Final = 14.0
"""What the sequential laws around turtlesim take before their loop is in the cache [s]: numba
compiles it for 13 s."""

LOOP: Final = CompiledLoops(
    "turtlelog.simulate.compiled.sequential_loop", cost_s=COST_S, first_s=FIRST_S
)
"""The loop of the sequential laws around turtlesim."""

ANY_FIRST_S: Final = 30.0
"""What numba's import and the loop of all others take before it is in the cache [s]."""

ANY_LOOP: Final = CompiledLoops(
    "turtlelog.simulate.compiled.any_loop", cost_s=COST_S, first_s=ANY_FIRST_S
)
"""The loop of all other laws and plants that are compiled."""

_AHEAD: Final = 4
"""Runs for each thread that may wait to be taken: memory stays bounded, and no thread idles."""

Simulated = Run | SimulationError


class ManyRuns(Iterator[Simulated]):
    """The runs of scenarios, in their order; where one fails its SimulationError in its place.

    Only a few runs are in memory, however many there are.

    Attributes:
        compiled: How many runs the compiled loop has simulated.
        interpreted: How many the interpreted one has: of laws and effects that are not compiled,
            where a run fails, without numba, or before they are worth loading the compiled one.
    """

    def __init__(
        self,
        scenarios: Iterable[Scenario],
        *,
        plant: Plant | None,
        threads: int | None,
        step_budget_s: float | None,
    ) -> None:
        self.compiled = self.interpreted = 0
        self._threads = count_cores() if threads is None else threads
        if self._threads < 1:
            raise SimulationError(f"threads: expected at least 1, found {threads}")
        self._count = len(scenarios) if isinstance(scenarios, Sized) else 1
        self._plant, self._step_budget_s = plant, step_budget_s
        self._scenarios = iter(scenarios)
        self._waiting: deque[Simulated | Future[Simulated]] = deque()
        self._pool: ThreadPoolExecutor | None = None
        self._local, self._counting = threading.local(), threading.Lock()

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
        """Simulate a scenario, or have a thread do so."""
        plant = scenario.plant.facts if self._plant is None else self._plant
        loop = find_loop(scenario, plant)
        kernel = None if loop is None else loop.find()
        if kernel is None:
            return self._interpret(scenario, plant, loop)
        if self._threads == 1:
            return self._compile(kernel, scenario, plant)
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self._threads, thread_name_prefix="simulate")
        return self._pool.submit(self._compile, kernel, scenario, plant)

    def _compile(self, kernel: Any, scenario: Scenario, plant: Plant) -> Simulated:
        if not hasattr(self._local, "runner"):
            self._local.runner = KernelRunner()
        run: Run | None = self._local.runner.simulate(kernel, scenario, plant)
        with self._counting:
            self.compiled += run is not None
            self.interpreted += run is None
        return self._simulate(scenario, plant) if run is None else run

    def _interpret(self, scenario: Scenario, plant: Plant, loop: CompiledLoops | None) -> Simulated:
        """Simulate, and find out whether the others are worth loading a compiled loop."""
        with self._counting:
            self.interpreted += 1
        found = self._simulate(scenario, plant)
        if isinstance(found, Run) and loop is not None:
            # The first tells how long the others will be about; later ones count themselves.
            runs = self._count if self.interpreted == 1 else 1
            loop.expect(len(found.samples) * runs, find_saving(scenario))
        return found

    def _simulate(self, scenario: Scenario, plant: Plant) -> Simulated:
        try:
            return simulate_run(scenario, plant, step_budget_s=self._step_budget_s)
        except SimulationError as err:
            return err


def find_loop(scenario: Scenario, plant: Plant) -> CompiledLoops | None:
    """Return the compiled loop that covers a scenario, whose law is resolved; None: none does."""
    if not is_compiled(scenario, plant):
        return None
    return LOOP if is_common(scenario) else ANY_LOOP


def find_saving(scenario: Scenario) -> float:
    """Return what a compiled loop saves of each sample of a scenario, about [s]."""
    if scenario.plant.kind == LAGGED or scenario.path is not None:
        return _STEPPED_SAVED_S
    return _SAVED_S if is_common(scenario) else _ANY_SAVED_S


def simulate_many(
    scenarios: Iterable[Scenario],
    *,
    plant: Plant | None = None,
    threads: int | None = None,
    step_budget_s: float | None = STEP_BUDGET_S,
) -> ManyRuns:
    """Simulate scenarios one after the other, each as `simulate_run` does, bit for bit.

    With the extra `fast` the built-in laws run in a compiled loop, once there is so much to do that
    it is worth loading; laws of the user's own are interpreted.

    Args:
        scenarios: What to simulate; taken as the runs are.
        plant: On whose clock; None: each on that of its own plant.
        threads: That simulate at once; None: as many as cores.
        step_budget_s: Time that a law may compute for one answer [s]; None: as long as it takes.

    Returns:
        An iterator of runs; where one fails its SimulationError, with the run so far as `run`.

    Raises:
        SimulationError: Where `threads` is no number above 0.
        ScenarioError: While iterating, where a law cannot be loaded or may not run.
    """
    return ManyRuns(scenarios, plant=plant, threads=threads, step_budget_s=step_budget_s)
