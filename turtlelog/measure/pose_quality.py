"""A direction of travel beside a robot's heading, and notes on the quality of its poses."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import describe_count, format_short, join_words
from turtlelog.log.read_choice import NOTES
from turtlelog.measure.breaks import (
    ACCELERATION,
    ROUNDING,
    PoseJump,
    find_gaps,
    find_jumps,
)
from turtlelog.measure.metric import Metric
from turtlelog.measure.pose_noise import (
    describe_outliers,
    find_pose_resolution,
    find_scatter,
    measure_rate_noise,
    measure_steps,
)
from turtlelog.measure.rates import (
    AXES,
    Axis,
    find_changing_rows,
    read_held_commands,
    space_poses,
)
from turtlelog.measure.reductions import Values, compute_median, subtract_neighbours
from turtlelog.measure.signals import sign_speeds
from turtlelog.run import PoseColumns, Run, take_rows

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


_BACKWARD: Final = 0.1
"""Speed along the heading, as a share of the speed, from which its sign is clear."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TravelDirection:
    """The constant angle between a robot's heading and its direction of travel.

    Attributes:
        angle_rad: Direction of travel minus heading, in (-pi, pi) [rad]; positive to the left.
            Beyond a quarter turn only if the reported speed or the commands show which way is
            forward.
    """

    angle_rad: float

    @property
    def shortfall(self) -> float:
        """Share by which speeds along the heading are too small [1]."""
        return 1.0 - math.cos(self.angle_rad)

    def describe(self) -> str:
        """Return the angle and its side in words, and what it makes of speeds along the heading."""
        side = "left" if self.angle_rad > 0.0 else "right"
        way = f"the robot travels {abs(math.degrees(self.angle_rad)):.1f} deg to the {side} of its"
        less = f"speeds along the heading are {100.0 * min(self.shortfall, 1.0):.1f} % too small"
        if self.shortfall > 1.0 + _BACKWARD:
            less = "speeds along the heading have the wrong sign"
        return f"{way} heading; {less}"


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
    is_other = run.commands.lateral_speed_m_s.any() or run.poses.speed_m_s is not None
    if is_other or run.origin.has_courses or run.origin.has_leaps:
        return None
    moved_m, turned_rad, ends = _measure_displacements(run.poses)
    sizes_m = np.hypot(moved_m[:, 0], moved_m[:, 1])
    largest_m = float(sizes_m.max(initial=0.0))
    if not largest_m or int((sizes_m > _MOVING * largest_m).sum()) < _FEWEST:
        return None
    moved_m /= largest_m  # whose squares are finite; only the direction counts
    energy = float((moved_m**2).sum())
    if turning := float(turned_rad @ turned_rad):
        moved_m = moved_m - np.outer(turned_rad, (turned_rad @ moved_m) / turning)
    (least, most), axes = np.linalg.eigh(moved_m.T @ moved_m)
    ahead, aside = axes[:, 1].tolist()
    angle_rad = math.atan(aside / ahead) if ahead else math.pi / 2.0
    against = math.sin(angle_rad) ** 2
    ways = moved_m @ np.array([math.cos(angle_rad), math.sin(angle_rad)])
    # Swapped motors, too, drive against commands alone, so straight back needs both.
    has_both = run.poses.measured_speed_m_s is not None and len(run.commands) > 0
    may_turn = has_both or abs(angle_rad) >= _LEAST_RAD
    if may_turn and _goes_against(run, ways, ends):
        angle_rad -= math.copysign(math.pi, angle_rad)
        against = 1.0
    unexplained = least / (least + most * against) if against else 1.0
    is_clear = most > _LEFT * energy and unexplained < 1.0 - _EXPLAINED
    is_clear &= abs(angle_rad) >= _LEAST_RAD
    if not is_clear:
        return None
    return TravelDirection(angle_rad=angle_rad)


_ONE_SIGN: Final = 0.8
"""Share of the motion with one sign against the reported speed or the commands from which they show
which way is forward. Commands act late, so a few displacements have the sign of those before."""


