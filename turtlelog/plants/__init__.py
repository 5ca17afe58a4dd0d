"""Plants: what is driven, one file each."""

from turtlelog.plants.lagged import LaggedParameters, LaggedRobot
from turtlelog.plants.turtlesim import TURTLESIM, Plant, Turtle, round_to_float32

__all__ = ["TURTLESIM", "LaggedParameters", "LaggedRobot", "Plant", "Turtle", "round_to_float32"]
