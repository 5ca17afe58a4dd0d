"""`turtlelog sweep`: a scenario varied, simulated and measured, as one table."""

import shlex
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Annotated, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli import console, options
from turtlelog.cli.list_names import complete_keys, complete_metrics
from turtlelog.cli.scenario import LawOptions, ScenarioWord, list_given_keys, load_changed_scenario
from turtlelog.cli.usage import Whole
from turtlelog.cli.work import WorkOptions, show_progress
from turtlelog.display import describe_count, format_range
from turtlelog.errors import SweepError, UsageError
from turtlelog.files.urls import make_path

_MANY_ROWS: Final = 1_000_000
"""Number of rows from which consent is requested; without compilation, these rows take hours."""


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class PlanOptions:
    """Rows of the sweep.

    Attributes:
        grid: Vary a key over a range with both ends, or over a list. Examples:
            law.kp_linear=0.5:12:0.25 (default step: 1), law.projection=bearing,heading, kp=1:12
            (all gains together). Can be repeated: every combination is a row, the last key varies
            fastest.
        zip_: Vary two or more keys together: their first values, their second values, and so on.
            Give this option once for each key.
        sample: Number of rows to choose at random instead: any number between A and B for A:B, one
            value for A:B:STEP or a list.
        seed: Seed of the random choice. Default: 0.
        latin: Latin hypercube: divide each key's range into as many equal parts as there are rows,
            and use each part once.
    """

    grid: Annotated[list[str] | None, Parameter(metavar="KEY=VALUES", completer=complete_keys)] = (
        None
    )
    zip_: Annotated[
        list[str] | None, Parameter(name="--zip", metavar="KEY=VALUES", completer=complete_keys)
    ] = None
    sample: Annotated[Whole | None, Parameter(metavar="COUNT")] = None
    seed: Annotated[Whole | None, Parameter(metavar="NUMBER")] = None
    latin: bool = False

    def build_plan(self) -> "tl.sweep.SweepPlan":
        """Return the requested rows."""
        sampling = None
        if self.sample is not None:
            sampling = tl.sweep.Sampling(
                count=self.sample, seed=self.seed or 0, is_latin=self.latin
            )
        elif self.seed is not None:
            raise UsageError(
                "--seed: needs --sample COUNT; --grid seed=0:9 varies that of the scenario"
            )
        elif self.latin:
            raise UsageError("--latin: needs --sample COUNT")
        return tl.sweep.build_plan(self.grid or (), self.zip_ or (), sampling)


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class SweepTableOptions:
    """Options for the written files.

    Attributes:
        output: Write the table to this .parquet file, or behind a URL.
        metric: Ids or patterns of metrics (turtlelog list metrics). Example:
            rotate.overshoot,final.*. Default: the essential metrics of each row's law, without
            dead_time.
        record: Write a recording of each row to this folder or URL. Example of a name:
            row-000123.mcap.
        record_where: With --record: only rows that meet this condition. Example:
            "translate.settling_time > 5".
    """

    output: Annotated[options.Place, Parameter(name=("--output", "-o"))]
    metric: Annotated[str | None, Parameter(metavar="IDS", completer=complete_metrics)] = None
    record: Annotated[options.Place | None, Parameter(metavar="DIR")] = None
    record_where: Annotated[str | None, Parameter(metavar="EXPRESSION")] = None

    def build_records(self, work: WorkOptions) -> "tl.sweep.RowRecords | None":
        """Return the settings for recording runs, with paths that are valid for workers."""
        if self.record is None:
            if self.record_where is not None:
                raise UsageError("--record-where: needs --record DIR")
            return None
        (folder,) = work.name_files([self.record])
        return tl.sweep.RowRecords(folder=str(folder), where=self.record_where)


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class SweepOptions(WorkOptions):
    """Options for the work.

    Attributes:
        yes: Sweep over more than a million rows without asking.
        trust_law: Run the code of the law that a recording names, if the law is not built in.
        step_budget_ms: A row fails if its law computes longer than this in one step (wall-clock
            time). Default: 10000. Unit: ms. Without the option, built-in laws have no limit.
    """

    yes: bool = False
    trust_law: bool = False
    step_budget_ms: options.StepBudgetMs = None


