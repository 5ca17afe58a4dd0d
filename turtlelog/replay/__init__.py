"""A Run driven again: its commands through the plant."""

from turtlelog.errors import ReplayError
from turtlelog.replay.breaks import Gap, Jump
from turtlelog.replay.placement import CommandUse
from turtlelog.replay.plant import PlantReplay, PoseError, Stretch, replay_plant

__all__ = [
    "CommandUse",
    "Gap",
    "Jump",
    "PlantReplay",
    "PoseError",
    "ReplayError",
    "Stretch",
    "replay_plant",
]
