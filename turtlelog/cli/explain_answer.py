"""What `turtlelog explain` found, as JSON."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import turtlelog as tl

if TYPE_CHECKING:
    from turtlelog import Attribution, Identification
    from turtlelog.explain import StartRange


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

_DEAD_TIME: Final = "dead_time."
"""Begins the key of a loop's dead time."""


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
        "attribution": None if attribution is None else _describe_attribution(attribution),
        "notes": [*found.notes],
    }


def _list_dead_times(found: "Identification") -> dict[str, Any]:
    """Return the dead times by loop, or else by phase."""
    return {
        key.removeprefix(_DEAD_TIME): finding.value
        for key, finding in found.findings.items()
        if key.startswith(_DEAD_TIME)
    }


def _describe_attribution(found: "Attribution") -> dict[str, Any]:
    return {
        "metric": found.metric,
        "unit": found.unit,
        "as_logged": found.as_logged,
        "as_built": found.as_built,
        "without_all": found.without_all,
        "shares": [
            {"mechanism": share.mechanism, "share": share.share, "alone": share.alone}
            for share in found.shares
        ],
        "others": [
            {"mechanism": share.mechanism, "alone": share.alone, "ending": share.ending or None}
            for share in found.others
        ],
        "withheld": found.withheld or None,
        "together": [
            {"mechanisms": case.mechanisms, "value": case.value} for case in found.together
        ],
        "without_value": [
            {"mechanisms": case.mechanisms, "reason": case.reason} for case in found.without_value
        ],
        "grain": {"size": found.grain.size, "reason": found.grain.reason},
        "starts": None if found.starts is None else _describe_starts(found.starts),
        "sentences": tl.write_sentences(found),
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
