"""A robot's dynamics from commands and motion."""

from turtlelog.identify.motion_prediction import (
    AxisTraces,
    PredictionError,
    measure_prediction,
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

__all__ = [
    "AxisModel",
    "AxisTraces",
    "Estimate",
    "PredictionError",
    "RobotEvent",
    "RobotModel",
    "TickDelays",
    "identify_robot",
    "measure_prediction",
    "predict_axis",
    "trace_axis",
]
