"""Units of quantities, as names spell them, values suggest them and motion doubts them; times."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from decimal import Decimal, InvalidOperation
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import format_short
from turtlelog.errors import LogError
from turtlelog.log.planar_poses import MOVED_M, Values
from turtlelog.log.ros2.stamps import CROWDED_NS, TimesNs, thin_rows

Quantity = Literal["time", "length", "angle", "speed", "turn_rate", "number"]

QUANTITIES: Final[Mapping[str, Quantity]] = {
    **dict.fromkeys(("t", "t_nanosec"), "time"),
    **dict.fromkeys("xyz", "length"),
    "heading": "angle",
    **dict.fromkeys(("qx", "qy", "qz", "qw"), "number"),
    "speed": "speed",
    "turn_rate": "turn_rate",
    "command_speed": "speed",
    "command_turn_rate": "turn_rate",
}
"""Quantities of a table by field; `speed` and `turn_rate` are measured values of the robot."""

UNITS: Final[Mapping[Quantity, Mapping[str, float]]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "angle": {"rad": 1.0, "deg": math.pi / 180.0, "compass": -math.pi / 180.0},
    "speed": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1.0 / 3.6},
    "turn_rate": {"rad/s": 1.0, "deg/s": math.pi / 180.0, "rpm": math.pi / 30.0},
    "number": {"1": 1.0},
}
"""Units by quantity, the standard unit first, each with its factor to the standard unit.