def _goes_against(run: Run, ways: Values, ends: NDArray[np.int64]) -> bool:
    """Return whether reported speeds and commands, of which one exists, have the other sign."""
    time_s = (run.poses.time_ns - run.start_ns) / 1e9
    told = list[Values]()
    if (speed := run.poses.measured_speed_m_s) is not None:
        steps_m = np.diff(time_s) * (speed[1:] + speed[:-1]) / 2.0
        told.append(np.append(0.0, np.cumsum(steps_m)))
    if (commands := read_held_commands(run, "speed", None)) is not None:
        told.append(commands.integrate(time_s))
    against = [ways * (way_m[ends[1]] - way_m[ends[0]]) for way_m in told]
    moving = [products for products in against if products.any()]
    return bool(moving) and all(
        float(products.sum()) < -_ONE_SIGN * float(np.abs(products).sum()) for products in moving
    )


def _measure_displacements(poses: PoseColumns) -> tuple[Values, Values, NDArray[np.int64]]:
    """Return displacements along the mean heading and to its left [m], turns [rad], and rows.

    The rows are those of the first and of the last pose of each, shape (2, n).
    """
    time_s = poses.time_ns / 1e9
    if len(time_s) < 2:
        return np.zeros((0, 2)), np.zeros(0), np.zeros((2, 0), dtype=np.int64)
    every = math.ceil(_OVER_S / max(compute_median(np.diff(time_s)), 1e-9))
    rows = np.arange(0, len(time_s), every)
    ahead_m, aside_m, turned_rad = measure_steps(take_rows(poses, rows))
    kept = (np.diff(time_s[rows]) <= _MOST_S) & (np.abs(turned_rad) <= _MOST_TURN_RAD)
    ends = np.array([rows[:-1], rows[1:]])
    return np.column_stack([ahead_m, aside_m])[kept], turned_rad[kept], ends[:, kept]


_CHORD_S: Final = 0.5
"""Time over which motion is split into ahead and aside [s]: in it, noise of poses hardly adds."""

_COMMANDED_M_S: Final = 0.01
"""Command to the side from which a robot counts as commanded sideways [m/s], as of rest."""


def describe_sideways(run: Run) -> str:
    """Return a clause on a robot that is commanded sideways; empty for other robots."""
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


def _describe_repetition(poses: PoseColumns) -> str:
    """Return the rate at which poses change, if most repeat the previous one; otherwise empty."""
    rows = find_changing_rows(poses)
    if len(rows) == len(poses):
        return ""
    return f"{1e9 / compute_median(np.diff(poses.time_ns[rows])):.3g} Hz"


_JUMPED: Final = 0.1
"""Share of a jump from which the distance driven meanwhile is mentioned."""


def describe_source(run: Run) -> dict[str, str]:
    """Return notes on the data of a run, by name: its clock and source, jumps, gaps, outliers."""
    shown = (name for name, kind in NOTES.items() if kind.in_info and name in run.notes)
    notes = {name: run.notes[name] for name in shown}
    notes |= describe_breaks(run) if run.poses.speed_m_s is None else {}
    notes |= describe_outliers(run) | describe_travel(run)
    if sideways := describe_sideways(run):
        notes["sideways"] = f"{sideways}; speeds are those ahead or back"
    return notes


def describe_breaks(run: Run) -> dict[str, str]:
    """Return a sentence on `repeated`, `jumps` and `gaps`, for each that is not empty."""
    found = {}
    if changes := _describe_repetition(run.poses):
        found["repeated"] = f"most positions repeat the one before; they change at {changes}"
    if jumps := find_jumps(run):
        found["jumps"] = _tell_jumps(run, jumps)
    if gaps := find_gaps(run):
        longest = max(gaps, key=lambda gap: gap.end_ns - gap.start_ns)
        which = "" if len(gaps) == 1 else "the longest "
        length_s = (longest.end_ns - longest.start_ns) / 1e9
        at_s, usual_ms = (longest.start_ns - run.start_ns) / 1e9, longest.usual_ns / 1e6
        long = f"{which}{length_s:.2f} s without a pose from {at_s:.1f} s"
        found["gaps"] = f"{describe_count(len(gaps), 'gap')}, {long}; usual are {usual_ms:.0f} ms"
    return found


