"""The metrics of a recording as a row of a table."""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Any

import msgspec

from turtlelog.compare import order_ids
from turtlelog.errors import LibraryError, TurtlelogError
from turtlelog.log import ReadChoice, read_as_chosen
from turtlelog.measure import MeasureSettings, measure_run
from turtlelog.sweep.file_rows import ERROR
from turtlelog.sweep.recordings import RecordingTable
from turtlelog.sweep.row_columns import Cell, Key, Row

_TEXTS = (Key("name"), Key("source"), Key("stop_reason"), Key("notes"))
_STATUS = ".status"


@dataclass(frozen=True, slots=True, kw_only=True)
class _MeasureFile:
    settings: MeasureSettings
    only: tuple[str, ...] | None
    topics: ReadChoice

    def __call__(self, path: str) -> list[Row]:
        try:
            run = read_as_chosen(path, self.topics)
        except LibraryError:
            raise
        except TurtlelogError as err:
            return [{ERROR: str(err).removeprefix(f"{path}: ")}]
        notes = "; ".join(f"{name}: {text}" for name, text in run.notes.items())
        row: dict[Key, Cell] = dict(
            zip(_TEXTS, (run.name, run.source, run.stop_reason, notes or None), strict=True)
        )
        for name, metric in measure_run(run, self.settings, only=self.only).items():
            row[Key(name, "real", metric.unit)] = metric.value
            row[Key(f"{name}{_STATUS}")] = metric.status.value
        return [row]


def plan_metric_table(
    settings: MeasureSettings | None = None,
    *,
    only: Sequence[str] | None = None,
    topics: ReadChoice | None = None,
) -> RecordingTable:
    """Return what `tabulate_recordings` needs for a table with a row of metrics for each file.

    Args:
        settings: See `measure_run`.
        only: Ids and patterns; None: every metric.
        topics: Topics to read from third-party files.
    """
    settings, topics = settings or MeasureSettings(), topics or ReadChoice()
    chosen = None if only is None else tuple(only)
    return RecordingTable(
        kind="metrics",
        facts={
            "metrics": "all" if chosen is None else ",".join(chosen),
            "settings": describe_values(settings),
            "reading": describe_values(topics),
        },
        work=_MeasureFile(settings=settings, only=chosen, topics=topics),
        order=_order,
    )


def _order(keys: Set[Key], used: Set[Key]) -> list[Key]:
    """Return the columns of texts, then of each metric that a run has the value and the status."""
    ids = {key.name.removesuffix(_STATUS) for key in used if key.name.endswith(_STATUS)}
    values = {
        name: sorted(key for key in keys if key.name == name and key.type == "real") for name in ids
    }
    chosen = [*_TEXTS]
    for name in order_ids(sorted(ids)):
        chosen += [*values[name], Key(f"{name}{_STATUS}")]
    return chosen


def describe_values(values: Any) -> str:
    """Return settings as JSON, the same text for the same settings."""

    def describe(value: Any) -> Any:
        if isinstance(value, Mapping):
            return dict(value)
        return value.tolist() if hasattr(value, "tolist") else repr(value)

    return msgspec.json.encode(values, enc_hook=describe, order="deterministic").decode()