An angle of a compass [deg] is 0 to the north, which is +y, and clockwise."""


NORTH_RAD: Final = math.pi / 2.0
"""Heading of a robot to the north, +y [rad]."""

TIME_POWERS: Final = {"s": 9, "ms": 6, "us": 3, "ns": 0}
"""Units of time as powers of ten, in nanoseconds."""

_SPELLINGS: Final[Mapping[str, str]] = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("ms", "msec", "millis", "milliseconds"), "ms"),
    **dict.fromkeys(("us", "usec", "micros", "microseconds", "µs", "μs"), "us"),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanos", "nanosec", "nanoseconds"), "ns"),
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), "m"),
    **{name: name for name in ("cm", "mm", "rpm", "1", "compass")},
    **dict.fromkeys(("rad", "rads", "radian", "radians"), "rad"),
    **dict.fromkeys(("deg", "degs", "degree", "degrees", "°"), "deg"),
    **dict.fromkeys(("m/s", "m_s", "mps", "m_per_s"), "m/s"),
    **dict.fromkeys(("cm/s", "cm_s"), "cm/s"),
    **dict.fromkeys(("mm/s", "mm_s"), "mm/s"),
    **dict.fromkeys(("km/h", "km_h", "kmh", "kph"), "km/h"),
    **dict.fromkeys(("rad/s", "rad_s", "radps", "rad_per_s", "rads/s"), "rad/s"),
    **dict.fromkeys(("deg/s", "deg_s", "degps", "dps", "deg_per_s", "°/s"), "deg/s"),
}
"""Common spellings of units."""

DATES: Final = frozenset({"utc", "gmt", "date", "datetime", "iso", "iso8601", "iso 8601"})
"""Texts in a row of units above times that need no unit."""


def read_unit(field: str, text: str) -> str | None:
    """Return the unit of a field; None if the text is not one of its units."""
    plain = text.strip().lower().replace(" ", "").replace("^-1", "").replace("·", "_")
    quantity = QUANTITIES[field]
    if quantity == "speed" and plain == "ms":  # a speed is never in milliseconds
        return "m/s"
    unit = _SPELLINGS.get(plain)
    return unit if unit in UNITS[quantity] else None


def is_row_of_units(cells: Sequence[str]) -> bool:
    """Return whether cells below a header are units: no number or time, and a known unit."""
    if any(DATE.match(cell) or read_time(cell, 0) is not None for cell in cells):
        return False
    return any(cell.strip("[]() ").lower() in _SPELLINGS for cell in cells)


_LATEST_NS: Final = 2**62

_MOST_DIGITS: Final = 20  # digits before the point; nanoseconds of 64 bits have no more

DATE: Final = re.compile(
    r"\s*+(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d:\d\d)(?:[.,](\d++))?"
    r"\s*+(Z|[+-]\d\d:?\d\d)?\s*+\Z",
    re.ASCII,
)


EPOCHS: Final = ((1e18, "ns"), (1e15, "us"), (1e12, "ms"), (1e9, "s"))
"""Smallest time since 1970 in each unit. The ranges last from 2001 to 2286."""

_LONGEST_STEP: Final = 1000.0
"""Largest usual step between rows that is read as seconds if the unit is unknown [s]."""


def guess_time_unit(name: str, numbers: NDArray[np.float64]) -> tuple[str, bool]:
    """Return the unit of the times in a column, and whether they are since 1970."""
    for least, unit in EPOCHS:
        if least <= numbers[0] < 10 * least:
            return unit, True
    step = float(np.median(np.abs(np.diff(numbers)))) if len(numbers) > 1 else 0.0
    if step > _LONGEST_STEP:
        units = UNITS["time"]  # the steps of most tables are near 0.05 s
        unit = min(units, key=lambda unit: abs(math.log10(step * units[unit] / 0.05)))
        raise LogError(
            f"column {name}: expected a time with its unit, found steps of {step:g}, which are no"
            f" seconds: --column t='{name} [{unit}]' names the unit (s, ms, us, ns)"
        )
    return "s", False


def read_time(cell: Any, power: int) -> int | None:
    """Return a time in a unit of 10**power ns as exact nanoseconds; None if it is not a number."""
    try:
        number = Decimal(str(cell))
    except InvalidOperation:
        return None
    if not number.is_finite() or number.adjusted() > _MOST_DIGITS:
        return None
    time_ns = round(number.scaleb(power))
    return time_ns if abs(time_ns) <= _LATEST_NS else None


_CLOCK: Final = re.compile(r"\s*(\d{1,2}):([0-5]\d):([0-5]\d)(?:[.,](\d+))?\s*\Z", re.ASCII)
"""A time of the day, `23:59:50.25`."""


def read_clock(cell: str) -> int | None:
    """Return a time of the day as nanoseconds since midnight; None for other texts."""
    if (match := _CLOCK.match(cell)) is None:
        return None
    seconds = (int(match[1]) * 60 + int(match[2])) * 60 + int(match[3])
    return seconds * 1_000_000_000 + int((match[4] or "0")[:9].ljust(9, "0"))


def read_date(cell: str) -> int | None:
    """Return an ISO 8601 time, by default of UTC, as nanoseconds since 1970; None for others."""
    if (match := DATE.match(cell)) is None:
        return None
    try:
        at = datetime.fromisoformat(f"{match[1]}T{match[2]}{match[4] or '+00:00'}")
    except ValueError:
        return None
    seconds = (at - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(seconds=1)
    return seconds * 1_000_000_000 + int((match[3] or "0")[:9].ljust(9, "0"))


TIMES: Final = ((DATE, read_date, "date"), (_CLOCK, read_clock, "time of the day"))
"""Texts of times: their pattern, their reader, and what they are."""


_LONGEST_STEP_S: Final = 5.0
"""Largest usual step that is not doubted if seconds are assumed [s]: satellite loggers save a pose
every few seconds. In milliseconds, this is 200 Hz."""

_FASTEST_M_S: Final = 100.0
"""Largest usual speed that is not doubted in metres [m/s]: a racing car's, or 0.1 m/s in mm."""

_CRAWL_M_S: Final = 0.01

_LEAST_EXTENT_M: Final = 0.1
"""Speed below which a robot crawls for all of its way, which is not within its own noise, so that
whole numbers of seconds are doubted [m/s, m]: slower than what counts as rest."""

_CURVE_NS: Final = 500_000_000

_STRONGEST_M_S2: Final = 49.0
"""Time over which accelerations are measured [ns], and the largest that is not doubted in a tenth
of it [m/s^2]: 5 g, as racing cars reach. 0.5 m/s and 1 rad/s in cm are 50 m/s^2."""

