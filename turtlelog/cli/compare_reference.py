"""`turtlelog compare` against a reference: runs against a run, robots against a scenario."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import turtlelog as tl
from turtlelog.cli import console
from turtlelog.cli.compare_answer import format_reference, format_robots, list_errors
from turtlelog.cli.options import ReadingOptions, read_runs, require_pictures
from turtlelog.cli.work import show_progress, watch_files
from turtlelog.compare.difference import compare_measured
from turtlelog.errors import TurtlelogError, UsageError
from turtlelog.processes import map_in_processes

if TYPE_CHECKING:
    from collections.abc import Mapping

    from turtlelog.cli.compare import ReferenceOptions


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """Comparison of one run with the reference."""

    summary: "tl.compare.RunSummary"
    comparison: "tl.compare.RunComparison"
    path_error: "tl.compare.PathDeviation"


@dataclass(frozen=True, kw_only=True)
class _Comparer:
    """A comparer of runs with a reference, one after another, in this process or another."""

    reference: "tl.Run"
    alignment: str
    choice: "tl.log.ReadChoice"

    @cached_property
    def _metrics(self) -> "Mapping[str, tl.Metric]":
        return tl.measure_run(self.reference)

    def __call__(self, path: Path) -> Compared:
        return self.compare(path, tl.log.read_as_chosen(path, self.choice))

    def compare(self, path: Path, run: "tl.Run") -> Compared:
        """Return the comparison of a run that has been read."""
        usual = [
            name for one in (run, self.reference) for name in tl.compare.list_usual_of_run(one)
        ]
        metrics = _measure_known(run, usual)
        error = tl.compare.measure_path_error(self.reference, run, alignment=self.alignment)
        return Compared(
            summary=tl.summarise_run(run, file=str(path), metrics=metrics),
            comparison=compare_measured(
                self.reference, self._metrics, run, alignment=self.alignment
            ),
            path_error=error,
        )


def compare_with_reference(
    paths: Sequence[Path],
    held: "Sequence[tl.Run] | None",
    against: "ReferenceOptions",
    topics: ReadingOptions | None,
    *,
    jobs: int,
    kind: str,
) -> None:
    """Print the distances of runs from the first run.

    Runs in `held` are read already, and are compared in this process.
    """
    alignment = against.align or "first_sample"
    if alignment == "first-sample":
        alignment = "first_sample"
    choice = (topics or ReadingOptions()).build_choice()
    reference = tl.log.read_as_chosen(paths[0], choice) if held is None else held[0]
    comparer = _Comparer(reference=reference, alignment=alignment, choice=choice)
    others = paths[1:]
    if held is None:
        console.print_run_notes(paths[0], reference.notes)
        found: Iterable[Compared] = map_in_processes(comparer, others, jobs)
    else:
        found = map(comparer.compare, others, held[1:])
    compared: list[Compared] = []
    for one in watch_files(found, len(others)):
        compared.append(one)
        if held is None:
            console.print_run_notes(one.summary.file, one.summary.notes)
    if kind == "json":
        runs = [_build_run(*pair) for pair in zip(paths[1:], compared, strict=True)]
        console.print_json(
            _ReferenceAnswer(reference=str(paths[0]), alignment=alignment, runs=runs)
        )
    else:
        usual = [*tl.compare.list_usual_of_run(reference)]
        summaries = [one.summary for one in compared]
        unlike = [one for one in summaries if one.is_lawless != reference.is_lawless]
        usual += tl.compare.list_usual_of_run(unlike[-1]) if unlike else ()
        first = tl.summarise_run(
            reference, file=str(paths[0]), metrics=_measure_known(reference, usual)
        )
        if kind != "txt":
            console.print_tables(_tabulate(first, compared, kind), kind)
            return
        console.print_text(format_reference(first, compared, shows_signals=against.details))


def _measure_known(run: "tl.Run", names: Sequence[str]) -> "Mapping[str, tl.Metric]":
    known = tl.measure.list_metrics(run.declaration)
    return tl.measure_run(run, only=[name for name in names if name in known])


def _tabulate(
    first: "tl.compare.RunSummary", compared: "Sequence[Compared]", kind: str
) -> "list[tl.compare.Table]":
    summaries = [first, *(one.summary for one in compared)]
    comparisons = [one.comparison for one in compared]
    reference, *names = tl.compare.name_runs(summaries)
    differences = tl.compare.tabulate_differences(comparisons, names=names, reference=reference)
    if kind == "csv":
        return [differences]
    errors = {name: one.path_error for name, one in zip(names, compared, strict=True)}
    told = tuple(list_errors(errors, reference))
    return [tl.tabulate_runs(summaries), replace(differences, notes=(*differences.notes, *told))]


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricBeside:
    """A metric of a run.

    Attributes:
        id: Id of the metric.
        value: Value in `unit`; None if `status` is not `ok`.
        unit: Unit of both values.
        status: Whether the metric has a value.
        reference: Value of the reference; None if the reference has no value.
        better: `lower`, `higher`, or None if neither is better.
    """

    id: str
    value: float | None
    unit: str
    status: str
    reference: float | None
    better: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class _HeldMetric(MetricBeside):
    reference_status: str


@dataclass(frozen=True, slots=True, kw_only=True)
class _HeldSignal:
    signal: str
    unit: str
    largest: float
    at_s: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class _HeldRun:
    """Differences between a run and the reference."""

    file: str
    name: str
    overlap_s: float
    overlap_from_s: float
    notes: tuple[str, ...]
    signals: list[_HeldSignal]
    metrics: list[_HeldMetric]
    path_error: "tl.compare.PathDeviation"


@dataclass(frozen=True, slots=True, kw_only=True)
class _ReferenceAnswer:
    """Runs compared with the reference, which is a file."""

    reference: str
    alignment: str
    runs: list[_HeldRun]


def _build_run(path: Path, compared: Compared) -> _HeldRun:
    found = compared.comparison
    return _HeldRun(
        file=str(path),
        name=found.name,
        overlap_s=found.overlap_s,
        overlap_from_s=found.overlap_from_s,
        notes=found.notes,
        signals=[console.copy_fields(_HeldSignal, one) for one in found.signals],
        metrics=[
            _HeldMetric(
                **take_metric(one.metric, one.reference.value),
                reference_status=one.reference.status.value,
            )
            for one in found.metrics
        ],
        path_error=compared.path_error,
    )


def take_metric(metric: "tl.Metric", reference: float | None = None) -> dict[str, Any]:
    """Return the fields of `MetricBeside`."""
    kind = tl.measure.find_metric_kind(metric.id)
    return {
        "id": metric.id,
        "value": metric.value,
        "unit": metric.unit,
        "status": metric.status.value,
        "reference": reference,
        "better": None if kind is None else kind.better,
    }


def list_scenario_files(files: Sequence[Path]) -> list[Path]:
    """Return the files that are scenarios, judging by their suffix."""
    return [file for file in files if file.suffix.lower() == ".toml"]


def compare_with_robot(
    files: Sequence[Path],
    *,
    plot: Path | None,
    rrd: Path | None,
    topics: ReadingOptions | None,
    kind: str,
) -> int:
    """Print the distances of recorded robots from the robot of a scenario among the files."""
    scenarios = list_scenario_files(files)
    if len(scenarios) > 1:
        named = ", ".join(map(str, scenarios))
        raise UsageError(f"name one scenario to compare bags with, not {named}")
    (scenario_file,) = scenarios
    bags = [file for file in files if file not in scenarios]
    if not bags:
        raise UsageError(
            f"compare {scenario_file} needs a bag or a recording beside the scenario; two"
            " scenarios are compared by their runs, which turtlelog run records"
        )
    require_pictures(plot, rrd, files, drawn=bags, of="bag")
    scenario = tl.scenario.read_scenario(scenario_file)
    if scenario.plant.kind != "lagged":
        raise UsageError(
            f'{scenario_file}: must be the scenario of a robot, plant.kind = "lagged", not'
            f" {scenario.plant.kind}; turtlelog replay drives turtlesim with recorded commands"
        )
    found: list[tuple[Path, tl.compare.RobotComparison]] = []
    is_fine = True
    for bag in bags:
        try:
            (run,) = read_runs([bag], topics)
            with show_progress(f"simulating {run.name}"):
                found.append((bag, tl.compare.compare_robot(run, scenario)))
        except TurtlelogError as err:
            console.print_error(str(err))
            is_fine = False
    if found:
        _print(found, scenario_file, kind)
        _draw(found[0][1], plot, rrd)
    return console.EXIT_FINE if is_fine else console.EXIT_BAD_INPUT


def _print(
    found: "Sequence[tuple[Path, tl.compare.RobotComparison]]", scenario: Path, kind: str
) -> None:
    if kind == "json":
        seeds = found[0][1].seeds
        runs = [_build_robot(file, one) for file, one in found]
        console.print_json(_RobotAnswer(reference=str(scenario), seeds=seeds, runs=runs))
        return
    robots = [one for _, one in found]
    if kind == "txt":
        console.print_text(format_robots(robots, [str(file) for file, _ in found], str(scenario)))
    else:
        console.print_tables([tl.compare.tabulate_robots(robots)], kind)


@dataclass(frozen=True, slots=True, kw_only=True)
class _BandAnswer:
    """Errors of a quantity after a time, in `unit`; fields as in `ErrorBand`."""

    quantity: str
    unit: str
    horizon_s: float
    pieces: int
    median: float
    largest: float
    largest_at_s: float
    simulated_median: float | None
    within_share: float | None
    above: int | None
    below: int | None
    verdict: str


@dataclass(frozen=True, slots=True, kw_only=True)
class _RobotRun:
    """A recorded robot compared with the simulated one."""

    file: str
    name: str
    overlap_s: float
    signals: tuple[()] = ()
    metrics: tuple[()] = ()
    errors: list[_BandAnswer]
    noise: "tuple[tl.compare.NoiseLevel, ...]"
    clock: "tl.run.Clock | None"
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _RobotAnswer:
    """Recorded robots compared with the robot of a scenario file."""

    reference: str
    alignment: str = "anchored"
    seeds: int
    runs: list[_RobotRun]


def _build_robot(file: Path, found: "tl.compare.RobotComparison") -> _RobotRun:
    time_ns = found.recorded.time_ns
    return _RobotRun(
        file=str(file),
        name=found.name,
        overlap_s=int(time_ns[-1] - time_ns[0]) / 1e9,
        errors=[
            console.copy_fields(
                _BandAnswer,
                band,
                unit="m" if band.quantity == "position" else "rad",
                pieces=len(band.recorded),
            )
            for band in found.bands
        ],
        noise=found.noise,
        clock=found.clock,
        notes=found.notes,
    )


def _draw(found: "tl.compare.RobotComparison", plot: Path | None, rrd: Path | None) -> None:
    if plot is not None:
        tl.draw.write_prediction_figure(found, plot)
        console.print_note(f"wrote {plot}")
    if rrd is not None:
        tl.draw.write_prediction_rrd(found, rrd)
        console.print_note(f"wrote {rrd}")
