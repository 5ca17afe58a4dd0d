"""`turtlelog compare`: which runs are compared how, and why a metric of two runs differs."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from textwrap import shorten
from typing import Annotated, Any, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli import console, options
from turtlelog.cli.compare_answer import compare_across, list_compared
from turtlelog.cli.compare_reference import (
    compare_with_reference,
    compare_with_robot,
    list_scenario_files,
)
from turtlelog.cli.compare_trajectories import TrajectoryOptions, compare_with_trajectory
from turtlelog.cli.list_names import complete_metrics
from turtlelog.cli.work import Jobs, count_jobs, show_progress, watch_summaries
from turtlelog.display import describe_count, join_words, split_numbers
from turtlelog.errors import TurtlelogError, UsageError
from turtlelog.escapes import escape_controls
from turtlelog.files.urls import make_path

_SUFFIXES: Final = (".mcap", ".json", ".csv", ".parquet", ".tum", ".db3", ".bag")
"""Suffixes of recordings except folders. A word after --why with such a suffix is not a metric."""

_LONGEST: Final = 40
"""Longest list of settings in a line [characters]; JSON and CSV contain all."""

_MOST_SETTINGS: Final = 3
"""Largest number of settings of a change in its line; a law has ten and more."""

_MOST_NAMED: Final = 3
"""Largest number of unreadable recordings that a sentence names; stderr has a line for each."""


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceOptions:
    """Why two runs differ; the reference, and how to compare with it.

    `turtlelog check` gives verdicts.

    Attributes:
        why: Explain why this metric differs between two runs. Example: --why run.duration. Default:
            the final position error, or without a goal the error of the last loop.
        first: With --why: explain the first recording, by name, that meets this condition, compared
            with the recording before. Example: "final.position_error > 0.01".
        trust_law: With --why: run the code of the laws that the recordings name.
        reference: Run with which the others are compared.
        align: Common time zero: first_sample, phase:NAME (the start of a phase), recorded (times as
            they are), sample (samples by their number). Default: first_sample; recorded for runs of
            one bag. With --ate or --rpe the transformation that is fitted: se3, se2, sim3, sim2
            (with scale), origin, none.
        jobs: Number of processes. Default: one per core if that is faster; 1 with --rrd or with a
            robot's scenario.
        details: With --reference: show the signals also if several runs are compared.
    """

    why: Annotated[bool | str | None, Parameter(negative=(), metavar="METRIC")] = None
    first: Annotated[str | None, Parameter(metavar="EXPRESSION")] = None
    trust_law: bool = False
    reference: options.Place | None = None
    tolerances: Annotated[options.Place | None, Parameter(show=False)] = None
    align: Annotated[str | None, Parameter(metavar="HOW")] = None
    jobs: Jobs = None
    details: bool = False
    trajectories: TrajectoryOptions = field(default_factory=TrajectoryOptions)

    @property
    def is_why(self) -> bool:
        """Whether --why is given; without it, options that need it are refused."""
        if not self.why:
            given = {"--first": self.first, "--trust-law": self.trust_law}
            options.refuse_given(given, "needs --why")
        return bool(self.why)


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

    def name_values(self) -> dict[str, str | None]:
        """Return the values by option."""
        return {f"--{one.name}": getattr(self, one.name) for one in fields(self)}

    def list_columns(self) -> list[str]:
        """Return the requested names and patterns; empty for the usual columns."""
        return options.split_names(self.metric, "--metric") or []


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
    against: ReferenceOptions = ReferenceOptions(),
    choice: ChoiceOptions = ChoiceOptions(),
    formats: console.FormatOptions = console.FormatOptions(),
    pictures: DrawingOptions = DrawingOptions(),
    topics: options.ReadingOptions = options.ReadingOptions(),
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
    kind, rrd = formats.choose(), pictures.rrd
    if against.is_why:
        options.refuse_given({"--metric": choice.metric}, f"--why {choice.metric} names the metric")
        given = {"--align": against.align, **choice.name_values(), "--rrd": rrd}
        options.refuse_given(given, "leave out --why")
        paths = [*([] if against.reference is None else [against.reference]), *files]
        return _compare_why(against, paths, plot=pictures.plot, topics=topics, kind=kind)
    files = options.list_files(files, without=against.reference)
    jobs = count_jobs(against.jobs, files)
    trajectories = against.trajectories
    if trajectories.require_sense():
        advice = "leave it out beside --ate and --rpe"
        options.refuse_given({**choice.name_values(), "--rrd": rrd}, advice)
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
    return compare_across(paths, held, choice, topics, jobs=jobs, kind=kind)


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
    if against.reference is None:
        options.refuse_given({"--align": against.align}, "needs --reference FILE")
    else:
        options.refuse_given(choice.name_values(), "leave out --reference")


def _require_robot_sense(against: ReferenceOptions, choice: ChoiceOptions) -> None:
    names = ("reference", "align", "tolerances")
    given = {f"--{name}": getattr(against, name) for name in names} | choice.name_values()
    advice = "leave it out, the scenario is what bags are compared with"
    options.refuse_given({f"{name} {value}": value for name, value in given.items()}, advice)


def _draw(paths: Sequence[Path], rrd: Path, topics: options.ReadingOptions) -> "list[tl.Run]":
    runs = options.read_runs(paths, topics)
    with show_progress("drawing"):
        tl.write_comparison_rrd(runs, rrd)
    console.print_note(f"wrote {rrd}")
    return runs


def _compare_why(
    against: ReferenceOptions,
    files: Sequence[Path],
    *,
    plot: Path | None,
    topics: options.ReadingOptions,
    kind: str,
) -> int:
    """Print why a metric of two runs differs, and return the exit code."""
    metric, files = _split_metric(against, files)
    options.require_pictures(plot, None, files, drawn=(), of="")
    code, told = console.EXIT_FINE, list[str]()
    if against.first is None:
        if len(files) != 2:
            raise UsageError(
                f"--why compares two runs, but {len(files)} {'was' if len(files) == 1 else 'were'}"
                " given; of more, --first EXPRESSION takes the first that meets a condition and the"
                " one before it"
            )
        pair = files[0], files[1]
    else:
        found_pair, code = _find_pair(against.first, files, against.jobs, topics, kind)
        if found_pair is None:
            return code
        pair, told = found_pair
        if metric is None:  # the first metric that the condition names
            names = tl.expressions.parse_expression(against.first, source="--first").names
            metric = next((name for name in names if tl.measure.find_metric_kind(name)), None)
    runs = [replace(options.read_chosen_run(one, topics), name=one.name) for one in pair]
    with show_progress("simulated", 100.0, "%") as progress:
        found = tl.explain_difference(
            *runs,
            metric=metric,
            trust_law=against.trust_law,
            work=tl.explain.Work(jobs=against.jobs, report=progress.count),
        )
    if kind == "json":
        first, second = map(str, pair)
        console.print_json(
            WhyAnswer(first=first, second=second, condition=against.first, explanation=found)
        )
    elif kind == "txt":
        words = [*pair, *options.list_option_words(topics)]
        console.print_text(_format_why(found, words, lead=told))
    else:
        console.print_tables([_tabulate_why(found)], kind)
    console.write_asked(plot, lambda path: tl.draw.write_difference_figure(found, path))
    return code


@dataclass(frozen=True, slots=True, kw_only=True)
class WhyAnswer:
    """Causes of a metric's difference between two recordings.

    Attributes:
        first: File of the first run; None if there is nothing to compare.
        second: File of the second run.
        condition: Given condition, which `second` is the first to meet.
        explanation: Causes of the difference; None if there is nothing to compare.
    """

    first: str | None
    second: str | None
    condition: str | None
    explanation: "tl.explain.ExplainedDifference | None"


def _split_metric(
    against: ReferenceOptions, files: Sequence[Path]
) -> tuple[str | None, list[Path]]:
    """Return the metric and the files, because the word after --why may be the first file."""
    word = against.why
    if not isinstance(word, str):
        return None, [*files]
    is_metric = tl.measure.find_metric_kind(word) is not None
    path = make_path(word)
    if not is_metric and ("/" in word or path.suffix.lower() in _SUFFIXES or path.exists()):
        return None, [path, *files]
    return word, [*files]


def _find_pair(
    condition: str,
    files: Sequence[Path],
    jobs: int | None,
    topics: options.ReadingOptions,
    kind: str,
) -> tuple[tuple[tuple[Path, Path], list[str]] | None, int]:
    """Return the first recording that meets a condition and the one before it, described."""
    paths = sorted(options.list_files(files), key=lambda path: split_numbers(str(path)))
    errors: list[TurtlelogError] = []
    needed = tl.compare.list_needed_metrics([], where=condition, sort=None, source="--first")
    found = tl.compare.summarise_files(
        paths,
        only=partial(list_compared, needed=needed, is_usual=False),
        topics=topics.build_choice(),
        jobs=count_jobs(jobs, paths),
    )
    summaries = [*watch_summaries(found, len(paths), errors)]
    code = console.print_errors(errors)
    met, notes = tl.compare.select_runs(summaries, condition, source="--first")
    for note in notes:
        console.print_note(note)
    row = summaries.index(met[0]) if met else 0
    if row:
        first, second = Path(summaries[row - 1].file), Path(summaries[row].file)
        told = [f"{second.name} is the first that meets {condition}, after {first.name}."]
        read = {one.file for one in summaries}
        unread = [one.name for one in paths if str(one) < str(second) and str(one) not in read]
        if unread:
            count = describe_count(len(unread), "earlier recording")
            names = join_words(unread[:_MOST_NAMED])
            told.append(f"{count} cannot be read and may meet it, too: {names}.")
        return ((first, second), told), code
    if kind == "json":
        bad = summaries[0].file if met else None
        console.print_json(WhyAnswer(first=None, second=bad, condition=condition, explanation=None))
    elif summaries:
        name, readable = Path(summaries[0].file).name, " that can be read" if errors else ""
        text = f"None of {len(summaries)} recordings{readable} meets {condition}."
        if met:
            text = f"{name} meets {condition}, and no recording{readable} comes before it."
        elif len(summaries) == 1:
            text = f"{name} does not meet {condition}."
        console.print_text(console.fill_lines([text]))
    return None, code


def _format_why(
    found: "tl.explain.ExplainedDifference",
    words: Sequence[object],
    *,
    lead: Sequence[str] = (),
) -> str:
    """Return the causes of a difference: the answer, a line for each change, and its conditions.

    `words`: both files, and options for reading them.
    """
    head, *rest = found.sentences
    rows = []
    for one in found.contributions:
        size, undone = tl.explain.format_change(found, one), ""
        if one.undone is not None:
            undone = f"without: {tl.explain.format_magnitude(found, one.undone)}"
        settings = shorten("; ".join(_list_settings(one)), _LONGEST, placeholder=" ...")
        rows.append((one.name, size, settings, undone))
    table = ["", *console.align_rows(rows), ""] if rows else []
    following = f"turtlelog compare --reference {console.quote_file(*words)}"
    ends = console.fill_lines([*rest, f"Signal by signal: {following}"])
    return "\n".join([console.fill_lines([head, *lead]), *table, ends])


def _list_settings(one: "tl.explain.Change") -> Iterator[str]:
    """Yield the settings of a change. Settings with equal pairs of values share an entry."""
    pairs: dict[tuple[str, str], list[str]] = {}
    for key, before, after in zip(one.keys, one.first, one.second, strict=True):
        if before == after:  # the same seed in both runs
            continue
        pairs.setdefault((_show(before), _show(after)), []).append(key)
    for number, ((before, after), keys) in enumerate(pairs.items()):
        if number == _MOST_SETTINGS:
            yield f"{sum(map(len, [*pairs.values()][number:]))} more"
            return
        yield f"{', '.join(keys)} {before} -> {after}"


def _show(value: Any) -> str:
    if value is None:
        return "none"
    return f"{value:.6g}" if isinstance(value, float) else escape_controls(str(value))


def _tabulate_why(found: "tl.explain.ExplainedDifference") -> "tl.compare.Table":
    """Return a row for each change."""
    unit = f" [{found.unit}]" if found.unit else ""
    heads = ("change", f"contribution{unit}", f"s.e.{unit}", f"undone{unit}", "settings")
    rows = []
    for one in found.contributions:
        settings = "; ".join(_list_settings(one))
        rows.append((one.name, one.contribution, one.standard_error, one.undone, settings))
    return console.build_table(found.sentences[0], heads, rows, found.sentences[1:])
