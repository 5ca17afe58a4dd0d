from .lagged import (
    LAGGED as LAGGED,
    LARGEST_M as LARGEST_M,
    LaggedParameters as LaggedParameters,
    LaggedRobot as LaggedRobot,
    build_lagged_plant as build_lagged_plant,
    find_plant as find_plant,
    read_plant as read_plant,
)
from .turtlesim import (
    TURTLESIM as TURTLESIM,
    Plant as Plant,
    Turtle as Turtle,
    round_to_float32 as round_to_float32,
)
