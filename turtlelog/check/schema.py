"""The JSON Schema of specification files, for editors."""

from collections.abc import Mapping
from typing import Any

from turtlelog.check.vocabulary import PHASES
from turtlelog.compare import ALIGNMENTS
from turtlelog.compare.tolerance_file import FORMAT
from turtlelog.measure import METRICS, SIGNALS, MetricKind, SignalKind

_TEXT = {"type": "string", "pattern": "\\S"}


def build_schema() -> dict[str, Any]:
    """Return the schema, draft 2020-12. Formulas are text to it: `turtlelog check` parses them."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "turtlelog specification and tolerance file",
        "type": "object",
        "required": ["format"],
        "anyOf": [{"required": [key]} for key in ("checks", "signals", "metrics")],
        "additionalProperties": False,
        "properties": {
            "format": {"const": FORMAT, "description": "Of this file."},
            "reference": {
                **_TEXT,
                "description": "Recording that tolerances are taken from, relative to this file.",
            },
            "alignment": {
                "enum": list(ALIGNMENTS),
                "description": "How runs and reference are brought together in time.",
            },
            "checks": {
                "type": "object",
                "additionalProperties": _build_check(),
                "description": "What is to hold, by a name of your own.",
            },
            "signals": _build_tolerances(SIGNALS, "signal"),
            "metrics": _build_tolerances(METRICS, "metric"),
        },
        "$defs": {
            "signal": _build_tolerance(has_time=True),
            "metric": _build_tolerance(has_time=False),
        },
    }


def _build_check() -> dict[str, Any]:
    return {
        "type": "object",
        "additionalProperties": False,
        "properties": {
            "expect": {**_TEXT, "description": "Formula over metrics and parameters."},
            "holds": {**_TEXT, "description": "Formula over signals and time."},
            "phase": {"enum": list(PHASES), "description": "Stretch that holds looks at."},
            "when": {**_TEXT, "description": "Otherwise the check is skipped."},
            "reason": {**_TEXT, "description": "Why so much and no more."},
            "observed": {
                "type": "boolean",
                "description": "The bound was read off a good run; nobody has thought about it.",
            },
        },
        "oneOf": [{"required": ["expect"]}, {"required": ["holds"]}],
        "dependentRequired": {"phase": ["holds"]},
    }


def _build_tolerances(kinds: Mapping[str, SignalKind | MetricKind], kind: str) -> dict[str, Any]:
    return {
        "type": "object",
        "additionalProperties": False,
        "properties": {
            name: {"$ref": f"#/$defs/{kind}", "description": f"[{found.unit}] {found.meaning}"}
            for name, found in kinds.items()
        },
    }


def _build_tolerance(*, has_time: bool) -> dict[str, Any]:
    number = {"type": "number", "minimum": 0}
    properties = {
        "abs": {**number, "description": "How far from the reference, in the unit of the name."},
        "rel": {**number, "maximum": 1, "description": "As a share of the reference."},
        "reason": {**_TEXT, "description": "Why so much and no more."},
    }
    if has_time:
        properties["time_s"] = {**number, "description": "How far in time [s]."}
    return {
        "type": "object",
        "required": ["reason"],
        "additionalProperties": False,
        "properties": properties,
    }
