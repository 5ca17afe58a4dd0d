"""The paper's law: rotate on the spot, then translate, each with u = Kp e."""

import math
from dataclasses import dataclass, field, fields
from typing import Annotated, ClassVar, Final, Literal

from msgspec import Meta
from msgspec.structs import replace

from turtlelog.angles import wrap_angle
from turtlelog.errors import LawError
from turtlelog.laws.base import ABSENT_BY_DEFAULT, MAY_BE_INFINITE, TOLERANCE, Decision, Goal, Pose
from turtlelog.laws.schedule import DISTANCE, GainSchedule
from turtlelog.laws.sequential_loops import (
    DECLARATION,
    REORIENT,
    ROTATE,
    TRANSLATE,
    declare_loops,
)
from turtlelog.loops import Declaration, Mechanism
from turtlelog.paths import Path

__all__ = ["DECLARATION", "SequentialP", "SequentialPParameters"]

_MECHANISMS: Final = (
    Mechanism(
        name="pause",
        kind="effect",
        neutral={"law.pause_ticks": 0},
        meaning="no pause after the rotation",
    ),
    Mechanism(
        name="projection",
        kind="property",
        neutral={"law.projection": "heading"},
        meaning="projection on the current heading",
    ),
    Mechanism(
        name="wrap",
        kind="effect",
        neutral={"law.wrap_error": True},
        meaning="the error wrapped",
    ),
    TOLERANCE,
)

