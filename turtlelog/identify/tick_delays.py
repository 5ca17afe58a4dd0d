"""Turtlesim's dead time, read from its poses: which tick took which command."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from turtlelog.errors import ReplayError
from turtlelog.identify.axis_motion import NAMES, Axis, get_commands
from turtlelog.identify.held_response import Values
from turtlelog.identify.robot_model import AxisModel, Estimate, RobotModel, TickDelays
from turtlelog.plants import TURTLESIM, find_plant
from turtlelog.replay.plant_ticks import find_breaks, read_motion
from turtlelog.replay.taken_commands import follow_commands, place_commands
from turtlelog.run import Run

_MOST_UNEXPLAINED: Final = 0.05
"""Share of the moving ticks that no recorded command explains, above which the poses are not of
turtlesim, or of other commands. A recorder that began late misses the first command only."""

_HERE: Final = "turtlesim moves by the command of a tick, whole and at once"


def identify_ticks(runs: Sequence[Run]) -> RobotModel | None:
    """Return when each command moved turtlesim; None of other robots, and without commands."""
    found = [_list_delays(run) for run in runs]
    if any(delays is None for delays in found):
        return None
    delays_s = np.concatenate([delays for delays in found if delays is not None])
    if not len(delays_s):
        return None
    delays = TickDelays(
        shown=len(delays_s),
        commands=sum(len(run.commands) for run in runs),
        least_s=float(delays_s.min()),
        median_s=float(np.median(delays_s)),
        largest_s=float(delays_s.max()),
    )
    return RobotModel(
        files=tuple(run.name for run in runs),
        clock=runs[0].clock,
        speed=_describe(runs, "speed", delays),
        turn_rate=_describe(runs, "turn_rate", delays),
        tick_delays=delays,
        notes=(
            f"Exact: {_HERE}. The interval of the dead time is from the least to the largest, from"
            " the time of a command to that of the pose that shows it first; a command that"
            " changes nothing shows in none.",
        ),
    )


def _list_delays(run: Run) -> Values | None:
    """Return how late each command was taken [s]; None where the ticks do not tell."""
    if find_plant(run) is not TURTLESIM:
        return None
    try:
        motion = read_motion(run)
    except ReplayError:
        return None
    starts = find_breaks(motion)[2]
    _, use = place_commands(motion, run, frozenset(starts))
    moving = np.count_nonzero((motion.speed_m_s != 0.0) | (motion.turn_rate_rad_s != 0.0))
    if use.unexplained_ticks > _MOST_UNEXPLAINED * moving:
        return None
    commands, poses = follow_commands(run).T
    return np.asarray((motion.time_ns[poses] - run.commands.time_ns[commands]) / 1e9)


def _describe(runs: Sequence[Run], axis: Axis, delays: TickDelays) -> AxisModel:
    if not any(get_commands(run, axis).any() for run in runs):
        name = NAMES[axis]
        reason = f"the {name} is never commanded"
        return AxisModel(
            axis=axis,
            status="not_identifiable",
            reason=reason,
            advice=f"step the {name} ten times for 2 s",
        )
    poses = sum(len(run.poses) for run in runs)
    delay = Estimate(value=delays.median_s, low=delays.least_s, high=delays.largest_s)
    return AxisModel(
        axis=axis,
        status="ok",
        gain=Estimate(value=1.0, low=1.0, high=1.0, unit="1"),
        dead_time_s=delay,
        lag_s=Estimate(value=0.0, low=0.0, high=0.0),
        total_delay_s=delay,
        steps=poses,
        steps_in_all=poses,
        changes=sum(int(np.count_nonzero(np.diff(get_commands(run, axis)))) for run in runs),
    )
