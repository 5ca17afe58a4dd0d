"""`turtlelog explain`: from a log to the reason."""

import textwrap
from dataclasses import dataclass, replace
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.options import Json, TopicOptions, read_runs
from turtlelog.cli.output import format_table, print_json, print_note, print_text
from turtlelog.cli.progress import show_progress
from turtlelog.cli.targets import require_new_target
from turtlelog.errors import ExplainError, UsageError

if TYPE_CHECKING:
    from turtlelog import Attribution, Identification, Run
    from turtlelog.explain import Finding

_ROWS: Final = (
    ("start backlog", "loop.start_backlog", "poses"),
    ("pause", "law.pause_ticks", "ticks"),
    ("  by the clock", "pause.seconds", "s"),
    ("  command held in it", "pause.held_turn_rate_rad_s", "rad/s"),
    ("  turned by its end", "pause.turned_rad", "rad"),
    ("  answered at once", "pause.burst", "poses"),
    ("dead time rotating", "dead_time.rotate", "ticks"),
    ("dead time translating", "dead_time.translate", "ticks"),
    ("lost commands", "lost_commands", ""),
    ("queue policy", "loop.queue_policy", ""),
    ("command queue", "loop.command_queue", ""),
    ("pose queue", "loop.pose_queue", ""),
    ("transport delay", "loop.transport_delay_ticks", "ticks"),
    ("answers every", "loop.period_ticks", "ticks"),
    ("Kp angular", "law.kp_angular", "1/s"),
    ("Kp linear", "law.kp_linear", "1/s"),
    ("turn rate limit", "limits.turn_rate_rad_s", "rad/s"),
    ("speed limit", "limits.speed_m_s", "m/s"),
    ("heading tolerance", "law.heading_tolerance_rad", "rad"),
    ("position tolerance", "law.position_tolerance_m", "m"),
    ("projection", "law.projection", ""),
    ("wrapped error", "law.wrap_error", ""),
    ("poses", "loop.pose_precision", ""),
    ("stop reason", "stop_reason", ""),
)
"""What the table shows: its name, its key among the findings, its unit there."""

_EVIDENCE_WIDTH: Final = 46

_JSON: Final = {
    "start_backlog": "loop.start_backlog",
    "pause_ticks": "law.pause_ticks",
    "dead_time_ticks": {"rotate": "dead_time.rotate", "translate": "dead_time.translate"},
    "gains": {"angular": "law.kp_angular", "linear": "law.kp_linear"},
    "limits": {"speed": "limits.speed_m_s", "turn_rate": "limits.turn_rate_rad_s"},
    "heading_tolerance": "law.heading_tolerance_rad",
    "position_tolerance": "law.position_tolerance_m",
    "projection": "law.projection",
    "wrap_error": "law.wrap_error",
    "stop_reason": "stop_reason",
    "lost_commands": "lost_commands",
    "queue_policy": "loop.queue_policy",
    "command_queue": "loop.command_queue",
    "pose_queue": "loop.pose_queue",
    "transport_delay_ticks": "loop.transport_delay_ticks",
    "period_ticks": "loop.period_ticks",
    "pose_precision": "loop.pose_precision",
    "pause": {
        "seconds": "pause.seconds",
        "held_turn_rate": "pause.held_turn_rate_rad_s",
        "turned": "pause.turned_rad",
        "burst": "pause.burst",
    },
}
"""What stands where in the answer's `identified`."""


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

    First it identifies, from poses and commands alone: gains, limits, tolerances, dead times,
    queues, start backlog and pause, each with its evidence or the reason why the log does not tell.
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
    (run,) = read_runs([file], topics)
    found = tl.identify_run(run)
    if outputs.scenario is not None:
        _write_scenario(found, outputs.scenario)
    attribution, obstacle = _attribute(found, metric, mechanisms)
    if json:
        print_json(_describe(file, found, attribution, obstacle))
    else:
        print_text(_format(found))
        print_text(obstacle if attribution is None else _format_attribution(attribution))
    if outputs.rrd is not None:
        _draw(run, found, attribution, outputs.rrd)


def _attribute(
    found: "Identification", metric: str, mechanisms: str
) -> "tuple[Attribution | None, str]":
    """Return the attribution, or why there is none; what is misspelt is refused."""
    names = [name.strip() for name in mechanisms.split(",")]
    if metric not in tl.METRICS:
        raise UsageError(f"--metric: expected one of {', '.join(tl.METRICS)}, found {metric!r}")
    for name in names:
        if name not in tl.MECHANISMS:
            known = ", ".join(tl.MECHANISMS)
            raise UsageError(f"--mechanisms: expected some of {known}, found {name!r}")
    if len({*names}) < len(names):
        raise UsageError(f"--mechanisms: expected different ones, found {mechanisms!r}")
    if found.scenario is None:
        return None, "No figure is attributed: there is no scenario to simulate."
    try:
        return tl.attribute_scenario(found.scenario, metric=metric, mechanisms=names), ""
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


