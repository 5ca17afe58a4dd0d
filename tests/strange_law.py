"""A law that is like none of ours: loops `a` and `b`, phases `one` and `two`, a state, a reference
that moves, a parameter without a default."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import turtlelog as tl
from turtlelog.laws import Decision, Goal, Pose
from turtlelog.run.angles import subtract_headings
from turtlelog.run.loops import Cause, ControlLoop, Declaration
from turtlelog.run.paths import Path as Track

KIND: Final = f"{Path(__file__)}:StrangeLaw"
"""What a scenario's law.kind says of it."""


@dataclass(frozen=True, kw_only=True)
class StrangeParameters:
    gain_a: float
    gain_b: float = 1.0
    sweep_rad_s: float = 0.8
    hesitates_ticks: int = 10


class StrangeLaw:
    """Turns along with a reference that sweeps to the goal's bearing, then drives there."""

    Parameters = StrangeParameters
    causes = (
        Cause(
            name="hesitation",
            kind="effect",
            neutral={"law.hesitates_ticks": 0},
            meaning="no stop between the phases",
        ),
    )
    counts_samples = ()

    @classmethod
    def declare(
        cls, parameters: StrangeParameters, goal: Goal | None, path: Track | None
    ) -> Declaration:
        return Declaration(
            loops=(
                ControlLoop(
                    name="a",
                    signal="heading",
                    command="turn_rate",
                    reference="recorded",
                    gain="law.gain_a",
                ),
                ControlLoop(
                    name="b",
                    signal="distance",
                    command="speed",
                    reference="zero",
                    gain="law.gain_b",
                ),
            ),
            phases={"one": ("a",), "two": ("b",)},
            states=("memory",),
        )

    def __init__(self, parameters: StrangeParameters) -> None:
        self.parameters = parameters
        self.goal = Goal(0.0, 0.0)
        self.memory = 0.0
        self.is_second = False
        self.first_ns: int | None = None
        self.start_rad = 0.0

    def reset(self, start: Pose, goal: Goal | None, path: Track | None) -> None:
        assert goal is not None
        self.goal, self.start_rad = goal, start.heading_rad
        self.memory, self.is_second, self.first_ns = 0.0, False, None

    def step(self, time_ns: int, pose: Pose) -> Decision:
        self.first_ns = time_ns if self.first_ns is None else self.first_ns
        ahead_m, left_m = self.goal.x_m - pose.x_m, self.goal.y_m - pose.y_m
        bearing_rad, distance_m = math.atan2(left_m, ahead_m), math.hypot(ahead_m, left_m)
        if self.is_second:
            return self._drive(subtract_headings(bearing_rad, pose.heading_rad), distance_m)
        turn_rad = subtract_headings(bearing_rad, self.start_rad)
        swept_rad = self.parameters.sweep_rad_s * (time_ns - self.first_ns) / 1e9
        share = min(swept_rad / max(abs(turn_rad), 1e-9), 1.0)
        wanted = Pose(pose.x_m, pose.y_m, self.start_rad + share * turn_rad)
        error_rad = subtract_headings(wanted.heading_rad, pose.heading_rad)
        self.memory += error_rad
        self.is_second = share == 1.0 and abs(error_rad) < 0.01
        return Decision(
            speed_m_s=0.0,
            turn_rate_rad_s=self.parameters.gain_a * error_rad,
            phase="one",
            states=(self.memory,),
            reference=wanted,
            ends_phase=self.is_second,
            blocks_ticks=self.parameters.hesitates_ticks if self.is_second else 0,
        )

    def _drive(self, error_rad: float, distance_m: float) -> Decision:
        self.memory += distance_m
        return Decision(
            speed_m_s=self.parameters.gain_b * distance_m,
            turn_rate_rad_s=2.0 * error_rad,
            phase="two",
            states=(self.memory,),
            stop_reason="arrived" if distance_m < 0.05 else None,
        )


def simulate_strange(**changes: Any) -> tl.Run:
    """Return a run of the law; `changes` by key with `__` for the dot: `law__gain_b=2.0`."""
    values = {key.replace("__", "."): value for key, value in changes.items()}
    law = {"law.kind": KIND, "law.gain_a": 4.0}
    scenario = tl.override_scenario(
        tl.load_scenario("textbook"), {**law, "name": "strange", **values}
    )
    return tl.simulate_run(scenario)
