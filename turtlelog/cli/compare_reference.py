"""`turtlelog compare` against a reference: runs against a run, robots against a scenario."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Final

import turtlelog as tl
from turtlelog.cli import console
from turtlelog.cli.compare_answer import (
    MetricBeside,
    list_cell_reasons,
    narrow_columns,
    take_metric,
)
from turtlelog.cli.options import (
    ReadingOptions,
    list_option_words,
    read_runs,
    require_pictures,
)
from turtlelog.cli.work import show_progress, watch_files
from turtlelog.compare.difference import compare_measured
from turtlelog.display import format_number, format_short, join_words
from turtlelog.errors import TurtlelogError, UsageError
from turtlelog.processes import map_in_processes

if TYPE_CHECKING:
    from collections.abc import Mapping

    from turtlelog.cli.compare import ReferenceOptions
    from turtlelog.compare import PathDeviation, RobotComparison, RunSummary


_LONGEST: Final = 24
"""Longest name of a recorded robot [characters]; a robot with a longer name is called by its
file."""

_MOST_RUNS: Final = 1
"""Largest number of runs whose signals are shown with a reference by default."""


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
    topics: ReadingOptions,
    *,
    jobs: int,
    kind: str,
) -> None:
    """Print the distances of runs from the first run.

    Runs in `held` are read already, and are compared in this process.
    """
    # Runs of one file have one clock; their first poses are not at one time.
    files = {tl.log.split_topic(path)[0] for path in paths}
    alignment = against.align or ("recorded" if len(files) == 1 else "first_sample")
    if alignment == "first-sample":
        alignment = "first_sample"
    choice = topics.build_choice()
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
        words = list_option_words(topics)
        console.print_text(_format_reference(first, compared, words, shows_signals=against.details))


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
    told = tuple(_list_errors(errors, reference))
    return [tl.tabulate_runs(summaries), replace(differences, notes=(*differences.notes, *told))]


def _format_reference(
    first: "RunSummary", found: Sequence[Compared], reading: Sequence[str], *, shows_signals: bool
) -> str:
    """Return the distances of runs from a reference's path, then metrics and signals."""
    summaries, changes = tl.compare.shorten_names([first, *(one.summary for one in found)])
    reference, *names = tl.compare.name_runs(summaries)
    errors = dict(zip(names, (one.path_error for one in found), strict=True))
    ranking = tl.compare.judge_runs(summaries)
    across, _ = narrow_columns(tl.tabulate_runs(summaries, ranking=ranking, differing=0), summaries)
    told = [f"{ranking.describe().capitalize()}."] if ranking.differences else []
    reasons = list_cell_reasons(across, summaries)
    across = replace(across, notes=(*reasons, *changes, *told))
    comparisons = [one.comparison for one in found]
    signals = tl.compare.tabulate_differences(comparisons, names=names, reference=reference)
    file = console.quote_file(first.file, *reading)
    parts = [console.fit_body(across)]
    if shows_signals or len(found) <= _MOST_RUNS:
        parts.append(f"\n{signals.title}\n" + console.fit_body(replace(signals, notes=())))
    else:
        parts.append("\nThe largest difference of every signal: --details")
    return "\n".join(
        [
            console.fill_lines(_list_errors(errors, reference)),
            *parts,
            "",
            console.fill_lines(signals.notes),
            f"Verdicts with tolerances: turtlelog check --init {file}",
        ]
    )


def _show(value_m: float) -> str:
    return format_number(round(value_m, 9), "m")  # smaller values are rounding


