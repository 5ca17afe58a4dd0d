"""Messages of failures. This module is loaded only when a test fails."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from turtlelog.check import ArtifactWriter, CheckResult
from turtlelog.check.recorded_metric import RecordedMetric
from turtlelog.errors import TurtlelogError
from turtlelog.escapes import escape_controls
from turtlelog.measure import MIRRORED, Metric

if TYPE_CHECKING:
    from turtlelog.check.recording_fixture import Recording


def explain_comparison(operator: str, left: object, right: object) -> list[str] | None:
    """Return the first lines of the message of a comparison; the section below has the details."""
    watched = [one for one in (left, right) if isinstance(one, Metric) and one.watch is not None]
    if not watched or operator not in MIRRORED:
        return None
    metric, watch = watched[0], watched[0].watch
    asked, other = (operator, right) if metric is left else (MIRRORED[operator], left)
    if not isinstance(watch, RecordedMetric):
        return None
    try:
        result = watch.judge(metric, asked, other)
    except TurtlelogError:
        return None
    lines = (
        f"{left!r} {operator} {right!r}",
        f"{result.check} of {result.file}: expected {result.expected}",
    )
    return [escape_controls(line) for line in lines]


def list_failure_lines(
    recording: "Recording", results: Sequence[CheckResult], *, explains: bool
) -> list[str]:
    """Return the complete message for failed checks, with the reason why the recording differs."""
    try:
        if explains:
            results = recording.explain_failures(results)
        return recording.describe(*results)
    except TurtlelogError as err:
        return [f"{recording.file}: {err}"]


def keep_artifacts(
    recording: "Recording", results: Sequence[CheckResult], writer: ArtifactWriter, *, prefix: str
) -> list[str]:
    """Write files for the first violation; return lines with their names, or with errors."""
    dated = [result for result in results if result.first_violation_s is not None]
    result = min(dated, key=lambda found: found.first_violation_s or 0.0, default=results[0])
    try:
        found = writer.write(recording.run, result, prefix=prefix)
    except (TurtlelogError, OSError) as err:
        return [f"artifacts: {err}"]
    lines = [*(f"wrote {path}" for path in found.files), *found.notes]
    return [escape_controls(line) for line in lines]
