"""`turtlelog explain`: from a log to the reason."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.explain_answer import describe_explanation
from turtlelog.cli.explain_tables import format_attribution, format_identification
from turtlelog.cli.options import Json, TopicOptions, read_runs
from turtlelog.cli.output import print_json, print_note, print_text
from turtlelog.cli.progress import show_progress
from turtlelog.cli.targets import require_new_target
from turtlelog.errors import ExplainError

if TYPE_CHECKING:
    from turtlelog import Attribution, Identification, Run

_NOTHING: Final = "No metric is explained: there is no scenario to simulate."


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class OutputOptions:
    """Files to write.

    Attributes:
        scenario: Write the identified scenario to this .toml file.
        rrd: Write a Rerun recording of the run beside itself without each effect.
    """

    scenario: Path | None = None
    rrd: Path | None = None


def explain(
    file: Annotated[Path, Parameter(name="FILE")],
    /,
    *,
    metric: str = "final.position_error",
    mechanisms: str | None = None,
    outputs: OutputOptions | None = None,
    topics: TopicOptions | None = None,
    json: Json = False,
) -> None:
    """Say what made a run what it is, and which effect caused which part of a metric.

    First it identifies, from the samples of the controller (the poses that it read and the commands
    that it gave): gains, limits, tolerances, dead times, queues, start backlog and pause, each with
    its evidence or the reason why the log does not tell. The identified scenario is simulated again
    and compared with the log, sample by sample. Of a law other than sequential-p nothing is said.

    Then it simulates that scenario without its effects, in every combination, and divides the
    metric among them: Shapley values, whose sum is the metric as built less that without all. They
    are given where the re-simulation has the log's own value; both stand side by side. Effects are
    what an implementation adds: queue, pause, delay, wrap. Properties of any such loop stand beside
    them, each taken out alone: saturation, sampling, float32, projection, tolerance.

    Example: turtlelog explain kp10.mcap --metric final.heading_error --scenario found.toml

    Args:
        file: A recording (.mcap), a ROS 2 bag, or one of the paper's logs (.json, .csv).
        metric: What to explain, by its id (turtlelog metrics lists them).
        mechanisms: Effects and properties that share it, separated by commas; by default every
            effect that is in the run. Of more than six, those six that change it most.
        json: Print one JSON object instead of tables.
    """
    outputs = outputs or OutputOptions()
    require_new_target(outputs.scenario, [file], suffix=".toml")
    require_new_target(outputs.rrd, [file], suffix=".rrd")
    names = None if mechanisms is None else [name.strip() for name in mechanisms.split(",")]
    tl.require_players(metric, names)
    (run,) = read_runs([file], topics)
    found = tl.identify_run(run)
    if outputs.scenario is not None:
        _write_scenario(found, outputs.scenario)
    attribution = None
    if found.scenario is not None:
        attribution = tl.attribute_run(run, metric=metric, mechanisms=names, identified=found)
    if json:
        print_json(describe_explanation(file, found, attribution))
    else:
        print_text(format_identification(found))
        print_text(_NOTHING if attribution is None else format_attribution(attribution))
    if outputs.rrd is not None:
        _draw(run, found, attribution, outputs.rrd)


def _draw(
    run: "Run",
    found: "Identification",
    attribution: "Attribution | None",
    path: Path,
) -> None:
    if attribution is None or attribution.withheld:
        reason = _NOTHING if attribution is None else attribution.withheld
        raise ExplainError(f"{path}: expected shares to draw, found none: {reason}")
    shares = {share.mechanism: share.share for share in attribution.shares if share.share}
    chosen = [[name] for name in shares]
    if len(shares) > 1:
        chosen.append([*shares])
    with show_progress("simulating without", len(chosen)) as progress:
        without = {}
        for number, names in enumerate(chosen, start=1):
            without[" and ".join(names)] = tl.simulate_without(found.build_scenario(), names)
            progress.done = number
    tl.write_explanation_rrd(run, without, shares, path, metric=attribution.metric)
    print_note(f"wrote {path}")


def _write_scenario(found: "Identification", path: Path) -> None:
    from turtlelog.log.atomic import replace_when_complete

    text = tl.format_scenario(found.build_scenario())
    with replace_when_complete(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    print_note(f"wrote {path}")