def sweep(
    base: ScenarioWord = None,
    /,
    *,
    table: SweepTableOptions,
    plan: PlanOptions = PlanOptions(),
    changes: LawOptions = LawOptions(),
    work: SweepOptions = SweepOptions(),
    json: options.Json = False,
) -> int:
    """Vary a scenario, simulate and measure every variant, and write one table.

    A row of the Parquet table is a run: its number, the values of the keys, each metric with its
    status, and how the run ended or why it failed. A failed run does not stop the sweep. Rows equal
    the results of `run` for the same scenario, bit for bit, on any number of cores. The same
    command writes the same file, and continues an interrupted sweep.

    Example: turtlelog sweep paper-kp4 --grid law.kp_linear=1:12:0.5 -o kp.parquet

    Example: turtlelog sweep mine.toml --grid seed=0:31 --record runs -o s.parquet

    Random effects use the scenario's seed. The seed is the same in every row unless the seed is
    varied: --grid seed=0:31. `turtlelog run --from results.parquet --row 123` simulates a row
    again.

    Args:
        base: A preset (turtlelog list presets), a scenario file (.toml), also one written by
            `identify`, or a recording. Default: paper; with --law: textbook.
        json: Print one JSON object instead of a line.
    """
    begun = time.monotonic()
    scenario, prepared = _prepare(base, table, plan, changes, work)
    rows = prepared.plan.row_count
    if rows > _MANY_ROWS and not work.yes:
        _ask_consent(prepared, table.output, work.jobs)
    with (
        work.find_any_place() as place,
        show_progress("simulated", rows, "rows", has_rate=True) as progress,
    ):
        try:
            found = tl.sweep.run_sweep(
                prepared, table.output, jobs=place, watch=progress.set, tell=_tell_late
            )
        except KeyboardInterrupt:
            console.print_note(
                f"{int(progress.done)} of {rows} rows are done; the same command goes on"
            )
            raise
    seed = _find_seed(scenario, prepared.plan)
    _answer(found, prepared.plan, seed, time.monotonic() - begun, json=json)
    return console.EXIT_FINE


def _tell_late(late: str) -> None:
    console.print_note(
        f"{late}. Every such row takes as long. Ctrl-C keeps the rows that are done: the same"
        " command goes on, also with a shorter --step-budget-ms"
    )


def _prepare(
    base: str | None,
    table: SweepTableOptions,
    plan: PlanOptions,
    changes: LawOptions,
    work: SweepOptions,
) -> "tuple[tl.Scenario, tl.sweep.Sweep]":
    inputs = [] if base is None else [make_path(base)]
    options.require_new_target(table.output, inputs, suffix=".parquet")
    rows, records = plan.build_plan(), table.build_records(work)
    scenario = load_changed_scenario(base, changes)
    prepared = tl.sweep.prepare_sweep(
        scenario,
        rows,
        metrics=options.split_names(table.metric, "--metric"),
        records=records,
        trust_law=work.trust_law,
        step_budget_s=options.choose_step_budget(work.step_budget_ms),
        source="--grid",
    )
    for key in list_given_keys(changes):
        if key in prepared.plan.keys:
            raise UsageError(f"--set: {key} is varied by --grid; leave one of them out")
    return scenario, prepared


def _ask_consent(prepared: "tl.sweep.Sweep", output: Path, jobs: int | None) -> None:
    """Print the cost of a large sweep, and continue if the user at the terminal agrees."""
    rows = prepared.plan.row_count
    found = tl.sweep.estimate_sweep(prepared, jobs=jobs)
    took = timedelta(seconds=max(1, round(found.seconds)))
    takes = f"{rows:,} rows: about {took}, and {found.bytes / 1e6:,.0f} MB in {output}"
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise UsageError(f"{takes}; add --yes to start it")
    console.print_note(takes)
    sys.stderr.write("Go on? [y/N] ")
    sys.stderr.flush()
    if sys.stdin.readline().strip().lower() not in {"y", "yes"}:
        raise UsageError("stopped: the answer was not yes")


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepAnswer:
    """Results of a sweep.

    Attributes:
        output: Path of the table.
        rows: Number of rows.
        failed: Number of failed rows.
        samples: Total number of samples of all runs.
        recorded: Number of recorded runs.
        elapsed_s: Time that the command took [s].
    """

    output: str
    rows: int
    failed: int
    samples: int
    recorded: int
    elapsed_s: float


