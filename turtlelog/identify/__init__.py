"""A robot's dynamics from commands and motion."""

from turtlelog.identify.motion_prediction import (
    AxisTraces,
    predict_axis,
    trace_axis,
)
from turtlelog.identify.robot_identification import identify_robot
from turtlelog.identify.robot_model import (
    AxisModel,
    Estimate,
    RobotEvent,
    RobotModel,
    TickDelays,
)
from turtlelog.identify.robot_scenario import RobotScenario, build_robot_scenario

__all__ = [
    "AxisModel",
    "AxisTraces",
    "Estimate",
    "RobotEvent",
    "RobotModel",
    "RobotScenario",
    "TickDelays",
    "build_robot_scenario",
    "identify_robot",
    "predict_axis",
    "trace_axis",
]
