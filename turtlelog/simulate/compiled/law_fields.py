"""Which numbers the compiled loop takes of a law, of its path, its schedule and its signal."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.laws import SequentialP, SequentialPID, find_law
from turtlelog.laws.kanayama import Kanayama
from turtlelog.laws.open_loop import MOST_ROWS, TAPS, OpenLoop, build_signal
from turtlelog.laws.posture import Posture
from turtlelog.laws.pure_pursuit import PurePursuit
from turtlelog.laws.schedule import DISTANCE
from turtlelog.paths import MOST_POINTS, Path, PathFollower
from turtlelog.scenario import Scenario

LAWS: Final[tuple[type[Any], ...]] = (
    SequentialP,
    SequentialPID,
    Posture,
    Kanayama,
    PurePursuit,
    OpenLoop,
)
"""Laws that are compiled; the sequential ones are one, whose terms are 0 in the first."""
SEQUENTIAL, POSTURE, KANAYAMA, PURE_PURSUIT, OPEN_LOOP = range(5)

SIGNALS: Final = ("sequence", "impulse", "step", "ramp", "prbs")
"""Signals of the open loop by number."""
SEQUENCE, IMPULSE, STEP, RAMP, PRBS = range(5)

PLAIN_KEYS: Final = (
    *("law.gamma", "law.k", "law.h", "law.kx", "law.ky", "law.ktheta", "law.lookahead_m"),
    *("law.kp_along", "law.speed_m_s", "law.end_tolerance_m"),
)
"""Keys of laws, of which each is a number of the loop; 0 where the law has none of the name."""

SIGNAL_KEYS: Final = (
    *("law.signal", "law.axis", "law.amplitude", "law.start_s", "law.duration_s", "law.width_s"),
    *("law.bit_s", "law.order", "law.register"),
    *("law.time_s", "law.speed_m_s", "law.turn_rate_rad_s"),
)
"""Keys of the open loop, which `_derive_signal` and `fill_signal` read."""

TABLE_KEYS: Final = (
    "law.schedule",
    *(f"path.{one}" for one in ("kind", "points", "center_x_m", "center_y_m", "size_m")),
    *("path.closed", "path.speed_m_s"),
)
"""Keys of gains that change on the way and of the path, of which tables are made."""

SCHEDULED: Final = (
    *("kp_linear", "kp_angular", "ki_linear", "ki_angular", "kd_linear", "kd_angular"),
)
"""Gains that a schedule may have, in the order of its table."""

LAW_WHOLE: Final = (
    *("law", "schedule_entries", "has_distances", "has_goal_heading"),
    *("path_pieces", "path_is_closed", "path_has_speed"),
    *("signal", "signal_rows", "moves_speed", "moves_turn", "signal_shift", "excite_phase"),
    *("signal_start_ns", "signal_duration_ns", "signal_width_ns", "signal_bit_ns"),
)
"""Whole numbers of a law."""

LAW_REAL: Final = (
    *(key.replace(".", "_") for key in PLAIN_KEYS),
    *("arrival_rad", "path_length_m", "path_reach_m", "path_speed_m_s"),
    *("signal_amplitude", "signal_height"),
)
"""Other numbers of a law."""

PIECE: Final = np.dtype(
    [
        (name, np.float64)
        for name in ("start_m", "length_m", "x_m", "y_m", "heading_rad", "curvature_1_m")
    ]
)
"""A `PathPiece`."""

MOST_PIECES: Final = MOST_POINTS + 2
"""Behind the pieces of an open path stand its tangents, at the end and at the beginning."""

MOST_OF_SIGNAL: Final = max(MOST_ROWS, 2 ** max(TAPS) - 1)
"""Rows of a sequence, or bits of a PRBS."""


def derive_law(scenario: Scenario) -> dict[str, float]:
    """Return the values of `LAW_WHOLE` and `LAW_REAL`; what the law does not have is 0."""
    parameters = scenario.law.parameters
    law: type[Any] = find_law(scenario.law.kind)
    values: dict[str, float] = dict.fromkeys((*LAW_WHOLE, *LAW_REAL), 0)
    values["law"] = max(LAWS.index(law) - 1, SEQUENTIAL)
    if law is OpenLoop:
        return values | _derive_signal(parameters)
    for key in PLAIN_KEYS:
        values[key.replace(".", "_")] = getattr(parameters, key.removeprefix("law."), 0.0)
    heading_rad = scenario.goal.heading_rad
    values["has_goal_heading"] = heading_rad is not None
    values["arrival_rad"] = heading_rad or 0.0
    schedule = getattr(parameters, "schedule", None)
    if schedule is not None:
        values["schedule_entries"] = len(schedule.at)
        values["has_distances"] = schedule.over == DISTANCE
    return values | ({} if scenario.path is None else _derive_path(scenario.path))


def _derive_path(path: Path) -> dict[str, float]:
    return {
        "path_pieces": len(path.pieces),
        "path_is_closed": path.is_closed,
        "path_length_m": path.length_m,
        "path_reach_m": PathFollower(path).reach_m,
        "path_has_speed": path.speed_m_s is not None,
        "path_speed_m_s": path.speed_m_s or 0.0,
    }


def _derive_signal(parameters: Any) -> dict[str, float]:
    found = build_signal(parameters)
    return {
        "signal": SIGNALS.index(found.kind),
        "signal_rows": len(found.rows_ns) or len(found.bits),
        "moves_speed": found.axis != "turn_rate",
        "moves_turn": found.axis != "speed",
        "signal_shift": len(found.bits) // 2 if found.axis == "both" else 0,
        "excite_phase": parameters.begins_s > 0.0,
        "signal_start_ns": found.start_ns,
        "signal_duration_ns": found.duration_ns,
        "signal_width_ns": found.width_ns,
        "signal_bit_ns": found.bit_ns,
        "signal_amplitude": found.amplitude,
        "signal_height": found.amplitude / found.width_s,
    }


def fill_schedule(scenario: Scenario) -> NDArray[np.float64]:
    """Return the table of gains that change on the way, of no entries where none do.

    Shape (entries, 7): distances or heading errors, then the gains of `SCHEDULED`, NaN where one
    is constant.
    """
    schedule = getattr(scenario.law.parameters, "schedule", None)
    if schedule is None:
        return np.empty((0, 1 + len(SCHEDULED)))
    table = np.full((len(schedule.at), 1 + len(SCHEDULED)), np.nan)
    table[:, 0] = schedule.at
    for place, name in enumerate(SCHEDULED, start=1):
        if name in schedule.gains:
            table[:, place] = getattr(schedule, name)
    return table


def fill_pieces(path: Path | None) -> NDArray[Any]:
    """Return the pieces of a path, of an open one with its tangents, shape (pieces + 2,)."""
    if path is None:
        return np.empty(0, PIECE)
    first, last = path.pieces[0], path.pieces[-1]
    tangents = last.go_straight(last.length_m), first.go_straight(0.0)
    return np.array([piece[1:] for piece in (*path.pieces, *tangents)], PIECE)


def fill_signal(parameters: Any) -> NDArray[np.float64]:
    """Return time [ns], speed and turn rate of each row of a sequence, or the bits of a PRBS.

    Shape (rows, 3), where a bit stands in each column.
    """
    if not isinstance(parameters, OpenLoop.Parameters):
        return np.empty((0, 3))
    found = build_signal(parameters)
    if found.bits:
        return np.repeat(np.array(found.bits, np.float64)[:, None], 3, axis=1)
    rows = [*zip(found.rows_ns, found.speeds, found.turn_rates, strict=True)]
    return np.array(rows, np.float64).reshape(-1, 3)


def is_covered(scenario: Scenario) -> bool:
    """Whether the law of a scenario is compiled; one that tracks a path needs one."""
    law: type[Any] = find_law(scenario.law.kind)
    tracks = law in {Kanayama, PurePursuit}
    return law in LAWS and (scenario.path is not None or not tracks)
