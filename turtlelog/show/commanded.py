"""What a run was commanded: by its samples, or where it has none by the messages on its topic."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from turtlelog.run import Run

Command = Literal["speed", "turn_rate"]


def read_commanded(
    run: Run, command: Command
) -> tuple[NDArray[np.int64], NDArray[np.float64]] | None:
    """Return times [ns] and values as commanded; None where the run holds no commands.

    Args:
        run: Whose commands.
        command: `speed` [m/s] or `turn_rate` [rad/s].
    """
    table = run.samples if len(run.samples) else run.commands
    if not len(table):
        return None
    return table.time_ns, table.speed_m_s if command == "speed" else table.turn_rate_rad_s
