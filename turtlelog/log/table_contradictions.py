"""Contradictions within a table: times that start again, units that the motion does not fit."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import format_short
from turtlelog.log.planar_poses import Values
from turtlelog.log.ros2.reported_motion import (
    MOVED_M,
    SPEED,
    describe_paths,
    measure_paths,
    thin_rows,
)

UNLIKELY: Final = "unlikely_units"
"""Name of the note on assumed units of time and length that give an unlikely motion."""

HEADINGS: Final = "heading_and_travel"
"""Name of the note on headings that differ from the direction of travel."""

RATE_NOTE: Final = "turning_by_rate"
"""Name of the note on headings and reported turn rates that turn differently."""

TimesNs = NDArray[np.int64]

_FAR_BACK: Final = 0.5
"""Largest share of a run's time at which the next run starts. A late row goes back by a few steps,
and a new run to the start."""

_FEWEST_ROWS: Final = 10
"""Smallest number of rows of a run, and of rows within the times of the run above. Rows of several
threads are late by fewer rows."""


def find_runs(time_ns: TimesNs) -> list[slice]:
    """Return the rows of each run in a table whose times start again, in the order of the file.

    Rows that are late, and parts in another order, belong to one run: sorting is right for them.
    """
    starts = np.append(0, np.flatnonzero(np.diff(time_ns) < 0) + 1)
    ends = np.append(starts[1:], len(time_ns))
    columns = (starts, ends, time_ns[starts], time_ns[ends - 1])
    found, first = [], 0
    low = high = int(time_ns[0])
    for start, end, begin, last in zip(*(column.tolist() for column in columns), strict=True):
        is_long = start - first >= _FEWEST_ROWS <= end - start
        if is_long and begin <= low + _FAR_BACK * (high - low):
            part = time_ns[start:end]
            within = np.searchsorted(part, high, "right") - np.searchsorted(part, low)
            if within >= _FEWEST_ROWS:
                found.append(slice(first, start))
                first, low, high = start, begin, last
        low, high = min(low, begin), max(high, last)
    return [*found, slice(first, len(time_ns))]


_PIECES: Final = 100
"""Number of pieces of a path whose directions are compared with headings."""

_STRAIGHT: Final = 0.5
"""Smallest distance between the ends of a piece, as a share of its length: less is noise of a robot
at rest."""

_STEADY: Final = 0.5
"""Smallest mean cosine of twice the change of direction between pieces; it is 0 for noise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Travel:
    """Directions of travel along pieces of a path.

    Attributes:
        firsts: First row of each piece, shape (n,).
        lasts: Last row of each piece.
        course_rad: Direction from the first to the last row, counter-clockwise from +x [rad].
        length_m: Distance between them [m].
    """

    firsts: NDArray[np.int64]
    lasts: NDArray[np.int64]
    course_rad: Values
    length_m: Values


def find_travel(xy_m: Values) -> Travel | None:
    """Return the directions of travel; None if the robot hardly moves, or scatters.

    The finite positions have the shape (n, 2).
    """
    with np.errstate(over="ignore", invalid="ignore"):  # lengths beyond 1e154 overflow
        along_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy_m, axis=0).T))])
    if not np.isfinite(along_m[-1] * _PIECES):
        return None
    edges = np.searchsorted(along_m, np.linspace(0.0, along_m[-1], _PIECES + 1))
    edges = np.unique(np.minimum(edges, len(along_m) - 1))
    ways_m = np.diff(xy_m[edges], axis=0)
    length_m = np.hypot(*ways_m.T)
    is_straight = length_m > _STRAIGHT * np.diff(along_m[edges])
    if is_straight.sum() < 2 or float(np.ptp(xy_m, axis=0).max()) < MOVED_M:
        return None
    course_rad = np.arctan2(ways_m[:, 1], ways_m[:, 0])[is_straight]
    if float(np.cos(2.0 * np.diff(course_rad)).mean()) < _STEADY:
        return None
    return Travel(
        firsts=edges[:-1][is_straight],
        lasts=edges[1:][is_straight],
        course_rad=course_rad,
        length_m=length_m[is_straight],
    )


