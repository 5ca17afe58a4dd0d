"""Comparison of the path, rates and units that odometry or a table reports with its poses."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from turtlelog.display import format_short
from turtlelog.log.planar_poses import (
    MOVED_M,
    Values,
    describe_height,
    describe_leaps,
    describe_level,
    describe_small_leaps,
)
from turtlelog.log.ros2.bag_rows import OrderedRows
from turtlelog.log.ros2.stamps import TimesNs, thin_rows
from turtlelog.log.units import UNITS, describe_units

_APART: Final = 0.2
"""Share by which two path lengths must differ. Wheel odometry integrates its own speed and is
within 5 %; odometry of a camera or a filter is within 10 %."""

_LEAST_M: Final = 0.5
"""Shortest path that is compared [m]: noise of 5 mm from pose to pose adds up to it in 100
poses."""

_STILL_M: Final = 1e-3
"""Largest extent of poses that never move [m]; an encoder's tick is smaller, and noise is
larger."""

_LONGEST_NS: Final = 1_000_000_000
"""Longest step in time that counts [ns]: the motion during longer steps is unknown."""

STRIDE_NS: Final = 200_000_000
"""Time over which poses are differenced [ns]; in this time, 1 mm of noise is 7 mm/s."""

_JUMP_M: Final = 0.05
"""Excess of a step over the reported speed from which it is a jump [m]: a step at 20 Hz and 1
m/s."""

_MOST_JUMPS: Final = 0.1
"""Largest share of jumps among the steps. More jumps would be the usual motion."""

_NEARER: Final = 2.0
"""Ratio of two paths' distances from that of the commands, from which the farther is wrong."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Paths:
    """Path lengths of one drive [m].

    Attributes:
        is_still: Whether the poses never move.
        by_poses: Sum of distances from pose to pose.
        by_strides: Sum of distances between poses 0.2 s apart.
        by_medians: Sum of distances between the median poses of each second; None for a short time.
        by_speed: Integral of the magnitude of the reported velocity; None without reports.
        in_jumps: Sum of the excess of single steps over the reported velocity.
        by_commands: Integral of the magnitude of the commands; None without commands.
    """

    is_still: bool
    by_poses: float
    by_strides: float
    by_medians: float | None
    by_speed: float | None
    in_jumps: float
    by_commands: float | None


def measure_paths(
    time_ns: TimesNs,
    columns: Mapping[str, Values],
    commands: tuple[TimesNs, Values] | None = None,
) -> Paths:
    """Return the path lengths of a drive by poses, speeds and commands.

    Times do not decrease. Commands have a time [ns] and a magnitude of velocity [m/s].
    """
    xy_m = np.column_stack([columns["x"], columns["y"]])
    step_ns = np.diff(time_ns)
    is_known = step_ns <= _LONGEST_NS
    way_m = np.hypot(*np.diff(xy_m, axis=0).T)[is_known]
    rows = thin_rows(time_ns, STRIDE_NS)
    strides_m = np.hypot(*np.diff(xy_m[rows], axis=0).T)
    # Poses with one common time give no rate: their times are wrong, not their path.
    lasts = int(time_ns[-1] - time_ns[0]) >= STRIDE_NS
    driven_m, jumps_m = None, np.zeros(0)
    if lasts and (speed := columns.get(SPEED)) is not None:
        lateral = columns.get(LATERAL)
        if lateral is None or not np.isfinite(lateral).all():
            lateral = np.zeros_like(speed)
        magnitude = np.hypot(speed, lateral)
        driven_m = ((magnitude[1:] + magnitude[:-1]) / 2.0 * step_ns / 1e9)[is_known]
        beyond_m = way_m - driven_m
        jumps_m = beyond_m[beyond_m > _JUMP_M]
    is_few = len(jumps_m) <= _MOST_JUMPS * len(way_m)
    by_commands = None
    if commands is not None:  # each is held until the next, but at most for a second
        held_s = np.minimum(np.diff(commands[0]), _LONGEST_NS) / 1e9
        by_commands = float((np.abs(commands[1][:-1]) * held_s).sum())
    return Paths(
        is_still=bool((np.ptp(xy_m, axis=0) <= _STILL_M).all()),
        by_poses=float(way_m.sum()),
        by_strides=float(strides_m[np.diff(time_ns[rows]) <= _LONGEST_NS].sum()),
        by_medians=_measure_medians(time_ns, xy_m),
        by_speed=None if driven_m is None else float(driven_m.sum()),
        in_jumps=float(jumps_m.sum()) if is_few else 0.0,
        by_commands=by_commands,
    )


