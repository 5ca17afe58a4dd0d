"""Kanayama's tracking law: the error in the robot's frame, added to the reference's own motion.

Y. Kanayama, Y. Kimura, F. Miyazaki, T. Noguchi, "A stable tracking control method for an autonomous
mobile robot", Proc. IEEE International Conference on Robotics and Automation, 1990, equation 8. The
default gains are those of its experiments: 10 1/s, 6.4e-3 1/cm^2, 0.16 1/cm.
"""

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

from msgspec import Meta

from turtlelog.angles import wrap_angle
from turtlelog.laws.base import Pose
from turtlelog.laws.path_tracking import PathTracker, Target


@dataclass(frozen=True, slots=True, kw_only=True)
class KanayamaParameters:
    """Parameters of Kanayama's law.

    Attributes:
        kx: Gain of the error ahead [1/s], > 0.
        ky: Gain of the error to the left [1/m^2], > 0.
        ktheta: Gain of the heading error [1/m], > 0. ktheta^2 = 4 ky damps small errors critically.
        speed_m_s: Speed along a path that has none [m/s], > 0.
        end_tolerance_m: A path without a speed ends this far before its end [m], > 0.
    """

    kx: Annotated[float, Meta(gt=0, le=1e6)] = 10.0
    ky: Annotated[float, Meta(gt=0, le=1e6)] = 64.0
    ktheta: Annotated[float, Meta(gt=0, le=1e6)] = 16.0
    speed_m_s: Annotated[float, Meta(gt=0, le=1e6)] = 0.5
    end_tolerance_m: Annotated[float, Meta(gt=0, le=1e6)] = 0.01


class Kanayama(PathTracker):
    """v = v_r cos e_theta + kx e_x, omega = omega_r + v_r (ky e_y + ktheta sin e_theta)."""

    Parameters: ClassVar = KanayamaParameters
    kind: ClassVar = "kanayama"
    along_gain: ClassVar = "kx"

    def _steer(self, pose: Pose, target: Target) -> tuple[float, float]:
        gains, point, speed_m_s = self._parameters, target.point, target.speed_m_s
        x_m, y_m = point.x_m - pose.x_m, point.y_m - pose.y_m
        cos, sin = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
        ahead_m, left_m = x_m * cos + y_m * sin, y_m * cos - x_m * sin
        error_rad = wrap_angle(point.heading_rad - pose.heading_rad)
        turn_rate_rad_s = speed_m_s * (
            point.curvature_1_m + gains.ky * left_m + gains.ktheta * math.sin(error_rad)
        )
        return speed_m_s * math.cos(error_rad) + gains.kx * ahead_m, turn_rate_rad_s
