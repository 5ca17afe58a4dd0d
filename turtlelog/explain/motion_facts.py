"""Facts from the poses and commands of a recording without a controller's samples."""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import ReplayError
from turtlelog.measure import Outlier, list_outliers
from turtlelog.measure.breaks import PoseGap, PoseJump, find_gaps, find_jumps
from turtlelog.plants import LAGGED, find_plant
from turtlelog.replay import PlantReplay, follow_commands, moves_as_turtlesim, replay_plant
from turtlelog.run import Run

_SPREAD: Final = (5.0, 95.0)
"""Percentiles that bound the central 90 % of periods."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Periods:
    """Times between successive rows of a table.

    Attributes:
        usual_ns: Median period [ns].
        low_ns: Lower end of the central 90 % [ns].
        high_ns: Upper end of the central 90 % [ns].
        longest_ns: Longest period [ns].
        longest_at_ns: Start of the longest period [ns].
    """

    usual_ns: float
    low_ns: float
    high_ns: float
    longest_ns: int
    longest_at_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Largest:
    """The command of the largest magnitude on an axis.

    Attributes:
        signal: `speed`, `lateral_speed` or `turn_rate`.
        unit: Unit of the signal.
        value: Signed value of the command.
        time_ns: Time of its first publication [ns].
    """

    signal: str
    unit: str
    value: float
    time_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Delays:
    """Delays from the publication of commands to the poses of turtlesim that show them.

    Attributes:
        counts: Number of commands by ticks of dead time: 0 is the first pose after the command.
        low_ns: Shortest time from a command to the pose that shows it [ns].
        median_ns: Median delay [ns].
        high_ns: Longest delay [ns].
    """

    counts: dict[int, int]
    low_ns: int
    median_ns: float
    high_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionFacts:
    """Facts about poses and commands, without the samples of a controller.

    Attributes:
        name: Name of the run.
        kind: Kind of robot that the poses belong to.
        poses: Times from one pose to the next; None for fewer than two poses.
        commands: Times from one command to the next; None for fewer than two commands.
        largest: Command of the largest magnitude on each used axis.
        outliers: Measured rates that their neighbours contradict.
        jumps: Steps that a robot cannot have driven; for turtlesim, the replay contains them.
        gaps: Segments without poses; for turtlesim, the replay contains them.
        replay: Result of replaying the commands in turtlesim's plant; None for another robot.
        refused: Reason why the replay in turtlesim's plant failed; empty after success, or for
            another robot.
        delays: Delays of turtlesim; None if no pose shows a command.
    """

    name: str
    kind: Literal["turtlesim", "robot"]
    poses: Periods | None
    commands: Periods | None
    largest: tuple[Largest, ...]
    outliers: tuple[Outlier, ...]
    jumps: tuple[PoseJump, ...]
    gaps: tuple[PoseGap, ...]
    replay: PlantReplay | None
    refused: str
    delays: Delays | None


def read_motion_facts(run: Run) -> MotionFacts:
    """Return facts from the poses and commands of a run, with or without samples."""
    is_turtlesim = find_plant(run).name != LAGGED and moves_as_turtlesim(run)
    replay, refused = None, ""
    if is_turtlesim:
        try:
            replay = replay_plant(run)
        except ReplayError as err:
            refused = str(err)
    return MotionFacts(
        name=run.name,
        kind="turtlesim" if is_turtlesim else "robot",
        poses=_measure_periods(run.poses.time_ns),
        commands=_measure_periods(run.commands.time_ns),
        largest=_find_largest(run),
        outliers=list_outliers(run),
        jumps=find_jumps(run) if replay is None else (),
        gaps=find_gaps(run) if replay is None else (),
        replay=replay,
        refused=refused,
        delays=None if replay is None else _measure_delays(run),
    )


def _measure_periods(time_ns: NDArray[np.int64]) -> Periods | None:
    if len(time_ns) < 2:
        return None
    period_ns = np.diff(time_ns)
    low_ns, high_ns = np.percentile(period_ns, _SPREAD)
    longest = int(period_ns.argmax())
    return Periods(
        usual_ns=float(np.median(period_ns)),
        low_ns=float(low_ns),
        high_ns=float(high_ns),
        longest_ns=int(period_ns[longest]),
        longest_at_ns=int(time_ns[longest]),
    )


def _find_largest(run: Run) -> tuple[Largest, ...]:
    commands = run.commands
    columns = (
        ("speed", "m/s", commands.speed_m_s),
        ("lateral_speed", "m/s", commands.lateral_speed_m_s),
        ("turn_rate", "rad/s", commands.turn_rate_rad_s),
    )
    found = []
    for signal, unit, values in columns:
        if values.any():
            row = int(np.abs(values).argmax())
            at_ns = int(commands.time_ns[row])
            found.append(Largest(signal=signal, unit=unit, value=float(values[row]), time_ns=at_ns))
    return tuple(found)


def _measure_delays(run: Run) -> Delays | None:
    command, pose = follow_commands(run).T
    if not len(command):
        return None
    published_ns = run.commands.time_ns[command]
    # A command may answer the pose at its own time. A recorder may write a command after the pose
    # that shows it, which is no dead time.
    ticks = np.maximum(pose - np.searchsorted(run.poses.time_ns, published_ns, "right"), 0)
    delay_ns = run.poses.time_ns[pose] - published_ns
    values, counts = np.unique(ticks, return_counts=True)
    return Delays(
        counts=dict(zip(values.tolist(), counts.tolist(), strict=True)),
        low_ns=int(delay_ns.min()),
        median_ns=float(np.median(delay_ns)),
        high_ns=int(delay_ns.max()),
    )