_FEWEST_SECONDS: Final = 3


def _measure_medians(time_ns: TimesNs, xy_m: Values) -> float | None:
    """Return the length through the median positions of each second: noise hardly adds to it."""
    seconds = (time_ns - time_ns[0]) // _LONGEST_NS
    if seconds[-1] < _FEWEST_SECONDS:
        return None
    starts = np.flatnonzero(np.diff(seconds, prepend=-1))
    middles = (starts + np.append(starts[1:], len(seconds)) - 1) // 2
    medians = np.column_stack([one[np.lexsort((one, seconds))][middles] for one in xy_m.T])
    return float(np.hypot(*np.diff(medians, axis=0).T).sum())


def describe_paths(paths: Paths, others: str | None = None) -> str | None:
    """Return a sentence on paths that differ, and on the likely error; None if the paths agree.

    Where the poses may be wrong, it names `others`, the other topics with poses.
    """
    found = _find_contradiction(paths, others)
    return None if found is None else ": ".join(found)


def _find_contradiction(paths: Paths, others: str | None) -> tuple[str, str] | None:
    """Return how paths differ, and the likely error; None if the paths agree."""
    more = "" if others is None else f"; others: {others}"
    if paths.is_still:
        still = _describe_still(paths)
        return still and (still[0], f"{still[1]}{more}")
    if paths.by_speed is None or max(paths.by_poses, paths.by_speed) < _LEAST_M:
        return None
    if not _differ(paths.by_poses, paths.by_speed):
        return None
    if paths.by_medians is not None and max(paths.by_medians, paths.by_speed) < _LEAST_M:
        return None  # the robot turns in place, or rests, and its positions scatter
    by_poses, by_speed = (format_short(one, "m") for one in (paths.by_poses, paths.by_speed))
    found = f"the path is {by_poses} by the poses and {by_speed} by the reported speed"
    blamed, is_speed = _blame(paths, paths.by_speed)
    return found, f"{blamed}{'' if is_speed else more}"


def _describe_still(paths: Paths) -> tuple[str, str] | None:
    if paths.by_speed is not None and paths.by_speed >= _LEAST_M:
        way = format_short(paths.by_speed, "m")
        return "the poses never move, and are likely wrong", f"the reported speed drives {way}"
    if paths.by_commands is not None and paths.by_commands >= _LEAST_M:
        way = format_short(paths.by_commands, "m")
        found = f"the poses never move though commands ask for {way}"
        return found, "nobody computes them, or the robot was held"
    return None


def _blame(paths: Paths, by_speed: float) -> tuple[str, bool]:
    """Return what is likely wrong, and whether it is the reported speed."""
    if paths.in_jumps and not _differ(paths.by_poses - paths.in_jumps, by_speed):
        jumps = format_short(paths.in_jumps, "m")
        return f"the poses are more likely wrong, whose jumps add {jumps}", False
    if paths.by_poses > by_speed and not _differ(paths.by_strides, by_speed):
        strides = format_short(paths.by_strides, "m")
        found = "the poses are more likely wrong from one to the next, where they scatter; over"
        return f"{found} 0.2 s each they add up to {strides}", False
    if paths.by_commands is not None and paths.by_commands >= _LEAST_M:
        off_m = [abs(one - paths.by_commands) for one in (paths.by_strides, by_speed)]
        if max(off_m) > _NEARER * min(off_m):
            asked = format_short(paths.by_commands, "m")
            if off_m[0] > off_m[1]:
                # Slipping wheels turn as commanded, and the odometry reports that.
                ratio = f"{by_speed / max(paths.by_strides, _STILL_M):.2g}"
                wrong = "the poses are wrong, the wheels slip, or the reported speed is"
                return f"{wrong} {ratio} times the true one; commands ask for {asked}", False
            return f"the reported speed is more likely wrong, as commands ask for {asked}", True
    return "nothing tells which is wrong", False


