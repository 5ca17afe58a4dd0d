"""Turtlesim's dead time, read from its poses: which tick took which command."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import ReplayError
from turtlelog.identify.axis_motion import NAMES, Axis, get_commands
from turtlelog.identify.held_response import Values
from turtlelog.identify.robot_model import AxisModel, Estimate, RobotModel, TickDelays
from turtlelog.plants import TURTLESIM, find_plant
from turtlelog.plants.turtlesim import TICK_S
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
    known = [shown for shown in found if shown is not None]
    if len(known) < len(runs):
        return None
    delays_s = np.concatenate([shown.delays_s for shown in known])
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
        speed=_describe(runs, "speed", known),
        turn_rate=_describe(runs, "turn_rate", known),
        tick_delays=delays,
        notes=(
            f"Exact: {_HERE}. The dead time is from the time of a command to the beginning of the"
            f" tick that moves by it; the pose at its end, {1e3 * TICK_S:.0f} ms later, shows it."
            " The value is the median of the commands that change the axis.",
        ),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Shown:
    """The commands of a run that poses show.

    Attributes:
        commands: Their rows, rising, shape (n,).
        delays_s: From the time of each to that of the pose that shows it first [s], shape (n,).
    """

    commands: NDArray[np.int64]
    delays_s: Values


def _list_delays(run: Run) -> _Shown | None:
    """Return which commands poses show, and how late; None where the ticks do not tell."""
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
    delays_s = (motion.time_ns[poses] - run.commands.time_ns[commands]) / 1e9
    return _Shown(commands=commands, delays_s=delays_s)


def _list_dead_times(run: Run, axis: Axis, shown: _Shown) -> Values:
    """Return the dead times of the commands that change an axis [s]: a tick less than to the pose.

    A real turtlesim takes a command at the end of a tick, and moves by it for all of the tick.
    """
    values = get_commands(run, axis)[shown.commands]
    changes = np.diff(values, prepend=0.0) != 0.0
    return np.asarray(np.maximum(shown.delays_s[changes] - TICK_S, 0.0))


def _describe(runs: Sequence[Run], axis: Axis, shown: Sequence[_Shown]) -> AxisModel:
    dead_times = [_list_dead_times(run, axis, own) for run, own in zip(runs, shown, strict=True)]
    dead_times_s = np.concatenate(dead_times)
    if not len(dead_times_s):
        name = NAMES[axis]
        reason = f"no pose shows a change of the commanded {name}"
        if not any(get_commands(run, axis).any() for run in runs):
            reason = f"the {name} is never commanded"
        return AxisModel(
            axis=axis,
            status="not_identifiable",
            reason=reason,
            advice=f"step the {name} ten times for 2 s",
        )
    poses = sum(len(run.poses) for run in runs)
    delay = Estimate(
        value=float(np.median(dead_times_s)),
        low=float(dead_times_s.min()),
        high=float(dead_times_s.max()),
    )
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
