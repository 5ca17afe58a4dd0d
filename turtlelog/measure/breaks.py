"""Breaks in the poses of any robot: segments without poses, and steps that it cannot have made.

For turtlesim, whose poses contain the applied command, a replay through the plant shows more.

Between two poses a robot moves about as far as just before and just after. A correction of its pose
adds a step that neither neighbouring step has: the excess. This holds at any speed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from turtlelog.display import describe_count, join_words
from turtlelog.measure.corrections import ACCELERATION, LATE, find_corrections, measure_steps
from turtlelog.measure.motion import GAP_STEPS
from turtlelog.measure.rates import NEIGHBOURS
from turtlelog.measure.reductions import compute_median
from turtlelog.run import PoseColumns, Run, take_rows

Values = NDArray[np.float64]

_USUAL: Final = 0.95
"""Share of time steps that count as usual: some robots publish at two rates, or only while they
move."""

_FAST: Final = 3.0
"""Ratio to the greatest lasting rate from which a step is a jump. A robot near that rate, and a
pose that is late by a whole step, together give a ratio of 2."""

_STRAYS: Final = 0.05
"""Largest share of steps that lead out and back at once and count as stray poses. Noise and a
second program lead out and back all the time."""

_TOLD: Final = 0.1
"""Share of a jump from which the distance driven meanwhile is mentioned."""

_TURNED_RAD: Final = 0.1
"""Turn of a jump from which the displacement is measured along the heading before it, because there
is no mean heading. At this turn, both directions differ by 3 deg, 5 % of the displacement to the
side."""

_ROUNDING: Final = 1e-5
"""Largest effect of the 32-bit rounding of two poses on a step [m, rad]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseGap:
    """A segment of time whose poses are missing: after start_ns, before end_ns.

    Attributes:
        row: Row of the first pose after the gap.
        start_ns: Time of the last pose before the gap [ns].
        end_ns: Time of the first pose after the gap [ns].
        usual_ns: Usual time between two poses [ns].
    """

    row: int
    start_ns: int
    end_ns: int
    usual_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseJump:
    """A step between two poses that the robot cannot have driven.

    Attributes:
        row: Row of the first pose after the jump.
        time_ns: Time of the first pose after the jump [ns].
        moved_m: Displacement along the heading, backward negative [m]; to the east if headings are
            courses.
        aside_m: Displacement to the left [m]; to the north if headings are courses.
        turned_rad: Turn, counter-clockwise positive [rad].
        excess_m: Distance beyond that of the neighbouring steps [m].
        excess_rad: Turn beyond that of the neighbouring steps [rad].
    """

    row: int
    time_ns: int
    moved_m: float
    aside_m: float
    turned_rad: float
    excess_m: float
    excess_rad: float


def find_gaps(run: Run) -> tuple[PoseGap, ...]:
    """Return the segments of time without poses, each longer than four usual steps."""
    time_ns = run.poses.time_ns
    step_ns = np.diff(time_ns)
    if not len(step_ns):
        return ()
    usual_ns = float(np.quantile(step_ns, _USUAL))
    return tuple(
        PoseGap(
            row=row + 1,
            start_ns=int(time_ns[row]),
            end_ns=int(time_ns[row + 1]),
            usual_ns=int(compute_median(step_ns)),
        )
        for row in np.flatnonzero(step_ns > GAP_STEPS * usual_ns).tolist()
    )


