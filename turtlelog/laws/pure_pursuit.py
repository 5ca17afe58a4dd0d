"""Pure pursuit: drive on the arc to the path point that is one lookahead distance away.

R. C. Coulter, "Implementation of the Pure Pursuit Path Tracking Algorithm", CMU-RI-TR-92-01,
Carnegie Mellon University, 1992: a circle is tangent to the heading and passes through a point at
the distance L. If the point lies y to the left, the curvature of the circle is 2 y / L^2.
"""

import math
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Final

from msgspec import Meta

from turtlelog.laws.base import LawPart
from turtlelog.laws.path_tracking import STOPS, TrackingState, declare, find_target
from turtlelog.run.path_pieces import find_ahead


@dataclass(frozen=True, slots=True, kw_only=True)
class PurePursuitParameters:
    """Parameters of pure pursuit.

    Attributes:
        lookahead_m: Distance from the robot to the path point for which it steers [m], > 0.
        speed_m_s: Speed along a path without a speed of its own [m/s], > 0.
        kp_along: Gain of the error along the path [1/s], >= 0. If the path has a speed of its own,
            the gain times the error is added to this speed.
        end_tolerance_m: Distance from the end of a path within which the path is finished [m], > 0.
            Only for a path without a speed of its own.
    """

    lookahead_m: Annotated[float, Meta(gt=0, le=1e6)] = 0.3
    speed_m_s: Annotated[float, Meta(gt=0, le=1e6)] = 0.5
    kp_along: Annotated[float, Meta(ge=0, le=1e6)] = 1.0
    end_tolerance_m: Annotated[float, Meta(gt=0, le=1e6)] = 0.01


def step(
    settings: Any, state: Any, pieces: Any, row: Any, time_ns: int, pose: tuple[float, float, float]
) -> tuple[float, float]:
    """Return the command for one pose: omega = 2 v y / L^2."""
    law = settings.law
    _, speed_m_s, behind_m, nearest_m = find_target(settings, state, pieces, row, time_ns, pose)
    if row.stop != 0:
        return 0.0, 0.0
    speed = speed_m_s + law.kp_along * behind_m
    position = pose[0], pose[1]
    ahead = find_ahead(settings.path, pieces, position, law.lookahead_m, nearest_m)
    x_m, y_m = ahead[0] - pose[0], ahead[1] - pose[1]
    left_m = y_m * math.cos(pose[2]) - x_m * math.sin(pose[2])
    square = x_m * x_m + y_m * y_m
    return speed, speed * 2.0 * left_m / square if square != 0.0 else 0.0


PART: Final = LawPart(
    name="pure-pursuit",
    meaning="Steer for a point of the path ahead: omega = v 2 y / L^2.",
    Parameters=PurePursuitParameters,
    step=step,
    declare=partial(declare, "pure-pursuit", "kp_along"),
    State=TrackingState,
    stops=STOPS,
    counts_samples=(),
    needs_path=True,
)
