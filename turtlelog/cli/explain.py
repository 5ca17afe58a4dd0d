"""`turtlelog explain`: causes of a run's metric."""

from dataclasses import dataclass
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.explain_answer import (
    DelaysAnswer,
    LeapAnswer,
    MotionAnswer,
    RateAnswer,
    SilenceAnswer,
    TicksAnswer,
    ValueAnswer,
    build_explain_answer,
    format_explain_answer,
    format_explain_details,
)
from turtlelog.cli.list_names import complete_causes, complete_metrics
from turtlelog.cli.options import (
    File,
    Jobs,
    Json,
    Place,
    ReadingOptions,
    name_as_typed,
    read_runs,
    require_jobs,
    require_there,
    split_names,
)
from turtlelog.cli.output import fill_lines, print_json, print_note, print_text, write_text
from turtlelog.cli.progress import show_progress
from turtlelog.cli.replay_plant import build_plant, judge_rounding, list_breaks
from turtlelog.cli.targets import require_new_target
from turtlelog.display import describe_count, join_words
from turtlelog.errors import ExplainError
from turtlelog.escapes import escape_controls

if TYPE_CHECKING:
    from turtlelog import Run
    from turtlelog.explain import (
        Attribution,
        Delays,
        Identification,
        Largest,
        Luck,
        MotionFacts,
        Periods,
    )

_NOTHING: Final = "no scenario fits this log"
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
    scenario: Place | None = None
    rrd: Place | None = None
    trust_law: bool = False
    jobs: Jobs = None


