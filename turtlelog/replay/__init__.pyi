from .breaks_and_commands import (
    CommandUse as CommandUse,
    Gap as Gap,
    Jump as Jump,
    follow_commands as follow_commands,
    moves_as_turtlesim as moves_as_turtlesim,
)
from .differences import (
    Difference as Difference,
    PlantStretch as PlantStretch,
    PoseError as PoseError,
    RowCount as RowCount,
    SignalDifference as SignalDifference,
)
from .loop_replay import (
    Departure as Departure,
    LawReplay as LawReplay,
    LoopReplay as LoopReplay,
    ReplayError as ReplayError,
    find_departure as find_departure,
    replay_law as replay_law,
    replay_loop as replay_loop,
)
from .plant_replay import (
    CommandReplay as CommandReplay,
    PlantReplay as PlantReplay,
    drive_commands as drive_commands,
    replay_plant as replay_plant,
)
