"""Posture law: drive to a position and a heading at once, so that a Lyapunov function decreases.

M. Aicardi, G. Casalino, A. Bicchi, A. Balestrino, "Closed loop steering of unicycle-like vehicles
via Lyapunov techniques", IEEE Robotics & Automation Magazine 2(1), 1995.
"""

import math
from dataclasses import dataclass, field
from typing import Annotated, Any, Final

from msgspec import Meta

from turtlelog.arithmetic import called, hypot, most, wrap_angle
from turtlelog.laws.base import TOLERANCE, Goal, LawPart
from turtlelog.parts import MAY_BE_INFINITE
from turtlelog.run import stop_reasons
from turtlelog.run.loops import ControlLoop, Declaration
from turtlelog.run.paths import Path

_DRIVE, _TURN = 0, 1
"""Numbers of the phases in the declaration."""

_STOPS: Final = (stop_reasons.WITHIN_TOLERANCE, stop_reasons.TIMEOUT)
_WITHIN_TOLERANCE, _TIMEOUT = 1, 2

SERIES_BELOW: Final = 1e-4
"""Angle below which sin(a) / a is computed as 1 - a^2 / 6 [rad]: the next term, a^4 / 120, is under
1e-18."""

Gain = Annotated[float, Meta(gt=0, le=1e6)]
"""A gain of at most one million, which is far beyond every sampled loop and keeps all products
finite."""

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
    phases={"drive": ("approach", "align"), "turn": ()},
    states=("lyapunov",),
    state_units={"lyapunov": "1"},  # squared metres and squared radians, added as numbers
)
"""Declaration of the posture law, the same for all parameters."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PostureParameters:
    """Parameters of the posture law.

    Let rho be the distance to the goal, alpha the bearing of the goal minus the heading, and phi
    the bearing minus the goal's heading. Then speed = gamma cos(alpha) rho, turn rate = k alpha +
    gamma cos(alpha) sin(alpha) / alpha (alpha + h phi).

    Near the goal, the poles of the angles are the roots of s^2 + k s + gamma^2 h, and the pole of
    rho is -gamma. The angles vanish faster than rho if 2 < k / gamma < h + 1. The defaults give a
    double pole at -2 gamma. The default gamma is below twice the usual limit of 1 rad/s. With a
    larger gamma, a clipped turn rate cannot follow the motion around the goal, and the robot may
    spiral.

    Attributes:
        gamma: Gain of the distance [1/s].
        k: Gain of the angle between the heading and the direction to the goal [1/s].
        h: Weight of the angle between the direction to the goal and the goal's heading.
        position_tolerance_m: Largest error of a coordinate at which the position is reached [m].
        heading_tolerance_rad: Largest heading error at which the heading is reached [rad].
        timeout_s: Time after the first sample at which the run ends [s]; inf: never.
    """

    gamma: Gain = 1.0
    k: Gain = 4.0
    h: Gain = 4.0
    position_tolerance_m: Annotated[float, Meta(gt=0)] = 0.001
    heading_tolerance_rad: Annotated[float, Meta(gt=0)] = 0.001
    timeout_s: Annotated[float, Meta(gt=0)] = field(default=60.0, metadata=MAY_BE_INFINITE)


@dataclass(slots=True)
class PostureState:
    """State of the posture law.

    Attributes:
        phase: Number of the phase; -1 before the first sample.
        first_ns: Time of the first sample [ns].
        arrival_rad: Heading at arrival [rad]: the goal's heading, or the bearing from the start if
            the goal has none.
        lyapunov: Value of the Lyapunov function, which decreases.
    """

    phase: int = -1
    first_ns: int = 0
    arrival_rad: float = 0.0
    lyapunov: float = 0.0


@called
def step(
    settings: Any, state: Any, row: Any, time_ns: int, pose: tuple[float, float, float]
) -> tuple[float, float]:
    """Answer one pose."""
    law, goal = settings.law, settings.goal
    x_m, y_m = goal.x_m - pose[0], goal.y_m - pose[1]
    bearing_rad = math.atan2(y_m, x_m)
    has_heading = not math.isnan(goal.heading_rad)
    if state.phase < 0:
        state.first_ns = time_ns
        state.arrival_rad = goal.heading_rad if has_heading else bearing_rad
    rho = hypot(x_m, y_m)
    alpha = wrap_angle(bearing_rad - pose[2])
    phi = wrap_angle(bearing_rad - state.arrival_rad)
    turn_rad = wrap_angle(state.arrival_rad - pose[2])
    state.lyapunov = 0.5 * (rho * rho + alpha * alpha + law.h * phi * phi)
    speed = turn_rate = 0.0
    if most(abs(x_m), abs(y_m)) > law.position_tolerance_m:
        state.phase = _DRIVE
        speed = law.gamma * math.cos(alpha) * rho
        turn_rate = _steer(law, alpha, phi)
    elif has_heading and abs(turn_rad) > law.heading_tolerance_rad:
        # The same law, as if it had arrived along the goal's heading, where phi is 0.
        state.phase = _TURN
        turn_rate = _steer(law, turn_rad, 0.0)
    else:
        state.phase = max(state.phase, _DRIVE)
        row.stop = _WITHIN_TOLERANCE
    if row.stop == 0 and time_ns - state.first_ns > law.timeout_s * 1e9:
        row.stop = _TIMEOUT
    row.phase, row.distance_m = state.phase, rho
    row.bearing_rad, row.heading_error_rad = bearing_rad, alpha
    row.error_x_m, row.error_y_m = x_m, y_m
    return speed, turn_rate


def _steer(law: Any, alpha: float, phi: float) -> float:
    """Return the turn rate, with sin(a) / a = 1 at a = 0."""
    ratio = 1.0 - alpha * alpha / 6.0
    if abs(alpha) >= SERIES_BELOW:
        ratio = math.sin(alpha) / alpha
    swing = law.gamma * math.cos(alpha) * ratio
    rate: float = law.k * alpha + swing * (alpha + law.h * phi)
    return rate


def declare(parameters: Any, goal: Goal | None, path: Path | None) -> Declaration:
    """Return the two loops of the posture law, which act at the same time."""
    del parameters, goal, path
    return DECLARATION


PART: Final = LawPart(
    name="posture",
    meaning="Drive to position and heading at once, by the Lyapunov law of Aicardi and others.",
    Parameters=PostureParameters,
    step=step,
    declare=declare,
    State=PostureState,
    stops=_STOPS,
    causes=(TOLERANCE,),
    counts_samples=(),
    list_unused=lambda _: ("path",),
)
