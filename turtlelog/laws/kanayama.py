"""Kanayama's tracking law: the reference's motion plus feedback of the error in the robot's frame.

Y. Kanayama, Y. Kimura, F. Miyazaki, T. Noguchi, "A stable tracking control method for an autonomous
mobile robot", Proc. IEEE International Conference on Robotics and Automation, 1990, equation 8. The
default gains are the gains of the article's experiments: 10 1/s, 6.4e-3 1/cm^2, 0.16 1/cm.
"""

import math
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Final

from msgspec import Meta

from turtlelog.arithmetic import wrap_angle
from turtlelog.laws.base import LawPart
from turtlelog.laws.path_tracking import STOPS, TrackingState, declare, find_target


@dataclass(frozen=True, slots=True, kw_only=True)
class KanayamaParameters:
    """Parameters of Kanayama's law.

    Attributes:
        kx: Gain of the longitudinal error [1/s], > 0.
        ky: Gain of the lateral error [1/m^2], > 0.
        ktheta: Gain of the heading error [1/m], > 0. ktheta^2 = 4 ky damps small errors critically.
        speed_m_s: Speed along a path without a speed of its own [m/s], > 0.
        end_tolerance_m: Distance from the end of a path within which the path is finished [m], > 0.
            Only for a path without a speed of its own.
    """

    kx: Annotated[float, Meta(gt=0, le=1e6)] = 10.0
    ky: Annotated[float, Meta(gt=0, le=1e6)] = 64.0
    ktheta: Annotated[float, Meta(gt=0, le=1e6)] = 16.0
    speed_m_s: Annotated[float, Meta(gt=0, le=1e6)] = 0.5
    end_tolerance_m: Annotated[float, Meta(gt=0, le=1e6)] = 0.01


def step(
    settings: Any, state: Any, pieces: Any, row: Any, time_ns: int, pose: tuple[float, float, float]
) -> tuple[float, float]:
    """Answer one pose, using the error in the robot's frame."""
    gains = settings.law
    point, speed_m_s, _, _ = find_target(settings, state, pieces, row, time_ns, pose)
    if row.stop != 0:
        return 0.0, 0.0
    x_m, y_m = point[0] - pose[0], point[1] - pose[1]
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    ahead_m, left_m = x_m * cos + y_m * sin, y_m * cos - x_m * sin
    error_rad = wrap_angle(point[2] - pose[2])
    turn_rate = speed_m_s * (point[3] + gains.ky * left_m + gains.ktheta * math.sin(error_rad))
    return speed_m_s * math.cos(error_rad) + gains.kx * ahead_m, turn_rate


PART: Final = LawPart(
    name="kanayama",
    meaning="v = v_r cos e_theta + kx e_x, omega = omega_r + v_r (ky e_y + ktheta sin e_theta).",
    Parameters=KanayamaParameters,
    step=step,
    declare=partial(declare, "kanayama", "kx"),
    State=TrackingState,
    stops=STOPS,
    counts_samples=(),
    needs_path=True,
)