def find_jumps(run: Run) -> tuple[PoseJump, ...]:
    """Return the steps from pose to pose that the robot cannot have driven.

    A step is a jump if it is far beyond the greatest rate of the robot (two steps if a pose
    strays), or a correction of the pose (`find_corrections`).
    """
    poses = run.poses
    if _has_courses(run):  # a course turns with the positions, and is not independent
        poses = replace(poses, heading_rad=np.zeros(len(poses)))
    rows = _find_changing_rows(poses)
    if len(rows) < len(poses):
        is_kept = np.zeros(len(poses), dtype=np.bool_)
        is_kept[rows] = True
        poses = take_rows(poses, is_kept)
    if len(poses) < 3:
        return ()
    steps = measure_steps(poses)
    step_ns = np.diff(poses.time_ns)
    usual_ns = np.asarray(np.maximum(step_ns, compute_median(step_ns)))
    moved, turned = np.hypot(steps[0], steps[1]), np.abs(steps[2])
    applied = [poses.speed_m_s, poses.turn_rate_rad_s]
    is_jump = np.zeros(len(step_ns), dtype=bool)
    if poses.speed_m_s is None:
        is_jump |= find_corrections(poses)
    together = np.hypot(*(poses.xy_m[2:] - poses.xy_m[:-2]).T), np.abs(steps[2][1:] + steps[2][:-1])
    ways = zip((moved, turned), together, applied, ACCELERATION, strict=True)
    for way, net, seen, acceleration in ways:
        is_jump |= _find_far_steps(way, net, usual_ns, seen=seen, acceleration=acceleration)
    beyond_ahead_m, beyond_aside_m, beyond_turned_rad = _find_excess_steps(poses)
    beyond_m, beyond_rad = np.hypot(beyond_ahead_m, beyond_aside_m), np.abs(beyond_turned_rad)
    for row in np.flatnonzero(is_jump & (beyond_rad > _TURNED_RAD)).tolist():
        # The axes turned with the robot, so only the size of the displacement is compared.
        near = moved[row - NEIGHBOURS : row + NEIGHBOURS + 1]
        beyond_m[row] = abs(moved[row] - np.median(near))
    steps = _face_before(steps, beyond_turned_rad)
    # At either end nothing tells what of a step is driving.
    for beyond, whole in ((beyond_m, moved), (beyond_rad, turned)):
        beyond[:NEIGHBOURS], beyond[-NEIGHBOURS:] = whole[:NEIGHBOURS], whole[-NEIGHBOURS:]
    return tuple(
        PoseJump(
            row=int(rows[row + 1]),
            time_ns=int(poses.time_ns[row + 1]),
            moved_m=float(steps[0][row]),
            aside_m=float(steps[1][row]),
            turned_rad=float(steps[2][row]),
            excess_m=float(beyond_m[row]),
            excess_rad=float(beyond_rad[row]),
        )
        for row in np.flatnonzero(is_jump).tolist()
    )


def _has_courses(run: Run) -> bool:
    """Return whether headings are courses over ground, as of a satellite receiver."""
    return "heading" in run.notes


def _face_before(
    steps: tuple[Values, Values, Values], beyond_rad: Values
) -> tuple[Values, Values, Values]:
    """Return jumps that include a turn, with the displacement along the heading before the jump."""
    off_rad = np.where(np.abs(beyond_rad) > _TURNED_RAD, 0.5 * beyond_rad, 0.0)
    cos, sin = np.cos(off_rad), np.sin(off_rad)
    ahead_m, aside_m, turned_rad = steps
    return ahead_m * cos - aside_m * sin, ahead_m * sin + aside_m * cos, turned_rad


def describe_breaks(run: Run) -> dict[str, str]:
    """Return a sentence on `jumps` and one on `gaps`, for each that is not empty."""
    found = {}
    if jumps := find_jumps(run):
        found["jumps"] = _describe_jumps(jumps, run.start_ns, is_north=_has_courses(run))
    if gaps := find_gaps(run):
        longest = max(gaps, key=lambda gap: gap.end_ns - gap.start_ns)
        which = "" if len(gaps) == 1 else "the longest "
        length_s = (longest.end_ns - longest.start_ns) / 1e9
        found["gaps"] = (
            f"{describe_count(len(gaps), 'gap')}, {which}{length_s:.2f} s without a pose from"
            f" {(longest.start_ns - run.start_ns) / 1e9:.1f} s; usual are"
            f" {longest.usual_ns / 1e6:.0f} ms"
        )
    return found


