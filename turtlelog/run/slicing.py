"""A segment of a run as a new run."""

import math
from dataclasses import replace
from numbers import Real
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import RunError
from turtlelog.run.columns import take_rows

if TYPE_CHECKING:
    from turtlelog.run.run import Run


def slice_run(run: "Run", *, start_ns: int | None = None, end_ns: int | None = None) -> "Run":
    """Return the rows of a run in [start_ns, end_ns]. The segment must contain a pose.

    Samples whose pose is outside the segment are dropped. The stop reason is dropped if the end is
    cut off. Times and sequence numbers do not change. If a row is missing, the parameters no longer
    determine the run.
    """
    start_ns = int(run.poses.time_ns[0]) if start_ns is None else start_ns
    end_ns = run.end_ns if end_ns is None else end_ns
    first = int(np.searchsorted(run.poses.time_ns, start_ns, side="left"))
    after = int(np.searchsorted(run.poses.time_ns, end_ns, side="right"))
    first = min(first, len(run.poses) - 1)
    after = max(after, first + 1)
    read = run.samples.pose_sequence
    kept = _select(run.samples.time_ns, start_ns, end_ns) & (read >= first) & (read < after)
    samples = take_rows(run.samples, kept)
    is_whole = first == 0 and end_ns >= run.end_ns
    return replace(
        run,
        scenario_is_complete=run.scenario_is_complete and is_whole,
        stop_reason=run.stop_reason if end_ns >= run.end_ns else None,
        poses=take_rows(run.poses, slice(first, after)),
        commands=take_rows(run.commands, _select(run.commands.time_ns, start_ns, end_ns)),
        samples=replace(samples, pose_sequence=samples.pose_sequence - first),
        events=tuple(event for event in run.events if start_ns <= event.time_ns <= end_ns),
    )


def locate_stretch(run: "Run", start_s: float | None, end_s: float | None) -> tuple[int, int]:
    """Convert a segment relative to the run's time zero to [start_ns, end_ns].

    Raises:
        RunError: If the segment is invalid or contains no pose.
    """
    for name, value in (("start_s", start_s), ("end_s", end_s)):
        if value is not None and not (isinstance(value, Real) and math.isfinite(value)):
            raise RunError(f"{name}: expected a time in s, found {value!r:.60}")
    poses_ns = run.poses.time_ns
    if not len(poses_ns):
        raise RunError("slice: expected a run with poses, found commands alone")
    start_ns = int(poses_ns[0]) if start_s is None else run.start_ns + round(start_s * 1e9)
    end_ns = run.end_ns if end_s is None else run.start_ns + round(end_s * 1e9)
    if start_s is not None and end_s is not None and end_s < start_s:
        raise RunError(f"end_s: expected start_s = {start_s:g} or later, found {end_s:g}")
    if not ((poses_ns >= start_ns) & (poses_ns <= end_ns)).any():
        first_s, last_s = ((int(time) - run.start_ns) / 1e9 for time in (poses_ns[0], poses_ns[-1]))
        found = f"{(start_ns - run.start_ns) / 1e9:g} to {(end_ns - run.start_ns) / 1e9:g} s"
        raise RunError(
            f"slice: expected a segment with poses, which are from {first_s:g} to {last_s:g} s,"
            f" found {found}"
        )
    return start_ns, end_ns


def _select(time_ns: NDArray[np.int64], start_ns: int, end_ns: int) -> NDArray[np.bool_]:
    return np.asarray((time_ns >= start_ns) & (time_ns <= end_ns))