def explain(
    file: File,
    /,
    *,
    metric: Annotated[str | None, Parameter(metavar="ID", completer=complete_metrics)] = None,
    causes: Annotated[str | None, Parameter(metavar="NAMES", completer=complete_causes)] = None,
    options: ExplainOptions | None = None,
    topics: ReadingOptions | None = None,
    json: Json = False,
) -> None:
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
    the largest commands, and for turtlesim the dead time of its commands.

    If an effect is random, contributions are means over 32 seeds with standard errors.

    Example: turtlelog explain kp10.mcap --metric final.heading_error

    Args:
        file: A recording (.mcap), a ROS 2 bag, a table (.csv, .parquet, .tum), or one of the
            paper's logs (.json, .csv).
        metric: Metric to explain, by its id (turtlelog list metrics). Default: the final position
            error, or without a goal the error of the last loop.
        causes: Effects and design parameters among which the metric is divided, separated by commas
            (turtlelog list causes). Default: every effect of the run, at most the six that change
            the metric most.
        json: Print one JSON object.
    """
    require_there([file])
    options = options or ExplainOptions()
    require_new_target(options.scenario, [file], suffix=".toml")
    require_new_target(options.rrd, [file], suffix=".rrd")
    # Imported here: the command line loads no package before a command needs it.
    from turtlelog.explain import require_trust

    names = None if causes is None else split_names(causes, "--causes")
    (run,) = read_runs([file], topics)
    metric = metric or tl.explain.choose_metric(run.declaration)
    with name_as_typed(file, run):
        tl.explain.require_causes(run, metric, names)
        require_trust(run, trust_law=options.trust_law)
        found = tl.identify_run(run, trust_law=options.trust_law)
    if options.scenario is not None:
        _write_scenario(found, options.scenario)
    attribution = None
    if found.scenario is not None:
        with show_progress("simulated", 100.0, "%") as progress:
            attribution = tl.attribute_run(
                run,
                metric=metric,
                causes=names,
                identified=found,
                trust_law=options.trust_law,
                work=tl.explain.Work(jobs=require_jobs(options.jobs), report=progress.count),
            )
    motion = None if len(run.samples) else tl.explain.read_motion_facts(run)
    answer = build_explain_answer(
        file,
        tl.measure_run(run, only=[metric])[metric],
        found,
        attribution,
        None if motion is None else build_motion(file, run, motion),
    )
    if json:
        print_json(answer)
    elif motion is not None:
        print_text(format_motion(file, run, motion))
    else:
        print_text(format_explain_answer(answer, found))
        if attribution is not None and run.declaration.list_gains():
            print_text(_GIVEN)
        print_text(f"\n{format_explain_details(answer, found)}" if options.details else _DETAILS)
    if options.rrd is not None:
        _draw(run, found, attribution, options.rrd, require_jobs(options.jobs))


def _draw(
    run: "Run",
    found: "Identification",
    attribution: "Attribution | None",
    path: Path,
    jobs: int | None,
) -> None:
    if attribution is None:
        raise ExplainError(f"{path}: there is nothing to draw, because {_NOTHING}")
    with show_progress("simulating without", 100.0, "%") as progress:
        without = tl.explain.simulate_what_ifs(found, attribution, report=progress.count)
    luck = _measure_luck(run, found, attribution, jobs)
    tl.draw.write_explanation_rrd(run, attribution, without, path, luck=luck)
    print_note(f"wrote {path}")


def _measure_luck(
    run: "Run", found: "Identification", attribution: "Attribution", jobs: int | None
) -> "Luck | None":
    """Return the values from other starts; None without such values, as the text explains."""
    with show_progress("simulated", 100.0, "%") as progress:
        work = tl.explain.Work(jobs=jobs, report=progress.count)
        try:
            return tl.explain.measure_luck(run, identified=found, found=attribution, work=work)
        except ExplainError:
            return None


def _write_scenario(found: "Identification", path: Path) -> None:
    write_text(path, tl.format_scenario(found.build_scenario()))
    print_note(f"wrote {path}")


_NEEDS: Final = (
    "An explanation needs the samples of the controller (turtlelog_msgs/msg/ControlSample): the"
    " pose that it read, and the command that it gave."
)

_SILENCE: Final = 1.5
"""Silence, in usual periods, from which a silence is shown; one period may vary by half."""


def build_motion(file: Path, run: "Run", found: "MotionFacts") -> MotionAnswer:
    """Return the facts as an answer."""

    def tell_s(time_ns: float) -> float:
        return (time_ns - run.start_ns) / 1e9

    def build_rate(rows: int, periods: "Periods | None") -> RateAnswer:
        if periods is None:
            return RateAnswer(rows=rows)
        return RateAnswer(
            rows=rows,
            period_s=periods.usual_ns / 1e9,
            low_s=periods.low_ns / 1e9,
            high_s=periods.high_ns / 1e9,
            longest_silence_s=periods.longest_ns / 1e9,
            silence_at_s=tell_s(periods.longest_at_ns),
        )

    delays, replay = found.delays, found.replay
    largest, outliers = (
        [
            ValueAnswer(signal=one.signal, unit=one.unit, value=one.value, at_s=tell_s(one.time_ns))
            for one in values
        ]
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
                at_s=tell_s(jump.time_ns),
                moved=jump.moved_m,
                aside=jump.aside_m,
                turned=jump.turned_rad,
            )
            for jump in found.jumps
        ],
        gaps=[
            SilenceAnswer(start_s=tell_s(gap.start_ns), end_s=tell_s(gap.end_ns))
            for gap in found.gaps
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
        needs=_NEEDS,
    )


def format_motion(file: Path, run: "Run", found: "MotionFacts") -> str:
    """Return that no cause is known, and the facts as sentences."""
    name = escape_controls(file.name)
    sentences = [
        f"{name}: not explained, because there are no samples of a controller.",
        _tell_kind(run, found),
        _tell_rate(run, "pose", len(run.poses), found.poses),
        _tell_rate(run, "command", len(run.commands), found.commands),
        _tell_largest(run, found.largest),
        *_tell_outliers(run, found),
        *_tell_breaks(run, found),
        *_tell_plant(run, found),
    ]
    if found.replay is not None:
        sentences += [f"At {line}." for line in list_breaks(run, found.replay)]
    return fill_lines([*filter(None, sentences), "", _NEEDS])


def _tell_kind(run: "Run", found: "MotionFacts") -> str:
    topics = [run.notes.get(f"{kind}_topic", "") for kind in ("pose", "command")]
    where = join_words([escape_controls(topic) for topic in topics if topic])
    kind = "turtlesim" if found.kind == "turtlesim" else "a robot, not turtlesim"
    if found.kind == "robot" and run.poses.speed_m_s is not None and not run.parameters:
        kind = "a robot that publishes poses as turtlesim does, not turtlesim"
    length = f"run.duration {run.duration_s:.3f} s"
    return f"{kind[0].upper()}{kind[1:]}, {length}{f', of {where}' if where else ''}."


def _tell_rate(run: "Run", noun: str, rows: int, periods: "Periods | None") -> str:
    if periods is None:
        return f"{describe_count(rows, noun)}." if rows else f"No {noun}s."
    usual, low, high = (
        f"{period_ns / 1e6:.4g}"
        for period_ns in (periods.usual_ns, periods.low_ns, periods.high_ns)
    )
    text = f"{describe_count(rows, noun)}, usually one every {usual} ms"
    if low != high:
        text += f"; nine of ten within {low} to {high} ms"
    if periods.longest_ns > _SILENCE * periods.usual_ns:
        at_s = (periods.longest_at_ns - run.start_ns) / 1e9
        text += f"; the longest silence {periods.longest_ns / 1e9:.4g} s, from {at_s:.3f} s"
    return f"{text}."


def _tell_largest(run: "Run", found: "tuple[Largest, ...]") -> str:
    parts = [
        f"{largest.signal.replace('_', ' ')} {largest.value:.4g} {largest.unit}"
        f" at {round((largest.time_ns - run.start_ns) / 1e9, 3) + 0.0:.3f} s"
        for largest in found
    ]
    return f"Largest commands: {', '.join(parts)}." if parts else ""


def _tell_outliers(run: "Run", found: "MotionFacts") -> list[str]:
    from turtlelog.measure import describe_outliers

    if not found.outliers:
        return []
    return [
        f"The {signal.replace('_', ' ')} has {text}."
        for signal, text in describe_outliers(run).items()
    ]


def _tell_breaks(run: "Run", found: "MotionFacts") -> list[str]:
    """Return sentences on impossible steps and on missing poses."""
    from turtlelog.measure.breaks import describe_breaks

    if found.replay is not None:
        return []
    return [f"{text[0].upper()}{text[1:]}." for text in describe_breaks(run).values()]


def _tell_plant(run: "Run", found: "MotionFacts") -> list[str]:
    replay, delays = found.replay, found.delays
    if found.refused:
        return [f"Turtlesim's plant was not driven. {found.refused}."]
    if replay is None or not len(run.commands):
        return []
    use, error = replay.commands, replay.max_abs_error
    off = f"x {error.x_m:.3g} m, y {error.y_m:.3g} m, heading {degrees(error.heading_rad):.3g} deg"
    sentences = [
        f"Its commands through turtlesim's plant: {use.taken} taken, {use.unseen} that no pose"
        f" shows; it stopped by itself {use.stops} times. Largest differences {off}.",
        " ".join(judge_rounding(replay)),
    ]
    if use.unexplained_ticks:
        count = describe_count(use.unexplained_ticks, "tick")
        sentences.append(f"No recorded command explains the velocity of {count}.")
    if delays is not None:
        sentences.append(_tell_delays(delays))
    return sentences


def _tell_delays(found: "Delays") -> str:
    counts = [
        f"{count} in the next tick"
        if ticks == 0
        else f"{count} {describe_count(ticks, 'tick')} later"
        for ticks, count in found.counts.items()
    ]
    times = [f"{value / 1e6:.4g}" for value in (found.low_ns, found.median_ns, found.high_ns)]
    total = describe_count(sum(found.counts.values()), "command")
    low, median, high = times
    return (
        f"Dead time of the {total} that a pose shows: {join_words(counts)}. The pose comes {low} to"
        f" {high} ms after the command, usually {median} ms, by the recording's clock."
    )
