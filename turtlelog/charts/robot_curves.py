"""Curves of a robot in a bag: rates, paths, gaps, and steps of its commands."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.charts.curves import Command, Curve, Values, read_curve, select_curve_rows
from turtlelog.compare.robot_comparison import SHOWN_UNITS, Quantity
from turtlelog.display import describe_count
from turtlelog.errors import ReplayError
from turtlelog.measure import find_outliers
from turtlelog.measure.breaks import find_gaps
from turtlelog.plants import LAGGED, find_plant
from turtlelog.replay.recorded_motion import find_breaks, read_motion
from turtlelog.run import Run
from turtlelog.run.loops import COMMAND_UNITS


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredRate:
    """A measured rate without its outliers, and the outliers."""

    command: Command  # command that the rate responds to
    curve: Curve  # all other values
    outliers: Curve  # values that would flatten every other curve. The data keep these values

    def name_outliers(self) -> str:
        """Return text on the outliers, of several the largest; empty without outliers."""
        found = self.outliers
        if not len(found.values):
            return ""
        row = int(np.abs(found.values).argmax())
        text = f"{found.values[row]:.4g} {COMMAND_UNITS[self.command]} at {found.time_s[row]:.1f} s"
        count = len(found.values)
        return f"outlier {text}" if count == 1 else f"{describe_count(count, 'outlier')} to {text}"


def read_measured(run: Run, command: Command) -> MeasuredRate | None:
    """Return the `speed` or `turn_rate` that a robot reports; None without reports."""
    curve = read_curve(run, f"measured_{command}")
    if curve is None:
        return None
    outliers = find_outliers(curve.time_ns, curve.values)
    rest = np.delete(np.arange(len(curve.values)), outliers)
    return MeasuredRate(
        command=command,
        curve=part_curve(run, select_curve_rows(curve, rest)),
        outliers=select_curve_rows(curve, outliers),
    )


def part_path(run: Run) -> Values:
    """Return the positions of a run [m], shape (n, 2), with NaN before each break of its poses.

    The robot did not drive between the poses before and after a reset or teleport. The robot's
    position is unknown while it sent no poses.
    """
    return np.insert(run.poses.xy_m, find_break_rows(run), np.nan, axis=0)


def part_curve(run: Run, curve: Curve) -> Curve:
    """Return a curve with NaN before each break of the poses in which the curve has no row."""
    rows = find_break_rows(run)
    if not len(rows):
        return curve
    before_ns, after_ns = run.poses.time_ns[rows - 1], run.poses.time_ns[rows]
    places = np.searchsorted(curve.time_ns, after_ns)
    is_inside = (places > 0) & (places < len(curve.time_ns))
    is_bare = np.searchsorted(curve.time_ns, before_ns, side="right") == places
    kept = is_inside & is_bare
    time_ns = np.insert(curve.time_ns, places[kept], after_ns[kept])
    return replace(curve, time_ns=time_ns, values=np.insert(curve.values, places[kept], np.nan))


def find_break_rows(run: Run) -> NDArray[np.int64]:
    """Return the rows of poses before which curves break: at jumps, and after gaps."""
    least_ns = min(_find_least_ns(run), _LEAST_NS)
    gaps = [gap.row for gap in find_gaps(run) if gap.end_ns - gap.start_ns >= least_ns]
    return np.unique(np.array([*find_jump_rows(run), *gaps], dtype=np.int64))


def find_jump_rows(run: Run) -> NDArray[np.int64]:
    """Return the rows of poses after jumps, for turtlesim without samples."""
    none = np.zeros(0, dtype=np.int64)
    if len(run.samples) or not is_turtlesim(run):
        return none
    try:
        jumps, _, _ = find_breaks(read_motion(run))
    except ReplayError:
        return none
    return np.asarray(np.searchsorted(run.poses.time_ns, [jump.at_ns for jump in jumps]))


def is_turtlesim(run: Run) -> bool:
    """Return whether poses are those of turtlesim, which alone publishes applied velocities.

    A run with a controller's samples counts as turtlesim's.
    """
    publishes = run.poses.speed_m_s is not None or len(run.samples) > 0
    return publishes and find_plant(run).name != LAGGED


def read_pace(run: Run, rows: NDArray[np.int64]) -> Values:
    """Return the speed of a run between some of its poses [m/s], shape (n - 1,).

    For runs without samples, the reported speed is used, because the times of their poses jitter.
    Outliers are clipped to the largest of the other values.
    """
    poses = run.poses
    way_m, time_ns = np.diff(poses.xy_m[rows], axis=0), poses.time_ns[rows]
    pace = np.hypot(*way_m.T) / (np.diff(time_ns) / 1e9)
    if len(run.samples) or not len(pace):
        return np.asarray(pace)
    reported = poses.measured_speed_m_s if poses.speed_m_s is None else poses.speed_m_s
    if reported is not None:
        pace = np.abs(reported[rows][1:])
    rest = np.delete(pace, find_outliers(time_ns[1:], pace))
    return np.asarray(np.minimum(pace, rest.max()))


def lack_samples(runs: Sequence[Run]) -> bool:
    """Return whether no run has samples of a controller: only poses, and at most commands."""
    return not any(len(run.samples) for run in runs)


_LEAST_SHARE: Final = 0.01
"""Smallest visible gap as a share of a run's duration. In a column of 70 mm, a shorter gap is
narrower than a millimetre."""

_LEAST_NS: Final = 1_000_000_000
"""Length from which a gap always interrupts curves [ns], because a view can be zoomed. Shorter gaps
in a long run are single poses that a busy computer lost."""

_MOST_NAMED: Final = 5
"""Largest number of gaps with text, the longest gaps; more text would cover the curves."""


def list_seen_gaps(run: Run) -> list[tuple[float, float, str]]:
    """Return the longest gaps in the poses that a picture can show, in order of time.

    Returns:
        Start and end of each gap, from the first sample [s], and its length in words.
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


