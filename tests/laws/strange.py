"""A law that shares no name with the built-in one: loops a and b, phases one and two."""

import math
from dataclasses import dataclass
from typing import ClassVar

from turtlelog.angles import subtract_headings
from turtlelog.laws import Decision, Goal, Pose
from turtlelog.loops import ControlLoop, Declaration, Mechanism

STRANGE = "tests/laws/strange.py:Strange"
SILENT = "tests/laws/strange.py:Silent"


@dataclass(frozen=True, slots=True, kw_only=True)
class StrangeParameters:
    ka: float = 3.0
    kb: float = 2.0
    bias_rad: float = 0.0
    pace_m_s: float = 0.6
    turning_samples: int = 150


class Strange:
    """Turns to the goal for some samples, then follows a pose that moves there."""

    Parameters: ClassVar = StrangeParameters
    counts_samples: ClassVar = ("turning_samples",)
    mechanisms: ClassVar = (
        Mechanism(
            name="bias",
            kind="effect",
            neutral={"law.bias_rad": 0.0},
            meaning="the heading read without a bias",
        ),
    )

    @classmethod
    def declare(cls, parameters: StrangeParameters, goal: Goal | None, path: None) -> Declaration:
        a = ControlLoop(name="a", signal="heading", command="turn_rate", reference="bearing_now",
                        gain="law.ka")  # fmt: skip
        b = ControlLoop(name="b", signal="along_track", command="speed", reference="recorded",
                        gain="law.kb")  # fmt: skip
        return Declaration(loops=(a, b), phases={"one": ("a",), "two": ("a", "b")}, states=("sum",))

    def __init__(self, parameters: StrangeParameters) -> None:
        self.parameters = parameters

    def reset(self, start: Pose, goal: Goal | None, path: None) -> None:
        assert goal is not None
        self.start, self.goal = start, goal
        self.samples, self.began_ns, self.sum = 0, 0, 0.0
        self.bearing_rad = math.atan2(goal.y_m - start.y_m, goal.x_m - start.x_m)
        self.length_m = math.hypot(goal.x_m - start.x_m, goal.y_m - start.y_m)

    def step(self, time_ns: int, pose: Pose) -> Decision:
        parameters = self.parameters
        self.samples += 1
        left_m, ahead_m = self.goal.y_m - pose.y_m, self.goal.x_m - pose.x_m
        bearing_rad = math.atan2(left_m, ahead_m) if math.hypot(left_m, ahead_m) > 0.3 else None
        error_rad = 0.0
        if bearing_rad is not None:
            error_rad = subtract_headings(bearing_rad + parameters.bias_rad, pose.heading_rad)
        self.sum += error_rad
        turn_rate = parameters.ka * error_rad
        if self.samples <= parameters.turning_samples:
            self.began_ns = time_ns
            return Decision(speed_m_s=0.0, turn_rate_rad_s=turn_rate, phase="one",
                            states=(self.sum,))  # fmt: skip
        way_m = min(parameters.pace_m_s * (time_ns - self.began_ns) / 1e9, self.length_m)
        cosine, sine = math.cos(self.bearing_rad), math.sin(self.bearing_rad)
        reference = Pose(
            self.start.x_m + way_m * cosine, self.start.y_m + way_m * sine, self.bearing_rad
        )
        behind_m = (reference.x_m - pose.x_m) * cosine + (reference.y_m - pose.y_m) * sine
        is_there = way_m == self.length_m and abs(behind_m) < 0.01
        return Decision(
            speed_m_s=parameters.kb * behind_m,
            turn_rate_rad_s=turn_rate,
            phase="two",
            states=(self.sum,),
            reference=reference,
            stop_reason="arrived" if is_there else None,
        )


class Silent(Strange):
    """The same, but it does not tell which of its parameters count samples."""

    counts_samples = None  # type: ignore[assignment]