def _differ(one_m: float, other_m: float) -> bool:
    return abs(one_m - other_m) > _APART * max(one_m, other_m)


SPEED: Final = "measured_speed"
LATERAL: Final = "measured_lateral_speed"
TURN_RATE: Final = "measured_turn_rate"

TURNED_RAD: Final = 0.2
"""Smallest turn of a robot that turned [rad]."""

_JUMPS: Final = 0.99
"""Quantile of steps above which steps may be jumps, for example corrections of a robot at rest."""

_SLOWEST_M_S: Final = 0.05
"""Difference between twists and path up to which it may be noise (rms) [m/s]."""

_MUCH_BETTER: Final = 3.0
"""Ratio of fits from which twists count as along the world's axes; both fit a robot along x."""


def judge_rates(
    time_ns: TimesNs, columns: Mapping[str, Values]
) -> tuple[dict[str, Values], dict[str, str]]:
    """Return the columns of poses with rates along the robot's axes, and a note on the changes.

    Rates that are all zeros are left out if the poses move. Twists along the axes of the world, a
    common fault, are rotated. Times [ns] do not decrease; columns are x, y [m], heading [rad] and
    rates.
    """
    left = {name: column for name, column in columns.items() if name != LATERAL}
    lateral = columns.get(LATERAL)
    lateral = lateral if lateral is not None and np.isfinite(lateral).all() else None
    if len(time_ns) < 2 or not {SPEED, TURN_RATE} & set(left):
        return left, {}
    notes: list[str] = []
    if unset := _find_unset(left, lateral):
        left = {name: column for name, column in left.items() if name not in unset}
        rates = " and ".join(name.removeprefix("measured_").replace("_", " ") for name in unset)
        notes.append(f"{rates} of all twists are 0 though the poses move: taken as not reported")
    if SPEED in left and lateral is not None and lateral.any():
        forward = _turn_twists(time_ns, left, lateral)
        if forward is not None:
            left[SPEED] = forward
            notes.append(
                "twists are along the axes of the world, not the robot's, as the poses tell: the"
                " speed is turned into the robot's axis"
            )
    return left, {"reported_rates": "; ".join(notes)} if notes else {}


def _find_unset(columns: Mapping[str, Values], lateral: Values | None) -> list[str]:
    """Return the names of rates that are 0 throughout while the poses move."""
    speeds = [column for column in (columns.get(SPEED), lateral) if column is not None]
    no_speed = SPEED in columns and not any(column.any() for column in speeds)
    no_turn = TURN_RATE in columns and not columns[TURN_RATE].any()
    if not no_speed and not no_turn:
        return []
    moved = _measure_range(np.column_stack([columns["x"], columns["y"]])) > MOVED_M
    turned = _measure_range(np.unwrap(columns["heading"])[:, np.newaxis]) > TURNED_RAD
    if no_speed and no_turn:
        return [SPEED, TURN_RATE] if moved or turned else []
    return [SPEED] if no_speed and moved else [TURN_RATE] if no_turn and turned else []


_BLOCKS: Final = 50
"""Number of means of poses that show the extent of a path: noise of 0.04 rad in a minute at 10 Hz
gives a range of 0.06 rad instead of 0.26."""


