"""A law whose one loop is P, PI, PD or PID, as its parameters say, and that ignores much."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from turtlelog.laws import Decision, Goal, Pose
from turtlelog.run.loops import ControlLoop, Declaration

KIND: Final = f"{Path(__file__)}:PidLaw"


@dataclass(frozen=True, kw_only=True)
class PidParameters:
    kp: float = 1.0
    ki: Any = 0.0
    kd: float = 0.0
    tf_s: float = 0.0
    tells: str = "pid"  # which keys the loop names: "pid", "pd", "gain"
    signal: str = "heading"
    unused: Any = ()


class PidLaw:
    Parameters = PidParameters

    @classmethod
    def declare(cls, parameters: PidParameters, goal: Goal | None, path: None) -> Declaration:
        named = {"derivative_gain": "law.kd", "derivative_filter": "law.tf_s"}
        if parameters.tells == "pid":
            named["integral_gain"] = "law.ki"
        turn = ControlLoop(
            name="turn",
            signal=parameters.signal,
            command="turn_rate",
            reference="zero",
            gain="law.kp",
            is_proportional=False,
            **({} if parameters.tells == "gain" else named),
        )
        return Declaration(loops=(turn,), phases={"turn": ("turn",)}, uses_goal=False)

    @classmethod
    def list_unused(cls, parameters: PidParameters) -> Any:
        return tuple(parameters.unused)

    def __init__(self, parameters: PidParameters) -> None:
        self.parameters = parameters

    def reset(self, start: Pose, goal: Goal | None, path: None) -> None:
        pass

    def step(self, time_ns: int, pose: Pose) -> Decision:
        return Decision(speed_m_s=0.0, turn_rate_rad_s=0.0, stop_reason="done")
