"""A sweep: preparation of its rows, and in one call from arrays of values to a table in memory."""

import hashlib
import json
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from turtlelog.display import describe_count, fit_line, format_html, format_notebook
from turtlelog.errors import ScenarioError, SweepError
from turtlelog.laws import read_law_source
from turtlelog.laws.loading import list_law_files
from turtlelog.measure import choose_metrics
from turtlelog.run.tables import Tabular
from turtlelog.scenario import (
    Scenario,
    choose_scenario,
    flatten_scenario,
    format_scenario,
    parse_scenario,
    resolve_scenario,
    unwrap_number,
)
from turtlelog.simulate import declare_scenario
from turtlelog.simulate.step_budget import STEP_BUDGET_S
from turtlelog.sweep.plan import KP, MOST_ROWS, KeyValues, SweepPlan, build_row_scenario
from turtlelog.sweep.simulate_rows import RowChunk, RowRecords, require_condition
from turtlelog.sweep.sweep_rows import run_sweep
from turtlelog.sweep.table.result_table import (
    ResultTable,
    build_result_arrow,
    choose_type,
    open_result_table,
    write_result_table,
)
from turtlelog.sweep.table.swept_results import SweptResults, read_swept_results
from turtlelog.version import __version__

if TYPE_CHECKING:
    from concurrent.futures import Executor

