"""Step and gain schedules of the sequential laws: rotate, then translate, each with u = P + I + D.

The P term is Kp e. The I and D terms follow Astrom and Wittenmark, Computer-Controlled Systems,
chapter 8: I by forward Euler, D of the measurement by backward Euler. Both terms begin every phase
at 0. The first sample only computes the goal bearing.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from itertools import pairwise
from typing import Any, Final, Literal, NoReturn

from turtlelog.arithmetic import (
    Direction,
    called,
    clip,
    count_begun,
    find_direction,
    hypot,
    least,
    most,
    wrap_angle,
)
from turtlelog.errors import ParameterError
from turtlelog.run import stop_reasons

ROTATE, TRANSLATE, REORIENT = 0, 2, 3
"""Numbers of the phases in the declaration; 1 is the pause."""

STOPS: Final = (
    stop_reasons.WITHIN_TOLERANCE,
    stop_reasons.STANDSTILL,
    stop_reasons.SETTLED,
    stop_reasons.TIMEOUT,
)
WITHIN_TOLERANCE, STANDSTILL, SETTLED, TIMEOUT = 1, 2, 3, 4

ON_HEADING: Final = 1
"""Number of `heading`, the second value of `projection`."""

CLAMPING, BACK_CALCULATION = 1, 2
"""Numbers of the second and third value of `anti_windup`."""

SCHEDULED: Final = (
    *("kp_linear", "kp_angular", "ki_linear", "ki_angular", "kd_linear", "kd_angular"),
)
"""Gains that a schedule may contain, in the order of its table."""


@dataclass(slots=True, kw_only=True)
class SequentialNumbers:
    """Keys of both sequential laws as numbers.

    `has_distances` and `entries` describe the schedule.
    """

    kp_angular: float = 1.0
    kp_linear: float = 1.0
    ki_angular: float = 0.0
    ki_linear: float = 0.0
    kd_angular: float = 0.0
    kd_linear: float = 0.0
    heading_tolerance_rad: float = 0.001
    position_tolerance_m: float = 0.001
    projection: int = ON_HEADING
    wrap_error: bool = True
    pause_ticks: int = 0
    timeout_s: float = 30.0
    settled_within_m: float = 0.01
    settled_for_s: float = 5.0
    standstill_samples: int = 100
    standstill_below: float = 0.001
    reorient: bool = False
    derivative_filter_s: float = 0.0
    anti_windup: int = CLAMPING
    tracking_time_s: float = 1.0
    entries: int = 0
    has_distances: bool = False


@dataclass(slots=True)
class Terms:
    """Gains, integral and derivative of one loop, and the contributions of both to the command.

    Attributes:
        kp: Proportional gain. A schedule changes kp, ki and kd.
        has_terms: Whether the loop has an integral or a derivative. Without integral and derivative
            nothing is added, because -0.0 + 0.0 is 0.0.
        has_integral: Whether the loop has an integral.
        integral: Contribution of the integral to the command of this sample.
        derivative: Contribution of the derivative to the command of this sample.
        error_rate: Rate at which the integral grows until the next sample.
        excess: Excess of the command over its limit, if the integral tracks the clipped command.
        last_ns: Time of the last sample [ns].
    """

    kp: float = 0.0
    ki: float = 0.0
    kd: float = 0.0
    has_terms: bool = False
    has_integral: bool = False
    integral: float = 0.0
    derivative: float = 0.0
    error_rate: float = 0.0
    excess: float = 0.0
    last_ns: int = 0


@dataclass(slots=True)
class SequentialState:
    """State of a sequential law. The recorded numbers are the last fields."""

    phase: int = -1
    begun: int = -1
    first_ns: int = 0
    still_samples: int = 0
    close_since_ns: int = -1
    bearing_rad: float = 0.0
    goal_heading_rad: float = 0.0
    heading_error_rad: float = 0.0
    world_v_x_m_s: float = 0.0
    world_v_y_m_s: float = 0.0
    heading_before_rad: float = 0.0
    error_before_x_m: float = 0.0
    error_before_y_m: float = 0.0
    along: Direction = field(default_factory=Direction)
    speed: Terms = field(default_factory=Terms)
    turn: Terms = field(default_factory=Terms)
    integral_angular: float = 0.0
    derivative_angular: float = 0.0
    integral_linear: float = 0.0
    derivative_linear: float = 0.0


def step(
    settings: Any, state: Any, table: Any, row: Any, time_ns: int, pose: tuple[float, float, float]
) -> tuple[float, float]:
    """Answer one pose."""
    law, goal = settings.law, settings.goal
    x_m, y_m = goal.x_m - pose[0], goal.y_m - pose[1]
    row.error_x_m, row.error_y_m = x_m, y_m
    row.distance_m = hypot(x_m, y_m)
    if state.begun >= 0:  # otherwise all of them are 0
        state.integral_angular = state.derivative_angular = 0.0
        state.integral_linear = state.derivative_linear = 0.0
    phase, speed, turn_rate = state.phase, 0.0, 0.0
    if law.entries > 0 and phase >= 0:
        _follow_schedule(law, state, table, row.distance_m, pose[2])
    row.world_v_x_m_s = row.world_v_y_m_s = 0.0
    if phase == TRANSLATE:
        speed = _translate(settings, state, row, time_ns, pose[2])
        row.world_v_x_m_s, row.world_v_y_m_s = state.world_v_x_m_s, state.world_v_y_m_s
    elif phase == ROTATE:
        turn_rate = _rotate(settings, state, row, time_ns, pose[2])
    elif phase == REORIENT:
        turn_rate = _reorient(settings, state, row, time_ns, pose[2])
    else:
        phase = ROTATE
        _begin(settings, state, table, time_ns, math.atan2(y_m, x_m))
    row.phase = phase
    row.bearing_rad, row.heading_error_rad = state.bearing_rad, state.heading_error_rad
    return speed, turn_rate


def _begin(settings: Any, state: Any, table: Any, time_ns: int, bearing_rad: float) -> None:
    law = settings.law
    state.phase, state.first_ns = ROTATE, time_ns
    state.bearing_rad = bearing_rad
    if law.reorient:
        state.goal_heading_rad = wrap_angle(settings.goal.heading_rad)
    speed, turn = state.speed, state.turn
    speed.kp, speed.ki, speed.kd = law.kp_linear, law.ki_linear, law.kd_linear
    turn.kp, turn.ki, turn.kd = law.kp_angular, law.ki_angular, law.kd_angular
    speed.has_integral, turn.has_integral = law.ki_linear != 0.0, law.ki_angular != 0.0
    speed.has_terms = speed.has_integral or law.kd_linear != 0.0
    turn.has_terms = turn.has_integral or law.kd_angular != 0.0
    if law.entries > 0:
        speed.has_integral = speed.has_integral or not math.isnan(table[0][3])
        turn.has_integral = turn.has_integral or not math.isnan(table[0][4])
        derives, turn_derives = not math.isnan(table[0][5]), not math.isnan(table[0][6])
        speed.has_terms = speed.has_terms or speed.has_integral or derives
        turn.has_terms = turn.has_terms or turn.has_integral or turn_derives


@called
def _follow_schedule(
    law: Any, state: Any, table: Any, distance_m: float, heading_rad: float
) -> None:
    """Set the scheduled gains, by the distance or by the error of the last active heading loop."""
    wanted_rad = state.goal_heading_rad if state.phase == REORIENT else state.bearing_rad
    place = distance_m if law.has_distances else abs(_find_error(law, wanted_rad, heading_rad))
    after, last = count_begun(table, law.entries, place), law.entries - 1
    low, high = min(max(after - 1, 0), last), min(after, last)
    part = 0.0
    if after > 0 and low < high:
        part = (place - table[low][0]) / (table[high][0] - table[low][0])
    for column in range(1, 7):
        gain = table[low][column]
        if part != 0.0:
            gain += part * (table[high][column] - gain)
        if not math.isnan(gain):
            _enter_gain(state.speed if column % 2 == 1 else state.turn, column, gain)


def _find_error(law: Any, wanted_rad: float, heading_rad: float) -> float:
    error_rad = wanted_rad - heading_rad
    return wrap_angle(error_rad) if law.wrap_error else error_rad


def _enter_gain(terms: Any, column: int, gain: float) -> None:
    if column <= 2:
        terms.kp = gain
    elif column <= 4:
        terms.ki = gain
    else:
        terms.kd = gain


def _rotate(settings: Any, state: Any, row: Any, time_ns: int, heading_rad: float) -> float:
    """Return the turn rate. If the rotation ends, switch to the next phase."""
    law = settings.law
    state.heading_error_rad = error_rad = _find_error(law, state.bearing_rad, heading_rad)
    if abs(error_rad) > law.heading_tolerance_rad:
        return _turn(settings, state, time_ns, heading_rad)
    state.phase, row.blocks_ticks, row.ends_phase = TRANSLATE, law.pause_ticks, True
    return 0.0


def _reorient(settings: Any, state: Any, row: Any, time_ns: int, heading_rad: float) -> float:
    law = settings.law
    state.heading_error_rad = error_rad = _find_error(law, state.goal_heading_rad, heading_rad)
    if abs(error_rad) <= law.heading_tolerance_rad:
        row.stop = WITHIN_TOLERANCE
        return 0.0
    if time_ns - state.first_ns > law.timeout_s * 1e9:
        row.stop = TIMEOUT
    return _turn(settings, state, time_ns, heading_rad)


def _turn(settings: Any, state: Any, time_ns: int, heading_rad: float) -> float:
    """Return the turn rate for a heading error, including integral and derivative terms."""
    terms, error_rad = state.turn, state.heading_error_rad
    turn_rate: float = terms.kp * error_rad
    if not terms.has_terms:
        return turn_rate
    turned_rad = wrap_angle(heading_rad - state.heading_before_rad)
    state.heading_before_rad = heading_rad
    _advance_terms(settings.law, state, terms, time_ns, turned_rad)
    state.integral_angular, state.derivative_angular = terms.integral, terms.derivative
    limit = settings.limits.turn_rate_rad_s
    return _add_terms(settings.law, terms, turn_rate, error_rad, limit)


def _translate(settings: Any, state: Any, row: Any, time_ns: int, heading_rad: float) -> float:
    """Return the speed."""
    # If the translation ends, set the stop reason or switch to the next phase.
    law, terms = settings.law, state.speed
    x_m, y_m = row.error_x_m, row.error_y_m
    stop, speed = WITHIN_TOLERANCE, 0.0
    if abs(x_m) > law.position_tolerance_m or abs(y_m) > law.position_tolerance_m:
        state.world_v_x_m_s, state.world_v_y_m_s = terms.kp * x_m, terms.kp * y_m
        along_rad = heading_rad if law.projection == ON_HEADING else state.bearing_rad
        cos, sin = find_direction(state.along, along_rad)
        speed = state.world_v_x_m_s * cos + state.world_v_y_m_s * sin
        if terms.has_terms:
            way_m = (state.error_before_x_m - x_m) * cos + (state.error_before_y_m - y_m) * sin
            state.error_before_x_m, state.error_before_y_m = x_m, y_m
            _advance_terms(law, state, terms, time_ns, way_m)
            state.integral_linear, state.derivative_linear = terms.integral, terms.derivative
            along_m, limit = x_m * cos + y_m * sin, settings.limits.speed_m_s
            speed = _add_terms(law, terms, speed, along_m, limit)
        stop = _find_stop(law, state, time_ns, speed, most(abs(x_m), abs(y_m)))
    if stop in (0, TIMEOUT) or not law.reorient:
        row.stop = stop
    else:
        state.phase, row.ends_phase = REORIENT, True
    return speed


def _find_stop(law: Any, state: Any, time_ns: int, speed: float, error_m: float) -> int:
    still = abs(speed) < law.standstill_below
    state.still_samples = state.still_samples + 1 if still else 0
    if state.still_samples > law.standstill_samples:
        return STANDSTILL
    if error_m >= law.settled_within_m:
        state.close_since_ns = -1
    elif state.close_since_ns < 0:
        state.close_since_ns = time_ns
    elif time_ns - state.close_since_ns > law.settled_for_s * 1e9:
        return SETTLED
    return TIMEOUT if time_ns - state.first_ns > law.timeout_s * 1e9 else 0


def _advance_terms(law: Any, state: Any, terms: Any, time_ns: int, moved: float) -> None:
    """Start the integral and derivative of a phase, or continue them to a sample."""
    # The samples of a burst have the same time: the integral and the derivative do not change.
    if state.begun != state.phase:
        state.begun = state.phase
        terms.integral = terms.derivative = terms.error_rate = terms.excess = 0.0
        terms.last_ns = time_ns
        return
    step_s = (time_ns - terms.last_ns) / 1e9
    terms.last_ns = time_ns
    if step_s <= 0.0:
        return
    # No further back than to the limit, where a step is longer than the tracking time.
    back = least(step_s / law.tracking_time_s, 1.0)
    terms.integral += step_s * terms.error_rate - back * terms.excess
    filter_s = law.derivative_filter_s
    terms.derivative = (filter_s * terms.derivative - terms.kd * moved) / (filter_s + step_s)


def _add_terms(law: Any, terms: Any, proportional: float, error: float, limit: float) -> float:
    """Return the command, and store the rate of the integral."""
    command: float = proportional + terms.integral + terms.derivative
    if not terms.has_integral:
        return command
    excess = command - clip(command, limit)
    error_rate = terms.ki * error
    if law.anti_windup == CLAMPING and excess * error_rate > 0.0:
        error_rate = 0.0
    terms.error_rate = error_rate
    terms.excess = excess if law.anti_windup == BACK_CALCULATION else 0.0
    return command


# Gain schedules: gains from a table over the distance to the goal, or over the heading error.

DISTANCE: Final = "distance"

MOST_ENTRIES: Final = 1000
"""Largest number of entries of a schedule, whose table is part of every recording and scenario
text. 1,000 entries are one per 16 mm of the longest path in turtlesim's world, and 10 KB of text
for each gain."""

_POSITIVE: Final = ("kp_angular", "kp_linear")
"""Gains that must be above 0, like the constant ones; other gains may be 0."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GainSchedule:
    """Gain schedule of a sequential law. Gains that are left out stay constant.

    Gains are linearly interpolated between entries. Outside the table, the first or last entry
    holds.

    Attributes:
        over: Variable of the gains: the `distance` from the pose to the goal [m], or the magnitude
            of the `heading_error` [rad].
        at: Distances or heading errors of the entries, rising, >= 0 [m or rad].
        kp_angular: Gain of the heading loops at each entry, > 0 [1/s].
        kp_linear: Gain of the position loop at each entry, > 0 [1/s].

    Raises:
        ParameterError: One line with the key, what was expected and what was found.
    """

    over: Literal["distance", "heading_error"]
    at: tuple[float, ...]
    kp_angular: tuple[float, ...] | None = None
    kp_linear: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if self.over not in {DISTANCE, "heading_error"}:
            _refuse("over", "distance or heading_error", self.over)
        for name in ("at", *self.gains):
            object.__setattr__(self, name, _read_numbers(name, getattr(self, name)))
        self._require_places()
        for name in self.gains:
            if len(getattr(self, name)) != len(self.at):
                entries = f"{len(self.at)} entries, one for each of at"
                _refuse(name, entries, len(getattr(self, name)))
        if not self.gains:
            known = " or ".join(_list_gains(self))
            raise ParameterError(f"over: expected {known} beside it, found no gain")

    def _require_places(self) -> None:
        if not 2 <= len(self.at) <= MOST_ENTRIES:
            _refuse("at", f"2 to {MOST_ENTRIES} entries", len(self.at))
        for low, high in pairwise(self.at):
            if not low < high:
                _refuse("at", "rising numbers", f"{high:g} after {low:g}")

    @property
    def gains(self) -> tuple[str, ...]:
        """Names of the gains that are scheduled."""
        return tuple(name for name in _list_gains(self) if getattr(self, name) is not None)


