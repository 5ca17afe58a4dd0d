"""A sweep: preparation of its rows, their simulation on all cores, and all of it in one call."""

import hashlib
import json
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from turtlelog.errors import LogError, ScenarioError, SweepError
from turtlelog.files.urls import RemotePath, has_files, make_path
from turtlelog.laws import WorkWithLaws, is_given, read_law_source
from turtlelog.laws.loading import list_law_files
from turtlelog.libraries import __version__
from turtlelog.log.file_access import name_file, remove_leftovers
from turtlelog.measure import choose_metrics
from turtlelog.processes import CAN_FORK, LONG_S, count_cores, map_in_processes
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
from turtlelog.sweep import sweep_rows
from turtlelog.sweep.batch import find_batch
from turtlelog.sweep.partial_table import KeptParts, has_results, name_partial, require_same
from turtlelog.sweep.result_table import (
    ComputedItems,
    choose_type,
    open_result_table,
    write_result_table,
)
from turtlelog.sweep.sweep_plan import KP, MOST_ROWS, KeyValues, SweepPlan, build_row_scenario
from turtlelog.sweep.sweep_table import SweepTable, read_sweep_table

if TYPE_CHECKING:
    from concurrent.futures import Executor


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
    """A sweep that can be run, as returned by `prepare_sweep`."""

    base: str  # scenario that the rows vary, as text
    plan: SweepPlan  # plan of the rows
    metrics: tuple[str, ...] | None = None  # ids or patterns. Default: essential, no `dead_time`
    records: sweep_rows.RowRecords | None = None  # runs to record; None: no run is recorded
    law_code: str = ""  # checksum of the files of a law that is not built in; empty otherwise
    step_budget_s: float = STEP_BUDGET_S  # longest step [s]; may differ in a resumed sweep

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

    def cut_chunk(
        self, first: int, count: int, *, ahead: int = 0, threads: int = 1
    ) -> sweep_rows.RowChunk:
        """Return a range of rows as a chunk of work."""
        rows = range(first, first + count)
        columns = [self.plan.list_values(rows, key) for key in self.plan.keys]
        return sweep_rows.RowChunk(
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
    records: sweep_rows.RowRecords | None = None,
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
    if KP in plan.keys:
        declared = declare_scenario(resolve_scenario(base, trust_law=trust_law))
        plan = plan.spread_gains(declared.list_gains())
    found = _resolve_probes(base, plan, trust_law=trust_law, source=source)
    known = [flatten_scenario(one) for one in found]
    real = {key for key in plan.keys if any(isinstance(one.get(key), float) for one in known)}
    if metrics is not None:
        for one in found:
            choose_metrics(metrics, declare_scenario(one))
    first = dict(zip(plan.keys, plan.find_values(0), strict=True))
    sweep_rows.require_condition(records, {**known[0], **first})
    kinds = {one.law.kind for one in found} | {str(one.get("law.kind")) for one in known}
    return Sweep(
        base=format_scenario(base),
        plan=plan.with_reals(real),
        metrics=None if metrics is None else tuple(metrics),
        records=records,
        law_code=_digest_laws(sorted(kinds)),
        step_budget_s=step_budget_s,
    )


def _resolve_probes(
    base: Scenario, plan: SweepPlan, *, trust_law: bool, source: str
) -> list[Scenario]:
    """Return the scenarios of the probed rows that are valid; if none is, the first error."""
    found, errors, trusted = [], [], True if trust_law else None
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
    return found


def _digest_laws(kinds: Sequence[str]) -> str:
    """Return a digest of the code of laws; empty if all are built in."""
    # Files of laws and the modules that they import from their folder, or the text of a law of this
    # session; built-in laws and modules have neither.
    paths = [Path(kind.rpartition(":")[0]) for kind in kinds if ".py:" in kind]
    code = [file.read_bytes() for path in paths for file in list_law_files(path)]
    code += [text.encode() for kind in kinds if (text := read_law_source(kind)) is not None]
    return hashlib.sha256(b"".join(code)).hexdigest() if code else ""


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


_CHUNK_S: Final = 0.5
"""Duration of a chunk, measured on the first row [s]: the largest loss by an interruption."""

_MOST_IN_CHUNK: Final = 1024  # rows in a chunk, of which a process keeps all results in memory
_MOST_IN_BATCH: Final = 4096  # rows in a compiled chunk: half a second of usual rows


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepSummary:
    """Results of a sweep.

    The valueless metrics have no value in any row.
    """

    output: Path  # path of the table
    rows: int  # number of rows
    failed: int  # number of failed rows
    samples: int  # total number of samples of all runs
    recorded: int = 0  # number of recorded runs
    first_failure: str = ""  # row and reason of the first failure; empty if no row failed
    valueless: Mapping[str, str] = field(default_factory=dict)  # statuses by metric


def run_sweep(
    sweep: Sweep,
    output: str | Path,
    *,
    jobs: "int | Executor | None" = None,
    watch: Callable[[int], None] | None = None,
    tell: Callable[[str], None] | None = None,
) -> SweepSummary:
    """Simulate all rows of a sweep, write their table and return a summary.

    Finished rows are saved next to the output: the same sweep into the same file resumes from
    there. If the results already exist, nothing is simulated.

    Args:
        sweep: Result of `prepare_sweep`.
        output: Path of the Parquet file.
        jobs: Number of processes, or an executor. Default: one per core if that is faster.
        watch: Function that is called with the number of finished rows.
        tell: Function that is called once, with the first row whose law exceeds the step budget.

    Raises:
        SweepError: If the file belongs to another sweep, another process is writing it, or the disk
            is full.
        LogError: If the results cannot be written.
    """
    output, facts = make_path(output), sweep.list_facts()
    if has_results(output, facts):
        name_partial(output).unlink(missing_ok=True)
        return _summarise(output, sweep)
    kept = KeptParts(output, facts, sweep_rows.RowResults, require=partial(require_same, facts))
    is_complete = False
    try:
        _begin_records(sweep, kept)
        rows = sweep_rows.SweptRows(kept)
        _simulate(sweep, rows, jobs, _Telling(watch, tell))
        write_result_table(sweep_rows.assemble_table(sweep.plan, facts, rows), output)
        is_complete = True
    finally:
        kept.close(is_complete=is_complete)
    return _summarise(output, sweep)


def _begin_records(sweep: Sweep, kept: KeptParts[sweep_rows.RowResults]) -> None:
    """Create the folder of recordings, or remove a killed sweep's incomplete files from it.

    A folder with files is refused unless the sweep is resumed.
    """
    folder = None if sweep.records is None else make_path(sweep.records.folder)
    if folder is not None and not kept.was_begun:
        try:
            _make_folder(folder)
        except (LogError, SweepError):
            kept.close(is_complete=True)  # nothing was begun
            raise
    elif folder is not None and not isinstance(folder, RemotePath):
        remove_leftovers(folder)


def _make_folder(folder: Path) -> None:
    with name_file(folder, expected="a place that can be written"):
        is_used = has_files(folder)
    if is_used:
        raise SweepError(f"{folder}: expected a new folder for recordings, found one with files")
    try:
        if not isinstance(folder, RemotePath):
            folder.mkdir(exist_ok=True)
    except OSError as err:
        expected = "the name of a folder to make"
        raise SweepError(f"{folder}: expected {expected}, found: {err.strerror or err}") from err


def _simulate(
    sweep: Sweep, rows: sweep_rows.SweptRows, jobs: "int | Executor | None", watch: "_Telling"
) -> None:
    """Simulate the remaining rows; the first two run alone to measure the time per row."""
    watch(rows.count)
    for _ in range(2):  # the first row includes loading times
        gaps = rows.list_gaps(sweep.plan.row_count)
        if not gaps:
            return
        first = sweep.cut_chunk(gaps[0][0], 1)
        begun = time.perf_counter()
        found = sweep_rows.simulate_rows(first)
        row_s = time.perf_counter() - begun
        rows.add(found)
        watch(rows.count, found)
    rest = sweep.plan.row_count - rows.count
    if jobs is None:
        jobs = count_cores() if rest * row_s > LONG_S else 1
    count, threads = (jobs if isinstance(jobs, int) else 1), 1
    batch = find_batch(parse_scenario(sweep.base)) if sweep_rows.is_batch(first) else None
    if batch is not None and batch.expect(rest, row_s / count) is not None:
        size = _MOST_IN_BATCH
        if isinstance(jobs, int):
            # Threads share loaded code; processes would take longer to start.
            jobs, threads = 1, jobs
    else:
        size = max(1, min(_MOST_IN_CHUNK, int(_CHUNK_S / row_s), -(-rest // count)))
    laws = _list_given_laws(sweep)
    if laws and isinstance(jobs, int) and not CAN_FORK:
        jobs = 1
    work = WorkWithLaws(sweep_rows.simulate_rows, () if isinstance(jobs, int) else laws)
    cut = partial(sweep.cut_chunk, ahead=rest // count, threads=threads)
    chunks = _cut_chunks(cut, rows.list_gaps(sweep.plan.row_count), size)
    for results in map_in_processes(work, chunks, jobs, name=_name_chunk, is_forked=bool(laws)):
        rows.add(results)
        watch(rows.count, results)


def _cut_chunks(
    cut: Callable[[int, int], sweep_rows.RowChunk], gaps: Sequence[tuple[int, int]], size: int
) -> Sequence[sweep_rows.RowChunk]:
    """Return chunks of work on segments of rows, created on demand."""
    cuts = [(row, min(size, end - row)) for first, end in gaps for row in range(first, end, size)]
    return ComputedItems(len(cuts), lambda first, end: [cut(*one) for one in cuts[first:end]])


def _name_chunk(chunk: sweep_rows.RowChunk) -> str:
    return f"rows {chunk.first} to {chunk.first + len(chunk.values) - 1}"


def _list_given_laws(sweep: Sweep) -> tuple[str, ...]:
    """Return the laws of the rows that exist only in this process and its forks."""
    keys = (*sweep.plan.grid, *sweep.plan.zipped)
    kinds = [kind for one in keys if one.key == "law.kind" for kind in one.values]
    return tuple(filter(is_given, dict.fromkeys([parse_scenario(sweep.base).law.kind, *kinds])))


class _Telling:
    """Reports the number of finished rows, notes of compiled loops, and the first late row."""

    def __init__(
        self, watch: Callable[[int], None] | None, tell: Callable[[str], None] | None
    ) -> None:
        self._watch, self._tell = watch or (lambda _: None), tell or (lambda _: None)
        self._notes, self._has_told = set[str](), False

    def __call__(self, done: int, results: sweep_rows.RowResults | None = None) -> None:
        self._watch(done)
        if results is None:
            return
        for note in results.notes:
            if note not in self._notes:
                self._notes.add(note)
                self._tell(note)
        late = None if self._has_told else results.find_late()
        if late is not None:
            self._has_told = True
            self._tell(f"row {late[0]}: {late[1]}")


def _summarise(output: Path, sweep: Sweep) -> SweepSummary:
    """Return the summary of a table, with at most one row group in memory."""
    table = open_result_table(output, kind="sweep")
    failed = table.count_values("failed")
    return SweepSummary(
        output=output,
        rows=table.row_count,
        failed=failed,
        samples=int(table.facts["samples"]),
        recorded=int(table.facts["recorded"]),
        first_failure=sweep_rows.find_failure(table) if failed else "",
        valueless=sweep_rows.list_valueless(table, sweep.metrics or ()),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepEstimate:
    """Estimated cost of a sweep, measured on a few of its rows."""

    seconds: float  # duration with the given number of processes [s]
    bytes: int  # size of the table [bytes]; the file may be smaller if values repeat


def estimate_sweep(sweep: Sweep, *, jobs: int | None = None) -> SweepEstimate:
    """Simulate a few rows and return the estimated cost of all rows."""
    count, jobs = sweep.plan.row_count, jobs or count_cores()
    probes = sweep.plan.list_probes()
    for row in probes:  # loading times are not counted for every row
        found = sweep_rows.simulate_rows(sweep.cut_chunk(row, 1, ahead=count // jobs))
    begun = time.perf_counter()
    for row in probes:
        sweep_rows.simulate_rows(sweep.cut_chunk(row, 1, ahead=count // jobs))
    row_s = (time.perf_counter() - begun) / len(probes)
    numbers = 1 + len(sweep.plan.keys) + len(found.metrics)
    return SweepEstimate(seconds=row_s * count / jobs, bytes=8 * numbers * count)