_ACCELERATED: Final = 0.9

_FEWEST_CURVES: Final = 12

_SECOND_NS: Final = 1_000_000_000

_SLOWEST_NS: Final = 2 * _SECOND_NS
"""Shortest usual step between times in whole seconds that is doubted [ns]: many a log has one row a
second, and few robots have a pose every ms."""


def describe_units(
    time_ns: NDArray[np.int64], xy_m: NDArray[np.float64], columns: Mapping[str, str] | None
) -> str:
    """Return a sentence on doubtful units of `columns` in assumed s and m; empty without doubt.

    The metres of a bag are doubted without columns.
    """
    step_s = np.diff(time_ns) / 1e9
    if not len(step_s):
        return ""
    usual_s = float(np.median(step_s))
    if columns and "t" in columns and usual_s > _LONGEST_STEP_S:
        step = format_short(usual_s, "s")
        option = f"--column t='{columns['t']} [ms]'"
        return f"times are assumed to be in s, so poses are {step} apart; if they are ms: {option}"
    is_apart = np.diff(time_ns) >= CROWDED_NS  # poses of one time tell no speed
    if not is_apart.any():
        return ""
    way_m = np.hypot(*np.diff(xy_m, axis=0).T)
    usual_m_s = float(np.median(way_m[is_apart] / step_s[is_apart]))
    speed = format_short(usual_m_s, "m/s")
    if columns is None and usual_m_s > _FASTEST_M_S:
        return f"x and y are read in m, so {speed} is usual; they may be in mm"
    if columns and {"x", "y"} <= {*columns} and usual_m_s > _FASTEST_M_S:
        option = " ".join(f"--column {axis}='{columns[axis]} [mm]'" for axis in "xy")
        return f"x and y are assumed to be in m, so {speed} is usual; if they are mm: {option}"
    columns = columns or {}
    return _describe_curves(time_ns, xy_m, columns) or _describe_crawl(time_ns, xy_m, columns)


def _describe_curves(time_ns: TimesNs, xy_m: Values, columns: Mapping[str, str]) -> str:
    """Return a sentence on positions whose accelerations no robot on the ground has in metres."""
    rows = thin_rows(time_ns, _CURVE_NS)
    if not {"x", "y"} <= {*columns} or len(rows) < _FEWEST_CURVES:
        return ""
    step_s = np.diff(time_ns[rows]) / 1e9
    speeds_m_s = np.diff(xy_m[rows], axis=0) / step_s[:, np.newaxis]
    change_m_s = np.hypot(*np.diff(speeds_m_s, axis=0).T)
    strong = float(np.quantile(change_m_s / ((step_s[1:] + step_s[:-1]) / 2.0), _ACCELERATED))
    if strong <= _STRONGEST_M_S2:
        return ""
    option = " ".join(f"--column {axis}='{columns[axis]} [cm]'" for axis in "xy")
    found = (
        f"x and y are assumed to be in m, so accelerations reach {format_short(strong, 'm/s^2')}"
    )
    return f"{found}; if they are cm (or mm): {option}"


def _describe_crawl(time_ns: TimesNs, xy_m: Values, columns: Mapping[str, str]) -> str:
    """Return a sentence on times in whole seconds in which a robot is never faster than rest."""
    step_ns = np.diff(time_ns)
    if "t" not in columns or (step_ns % _SECOND_NS).any() or not step_ns.all():
        return ""
    if float(np.median(step_ns)) < _SLOWEST_NS:
        return ""
    fastest_m_s = float(np.quantile(np.hypot(*np.diff(xy_m, axis=0).T) / (step_ns / 1e9), 0.99))
    if fastest_m_s > _CRAWL_M_S or float(np.ptp(xy_m, axis=0).max()) < _LEAST_EXTENT_M:
        return ""
    step, speed = (
        format_short(float(np.median(step_ns)) / 1e9, "s"),
        format_short(fastest_m_s, "m/s"),
    )
    option = f"--column t='{columns['t']} [ms]'"
    slow = f"so poses are {step} apart and the robot drives at most {speed}"
    return f"times are assumed to be in s, {slow}; if they are ms: {option}"