def _format(found: "Identification") -> str:
    rows: list[tuple[str, ...]] = []
    for name, key, unit in _ROWS:
        if key in found.findings:
            finding = found.findings[key]
            evidence = "see below" if finding.evidence in found.notes else finding.evidence
            rows += _format_finding(name, replace(finding, evidence=evidence), unit)
    table = tl.Table(
        title=f"What the log of {found.name} tells",
        columns=tuple(tl.Column(title=title) for title in ("", "value", "how sure", "evidence")),
        rows=tuple(rows),
        notes=tuple(_capitalise(note) for note in found.notes),
    )
    return f"{format_table(table)}\n{_format_resimulation(found)}"


def _format_attribution(found: "Attribution") -> str:
    unit = found.unit
    table = tl.Table(
        title=f"What caused {found.metric}",
        columns=(
            tl.Column(title="mechanism"),
            tl.Column(title="share", unit=unit),
            tl.Column(title="without it alone", unit=unit),
            tl.Column(title="without it means"),
        ),
        rows=tuple(
            (
                share.mechanism,
                share.share,
                share.alone,
                tl.MECHANISMS[share.mechanism].meaning,
            )
            for share in (*found.shares, *found.others)
        ),
        notes=tl.write_sentences(found),
    )
    return f"\n{format_table(table)}"


def _format_finding(name: str, finding: "Finding", unit: str) -> list[tuple[str, ...]]:
    value = "-" if finding.value is None else _format_value(finding.value, unit)
    evidence = finding.evidence
    if finding.candidates:
        evidence += ": " + ", ".join(map(str, finding.candidates))
    if finding.value is not None and finding.interval is not None:
        low, high = (_format_value(bound, unit, digits=4) for bound in finding.interval)
        evidence += f": {low} to {high}"
    first, *rest = textwrap.wrap(evidence, _EVIDENCE_WIDTH, break_on_hyphens=False)
    return [(name, value, finding.certainty.value, first), *(("", "", "", line) for line in rest)]


def _format_value(value: Any, unit: str, digits: int = 6) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str):
        return value.replace("_", " ")
    if unit in {"rad", "rad/s"}:
        value, unit = degrees(value), unit.replace("rad", "deg")
    return f"{value:.{digits}g} {unit}".rstrip()


def _format_resimulation(found: "Identification") -> str:
    again = found.resimulation
    if again is None:
        return "Nothing was simulated again.\n"
    error = again.max_abs_error
    return (
        f"Simulated again: {again.samples} samples, largest differences x {error.x_m:.3g} m,"
        f" y {error.y_m:.3g} m,\nheading {degrees(error.heading_rad):.3g} deg,"
        f" commands {again.max_command_error:.3g}.\n"
    )


def _capitalise(note: str) -> str:
    return f"{note[:1].upper()}{note[1:]}."


def _describe(
    file: Path, found: "Identification", attribution: "Attribution | None", obstacle: str
) -> dict[str, Any]:
    again = found.resimulation
    return {
        "file": str(file),
        "name": found.name,
        "identified": _nest(_JSON, found, "value"),
        "reasons": {
            key: finding.evidence
            for key, finding in found.findings.items()
            if finding.value is None
        },
        "findings": [
            {
                "key": key,
                "value": finding.value,
                "certainty": finding.certainty.value,
                "evidence": finding.evidence,
                "interval": finding.interval,
                "candidates": finding.candidates,
                "assumed": finding.assumed,
            }
            for key, finding in found.findings.items()
        ],
        "resimulation": None
        if again is None
        else {
            "samples": again.samples,
            "max_abs_error": {
                "x": again.max_abs_error.x_m,
                "y": again.max_abs_error.y_m,
                "heading": again.max_abs_error.heading_rad,
            },
            "max_command_error": again.max_command_error,
            "is_exact": again.is_exact,
        },
        "attribution": None if attribution is None else _describe_attribution(attribution),
        "notes": [*found.notes, *([obstacle] if obstacle else [])],
    }


def _describe_attribution(found: "Attribution") -> dict[str, Any]:
    return {
        "metric": found.metric,
        "unit": found.unit,
        "as_built": found.as_built,
        "without_all": found.without_all,
        "shares": [
            {"mechanism": share.mechanism, "share": share.share, "alone": share.alone}
            for share in found.shares
        ],
        "others": [{"mechanism": share.mechanism, "alone": share.alone} for share in found.others],
        "interaction": found.interaction,
        "heading_tolerance_explains": found.bound,
        "sentences": list(tl.write_sentences(found)),
    }


def _nest(places: dict[str, Any], found: "Identification", field: str) -> dict[str, Any]:
    return {
        name: _nest(key, found, field)
        if isinstance(key, dict)
        else getattr(found.findings.get(key), field, None)
        for name, key in places.items()
    }
