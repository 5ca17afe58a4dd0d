"""Times of the runs that each picture of a movie shows."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.charts.time_axes import TIMELINE, find_phase_zeros
from turtlelog.errors import ShowError
from turtlelog.run import Run

Values = NDArray[np.float64]

SHORTEST_S: Final = 1.0
"""Shortest movie [s]; shorter movies would be a picture."""

LONGEST_S: Final = {".mp4": 600.0, ".gif": 60.0}
"""Longest movie [s] by format. An .mp4 takes 3 s of work per second. A .gif is made from all
pictures at once, 22 MB per second."""

_STILL_S: Final = 1.5
"""Time without motion at the end [s], for reading the distances of the runs."""

_MOST_STILL: Final = 0.3
"""Largest share of this time in the movie."""

_SLOWEST: Final = 0.25
"""Slowest motion: a run of half a second takes two seconds, so that each pose is visible."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Film:
    """The times of a movie's pictures.

    Attributes:
        timeline: Timeline of the times.
        zeros_ns: Zero of the timeline in each run's own time [ns].
        time_s: Time of each picture on the timeline [s], shape (n,), increasing, then constant.
        driving: Number of pictures that show the runs driving.
        pace: Seconds of the runs per second of the movie.
    """

    timeline: str
    zeros_ns: tuple[int, ...]
    time_s: Values
    driving: int
    pace: float


def plan_film(
    runs: Sequence[Run], *, timeline: str, length_s: float | None, pictures_per_s: float
) -> Film:
    """Return the times of a movie's pictures, from the first pose of any run to the last pose.

    Args:
        runs: Runs, at least one.
        timeline: `sim_time`, from each run's first sample; or the timeline of a later phase, such
            as `translate_time`, from the start of this phase.
        length_s: Length of the movie [s]. Default: real time, up to 10 s.
        pictures_per_s: Picture rate [1/s].

    Raises:
        ShowError: If a run has no such timeline.
    """
    zeros_ns = tuple(_find_zero_ns(run, timeline) for run in runs)
    pairs = list(zip(runs, zeros_ns, strict=True))
    first_s = min((int(run.poses.time_ns[0]) - zero_ns) / 1e9 for run, zero_ns in pairs)
    last_s = max((int(run.poses.time_ns[-1]) - zero_ns) / 1e9 for run, zero_ns in pairs)
    whole_s = _choose_length(last_s - first_s) if length_s is None else length_s
    still_s = min(_STILL_S, _MOST_STILL * whole_s)
    driving = max(round((whole_s - still_s) * pictures_per_s), 2)
    still = max(round(still_s * pictures_per_s), 1)
    moments = np.linspace(first_s, last_s, driving)
    return Film(
        timeline=timeline,
        zeros_ns=zeros_ns,
        time_s=np.append(moments, np.full(still, last_s)),
        driving=driving,
        pace=(last_s - first_s) * pictures_per_s / driving,
    )


def _choose_length(span_s: float) -> float:
    """Return the default length of a movie [s]: real time, within limits."""
    return float(np.clip(span_s + _STILL_S, min(span_s / _SLOWEST + _STILL_S, 3.0), 10.0))


def _find_zero_ns(run: Run, timeline: str) -> int:
    if timeline == TIMELINE:
        return run.start_ns
    zeros_ns = find_phase_zeros(run)
    if timeline not in zeros_ns:
        known = ", ".join([TIMELINE, *zeros_ns])
        raise ShowError(f"timeline: {run.name}: expected one of {known}, found {timeline!r}")
    return zeros_ns[timeline]
