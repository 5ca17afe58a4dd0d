"""The answer of `turtlelog explain` as data and as text."""

import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import turtlelog as tl
from turtlelog.cli.motion_answer import MotionAnswer
from turtlelog.cli.output import build_table, copy_fields, fill_lines, fit_table
from turtlelog.cli.replay_answer import build_pose_error
from turtlelog.escapes import escape_controls

if TYPE_CHECKING:
    from turtlelog import Metric
    from turtlelog.explain import Attribution, Finding, Identification


_ROWS: Final = (
    ("initial queue", "loop.start_backlog", "poses"),
    ("pause", "law.pause_ticks", "ticks"),
    ("  by the clock", "pause.seconds", "s"),
    ("  command held in it", "pause.held_turn_rate_rad_s", "rad/s"),
    ("  turned by the end", "pause.turned_rad", "rad"),
    ("  answered at once", "pause.burst", "poses"),
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
"""Rows of the table: name, key of the finding, and unit."""

_DEAD_TIME: Final = "dead_time."
"""Prefix of the key of a loop's dead time."""

_DRIVEN: Final = "No scenario fits this log. The plant was driven with its commands."

_NOTED: Final = "the recorded scenario"
"""Evidence of values known from the re-simulated recorded scenario."""

_EVIDENCE_WIDTH: Final = 26
_MEANING_WIDTH: Final = 30
"""Width of the last columns of tables [characters]; other columns need the rest of a line."""


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
        resimulation: Comparison of the re-simulated scenario with the log; None without one.
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
    attribution: "Attribution | None"
    in_words: Mapping[str, str]
    notes: tuple[str, ...]
    motion: MotionAnswer | None


def build_explain_answer(
    file: Path,
    metric: "Metric",
    found: "Identification",
    attribution: "Attribution | None",
    motion: MotionAnswer | None,
) -> ExplainAnswer:
    """Return the answer as data."""
    again = found.resimulation
    error = {} if again is None else {"max_abs_error": build_pose_error(again.max_abs_error)}
    return ExplainAnswer(
        file=str(file),
        name=found.name,
        metric=metric.to_dict(),
        identified=tuple(
            copy_fields(FindingAnswer, one, key=key, certainty=one.certainty.value)
            for key, one in found.findings.items()
        ),
        resimulation=None if again is None else asdict(again) | error,
        tried=found.tried,
        attribution=attribution,
        in_words={} if attribution is None else dict(_describe_causes(found, attribution)),
        notes=found.notes,
        motion=motion,
    )


def _describe_causes(
    found: "Identification", attribution: "Attribution"
) -> Iterator[tuple[str, str]]:
    """Yield each contributing cause with its settings in this run, or words for them."""
    from turtlelog.scenario import flatten_scenario

    scenario = found.build_scenario()
    values = flatten_scenario(scenario)
    table = tl.explain.find_causes(scenario)
    for one in attribution.contributions:
        neutral = table[one.cause].neutral
        settings = [
            f"{key} = {values[key]}"
            for key in neutral
            if values.get(key, neutral[key]) != neutral[key]
        ]
        text, describe = ", ".join(settings), _WORDS.get((*neutral,))
        yield one.cause, text if describe is None else describe(found, text)


def _describe_queue(found: "Identification", settings: str) -> str:
    """Return text on the dead times that include the queue."""
    parts: list[str] = []
    for key, finding in found.findings.items():
        if key.startswith(_DEAD_TIME) and finding.value is not None:
            loop = tl.explain.describe_loop_name(found.law, key.removeprefix(_DEAD_TIME))
            parts.append(f"{finding.value}{'' if parts else ' ticks'} {loop}")
    if not parts:
        return settings
    return f"commands wait: dead time {', '.join(parts)}"


def _describe_pause(found: "Identification", settings: str) -> str:
    seconds = getattr(found.findings.get("pause.seconds"), "value", None)
    if not found.tells_law or seconds is None:
        return settings
    return f"the controller is silent for {seconds:.4g} s after the rotation"


def _describe_wrap(found: "Identification", settings: str) -> str:
    return "the heading error is not wrapped to half a turn" if found.tells_law else settings


_WORDS: Final = {
    ("loop.queue_policy", "loop.start_backlog"): _describe_queue,
    ("law.pause_ticks",): _describe_pause,
    ("law.wrap_error",): _describe_wrap,
}
"""Functions that describe a cause, by the settings that remove it."""


def format_explain_answer(answer: ExplainAnswer, found: "Identification") -> str:
    """Return the value, its causes, what they depend on, and the confidence."""
    name = escape_controls(Path(answer.file).name)
    attribution = answer.attribution
    if attribution is None:
        return _fill([f"{name}: {_write_unknown(answer.metric)}", *_write_known(answer, found)])
    named = tl.explain.choose_named(attribution)
    lines = [f"{name}: {tl.explain.write_headline(attribution)}"]
    if named:
        lines += ["", f"{tl.explain.write_cause_head(attribution)}:"]
    sizes = [tl.explain.format_contribution(attribution, one) for one in named]
    widths = [max(map(len, column), default=0) for column in ([one.cause for one in named], sizes)]
    for one, size in zip(named, sizes, strict=True):
        head = f"  {one.cause:<{widths[0]}}  {size:<{widths[1]}}  "
        words = answer.in_words[one.cause]
        lines.append(fill_lines([f"{head}{words}".rstrip()], indent=len(head)))
    lines += tl.explain.write_reasons(attribution)
    return _fill([*lines, _write_confidence(found, attribution)])


def _fill(lines: list[str]) -> str:
    return "\n".join(line if line.startswith("  ") else fill_lines([line]) for line in lines)


def _write_unknown(metric: Mapping[str, Any]) -> str:
    if metric["value"] is None:
        return f"{metric['id']} has no value: {metric['reason']}"
    size = f"{metric['value']:.4g} {metric['unit']}".removesuffix(" 1")
    return f"{metric['id']} is {size}; its causes are unknown"


def _write_known(answer: ExplainAnswer, found: "Identification") -> Iterator[str]:
    """Yield the reason why no scenario can be simulated, and the facts in the log."""
    yield from map(_capitalise, answer.notes)
    known = [
        f"{name.strip()} {_format_value(finding.value, unit)}"
        for name, key, unit in _list_rows(found)
        if (finding := found.findings.get(key)) is not None and finding.value is not None
    ]
    if known:
        yield f"The log shows: {', '.join(known)}."


def _write_confidence(found: "Identification", attribution: "Attribution") -> str:
    """Return how well the simulated scenario reproduces the log."""
    again = found.resimulation
    if again is None:
        return ""
    rows = f"all {again.samples} samples"
    if found.is_recorded:
        return f"Confidence: as recorded. The recorded scenario reproduces {rows}."
    if not again.is_exact:
        return f"Confidence: {_judge_settings(found)}. {_write_differences(found)}"
    label = "Confidence: exact. " if attribution.acting and not attribution.doubts else ""
    return f"{label}The re-simulation reproduces {rows} bit for bit."


def _judge_settings(found: "Identification") -> str:
    """Return the confidence in loop settings that do not reproduce every sample."""
    from turtlelog.explain import Certainty

    settings = [one for key, one in found.findings.items() if key in found.tried]
    is_known = all(one.certainty is not Certainty.UNKNOWN for one in settings)
    return "fitted" if settings and is_known else "unknown in part"


def _write_differences(found: "Identification") -> str:
    again = found.resimulation
    if again is None:
        return "Nothing was simulated again."
    error = again.max_abs_error
    return (
        f"Largest differences of the re-simulation, in {again.samples} samples: x {error.x_m:.3g}"
        f" m, y {error.y_m:.3g} m, heading {degrees(error.heading_rad):.3g} deg, commands"
        f" {again.max_command_error:.3g}."
    )


def format_explain_details(answer: ExplainAnswer, found: "Identification") -> str:
    """Return every cause, the identified settings with evidence, and the tried values."""
    parts = [] if answer.attribution is None else [format_causes(answer.attribution)]
    parts += [format_identification(found), _format_resimulation(found)]
    return "\n".join(filter(None, parts))


def format_identification(found: "Identification") -> str:
    """Return the identified settings with their evidence."""
    rows: list[tuple[str, ...]] = []
    hidden: dict[str, list[str]] = {note: [] for note in found.notes}
    for name, key, unit in _list_rows(found):
        finding = found.findings.get(key)
        if finding is None:
            continue
        if finding.evidence not in hidden:
            rows += _format_finding(name, finding, unit)
        elif finding.value is None:
            hidden[finding.evidence].append(name.strip())
        else:
            # Its evidence is the note below the table, printed once.
            rows += _format_finding(name, replace(finding, evidence=_NOTED), unit)
    notes = []
    for note, names in hidden.items():
        unknown = f" Therefore unknown: {', '.join(names)}." if names else ""
        notes.append(_capitalise(note) + unknown)
    heads = ("", "value", "confidence", "evidence")
    table = build_table(f"Identified from the log of {found.name}", heads, rows)
    return "\n".join([fit_table(table), *([_fill(notes), ""] if notes else [])])


def format_causes(found: "Attribution") -> str:
    """Return a table of the causes that change the value; empty if there are none."""
    from turtlelog.explain.answers import THIS_SEED, THIS_SEED_MEANS

    unit, parts = f" [{found.unit}]" if found.unit else "", found.changing
    if all(one.contribution is None and one.alone is None for one in parts):
        return ""
    heads = ["cause", f"contribution{unit}", f"without it{unit}", "without it means"]
    rows = [[one.cause, one.contribution, one.alone, one.meaning] for one in parts]
    if any(one.standard_error for one in parts):
        heads.insert(2, f"s.e.{unit}")
        for row, one in zip(rows, parts, strict=True):
            row.insert(2, one.standard_error)
        if found.contributions and found.seeds is not None and found.seeds.varies:
            row = [THIS_SEED, found.this_seed, None, None, THIS_SEED_MEANS]
            rows.insert(sum(one.contribution is not None for one in parts), row)
    lines = (line for row in rows for line in _break_row(row))
    return fit_table(build_table(f"Causes of {found.metric}", heads, lines))


def _break_row(row: list[Any]) -> list[tuple[Any, ...]]:
    """Return a row whose last cell continues on further lines."""
    first, *rest = textwrap.wrap(row[-1], _MEANING_WIDTH, break_on_hyphens=False)
    return [(*row[:-1], first), *(("",) * (len(row) - 1) + (line,) for line in rest)]


def _list_rows(found: "Identification") -> list[tuple[str, str, str]]:
    """Return the rows, with one row for each loop's dead time, and none for an unknown law."""
    from turtlelog.explain import describe_loop_name

    keys = [key for key in found.findings if key.startswith(_DEAD_TIME)]
    names = [describe_loop_name(found.law, key.removeprefix(_DEAD_TIME)) for key in keys]
    rows = [(f"dead time {name}", key, "ticks") for name, key in zip(names, keys, strict=True)]
    after = [key for _, key, _ in _ROWS].index("lost_commands")
    rows = [*_ROWS[:after], *rows, *_ROWS[after:]]
    return [row for row in rows if found.tells_law or not row[1].startswith("law.")]


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
    if unit == "rad":
        value, unit = degrees(value), "deg"
    return f"{value:.{digits}g} {unit}".rstrip()


def _format_resimulation(found: "Identification") -> str:
    if found.resimulation is not None:
        return _fill([_write_differences(found), _format_tried(found)])
    if not found.tried:
        return "Nothing was simulated again."
    return _fill([_DRIVEN, _format_tried(found)])


def _format_tried(found: "Identification") -> str:
    """Return text on the loop settings that were tried."""
    if not found.tried:
        return "Settings tried: those recorded, and no others."
    parts = [
        f"{name} {_format_range(found.tried[key], unit)}"
        for name, key, unit in _ROWS
        if len(found.tried.get(key, ())) > 1
    ]
    only = "one, the clock and the dead times leave no other"
    return f"Settings tried: {'; '.join(parts) or only}."


def _format_range(values: tuple[Any, ...], unit: str) -> str:
    if len(values) > 2 and [*values] == [*range(values[0], values[0] + len(values))]:
        return f"{values[0]} to {values[-1]} {unit}".rstrip()
    return f"{', '.join(map(str, values))} {unit}".rstrip()


def _capitalise(note: str) -> str:
    return f"{note[:1].upper()}{note[1:].removesuffix('.')}."
