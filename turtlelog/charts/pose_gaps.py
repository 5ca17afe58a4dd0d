"""Stretches without poses, as pictures show them: curves break there, and words tell how long."""

from typing import Final

from turtlelog.measure.breaks import PoseGap, find_gaps
from turtlelog.run import Run

_LEAST_SHARE: Final = 0.01
"""Of the duration of a run: in a column of 70 mm a shorter gap is below a millimetre wide."""

_LEAST_NS: Final = 1_000_000_000
"""From here on curves break whatever their length: a view can be zoomed. Shorter gaps of a long run
are single poses that a busy computer lost."""

_MOST_NAMED: Final = 5
"""Words for more would cover the curves: the longest ones have them."""


def list_breaking_gaps(run: Run) -> list[PoseGap]:
    """Return the stretches without poses at which curves break."""
    least_ns = min(_find_least_ns(run), _LEAST_NS)
    return [gap for gap in find_gaps(run) if gap.end_ns - gap.start_ns >= least_ns]


def list_seen_gaps(run: Run) -> list[tuple[float, float, str]]:
    """Return the longest stretches without poses that a picture has room to show, in order of time.

    Returns:
        From when to when each lasts, from the first sample [s], and its length in words.
    """
    least_ns = _find_least_ns(run)
    gaps = [gap for gap in find_gaps(run) if gap.end_ns - gap.start_ns >= least_ns]
    longest = sorted(gaps, key=lambda gap: gap.start_ns - gap.end_ns)[:_MOST_NAMED]
    return [
        (
            (gap.start_ns - run.start_ns) / 1e9,
            (gap.end_ns - run.start_ns) / 1e9,
            f"{(gap.end_ns - gap.start_ns) / 1e9:.2g} s without poses",
        )
        for gap in sorted(longest, key=lambda gap: gap.start_ns)
    ]


def _find_least_ns(run: Run) -> float:
    first_ns = [*run.poses.time_ns[:1].tolist(), run.start_ns][0]
    return _LEAST_SHARE * float(run.end_ns - first_ns)