def _tell_jumps(run: Run, jumps: Sequence[PoseJump]) -> str:
    largest = max(jumps, key=lambda jump: (jump.excess_m, jump.excess_rad))
    which = "" if len(jumps) == 1 else "the largest "
    names = ("m ahead", "m back", "m to the left", "m to the right")
    if run.origin.has_courses:
        names = ("m east", "m west", "m north", "m south")
    signed = (largest.moved_m, -largest.moved_m, largest.aside_m, -largest.aside_m)
    way_m = float(np.hypot(largest.moved_m, largest.aside_m))
    beyond_s2 = largest.excess_m / ACCELERATION[0], largest.excess_rad / ACCELERATION[1]
    # The displacement has no meaning if the heading jumps.
    is_turn = largest.excess_m <= _JUMPED * way_m and beyond_s2[0] < beyond_s2[1]
    least_m, beyond = np.inf if is_turn else ROUNDING, ""
    parts = [f"{way:.3g} {name}" for name, way in zip(names, signed, strict=True) if way > least_m]
    # What the robot turned as usual meanwhile is no part of a jump of its position.
    if abs(largest.turned_rad) > ROUNDING and largest.excess_rad > _JUMPED * abs(
        largest.turned_rad
    ):
        parts.append(f"{np.degrees(largest.turned_rad):+.3g} deg")
    if abs(largest.excess_m - way_m) > _JUMPED * way_m and not is_turn:
        beyond = f", {largest.excess_m:.3g} m more than it drove"
    at_s, count = (largest.time_ns - run.start_ns) / 1e9, describe_count(len(jumps), "jump")
    return f"{count}, {which}{join_words(parts)} at {at_s:.1f} s{beyond}"


_SHOWN: Final = 5e-4
"""Share of a path length below which jumps do not change its three printed digits."""

_COUNTED: Final = 5e-3
"""Share of the time below which gaps do not change the share at rest, in whole per cent."""

_NOISY: Final = 0.03
"""Share of the largest measured rate from which noise is told: three standard deviations of it are
a tenth."""

_CREPT_M: Final = 0.02
"""Distance at rest that is told: more than a robot that brakes and stops four times."""

_LARGE: Final = 0.05
"""Share of a path length from which jumps are told beside it, and of a duration from which gaps
are. Wheel odometry is as wrong itself."""


def describe_poses(run: Run, metrics: Mapping[str, Metric]) -> dict[str, str]:
    """Return notes on motion to the side, and on what metrics contain besides motion.

    Without a path length, there is only the resolution of lags and rise times.
    """
    if run.poses.speed_m_s is not None:
        return {}
    resolution = _describe_resolution(run, metrics)
    path_m = _get(metrics, "run.path_length")
    if path_m is None:
        return resolution
    sideways = describe_sideways(run)
    silent = [axis.replace("_", " ") for axis in _list_silent(run)]
    is_partly = len(silent) == 1
    return {
        **resolution,
        **({} if sign_speeds(run) is None else {"unsigned": "the poses give the sign"}),
        **({"differenced": f"; the {silent[0]} is a difference of poses"} if is_partly else {}),
        **describe_travel(run),
        **({"sideways": sideways} if sideways else {}),
        **_describe_times(run),
        **_describe_noise(run, metrics),
        **_describe_rest(run, metrics, path_m),
        **_describe_jumps(run, path_m),
    }


def _list_silent(run: Run) -> list[Axis]:
    """Return the axes of which the robot reports no rates."""
    reported = (run.poses.measured_speed_m_s, run.poses.measured_turn_rate_rad_s)
    return [axis for axis, rate in zip(AXES, reported, strict=True) if rate is None]


def _get(metrics: Mapping[str, Metric], name: str) -> float | None:
    metric = metrics.get(name)
    return None if metric is None else metric.value


def _describe_resolution(run: Run, metrics: Mapping[str, Metric]) -> dict[str, str]:
    known = [_get(metrics, f"run.{axis}_{name}") for axis in AXES for name in ("lag", "rise_time")]
    if all(value is None for value in known) or len(run.poses) < 2:
        return {}
    is_reported = run.poses.measured_speed_m_s is not None
    time_s = run.poses.time_ns / 1e9 if is_reported else space_poses(run).time_s
    step_s = compute_median(subtract_neighbours(time_s))
    lead_s = -min((lag for axis in AXES if (lag := _get(metrics, f"run.{axis}_lag"))), default=0.0)
    # A robot without delays has a lag of 0 within half a step.
    leads = {"leads": format_short(lead_s, "s")} if lead_s > step_s else {}
    return {
        "rate_step": format_short(1e3 * step_s, "ms"),
        **leads,
        **_describe_answers(run, metrics, step_s),
    }