_SHOWN_ROWS: Final = 20
"""Number of rows of the table shown in a notebook; the frame contains all rows."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class SweepTable(Tabular):
    """The results of a sweep: a table for pandas, polars and Arrow.

    The columns are the row number, the varied keys, each metric with its status, the stop reason,
    and the reason of a failure.

    Attributes:
        name: Name of the scenario that the rows vary.
        keys: Varied keys.
        table: All columns and the facts of the table.
        notes: Notes on laws that were not compiled or exceeded the step budget, one line each.
    """

    name: str
    keys: tuple[str, ...]
    table: ResultTable
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return self.table.row_count

    @property
    def failed(self) -> int:
        """Number of failed rows."""
        column = self.table.find("failed")
        return 0 if column is None else sum(cell is not None for cell in column.cells)

    def _tabulate(self) -> Mapping[str, Any]:
        return {one.name: one.cells for one in self.table.columns}

    def _list_units(self) -> Mapping[str, str]:
        return {one.name: one.unit for one in self.table.columns if one.unit}

    def to_arrow(self) -> Any:
        """Return the table as the `pyarrow.Table` that its file contains."""
        return build_result_arrow(self.table)

    def __repr__(self) -> str:
        return fit_line(f"<SweepTable of {self._describe()}>")

    def _describe(self) -> str:
        rows, failed = describe_count(len(self), "row"), self.failed
        more = f", {failed} failed" if failed else ""
        return f"{self.name}: {rows} over {', '.join(self.keys)}{more}"

    def _repr_html_(self) -> str:
        shown = [one for one in self.table.columns if one.name in self.keys or one.type == "real"]
        heads = [f"{one.name} [{one.unit}]" if one.unit else one.name for one in shown]
        rows = [[one.cells[row] for one in shown] for row in range(min(len(self), _SHOWN_ROWS))]
        rest = len(self) - len(rows)
        more = f"<p>{describe_count(rest, 'more row')}: to_pandas()</p>" if rest else ""
        notes = [f"<p>{escape(note)}</p>" for note in self.notes]
        return format_notebook(self._describe(), format_html(rows, heads=heads), more, *notes)


def sweep_scenario(  # noqa: PLR0913  (all but the first two have defaults)
    scenario: Scenario | str | Path,
    grid: Mapping[str, Iterable[Any]],
    *,
    metrics: str | Sequence[str] | None = None,
    law: Any = None,
    changes: Mapping[str, Any] | None = None,
    output: str | Path | None = None,
    jobs: "int | Executor | None" = None,
    step_budget_s: float = STEP_BUDGET_S,
) -> SweepTable:
    """Simulate and measure all combinations of values, with the last key changing fastest.

    The column `failed` gives the reason of a failed row; a failed row does not end the sweep.

    Args:
        scenario: Scenario that the rows vary: a scenario, the name of a preset, or a file.
        grid: Values by dotted key, as in `{"law.kp_linear": np.linspace(1, 4, 30)}`; the key `kp`
            sets all gains of the law.
        metrics: One or several metric ids or patterns. Default: the essential metrics except
            `dead_time`.
        law: Law to use instead of the scenario's law, as in `simulate_run`. A law defined in a
            notebook runs in several processes only on Linux, elsewhere in one. A cluster receives
            the law with the work.
        changes: Values by dotted key, the same for all rows.
        output: Path of the .parquet file; the same call resumes an interrupted sweep. Default: no
            file.
        jobs: Number of processes, or an executor. Default: one per core if that is faster.
        step_budget_s: Longest computing time of the law per step [s].

    Raises:
        SweepError: If `grid` contains no values to vary, or the file belongs to another sweep.
        MeasureError: If `metrics` contains an unknown metric.
        LawError: If `law` is not a valid law.
        ScenarioError: If the scenario does not exist, or no row forms a valid scenario.
        LogError: If `output` cannot be written.
        LibraryError: If pyarrow is not installed.
    """
    base = choose_scenario(scenario, law=law, changes=changes)
    plan = SweepPlan(grid=tuple(_read_values(grid)))
    metrics = [metrics] if isinstance(metrics, str) else metrics
    sweep = prepare_sweep(base, plan, metrics=metrics, step_budget_s=step_budget_s)
    notes: list[str] = []
    with tempfile.TemporaryDirectory(prefix="turtlelog-") as folder:
        file = Path(folder, "sweep.parquet") if output is None else output
        run_sweep(sweep, file, jobs=jobs, tell=notes.append)
        return replace(read_sweep_table(file), notes=tuple(notes))


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """A sweep that can be run, as returned by `prepare_sweep`.

    Attributes:
        base: Scenario that the rows vary, as text.
        plan: Plan of the rows.
        metrics: Metric ids or patterns. Default: the essential metrics of each row's law except
            `dead_time`.
        records: Runs to record; None: no run is recorded.
        law_code: Checksum of the files of a law that is not built in; empty otherwise.
        step_budget_s: Longest computing time of the law per step [s]; a sweep may be resumed with
            another value.
    """

    base: str
    plan: SweepPlan
    metrics: tuple[str, ...] | None = None
    records: RowRecords | None = None
    law_code: str = ""
    step_budget_s: float = STEP_BUDGET_S

    def list_facts(self) -> dict[str, str]:
        """Return the facts that identify a sweep, for file metadata."""
        where = None if self.records is None else (self.records.folder, self.records.where)
        return {
            "base": self.base,
            "plan": self.plan.describe(),
            "metrics": json.dumps(self.metrics),
            "records": json.dumps(where),
            "law_code": self.law_code,
            "version": __version__,
        }

    def cut_chunk(self, first: int, count: int, *, ahead: int = 0, threads: int = 1) -> RowChunk:
        """Return a range of rows as a chunk of work."""
        rows = range(first, first + count)
        columns = [self.plan.list_values(rows, key) for key in self.plan.keys]
        return RowChunk(
            base=self.base,
            keys=self.plan.keys,
            first=first,
            values=tuple(zip(*columns, strict=True)),
            metrics=self.metrics,
            records=self.records,
            ahead=ahead,
            threads=threads,
            step_budget_s=self.step_budget_s,
        )


def prepare_sweep(  # noqa: PLR0913  (all but the first two have defaults)
    base: Scenario,
    plan: SweepPlan,
    *,
    metrics: Sequence[str] | None = None,
    records: RowRecords | None = None,
    trust_law: bool = False,
    step_budget_s: float = STEP_BUDGET_S,
    source: str = "grid",
) -> Sweep:
    """Return a sweep of a base scenario. The first, a middle and the last row are checked.

    Args:
        base: Scenario that the rows vary.
        plan: Plan of the rows; the key `kp` stands for all gains of the law.
        metrics: Metric ids or patterns. Default: the essential metrics of each row's law except
            `dead_time`.
        records: Runs to record.
        trust_law: Whether a law named in a recording may run too.
        step_budget_s: Longest computing time of the law per step [s]; rows that exceed it fail.
        source: Prefix of error messages about the values of a row.

    Raises:
        SweepError: If `kp` varies, and the law declares no gain or other keys vary together.
        ScenarioError: If none of these rows forms a valid scenario, or the law may not run.
        MeasureError: If a metric is unknown.
        ExpressionError: If the condition on recordings cannot be evaluated.
    """
    trusted = True if trust_law else None
    if KP in plan.keys:
        declared = declare_scenario(resolve_scenario(base, trust_law=trust_law))
        plan = plan.spread_gains(declared.list_gains())
    found, errors = [], []
    for row in plan.list_probes():
        try:
            scenario = build_row_scenario(
                base, plan.keys, plan.find_values(row), row, source=source, trust_law=trusted
            )
            found.append(resolve_scenario(scenario, trust_law=trust_law))
        except ScenarioError as err:
            errors.append(err)
    if not found:
        raise errors[0]
    known = [flatten_scenario(one) for one in found]
    real = {key for key in plan.keys if any(isinstance(one.get(key), float) for one in known)}
    if metrics is not None:
        for one in found:
            choose_metrics(metrics, declare_scenario(one))
    first = dict(zip(plan.keys, plan.find_values(0), strict=True))
    require_condition(records, {**known[0], **first})
    kinds = {one.law.kind for one in found} | {str(one.get("law.kind")) for one in known}
    return Sweep(
        base=format_scenario(base),
        plan=plan.with_reals(real),
        metrics=None if metrics is None else tuple(metrics),
        records=records,
        law_code=_sum_up_code(sorted(kinds)),
        step_budget_s=step_budget_s,
    )


def _sum_up_code(kinds: Sequence[str]) -> str:
    """Return a checksum of the files of laws and of the modules that they import from their folder.

    For a law defined in this session, the checksum is that of its source text. The result is empty
    if all laws are built in or modules.
    """
    texts = [text for kind in kinds if (text := read_law_source(kind)) is not None]
    laws = [Path(kind.rpartition(":")[0]) for kind in kinds if ".py:" in kind]
    files = [file for law in laws for file in list_law_files(law)]
    parts = [*(path.read_bytes() for path in files), *(text.encode() for text in texts)]
    return hashlib.sha256(b"".join(parts)).hexdigest() if parts else ""


def read_sweep_table(path: str | Path) -> SweepTable:
    """Return the table of a sweep in a file.

    Raises:
        LogError: If the file is not a table of a sweep.
        LibraryError: If pyarrow is not installed.
    """
    table = open_result_table(path, kind="sweep").load()
    name = parse_scenario(table.facts["base"]).name
    plan = json.loads(table.facts["plan"])
    return SweepTable(name=name, keys=(*plan["grid"], *plan["zip"]), table=table)


def read_table_results(table: SweepTable, patterns: Sequence[str] | None = None) -> SweptResults:
    """Return the rows of a table in memory for charts, as `read_swept_results` does."""
    with tempfile.TemporaryDirectory(prefix="turtlelog-") as folder:
        file = Path(folder, "sweep.parquet")
        write_result_table(table.table, file)
        return replace(read_swept_results(file, patterns), path=f"sweep of {table.name}")


def _read_values(grid: Mapping[str, Iterable[Any]]) -> Iterator[KeyValues]:
    """Yield the values of each key, numpy numbers converted to Python numbers."""
    example = '{"law.kp_linear": [1.0, 2.0]}'
    if not isinstance(grid, Mapping) or not grid:
        raise SweepError(f"grid: expected values by key, as in {example}, found {grid!r:.60}")
    rows = 1
    for key, given in grid.items():
        if not isinstance(key, str) or isinstance(given, str) or not isinstance(given, Iterable):
            raise SweepError(f"grid: {key}: expected values, as in {example}, found {given!r:.60}")
        values = [unwrap_number(one) for one in given]
        if not values:
            raise SweepError(f"grid: {key}: has no values; give them as in {example}")
        if any(getattr(one, "ndim", 0) for one in values):
            raise SweepError(f"grid: {key}: expected one dimension, found {given!r:.60}")
        is_text = choose_type(values) == "text"
        if None in values or (is_text and not all(isinstance(one, str) for one in values)):
            expected = "numbers, texts or truths alone"
            raise SweepError(f"grid: {key}: expected {expected}, found {values!r:.60}")
        rows *= len(values)
        text = ",".join(one if isinstance(one, str) else json.dumps(one) for one in values)
        yield KeyValues(key=key, text=text, values=values)
    if rows > MOST_ROWS:
        raise SweepError(f"grid: expected at most {MOST_ROWS:,} rows, found {rows:,}")
