"""What commands print: results to stdout, notes to stderr."""

import json
import math
import os
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from turtlelog import Metric


def print_text(text: str) -> None:
    """Print a result."""
    sys.stdout.write(text.rstrip("\n") + "\n")


def print_note(text: str) -> None:
    """Print progress or a note."""
    sys.stderr.write(text + "\n")
    sys.stderr.flush()


def print_error(text: str) -> None:
    """Print an error in one line."""
    print_note(f"turtlelog: error: {' '.join(text.split())}")


def print_json(value: Any) -> None:
    """Print one JSON value and nothing else; what is not finite becomes null."""
    sys.stdout.write(json.dumps(_make_finite(value), indent=2, allow_nan=False) + "\n")


def describe_metrics(metrics: "Mapping[str, Metric]") -> list[dict[str, Any]]:
    """Return metrics as the `metrics` list of JSON answers."""
    return [
        {
            "id": metric.id,
            "value": metric.value,
            "unit": metric.unit,
            "status": metric.status.value,
            "reason": metric.reason or None,
        }
        for metric in metrics.values()
    ]


def find_command_name() -> str:
    """Return how a user calls turtlelog again from here."""
    if "UV_RUN_RECURSION_DEPTH" in os.environ:
        return "uv run turtlelog"
    if shutil.which("turtlelog"):
        return "turtlelog"
    python = Path(sys.executable)
    if python.is_relative_to(Path.cwd()):
        python = python.relative_to(Path.cwd())
    return f"{python} -m turtlelog"


def _make_finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _make_finite(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_make_finite(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