def measure_misfit(travel: Travel, heading_rad: Values) -> float:
    """Return the mean angle between headings and the line of travel [rad], in [0, pi/2].

    A robot may drive backward along its heading. Headings of random directions give pi/4.
    """
    sums = np.concatenate([[0.0], np.cumsum(np.exp(1j * heading_rad))])
    mean_rad = np.angle(sums[travel.lasts + 1] - sums[travel.firsts])
    off_rad = np.abs(np.angle(np.exp(2j * (mean_rad - travel.course_rad)))) / 2.0
    return float(np.average(off_rad, weights=travel.length_m))


_WELL_RAD: Final = 0.2
"""Largest misfit of headings that fit the travel [rad]: noise, and a robot that slips sideways."""

_TURNED_DEG: Final = 30.0
"""Smallest range of headings that shows degrees [deg]. A robot that drives sideways may turn by so
many radians, but not along its path."""

_TURNED_RAD: Final = 0.5
"""Smallest range of directions that shows how headings count [rad]. On a straight path, any offset
of the headings may be how the robot drives."""

_BADLY_RAD: Final = 0.5
"""Misfit from which headings contradict the travel [rad]: no robot on wheels slips by 30 deg."""


def fits_degrees(xy_m: Values, headings: Values) -> bool:
    """Return whether the direction of travel shows that headings are in degrees, not in radians."""
    known = np.isfinite(xy_m).all(axis=1) & np.isfinite(headings)
    xy_m, headings = xy_m[known], headings[known]
    if len(headings) < 2 or np.ptp(headings) < _TURNED_DEG:
        return False
    travel = find_travel(xy_m)
    if travel is None:
        return False
    in_deg = measure_misfit(travel, np.radians(headings))
    return in_deg <= _WELL_RAD and in_deg < measure_misfit(travel, headings)


def describe_headings(xy_m: Values, heading_rad: Values, *, column: str, is_assumed: bool) -> str:
    """Return a sentence on headings that contradict the direction of travel; else nothing.

    Args:
        xy_m: Finite positions [m], shape (n, 2).
        heading_rad: Headings as read [rad], shape (n,).
        column: Name of the column of the headings; empty if rotations are quaternions.
        is_assumed: Whether radians are assumed.
    """
    travel = find_travel(xy_m) if len(xy_m) > 1 else None
    if travel is None or (misfit_rad := measure_misfit(travel, heading_rad)) <= _BADLY_RAD:
        return ""
    off = f"{math.degrees(misfit_rad):.0f} deg"
    found = f"headings and direction of travel differ by {off} on average"
    ways = (("deg", 1.0), ("compass", -1.0)) if is_assumed else (("compass", -1.0),)
    scale = math.pi / 180.0 if is_assumed else 1.0
    turned_rad = float(np.ptp(np.unwrap(travel.course_rad, period=math.pi)))
    for unit, sign in ways if column and turned_rad >= _TURNED_RAD else ():
        other_rad = sign * scale * heading_rad + (0.0 if unit == "deg" else math.pi / 2.0)
        if measure_misfit(travel, other_rad) <= _WELL_RAD:
            words = "degrees" if unit == "deg" else "a compass (0 is north, clockwise)"
            return f"{found}, but fit {words}: --column heading='{column} [{unit}]'"
    read = " (assumed in rad)" if is_assumed else ""
    return f"{found}: the robot drives sideways, or the headings{read} are wrong"


_LONGEST_STEP_S: Final = 5.0
"""Largest usual step that is not doubted if seconds are assumed [s]: satellite loggers save a pose
every few seconds. In milliseconds, this is 200 Hz."""

_FASTEST_M_S: Final = 100.0
"""Largest usual speed that is not doubted if metres are assumed [m/s]: that of a racing car. In
millimetres, this is 0.1 m/s."""


