"""What the controller reads of the plant's poses: biased, noisy, rounded, late or not at all."""

import math
from collections.abc import Callable
from struct import Struct
from typing import Final

from turtlelog.angles import wrap_angle
from turtlelog.laws import Pose
from turtlelog.scenario import Scenario
from turtlelog.simulate.random_streams import RandomStream
from turtlelog.simulate.transport import LossCount

_FLOATS: Final = Struct("<3f")
"""A pose as a message holds it: 32-bit floats."""


class Sensor:
    """Senses the poses that the plant publishes, by their numbers, and delivers them.

    Attributes:
        lost: Poses that dropped out.
    """

    __slots__ = (
        "_bias",
        "_deliver",
        "_dropout",
        "_dropout_probability",
        "_is_rounded",
        "_noise",
        "_noise_sizes",
        "_outlier",
        "_outlier_probability",
        "_outlier_sizes",
        "_period_ns",
        "_quantum",
        "lost",
    )

    def __init__(
        self, scenario: Scenario, period_ns: int, deliver: Callable[[int, Pose], object]
    ) -> None:
        """Hand over what is sensed to `deliver`, with the number of its pose."""
        sensing, seed = scenario.sensing, scenario.seed
        self._deliver, self._period_ns = deliver, period_ns
        self._bias = sensing.bias_position_m, sensing.bias_heading_rad
        self._noise_sizes = sensing.noise_position_m, sensing.noise_heading_rad
        self._quantum = sensing.quantum_position_m, sensing.quantum_heading_rad
        self._outlier_sizes = sensing.outlier_m, sensing.outlier_rad
        self._outlier_probability = sensing.outlier_probability
        self._dropout_probability = sensing.dropout_probability
        self._noise = RandomStream(seed, "noise", width=3, kind="normal")
        self._outlier = RandomStream(seed, "outlier", width=3, kind="uniform")
        self._dropout = RandomStream(seed, "dropout", kind="uniform")
        self._is_rounded = scenario.loop.pose_precision == "float32"
        self.lost = LossCount()

    def receive(self, tick: int, pose: Pose) -> Pose | None:
        """Return the pose of a tick as it is sensed, None where it drops out."""
        if self._dropout_probability and self._dropout.draw(tick)[0] < self._dropout_probability:
            self.lost.add(tick * self._period_ns)
            return None
        self.lost.end_stretch()
        sensed = self._sense(tick, pose)
        self._deliver(tick, sensed)
        return sensed

    def _sense(self, tick: int, pose: Pose) -> Pose:
        bias_m, bias_rad = self._bias
        noise_m, noise_rad = self._noise_sizes
        x_m, y_m, heading_rad = pose.x_m + bias_m, pose.y_m + bias_m, pose.heading_rad + bias_rad
        if noise_m or noise_rad:
            noise_x, noise_y, noise_heading = self._noise.draw(tick)
            x_m += noise_m * noise_x
            y_m += noise_m * noise_y
            heading_rad += noise_rad * noise_heading
        if self._outlier_probability:
            chance, direction, side = self._outlier.draw(tick)
            if chance < self._outlier_probability:
                far_m, far_rad = self._outlier_sizes
                x_m += far_m * math.cos(2.0 * math.pi * direction)
                y_m += far_m * math.sin(2.0 * math.pi * direction)
                heading_rad += far_rad if side < 0.5 else -far_rad
        quantum_m, quantum_rad = self._quantum
        x_m, y_m = round_to_step(x_m, quantum_m), round_to_step(y_m, quantum_m)
        heading_rad = round_to_step(heading_rad, quantum_rad)
        # turtlesim's own headings reach a rounding beyond pi: what nothing changed stays.
        if heading_rad != pose.heading_rad:
            heading_rad = wrap_angle(heading_rad)
        if self._is_rounded:
            x_m, y_m, heading_rad = _FLOATS.unpack(_FLOATS.pack(x_m, y_m, heading_rad))
        return Pose(x_m, y_m, heading_rad)


def round_to_step(value: float, step: float) -> float:
    """Return the nearest multiple of a step, the even one of two; without a step the value."""
    if not step:
        return value
    steps = value / step
    # Of a step far below the digits of a double there is no whole number: nothing is rounded.
    return step * round(steps) if math.isfinite(steps) else value


def build_sensor(
    scenario: Scenario, period_ns: int, deliver: Callable[[int, Pose], object]
) -> Sensor | None:
    """Return what senses poses, None where the controller reads them as they are published."""
    return Sensor(scenario, period_ns, deliver) if scenario.sensing.changes_poses else None
