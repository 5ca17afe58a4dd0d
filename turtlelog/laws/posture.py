"""Drive to a pose, position and heading at once, so that a Lyapunov function decreases.

M. Aicardi, G. Casalino, A. Bicchi, A. Balestrino, "Closed loop steering of unicycle-like vehicles
via Lyapunov techniques", IEEE Robotics & Automation Magazine 2(1), 1995.
"""

import math
from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Final

from msgspec import Meta

from turtlelog.angles import wrap_angle
from turtlelog.errors import LawError
from turtlelog.laws.base import MAY_BE_INFINITE, TOLERANCE, Decision, Goal, Pose
from turtlelog.loops import ControlLoop, Declaration
from turtlelog.paths import Path

_DRIVE: Final = "drive"
_TURN: Final = "turn"

SERIES_BELOW: Final = 1e-4
"""Below this angle [rad] sin(a) / a is 1 - a^2 / 6: the next term, a^4 / 120, is under 1e-18."""

Gain = Annotated[float, Meta(gt=0, le=1e6)]
"""A million is far beyond every sampled loop, and keeps all products finite."""

DECLARATION: Final = Declaration(
    loops=(
        ControlLoop(
            name="approach",
            signal="distance",
            command="speed",
            reference="zero",
            gain="law.gamma",
            is_proportional=False,
        ),
        ControlLoop(
            name="align",
            signal="heading",
            command="turn_rate",
            reference="bearing_now",
            gain="law.k",
            is_proportional=False,
        ),
    ),
    # Turning on the spot at the goal is neither: the bearing means nothing there.
    phases={_DRIVE: ("approach", "align"), _TURN: ()},
    states=("lyapunov",),
)
"""What the posture law declares, whatever its parameters."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PostureParameters:
    """Parameters of the posture law.

    With rho the distance to the goal, alpha the bearing of the goal minus the heading and phi that
    bearing minus the goal's heading: speed = gamma cos(alpha) rho, turn rate = k alpha
    + gamma cos(alpha) sin(alpha) / alpha (alpha + h phi).

    Near the goal the angles have the poles of s^2 + k s + gamma^2 h, and rho has -gamma. The angles
    vanish faster than rho where 2 < k / gamma < h + 1. The defaults are the double pole -2 gamma,
    and gamma is below twice the usual limit of 1 rad/s: above that a clipped turn rate loses
    against the motion around the goal, and the robot may spiral.

    Attributes:
        gamma: Gain of the distance [1/s].
        k: Gain of the angle between heading and goal [1/s].
        h: Weight of the angle between the way to the goal and the goal's heading.
        position_tolerance_m: The position is reached when neither error coordinate is larger [m].
        heading_tolerance_rad: The heading is reached when its error is not larger [rad].
        timeout_s: The run ends this long after the first sample [s]; inf: never.
    """

    gamma: Gain = 1.0
    k: Gain = 4.0
    h: Gain = 4.0
    position_tolerance_m: Annotated[float, Meta(gt=0)] = 0.001
    heading_tolerance_rad: Annotated[float, Meta(gt=0)] = 0.001
    timeout_s: Annotated[float, Meta(gt=0)] = field(default=60.0, metadata=MAY_BE_INFINITE)


class Posture:
    """Drive to position and heading at once, by the Lyapunov law of Aicardi and others."""

    Parameters: ClassVar = PostureParameters
    mechanisms: ClassVar = (TOLERANCE,)
    counts_samples: ClassVar = ()

    @classmethod
    def declare(
        cls, parameters: PostureParameters, goal: Goal | None, path: Path | None
    ) -> Declaration:
        """Return its two loops, which act together."""
        del parameters, goal, path
        return DECLARATION

    @classmethod
    def list_unused(cls, parameters: PostureParameters) -> tuple[str, ...]:
        """Return the path."""
        del parameters
        return ("path",)

    def __init__(self, parameters: PostureParameters) -> None:
        """Take the parameters."""
        self._parameters = parameters
        self._goal = Goal(0.0, 0.0)
        self._arrival_rad = 0.0
        self._phase = _DRIVE
        self._first_ns: int | None = None

    def reset(self, start: Pose, goal: Goal | None, path: Path | None) -> None:
        """Choose the heading to arrive with: the goal's, or else the bearing from the start."""
        del path
        if goal is None:
            raise LawError("expected a goal, found none")
        self._goal = goal
        self._phase = _DRIVE
        self._first_ns = None
        line_rad = math.atan2(goal.y_m - start.y_m, goal.x_m - start.x_m)
        self._arrival_rad = line_rad if goal.heading_rad is None else goal.heading_rad

    def step(self, time_ns: int, pose: Pose) -> Decision:
        """Answer one pose."""
        if self._first_ns is None:
            self._first_ns = time_ns
        rules = self._parameters
        error_x_m, error_y_m = self._goal.x_m - pose.x_m, self._goal.y_m - pose.y_m
        rho = math.hypot(error_x_m, error_y_m)
        bearing_rad = math.atan2(error_y_m, error_x_m)
        alpha = wrap_angle(bearing_rad - pose.heading_rad)
        phi = wrap_angle(bearing_rad - self._arrival_rad)
        turn_rad = wrap_angle(self._arrival_rad - pose.heading_rad)
        lyapunov = 0.5 * (rho * rho + alpha * alpha + rules.h * phi * phi)
        speed_m_s, stop_reason = 0.0, None
        if max(abs(error_x_m), abs(error_y_m)) > rules.position_tolerance_m:
            self._phase = _DRIVE
            speed_m_s = rules.gamma * math.cos(alpha) * rho
            turn_rate_rad_s = self._compute_turn_rate(alpha, phi)
        elif self._has_heading and abs(turn_rad) > rules.heading_tolerance_rad:
            # The same law, as if it had arrived along the goal's heading, where phi is 0.
            self._phase = _TURN
            turn_rate_rad_s = self._compute_turn_rate(turn_rad, 0.0)
        else:
            turn_rate_rad_s, stop_reason = 0.0, "within_tolerance"
        if stop_reason is None and time_ns - self._first_ns > rules.timeout_s * 1e9:
            stop_reason = "timeout"
        return Decision(
            speed_m_s=speed_m_s,
            turn_rate_rad_s=turn_rate_rad_s,
            phase=self._phase,
            bearing_rad=bearing_rad,
            heading_error_rad=alpha,
            error_x_m=error_x_m,
            error_y_m=error_y_m,
            states=(lyapunov,),
            stop_reason=stop_reason,
        )

    @property
    def _has_heading(self) -> bool:
        return self._goal.heading_rad is not None

    def _compute_turn_rate(self, alpha: float, phi: float) -> float:
        rules = self._parameters
        sine_ratio = compute_sine_ratio(alpha)
        swing = rules.gamma * math.cos(alpha) * sine_ratio
        return rules.k * alpha + swing * (alpha + rules.h * phi)


def compute_sine_ratio(angle_rad: float) -> float:
    """Return sin(a) / a, which is 1 at 0."""
    if abs(angle_rad) < SERIES_BELOW:
        return 1.0 - angle_rad * angle_rad / 6.0
    return math.sin(angle_rad) / angle_rad
