"""The JSON Schema of specification files, for editors."""

from typing import Any

from turtlelog.check.spec_file import FORMAT
from turtlelog.compare import ALIGNMENTS
from turtlelog.loops import DONE, NAME_PATTERN, RESERVED, STATE_PATTERN
from turtlelog.measure import ANY_LOOP, METRICS, SIGNALS

_TEXT = {"type": "string", "pattern": "\\S"}

_LOOP = f"(?!(?:{'|'.join(sorted(RESERVED))})[.]){NAME_PATTERN}"
"""Which loops and phases there are, a run's law says."""


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
                "type": "string",
                "pattern": f"^(?:{'|'.join(ALIGNMENTS).replace('NAME', NAME_PATTERN)})$",
                "description": "How runs and reference are brought together in time.",
            },
            "checks": {
                "type": "object",
                "additionalProperties": _build_check(),
                "description": "What is to hold, by a name of your own.",
            },
            "signals": _build_signals(),
            "metrics": _build_metrics(),
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
            "phase": {
                "type": "string",
                "pattern": f"^(?!{DONE}$){NAME_PATTERN}$",
                "description": "Stretch that holds looks at: a phase of the law, or pause.",
            },
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


def _build_signals() -> dict[str, Any]:
    """Return the schema of signals by name; any law may have states of its own."""
    return {
        "type": "object",
        "additionalProperties": False,
        "properties": {
            name: _describe("signal", found.unit, found.meaning) for name, found in SIGNALS.items()
        },
        "patternProperties": {f"^{STATE_PATTERN}$": {"$ref": "#/$defs/signal"}},
    }


def _build_metrics() -> dict[str, Any]:
    """Return the schema of metrics by id, those of a loop as of any law's."""
    described = {
        name: _describe("metric", found.unit, found.meaning) for name, found in METRICS.items()
    }
    patterns = {name: name.partition(f"{ANY_LOOP}.")[2] for name in METRICS if ANY_LOOP in name}
    return {
        "type": "object",
        "additionalProperties": False,
        "properties": {name: found for name, found in described.items() if name not in patterns},
        "patternProperties": {
            f"^{_LOOP}[.]{plain}$": described[name] for name, plain in patterns.items()
        },
    }


def _describe(kind: str, unit: str, meaning: str) -> dict[str, Any]:
    return {"$ref": f"#/$defs/{kind}", "description": f"[{unit}] {meaning}"}


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
