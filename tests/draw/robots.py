from dataclasses import replace
from typing import Any

import numpy as np

from tests.draw.rerun.rrds import make_foreign_run
from turtlelog.run import CommandColumns, PoseColumns, Run

ROWS = 200
OUTLIER_ROW = 120
OUTLIER = -143.6


def make_robot(name: str = "robot", **changes: Any) -> Run:
    """Return a robot that drives a curve, with one wild value of its turn rate."""
    time_ns = np.arange(ROWS, dtype=np.int64) * 50_000_000
    heading_rad = 0.3 * np.sin(time_ns / 1e9)
    way_m = np.cumsum([np.cos(heading_rad), np.sin(heading_rad)], axis=1).T * 0.01 - 3.0
    turn_rate = 0.3 * np.cos(time_ns / 1e9)
    turn_rate[OUTLIER_ROW] = OUTLIER
    poses = PoseColumns(
        time_ns=time_ns,
        xy_m=way_m.copy(),
        heading_rad=heading_rad,
        measured_speed_m_s=0.2 + 0.01 * np.sin(7.0 * time_ns / 1e9),
        measured_turn_rate_rad_s=turn_rate,
    )
    run = replace(make_foreign_run(50), name=name, poses=poses)
    commands = CommandColumns(
        time_ns=time_ns[::2].copy(),
        speed_m_s=np.full(ROWS // 2, 0.2),
        lateral_speed_m_s=np.zeros(ROWS // 2),
        turn_rate_rad_s=0.3 * np.cos(time_ns[::2] / 1e9),
    )
    return replace(run, **({"commands": commands} | changes))


def keep_no_commands(run: Run) -> Run:
    none = replace(
        run.commands,
        **{name: getattr(run.commands, name)[:0] for name in CommandColumns.__dataclass_fields__},
    )
    return replace(run, commands=none)
