from .commanded_plant import (
    CommandReplay as CommandReplay,
    drive_commands as drive_commands,
)
from .law_replay import (
    Difference as Difference,
    LawReplay as LawReplay,
    ReplayError as ReplayError,
    SignalDifference as SignalDifference,
    replay_law as replay_law,
)
from .loop_replay import (
    LoopReplay as LoopReplay,
    replay_loop as replay_loop,
)
from .plant_replay import (
    PlantReplay as PlantReplay,
    PlantStretch as PlantStretch,
    PoseError as PoseError,
    replay_plant as replay_plant,
)
from .plant_ticks import (
    Gap as Gap,
    Jump as Jump,
    moves_as_turtlesim as moves_as_turtlesim,
)
from .run_pairs import (
    RowCount as RowCount,
)
from .taken_commands import (
    CommandUse as CommandUse,
    follow_commands as follow_commands,
)
