"""References: recordings, or metrics as `turtlelog metrics --json` prints them."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from turtlelog.errors import CheckError
from turtlelog.log import read_run, replace_when_complete, write_recording
from turtlelog.measure import METRICS, Metric, Status, measure_run
from turtlelog.run import Run


@dataclass(slots=True, kw_only=True)
class Reference:
    """A file that recordings are held to.

    Attributes:
        path: A recording, or metrics (.json).
        is_accepting: Whether `matches` writes the file anew instead of comparing.
        accepted: From which recordings it was written.
    """

    path: Path
    is_accepting: bool = False
    accepted: list[Path] = field(default_factory=list)

    def __repr__(self) -> str:
        return f"<reference {self.path}>"

    def load(self) -> Run | Mapping[str, Metric]:
        """Return what stands in the file.

        Raises:
            CheckError: Where it is not there, or holds no metrics.
            LogError: Where it holds no recording.
        """
        return load_reference(self.path)

    def accept(self, run: Run, source: Path) -> None:
        """Write the file from a run.

        Raises:
            CheckError: Where it was written from another one in the same session.
            LogError: Where it cannot be written.
        """
        others = [str(path) for path in self.accepted if path != source]
        if others:
            raise CheckError(
                f"{self.path}: expected one recording to accept, found {others[0]} and {source};"
                " a name with {stem} gives each its own reference"
            )
        self.path.parent.mkdir(parents=True, exist_ok=True)
        if self.path.suffix.lower() == ".json":
            with replace_when_complete(self.path) as part:
                part.write_text(format_metrics(run, source.name), encoding="utf-8")
        elif self.path.resolve() != source.resolve():
            write_recording(run, self.path)
        self.accepted.append(source)


def load_reference(path: Path) -> Run | Mapping[str, Metric]:
    """Return the run or the metrics in a file."""
    if not path.exists():
        raise CheckError(
            f"{path}: expected a reference, found no such file; --turtlelog-accept writes it"
        )
    if path.suffix.lower() == ".json":
        found = _parse_metrics(path)
        if found is not None:
            return found
    return read_run(path)


def format_metrics(run: Run, file: str) -> str:
    """Return the metrics of a run as `turtlelog metrics --json` prints them."""
    metrics = [
        {
            "id": metric.id,
            "value": metric.value,
            "unit": metric.unit,
            "status": metric.status.value,
            "reason": metric.reason or None,
            "at_s": metric.at_s,
        }
        for metric in measure_run(run).values()
    ]
    return json.dumps([{"file": file, "name": run.name, "metrics": metrics}], indent=2) + "\n"


def _parse_metrics(path: Path) -> Mapping[str, Metric] | None:
    """Return the metrics of a file; None where it is JSON of another kind: a log."""
    try:
        found: Any = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError):
        return None
    if isinstance(found, list) and len(found) == 1:
        found = found[0]
    if not isinstance(found, dict) or not isinstance(found.get("metrics"), list):
        return None
    metrics = [_parse_metric(entry, f"{path}: metrics[{i}]") for i, entry in _number(found)]
    if not metrics:
        raise CheckError(f"{path}: metrics: expected at least one, found none")
    return {metric.id: metric for metric in metrics}


def _number(found: dict[str, Any]) -> list[tuple[int, Any]]:
    return list(enumerate(found["metrics"]))


def _parse_metric(entry: Any, place: str) -> Metric:
    if not isinstance(entry, dict) or entry.get("id") not in METRICS:
        found = entry.get("id") if isinstance(entry, dict) else entry
        raise CheckError(f"{place}.id: expected the id of a metric, found {found!r}")
    unit, value, status = METRICS[entry["id"]].unit, entry.get("value"), entry.get("status")
    if entry.get("unit") != unit:
        raise CheckError(f"{place}.unit: expected {unit}, found {entry.get('unit')!r}")
    if status not in list(Status):
        raise CheckError(f"{place}.status: expected one of a metric, found {status!r}")
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    is_number = is_number and math.isfinite(float(value or 0))
    if (status == Status.OK) != is_number:
        raise CheckError(f"{place}.value: expected one that goes with {status}, found {value!r}")
    reason = entry.get("reason") or ""
    return Metric(id=entry["id"], value=value, unit=unit, status=Status(status), reason=str(reason))