def _list_errors(errors: "Mapping[str, PathDeviation]", reference: str) -> Iterator[str]:
    """Yield the run furthest from the reference's path, then the distance of each run."""
    name, worst = max(errors.items(), key=lambda one: one[1].largest_m)
    at = f"by at most {_show(worst.largest_m)}, at {worst.largest_at_s:.2f} s"
    is_on = round(worst.largest_m, 9) == 0.0
    if len(errors) == 1:
        on = f"{name} stays on the path of {reference}, within 1e-9 m."
        yield on if is_on else f"{name} departs from the path of {reference} {at}."
    else:
        off = f"{name} departs most from its path, {at}."
        told = "all stay on its path, within 1e-9 m." if is_on else off
        yield f"{len(errors)} runs beside {reference}: {told}"
    for name, error in errors.items():
        if not round(error.largest_apart_m, 9):
            continue
        path = f"up to {_show(error.largest_m)} from the path, RMS {_show(error.rms_m)}; "
        apart = f"at equal times up to {_show(error.largest_apart_m)} apart"
        yield f"{name}: {path if len(errors) > 1 else ''}{apart}, RMS {_show(error.rms_apart_m)}."


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
    return console.copy_fields(
        _HeldRun,
        found,
        file=str(path),
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


def list_scenario_files(files: Sequence[Path]) -> list[Path]:
    """Return the files that are scenarios, judging by their suffix."""
    return [file for file in files if file.suffix.lower() == ".toml"]


def compare_with_robot(
    files: Sequence[Path],
    *,
    plot: Path | None,
    rrd: Path | None,
    topics: ReadingOptions,
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
    if scenario.plant.facts.dynamics != "first-order":
        raise UsageError(
            f'{scenario_file}: must be the scenario of a robot, plant.kind = "lagged", not'
            f" {scenario.plant.kind}; turtlelog replay drives {scenario.plant.kind} with recorded"
            " commands"
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
        words = list_option_words(topics)
        _print(found, scenario_file, words, kind, is_drawn=plot is not None)
        first = found[0][1]
        console.write_asked(plot, lambda path: tl.draw.write_prediction_figure(first, path))
        console.write_asked(rrd, lambda path: tl.draw.write_prediction_rrd(first, path))
    return console.EXIT_FINE if is_fine else console.EXIT_BAD_INPUT


def _print(
    found: "Sequence[tuple[Path, tl.compare.RobotComparison]]",
    scenario: Path,
    reading: Sequence[str],
    kind: str,
    *,
    is_drawn: bool,
) -> None:
    robots = [one for _, one in found]
    if kind == "json":
        runs = [_build_robot(file, one) for file, one in found]
        console.print_json(_RobotAnswer(reference=str(scenario), seeds=robots[0].seeds, runs=runs))
    elif kind == "txt":
        files = [str(file) for file, _ in found]
        command = f"turtlelog compare {console.quote_file(files[0], scenario, *reading)}"
        console.print_text(_format_robots(robots, files, "" if is_drawn else command))
    else:
        console.print_tables([tl.compare.tabulate_robots(robots)], kind)


def _format_robots(found: "Sequence[RobotComparison]", files: Sequence[str], command: str) -> str:
    """Return the distances of recorded robots from a simulated one, their meaning, and a table.

    `command` repeats the comparison of the first robot; empty if its curves are drawn already.
    """
    found = [
        one if len(one.name) <= _LONGEST else replace(one, name=tl.compare.label_file(file))
        for one, file in zip(found, files, strict=True)
    ]
    table = tl.compare.tabulate_robots(found)
    heads = []
    for one in found:
        said = []
        for band in (band for band in one.bands if band.quantity == "position"):
            simulated = band.simulated_median
            beside = "" if simulated is None else f" (simulated {format_short(simulated, 'm')})"
            said.append(f"{format_short(band.median, 'm')}{beside} after {band.horizon_s:g} s")
        head = f"{one.name} beside the scenario {one.scenario}"
        heads.append(f"{head}: median position error {join_words(said)}.")
    if len(found) > 1:
        heads.insert(0, f"{len(found)} recorded robots beside the scenario {found[0].scenario}:")
    # The sentences contain the number of errors outside of the band.
    ranks = [0 if column.title in {"above", "below"} else None for column in table.columns]
    narrow = tl.compare.narrow_table(replace(table, notes=()), console.find_width(), ranks)
    seeds = found[0].seeds
    means = (
        f"Each motion is simulated with {seeds} seeds." if seeds else "The scenario has no noise."
    )
    following = [
        f"The simulated robot is driven with the recorded commands. {means}",
        *([f"Curves: {command} --plot FILE.pdf"] if command else []),
    ]
    head = console.fill_lines([*heads, *table.notes], indent=2)
    return "\n".join([head, console.fit_body(narrow), "", console.fill_lines(following)])


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
