"""`turtlelog explain`: causes of a run's metric."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.explain_answer import (
    build_explain_answer,
    format_explain_answer,
    format_explain_details,
)
from turtlelog.cli.list_names import complete_causes, complete_metrics
from turtlelog.cli.motion_answer import build_motion, format_motion
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
from turtlelog.cli.output import print_json, print_note, print_text, write_text
from turtlelog.cli.progress import show_progress
from turtlelog.cli.targets import require_new_target
from turtlelog.errors import ExplainError

if TYPE_CHECKING:
    from turtlelog import Run
    from turtlelog.explain import (
        Attribution,
        Identification,
        Luck,
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
        write_text(options.scenario, tl.format_scenario(found.build_scenario()))
        print_note(f"wrote {options.scenario}")
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
