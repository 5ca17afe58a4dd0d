"""What a law of the user's own answers: complete, and as plain numbers that are kept as they were.

A law may answer with numpy's numbers, with whole ones, or with a list that it goes on changing.
"""

from math import atan2, isinf
from operator import index
from typing import Any, Final

from turtlelog.angles import wrap_angle
from turtlelog.errors import SimulationError
from turtlelog.laws import Decision, Goal, Pose

_NO_GOAL: Final = float("nan")

_MOST_TICKS: Final = 2**31 - 1
"""Longest block: a year of ticks, whose nanoseconds fit into 64 bits."""


def complete_decision(found: object, pose: Pose, goal: Goal | None, first_phase: str) -> Decision:
    """Return a decision with what it leaves out; without a goal its errors are NaN.

    Raises:
        SimulationError: Where it is no decision, or one of its numbers is none.
    """
    if not isinstance(found, Decision):
        raise SimulationError(f"expected a Decision, found {found!r:.60}")
    if found.phase is not None and found.bearing_rad is not None and _is_plain(found):
        return found
    ahead_m = _NO_GOAL if goal is None else goal.x_m - pose.x_m
    left_m = _NO_GOAL if goal is None else goal.y_m - pose.y_m
    bearing_rad = atan2(left_m, ahead_m)
    turn_rad = _NO_GOAL if goal is None else wrap_angle(bearing_rad - pose.heading_rad)
    # Built anew: msgspec's replace takes three times as long.
    return Decision(
        speed_m_s=_read_number("speed_m_s", found.speed_m_s),
        turn_rate_rad_s=_read_number("turn_rate_rad_s", found.turn_rate_rad_s),
        phase=first_phase if found.phase is None else found.phase,
        bearing_rad=_read_error("bearing_rad", found.bearing_rad, bearing_rad),
        heading_error_rad=_read_error("heading_error_rad", found.heading_error_rad, turn_rad),
        error_x_m=_read_error("error_x_m", found.error_x_m, ahead_m),
        error_y_m=_read_error("error_y_m", found.error_y_m, left_m),
        world_v_x_m_s=_read_number("world_v_x_m_s", found.world_v_x_m_s),
        world_v_y_m_s=_read_number("world_v_y_m_s", found.world_v_y_m_s),
        states=_read_states(found.states),
        reference=None if found.reference is None else _read_pose(found.reference),
        blocks_ticks=_read_ticks(found.blocks_ticks),
        ends_phase=bool(found.ends_phase),
        stop_reason=found.stop_reason,
    )


def _is_plain(found: Decision) -> bool:
    """Return whether nothing is left out and all numbers are Python's own: no copy is needed."""
    if found.states or found.reference is not None or found.blocks_ticks or found.ends_phase:
        return False
    try:
        # A sum with a number of numpy is one of numpy's; one with None is none.
        total = found.speed_m_s + found.turn_rate_rad_s + found.world_v_x_m_s + found.world_v_y_m_s
        total += found.bearing_rad + found.heading_error_rad  # type: ignore[operator]
        total += found.error_x_m + found.error_y_m  # type: ignore[operator]
    except (TypeError, ValueError):
        return False
    return type(total) is float


def _read_number(name: str, value: Any) -> float:
    """Return a number of any kind as a float; an array of one is none."""
    if type(value) is float:
        return value
    try:
        if hasattr(value, "__float__") and not getattr(value, "shape", ()):
            return float(value)
    except (ValueError, OverflowError):
        pass
    raise SimulationError(f"{name}: expected a number, found {value!r:.60}")


def _read_error(name: str, value: Any, default: float) -> float:
    if value is None:
        return default
    number = _read_number(name, value)
    if isinf(number):
        raise SimulationError(f"{name}: expected a finite number, found {number}")
    return number


def _read_states(states: Any) -> tuple[float, ...]:
    if isinstance(states, str) or not hasattr(states, "__iter__"):
        raise SimulationError(f"states: expected a tuple of numbers, found {states!r:.60}")
    return tuple([_read_number(f"states[{place}]", value) for place, value in enumerate(states)])


def _read_pose(reference: Any) -> Pose:
    try:
        x_m, y_m, heading_rad = reference.x_m, reference.y_m, reference.heading_rad
    except AttributeError as err:
        raise SimulationError(f"reference: expected a Pose, found {reference!r:.60}") from err
    return Pose(
        _read_number("reference.x_m", x_m),
        _read_number("reference.y_m", y_m),
        _read_number("reference.heading_rad", heading_rad),
    )


def _read_ticks(value: Any) -> int:
    if hasattr(value, "__index__") and 0 <= value <= _MOST_TICKS:
        return index(value)
    expected = f"a whole number from 0 to {_MOST_TICKS}"
    raise SimulationError(f"blocks_ticks: expected {expected}, found {value!r:.60}")
