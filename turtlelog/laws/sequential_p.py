"""The paper's law: rotate on the spot, then translate, each with u = Kp e."""

import math
from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Final, Literal

from msgspec import Meta
from msgspec.structs import replace

from turtlelog.angles import wrap_angle
from turtlelog.errors import LawError
from turtlelog.laws.base import ABSENT_BY_DEFAULT, MAY_BE_INFINITE, Decision, Goal, Pose
from turtlelog.loops import PAUSE, ControlLoop, Declaration, Mechanism
from turtlelog.paths import Path

_ROTATE: Final = "rotate"
_TRANSLATE: Final = "translate"
_NO_TOLERANCE: Final = 1e-6
"""The heading of a 32-bit pose comes no nearer to the bearing than about 1e-7 rad."""

DECLARATION: Final = Declaration(
    loops=(
        ControlLoop(
            name=_ROTATE,
            signal="heading",
            command="turn_rate",
            reference="goal_bearing",
            gain="law.kp_angular",
        ),
        ControlLoop(
            name=_TRANSLATE,
            signal="along_track",
            command="speed",
            reference="goal_distance",
            gain="law.kp_linear",
        ),
    ),
    # The pause stands second, as in recordings of format 1.
    phases={_ROTATE: (_ROTATE,), PAUSE: (), _TRANSLATE: (_TRANSLATE,)},
)
"""What the sequential law declares, whatever its parameters."""

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
    Mechanism(
        name="tolerance",
        kind="property",
        neutral={
            "law.heading_tolerance_rad": _NO_TOLERANCE,
            "law.position_tolerance_m": _NO_TOLERANCE,
        },
        meaning=f"tolerances of {_NO_TOLERANCE:g}",
    ),
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


class SequentialP:
    """Rotate to the goal bearing, then drive; the first callback only computes the bearing."""

    Parameters: ClassVar = SequentialPParameters
    mechanisms: ClassVar = _MECHANISMS
    counts_samples: ClassVar = ("standstill_samples",)

    @classmethod
    def declare(
        cls, parameters: SequentialPParameters, goal: Goal | None, path: Path | None
    ) -> Declaration:
        """Return its two loops, one after the other."""
        del parameters, goal, path
        return DECLARATION

    @classmethod
    def list_unused(cls, parameters: SequentialPParameters) -> tuple[str, ...]:
        """Return the path, and the goal's heading where it does not turn to it at the end."""
        turns_to_it = getattr(parameters, "reorient", False)
        return ("path",) if turns_to_it else ("path", "goal.heading_rad")

    def __init__(self, parameters: SequentialPParameters) -> None:
        """Take the parameters."""
        self._parameters = parameters
        self._goal = Goal(0.0, 0.0)
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
            raise LawError("sequential-p: expected a goal, found none")
        self._goal = goal
        self._phase = None
        self._bearing_rad = math.atan2(goal.y_m - start.y_m, goal.x_m - start.x_m)
        self._heading_error_rad = 0.0
        self._world_v_m_s = (0.0, 0.0)
        self._still_samples = 0
        self._close_since_ns = None

    def step(self, time_ns: int, pose: Pose) -> Decision:
        """Answer one pose."""
        if self._phase is _TRANSLATE:
            return self._translate(time_ns, pose)
        if self._phase is _ROTATE:
            return self._rotate(pose)
        self._phase = _ROTATE
        self._first_ns = time_ns
        return self._decide_rotation(pose, turn_rate_rad_s=0.0)

    def _rotate(self, pose: Pose) -> Decision:
        parameters = self._parameters
        error_rad = self._bearing_rad - pose.heading_rad
        if parameters.wrap_error:
            error_rad = wrap_angle(error_rad)
        self._heading_error_rad = error_rad
        if abs(error_rad) > parameters.heading_tolerance_rad:
            return self._decide_rotation(pose, turn_rate_rad_s=parameters.kp_angular * error_rad)
        self._phase = _TRANSLATE
        decision = self._decide_rotation(pose, turn_rate_rad_s=0.0)
        return replace(decision, blocks_ticks=parameters.pause_ticks, ends_phase=True)

    def _decide_rotation(self, pose: Pose, *, turn_rate_rad_s: float) -> Decision:
        return Decision(
            speed_m_s=0.0,
            turn_rate_rad_s=turn_rate_rad_s,
            phase=_ROTATE,
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
            self._world_v_m_s = parameters.kp_linear * error_x_m, parameters.kp_linear * error_y_m
            world_v_x_m_s, world_v_y_m_s = self._world_v_m_s
            along_rad = self._bearing_rad
            if parameters.projection == "heading":
                along_rad = pose.heading_rad
            speed_m_s = world_v_x_m_s * math.cos(along_rad) + world_v_y_m_s * math.sin(along_rad)
            stop_reason = self._find_stop_reason(time_ns, speed_m_s, error_x_m, error_y_m)
        else:
            speed_m_s, stop_reason = 0.0, "within_tolerance"
        return Decision(
            speed_m_s=speed_m_s,
            turn_rate_rad_s=0.0,
            phase=_TRANSLATE,
            bearing_rad=self._bearing_rad,
            heading_error_rad=self._heading_error_rad,
            error_x_m=error_x_m,
            error_y_m=error_y_m,
            world_v_x_m_s=self._world_v_m_s[0],
            world_v_y_m_s=self._world_v_m_s[1],
            stop_reason=stop_reason,
        )

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
