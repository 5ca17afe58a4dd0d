"""What a failure says; loaded when there is one."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from turtlelog.check import CheckResult, write_artifacts
from turtlelog.check.metric_value import MIRRORED, MetricValue
from turtlelog.errors import TurtlelogError

if TYPE_CHECKING:
    from turtlelog.check.recording import Recording


def explain_comparison(operator: str, left: object, right: object) -> list[str] | None:
    """Return the head of the message of a comparison; the section below says all."""
    value = left if isinstance(left, MetricValue) else right
    other = right if value is left else left
    if not isinstance(value, MetricValue) or value.value is None or operator not in MIRRORED:
        return None
    if isinstance(other, MetricValue):
        other = other.value
    if isinstance(other, bool) or not isinstance(other, int | float):
        return None
    result = value.judge(operator if value is left else MIRRORED[operator], float(other))
    return [
        f"{value!r} {operator} {other:g}" if value is left else f"{other:g} {operator} {value!r}",
        f"{result.check} of {result.file}: expected {result.expected}",
    ]


def explain_failures(recording: "Recording", results: Sequence[CheckResult]) -> list[str]:
    """Return all there is to say of the failed checks on a recording."""
    try:
        return recording.describe(*results)
    except TurtlelogError as err:
        return [f"{recording.file}: {err}"]


def keep_artifacts(
    recording: "Recording", results: Sequence[CheckResult], folder: Path, *, prefix: str
) -> list[str]:
    """Write what there is to look at of the first violation, and say where, or what went wrong."""
    dated = [result for result in results if result.first_violation_s is not None]
    result = min(dated, key=lambda found: found.first_violation_s or 0.0, default=results[0])
    try:
        found = write_artifacts(recording.run, result, folder, prefix=prefix)
    except (TurtlelogError, OSError) as err:
        return [f"artifacts: {err}"]
    return [*(f"wrote {path}" for path in found.files), *found.notes]
