"""`turtlelog compare`: comparison of runs with each other, or with a reference."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli import console, options
from turtlelog.cli.compare_answer import format_across
from turtlelog.cli.compare_reference import (
    MetricBeside,
    compare_with_reference,
    compare_with_robot,
    list_scenario_files,
    take_metric,
)
from turtlelog.cli.compare_trajectories import (
    TrajectoryOptions,
    compare_with_trajectory,
)
from turtlelog.cli.compare_why import WhyOptions, compare_why
from turtlelog.cli.list_names import complete_metrics
from turtlelog.cli.work import Jobs, count_jobs, show_progress, watch_summaries
from turtlelog.errors import TurtlelogError, UsageError


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceOptions(WhyOptions):
    """The reference, and how to compare with it. `turtlelog check` gives verdicts.

    Attributes:
        reference: Run with which the others are compared.
        align: Common time zero: first_sample, phase:NAME (the start of a phase), recorded (times as
            they are), sample (samples by their number). Default: first_sample. With --ate or --rpe
            the transformation that is fitted: se3, se2, sim3, sim2 (with scale), origin, none.
        jobs: Number of processes. Default: one per core if that is faster; 1 with --rrd or with a
            robot's scenario.
        details: With --reference: show the signals also if several runs are compared.
    """

    reference: options.Place | None = None
    tolerances: Annotated[options.Place | None, Parameter(show=False)] = None
    align: Annotated[str | None, Parameter(metavar="HOW")] = None
    jobs: Jobs = None
    details: bool = False
    trajectories: TrajectoryOptions = field(default_factory=TrajectoryOptions)


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class ChoiceOptions:
    """Rows and columns of the table across runs.

    Attributes:
        metric: Columns, separated by commas: metrics, patterns (translate.*), parameters.
        sort: Metric, parameter or column (name, Kp) to sort by. A minus sign sorts in falling
            order. Example: -run.duration. Default: rising gain.
        where: Use only the runs that meet this condition. Example: "law.kp_linear >= 2 and
            run.duration < 20".
        varied: Keys that were varied on purpose, separated by commas: limits.speed_m_s, or a group
            such as goal, path, start, plant or limits. If another group differs, no run is called
            the best. Gains may always differ.
    """

    metric: Annotated[str | None, Parameter(metavar="NAMES", completer=complete_metrics)] = None
    sort: Annotated[
        str | None, Parameter(allow_leading_hyphen=True, metavar="NAME", completer=complete_metrics)
    ] = None
    where: Annotated[str | None, Parameter(metavar="EXPRESSION")] = None
    varied: Annotated[str | None, Parameter(metavar="KEYS")] = None

    def list_varied(self) -> list[str]:
        """Return the keys and conditions that were varied on purpose, in addition to gains."""
        return [] if self.varied is None else options.split_names(self.varied, "--varied")

    def list_columns(self) -> list[str]:
        """Return the requested names and patterns; empty for the usual columns."""
        return [] if self.metric is None else options.split_names(self.metric, "--metric")


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class DrawingOptions:
    """Pictures of the comparison.

    Attributes:
        plot: Write a figure to this .pdf, .png or .svg file: paths, errors and rates of a robot and
            its scenario; with --why the contributions; with --ate trajectories and their errors.
        rrd: Write all runs, or a recorded robot beside a simulated one, into one Rerun recording.
    """

    plot: Annotated[options.Place | None, Parameter(metavar="FILE")] = None
    rrd: Annotated[options.Place | None, Parameter(name="--rrd", metavar="FILE")] = None


def compare(
    files: options.Files,
    /,
    *,
    against: ReferenceOptions | None = None,
    choice: ChoiceOptions | None = None,
    formats: console.FormatOptions | None = None,
    pictures: DrawingOptions | None = None,
    topics: options.ReadingOptions | None = None,
) -> int:
    """Compare runs: which is best at what. With --reference: how much each differs.

    With --why: why a metric of the second run differs from the first run. The settings in which
    their scenarios differ are exchanged in every combination, and the difference of the metric is
    divided among them by Shapley values. If no recorded scenario reproduces a run, an identified
    scenario is used. If no setting differs, the answer is the first sample at which the runs
    depart.

    One file may be the scenario of a robot (its plant is lagged). Then each recorded robot is
    compared with the simulated robot, which gets the recorded commands. The answer is the error of
    the simulated pose 1 s and 5 s after both poses were equal. The noise of the robot is simulated
    with 39 seeds: the answer also counts how many errors lie within the central 95 % of the
    simulated errors.

    With --ate or --rpe, files are trajectories: in TUM, KITTI or EuRoC format, or any recording or
    bag (FILE:TOPIC for one topic of a bag). The answer is the absolute trajectory error of each
    trajectory after alignment to the reference, and the relative pose error over a length.

    Without a reference, files that cannot be read are reported on stderr. The others are compared
    if there are two or more, and the exit code is 2.

    Example: turtlelog compare kp1.mcap kp2.mcap kp4.mcap --sort run.duration

    Example: turtlelog compare runs

    Example: turtlelog compare --reference good.mcap new.mcap

    Example: turtlelog compare estimate.tum --reference truth.tum --ate --rpe 1m

    Example: turtlelog compare good.mcap new.mcap --why

    Example: turtlelog compare runs --first "final.position_error > 0.005" --why

    Example: turtlelog compare robot_bag robot.toml

    Args:
        files: Recordings (.mcap), ROS 2 bags, tables (.csv, .parquet, .tum), or the paper's logs
            (.json, .csv); and perhaps one scenario of a robot (.toml).
    """
    against, choice = against or ReferenceOptions(), choice or ChoiceOptions()
    kind = (formats or console.FormatOptions()).choose()
    pictures = pictures or DrawingOptions()
    rrd = pictures.rrd
    if against.is_why:
        _require_why_sense(against, choice, rrd)
        paths = [*([] if against.reference is None else [against.reference]), *files]
        return compare_why(against, paths, plot=pictures.plot, topics=topics, kind=kind)
    files = options.list_files(files, without=against.reference)
    jobs = count_jobs(against.jobs, files)
    trajectories = against.trajectories
    if trajectories.require_sense():
        _require_trajectory_sense(choice, rrd)
        reference = trajectories.take_reference(against.reference, files)
        return compare_with_trajectory(
            reference, files, against, topics, plot=pictures.plot, kind=kind
        )
    if list_scenario_files(files):
        _require_robot_sense(against, choice)
        return compare_with_robot(files, plot=pictures.plot, rrd=rrd, topics=topics, kind=kind)
    if pictures.plot is not None:
        raise UsageError(
            "--plot: needs the scenario of a robot (.toml) among the files;"
            " turtlelog plot draws runs"
        )
    paths = [*([] if against.reference is None else [against.reference]), *files]
    _require_sense(paths, against, choice)
    options.require_new_target(rrd, paths, suffix=".rrd")
    held = None if rrd is None else _draw(paths, rrd, topics)
    if against.reference is not None:
        compare_with_reference(paths, held, against, topics, jobs=jobs, kind=kind)
        return console.EXIT_FINE
    columns = choice.list_columns()
    only = None  # every metric
    if columns or kind != "json":
        needed = tl.compare.list_needed_metrics(
            columns, where=choice.where, sort=choice.sort, source="--where"
        )
        only = partial(_list_needed, needed=needed, is_usual=not columns)
    summaries, errors = _summarise(paths, held, topics, only=only, jobs=jobs)
    code = console.print_errors(errors)
    # A single run is not compared with others.
    if not errors or len(summaries) > 1:
        _compare_across(summaries, choice, kind)
    return code


def _require_sense(paths: Sequence[Path], against: ReferenceOptions, choice: ChoiceOptions) -> None:
    if against.tolerances is not None:
        raise UsageError(
            "--tolerances: leave it out; verdicts are given by"
            f" turtlelog check {against.tolerances} RUN --reference {against.reference or 'RUN'}"
        )
    if len(paths) < 2:
        options.require_there(paths)
        raise UsageError(
            f"compare needs at least two runs, but {len(paths)} was given; add another file, or"
            " --reference FILE"
        )
    if against.reference is None and against.align is not None:
        raise UsageError("--align: needs --reference FILE")
    for name in () if against.reference is None else _list_given(choice, _OF_MANY):
        raise UsageError(f"--{name}: leave out --reference")


_OF_MANY: Final = ("metric", "sort", "where", "varied")
"""Options for comparing runs side by side, without a reference."""


def _list_given(group: object, names: Sequence[str]) -> dict[str, object]:
    """Return the options of a group with these names that are given."""
    values = {name: getattr(group, name) for name in names}
    return {name: value for name, value in values.items() if value is not None}


def _require_why_sense(against: ReferenceOptions, choice: ChoiceOptions, rrd: Path | None) -> None:
    given = _list_given(against, ["align"]) | _list_given(choice, _OF_MANY)
    for name, value in given.items():
        hint = f"--why {value} names the metric" if name == "metric" else "leave out --why"
        raise UsageError(f"--{name}: {hint}")
    if rrd is not None:
        raise UsageError("--rrd: leave out --why")


def _require_trajectory_sense(choice: ChoiceOptions, rrd: Path | None) -> None:
    for name in (*_list_given(choice, _OF_MANY), *(["rrd"] if rrd is not None else [])):
        raise UsageError(f"--{name}: leave it out beside --ate and --rpe")


def _require_robot_sense(against: ReferenceOptions, choice: ChoiceOptions) -> None:
    given = _list_given(against, ("reference", "align", "tolerances"))
    for name, value in (given | _list_given(choice, _OF_MANY)).items():
        raise UsageError(
            f"--{name} {value}: leave it out, the scenario is what bags are compared with"
        )


def _draw(
    paths: Sequence[Path], rrd: Path, topics: options.ReadingOptions | None
) -> "list[tl.Run]":
    """Write a picture of all runs, which needs all of them at once, and return the runs."""
    runs = options.read_runs(paths, topics)
    with show_progress("drawing"):
        tl.write_comparison_rrd(runs, rrd)
    console.print_note(f"wrote {rrd}")
    return runs


def _summarise(
    paths: Sequence[Path],
    held: "Sequence[tl.Run] | None",
    topics: options.ReadingOptions | None,
    *,
    only: "Callable[[tl.Run], Sequence[str]] | None",
    jobs: int,
) -> "tuple[tuple[tl.compare.RunSummary, ...], list[TurtlelogError]]":
    """Return run summaries, read one by one unless held, and the errors of unreadable files."""
    if held is not None:
        pairs = zip(held, paths, strict=True)
        return tuple(
            tl.summarise_run(
                run, file=str(path), metrics=tl.measure_run(run, only=only and only(run))
            )
            for run, path in pairs
        ), []
    errors: list[TurtlelogError] = []
    chosen = (topics or options.ReadingOptions()).build_choice()
    found = tl.compare.summarise_files(paths, only=only, topics=chosen, jobs=jobs)
    summaries = tuple(watch_summaries(found, len(paths), errors))
    return tl.compare.complete_summaries(summaries, topics=chosen), errors


def _list_needed(run: "tl.Run", *, needed: tuple[str, ...], is_usual: bool) -> tuple[str, ...]:
    # The usual metrics of a third-party bag are known when it is read.
    return (*needed, *tl.compare.list_usual_of_run(run)) if is_usual else needed


def _compare_across(
    summaries: "Sequence[tl.compare.RunSummary]", choice: ChoiceOptions, kind: str
) -> None:
    count, title = len(summaries), ""
    notes: tuple[str, ...] = ()
    if choice.where is not None:
        summaries, notes = tl.compare.select_runs(summaries, choice.where, source="--where")
        title = f"{len(summaries)} of {count} runs, where {choice.where}"
    if choice.sort is None:
        summaries = tl.compare.order_by_gain(summaries)
    else:
        from turtlelog.compare.run_table import sort_by_column

        summaries = sort_by_column(summaries, choice.sort, source="--sort")
    only = tl.compare.choose_columns(summaries, choice.list_columns(), source="--metric")
    ranking = tl.compare.judge_runs(summaries, varied=choice.list_varied(), source="--varied")
    if kind == "json":
        console.print_json(_build_answer(summaries, only=only, notes=notes, ranking=ranking))
        return
    if kind == "txt":
        console.print_text(format_across(summaries, ranking, only=only, title=title, notes=notes))
        return
    table = tl.tabulate_runs(summaries, only=only, title=title, notes=notes, ranking=ranking)
    console.print_tables([table], kind)
    if kind == "csv":
        # CSV has no room for notes.
        for note in (*notes, *ranking.list_notes(tl.compare.name_runs(summaries))):
            console.print_note(note)


@dataclass(frozen=True, slots=True, kw_only=True)
class _MarkedMetric(MetricBeside):
    mark: "tl.compare.Mark | None"


@dataclass(frozen=True, slots=True, kw_only=True)
class _RunBeside:
    """A run next to other runs, without a reference and therefore without signals."""

    file: str
    name: str
    overlap_s: None = None
    parameters: "Mapping[str, tl.run.Parameter]"
    signals: tuple[()] = ()
    metrics: list[_MarkedMetric]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Difference:
    condition: str
    key: str
    values: tuple[Any, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Unknown:
    condition: str
    runs: list[str]


@dataclass(frozen=True, slots=True, kw_only=True)
class _RankingAnswer:
    """Whether a run may be called the best, with varied keys, differing and unknown conditions."""

    is_fair: bool
    reason: str | None
    varied: tuple[str, ...]
    differences: list[_Difference]
    unknown: list[_Unknown]


@dataclass(frozen=True, slots=True, kw_only=True)
class _AcrossAnswer:
    """Runs next to each other, with marks on their metrics."""

    reference: None = None
    alignment: None = None
    notes: tuple[str, ...]
    ranking: _RankingAnswer
    runs: list[_RunBeside]


def _build_answer(
    summaries: "Sequence[tl.compare.RunSummary]",
    *,
    only: Sequence[str],
    notes: tuple[str, ...],
    ranking: "tl.compare.Ranking",
) -> _AcrossAnswer:
    ids = list(tl.measure.list_metrics(*(found.declaration for found in summaries)))
    if only:
        chosen = tl.compare.choose_columns(summaries, only)
        ids = [
            name for name in chosen if any(one.find_metric(name) is not None for one in summaries)
        ]
    marks = {name: tl.compare.mark_metric(summaries, name, ranking=ranking) for name in ids}
    parameters = tl.compare.order_parameters(summaries, ranking)
    names = tl.compare.name_runs(summaries)
    runs = [
        _RunBeside(
            file=summary.file,
            name=name,
            parameters=parameters[row],
            metrics=[
                _MarkedMetric(**take_metric(metric), mark=marks[metric.id].get(row))
                for metric in map(summary.find_metric, ids)
                if metric is not None
            ],
        )
        for row, (name, summary) in enumerate(zip(names, summaries, strict=True))
    ]
    judged = _RankingAnswer(
        is_fair=ranking.is_fair,
        reason=ranking.describe() or None,
        varied=ranking.varied,
        differences=[console.copy_fields(_Difference, found) for found in ranking.differences],
        unknown=[
            _Unknown(condition=condition, runs=[names[row] for row in rows])
            for condition, rows in ranking.unknown.items()
        ],
    )
    return _AcrossAnswer(notes=notes, ranking=judged, runs=runs)
