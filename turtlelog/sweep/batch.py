"""Simulation and measurement of varied scenarios in compiled code, without trajectories.

Laws and metrics that are not compiled, and rows that fail, are computed as single runs. Compiled or
not, a row has the numbers of a single run, bit for bit.
"""

import math
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import SimulationError, SweepError, TurtlelogError
from turtlelog.laws import find_law
from turtlelog.measure import measure_run
from turtlelog.measure.loop_segment import aim_at, number_loop
from turtlelog.measure.metric import REASONS, Status
from turtlelog.measure.metric_kinds import RUN_METRICS
from turtlelog.measure.response import NO_PHASE
from turtlelog.processes import count_cores
from turtlelog.run.loops import Declaration
from turtlelog.run.stop_reasons import draw_goal_line, name_stop
from turtlelog.scenario import Scenario, resolve_scenario
from turtlelog.simulate import compiled_loop, declare_scenario, many, simulate_run
from turtlelog.simulate.class_law import is_built_in
from turtlelog.simulate.compiled_twins import is_kept
from turtlelog.simulate.step_budget import STEP_BUDGET_S, StepBudgetError, WatchedCode
from turtlelog.sweep import batch_arrays as arrays
from turtlelog.sweep.sweep_plan import build_row_scenario

_MEASURING_S: Final = 5.0
"""Additional time for compiling the measurement together with the loop [s]."""

_STATUS_OF: Final = np.array([arrays.STATUSES.index(one.status) for one in REASONS], np.int8)
"""Status number of each reason."""

_TOO_LARGE: Final = arrays.STATUSES.index(Status.TOO_LARGE)
_NO_ROWS: Final = np.zeros(0, [("failure", np.int64), ("samples", np.int64)])

_STRETCH: Final = 32
"""Number of rows in one call: negligible overhead, and all cores finish together."""

_COMPARED: Final[set[many.CompiledCode]] = set()
"""Compiled loops of user laws that this process has already compared with plain runs."""


class Batch(NamedTuple):
    """A compiled loop with the functions that simulate and measure rows."""

    loop: Any
    run_rows: Any


@cache
def _find_batch(kind: arrays.Kind, coverage: arrays.Coverage) -> many.CompiledCode:
    def load() -> Batch:
        loop = compiled_loop.compile_loop(*kind)
        measure = many.call_beside(coverage.compiler)
        kind_of_rows = arrays.type_measurement(coverage)
        return Batch(loop, compiled_loop.compile_rows(loop, measure, kind_of_rows))

    def is_batch_kept() -> bool:
        if not many.is_loop_kept(*kind):
            return False
        names = f"rows_{compiled_loop.name_loop(*kind)}", arrays.name_measurement(coverage)
        return all(is_kept(many.ENTRY, name) for name in names)

    return many.CompiledCode(
        load,
        is_batch_kept,
        cost_s=many.COST_S,
        first_s=many.FIRST_S + _MEASURING_S,
        beside=(coverage.compiler,),
    )


def find_batch(base: Scenario) -> many.CompiledCode | None:
    """Return the compiled code for rows that vary keys of a scenario; None if the law has none."""
    try:
        scenario = resolve_scenario(base)
        kind, coverage = arrays.find_column_kind(scenario), arrays.find_coverage(scenario)
    except TurtlelogError:  # the rows may supply missing values
        return None
    return None if kind is None or coverage is None else _find_batch(kind, coverage)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredRows:
    """Results of rows, in their order."""

    values: Mapping[str, NDArray[np.float64]]  # by metric, shape (n,) each; NaN if missing
    statuses: Mapping[str, NDArray[np.int8]]  # indices into `STATUSES`, likewise; -1 if failed
    stop_reasons: list[str | None]  # stop reason of each row; None for rows that failed
    failed: list[str | None]  # reason of each failure; None for rows that did not fail
    late: list[int]  # rows that failed because a step exceeded its budget
    samples: NDArray[np.int64]  # number of samples of each row, shape (n,)
    compiled: int = 0  # number of rows that the compiled loop simulated, not as single runs
    interpreted: int = 0
    notes: tuple[str, ...] = ()  # notes on the compiled code of a user's law, one line each


