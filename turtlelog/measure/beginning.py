"""The beginning of a loop's stretch as a run of its own, for what costs too much on a long one."""

from dataclasses import fields, replace
from typing import Final, TypeVar

import numpy as np

from turtlelog.loops import ControlLoop
from turtlelog.measure.response import find_loop_samples
from turtlelog.run import PoseColumns, Run, SampleColumns

_EARLIER_SAMPLES: Final = 1000
"""Samples before the stretch that are kept: more than can still wait in any queue."""

_Columns = TypeVar("_Columns", PoseColumns, SampleColumns)


def take_beginning(run: Run, loop: ControlLoop, most_samples: int) -> Run:
    """Return a run with no more than that many samples of a loop, and few before it.

    A run that is no longer than that comes back as it is.
    """
    samples = run.samples
    if len(samples) <= most_samples:
        return run
    stretch = find_loop_samples(run, loop)
    first = 0 if stretch is None else stretch.start
    rows = slice(max(first - _EARLIER_SAMPLES, 0), first + most_samples)
    read = samples.pose_sequence[rows]
    poses = slice(int(read.min()), int(read.max()) + 1)
    kept = _slice(samples, rows)
    return replace(
        run,
        poses=_slice(run.poses, poses),
        samples=replace(kept, pose_sequence=np.asarray(read - poses.start)),
    )


def _slice(columns: _Columns, rows: slice) -> _Columns:
    values = {field.name: getattr(columns, field.name) for field in fields(columns)}
    return replace(
        columns, **{name: found[rows] for name, found in values.items() if found is not None}
    )
