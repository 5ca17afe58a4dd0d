"""The recorded commands through the lagged robot of the recorded scenario."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import ReplayError
from turtlelog.plants import PLANTS, find_plant
from turtlelog.replay.plant_ticks import Gap
from turtlelog.replay.run_pairs import has_all_commands, has_ticks
from turtlelog.replay.taken_commands import CommandUse
from turtlelog.run import CommandColumns, Run
from turtlelog.scenario import Scenario, Start, restore_scenario
from turtlelog.simulate.driven import DrivenPlant, State, list_commands


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
    drive, commands = DrivenPlant(scenario), list_commands(run.commands)
    published_ns = run.commands.time_ns
    ticks = run.poses.time_ns // plant.period_ns
    last = int(ticks[-1])
    # A tick owns the time up to the next: what is published then leaves after its pose.
    bounds = np.searchsorted(published_ns, np.arange(1, last + 2) * plant.period_ns).tolist()
    states, put = np.empty((last + 1, 3)), 0
    for tick in range(last + 1):
        for _ in drive.visit(tick):
            pass
        states[tick] = drive.read()[:3]
        for command in commands[put : bounds[tick]]:
            drive.put(tick, *command)
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
            taken=drive.taken,
            unseen=len(run.commands) - drive.taken,
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
    if PLANTS[scenario.plant.kind].acts_in_steps:
        raise ReplayError(
            f"{scenario.name}: the plant is {scenario.plant.kind}, not a robot model (lagged)"
        )
    period_ns = scenario.plant.facts.period_ns
    origin = Start(x_m=0.0, y_m=0.0, heading_rad=0.0)
    sensing = replace(scenario.sensing, dropout_probability=0.0)
    scenario = replace(scenario, start=origin, sensing=sensing)
    drive, given = DrivenPlant(scenario), list_commands(commands)
    states: list[State] = []
    ticks = np.arange(-(-int(time_ns[-1]) // period_ns) + 1) * period_ns
    visits = np.searchsorted(time_ns, ticks, side="right").tolist()
    puts = np.searchsorted(commands.time_ns, ticks + period_ns).tolist()
    times, put = time_ns.tolist(), 0
    for tick, visit in enumerate(visits):
        states += drive.visit(tick, times[len(states) : visit])
        for command in given[put : puts[tick]]:
            drive.put(tick, *command)
        put = puts[tick]
    poses = [(state[0], state[1], state[2]) for state in states]
    return np.array([drive.sense(number, pose) for number, pose in enumerate(poses)])


def _require_whole(run: Run) -> None:
    expected = "to drive a robot model with the recorded commands"
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
            else f"{run.name}: no commands {expected}"
        )
