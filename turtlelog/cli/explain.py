"""`turtlelog explain`: causes of a run's metric."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli import options
from turtlelog.cli.console import (
    EXIT_FAILED,
    EXIT_FINE,
    copy_fields,
    print_json,
    print_note,
    print_text,
    quote_file,
    write_asked,
    write_text,
)
from turtlelog.cli.explain_answer import (
    NEEDS,
    describe_causes,
    describe_cut,
    format_explain_answer,
    format_explain_details,
    format_motion,
)
from turtlelog.cli.list_names import complete_causes, complete_metrics
from turtlelog.cli.replay_answer import PlantReplayAnswer, build_plant, build_pose_error, tell_time
from turtlelog.cli.work import Jobs, show_progress
from turtlelog.errors import ExplainError

_GIVEN: Final = "Gains are taken as given. What they change: turtlelog compare --why RUN RUN"
_DETAILS: Final = "Every cause, setting and its evidence: --details"


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class ExplainOptions:
    """Files to write, code that may run, and number of processes.

    Attributes:
        details: Also print every cause, and every setting with its evidence.
        scenario: Write the identified scenario to this .toml file.
        rrd: Write a Rerun recording of the run, of its simulations without the effects, and of the
            contributions.
        trust_law: Run the code of the law that the recording names, if the law is not built in.
        jobs: Number of processes. Default: one per core if that is faster; 1 for laws of your own.
    """

    details: bool = False
    scenario: options.Place | None = None
    rrd: options.Place | None = None
    trust_law: bool = False
    jobs: Jobs = None


def explain(
    file: options.File,
    /,
    *,
    metric: Annotated[str | None, Parameter(metavar="ID", completer=complete_metrics)] = None,
    causes: Annotated[str | None, Parameter(metavar="NAMES", completer=complete_causes)] = None,
    chosen: ExplainOptions = ExplainOptions(),
    topics: options.ReadingOptions = options.ReadingOptions(),
    json: options.Json = False,
) -> int:
    """Explain a metric of a run: which effect of the implementation contributes how much.

    First the command identifies gains, limits, tolerances, dead times, queues and the pause from
    the samples of the controller: the poses that it read and the commands that it gave. The
    identified scenario is simulated and compared with the log, sample by sample.

    Then the scenario is simulated without its effects, in every combination, and the metric is
    divided among the effects. Contributions are Shapley values: their sum is the metric with all
    effects minus the metric without effects. The contributions are shown if the re-simulation
    agrees with the log. Effects come from the implementation, such as queue, delay, jitter, loss,
    noise or pause. Design parameters, such as saturation, sampling or tolerance, are removed one at
    a time.

    Parameters are identified only for the law sequential-p. For another law, the recorded scenario
    is used, if it reproduces every sample. If that law is not built in, this runs the code that the
    recording names, and needs --trust-law.

    Most third-party bags contain no samples. For these bags the answer shows rates, jumps, gaps,
    the largest commands, and for turtlesim the dead time of its commands. The exit code is then 1.

    If an effect is random, contributions are means over 32 seeds with standard errors.

    Example: turtlelog explain kp10.mcap --metric final.heading_error

    Args:
        file: A recording (.mcap), a ROS 2 bag, a table (.csv, .parquet, .tum), or one of the
            paper's logs (.json, .csv).
        metric: Metric to explain, by its id (turtlelog list metrics). Default: the final position
            error; without a goal, the error of the last loop; without a loop, run.path_length.
        causes: Effects and design parameters among which the metric is divided, separated by commas
            (turtlelog list causes). Default: every effect of the run, at most the six that change
            the metric most.
        json: Print one JSON object.
    """
    options.require_there([file])
    options.require_new_target(chosen.scenario, [file], suffix=".toml")
    options.require_new_target(chosen.rrd, [file], suffix=".rrd")
    names = options.split_names(causes, "--causes")
    (run,) = options.read_runs([file], topics)
    metric = metric or tl.explain.choose_metric(run.declaration)
    with options.name_as_typed(file, run):
        tl.explain.require_causes(run, metric, names)
        tl.explain.require_trust(run, trust_law=chosen.trust_law)
        found = tl.identify_run(run, trust_law=chosen.trust_law)
    write_asked(
        chosen.scenario,
        lambda path: write_text(path, tl.format_scenario(found.build_scenario())),
    )
    attribution = None
    if found.scenario is not None:
        with show_progress("simulated", 100.0, "%") as progress:
            attribution = tl.attribute_run(
                run,
                metric=metric,
                causes=names,
                identified=found,
                trust_law=chosen.trust_law,
                work=tl.explain.Work(jobs=chosen.jobs, report=progress.count),
            )
    motion = None if len(run.samples) else tl.explain.read_motion_facts(run)
    answer = _build_answer(file, run, metric, found, attribution, motion)
    if json:
        print_json(answer)
    elif motion is not None:
        print_text(format_motion(file, run, motion))
        command = "Measures of its motion: turtlelog metrics"
        if len(run.commands):
            command = "Response to its commands: turtlelog identify"
        print_text(f"{command} {quote_file(file, *options.list_option_words(topics))}")
    else:
        if cut := describe_cut(run, answer.metric["id"]):
            print_text(cut)
        print_text(format_explain_answer(answer, found))
        if attribution is not None and run.declaration.list_gains():
            print_text(_GIVEN)
        print_text(f"\n{format_explain_details(answer, found)}" if chosen.details else _DETAILS)
    if chosen.rrd is not None:
        _draw(run, found, attribution, chosen.rrd, chosen.jobs)
    return EXIT_FINE if motion is None else EXIT_FAILED


def _build_answer(
    file: Path,
    run: "tl.Run",
    metric: str,
    found: "tl.explain.Identification",
    attribution: "tl.explain.Attribution | None",
    motion: "tl.explain.MotionFacts | None",
) -> "ExplainAnswer":
    again = found.resimulation
    error = {} if again is None else {"max_abs_error": build_pose_error(again.max_abs_error)}
    return copy_fields(
        ExplainAnswer,
        found,
        file=str(file),
        metric=tl.measure_run(run, only=[metric])[metric].to_dict(),
        identified=tuple(
            copy_fields(FindingAnswer, one, key=key) for key, one in found.findings.items()
        ),
        resimulation=None if again is None else asdict(again) | error,
        attribution=attribution,
        in_words={} if attribution is None else dict(describe_causes(found, attribution)),
        motion=None if motion is None else build_motion(file, run, motion),
    )


def _draw(
    run: "tl.Run",
    found: "tl.explain.Identification",
    attribution: "tl.explain.Attribution | None",
    path: Path,
    jobs: int | None,
) -> None:
    if attribution is None:
        raise ExplainError(f"{path}: there is nothing to draw, because no scenario fits this log")
    with show_progress("simulating without", 100.0, "%") as progress:
        without = tl.explain.simulate_what_ifs(found, attribution, report=progress.count)
    luck = None
    with show_progress("simulated", 100.0, "%") as progress, suppress(ExplainError):
        # Without values from other starts, as the text explains.
        work = tl.explain.Work(jobs=jobs, report=progress.count)
        luck = tl.explain.measure_luck(run, identified=found, found=attribution, work=work)
    tl.draw.write_explanation_rrd(run, attribution, without, path, luck=luck)
    print_note(f"wrote {path}")


@dataclass(frozen=True, slots=True, kw_only=True)
class RateAnswer:
    """Rate of rows, the range of the central 90 % of the periods, and the longest silence."""

    rows: int
    period_s: float | None = None
    low_s: float | None = None
    high_s: float | None = None
    longest_silence_s: float | None = None
    silence_at_s: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ValueAnswer:
    """A value of a signal with its time."""

    signal: str
    unit: str
    value: float
    at_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class LeapAnswer:
    """A jump of the poses [m, rad]."""

    at_s: float
    moved: float
    aside: float
    turned: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SilenceAnswer:
    """A gap in the poses."""

    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TicksAnswer:
    """Number of commands that act after a number of ticks."""

    ticks: int
    commands: int


@dataclass(frozen=True, slots=True, kw_only=True)
class DelaysAnswer:
    """Delays with which commands act."""

    ticks: list[TicksAnswer]
    low_s: float
    median_s: float
    high_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionAnswer:
    """Facts about poses and commands without samples. Times count as in a replay.

    Attributes:
        kind: Kind of the recorded robot.
        run_duration_s: Duration of the run [s].
        poses: Rate of the poses.
        commands: Rate of the commands.
        largest_commands: Largest command of each axis.
        outliers: Values that do not belong to the motion.
        jumps: Jumps of the poses.
        gaps: Gaps in the poses.
        command_delays: Delays with which commands act; None if unknown.
        replay: The commands driven through the plant.
        needs: Data that an explanation would need.
    """

    kind: str
    run_duration_s: float
    poses: RateAnswer
    commands: RateAnswer
    largest_commands: list[ValueAnswer]
    outliers: list[ValueAnswer]
    jumps: list[LeapAnswer]
    gaps: list[SilenceAnswer]
    command_delays: DelaysAnswer | None
    replay: PlantReplayAnswer | None
    needs: str


def build_motion(file: Path, run: "tl.Run", found: "tl.explain.MotionFacts") -> MotionAnswer:
    """Return the facts as an answer."""
    at_s = partial(tell_time, run)

    def build_rate(rows: int, periods: "tl.explain.Periods | None") -> RateAnswer:
        if periods is None:
            return RateAnswer(rows=rows)
        return RateAnswer(
            rows=rows,
            period_s=periods.usual_ns / 1e9,
            low_s=periods.low_ns / 1e9,
            high_s=periods.high_ns / 1e9,
            longest_silence_s=periods.longest_ns / 1e9,
            silence_at_s=at_s(periods.longest_at_ns),
        )

    delays, replay = found.delays, found.replay
    largest, outliers = (
        [copy_fields(ValueAnswer, one, at_s=at_s(one.time_ns)) for one in values]
        for values in (found.largest, found.outliers)
    )
    return MotionAnswer(
        kind=found.kind,
        run_duration_s=run.duration_s,
        poses=build_rate(len(run.poses), found.poses),
        commands=build_rate(len(run.commands), found.commands),
        largest_commands=largest,
        outliers=outliers,
        jumps=[
            LeapAnswer(
                at_s=at_s(jump.time_ns),
                moved=jump.moved_m,
                aside=jump.aside_m,
                turned=jump.turned_rad,
            )
            for jump in found.jumps
        ],
        gaps=[
            SilenceAnswer(start_s=at_s(gap.start_ns), end_s=at_s(gap.end_ns)) for gap in found.gaps
        ],
        command_delays=None
        if delays is None
        else DelaysAnswer(
            ticks=[TicksAnswer(ticks=ticks, commands=n) for ticks, n in delays.counts.items()],
            low_s=delays.low_ns / 1e9,
            median_s=delays.median_ns / 1e9,
            high_s=delays.high_ns / 1e9,
        ),
        replay=None if replay is None else build_plant(file, run, replay),
        needs=NEEDS,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class FindingAnswer:
    """A setting of the run.

    Attributes:
        key: Key of the setting, as in a scenario.
        value: Identified value; None if it is not identified.
        certainty: Confidence in the value.
        evidence: Evidence of the value, or the reason why it is not identified.
        interval: Bounds of the value, if known.
        candidates: All values that fit, if several do.
        assumed: Value that the re-simulation uses if the setting is not identified and has no
            visible effect.
    """

    key: str
    value: Any
    certainty: str
    evidence: str
    interval: tuple[float, float] | None
    candidates: tuple[Any, ...]
    assumed: Any


@dataclass(frozen=True, slots=True, kw_only=True)
class ExplainAnswer:
    """The settings and causes identified from a run.

    Attributes:
        file: Name of the file as given.
        name: Name of the run.
        metric: Explained metric, with the value of the log.
        identified: The settings of the run, each with its confidence and evidence.
        resimulation: Comparison of the re-simulated scenario with the log.
        tried: Values that were tried, by key of the loop's settings.
        attribution: The value divided among its causes; None if no scenario reproduces the log.
        in_words: Action of each contributing cause in this run, in words.
        notes: Further notes, in sentences.
        motion: Facts about poses and commands without samples; None with samples.
    """

    file: str
    name: str
    metric: Mapping[str, Any]
    identified: tuple[FindingAnswer, ...]
    resimulation: Mapping[str, Any] | None
    tried: Mapping[str, tuple[Any, ...]]
    attribution: "tl.explain.Attribution | None"
    in_words: Mapping[str, str]
    notes: tuple[str, ...]
    motion: MotionAnswer | None