def measure_rows(  # noqa: PLR0913  (all but the first three have defaults)
    base: Scenario,
    columns: Mapping[str, Sequence[Any]],
    metrics: Sequence[str],
    *,
    threads: int | None = None,
    first: int = 0,
    ahead: int = 0,
    step_budget_s: float = STEP_BUDGET_S,
    source: str = "grid",
) -> MeasuredRows:
    """Simulate rows that vary a scenario, whose law may run, and return metrics by their ids.

    `columns` are the values of each varied key, one per row. There is a thread per core by default.
    `ahead`, about the number of rows still to be done by this process, decides whether compiled
    loops are worth loading. The row's number, from `first` on, is in the name of its scenario.
    `source` is the prefix of errors about the values of a row.
    """
    counts = {len(column) for column in columns.values()}
    if len(counts) != 1:
        raise SweepError(f"rows: expected columns of one length, found {sorted(counts) or 'none'}")
    work = _Work(base, columns, metrics, (source, first), step_budget_s)
    rest: Sequence[int] = range(work.count)
    batch = find_batch(base) if all(map(is_covered, metrics)) else None
    if batch is not None:
        kernel = batch.find()
        if kernel is None and work.count:
            work.measure_alone(0)
            rest = range(1, work.count)
            rows = max(work.count, ahead)
            kernel = batch.expect(int(work.result.samples[0]) * rows, many.find_saving(base))
        if kernel is not None:
            threads = count_cores() if threads is None else threads
            rest = work.run_compiled(batch, kernel, rest, threads)
        if batch.problem is not None:
            work.notes.append(f"law {base.law.kind} runs plain: {batch.problem}")
    for row in rest:
        work.measure_alone(row)
    return work.finish()


def _build_loops(declaration: Declaration) -> NDArray[Any]:
    """Return the loops of a covered law as `LOOP`."""
    return np.array([number_loop(declaration, one) for one in declaration.loops], arrays.LOOP)


class _Cells(NamedTuple):
    """Values and numbers of reasons in the columns of `batch_arrays`, shape (n, columns) each."""

    values: NDArray[np.float64]
    reasons: NDArray[np.int16]


