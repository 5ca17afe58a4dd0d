"""What is drawn of a robot in a bag: measured rates without outliers, its path without jumps."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from turtlelog.charts.curves import Command, Curve, read_curve, select_rows
from turtlelog.charts.pose_gaps import list_breaking_gaps
from turtlelog.display import describe_count
from turtlelog.errors import ReplayError
from turtlelog.measure import find_outliers
from turtlelog.plants import LAGGED, find_plant
from turtlelog.replay.plant_ticks import find_breaks, read_motion
from turtlelog.run import Run
from turtlelog.run.loops import COMMAND_UNITS

Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredRate:
    """A measured rate without its outliers, and these.

    Attributes:
        command: Of which command it is the answer.
        curve: All other values.
        outliers: Those that would flatten every curve beside them; they stay in the data.
    """

    command: Command
    curve: Curve
    outliers: Curve

    def name_outliers(self) -> str:
        """Return the outliers in words, of several the largest; empty where there are none."""
        found = self.outliers
        if not len(found.values):
            return ""
        row = int(np.abs(found.values).argmax())
        text = f"{found.values[row]:.4g} {COMMAND_UNITS[self.command]} at {found.time_s[row]:.1f} s"
        count = len(found.values)
        return f"outlier {text}" if count == 1 else f"{describe_count(count, 'outlier')} to {text}"


def read_measured(run: Run, command: Command) -> MeasuredRate | None:
    """Return what a robot reports of `speed` or `turn_rate`; None where it reports nothing."""
    curve = read_curve(run, f"measured_{command}")
    if curve is None:
        return None
    outliers = find_outliers(curve.time_ns, curve.values)
    rest = np.delete(np.arange(len(curve.values)), outliers)
    return MeasuredRate(
        command=command,
        curve=part_curve(run, select_rows(curve, rest)),
        outliers=select_rows(curve, outliers),
    )


def part_path(run: Run) -> Values:
    """Return the positions of a run [m], shape (n, 2), with NaN before each break of its poses.

    Nobody drove from the pose before a reset or teleport to the one after it, and where a robot was
    while it sent no poses is not known.
    """
    return np.insert(run.poses.xy_m, find_break_rows(run), np.nan, axis=0)


def part_curve(run: Run, curve: Curve) -> Curve:
    """Return a curve with NaN before each break of the poses within which it has no row itself."""
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
    """Return the rows of poses before which curves break: at jumps, after a time without poses."""
    gaps = np.array([gap.row for gap in list_breaking_gaps(run)], dtype=np.int64)
    return np.unique(np.concatenate([find_jump_rows(run), gaps]))


def find_jump_rows(run: Run) -> NDArray[np.int64]:
    """Return the rows of the poses that a jump leads to, of turtlesim's without samples."""
    none = np.zeros(0, dtype=np.int64)
    if len(run.samples) or not is_turtlesim(run):
        return none
    try:
        jumps, _, _ = find_breaks(read_motion(run))
    except ReplayError:
        return none
    return np.asarray(np.searchsorted(run.poses.time_ns, [jump.at_ns for jump in jumps]))


def is_turtlesim(run: Run) -> bool:
    """Whether the poses are turtlesim's: it alone publishes the velocities that it applies.

    A controller's samples are taken to be of a turtle.
    """
    publishes = run.poses.speed_m_s is not None or len(run.samples) > 0
    return publishes and find_plant(run).name != LAGGED


def read_pace(run: Run, rows: NDArray[np.int64]) -> Values:
    """Return how fast a run is between some of its poses [m/s], shape (n - 1,).

    Of runs without samples it is what the robot reports, as the times of their poses jitter; and
    outliers are as fast as the fastest of all others.
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
    """Whether no run holds samples of a controller: poses, and at most commands, of any robot."""
    return not any(len(run.samples) for run in runs)