def describe_units(time_ns: TimesNs, xy_m: Values, columns: Mapping[str, str]) -> str:
    """Return a sentence on doubtful units; empty without doubt.

    The times increase; `columns` has the names of columns in assumed s and m, by quantity.
    """
    step_s = np.diff(time_ns) / 1e9
    if not len(step_s):
        return ""
    usual_s = float(np.median(step_s))
    if "t" in columns and usual_s > _LONGEST_STEP_S:
        step = format_short(usual_s, "s")
        option = f"--column t='{columns['t']} [ms]'"
        return f"times are assumed to be in s, so poses are {step} apart; if they are ms: {option}"
    usual_m_s = float(np.median(np.hypot(*np.diff(xy_m, axis=0).T) / step_s))
    if {"x", "y"} <= {*columns} and usual_m_s > _FASTEST_M_S:
        speed = format_short(usual_m_s, "m/s")
        option = " ".join(f"--column {axis}='{columns[axis]} [mm]'" for axis in "xy")
        return f"x and y are assumed to be in m, so {speed} is usual; if they are mm: {option}"
    return ""


_LEAST_TURN_RAD: Final = 0.5
"""Smallest turn that is compared with reported turn rates [rad]; noise of headings is smaller."""

_STRIDE_NS: Final = 1_000_000_000
"""Time over which headings are differenced [ns]: reports that lag a bit agree over it."""

_OFF: Final = 0.2
"""Share by which a ratio must differ from 1, or from that of a unit."""


def describe_turning(
    time_ns: TimesNs, heading_rad: Values, turn_rate_rad_s: Values, column: str
) -> str:
    """Return a sentence on reported turn rates that the headings contradict; else nothing.

    The name of a column in assumed rad/s leads to a proposed unit; else it is empty.
    """
    rows = thin_rows(time_ns, _STRIDE_NS)
    step_s = np.diff(time_ns) / 1e9
    means = (turn_rate_rad_s[1:] + turn_rate_rad_s[:-1]) / 2.0
    reported_rad = np.diff(np.concatenate([[0.0], np.cumsum(means * step_s)])[rows])
    turned_rad = np.diff(np.unwrap(heading_rad)[rows])
    if min(np.abs(reported_rad).sum(), np.abs(turned_rad).sum()) < _LEAST_TURN_RAD:
        return ""
    ratio = float((reported_rad * turned_rad).sum() / (turned_rad**2).sum())
    if abs(ratio - 1.0) <= _OFF:
        return ""
    found = f"the reported turn rate is {format_short(ratio)} times that of the headings"
    return f"{found}{_propose('turn_rate', column, ratio)}"


def describe_speed(time_ns: TimesNs, xy_m: Values, speed_m_s: Values, column: str) -> str:
    """Return a sentence on reported speeds that the positions contradict; else nothing.

    The name of a column in assumed m/s leads to a proposed unit; else it is empty.
    """
    paths = measure_paths(time_ns, {"x": xy_m[:, 0], "y": xy_m[:, 1], SPEED: speed_m_s})
    found = describe_paths(paths)
    if found is None:
        return ""
    ratio = (paths.by_speed or 0.0) / paths.by_strides if paths.by_strides else 0.0
    proposed = _propose("speed", column, ratio)
    return f"{found.partition(':')[0]}{proposed}" if proposed else found


_FACTORS: Final[Mapping[str, Mapping[str, float]]] = {
    "speed": {"km/h": 3.6, "cm/s": 100.0, "mm/s": 1000.0},
    "turn_rate": {"deg/s": 180.0 / math.pi, "rpm": 30.0 / math.pi},
}


def _propose(field: str, column: str, ratio: float) -> str:
    for unit, factor in _FACTORS[field].items() if column else ():
        if abs(ratio / factor - 1.0) <= _OFF:
            return f", which fits {unit}: --column {field}='{column} [{unit}]'"
    return ""