def _describe_jumps(jumps: Sequence[PoseJump], start_ns: int, *, is_north: bool) -> str:
    largest = max(jumps, key=lambda jump: (jump.excess_m, jump.excess_rad))
    which = "" if len(jumps) == 1 else "the largest "
    names = ("m east", "m west", "m north", "m south") if is_north else _WAYS
    signed = (largest.moved_m, -largest.moved_m, largest.aside_m, -largest.aside_m)
    way_m = float(np.hypot(largest.moved_m, largest.aside_m))
    least_m = _ROUNDING
    beyond_s2 = largest.excess_m / ACCELERATION[0], largest.excess_rad / ACCELERATION[1]
    if largest.excess_m <= _TOLD * way_m and beyond_s2[0] < beyond_s2[1]:
        least_m = np.inf  # the displacement has no meaning if the heading jumps
    parts = [f"{way:.3g} {name}" for name, way in zip(names, signed, strict=True) if way > least_m]
    if abs(largest.turned_rad) > _ROUNDING:
        parts.append(f"{np.degrees(largest.turned_rad):+.3g} deg")
    at_s = (largest.time_ns - start_ns) / 1e9
    beyond = ""
    if abs(largest.excess_m - way_m) > _TOLD * way_m and np.isfinite(least_m):
        beyond = f", {largest.excess_m:.3g} m more than it drove"
    count = describe_count(len(jumps), "jump")
    return f"{count}, {which}{join_words(parts)} at {at_s:.1f} s{beyond}"


_WAYS: Final = ("m ahead", "m back", "m to the left", "m to the right")


def _find_far_steps(
    way: Values, net: Values, usual_ns: Values, *, seen: Values | None, acceleration: float
) -> NDArray[np.bool_]:
    """Return which steps are far beyond the greatest rate that lasts for two of them.

    Args:
        way: Magnitude of each step [m or rad], shape (n,).
        net: Magnitude of each two steps together, shape (n - 1,).
        usual_ns: Time that each step takes, or more [ns], shape (n,).
        seen: Rates applied by the plant [m/s or rad/s]; None if unknown.
        acceleration: Rate that the robot reaches from rest in 1 s [m/s^2 or rad/s^2].
    """
    both = np.minimum(way[1:], way[:-1])
    # A stray pose gives two steps, out and back, which together lead no further.
    for lasting in (np.minimum(both, net), both):
        rate = float((lasting / usual_ns[1:]).max()) * 1e9
        rate = rate if seen is None else max(rate, float(np.abs(seen).max()))
        reached = np.maximum(rate, acceleration * usual_ns / 1e9)
        is_far = np.asarray(way > _FAST * reached * usual_ns / 1e9 + _ROUNDING)
        if is_far.mean() <= _STRAYS:
            break
    return is_far


def _find_excess_steps(poses: PoseColumns) -> tuple[Values, Values, Values]:
    """Return the excess of steps over their neighbours: ahead and aside [m], turned [rad]."""
    steps = measure_steps(poses)
    step_ns = np.diff(poses.time_ns)
    if len(step_ns) <= 2 * NEIGHBOURS:
        ahead_m, aside_m, turned_rad = (np.zeros(len(step_ns)) for _ in steps)
        return ahead_m, aside_m, turned_rad
    is_late = step_ns > LATE * compute_median(step_ns)
    ahead_m, aside_m, turned_rad = (_find_excess(step, step_ns, is_late) for step in steps)
    return ahead_m, aside_m, turned_rad


def _find_changing_rows(poses: PoseColumns) -> NDArray[np.int64]:
    """Return the rows of poses that differ from the previous pose, if most poses repeat it.

    Some programs publish each pose several times. In other recordings, a repeated pose shows that
    the robot is at rest, and it counts.
    """
    every = np.arange(len(poses))
    moved = (np.diff(poses.xy_m, axis=0) != 0.0).any(axis=1) | (np.diff(poses.heading_rad) != 0.0)
    changing = np.flatnonzero(moved) + 1
    if len(changing) < 2 or compute_median(np.diff(changing)) < 2:
        return every
    return np.concatenate([[0], changing])


def _find_excess(step: Values, step_ns: NDArray[np.int64], is_late: NDArray[np.bool_]) -> Values:
    """Return by how much each step exceeds the median rate of its neighbours; 0 at both ends.

    For steps with lost poses, the excess is the part that neither a rate of the neighbours nor a
    stop explains.
    """
    windows = sliding_window_view(step / step_ns, 2 * NEIGHBOURS + 1)
    near = np.delete(windows, NEIGHBOURS, axis=1)
    inside = slice(NEIGHBOURS, -NEIGHBOURS)
    way, took_ns = step[inside], step_ns[inside]
    low = np.minimum(near.min(axis=1), 0.0) * took_ns
    high = np.maximum(near.max(axis=1), 0.0) * took_ns
    excess = np.zeros(len(step))
    plain = way - np.median(near, axis=1) * took_ns
    excess[inside] = np.where(is_late[inside], way - np.clip(way, low, high), plain)
    return excess
