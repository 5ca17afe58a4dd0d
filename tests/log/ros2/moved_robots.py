"""Messages of wheels, satellite receivers and cars."""

import math
from collections.abc import Sequence
from typing import Any

from tests.log.ros2.bags import START_NS, Said
from tests.log.ros2.robots import describe_head


def _describe_stamp(time_ns: int) -> dict[str, Any]:
    return describe_head("") | {
        "stamp": {"sec": time_ns // 1_000_000_000, "nanosec": time_ns % 1_000_000_000}
    }


def say_joints(
    names: Sequence[str],
    positions_rad: Sequence[float] = (),
    velocities_rad_s: Sequence[float] = (),
    *,
    at_s: float,
    topic: str = "/joint_states",
) -> Said:
    time_ns = START_NS + round(at_s * 1e9)
    values = {
        "header": _describe_stamp(time_ns),
        "name": list(names),
        "position": list(positions_rad),
        "velocity": list(velocities_rad_s),
        "effort": [],
    }
    return Said(topic=topic, type="sensor_msgs/msg/JointState", values=values, time_ns=time_ns)


def say_fix(
    latitude_deg: float,
    longitude_deg: float,
    *,
    at_s: float,
    altitude_m: float = 0.0,
    status: int = 0,
    topic: str = "/fix",
) -> Said:
    time_ns = START_NS + round(at_s * 1e9)
    values = {
        "header": _describe_stamp(time_ns),
        "status": {"status": status, "service": 1},
        "latitude": latitude_deg,
        "longitude": longitude_deg,
        "altitude": altitude_m,
        "position_covariance": [0.0] * 9,
        "position_covariance_type": 0,
    }
    return Said(topic=topic, type="sensor_msgs/msg/NavSatFix", values=values, time_ns=time_ns)


def drive_wheels(
    joints: Sequence[str] = ("left", "right"),
    *,
    radius_m: float = 0.05,
    track_m: float = 0.4,
    speed_m_s: float = 0.5,
    turn_rate_rad_s: float = 0.25,
    rows: int = 101,
    step_s: float = 0.1,
    has_positions: bool = True,
    wraps: bool = False,
) -> list[Said]:
    """Return what wheels tell on a circle of speed / turn rate, from the origin along x."""
    rates = [
        (speed_m_s + sign * turn_rate_rad_s * track_m / 2.0) / radius_m for sign in (-1.0, 1.0)
    ]
    said = []
    for row in range(rows):
        turned = [rate * row * step_s for rate in rates]
        turned = [math.remainder(angle, math.tau) for angle in turned] if wraps else turned
        positions = turned if has_positions else []
        said.append(say_joints(joints, positions, rates, at_s=row * step_s))
    return said
