"""Rows of a sweep: simulation and measurement of chunks of rows, and their one table.

A chunk contains all its inputs, and the results of a row do not depend on the chunk. Therefore any
process on any machine with the same version of turtlelog returns the same results.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import partial
from typing import Any, Final

from turtlelog import expressions, measure
from turtlelog.errors import SimulationError, SweepError, TurtlelogError
from turtlelog.files.urls import make_path
from turtlelog.log.recording import write_recording
from turtlelog.measure.metric import Metric
from turtlelog.parts import split_key_unit
from turtlelog.run import Run
from turtlelog.run.loops import Declaration
from turtlelog.scenario import Scenario, parse_scenario, resolve_scenario
from turtlelog.simulate import ManyRuns, declare_scenario
from turtlelog.simulate.step_budget import STEP_BUDGET_S, StepBudgetError
from turtlelog.sweep.batch import is_covered, measure_rows
from turtlelog.sweep.batch_arrays import OK, STATUSES, is_batched
from turtlelog.sweep.partial_table import (
    KeptParts,
    Key,
    PartialColumns,
    StoredCells,
    StoredRows,
    WindowedRows,
    build_result_columns,
)
from turtlelog.sweep.result_table import (
    STATUS,
    ComputedItems,
    ResultColumn,
    ResultTable,
    StoredTable,
)
from turtlelog.sweep.sweep_plan import SweepPlan, build_row_scenario


@dataclass(frozen=True, slots=True, kw_only=True)
class RowRecords:
    """Settings of the runs of a sweep to record."""

    folder: str  # folder of the recordings, named like `row-000123.mcap`; a URL is a prefix
    where: str | None = None  # condition on metrics, keys and `stop_reason`. None: all runs


@dataclass(frozen=True, slots=True, kw_only=True)
class RowChunk:
    """Rows to simulate."""

    base: str  # scenario that the rows vary, as text; its law may run
    keys: tuple[str, ...]
    first: int  # number of the first row
    values: tuple[tuple[Any, ...], ...]  # values of the keys, per row
    metrics: tuple[str, ...] | None = None  # ids or patterns. Default: by `list_row_metrics`
    records: RowRecords | None = None
    ahead: int = 0  # about how many rows this process still does, to decide on compiling
    threads: int = 1  # number of threads, if the chunk is a batch
    step_budget_s: float = STEP_BUDGET_S  # longest computing time of the law per step [s]
    source: str = "grid"  # prefix of errors about the values of a row


@dataclass(slots=True, kw_only=True)
class MetricCells:
    """Values of a metric per row, None without one, and their units, several if laws differ.

    A status is None if the row's law has no such metric, or if the row failed.
    """

    units: list[str]
    values: list[float | None]
    statuses: list[str | None]


@dataclass(slots=True, kw_only=True)
class RowResults:
    """Results of a chunk, row by row, from the row `first` on."""

    first: int
    stop_reasons: list[str | None] = field(default_factory=list)  # of each row; None if failed
    failed: list[str | None] = field(default_factory=list)  # of each row; None if it did not fail
    late: list[int] = field(default_factory=list)  # failed rows whose law took too long, from 0
    samples: int = 0  # total number of samples of the runs
    recorded: int = 0
    metrics: dict[str, MetricCells] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)  # notes on the compiled loops, one line each

    def __len__(self) -> int:
        return len(self.failed)

    def find_late(self) -> tuple[int, str] | None:
        """Return the first row whose law exceeded its time, and the reason of the failure."""
        if not self.late:
            return None
        row = min(self.late)
        return self.first + row, self.failed[row] or ""


def simulate_rows(chunk: RowChunk) -> RowResults:
    """Simulate and measure the rows of a chunk. A failed row gets a reason."""
    base = parse_scenario(chunk.base)
    if kinds := _list_batch_metrics(base, chunk):
        return _simulate_batch(base, chunk, kinds)
    scenarios: list[Scenario | TurtlelogError] = []
    for row, values in enumerate(chunk.values, start=chunk.first):
        try:
            scenario = build_row_scenario(base, chunk.keys, values, row, source=chunk.source)
            scenarios.append(resolve_scenario(scenario))
        except TurtlelogError as err:
            scenarios.append(err)
    good = [one for one in scenarios if isinstance(one, Scenario)]
    expected, budget_s = max(len(good), chunk.ahead), chunk.step_budget_s
    runs = ManyRuns(good, threads=1, step_budget_s=budget_s, expected=expected)
    results = RowResults(first=chunk.first)
    for row, one in enumerate(scenarios, start=chunk.first):
        found = next(runs) if isinstance(one, Scenario) else one
        if isinstance(found, Run):
            _enter_run(results, chunk, row, found)
        else:
            _enter_failure(results, found)
    results.notes = runs.notes
    return results


_DECIDING: Final = ("law.kind", "law.reorient", "law.schedule", "path.", "plant.kind")
"""Beginnings of keys that decide which metrics a row has, and whether the row is compiled."""


def is_batch(chunk: RowChunk) -> bool:
    """Return whether compiled code can simulate and measure a chunk as a whole."""
    return bool(_list_batch_metrics(parse_scenario(chunk.base), chunk))


def _list_batch_metrics(base: Scenario, chunk: RowChunk) -> Mapping[str, measure.MetricKind]:
    """Return the metrics of a chunk by id if the batch covers all of them, else nothing."""
    if chunk.records or any(k.startswith(_DECIDING) for k in chunk.keys):
        return {}
    try:
        scenario = resolve_scenario(base)
    except TurtlelogError:  # the rows may supply missing values
        return {}
    if not is_batched(scenario, scenario.plant.facts):
        return {}
    declaration = declare_scenario(scenario)
    names, known = list_row_metrics(declaration, chunk.metrics), measure.list_metrics(declaration)
    if not all(name in known and is_covered(name) for name in names):
        return {}
    return {name: known[name] for name in names}


def _simulate_batch(
    base: Scenario, chunk: RowChunk, kinds: Mapping[str, measure.MetricKind]
) -> RowResults:
    columns = dict(zip(chunk.keys, zip(*chunk.values, strict=True), strict=True))
    found = measure_rows(
        base,
        columns,
        [*kinds],
        threads=chunk.threads,
        first=chunk.first,
        ahead=chunk.ahead,
        step_budget_s=chunk.step_budget_s,
        source=chunk.source,
    )
    results = RowResults(
        first=chunk.first,
        stop_reasons=found.stop_reasons,
        failed=found.failed,
        late=found.late,
        samples=int(found.samples.sum()),
        notes=[*found.notes],
    )
    if all(reason is not None for reason in found.failed):
        return results
    for name, kind in kinds.items():
        numbers = found.statuses[name].tolist()
        values = zip(found.values[name].tolist(), numbers, strict=True)
        results.metrics[name] = MetricCells(
            units=[kind.unit],
            values=[value if number == OK else None for value, number in values],
            statuses=[None if number < 0 else STATUSES[number].value for number in numbers],
        )
    return results


def _enter_failure(results: RowResults, err: TurtlelogError) -> None:
    if isinstance(err, SimulationError) and err.run is not None:
        results.samples += len(err.run.samples)
    results.late.extend([len(results)] if isinstance(err, StepBudgetError) else [])
    results.failed.append(str(err))
    results.stop_reasons.append(None)
    _enter_metrics(results, {})


def _enter_run(results: RowResults, chunk: RowChunk, row: int, run: Run) -> None:
    try:
        names = list_row_metrics(run.declaration, chunk.metrics)
        condition = _parse_condition(chunk.records)
        asked = () if condition is None else _list_asked(condition)
        found = measure.measure_run(run, only=[*dict.fromkeys([*names, *asked])])
    except TurtlelogError as err:
        _enter_failure(results, err)
        return
    results.samples += len(run.samples)
    results.failed.append(None)
    results.stop_reasons.append(run.stop_reason)
    _enter_metrics(results, {name: found[name] for name in names})
    if chunk.records is None:
        return
    values = {"name": run.name, "stop_reason": run.stop_reason, **run.parameters}
    values |= dict(zip(chunk.keys, chunk.values[row - chunk.first], strict=True))
    values |= {name: metric.value for name, metric in found.items()}
    if condition is None or judge_condition(condition, values):
        write_recording(run, make_path(chunk.records.folder) / f"row-{row:06d}.mcap")
        results.recorded += 1


def list_row_metrics(declaration: Declaration, patterns: Sequence[str] | None) -> tuple[str, ...]:
    """Return the ids of the requested metrics of a law.

    The default is the essential metrics without dead times. The scenario already sets the delays,
    and identifying dead times from the log of each run would take most of the time.
    """
    if patterns is not None:
        return measure.choose_metrics(patterns, declaration)
    kinds = measure.list_metrics(declaration)
    essential = measure.list_essential_metrics(declaration)
    return tuple(name for name in essential if not kinds[name].needs_dead_time)


def _enter_metrics(results: RowResults, found: Mapping[str, Metric]) -> None:
    before = len(results) - 1
    for name, metric in found.items():
        cells = results.metrics.get(name)
        if cells is None:
            cells = MetricCells(units=[], values=[None] * before, statuses=[None] * before)
            results.metrics[name] = cells
        if metric.unit not in cells.units:
            cells.units.append(metric.unit)
        # Some metrics are numpy numbers, which other processes need not load.
        cells.values.append(None if metric.value is None else float(metric.value))
        cells.statuses.append(metric.status.value)
    for name in results.metrics.keys() - found.keys():
        results.metrics[name].values.append(None)
        results.metrics[name].statuses.append(None)


def _parse_condition(records: RowRecords | None) -> expressions.Expression | None:
    if records is None or records.where is None:
        return None
    return expressions.parse_expression(records.where, source="--record-where")


def _list_asked(condition: expressions.Expression) -> list[str]:
    return [name for name in condition.names if measure.find_metric_kind(name) is not None]


def judge_condition(condition: expressions.Expression, values: Mapping[str, Any]) -> bool:
    """Return whether a condition holds; False if a value that it needs is missing."""
    truth = expressions.evaluate_expression(condition, values)
    if truth is not None and not isinstance(truth, bool):
        raise SweepError(f"{condition.source}: expected a condition, found {truth!r}")
    return truth is True


def require_condition(records: RowRecords | None, parameters: Mapping[str, Any]) -> None:
    """Refuse a condition that cannot be evaluated for any row, given the parameters of one."""
    condition = _parse_condition(records)
    if condition is not None:
        known = {"name": "", "stop_reason": "", **parameters}
        judge_condition(condition, known | dict.fromkeys(_list_asked(condition), 1.0))


_STOP_REASON: Final = Key("stop_reason")

_FAILED: Final = Key("failed")


class SweptRows:
    """Known facts of the finished rows. The rows themselves are in the partial file."""

    def __init__(self, kept: KeptParts[RowResults]) -> None:
        """Load the results of an interrupted sweep."""
        self._kept = kept
        self._parts: list[tuple[int, int, int]] = []  # first row, number of rows, and place
        self._metrics: dict[str, tuple[int, int]] = {}  # first row and place of each metric
        self._units: dict[tuple[str, str], tuple[int, int]] = {}
        self.count = self.samples = self.recorded = 0
        for place in kept.places:
            self._enter(kept.read(place), place)

    def add(self, results: RowResults) -> None:
        """Save the results of a chunk."""
        self._enter(results, self._kept.add(results))

    def _enter(self, results: RowResults, place: int) -> None:
        self._parts.append((results.first, len(results), place))
        self.count += len(results)
        self.samples += results.samples
        self.recorded += results.recorded
        for number, (name, cells) in enumerate(results.metrics.items()):
            found = results.first, number
            self._metrics[name] = min(self._metrics.get(name, found), found)
            for order, unit in enumerate(cells.units):
                first = results.first, order
                self._units[name, unit] = min(self._units.get((name, unit), first), first)

    def list_gaps(self, count: int) -> list[tuple[int, int]]:
        """Return the segments of unfinished rows: the first row, and the row after the last."""
        gaps, row = [], 0
        for first, size, _ in sorted(self._parts):
            if first > row:
                gaps.append((row, first))
            row = first + size
        return [*gaps, (row, count)] if row < count else gaps

    def list_metrics(self) -> dict[str, str]:
        """Return the metrics in the order of the rows, with their units."""
        units = sorted(self._units, key=self._units.__getitem__)
        return {
            name: " or ".join(unit for other, unit in units if other == name)
            for name in sorted(self._metrics, key=self._metrics.__getitem__)
        }

    def order(self, count: int) -> WindowedRows:
        """Return the rows in order; SweepError if rows are missing or duplicated."""
        stored, row = StoredRows(), 0
        for first, size, place in sorted(self._parts):
            if first != row:
                raise SweepError(f"row {row}: expected every row once, found row {first} instead")
            row += size
            stored.add(size, partial(self._load, place))
        if row != count:
            raise SweepError(f"row {row}: expected {count} rows, found {row}")
        return WindowedRows(stored, range(count))

    def _load(self, place: int) -> PartialColumns:
        results = self._kept.read(place)
        texts = {_STOP_REASON: results.stop_reasons, _FAILED: results.failed}
        cells = {key: StoredCells.pack("text", found) for key, found in texts.items()}
        for name, metric in results.metrics.items():
            cells[Key(name, "real")] = StoredCells.pack("real", metric.values)
            cells[Key(f"{name}{STATUS}")] = StoredCells.pack("text", metric.statuses)
        return PartialColumns(len(results), cells)


def assemble_table(plan: SweepPlan, facts: Mapping[str, str], rows: SweptRows) -> ResultTable:
    """Return the table of a sweep, whose rows are loaded on demand."""
    ordered, units = rows.order(plan.row_count), rows.list_metrics()
    keys = [
        *(key for name in units for key in (Key(name, "real"), Key(f"{name}{STATUS}"))),
        *(_STOP_REASON, _FAILED),
    ]

    def plan_column(key: str) -> ResultColumn:
        cells = ComputedItems(
            plan.row_count, lambda begin, end: plan.list_values(range(begin, end), key)
        )
        unit = split_key_unit(key)[1] or None
        return ResultColumn(name=key, type=plan.find_type(key), cells=cells, unit=unit)

    columns = [
        ResultColumn(name="row", type="whole", cells=range(plan.row_count)),
        *map(plan_column, plan.keys),
        *(
            replace(column, unit=units.get(column.name, column.unit))
            for column in build_result_columns(ordered, keys)
        ),
    ]
    names = [column.name for column in columns]
    twice = next((name for number, name in enumerate(names) if name in names[:number]), None)
    if twice is not None:
        raise SweepError(f"{twice}: expected one column of a name, found a key and a metric of it")
    own = {"varied": json.dumps(plan.keys), "samples": str(rows.samples)}
    own["recorded"] = str(rows.recorded)
    return ResultTable(kind="sweep", columns=tuple(columns), facts={**facts, **own})


def list_valueless(table: StoredTable, patterns: Sequence[str]) -> dict[str, str]:
    """Return the metrics without a value in any row, with their statuses in words."""
    found: dict[str, str] = {}
    for name in table.names:
        status = f"{name}{STATUS}"
        if status in table.names and table.count_values(name) == 0:
            had = dict.fromkeys(
                text for cells in table.iterate(status) for text in cells.unique().to_pylist()
            )
            found[name] = " or ".join(text for text in had if text) or "every such row failed"
    for pattern in patterns:
        if not any(name == pattern or fnmatchcase(name, pattern) for name in table.names):
            found[pattern] = "no loop has that name"
    return found


def find_failure(table: StoredTable) -> str:
    """Return the first row that failed, with the reason."""
    texts = (text for cells in table.iterate("failed") for text in cells.to_pylist())
    return next(f"row {row}: {text}" for row, text in enumerate(texts) if text is not None)
