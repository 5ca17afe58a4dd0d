"""`turtlelog explain`: from a log to the reason."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.explain_answer import (
    describe_explanation,
    format_attribution,
    format_identification,
)
from turtlelog.cli.explain_motion import describe_motion, format_motion
from turtlelog.cli.list_names import complete_mechanisms, complete_metrics
from turtlelog.cli.options import (
    File,
    Jobs,
    Json,
    Place,
    ReadingOptions,
    read_runs,
    require_jobs,
    split_names,
)
from turtlelog.cli.output import print_json, print_note, print_text
from turtlelog.cli.progress import show_progress
from turtlelog.cli.targets import require_new_target
from turtlelog.errors import ExplainError

if TYPE_CHECKING:
    from turtlelog import Run
    from turtlelog.explain import Attribution, Identification

_NOTHING: Final = "No metric is explained: no scenario stands for this log."


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class ExplainOptions:
    """Files to write, which code may run, and in how many processes.

    Attributes:
        scenario: Write the identified scenario to this .toml file.
        rrd: Write a Rerun recording of the run beside its ghosts without the effects, and the
            attribution in steps.
        trust_law: Run the code of the law that the recording names, where it is not built in.
        jobs: Processes to simulate in; as many as cores where that is quicker. A law that is not
            built in takes one.
    """

    scenario: Place | None = None
    rrd: Place | None = None
    trust_law: bool = False
    jobs: Jobs = None


def explain(
    file: File,
    /,
    *,
    metric: Annotated[str | None, Parameter(metavar="ID", completer=complete_metrics)] = None,
    mechanisms: Annotated[
        str | None, Parameter(metavar="NAMES", completer=complete_mechanisms)
    ] = None,
    options: ExplainOptions | None = None,
    topics: ReadingOptions | None = None,
    json: Json = False,
) -> None:
    """Say what made a run what it is, and which effect caused which part of a metric.

    First it identifies, from the samples of the controller (the poses that it read and the commands
    that it gave): gains, limits, tolerances, dead times, queues, start backlog and pause, each with
    its evidence or the reason why the log does not show. The identified scenario is simulated again
    and compared with the log, sample by sample.

    Of another law than sequential-p no parameter is identified. Where its recording holds the whole
    scenario, that is simulated again; where it reproduces every sample, the loop's effects and the
    law's own mechanisms share the metric. That runs the code that the recording names, and needs
    --trust-law unless the law is built in.

    Of a recording without such samples, as most bags are, it says what poses and commands tell:
    how often they come, jumps, gaps, the largest commands, and of turtlesim the dead time of its
    commands, taken through its plant.

    Then it simulates that scenario without its effects, in every combination, and divides the
    metric among them: Shapley values, whose sum is the metric as built less that without all. They
    are given where the re-simulation has the log's own value; both stand side by side. Effects are
    what an implementation adds: queue, delay, jitter, loss, repeat, late, noise, bias, quantum,
    dropout, outlier, disturbance, of sequential-p pause and wrap, and what another law declares.
    Properties of any such loop stand beside them, each taken out alone: saturation, acceleration,
    jerk, shaping, sampling, float32, of sequential-p projection and tolerance.

    Where an effect is random, the shares are means over 32 seeds with standard errors; what this
    run's own seed makes of them is a line of its own.

    Example: turtlelog explain kp10.mcap --metric final.heading_error

    Args:
        file: A recording (.mcap), a ROS 2 bag, a table (.csv, .parquet, .tum), or one of the
            paper's logs (.json, .csv).
        metric: What to explain, by its id (turtlelog list metrics); by default the final position
            error, and without a goal the error of the last loop.
        mechanisms: Effects and properties that share it, separated by commas (turtlelog list
            mechanisms); by default every effect that is in the run. Of more than six, those six
            that change it most.
        json: Print one JSON object instead of tables.
    """
    options = options or ExplainOptions()
    require_new_target(options.scenario, [file], suffix=".toml")
    require_new_target(options.rrd, [file], suffix=".rrd")
    # Imported here: the command line loads no room before a command needs it.
    from turtlelog.explain import require_trust

    names = None if mechanisms is None else split_names(mechanisms, "--mechanisms")
    (run,) = read_runs([file], topics)
    is_asked = metric is not None or names is not None
    metric = metric or tl.explain.choose_metric(run.declaration)
    tl.explain.require_mechanisms(run, metric, names)
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
                mechanisms=names,
                identified=found,
                trust_law=options.trust_law,
                work=tl.explain.Work(jobs=require_jobs(options.jobs), report=progress.count),
            )
    motion = None if len(run.samples) else tl.explain.read_motion_facts(run)
    if json:
        motions = {"motion": None if motion is None else describe_motion(run, motion)}
        print_json(describe_explanation(file, found, attribution) | motions)
    elif motion is not None:
        print_text(format_motion(run, motion))
        if is_asked:
            print_text(_NOTHING)
    else:
        print_text(format_identification(found))
        print_text(_NOTHING if attribution is None else format_attribution(attribution))
    if options.rrd is not None:
        _draw(run, found, attribution, options.rrd)


def _draw(
    run: "Run",
    found: "Identification",
    attribution: "Attribution | None",
    path: Path,
) -> None:
    if attribution is None:
        raise ExplainError(f"{path}: expected shares or a ghost, found none: {_NOTHING}")
    with show_progress("simulating without", 100.0, "%") as progress:
        without = tl.explain.simulate_what_ifs(found, attribution, report=progress.count)
    tl.show.write_explanation_rrd(run, attribution, without, path)
    print_note(f"wrote {path}")


def _write_scenario(found: "Identification", path: Path) -> None:
    from turtlelog.log.complete_files import replace_when_complete

    text = tl.format_scenario(found.build_scenario())
    with replace_when_complete(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    print_note(f"wrote {path}")
