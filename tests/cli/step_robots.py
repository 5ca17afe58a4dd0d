"""Bags of a robot that answers a step of its speed."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.log.ros2.bags import START_NS, Said, make_command, make_odometry, make_vector, write_mcap
from tests.measure.driven import publish, respond

STEPS = [(1.0, 0.2), (3.0, 0.0)]


def write_robot(path: Path, *, commands: bool = True, gain: float = 1.0) -> Path:
    """Write a robot that answers a step of its speed, with a time constant of 0.1 s."""
    time_s = np.arange(0.0, 5.0, 0.05)
    rates, ways = respond(time_s, [(at, gain * value) for at, value in STEPS], 0.1)
    said = [tell_odometry(*row) for row in zip(time_s, rates, ways, strict=True)]
    if commands:
        at_s, values = publish([(0.5, 0.0), *STEPS], 4.5)
        said += [tell_command(*row) for row in zip(at_s, values, strict=True)]
    write_mcap(path, sorted(said, key=lambda one: one.time_ns))
    return path


def tell_odometry(at_s: float, rate: float, way: float) -> Said:
    said = make_odometry(yaw_rad=0.0, speed=(rate, 0.0), turn_rate=0.0)
    pose = {"position": make_vector(way), "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    values = {**said.values, "pose": {"pose": pose, "covariance": [0.0] * 36}}
    return replace(said, values=values, time_ns=START_NS + round(at_s * 1e9))


def tell_command(at_s: float, value: float) -> Said:
    said = make_command(topic="/cmd_vel", time_ns=START_NS + round(at_s * 1e9))
    values = {"linear": make_vector(value), "angular": make_vector()}
    return replace(said, values=values)