_PIECES: Final = 100
"""Number of pieces of a path whose directions are compared with headings."""

_STRAIGHT: Final = 0.5
"""Smallest distance between the ends of a piece, as a share of its length, of a moving robot."""

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
    """Return the directions of travel; None if the robot hardly moves, or scatters."""
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


def _measure_misfit(travel: Travel, heading_rad: Values) -> float:
    """Return the mean angle of headings to the line of travel [rad]; random ones give pi/4."""
    sums = np.concatenate([[0.0], np.cumsum(np.exp(1j * heading_rad))])
    mean_rad = np.angle(sums[travel.lasts + 1] - sums[travel.firsts])
    off_rad = np.abs(np.angle(np.exp(2j * (mean_rad - travel.course_rad)))) / 2.0
    return float(np.average(off_rad, weights=travel.length_m))


_WELL_RAD: Final = 0.2
"""Largest misfit of headings that fit the travel [rad]: noise, and a robot that slips sideways."""

_TURNED_DEG: Final = 30.0
"""Smallest range of headings that shows degrees [deg]; no path turns by so many radians."""

CURVED_RAD: Final = 0.5
"""Smallest range of directions that shows how headings count [rad]; one direction fits any
offset."""

_FOLLOWED: Final = 0.5
"""Largest misfit of few degrees, as a share of that of one direction, which fits a straight path:
headings follow the turns."""

_BADLY_RAD: Final = 0.5
"""Misfit from which headings contradict the travel [rad]: no robot on wheels slips by 30 deg."""


def fits_degrees(xy_m: Values, headings: Values) -> bool:
    """Return whether the direction of travel shows that headings are in degrees, not in radians."""
    known = np.isfinite(xy_m).all(axis=1) & np.isfinite(headings)
    xy_m, headings = xy_m[known], headings[known]
    travel = find_travel(xy_m) if len(headings) > 1 else None
    if travel is None:
        return False
    in_deg, in_rad = (_measure_misfit(travel, one) for one in (np.radians(headings), headings))
    if np.ptp(headings) >= _TURNED_DEG:
        return in_deg <= _WELL_RAD and in_deg < in_rad
    middle_rad = np.full(len(headings), np.angle(np.exp(2j * travel.course_rad).sum()) / 2.0)
    follows = in_deg <= _FOLLOWED * _measure_misfit(travel, middle_rad)
    return follows and in_deg <= _WELL_RAD and in_rad > _BADLY_RAD


def describe_headings(xy_m: Values, heading_rad: Values, *, column: str, is_assumed: bool) -> str:
    """Return a sentence on headings that contradict the direction of travel; else nothing.

    The name of their column is empty if rotations are quaternions; radians may be assumed.
    """
    travel = find_travel(xy_m) if len(xy_m) > 1 else None
    if travel is None or (misfit_rad := _measure_misfit(travel, heading_rad)) <= _BADLY_RAD:
        return ""
    off = f"{math.degrees(misfit_rad):.0f} deg"
    found = f"headings and direction of travel differ by {off} on average"
    ways = (("deg", 1.0), ("compass", -1.0)) if is_assumed else (("compass", -1.0),)
    scale = math.pi / 180.0 if is_assumed else 1.0
    turned_rad = float(np.ptp(np.unwrap(travel.course_rad, period=math.pi)))
    for unit, sign in ways if column and turned_rad >= CURVED_RAD else ():
        other_rad = sign * scale * heading_rad + (0.0 if unit == "deg" else math.pi / 2.0)
        if _measure_misfit(travel, other_rad) <= _WELL_RAD:
            words = "degrees" if unit == "deg" else "a compass (0 is north, clockwise)"
            return f"{found}, but fit {words}: --column heading='{column} [{unit}]'"
    read = " (assumed in rad)" if is_assumed else ""
    course = "; --column heading=course takes the travel instead" if column else ""
    return f"{found}: the robot drives sideways, or the headings{read} are wrong{course}"
