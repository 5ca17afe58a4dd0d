"""Breaks in the poses of any robot: segments without poses, and steps that it cannot have made.

For turtlesim, whose poses contain the applied command, a replay through its plant shows more.

Between two poses a robot moves about as far as just before and just after. A correction of its pose
adds a step that neither neighbour has: the excess. This is true at any speed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from turtlelog.display import describe_count, join_words
from turtlelog.measure.motion import GAP_STEPS
from turtlelog.measure.outliers import (
    GRAINS,
    LOCAL_SPANS,
    LONGEST_STEP_NS,
    NEIGHBOURS,
    compute_median,
    find_outliers,
    find_quantisation_step,
)
from turtlelog.run import PoseColumns, Run, take_rows
from turtlelog.run.angles import subtract_headings

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
        row: Row of the first pose after it.
        start_ns: Time of the last pose before it [ns].
        end_ns: Time of the first pose after it [ns].
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
        row: Row of the first pose after it.
        time_ns: Time of that pose [ns].
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

    A step far beyond the greatest rate of the robot is a jump; a stray pose makes two such steps. A
    single step is also a jump if neither neighbour is similar, as in `find_outliers`, or if it is
    opposite to the five steps on either side. The same is true if it exceeds the motion of these
    five (`_find_excess_steps`).
    """
    poses = run.poses
    if _has_courses(run):  # a course turns with the positions, and is not independent
        poses = replace(poses, heading_rad=np.zeros(len(poses)))
    rows = _find_changing_rows(poses)
    poses = poses if len(rows) == len(poses) else _take_poses(poses, rows)
    if len(poses) < 3:
        return ()
    steps = measure_excess(poses)
    step_ns = np.diff(poses.time_ns)
    usual_ns = np.asarray(np.maximum(step_ns, compute_median(step_ns)))
    moved, turned = np.hypot(steps[0], steps[1]), np.abs(steps[2])
    applied = [poses.speed_m_s, poses.turn_rate_rad_s]
    is_jump = np.zeros(len(step_ns), dtype=bool)
    excess = _find_excess_steps(poses)
    if poses.speed_m_s is None:
        is_jump |= excess.is_jump
    together = np.hypot(*(poses.xy_m[2:] - poses.xy_m[:-2]).T), np.abs(steps[2][1:] + steps[2][:-1])
    ways = zip((moved, turned), together, applied, _ACCELERATION, strict=True)
    for way, net, seen, acceleration in ways:
        is_jump |= _find_far_steps(way, net, usual_ns, seen=seen, acceleration=acceleration)
    for name, way in zip(("ahead", "aside", "turned"), steps, strict=True):
        rate = way / usual_ns * 1e9
        # A wheeled robot hardly moves sideways, so the sign of this motion is not informative.
        can_lead_back = (name != "aside") & (step_ns <= LONGEST_STEP_NS)
        stands_out = _find_reversals(rate) & can_lead_back
        stands_out[find_outliers(poses.time_ns[1:], rate)] = True
        # The displacement of a step with lost poses is a mean, which shows nothing about its ends.
        stands_out &= step_ns <= _LATE * compute_median(step_ns)
        is_jump |= stands_out & (np.abs(way - _smooth(way)) > _ROUNDING)
    beyond_m, beyond_rad = np.hypot(excess.ahead_m, excess.aside_m), np.abs(excess.turned_rad)
    for row in np.flatnonzero(is_jump & (beyond_rad > _TURNED_RAD)).tolist():
        # The axes turned with the robot, so only the size of the displacement is compared.
        near = moved[row - NEIGHBOURS : row + NEIGHBOURS + 1]
        beyond_m[row] = abs(moved[row] - np.median(near))
    steps = _face_before(steps, excess.turned_rad)
    # At both ends the motion within a step is unknown.
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
    """Return jumps that turn, with their displacement along the heading before them."""
    off_rad = np.where(np.abs(beyond_rad) > _TURNED_RAD, 0.5 * beyond_rad, 0.0)
    cos, sin = np.cos(off_rad), np.sin(off_rad)
    ahead_m, aside_m, turned_rad = steps
    return ahead_m * cos - aside_m * sin, ahead_m * sin + aside_m * cos, turned_rad


