"""A law of its own kind, as a user writes it: two loops, two phases, states, a moving reference."""

from pathlib import Path
from typing import Any

from turtlelog.scenario import Scenario, get_preset, override_scenario

_LAW = """
import math
from dataclasses import dataclass
from turtlelog.laws import Decision, Pose
from turtlelog.run.loops import ControlLoop, Declaration

@dataclass(frozen=True)
class Parameters:
    kp: float
    uses_goal: bool = True
    fails: str = ""

class Strange:
    Parameters = Parameters

    @classmethod
    def declare(cls, parameters, goal, path):
        loops = (
            ControlLoop(name="b", signal="heading", command="turn_rate", reference="recorded"),
            ControlLoop(name="a", signal="distance", command="speed", reference="zero"),
        )
        phases = {"two": ("b",), "one": ("a",)}
        return Declaration(loops=loops, phases=phases, states=("integral", "time_ns"),
            uses_goal=parameters.uses_goal)

    def __init__(self, parameters):
        self.parameters, self.count = parameters, 0

    def reset(self, start, goal, path):
        pass

    def step(self, time_ns, pose):
        self.count += 1
        number, fails = self.count, self.parameters.fails
        if number == 5 and fails == "raises":
            raise ValueError("out of ideas")
        turns = number <= 20
        return Decision(
            speed_m_s=math.nan if number == 5 and fails == "nan" else 0.1,
            turn_rate_rad_s=self.parameters.kp * math.sin(number),
            phase="two" if turns else "one",
            states=(number / 3.0, float(time_ns)),
            reference=Pose(number / 7.0, -0.1, 0.1 + 0.2 * number) if turns or number % 2 else None,
            world_v_x_m_s=0.1 if number == 8 else math.nan,
            blocks_ticks=3 if number == 20 else 0,
            stop_reason="enough" if number == 40 else None,
        )
"""


def make_strange(folder: Path, **values: Any) -> Scenario:
    """Return a scenario of that law; a keyword is one of its parameters, or a key of a scenario."""
    path = folder / "strange.py"
    path.write_text(_LAW, encoding="utf-8")
    keys = {_name_key(key): value for key, value in values.items()}
    kind = {"law.kind": f"{path}:Strange", "law.kp": 0.1}
    return override_scenario(get_preset("textbook"), kind | keys)


def _name_key(name: str) -> str:
    if name == "max_duration_s":
        return name
    return name.replace("__", ".") if "__" in name else f"law.{name}"
