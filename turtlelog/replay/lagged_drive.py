"""The recorded commands through the lagged robot of the recorded scenario."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import ReplayError
from turtlelog.laws import Decision, Pose
from turtlelog.plants import find_plant
from turtlelog.replay.plant_ticks import Gap
from turtlelog.replay.run_pairs import has_ticks
from turtlelog.replay.sample_pairs import has_all_commands
from turtlelog.replay.taken_commands import CommandUse
from turtlelog.run import CommandColumns, Run
from turtlelog.scenario import Scenario, Start, restore_scenario
from turtlelog.simulate import Sample
from turtlelog.simulate.drives import LaggedDrive, State, build_drive
from turtlelog.simulate.sensing import Sensor
from turtlelog.simulate.transport import TimedCommands


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaggedPoses:
    """Where the recorded commands lead the robot of a recording.

    Attributes:
        states: x, y [m] and heading [rad] at the time of each recorded pose, in double precision,
            shape (n, 3).
        gaps: Stretches of time whose poses are missing; the robot is driven through them.
        commands: What became of the recorded commands.
    """

    states: NDArray[np.float64]
    gaps: tuple[Gap, ...]
    commands: CommandUse


def drive_lagged(run: Run) -> LaggedPoses:
    """Drive the robot of a recording from its start with all of its commands.

    Its scenario tells how each command reaches the robot, and what pushes that, by its seed where
    it is random; the law and the sensing play no part.

    Raises:
        ReplayError: Where the recording does not hold all of its scenario, its commands, or poses
            at the ticks from the start on.
        ScenarioError: Where the scenario is wrong.
    """
    _require_whole(run)
    scenario, plant = restore_scenario(run), find_plant(run)
    commands = _CountedCommands(scenario, plant)
    drive = build_drive(scenario, plant, commands)
    samples = [*_list_samples(run.commands)]
    published_ns = run.commands.time_ns
    ticks = run.poses.time_ns // plant.period_ns
    last = int(ticks[-1])
    # A tick owns the time up to the next: what is published then leaves after its pose.
    bounds = np.searchsorted(published_ns, np.arange(1, last + 2) * plant.period_ns).tolist()
    states, put = np.empty((last + 1, 3)), 0
    for tick in range(last + 1):
        states[tick] = drive.step(tick)[:3]
        for sample in samples[put : bounds[tick]]:
            commands.put(tick, sample)
        put = bounds[tick]
    apart = np.diff(ticks)
    return LaggedPoses(
        states=states[ticks],
        gaps=tuple(
            Gap(
                start_ns=int(run.poses.time_ns[row]),
                end_ns=int(run.poses.time_ns[row + 1]),
                missing_ticks=int(apart[row]) - 1,
            )
            for row in np.flatnonzero(apart > 1)
        ),
        commands=CommandUse(
            taken=commands.taken,
            unseen=len(run.commands) - commands.taken,
            stops=0,
            unexplained_ticks=0,
        ),
    )


def sense_driven(
    scenario: Scenario, commands: CommandColumns, time_ns: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return what is sensed of a robot from the origin at some times, driven with commands.

    The scenario's plant, transport, disturbance and sensing act, by its seed; its start, law and
    limits play no part, nor do the delays and the dropout of sensed poses, which are by the time
    of the pose.

    Args:
        scenario: Of a lagged robot.
        commands: As published, with times from 0 on [ns].
        time_ns: Not decreasing, from 0 on, shape (n,).

    Returns:
        x, y [m] and heading [rad], shape (n, 3).

    Raises:
        ReplayError: Where the scenario is of no lagged robot.
        SimulationError: Where the robot runs away.
    """
    plant = scenario.plant.facts
    origin = Start(x_m=0.0, y_m=0.0, heading_rad=0.0)
    sensing = replace(scenario.sensing, dropout_probability=0.0)
    scenario = replace(scenario, start=origin, sensing=sensing)
    queue = TimedCommands(scenario, plant)
    drive = build_drive(scenario, plant, queue)
    if not isinstance(drive, LaggedDrive):
        raise ReplayError(
            f"{scenario.name}: expected a lagged robot to drive, found {scenario.plant.kind}"
        )
    states: list[State] = []
    ticks = np.arange(-(-int(time_ns[-1]) // plant.period_ns) + 1) * plant.period_ns
    visits = np.searchsorted(time_ns, ticks, side="right").tolist()
    puts = np.searchsorted(commands.time_ns, ticks + plant.period_ns).tolist()
    samples, times, put = [*_list_samples(commands)], time_ns.tolist(), 0
    for tick, visit in enumerate(visits):
        states += drive.visit(tick, times[len(states) : visit])
        for sample in samples[put : puts[tick]]:
            queue.put(tick, sample)
        put = puts[tick]
    sensed: list[tuple[float, float, float]] = []
    sensor = Sensor(
        scenario,
        plant.period_ns,
        lambda _, pose: sensed.append((pose.x_m, pose.y_m, pose.heading_rad)),
    )
    for number, state in enumerate(states):
        sensor.receive(number, Pose(*state[:3]))
    return np.array(sensed)


def _require_whole(run: Run) -> None:
    expected = "to drive a lagged robot with the recorded commands"
    if not run.scenario_is_complete:
        raise ReplayError(
            f"{run.name}: expected a whole scenario {expected}, found a part:"
            " it tells when each command reaches the robot"
        )
    if not has_ticks(run) or run.poses.time_ns[0] != 0:
        period_ms = find_plant(run).period_ns / 1e6
        first_s = run.poses.time_ns[0] / 1e9
        raise ReplayError(
            f"{run.name}: expected a pose per tick of exactly {period_ms:g} ms from 0 s on"
            f" {expected}, found the first at {first_s:g} s: a robot's rates before that are not"
            " recorded"
        )
    if not len(run.commands) or not has_all_commands(run):
        raise ReplayError(
            f"{run.name}: expected a command per sample {expected},"
            f" found {len(run.commands)} of {int(run.samples.sequence[-1]) + 1}"
            if len(run.samples)
            else f"{run.name}: expected commands {expected}, found none"
        )


def _list_samples(commands: CommandColumns) -> Iterator[Sample]:
    """Yield commands as samples, which carry them through the queues, in order."""
    columns = (commands.time_ns, commands.speed_m_s, commands.turn_rate_rad_s)
    rows = zip(*(column.tolist() for column in columns), strict=True)
    for number, (time_ns, speed, turn_rate) in enumerate(rows):
        yield Sample(
            time_ns=time_ns,
            sequence=number,
            pose_sequence=0,
            decision=Decision(speed_m_s=speed, turn_rate_rad_s=turn_rate),
            phase=0,
            speed_m_s=speed,
            turn_rate_rad_s=turn_rate,
            distance_m=float("nan"),
            published_ns=time_ns,
        )


class _CountedCommands(TimedCommands):
    """Commands on their way, and how many of them the robot has taken.

    Attributes:
        taken: So far; a command that arrives twice counts once.
    """

    taken = 0
    _last = -1

    def take(self, tick: int) -> Sample | None:
        found = super().take(tick)
        if found is not None:
            self._count(found)
        return found

    def list_arrived(self, until_ns: int) -> Iterator[tuple[int, Sample]]:
        for arrival_ns, command in super().list_arrived(until_ns):
            self._count(command)
            yield arrival_ns, command

    def _count(self, command: Sample) -> None:
        # None overtakes another, so one that comes again comes next.
        self.taken += command.sequence != self._last
        self._last = command.sequence
