"""`turtlelog compare`: which runs are compared how."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli import console, options
from turtlelog.cli.compare_answer import compare_across
from turtlelog.cli.compare_reference import (
    compare_with_reference,
    compare_with_robot,
    list_scenario_files,
)
from turtlelog.cli.compare_trajectories import TrajectoryOptions, compare_with_trajectory
from turtlelog.cli.compare_why import compare_why
from turtlelog.cli.list_names import complete_metrics
from turtlelog.cli.work import Jobs, count_jobs, show_progress
from turtlelog.errors import UsageError


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
        return compare_why(against, paths, plot=pictures.plot, topics=topics, kind=kind)
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
