from .axis_motion import NAMES as NAMES
from .motion_prediction import (
    AxisTraces as AxisTraces,
    predict_axis as predict_axis,
    trace_axis as trace_axis,
)
from .robot_identification import identify_robot as identify_robot
from .robot_model import (
    AxisModel as AxisModel,
    Estimate as Estimate,
    RobotEvent as RobotEvent,
    RobotModel as RobotModel,
    TickDelays as TickDelays,
)
from .robot_scenario import (
    RobotScenario as RobotScenario,
    build_robot_scenario as build_robot_scenario,
    read_robot_notes as read_robot_notes,
)
from .robot_words import (
    HEADS as HEADS,
    format_delay as format_delay,
    format_gain as format_gain,
    list_values as list_values,
    write_headline as write_headline,
)
