"""Pure pursuit: drive on the arc that leads to a point of the path a lookahead away.

R. C. Coulter, "Implementation of the Pure Pursuit Path Tracking Algorithm", CMU-RI-TR-92-01,
Carnegie Mellon University, 1992: the circle that is tangent to the heading and passes through a
point at the distance L, which lies y to the left, has the curvature 2 y / L^2.
"""

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

from msgspec import Meta

from turtlelog.laws.base import Pose
from turtlelog.laws.path_tracking import PathTracker, Target


@dataclass(frozen=True, slots=True, kw_only=True)
class PurePursuitParameters:
    """Parameters of pure pursuit.

    Attributes:
        lookahead_m: Distance from the robot to the point of the path that it steers for [m], > 0.
        speed_m_s: Speed along a path that has none [m/s], > 0.
        kp_along: Where the path has a speed: gain of the error along the path, whose product is
            added to that speed [1/s], >= 0.
        end_tolerance_m: A path without a speed ends this far before its end [m], > 0.
    """

    lookahead_m: Annotated[float, Meta(gt=0, le=1e6)] = 0.3
    speed_m_s: Annotated[float, Meta(gt=0, le=1e6)] = 0.5
    kp_along: Annotated[float, Meta(ge=0, le=1e6)] = 1.0
    end_tolerance_m: Annotated[float, Meta(gt=0, le=1e6)] = 0.01


class PurePursuit(PathTracker):
    """Steer for a point of the path ahead: omega = v 2 y / L^2."""

    Parameters: ClassVar = PurePursuitParameters
    kind: ClassVar = "pure-pursuit"
    along_gain: ClassVar = "kp_along"

    def _steer(self, pose: Pose, target: Target) -> tuple[float, float]:
        parameters = self._parameters
        speed_m_s = target.speed_m_s + parameters.kp_along * target.behind_m
        ahead = self._path.find_ahead(
            pose.x_m, pose.y_m, parameters.lookahead_m, from_m=target.nearest_m
        )
        x_m, y_m = ahead.x_m - pose.x_m, ahead.y_m - pose.y_m
        left_m = y_m * math.cos(pose.heading_rad) - x_m * math.sin(pose.heading_rad)
        square = x_m * x_m + y_m * y_m
        return speed_m_s, speed_m_s * 2.0 * left_m / square if square else 0.0