_RULE: Final = {**ABSENT_BY_DEFAULT, **MAY_BE_INFINITE}
"""Of a time in the rules that end a run; inf: that rule never does."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SequentialPParameters:
    """Parameters of the sequential proportional law.

    Attributes:
        kp_angular: Gain of the heading loop [1/s].
        kp_linear: Gain of the position loop [1/s].
        heading_tolerance_rad: Rotation ends when the heading error is no larger [rad].
        position_tolerance_m: Translation ends when neither error coordinate is larger [m].
        projection: What the world velocity is projected on: the goal `bearing`, as the paper's
            program does, or the current `heading`, as its equation 16 says.
        wrap_error: Whether the heading error is wrapped to [-pi, pi).
        pause_ticks: Ticks that the controller sleeps for after rotating [16 ms each].
        timeout_s: Translation ends this long after the first sample [s]; inf: never.
        settled_within_m: Error coordinates below this count as settled [m].
        settled_for_s: Translation ends when they have been settled for longer [s]; inf: never.
        standstill_samples: Translation ends after more consecutive samples at a standstill.
        standstill_below: A sample is at a standstill if its unclipped speed is below this [m/s].
        reorient: Whether a translation that does not end by the timeout is followed by a turn on
            the spot to the goal's heading, which it must have.
        schedule: Gains that change on the way and take the place of the constant ones; None: none.
    """

    kp_angular: Annotated[float, Meta(gt=0)] = 1.0
    kp_linear: Annotated[float, Meta(gt=0)] = 1.0
    heading_tolerance_rad: Annotated[float, Meta(gt=0)] = 0.001
    position_tolerance_m: Annotated[float, Meta(gt=0)] = 0.001
    projection: Literal["bearing", "heading"] = "heading"
    wrap_error: bool = True
    pause_ticks: Annotated[int, Meta(ge=0, le=1_000_000)] = 0
    timeout_s: Annotated[float, Meta(gt=0)] = field(default=30.0, metadata=_RULE)
    settled_within_m: Annotated[float, Meta(ge=0)] = field(default=0.01, metadata=ABSENT_BY_DEFAULT)
    settled_for_s: Annotated[float, Meta(ge=0)] = field(default=5.0, metadata=_RULE)
    standstill_samples: Annotated[int, Meta(ge=0, le=1_000_000)] = field(
        default=100, metadata=ABSENT_BY_DEFAULT
    )
    standstill_below: Annotated[float, Meta(ge=0)] = field(
        default=0.001, metadata=ABSENT_BY_DEFAULT
    )
    reorient: bool = field(default=False, metadata=ABSENT_BY_DEFAULT)
    schedule: GainSchedule | None = field(default=None, metadata=ABSENT_BY_DEFAULT)


class SequentialP:
    """Rotate to the goal bearing, then drive; the first callback only computes the bearing."""

    Parameters: ClassVar[type[SequentialPParameters]] = SequentialPParameters
    mechanisms: ClassVar = _MECHANISMS
    counts_samples: ClassVar = ("standstill_samples",)

    @classmethod
    def declare(
        cls, parameters: SequentialPParameters, goal: Goal | None, path: Path | None
    ) -> Declaration:
        """Return its loops, one after the other: two, or with `reorient` three.

        Raises:
            LawError: Where it is to reorient, and the goal has no heading.
        """
        del path
        return declare_loops(DECLARATION, goal, parameters.schedule, reorient=parameters.reorient)

    @classmethod
    def list_unused(cls, parameters: SequentialPParameters) -> tuple[str, ...]:
        """Return the path, and the goal's heading where it does not turn to it at the end."""
        return ("path",) if parameters.reorient else ("path", "goal.heading_rad")

    def __init__(self, parameters: SequentialPParameters) -> None:
        """Take the parameters."""
        self._parameters = parameters
        self._gains = {
            field.name: getattr(parameters, field.name)
            for field in fields(parameters)
            if field.name.startswith(("kp_", "ki_", "kd_"))
        }
        if parameters.schedule is not None:
            # In the place of the method: constant gains are not asked for a schedule each time.
            self.step = self._step_scheduled  # type: ignore[method-assign]
        self._adds_terms = False
        self._goal = Goal(0.0, 0.0)
        self._goal_heading_rad = 0.0
        self._phase: str | None = None
        self._bearing_rad = self._heading_error_rad = 0.0
        self._world_v_m_s = (0.0, 0.0)
        self._first_ns = 0
        self._still_samples = 0
        self._close_since_ns: int | None = None

    def reset(self, start: Pose, goal: Goal | None, path: Path | None) -> None:
        """Compute the goal bearing, once."""
        del path
        if goal is None:
            raise LawError("expected a goal, found none")
        self._goal = goal
        # Wrapped as the headings of poses are: beyond, an error that is not wrapped has no zero.
        self._goal_heading_rad = wrap_angle(goal.heading_rad or 0.0)
        self._phase = None
        self._bearing_rad = math.atan2(goal.y_m - start.y_m, goal.x_m - start.x_m)
        self._heading_error_rad = 0.0
        self._world_v_m_s = (0.0, 0.0)
        self._still_samples = 0
        self._close_since_ns = None

    def step(self, time_ns: int, pose: Pose) -> Decision:
        """Answer one pose."""
        if self._phase is TRANSLATE:
            return self._translate(time_ns, pose)
        if self._phase is ROTATE:
            return self._rotate(time_ns, pose)
        if self._phase is REORIENT:
            return self._reorient(time_ns, pose)
        self._phase = ROTATE
        self._first_ns = time_ns
        return self._decide_rotation(pose, turn_rate_rad_s=0.0)

    def _step_scheduled(self, time_ns: int, pose: Pose) -> Decision:
        """Answer one pose with the gains that the schedule has there."""
        schedule: GainSchedule = self._parameters.schedule  # type: ignore[assignment]
        if schedule.over == DISTANCE:
            place = math.hypot(self._goal.x_m - pose.x_m, self._goal.y_m - pose.y_m)
        else:
            place = self._find_heading_error(pose)
        self._gains.update(schedule.compute_gains(place))
        return type(self).step(self, time_ns, pose)

    def _find_heading_error(self, pose: Pose) -> float:
        """Return the error of the heading loop that acts, or acted last [rad]."""
        is_last = self._phase is REORIENT
        error_rad = (self._goal_heading_rad if is_last else self._bearing_rad) - pose.heading_rad
        return wrap_angle(error_rad) if self._parameters.wrap_error else error_rad

    def _rotate(self, time_ns: int, pose: Pose) -> Decision:
        parameters = self._parameters
        error_rad = self._bearing_rad - pose.heading_rad
        if parameters.wrap_error:
            error_rad = wrap_angle(error_rad)
        self._heading_error_rad = error_rad
        if abs(error_rad) > parameters.heading_tolerance_rad:
            turn_rate_rad_s = self._gains["kp_angular"] * error_rad
            if self._adds_terms:
                turn_rate_rad_s = self._add_turning(turn_rate_rad_s, error_rad, time_ns, pose)
            return self._decide_rotation(pose, turn_rate_rad_s=turn_rate_rad_s)
        decision = self._decide_rotation(pose, turn_rate_rad_s=0.0)
        self._phase = TRANSLATE
        return replace(decision, blocks_ticks=parameters.pause_ticks, ends_phase=True)

    def _reorient(self, time_ns: int, pose: Pose) -> Decision:
        rules = self._parameters
        error_rad = self._heading_error_rad = self._find_heading_error(pose)
        if abs(error_rad) <= rules.heading_tolerance_rad:
            decision = self._decide_rotation(pose, turn_rate_rad_s=0.0)
            return replace(decision, stop_reason="within_tolerance")
        turn_rate_rad_s = self._gains["kp_angular"] * error_rad
        if self._adds_terms:
            turn_rate_rad_s = self._add_turning(turn_rate_rad_s, error_rad, time_ns, pose)
        decision = self._decide_rotation(pose, turn_rate_rad_s=turn_rate_rad_s)
        is_late = time_ns - self._first_ns > rules.timeout_s * 1e9
        return replace(decision, stop_reason="timeout") if is_late else decision

    def _add_turning(
        self, proportional: float, error_rad: float, time_ns: int, pose: Pose
    ) -> float:
        """Return the turn rate with what a law adds to the proportional term; here nothing."""
        del error_rad, time_ns, pose
        return proportional

    def _add_driving(
        self, proportional: float, error_m: tuple[float, float], along_rad: float, time_ns: int
    ) -> float:
        """Return the speed with what a law adds to the proportional term; here nothing."""
        del error_m, along_rad, time_ns
        return proportional

    def _decide_rotation(self, pose: Pose, *, turn_rate_rad_s: float) -> Decision:
        return Decision(
            speed_m_s=0.0,
            turn_rate_rad_s=turn_rate_rad_s,
            phase=self._phase,
            bearing_rad=self._bearing_rad,
            heading_error_rad=self._heading_error_rad,
            error_x_m=self._goal.x_m - pose.x_m,
            error_y_m=self._goal.y_m - pose.y_m,
            world_v_x_m_s=0.0,
            world_v_y_m_s=0.0,
        )

    def _translate(self, time_ns: int, pose: Pose) -> Decision:
        parameters = self._parameters
        error_x_m, error_y_m = self._goal.x_m - pose.x_m, self._goal.y_m - pose.y_m
        tolerance_m = parameters.position_tolerance_m
        stop_reason: str | None
        if abs(error_x_m) > tolerance_m or abs(error_y_m) > tolerance_m:
            kp = self._gains["kp_linear"]
            self._world_v_m_s = world_v_x_m_s, world_v_y_m_s = kp * error_x_m, kp * error_y_m
            along_rad = self._bearing_rad
            if parameters.projection == "heading":
                along_rad = pose.heading_rad
            speed_m_s = world_v_x_m_s * math.cos(along_rad) + world_v_y_m_s * math.sin(along_rad)
            if self._adds_terms:
                errors_m = error_x_m, error_y_m
                speed_m_s = self._add_driving(speed_m_s, errors_m, along_rad, time_ns)
            stop_reason = self._find_stop_reason(time_ns, speed_m_s, error_x_m, error_y_m)
        else:
            speed_m_s, stop_reason = 0.0, "within_tolerance"
        decision = Decision(
            speed_m_s=speed_m_s,
            turn_rate_rad_s=0.0,
            phase=TRANSLATE,
            bearing_rad=self._bearing_rad,
            heading_error_rad=self._heading_error_rad,
            error_x_m=error_x_m,
            error_y_m=error_y_m,
            world_v_x_m_s=self._world_v_m_s[0],
            world_v_y_m_s=self._world_v_m_s[1],
            stop_reason=stop_reason,
        )
        if stop_reason is None or stop_reason == "timeout" or not parameters.reorient:
            return decision
        self._phase = REORIENT
        return replace(decision, ends_phase=True, stop_reason=None)

    def _find_stop_reason(
        self, time_ns: int, speed_m_s: float, error_x_m: float, error_y_m: float
    ) -> str | None:
        rules = self._parameters
        still = abs(speed_m_s) < rules.standstill_below
        self._still_samples = self._still_samples + 1 if still else 0
        if self._still_samples > rules.standstill_samples:
            return "standstill"
        if abs(error_x_m) >= rules.settled_within_m or abs(error_y_m) >= rules.settled_within_m:
            self._close_since_ns = None
        elif self._close_since_ns is None:
            self._close_since_ns = time_ns
        elif time_ns - self._close_since_ns > rules.settled_for_s * 1e9:
            return "settled"
        return "timeout" if time_ns - self._first_ns > rules.timeout_s * 1e9 else None