class _Work:
    """The state of rows while the batch computes them."""

    def __init__(
        self,
        base: Scenario,
        columns: Mapping[str, Sequence[Any]],
        metrics: Sequence[str],
        rows: tuple[str, int],
        step_budget_s: float,
    ) -> None:
        """Store what to compute; `rows` are the source of the rows and the number of the first."""
        self.count = count = len(next(iter(columns.values())))
        self._base, self._columns, self._metrics = base, columns, tuple(metrics)
        (self._source, self._first), self._step_budget_s = rows, step_budget_s
        self._is_own = False
        self.notes: list[str] = []
        self._compiled = 0
        self._local = threading.local()
        self.result = MeasuredRows(
            values={name: np.full(count, np.nan) for name in metrics},
            statuses={name: np.full(count, -1, np.int8) for name in metrics},
            stop_reasons=[None] * count,
            failed=[None] * count,
            late=[],
            samples=np.zeros(count, np.int64),
        )

    def finish(self) -> MeasuredRows:
        interpreted, notes = self.count - self._compiled, tuple(self.notes)
        return replace(self.result, compiled=self._compiled, interpreted=interpreted, notes=notes)

    def measure_alone(self, row: int) -> None:
        result = self.result
        try:
            scenario = self._build_scenario(row)
            run = simulate_run(scenario, step_budget_s=self._step_budget_s)
        except TurtlelogError as err:
            if isinstance(err, SimulationError) and err.run is not None:
                result.samples[row] = len(err.run.samples)
            result.failed[row] = str(err)
            result.late.extend([row] if isinstance(err, StepBudgetError) else [])
            return
        result.stop_reasons[row], result.samples[row] = run.stop_reason, len(run.samples)
        for name, metric in measure_run(run, only=self._metrics).items():
            result.statuses[name][row] = arrays.STATUSES.index(metric.status)
            if metric.value is not None:
                result.values[name][row] = metric.value

    def _build_scenario(self, row: int) -> Scenario:
        keys, values = tuple(self._columns), [column[row] for column in self._columns.values()]
        number = self._first + row
        scenario = build_row_scenario(self._base, keys, values, number, source=self._source)
        return resolve_scenario(scenario)

    def run_compiled(
        self, batch: many.CompiledCode, kernel: Batch, rows: Sequence[int], threads: int
    ) -> Sequence[int]:
        """Simulate and measure compiled rows; return the rows that are not compiled."""
        self._is_own = not is_built_in(kernel.loop.law)
        try:
            if self._is_own and rows and batch not in _COMPARED:
                _COMPARED.add(batch)
                self._compare(kernel, rows[0])
            return self._run_compiled(kernel, rows, threads)
        except StepBudgetError as err:
            batch.give_up(f"when compiled, one step {err}")
            return rows

    def _compare(self, kernel: Batch, row: int) -> None:
        """Note how much a row of a user's law differs between compiled and ordinary code."""
        try:
            scenario = self._build_scenario(row)
            plain = simulate_run(scenario, step_budget_s=self._step_budget_s)
        except TurtlelogError:  # the row has the reason
            return
        runner = compiled_loop.CompiledRunner(self._step_budget_s)
        compiled = runner.simulate(kernel.loop, scenario, scenario.plant.facts)
        if compiled is not None:
            self.notes += many.describe_compiled_difference(scenario.law.kind, plain, compiled)

    def _run_compiled(self, kernel: Batch, rows: Sequence[int], threads: int) -> list[int]:
        base = resolve_scenario(self._base)
        declaration, coverage = declare_scenario(base), arrays.find_coverage(base)
        assert coverage is not None
        self._declaration, self._coverage = declaration, coverage
        self._places = {name: find_column(name, declaration, coverage) for name in self._metrics}
        prepared = arrays.prepare_rows(base, self._columns, rows)
        cells = self._run_all(kernel, prepared, threads)
        # The line from start to goal is known in advance, unless a disturbance moves the waiting
        # robot.
        moved = self._correct_lines(prepared, cells)
        if len(moved):
            again = prepared.take(moved)
            part = self._run_all(kernel, again, threads)
            cells.values[moved], cells.reasons[moved] = part
            prepared.states[moved] = again.states
        now = prepared.states["now"] if len(prepared.rows) else _NO_ROWS
        good = (now["failure"] == 0) & (now["samples"] > 0)
        self._enter(prepared, cells, np.flatnonzero(good))
        self._compiled += int(good.sum())
        return sorted([*prepared.others, *prepared.rows[~good].tolist()])

    def _run_all(self, kernel: Any, prepared: arrays.PreparedRows, threads: int) -> _Cells:
        """Simulate and measure prepared rows from their start states; `states` is overwritten."""
        loops = _build_loops(self._declaration)
        columns = len(loops) * len(self._coverage.curves) + len(arrays.COURSES) + 2
        shape = len(prepared.rows), columns
        cells = _Cells(np.full(shape, np.nan), np.zeros(shape, np.int16))
        prepared.states[:] = prepared.starts
        asked = np.zeros(shape[1], np.bool_)
        asked[[place for place in self._places.values() if place is not None]] = True
        order = np.argsort(prepared.seeds, kind="stable")
        cuts = np.flatnonzero(np.diff(prepared.seeds[order])) + 1
        stretches = [
            group[first : first + _STRETCH]
            for group in np.split(order, cuts)
            for first in range(0, len(group), _STRETCH)
        ]

        def run(stretch: NDArray[np.int64]) -> None:
            rows, memory = self._find_memory(kernel, prepared, int(prepared.seeds[stretch[0]]))
            part = asked, cells.values[stretch], cells.reasons[stretch]
            begun = prepared.settings[stretch], prepared.states[stretch], prepared.lines[stretch]
            told = np.zeros(1, arrays.FACTS), loops, memory
            self._call(partial(kernel.run_rows, begun, rows, told, part), begun[1])
            _, cells.values[stretch], cells.reasons[stretch] = part
            _, prepared.states[stretch], _ = begun

        if threads == 1 or len(stretches) == 1:
            for stretch in stretches:
                run(stretch)
            return cells
        with ThreadPoolExecutor(threads, thread_name_prefix="batch") as pool:
            for _ in pool.map(run, stretches):
                pass
        return cells

    def _call(self, run: Callable[[], Any], states: NDArray[Any]) -> None:
        """Call compiled code, which may never return with a user's law."""
        if not self._is_own:
            run()
            return
        local = self._local
        kept = {name: vars(local).pop(name) for name in ("rows", "memory", "seed")}
        if not hasattr(local, "watched"):
            local.watched = WatchedCode(self._step_budget_s)
        local.watched.call(run, lambda: int(states["now"]["samples"].sum()))
        vars(local).update(kept)

    def _find_memory(
        self, kernel: Batch, prepared: arrays.PreparedRows, seed: int
    ) -> tuple[Any, Any]:
        """Return this thread's arrays for the loop, including random numbers, and for measuring."""
        local = self._local
        ticks, samples = prepared.ticks, prepared.samples
        has_rows = hasattr(local, "rows") and len(local.rows.ticks) >= ticks
        if not has_rows or len(local.rows.samples) < samples:
            rows = kernel.loop.kinds.allocate(ticks, samples)
            pieces = compiled_loop.build_pieces(prepared.path)
            local.rows = rows._replace(table=prepared.table, pieces=pieces)
            local.memory = arrays.allocate_memory(ticks, samples, prepared.path)
            local.seed = None
        if local.seed != seed:
            compiled_loop.draw_streams(local.rows, prepared.streams, seed, ticks, samples)
            local.seed = seed
        return local.rows, local.memory

    def _correct_lines(self, prepared: arrays.PreparedRows, cells: _Cells) -> NDArray[np.int64]:
        """Set the line from the first pose that was read; return the rows whose line changed."""
        read = cells.values[:, arrays.FIRST_POSE]
        lines = prepared.lines
        other = (read[:, 0] != lines["x_m"]) | (read[:, 1] != lines["y_m"])
        other &= ~np.isnan(read[:, 0])
        moved = np.flatnonzero(other)
        for row in moved.tolist():
            *_, x_m, y_m, heading_rad, band = lines[row].tolist()
            line = draw_goal_line((float(read[row, 0]), float(read[row, 1])), (x_m, y_m))
            lines[row] = (*aim_at(line, (x_m, y_m), heading_rad), band)
        return moved

    def _enter(self, prepared: arrays.PreparedRows, cells: _Cells, good: NDArray[np.int64]) -> None:
        result, rows = self.result, prepared.rows[good]
        if not len(rows):
            return
        now = prepared.states["now"]
        law: Any = find_law(self._base.law.kind)  # a LawPart, since its loop is compiled
        result.samples[rows] = now["samples"][good]
        for row, reason in zip(rows, now["stop"][good].tolist(), strict=True):
            result.stop_reasons[row] = name_stop(reason, law.stops)
        for name in self._metrics:
            place = self._places[name]
            if place is None:
                result.statuses[name][rows] = _STATUS_OF[NO_PHASE]
                continue
            column, status = cells.values[good, place], _STATUS_OF[cells.reasons[good, place]]
            if is_angle(name, self._declaration):
                column *= math.degrees(1.0)
            status[(status == arrays.OK) & ~np.isfinite(column)] = _TOO_LARGE
            result.values[name][rows] = np.where(status == arrays.OK, column, np.nan)
            result.statuses[name][rows] = status


def is_covered(name: str) -> bool:
    """Return whether the batch computes a metric, for any loop."""
    return (
        name in arrays.COURSES if name in RUN_METRICS else name.rpartition(".")[2] in arrays.CURVES
    )


def find_column(name: str, declaration: Declaration, coverage: arrays.Coverage) -> int | None:
    """Return the column of a covered metric; None if the law has no such metric."""
    curves = coverage.curves
    if name in arrays.COURSES:
        return len(declaration.loops) * len(curves) + [*arrays.COURSES].index(name)
    loop, _, plain = name.rpartition(".")
    for number, one in enumerate(declaration.loops):
        if one.name == loop and arrays.CURVES[plain].applies(one):
            return number * len(curves) + curves.index(plain)
    return None


def is_angle(name: str, declaration: Declaration) -> bool:
    """Return whether a metric is computed in rad but reported in deg."""
    loop, _, plain = name.rpartition(".")
    kind = None if name in arrays.COURSES else arrays.CURVES[plain]
    return kind is not None and kind.describe_unit(declaration.find_loop(loop)) == "deg"
