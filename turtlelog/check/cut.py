"""A stretch of a run as a run of its own."""

from dataclasses import fields, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from turtlelog.run import CommandColumns, PoseColumns, Run, SampleColumns

Columns = TypeVar("Columns", PoseColumns, CommandColumns, SampleColumns)


def cut_run(run: Run, *, start_ns: int | None = None, end_ns: int | None = None) -> Run:
    """Return the rows of a run in [start_ns, end_ns]; at least one pose stays.

    Samples whose pose is cut off are cut off with it. Times stay as they are.
    """
    start_ns = run.poses.time_ns[0] if start_ns is None else start_ns
    end_ns = run.end_ns if end_ns is None else end_ns
    first = int(np.searchsorted(run.poses.time_ns, start_ns, side="left"))
    after = int(np.searchsorted(run.poses.time_ns, end_ns, side="right"))
    first = min(first, len(run.poses) - 1)
    after = max(after, first + 1)
    read = run.samples.pose_sequence
    kept = _select(run.samples.time_ns, start_ns, end_ns) & (read >= first) & (read < after)
    samples = _take(run.samples, kept)
    return replace(
        run,
        poses=_take(run.poses, slice(first, after)),
        commands=_take(run.commands, _select(run.commands.time_ns, start_ns, end_ns)),
        samples=replace(samples, pose_sequence=samples.pose_sequence - first),
        events=tuple(event for event in run.events if start_ns <= event.time_ns <= end_ns),
    )


def _select(time_ns: NDArray[np.int64], start_ns: int, end_ns: int) -> NDArray[np.bool_]:
    return np.asarray((time_ns >= start_ns) & (time_ns <= end_ns))


def _take(columns: Columns, rows: slice | NDArray[np.bool_]) -> Columns:
    taken = {
        field.name: values[rows]
        for field in fields(columns)
        if (values := getattr(columns, field.name)) is not None
    }
    return replace(columns, **taken)