def _measure_range(values: Values) -> float:
    """Return the largest extent of a path along any axis, without its noise or longest steps."""
    firsts = np.arange(0, len(values), -(-len(values) // _BLOCKS))
    counts = np.diff(firsts, append=len(values))[:, np.newaxis]
    means = np.add.reduceat(values, firsts) / counts
    steps = np.diff(values, axis=0)
    length = np.hypot.reduce(steps, axis=1)
    steps[length > np.quantile(length, _JUMPS)] = 0.0
    way = np.vstack([np.zeros_like(steps[:1]), np.cumsum(steps, axis=0)])
    return float(np.minimum(np.ptp(way, axis=0), np.ptp(means, axis=0)).max())


def _turn_twists(time_ns: TimesNs, columns: Mapping[str, Values], lateral: Values) -> Values | None:
    """Return the forward speed of twists along the world's axes; None for other twists."""
    rows = thin_rows(time_ns, STRIDE_NS)
    if len(rows) < 3:
        return None
    step_s = np.diff(time_ns[rows]) / 1e9
    xy_m = np.column_stack([columns["x"], columns["y"]])
    heading_rad = np.unwrap(columns["heading"])
    twists = np.column_stack([columns[SPEED], lateral])
    turned = _rotate(twists, heading_rad)
    velocities = np.diff(xy_m[rows], axis=0) / step_s[:, np.newaxis]
    as_world, as_robot = (_compare(found, rows, velocities) for found in (twists, turned))
    if as_robot <= max(_MUCH_BETTER * as_world, _SLOWEST_M_S):
        return None
    return np.ascontiguousarray(_rotate(twists, -heading_rad)[:, 0])


def _rotate(vectors: Values, by_rad: Values) -> Values:
    x, y = vectors.T
    cos, sin = np.cos(by_rad), np.sin(by_rad)
    return np.column_stack([x * cos - y * sin, x * sin + y * cos])


def _compare(twists: Values, rows: TimesNs, velocities: Values) -> float:
    """Return the median distance between mean twists from row to row and velocities [m/s]."""
    sums = np.vstack([np.zeros((1, 2)), np.cumsum((twists[1:] + twists[:-1]) / 2.0, axis=0)])
    means = np.diff(sums[rows], axis=0) / np.diff(rows)[:, np.newaxis]
    return float(np.median(np.hypot(*(means - velocities).T)))


_LEAST_TURN_RAD: Final = 0.5
"""Smallest turn that is compared with reported turn rates [rad]; noise of headings is smaller."""

_TURN_STRIDE_NS: Final = 1_000_000_000
"""Time over which headings are differenced [ns]: reports that lag a bit agree over it."""

_OFF: Final = 0.2
"""Share by which a ratio must differ from 1, or from that of a unit."""


def describe_turning(
    time_ns: TimesNs, heading_rad: Values, turn_rate_rad_s: Values, column: str | None
) -> str:
    """Return a sentence on turn rates (of a `column` in assumed rad/s) that headings contradict.

    The column has no name if its unit is known, and is None in a bag.
    """
    rows = thin_rows(time_ns, _TURN_STRIDE_NS)
    step_s = np.diff(time_ns) / 1e9
    means = (turn_rate_rad_s[1:] + turn_rate_rad_s[:-1]) / 2.0
    reported_rad = np.diff(np.concatenate([[0.0], np.cumsum(means * step_s)])[rows])
    turned_rad = np.diff(np.unwrap(heading_rad)[rows])
    if min(np.abs(reported_rad).sum(), np.abs(turned_rad).sum()) < _LEAST_TURN_RAD:
        return ""
    # A single wrong report may exceed all turns together, and noise of headings all reports.
    by_turns = _find_median_ratio(reported_rad, turned_rad)
    by_reports = 1.0 / (_find_median_ratio(turned_rad, reported_rad) or math.inf)
    ratio = min(by_turns, by_reports, key=lambda ratio: abs(ratio - 1.0))
    if abs(ratio - 1.0) <= _OFF:
        return ""
    found = f"the reported turn rate is {format_short(ratio)} times that of the headings"
    return f"{found}{_propose('turn_rate', column, ratio)}"


def _find_median_ratio(values: Values, others: Values) -> float:
    """Return the median ratio of values to others, weighted by the others' magnitudes."""
    rows = np.flatnonzero(others)
    ratios = values[rows] / others[rows]
    order = np.argsort(ratios)
    weights = np.cumsum(np.abs(others[rows][order]))
    return float(ratios[order][np.searchsorted(weights, weights[-1] / 2.0)])


def describe_speed(
    time_ns: TimesNs, xy_m: Values, speed_m_s: Values, columns: Mapping[str, str]
) -> str:
    """Return a sentence on speeds that the positions contradict.

    The `columns` of x, y and speed are those in assumed units.
    """
    paths = measure_paths(time_ns, {"x": xy_m[:, 0], "y": xy_m[:, 1], SPEED: speed_m_s})
    found = _find_contradiction(paths, None)
    if found is None:
        return ""
    ratio = (paths.by_speed or 0.0) / paths.by_strides if paths.by_strides else 0.0
    proposed = _propose("speed", columns.get("speed", ""), ratio)
    if {"x", "y"} <= {*columns} and not proposed:
        proposed = next(_propose_lengths(columns, ratio), "")
    return f"{found[0]}{proposed}" if proposed else ": ".join(found)


_FACTORS: Final[Mapping[str, Mapping[str, float]]] = {
    "speed": {"km/h": 3.6, "cm/s": 100.0, "mm/s": 1000.0},
    "turn_rate": {"deg/s": 180.0 / math.pi, "rpm": 30.0 / math.pi},
}


def _propose(field: str, column: str | None, ratio: float) -> str:
    for unit, factor in _FACTORS[field].items() if column != "" else ():
        if abs(ratio / factor - 1.0) <= _OFF:
            option = f": --column {field}='{column} [{unit}]'" if column else ""
            return f", which fits {unit}{option}"
    return ""


def _propose_lengths(columns: Mapping[str, str], ratio: float) -> Iterator[str]:
    for unit, metres in UNITS["length"].items():
        if unit != "m" and abs(ratio / metres - 1.0) <= _OFF:
            options = " ".join(f"--column {axis}='{columns[axis]} [{unit}]'" for axis in "xy")
            yield f", which fits positions in {unit}: {options}"


class MotionFaults(NamedTuple):
    """What is unusual about the poses of a bag, with notes by name."""

    notes: dict[str, str]
    leaves_plane: bool  # whether headings and speeds are not those in the plane
    has_leaps: bool  # whether the poses alternate between two places


def note_motion(
    poses: OrderedRows,
    columns: Mapping[str, Values],
    xy_m: Values,
    commands: OrderedRows | None,
    *,
    vertical: int,
    others: str | None,
) -> MotionFaults:
    """Return poses off the plane, leaps, and notes on reported speeds that contradict poses.

    `poses` are timed, with all columns; `columns` are those that `judge_rates` keeps, `xy_m` the
    positions as received [m], `vertical` the number of poses without a heading, `others` the other
    topics.
    """
    notes, z_m = {}, columns.get("z")
    plane = describe_height(z_m, columns.get("tilt"))
    if plane is not None or vertical:
        which = "pose has" if vertical == 1 else "poses have"
        lost = f"; left out: {vertical} {which} no heading, as the forward axis points up or down"
        notes["plane"] = (plane or "the robot leaves the plane") + (lost if vertical else "")
    if leaps := describe_leaps(xy_m) or describe_small_leaps(xy_m):
        notes["leaps"] = leaps
    leaves_plane = plane is not None or vertical > 0
    faults = MotionFaults(notes, leaves_plane=leaves_plane, has_leaps=bool(leaps))
    if plane is not None:  # speeds along the robot's axes are not those seen from above
        return faults
    if level := describe_level(z_m):
        notes["height"] = level
    driven = None
    if commands is not None:
        speed, lateral = commands.columns["speed"], commands.columns["lateral_speed"]
        driven = commands.time_ns, np.hypot(speed, lateral)
    reported = poses.columns if SPEED in columns else columns
    if paths := describe_paths(measure_paths(poses.time_ns, reported, driven), others):
        notes["path_by_speed"] = paths
    return faults


def note_contradictions(
    time_ns: TimesNs, columns: Mapping[str, Values], *, has_headings: bool
) -> dict[str, str]:
    """Return notes on poses of a bag in unlikely units, and on turn rates that headings contradict.

    Times increase. Courses, and headings off the plane, are no headings that contradict rates.
    """
    xy_m = np.column_stack([columns["x"], columns["y"]])
    found = {"unlikely_units": describe_units(time_ns, xy_m, None)}
    if has_headings and TURN_RATE in columns:
        found["turning_by_rate"] = describe_turning(
            time_ns, columns["heading"], columns[TURN_RATE], None
        )
    return {name: text for name, text in found.items() if text}