def label_error(quantity: Quantity) -> str:
    """Return the axis label of a predicted error: `position error [mm]`."""
    unit, _ = SHOWN_UNITS[quantity]
    return f"{quantity} error [{unit}]"


def tell_gap(runs: Sequence[Run]) -> str:
    """Return text on the longest gap in the poses of a single run; empty without a gap."""
    gaps = list_seen_gaps(runs[0]) if len(runs) == 1 else []
    return max(gaps, key=lambda gap: gap[1] - gap[0])[2] if gaps else ""


def _find_least_ns(run: Run) -> float:
    first_ns = [*run.poses.time_ns[:1].tolist(), run.start_ns][0]
    return _LEAST_SHARE * float(run.end_ns - first_ns)


_LARGE: Final = 0.2
"""Share of the largest change from which a change counts; noise and resolution are smaller."""

_LEAST_HELD_S: Final = 0.15
"""Time from which a held command counts as a level [s]; commands come at 10 Hz and more, with
jitter."""

_MOST: Final = 60
"""Largest number of changes that are drawn, the largest changes; more would be a grey block."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandChange:
    """A change of a command in one direction, at once or over several commands."""

    begin_s: float  # time of the change's first command [s]
    half_s: float  # time at which the command passes the middle between its levels [s]
    end_s: float  # start of the next change, or end of the commands [s]
    before: float  # level from which it changes
    after: float  # level to which it changes

    def scale(self, values: Values) -> Values:
        """Return values as the completed fraction of the change: 0 before the change, 1 after."""
        return (values - self.before) / (self.after - self.before)


def find_command_changes(command: Curve) -> list[CommandChange]:
    """Return the large changes of a command in order of time.

    Successive commands in one direction are one change. A level that is held for longer than the
    change so far separates two changes.
    """
    values = np.concatenate([[0.0], command.values])
    rows = np.flatnonzero(np.diff(values) != 0.0)
    if not len(rows):
        return []
    signs, times_s = np.sign(np.diff(values)[rows]), command.time_s[rows]
    is_first = np.ones(len(rows), dtype=bool)
    first_s = times_s[0]
    for number in range(1, len(rows)):
        pause_s = times_s[number] - times_s[number - 1]
        is_held = pause_s > max(times_s[number - 1] - first_s, _LEAST_HELD_S)
        is_first[number] = signs[number] != signs[number - 1] or is_held
        first_s = times_s[number] if is_first[number] else first_s
    firsts = np.flatnonzero(is_first)
    lasts = np.append(firsts[1:], len(rows)) - 1
    ends_s = np.append(times_s[firsts[1:]], command.time_s[-1])
    found = []
    for first, last, end_s in zip(firsts, lasts, ends_s, strict=True):
        before, after = float(values[rows[first]]), float(values[rows[last] + 1])
        own = values[rows[first : last + 1] + 1]
        half = int(np.argmax((own - before) / (after - before) >= 0.5))
        change = CommandChange(
            begin_s=float(times_s[first]),
            half_s=float(times_s[first + half]),
            end_s=float(end_s),
            before=before,
            after=after,
        )
        found.append(change)
    sizes = np.array([abs(one.after - one.before) for one in found])
    kept = [
        row
        for row in np.argsort(-sizes, kind="stable")[:_MOST]
        if sizes[row] >= _LARGE * sizes.max()
    ]
    return [found[row] for row in sorted(kept)]
