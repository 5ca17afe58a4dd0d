"""How far a run is from the path of a reference."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from turtlelog.compare.alignment import align_runs
from turtlelog.compare.tube import lay_grid, read_rows
from turtlelog.measure import find_signal
from turtlelog.measure.path import compute_path_distances
from turtlelog.measure.step_response import compute_rms
from turtlelog.run import Run

_MOST_POINTS: Final = 20_000
"""Points of a path that distances are taken from: more take minutes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PathDeviation:
    """How far a run is from where a reference was, over the segment that both cover.

    Attributes:
        largest_m: Largest distance from the nearest point of the reference's path [m].
        largest_at_s: When, on the common clock [s].
        rms_m: Root of the mean square over time of that distance [m].
        largest_apart_m: Largest distance from where the reference was at the same time [m].
        largest_apart_at_s: When [s].
        rms_apart_m: Root of the mean square over time of that distance [m].
    """

    largest_m: float
    largest_at_s: float
    rms_m: float
    largest_apart_m: float
    largest_apart_at_s: float
    rms_apart_m: float


def measure_path_error(
    reference: Run, run: Run, *, alignment: str = "first_sample"
) -> PathDeviation:
    """Return how far a run is from a reference's path, and from the reference at equal times.

    Args:
        reference: The line through its poses is the path; of more than 20,000 every n-th.
        run: The other.
        alignment: As in `compare_runs`.

    Raises:
        CompareError: As `compare_runs`.
    """
    clock = align_runs(reference, run, alignment)
    columns = []
    for name in ("x", "y"):
        theirs, ours = (find_signal(who, name) for who in (reference, run))
        assert theirs is not None
        assert ours is not None
        placed = clock.place_signal(theirs, reference), clock.place_signal(ours, run)
        grid = lay_grid(placed[0].time_ns, placed[1].time_ns, clock.span)
        columns.append([read_rows(one, grid).values for one in placed])
    theirs_m, ours_m = (np.column_stack(pair) for pair in zip(*columns, strict=True))
    at_s = np.array([clock.read_ns(int(unit)) for unit in grid.at]) / 1e9
    path_m = reference.poses.xy_m[:: -(-len(reference.poses) // _MOST_POINTS)]
    path_m = np.concatenate([path_m, reference.poses.xy_m[-1:]])
    beside = compute_path_distances(ours_m, path_m)
    apart = np.hypot(*(ours_m - theirs_m).T)
    step_s = np.diff(at_s)
    return PathDeviation(
        largest_m=float(beside.max()),
        largest_at_s=float(at_s[beside.argmax()]),
        rms_m=compute_rms(step_s, beside, None),
        largest_apart_m=float(apart.max()),
        largest_apart_at_s=float(at_s[apart.argmax()]),
        rms_apart_m=compute_rms(step_s, apart, None),
    )
