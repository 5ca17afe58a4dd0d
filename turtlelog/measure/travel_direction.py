"""The direction in which a robot travels: at an angle to its heading, or commanded to the side.

A robot on two wheels, or a car, travels along its heading. A marker or sensor that is mounted at an
angle gives another heading. Speeds along this heading are too small by the cosine of the angle.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import format_short
from turtlelog.measure.breaks import measure_steps
from turtlelog.measure.rates import space_poses
from turtlelog.measure.reductions import compute_median, subtract_neighbours
from turtlelog.run import PoseColumns, Run, take_rows
from turtlelog.run.angles import subtract_headings

_OVER_S: Final = 0.5
"""Time over which a displacement is measured [s]: it is then larger than the noise of poses."""

_MOST_S: Final = 1.0
"""Longest displacement that counts [s]: a heading may turn by a full turn in a longer one."""

_MOST_TURN_RAD: Final = 1.0
"""Largest turn of a displacement [rad]; a larger one has no single direction."""

_LEAST_RAD: Final = math.radians(5.0)
"""Smallest angle that is reported [rad]: speeds along the heading are 0.4 % too small."""

_EXPLAINED: Final = 0.9
"""Share of the sideways motion that one angle must explain. A robot that slips in turns, or drives
sideways now and then, has no single angle."""

_FEWEST: Final = 10
"""Smallest number of displacements while the robot moves."""

_MOVING: Final = 0.1
"""Displacement as a share of the largest from which the robot moves."""

_LEFT: Final = 0.1
"""Share of the motion that must not go together with turning: on one circle, a marker beside the
robot's centre looks like a marker that is turned."""

_UNLIKE: Final = ("heading", "leaps")
"""Notes on headings that are computed from the motion, and on poses of two programs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TravelDirection:
    """The constant angle between a robot's heading and its direction of travel.

    Attributes:
        angle_rad: Direction of travel minus heading, in (-pi/2, pi/2) [rad]; positive to the left.
    """

    angle_rad: float

    @property
    def shortfall(self) -> float:
        """Share by which speeds along the heading are too small [1]."""
        return 1.0 - math.cos(self.angle_rad)

    def describe(self) -> str:
        """Return the angle and its side in words, and what it makes of speeds along the heading."""
        side = "left" if self.angle_rad > 0.0 else "right"
        return (
            f"the robot travels {abs(math.degrees(self.angle_rad)):.1f} deg to the {side} of its"
            f" heading; speeds along the heading are {100.0 * self.shortfall:.1f} % too small"
        )


def describe_travel(run: Run) -> dict[str, str]:
    """Return a note on the direction of travel, by name; empty if it is the heading."""
    found = find_travel_direction(run)
    return {} if found is None else {"travel": found.describe()}


def find_travel_direction(run: Run) -> TravelDirection | None:
    """Return the angle at which a robot travels beside its heading; None if there is no such angle.

    The robot may drive forward and backward. Sideways motion that goes with turning, of a point
    beside the robot's centre, does not count. There is no angle if sideways speeds are commanded,
    or if the robot is turtlesim.
    """
    if run.commands.lateral_speed_m_s.any() or run.poses.speed_m_s is not None:
        return None
    if any(name in run.notes for name in _UNLIKE):
        return None
    moved_m, turned_rad = _measure_displacements(run.poses)
    energy = float((moved_m**2).sum())
    sizes_m = np.hypot(moved_m[:, 0], moved_m[:, 1])
    if not energy or int((sizes_m > _MOVING * sizes_m.max()).sum()) < _FEWEST:
        return None
    turning = float(turned_rad @ turned_rad)
    if turning:
        moved_m = moved_m - np.outer(turned_rad, (turned_rad @ moved_m) / turning)
    (least, most), axes = np.linalg.eigh(moved_m.T @ moved_m)
    ahead, aside = axes[:, 1].tolist()
    angle_rad = math.atan(aside / ahead) if ahead else math.pi / 2.0
    unexplained = least / (least + most * math.sin(angle_rad) ** 2) if angle_rad else 1.0
    is_clear = most > _LEFT * energy and unexplained < 1.0 - _EXPLAINED
    if abs(angle_rad) < _LEAST_RAD or not is_clear:
        return None
    return TravelDirection(angle_rad=angle_rad)


def _measure_displacements(poses: PoseColumns) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return displacements along the mean heading and to its left [m], and turns [rad]."""
    time_s = poses.time_ns / 1e9
    if len(time_s) < 2:
        return np.zeros((0, 2)), np.zeros(0)
    rows = np.arange(
        0, len(time_s), math.ceil(_OVER_S / max(float(np.median(np.diff(time_s))), 1e-9))
    )
    step_m, apart_s = np.diff(poses.xy_m[rows], axis=0), np.diff(time_s[rows])
    heading_rad = poses.heading_rad[rows]
    turned_rad = np.asarray(subtract_headings(heading_rad[1:], heading_rad[:-1]))
    kept = (apart_s <= _MOST_S) & (np.abs(turned_rad) <= _MOST_TURN_RAD)
    middle_rad, step_m = (heading_rad[:-1] + turned_rad / 2.0)[kept], step_m[kept]
    cos, sin = np.cos(middle_rad), np.sin(middle_rad)
    ahead_m = step_m[:, 0] * cos + step_m[:, 1] * sin
    aside_m = step_m[:, 1] * cos - step_m[:, 0] * sin
    return np.column_stack([ahead_m, aside_m]), turned_rad[kept]


_CHORD_S: Final = 0.5
"""Time over which motion is split into ahead and aside [s]: in it, noise of poses hardly adds."""

_COMMANDED_M_S: Final = 0.01
"""Command to the side from which a robot counts as commanded sideways [m/s], as of rest."""


def describe_sideways(run: Run) -> str:
    """Return a clause on a robot that is commanded sideways; empty for other robots.

    Whether a robot moves sideways without such commands is not told: headings may be wrong.
    """
    most_m_s = float(np.abs(run.commands.lateral_speed_m_s).max(initial=0.0))
    if most_m_s < _COMMANDED_M_S:
        return ""
    commanded = f"commanded sideways, up to {format_short(most_m_s, 'm/s')}"
    if len(run.poses) < 2:
        return commanded
    spaced = space_poses(run)
    every = max(round(_CHORD_S / compute_median(subtract_neighbours(spaced.time_s))), 1)
    rows = np.append(spaced.rows[:-1:every], spaced.rows[-1])
    ahead_m, aside_m, _ = measure_steps(take_rows(run.poses, rows))
    aside, ahead = (format_short(float(np.abs(way).sum()), "m") for way in (aside_m, ahead_m))
    return f"{commanded}; it moves {aside} sideways, {ahead} ahead or back"
