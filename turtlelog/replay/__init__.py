"""A Run driven again: through the plant, through a law, in closed loop, with changes."""

from turtlelog.differences import Difference, SignalDifference
from turtlelog.errors import ReplayError
from turtlelog.replay.law_replay import LawReplay, replay_law
from turtlelog.replay.loop_replay import LoopReplay, replay_loop
from turtlelog.replay.plant_replay import PlantReplay, PlantStretch, PoseError, replay_plant
from turtlelog.replay.plant_ticks import (
    CommandUse,
    Gap,
    Jump,
    follow_commands,
    moves_as_turtlesim,
)
from turtlelog.replay.run_pairs import RowCount

__all__ = [
    "CommandUse",
    "Difference",
    "Gap",
    "Jump",
    "LawReplay",
    "LoopReplay",
    "PlantReplay",
    "PlantStretch",
    "PoseError",
    "ReplayError",
    "RowCount",
    "SignalDifference",
    "follow_commands",
    "moves_as_turtlesim",
    "replay_law",
    "replay_loop",
    "replay_plant",
]