def _describe_answers(run: Run, metrics: Mapping[str, Metric], step_s: float) -> dict[str, str]:
    """Return notes on silences of commands, and on rise times that are too small, by name."""
    from turtlelog.measure.metrics.following import find_rise_shortfall  # it needs this module
    from turtlelog.measure.run_context import MeasureSettings, RunContext

    held = [RunContext(run, MeasureSettings()).get_commands(axis) for axis in AXES]
    silences_s = [one.silences_s for one in held if one is not None and len(one.silences_s)]
    found = {}
    if silences_s:
        most = max(silences_s, key=len)
        total = format_short(float(np.diff(most).sum()), "s")
        found["silences"] = (
            f"{describe_count(len(most), 'silence')} of the commands, {total} in all"
        )
    short_s = {
        axis: find_rise_shortfall(run, axis)
        for axis in AXES
        if _get(metrics, f"run.{axis}_rise_time") is not None
    }
    said = [
        f"{axis.replace('_', ' ')} by up to about {format_short(float(f'{short:.1g}'), 's')}"
        for axis, short in short_s.items()
        if short > 2.0 * step_s
    ]
    return found | ({"short_rises": join_words(said)} if said else {})


def _describe_times(run: Run) -> dict[str, str]:
    changes = _describe_repetition(run.poses)
    gaps_s = sum(gap.end_ns - gap.start_ns for gap in find_gaps(run)) / 1e9
    least_s = {"gaps": _COUNTED * run.duration_s, "large_gaps": _LARGE * run.duration_s}
    gaps = {name: format_short(gaps_s, "s") for name in least_s if gaps_s > least_s[name]}
    return {"changes": changes, **gaps} if changes else gaps


def _describe_noise(run: Run, metrics: Mapping[str, Metric]) -> dict[str, str]:
    notes, scatter, sizes, coarse = {}, find_scatter(run), [], []
    if scatter.path_m is not None:
        notes["path_without_scatter"] = format_short(scatter.path_m, "m")
    if scatter.turning_rad is not None:
        notes["turning_without_scatter"] = format_short(math.degrees(scatter.turning_rad), "deg")
    if len(run.poses) < 2:
        return notes
    silent, noises = _list_silent(run), measure_rate_noise(run)
    for (axis, unit), noise, finest in zip(
        AXES.items(), noises, find_pose_resolution(run), strict=True
    ):
        time_s = space_poses(run).time_s if axis in silent else run.poses.time_ns / 1e9
        step_s = compute_median(np.diff(time_s))
        least = _NOISY * (_get(metrics, f"run.measured_{axis}_max") or math.inf)
        if finest > least * step_s:
            size = (finest, "m") if unit == "m/s" else (math.degrees(finest), "deg")
            over = f"{format_short(finest / step_s, unit)} over {format_short(1e3 * step_s, 'ms')}"
            coarse.append(f"{format_short(*size)} ({over})")
        elif axis in silent and noise > least:
            sizes.append(f"{noise:.1g} {unit}")
    found = {"rate_noise": join_words(sizes), "resolution": join_words(coarse)}
    return notes | {name: note for name, note in found.items() if note}


def _describe_rest(run: Run, metrics: Mapping[str, Metric], path_m: float) -> dict[str, str]:
    if not _get(metrics, "run.rest_share"):
        return {}
    from turtlelog.measure.metrics.travel import AT_REST_M_S, Rest, judge_rest
    from turtlelog.measure.run_context import MeasureSettings, RunContext

    rest = judge_rest(RunContext(run, MeasureSettings()))
    if not isinstance(rest, Rest) or rest.way_m <= max(_CREPT_M, _LARGE * path_m):
        return {}
    # A robot that moves further swings, and does not creep.
    creeps = rest.way_m <= AT_REST_M_S * rest.time_s
    return {"crept": format_short(rest.way_m, "m")} if creeps else {}


def _describe_jumps(run: Run, path_m: float) -> dict[str, str]:
    jumps = find_jumps(run)
    share = sum(jump.excess_m for jump in jumps) / (path_m or math.inf)
    if share <= _SHOWN:
        return {}
    large = {"jumped_share": f"{100.0 * share:.0f} %"} if share >= _LARGE else {}
    return {"jumps": _tell_jumps(run, jumps), **large}
