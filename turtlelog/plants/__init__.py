"""Plants: what is driven, one file each."""

from turtlelog.plants.lagged import (
    LAGGED,
    LARGEST_M,
    LaggedParameters,
    LaggedRobot,
    build_lagged_plant,
    find_plant,
    read_plant,
)
from turtlelog.plants.turtlesim import TURTLESIM, Plant, Turtle, round_to_float32

__all__ = [
    "LAGGED",
    "LARGEST_M",
    "TURTLESIM",
    "LaggedParameters",
    "LaggedRobot",
    "Plant",
    "Turtle",
    "build_lagged_plant",
    "find_plant",
    "read_plant",
    "round_to_float32",
]