def _take_poses(poses: PoseColumns, rows: NDArray[np.int64]) -> PoseColumns:
    is_kept = np.zeros(len(poses), dtype=np.bool_)
    is_kept[rows] = True
    return take_rows(poses, is_kept)


def describe_breaks(run: Run) -> dict[str, str]:
    """Return a sentence on `jumps` and one on `gaps`, for each that is not empty."""
    found = {}
    if jumps := find_jumps(run):
        found["jumps"] = _describe_jumps(jumps, run.start_ns, is_north=_has_courses(run))
    if gaps := find_gaps(run):
        longest = max(gaps, key=lambda gap: gap.end_ns - gap.start_ns)
        which = "" if len(gaps) == 1 else "the longest "
        found["gaps"] = (
            f"{describe_count(len(gaps), 'gap')}, {which}{_format_s(longest)} without a pose from"
            f" {(longest.start_ns - run.start_ns) / 1e9:.1f} s; usual are"
            f" {longest.usual_ns / 1e6:.0f} ms"
        )
    return found


def _format_s(gap: PoseGap) -> str:
    return f"{(gap.end_ns - gap.start_ns) / 1e9:.2f} s"


def _describe_jumps(jumps: Sequence[PoseJump], start_ns: int, *, is_north: bool) -> str:
    largest = max(jumps, key=lambda jump: (jump.excess_m, jump.excess_rad))
    which = "" if len(jumps) == 1 else "the largest "
    names = ("m east", "m west", "m north", "m south") if is_north else _WAYS
    signed = (largest.moved_m, -largest.moved_m, largest.aside_m, -largest.aside_m)
    way_m = float(np.hypot(largest.moved_m, largest.aside_m))
    least_m = _ROUNDING
    beyond_s2 = largest.excess_m / _ACCELERATION[0], largest.excess_rad / _ACCELERATION[1]
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


def _find_reversals(rate: Values) -> NDArray[np.bool_]:
    """Return which steps lead back during a steady motion, further than this motion varies."""
    found = np.zeros(len(rate), dtype=bool)
    if len(rate) <= 2 * NEIGHBOURS:
        return found
    windows = sliding_window_view(rate, 2 * NEIGHBOURS + 1)
    near, own = np.delete(windows, NEIGHBOURS, axis=1), windows[:, NEIGHBOURS]
    low, high = near.min(axis=1), near.max(axis=1)
    is_back = ((low > 0.0) & (own < 0.0)) | ((high < 0.0) & (own > 0.0))
    off = np.abs(own - np.median(near, axis=1))
    least = np.maximum(LOCAL_SPANS * (high - low), GRAINS * find_quantisation_step(rate))
    found[NEIGHBOURS:-NEIGHBOURS] = is_back & (off > least)
    return found


def _smooth(way: Values) -> Values:
    """Return the running median over three steps."""
    padded = np.pad(way, 1, mode="edge")
    return np.asarray(np.median(sliding_window_view(padded, 3), axis=1))


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


_ACCELERATION: Final = (2.0, 10.0)
"""Rate that a robot reaches from rest in 1 s if it was never seen to move so fast [m/s2,
rad/s2]."""

_BEYOND: Final = 3.0
"""Ratio to the effect of acceleration on a step from which an excess is a jump."""

_ALONE: Final = 3.0
"""Smallest ratio to the excess of each neighbour: a late pose has an excess of its own."""

_PLAIN_SHARE: Final = 0.8
_NOISES: Final = 6.0
"""Smallest ratio to the 80 % quantile of excesses. Normal or Laplace noise reaches it in 1 of
15,000 steps, and rarely beside such neighbours. With poses at 10 Hz, a correction every second is
in 10 % of the steps."""