def _answer(
    found: "tl.sweep.SweepSummary",
    plan: "tl.sweep.SweepPlan",
    seed: int | None,
    elapsed_s: float,
    *,
    json: bool,
) -> None:
    for name, reason in found.valueless.items():
        console.print_note(f"metric {name}: no row has a value ({reason})")
    if json:
        console.print_json(
            console.copy_fields(SweepAnswer, found, output=str(found.output), elapsed_s=elapsed_s)
        )
        return
    if found.failed:
        console.print_note(
            f"{describe_count(found.failed, 'row')} failed, the first: {found.first_failure}"
        )
    keys = ", ".join(plan.keys)
    recorded = f" {found.recorded} runs are recorded." if found.recorded else ""
    failed = f", {found.failed} failed" if found.failed else ""
    rows = f"{describe_count(found.rows, 'run')} over {keys}{failed}"
    console.print_text(
        console.fill_lines(
            [
                f"{rows}: {_describe_best(found.output)}.",
                *(() if seed is None else (_SAME_SEED.format(seed=seed),)),
                f"{found.output}: {found.samples:,} samples in {elapsed_s:.1f} s.{recorded}",
                f"Map: turtlelog plot {shlex.quote(str(found.output))} -o map.png",
            ]
        )
    )


_SAME_SEED: Final = (
    "Every row has the same random effects, of seed {seed}. --grid seed=0:31 shows how far they"
    " scatter."
)


def _find_seed(scenario: "tl.Scenario", plan: "tl.sweep.SweepPlan") -> int | None:
    """Return the one seed of all random effects; None without such effects, or with many seeds."""
    from turtlelog.explain.causes import draws_random
    from turtlelog.simulate.loop_parts import RANDOM_KEYS

    is_random = draws_random(scenario) or not RANDOM_KEYS.isdisjoint(plan.keys)
    return scenario.seed if is_random and "seed" not in plan.keys else None


_TOLD: Final = ("final.position_error", "run.duration")
"""Metrics whose range is printed: the first metric with values, or else any other metric."""


def _describe_best(output: Path) -> str:
    """Return the range of a metric over all rows, with its best row."""
    import numpy as np

    for patterns in (*([name] for name in _TOLD), None):
        with suppress(SweepError):
            results = tl.sweep.read_swept_results(output, patterns)
            for metric in results.metrics:
                if np.isfinite(metric.values).any():
                    return _describe_range(results, metric)
    return "no metric has a value in any row"


def _describe_range(results: "tl.sweep.SweptResults", metric: "tl.sweep.SweptMetric") -> str:
    import numpy as np

    values = metric.values
    low, high = format_range(float(np.nanmin(values)), float(np.nanmax(values)), metric.unit)
    if low == high:
        where = "every run" if np.isfinite(values).all() else "every run that has a value"
        return f"{metric.name} is {low} in {where}"
    return f"{metric.name} is {low} to {high}{_tell_least(results, metric)}"


def _tell_least(results: "tl.sweep.SweptResults", metric: "tl.sweep.SweptMetric") -> str:
    """Return with which keys a metric is least; over seeds, with which its mean is least."""
    import numpy as np

    view, kind = tl.sweep.choose_view(results), tl.measure.find_metric_kind(metric.name)
    is_whole = len(view.rows) == results.row_count and kind is not None and kind.better == "lower"
    best = tl.sweep.find_best_row(view, metric) if is_whole else None
    if best is None or best.others is None:
        is_one = any("seed" in axis.keys and len(axis) > 1 for axis in results.axes)
        run = " in a single run," if is_one else ""
        return f", least{run} with {results.tell_row(int(np.nanargmin(metric.values)))}"
    seeds = describe_count(view.seeds, "seed")
    if best.is_open:
        return f"; over {seeds}, all differences of the means may be chance"
    row = results.row_numbers.index(best.row)
    keys = ", ".join(axis.tell_row(row) for axis in results.axes if "seed" not in axis.keys)
    return f"; its mean over {seeds} is least with {keys}"
