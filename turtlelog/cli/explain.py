"""`turtlelog explain`: from a log to the reason."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class OutputOptions:
    """Files to write.

    Attributes:
        scenario: Write the identified scenario to this .toml file.
        rrd: Write a Rerun recording of the run beside itself without each mechanism.
    """

    scenario: Path | None = None
    rrd: Path | None = None


def explain(
    file: Annotated[Path, Parameter(name="FILE")],
    /,
    *,
    metric: str = "final.position_error",
    mechanisms: str = "queue,pause",
    outputs: OutputOptions | None = None,
    topics: TopicOptions | None = None,
    json: Json = False,
) -> None:
    """Say what made a run what it is, and which mechanism caused which part of a figure.

    First it identifies, from the samples of the controller (the poses that it read and the commands
    that it gave): gains, limits, tolerances, dead times, queues, start backlog and pause, each with
    its evidence or the reason why the log does not tell.
    The identified scenario is simulated again and compared with the log, sample by sample.

    Then it simulates the scenario without its mechanisms, in every combination, and shares the
    figure out among them: Shapley values, whose sum is the figure as built less that without all.

    Example: turtlelog explain kp10.mcap --metric final.heading_error --scenario found.toml

    Args:
        file: A recording (.mcap), a ROS 2 bag, or one of the paper's logs (.json, .csv).
        metric: The figure to share out, by its id (turtlelog metrics lists them).
        mechanisms: Who shares, separated by commas: queue, pause, delay, saturation, sampling,
            float32, projection, wrap, tolerance.
        json: Print one JSON object instead of tables.
    """
    outputs = outputs or OutputOptions()
    require_new_target(outputs.scenario, [file], suffix=".toml")
    require_new_target(outputs.rrd, [file], suffix=".rrd")
    names = [name.strip() for name in mechanisms.split(",")]
    tl.require_players(metric, names)
    (run,) = read_runs([file], topics)
    found = tl.identify_run(run)
    if outputs.scenario is not None:
        _write_scenario(found, outputs.scenario)
    attribution, obstacle = _attribute(found, metric, names)
    if json:
        print_json(describe_explanation(file, found, attribution, obstacle))
    else:
        print_text(format_identification(found))
        print_text(obstacle if attribution is None else format_attribution(attribution))
    if outputs.rrd is not None:
        _draw(run, found, attribution, outputs.rrd)


def _attribute(
    found: "Identification", metric: str, mechanisms: list[str]
) -> "tuple[Attribution | None, str]":
    """Return the attribution, or why there is none."""
    if found.scenario is None:
        return None, "No figure is attributed: there is no scenario to simulate."
    try:
        return tl.attribute_scenario(found.scenario, metric=metric, mechanisms=mechanisms), ""
    except ExplainError as err:
        return None, f"No figure is attributed: {err}"


def _draw(
    run: "Run",
    found: "Identification",
    attribution: "Attribution | None",
    path: Path,
) -> None:
    if attribution is None:
        raise ExplainError(f"{path}: expected shares to draw, found no figure attributed")
    shares = {share.mechanism: share.share or 0.0 for share in attribution.shares}
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