@dataclass(frozen=True, slots=True, kw_only=True)
class PIDGainSchedule(GainSchedule):
    """Gain schedule of `sequential-pid`. Gains that are left out stay constant.

    Attributes:
        ki_angular: Integral gain of the heading loops at each entry of `at`, >= 0 [1/s^2].
        kd_angular: Derivative gain of the heading loops, >= 0 [1].
        ki_linear: Integral gain of the position loop, >= 0 [1/s^2].
        kd_linear: Derivative gain of the position loop, >= 0 [1].
    """

    ki_angular: tuple[float, ...] | None = None
    kd_angular: tuple[float, ...] | None = None
    ki_linear: tuple[float, ...] | None = None
    kd_linear: tuple[float, ...] | None = None


def _list_gains(schedule: GainSchedule) -> list[str]:
    return [field.name for field in fields(schedule) if field.name not in {"over", "at"}]


def _read_numbers(name: str, values: Any) -> tuple[float, ...]:
    """Return numbers as floats. Refuse negative numbers, and proportional gains of 0."""
    if isinstance(values, str) or not isinstance(values, Sequence):
        _refuse(name, "a list of numbers", values)
    least = "> 0" if name in _POSITIVE else ">= 0"
    for value in values:
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        is_valid = is_number and math.isfinite(value) and value >= 0
        if not is_valid or (value == 0 and name in _POSITIVE):
            _refuse(name, f"finite numbers {least}", value)
    return tuple(map(float, values))


def _refuse(name: str, expected: str, found: object) -> NoReturn:
    raise ParameterError(f"{name}: expected {expected}, found {found!s:.60}")