_LATE: Final = 1.5
"""Ratio to the usual time from which a step lost poses: the robot may have stopped in it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ExcessSteps:
    """Steps between poses, each with its excess over the neighbouring steps.

    Attributes:
        ahead_m: Excess along the heading, backward negative [m], shape (n,).
        aside_m: Excess to the left [m], shape (n,).
        turned_rad: Excess turn, counter-clockwise [rad], shape (n,).
        is_jump: Whether the step is a jump, shape (n,).
    """

    ahead_m: Values
    aside_m: Values
    turned_rad: Values
    is_jump: NDArray[np.bool_]


def measure_excess(poses: PoseColumns) -> tuple[Values, Values, Values]:
    """Return each step along and across the mean heading of its poses [m], and turned [rad]."""
    turned_rad = subtract_headings(poses.heading_rad[1:], poses.heading_rad[:-1])
    mean_rad = poses.heading_rad[:-1] + 0.5 * turned_rad
    x_m, y_m = np.diff(poses.xy_m, axis=0).T
    cos, sin = np.cos(mean_rad), np.sin(mean_rad)
    return x_m * cos + y_m * sin, y_m * cos - x_m * sin, turned_rad


def _find_excess_steps(poses: PoseColumns) -> ExcessSteps:
    """Return the steps from pose to pose with their excess over the neighbouring steps."""
    steps = measure_excess(poses)
    step_ns = np.diff(poses.time_ns)
    is_jump = np.zeros(len(step_ns), dtype=bool)
    excess = [np.zeros(len(step_ns)) for _ in steps]
    if len(step_ns) > 2 * NEIGHBOURS:
        usual_ns = compute_median(step_ns)
        is_late = step_ns > _LATE * usual_ns
        pairs = [_find_excess(step, step_ns, is_late) for step in steps]
        plain, excess = ([pair[kind] for pair in pairs] for kind in (0, 1))
        for axes, acceleration in zip((slice(0, 2), slice(2, 3)), _ACCELERATION, strict=True):
            size, usual = (np.hypot.reduce(found[axes]) for found in (excess, plain))
            least = _BEYOND * acceleration * (step_ns / 1e9) ** 2
            is_jump |= (np.abs(size) > least) & _stands_alone(size, np.abs(usual))
    return ExcessSteps(
        ahead_m=excess[0],
        aside_m=excess[1],
        turned_rad=excess[2],
        is_jump=is_jump,
    )


def _find_changing_rows(poses: PoseColumns) -> NDArray[np.int64]:
    """Return the rows of poses that differ from the previous pose, if most poses repeat it.

    Some programs publish each pose several times. Otherwise a repeated pose means that the robot is
    at rest, and counts.
    """
    every = np.arange(len(poses))
    moved = (np.diff(poses.xy_m, axis=0) != 0.0).any(axis=1) | (np.diff(poses.heading_rad) != 0.0)
    changing = np.flatnonzero(moved) + 1
    if len(changing) < 2 or compute_median(np.diff(changing)) < 2:
        return every
    return np.concatenate([[0], changing])


def _find_excess(
    step: Values, step_ns: NDArray[np.int64], is_late: NDArray[np.bool_]
) -> tuple[Values, Values]:
    """Return by how much each step exceeds the median rate of its neighbours; 0 at both ends.

    The second value leaves out the part that another rate explains in steps with lost poses.
    """
    windows = sliding_window_view(step / step_ns, 2 * NEIGHBOURS + 1)
    near = np.delete(windows, NEIGHBOURS, axis=1)
    inside = slice(NEIGHBOURS, -NEIGHBOURS)
    way, took_ns = step[inside], step_ns[inside]
    # In a step with lost poses, any displacement between those of a stop and of a neighbour's rate
    # is possible.
    low = np.minimum(near.min(axis=1), 0.0) * took_ns
    high = np.maximum(near.max(axis=1), 0.0) * took_ns
    plain, excess = np.zeros(len(step)), np.zeros(len(step))
    plain[inside] = way - np.median(near, axis=1) * took_ns
    excess[inside] = np.where(is_late[inside], way - np.clip(way, low, high), plain[inside])
    return plain, excess


def _stands_alone(size: Values, plain: Values) -> NDArray[np.bool_]:
    """Return which excesses are far beyond those of their neighbours and the usual excess."""
    padded = np.pad(plain, NEIGHBOURS)
    near = np.delete(sliding_window_view(padded, 2 * NEIGHBOURS + 1), NEIGHBOURS, axis=1)
    usual = float(np.quantile(plain, _PLAIN_SHARE))
    return np.asarray((np.abs(size) > _ALONE * near.max(axis=1)) & (np.abs(size) > _NOISES * usual))
