"""What a law of the user's own answers: complete, and as plain numbers that are kept as they were.

A law may answer with numpy's numbers, with whole ones, or with a list that it goes on changing.
"""

from math import atan2, hypot, isinf
from operator import index
from typing import Any, Final

from turtlelog.angles import wrap_angle
from turtlelog.errors import SimulationError
from turtlelog.laws import Decision, Goal, Pose

_NO_GOAL: Final = float("nan")

_FLOATS: Final = {float}

_NONE_BLOCKED: Final = Decision(speed_m_s=0.0, turn_rate_rad_s=0.0).blocks_ticks

_FAR_M: Final = 1e300
"""Up to here squares of errors are no matter: the distance is a number."""

_MOST_TICKS: Final = 2**31 - 1
"""Longest block: a year of ticks, whose nanoseconds fit into 64 bits."""


def complete_decision(found: object, pose: Pose, goal: Goal | None, first_phase: str) -> Decision:
    """Return a decision with what it leaves out; without a goal its errors are NaN.

    Raises:
        SimulationError: Where it is no decision, or one of its numbers is none.
    """
    if not isinstance(found, Decision):
        raise SimulationError(f"expected a Decision, found {found!r:.60}")
    # Most laws answer in plain floats, and these are looked at once: a sample takes 5 us in all.
    is_plain = (
        type(found.speed_m_s) is type(found.turn_rate_rad_s) is float
        and type(found.world_v_x_m_s) is type(found.world_v_y_m_s) is float
        and type(found.states) is tuple
        and (not found.states or {*map(type, found.states)} == _FLOATS)
        and found.reference is None
        and found.blocks_ticks is _NONE_BLOCKED
    )
    if not (is_plain and _has_plain_errors(found)):
        found = _read_decision(found)
    if (
        found.phase is not None
        and found.bearing_rad is not None
        and found.heading_error_rad is not None
        and found.error_x_m is not None
        and found.error_y_m is not None
    ):
        return found
    ahead_m = _NO_GOAL if goal is None else goal.x_m - pose.x_m
    left_m = _NO_GOAL if goal is None else goal.y_m - pose.y_m
    bearing_rad = atan2(left_m, ahead_m)
    turn_rad = _NO_GOAL if goal is None else wrap_angle(bearing_rad - pose.heading_rad)
    # Built anew: msgspec's replace takes three times as long.
    return Decision(
        speed_m_s=found.speed_m_s,
        turn_rate_rad_s=found.turn_rate_rad_s,
        phase=first_phase if found.phase is None else found.phase,
        bearing_rad=bearing_rad if found.bearing_rad is None else found.bearing_rad,
        heading_error_rad=(
            turn_rad if found.heading_error_rad is None else found.heading_error_rad
        ),
        error_x_m=ahead_m if found.error_x_m is None else found.error_x_m,
        error_y_m=left_m if found.error_y_m is None else found.error_y_m,
        world_v_x_m_s=found.world_v_x_m_s,
        world_v_y_m_s=found.world_v_y_m_s,
        states=found.states,
        reference=found.reference,
        blocks_ticks=found.blocks_ticks,
        ends_phase=found.ends_phase,
        stop_reason=found.stop_reason,
    )


def _has_plain_errors(found: Decision) -> bool:
    """Whether the errors are floats with a finite distance, or all left to us."""
    if found.bearing_rad is None:
        return found.heading_error_rad is found.error_x_m is found.error_y_m is None
    x_m, y_m = found.error_x_m, found.error_y_m
    return (
        type(found.bearing_rad) is type(found.heading_error_rad) is float
        and type(x_m) is type(y_m) is float
        and -_FAR_M < x_m < _FAR_M
        and -_FAR_M < y_m < _FAR_M
    )


def _read_decision(found: Decision) -> Decision:
    error_x_m = _read_error("error_x_m", found.error_x_m)
    error_y_m = _read_error("error_y_m", found.error_y_m)
    if isinf(hypot(error_x_m or 0.0, error_y_m or 0.0)):
        raise SimulationError(f"error: expected a finite distance, found {error_x_m}, {error_y_m}")
    if found.phase is not None and not isinstance(found.phase, str):
        raise SimulationError(f"phase: expected its name, found {found.phase!r:.60}")
    return Decision(
        speed_m_s=_read_number("speed_m_s", found.speed_m_s),
        turn_rate_rad_s=_read_number("turn_rate_rad_s", found.turn_rate_rad_s),
        phase=found.phase,
        bearing_rad=_read_error("bearing_rad", found.bearing_rad),
        heading_error_rad=_read_error("heading_error_rad", found.heading_error_rad),
        error_x_m=error_x_m,
        error_y_m=error_y_m,
        world_v_x_m_s=_read_number("world_v_x_m_s", found.world_v_x_m_s),
        world_v_y_m_s=_read_number("world_v_y_m_s", found.world_v_y_m_s),
        states=_read_states(found.states),
        reference=None if found.reference is None else _read_pose(found.reference),
        blocks_ticks=_read_ticks(found.blocks_ticks),
        ends_phase=bool(found.ends_phase),
        stop_reason=found.stop_reason,
    )


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


def _read_error(name: str, value: Any) -> float | None:
    if value is None:
        return None
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
