"""What stands in the view of a failed check, read back."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rerun.chunk import RrdReader


@dataclass(frozen=True, slots=True, kw_only=True)
class Mark:
    """Where a .rrd opens, the mark in its plane, and what it says."""

    cursor_s: tuple[float, float]
    label: str
    xy_m: tuple[float, float]
    message: str


def read_mark(rrd: Path) -> Mark:
    reader = RrdReader(rrd)
    layout = _read_columns(reader.stream(store=reader.blueprints()[0]))
    plane = _read_columns(reader.stream().filter(content="/plane/violation"))
    document = _read_columns(reader.stream().filter(content="/documents/Violation"))
    (stretch,) = layout["TimePanelBlueprint:time_selection"]
    return Mark(
        cursor_s=(stretch["min"] / 1e9, stretch["max"] / 1e9),
        label=plane["Points2D:labels"][0],
        xy_m=tuple(plane["Points2D:positions"][0]),
        message=document["TextDocument:text"][0],
    )


def _read_columns(chunks: Any) -> dict[str, Any]:
    batches = [chunk.to_record_batch() for chunk in chunks]
    return {
        name: column.to_pylist()[0]
        for batch in batches
        for name, column in zip(batch.schema.names, batch.columns, strict=True)
        if ":" in name
    }
