"""Plants: what is driven, one file each."""

from turtlelog.plants.turtlesim import TURTLESIM, Plant, Turtle, round_to_float32

__all__ = ["TURTLESIM", "Plant", "Turtle", "round_to_float32"]
