"""Whether what odometry reports as its rates can be: held against the way that its poses tell."""

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]

REPORTED_RATES: Final = "reported_rates"
"""Note on rates of odometry that are left out or turned."""

SPEED: Final = "measured_speed"
LATERAL: Final = "measured_lateral_speed"
TURN_RATE: Final = "measured_turn_rate"

MOVED_M: Final = 0.1
"""A robot that moves as far [m] without a jump was under way: noise of standing robots is less."""

TURNED_RAD: Final = 0.2
"""Likewise of its heading [rad]."""

_JUMPS: Final = 0.99
"""Steps above this quantile may be jumps, which corrections make of a robot that stands."""

_STRIDE_NS: Final = 200_000_000
"""Time over which poses are differenced [ns]: 1 mm of noise is 7 mm/s then."""

_SLOWEST_M_S: Final = 0.05
"""Differences of twist and way below this rms [m/s] may be noise."""

_MUCH_BETTER: Final = 3.0
"""How many times better twists have to fit the world's axes than the robot's to be taken as such;
those of a robot that never turns away from the x axis fit both."""


def judge_rates(
    time_ns: NDArray[np.int64], columns: Mapping[str, Values]
) -> tuple[dict[str, Values], dict[str, str]]:
    """Return the columns of poses with rates that are the robot's own, and a note on what changed.

    Twists that were never set are all zeros; such rates are left out where the poses move. Twists
    along the axes of the world, a common fault, are turned into the robot's.

    Args:
        time_ns: When each pose was [ns], shape (n,), not decreasing.
        columns: x, y [m], heading [rad] and what is reported [m/s or rad/s], each shape (n,).
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
    return left, {REPORTED_RATES: "; ".join(notes)} if notes else {}


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


def _measure_range(values: Values) -> float:
    """Return the largest extent of a way along any axis, without its few longest steps."""
    steps = np.diff(values, axis=0)
    length = np.hypot.reduce(steps, axis=1)
    steps[length > np.quantile(length, _JUMPS)] = 0.0
    way = np.vstack([np.zeros_like(steps[:1]), np.cumsum(steps, axis=0)])
    return float(np.ptp(way, axis=0).max())


def _turn_twists(
    time_ns: NDArray[np.int64], columns: Mapping[str, Values], lateral: Values
) -> Values | None:
    """Return the forward speed of twists along the world's axes, None of any others."""
    rows = np.unique(np.searchsorted(time_ns, np.arange(time_ns[0], time_ns[-1], _STRIDE_NS)))
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


def _compare(twists: Values, rows: NDArray[np.int64], velocities: Values) -> float:
    """Return the median distance between mean twists from row to row and velocities [m/s]."""
    sums = np.vstack([np.zeros((1, 2)), np.cumsum((twists[1:] + twists[:-1]) / 2.0, axis=0)])
    means = np.diff(sums[rows], axis=0) / np.diff(rows)[:, np.newaxis]
    return float(np.median(np.hypot(*(means - velocities).T)))
