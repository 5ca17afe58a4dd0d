"""What `turtlelog explain` found: as JSON, as tables and sentences."""

import textwrap
from dataclasses import replace
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import turtlelog as tl
from turtlelog.cli.output import format_table

if TYPE_CHECKING:
    from turtlelog.explain import Attribution, Finding, Identification, SeedRange, StartRange


_JSON: Final = {
    "start_backlog": "loop.start_backlog",
    "pause_ticks": "law.pause_ticks",
    "dead_time_ticks": {},
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

_ROWS: Final = (
    ("start backlog", "loop.start_backlog", "poses"),
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
"""What the table shows: its name, its key among the findings, its unit there."""

_DEAD_TIME: Final = "dead_time."
"""Begins the key of a loop's dead time."""


_DRIVEN: Final = "No simulation stands for this log. The plant was driven with its commands."

_NOTED: Final = "the recorded scenario"
"""Evidence of what is known by the re-simulation of the recorded scenario."""

_TEXT_WIDTH: Final = 95
"""As wide as the notes of tables."""

_EVIDENCE_WIDTH: Final = 46

_WIDTH: Final = 96
"""Of lines, as wide as the notes of a table [characters]."""


def describe_explanation(
    file: Path, found: "Identification", attribution: "Attribution | None"
) -> dict[str, Any]:
    """Return the answer."""
    again = found.resimulation
    return {
        "file": str(file),
        "name": found.name,
        "identified": _nest(_JSON, found, "value") | {"dead_time_ticks": _list_dead_times(found)},
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
        "tried": {key: [*values] for key, values in found.tried.items()},
        "attribution": None if attribution is None else describe_attribution(attribution),
        "notes": [*found.notes],
    }


def _list_dead_times(found: "Identification") -> dict[str, Any]:
    """Return the dead times by loop, or else by phase."""
    return {
        key.removeprefix(_DEAD_TIME): finding.value
        for key, finding in found.findings.items()
        if key.startswith(_DEAD_TIME)
    }


def describe_attribution(found: "Attribution") -> dict[str, Any]:
    """Return what is told of an attribution."""
    return {
        "metric": found.metric,
        "unit": found.unit,
        "as_logged": found.as_logged,
        "as_built": found.as_built,
        "without_all": found.without_all,
        "shares": [
            {
                "mechanism": share.mechanism,
                "share": share.share,
                "standard_error": share.standard_error,
                "alone": share.alone,
            }
            for share in found.shares
        ],
        "this_seed": found.this_seed,
        "seeds": None if found.seeds is None else _describe_seeds(found.seeds),
        "others": [
            {
                "mechanism": share.mechanism,
                "alone": share.alone,
                "standard_error": share.standard_error,
                "ending": share.ending or None,
            }
            for share in found.others
        ],
        "withheld": found.withheld or None,
        "together": [
            {
                "mechanisms": case.mechanisms,
                "value": case.value,
                "standard_error": case.standard_error,
            }
            for case in found.together
        ],
        "without_value": [
            {"mechanisms": case.mechanisms, "reason": case.reason} for case in found.without_value
        ],
        "grain": {"size": found.grain.size, "reason": found.grain.reason},
        "starts": None if found.starts is None else _describe_starts(found.starts),
        "sentences": tl.explain.write_sentences(found),
    }


def _describe_seeds(found: "SeedRange") -> dict[str, Any]:
    return {
        "count": found.count,
        "used": found.used,
        "mean": found.mean,
        "standard_error": found.standard_error,
        "low": found.low,
        "high": found.high,
    }


def _describe_starts(found: "StartRange") -> dict[str, Any]:
    return {
        "count": found.count,
        "within_rad": found.within_rad,
        "low": found.low,
        "high": found.high,
        "without_value": found.without_value,
        "is_wide": found.is_wide,
        "parts": [
            {"mechanism": name, "low": low, "high": high}
            for name, (low, high) in found.parts.items()
        ],
    }


def _nest(places: dict[str, Any], found: "Identification", field: str) -> dict[str, Any]:
    return {
        name: _nest(key, found, field)
        if isinstance(key, dict)
        else getattr(found.findings.get(key), field, None)
        for name, key in places.items()
    }


def format_identification(found: "Identification") -> str:
    """Return what was identified, with its evidence, and how the re-simulation compares."""
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
            # The note that is its evidence stands below the table, once.
            rows += _format_finding(name, replace(finding, evidence=_NOTED), unit)
    table = tl.compare.Table(
        title=f"Identified from the log of {found.name}",
        columns=tuple(
            tl.compare.Column(title=title) for title in ("", "value", "how sure", "evidence")
        ),
        rows=tuple(rows),
        notes=tuple(_capitalise(note) + _name_unknown(names) for note, names in hidden.items()),
    )
    return f"{format_table(table)}\n{_format_resimulation(found)}"


def _name_unknown(names: list[str]) -> str:
    """Return which values a note is the reason of that there are none."""
    return f" Therefore unknown: {', '.join(names)}." if names else ""


def format_attribution(found: "Attribution") -> str:
    """Return the values, the shares, and what they mean."""
    from turtlelog.explain.attribution import THIS_SEED, THIS_SEED_MEANS

    unit, sentences = found.unit, tl.explain.write_sentences(found)
    parts = found.changing
    if all(one.share is None and one.alone is None for one in parts):
        # No table of dashes or zeros: what there is to say stands in the sentences.
        wrapped = "\n".join(textwrap.fill(one, _TEXT_WIDTH) for one in sentences)
        return f"\nWhat caused {found.metric}\n\n{wrapped}"
    columns = [
        tl.compare.Column(title="mechanism"),
        tl.compare.Column(title="share", unit=unit),
        tl.compare.Column(title="without it alone", unit=unit),
        tl.compare.Column(title="without it means"),
    ]
    rows = [[one.mechanism, one.share, one.alone, one.meaning] for one in parts]
    if any(one.standard_error for one in parts):
        columns.insert(2, tl.compare.Column(title="standard error", unit=unit))
        for row, one in zip(rows, parts, strict=True):
            row.insert(2, one.standard_error)
        if found.shares and found.seeds is not None and found.seeds.varies:
            row = [THIS_SEED, found.this_seed, None, None, THIS_SEED_MEANS]
            rows.insert(sum(one.share is not None for one in parts), row)
    table = tl.compare.Table(
        title=f"What caused {found.metric}",
        columns=tuple(columns),
        rows=tuple(map(tuple, rows)),
        notes=sentences,
    )
    return f"\n{format_table(table)}"


def _list_rows(found: "Identification") -> list[tuple[str, str, str]]:
    """Return the rows, with one for the dead time of each loop, and none of an unknown law."""
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
    again = found.resimulation
    if again is None:
        if not found.tried:
            return "Nothing was simulated again.\n"
        return f"{_DRIVEN}\n{_format_tried(found)}\n"
    error = again.max_abs_error
    return (
        f"Simulated again: {again.samples} samples, largest differences x {error.x_m:.3g} m,"
        f" y {error.y_m:.3g} m,\nheading {degrees(error.heading_rad):.3g} deg,"
        f" commands {again.max_command_error:.3g}.\n{_format_tried(found)}\n"
    )


def _format_tried(found: "Identification") -> str:
    """Return among which settings of the loop the log's were looked for."""
    if not found.tried:
        return "Settings tried: those recorded, and no others."
    parts = [
        f"{name} {_format_range(found.tried[key], unit)}"
        for name, key, unit in _ROWS
        if len(found.tried.get(key, ())) > 1
    ]
    text = (
        f"Settings tried: {'; '.join(parts) or 'one, the clock and the dead times leave no other'}."
    )
    return textwrap.fill(text, _WIDTH, break_on_hyphens=False)


def _format_range(values: tuple[Any, ...], unit: str) -> str:
    if len(values) > 2 and [*values] == [*range(values[0], values[0] + len(values))]:
        return f"{values[0]} to {values[-1]} {unit}".rstrip()
    return f"{', '.join(map(str, values))} {unit}".rstrip()


def _capitalise(note: str) -> str:
    return f"{note[:1].upper()}{note[1:]}."
