from .axis_model import (
    AxisModel as AxisModel,
    AxisTraces as AxisTraces,
    Estimate as Estimate,
    predict_axis as predict_axis,
    trace_axis as trace_axis,
)
from .axis_motion import NAMES as NAMES
from .robot_identification import identify_robot as identify_robot
from .robot_model import (
    HEADS as HEADS,
    RobotEvent as RobotEvent,
    RobotModel as RobotModel,
    TickDelays as TickDelays,
    format_delay as format_delay,
    format_gain as format_gain,
    list_model_values as list_model_values,
    list_unit_faults as list_unit_faults,
    write_robot_headline as write_robot_headline,
)
from .robot_scenario import (
    RobotScenario as RobotScenario,
    build_robot_scenario as build_robot_scenario,
    read_robot_notes as read_robot_notes,
)
