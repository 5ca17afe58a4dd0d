"""Recorded commands that drive a plant: alone, or through the robot model of the scenario."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import fit_line, format_short
from turtlelog.errors import ReplayError
from turtlelog.plants import PLANTS, find_plant
from turtlelog.plants.kinds import read_plant
from turtlelog.replay.plant_ticks import Gap
from turtlelog.replay.run_pairs import has_all_commands, has_ticks
from turtlelog.replay.taken_commands import CommandUse
from turtlelog.run import CommandColumns, PoseColumns, Run
from turtlelog.scenario import Scenario, Start, flatten_scenario, restore_scenario
from turtlelog.simulate.driven import DrivenPlant, State, list_plant_commands

_MOST_S = 3600.0
"""Longest simulated time [s], as for a replay in closed loop."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandReplay:
    """Motion of a plant that recorded commands drive.

    Attributes:
        name: Name of the run with the commands.
        plant: Kind of the plant.
        run: Run with the commands, and with the poses of the plant.
        path_length_m: Length of the plant's path [m].
        taken: Commands that the plant took.
        wall_s: Time from the first command at which the plant first met a wall of its world [s];
            None: never.
    """

    name: str
    plant: str
    run: Run
    path_length_m: float
    taken: int
    wall_s: float | None

    def __repr__(self) -> str:
        length = format_short(self.path_length_m, "m")
        return fit_line(f"<CommandReplay of {self.name}: {self.plant} drives {length}>")


def drive_commands(run: Run, scenario: Scenario | None = None) -> CommandReplay:
    """Drive a plant with the commands of a run, each at its time since the first command.

    The simulation ends with the last command. A plant that stops by itself without commands is
    simulated until it has stopped.

    Args:
        run: Run with commands; its poses are not used.
        scenario: Scenario whose plant, start, transport and disturbance act; its law, limits and
            sensing are not used. Default: turtlesim from its spawn pose.

    Raises:
        ReplayError: If there are no commands, there are sideways commands, or the commands last too
            long.
        SimulationError: If the plant diverges.
    """
    scenario = scenario or Scenario()
    parameters = flatten_scenario(scenario)
    plant = read_plant(parameters)
    commands = run.commands
    _require_driveable(run)
    origin_ns = int(commands.time_ns[0])
    end_ns = int(commands.time_ns[-1]) - origin_ns
    if math.isfinite(plant.watchdog_ns):
        end_ns += int(plant.watchdog_ns) + plant.period_ns
    ticks = -(-end_ns // plant.period_ns)
    drive = DrivenPlant(scenario)
    given = [
        (at_ns - origin_ns, speed, rate) for at_ns, speed, rate in list_plant_commands(commands)
    ]
    published_ns = commands.time_ns - origin_ns
    # A tick owns the time up to the next: what is published then leaves after its pose.
    bounds = np.searchsorted(published_ns, np.arange(1, ticks + 2) * plant.period_ns).tolist()
    states: list[State] = []
    put = 0
    for tick in range(ticks + 1):
        for _ in drive.visit(tick):
            pass
        states.append(drive.read())
        for command in given[put : bounds[tick]]:
            drive.put(tick, *command)
        put = bounds[tick]
    x_m, y_m, heading_rad, speed_m_s, turn_rate_rad_s = np.array(states).T
    time_ns = origin_ns + np.arange(ticks + 1, dtype=np.int64) * plant.period_ns
    xy_m = np.column_stack([x_m, y_m])
    at_wall = ((xy_m <= plant.low_m) | (xy_m >= plant.high_m)).any(axis=1)
    driven = Run(
        name=f"{run.name} on {plant.name}",
        source=f"replay of {run.name}",
        poses=PoseColumns(
            time_ns=time_ns,
            xy_m=xy_m,
            heading_rad=heading_rad.copy(),
            speed_m_s=speed_m_s.copy(),
            turn_rate_rad_s=turn_rate_rad_s.copy(),
        ),
        commands=commands,
        samples=run.samples,
        parameters={key: one for key, one in parameters.items() if key.startswith("plant.")},
        absent=tuple(name for name in run.absent if not name.startswith("poses")),
    )
    return CommandReplay(
        name=run.name,
        plant=plant.name,
        run=driven,
        path_length_m=float(np.hypot(*np.diff(xy_m, axis=0).T).sum()),
        taken=drive.taken,
        wall_s=float(np.argmax(at_wall)) * plant.period_ns / 1e9 if at_wall.any() else None,
    )


def _require_driveable(run: Run) -> None:
    commands = run.commands
    if not len(commands):
        raise ReplayError(f"{run.name}: no commands to drive a plant with")
    if commands.lateral_speed_m_s.any():
        row = int(np.flatnonzero(commands.lateral_speed_m_s)[0])
        raise ReplayError(
            f"{run.name}: expected commands along the heading, found one to the side"
            f" (command {row + 1}): a plant that drives sideways is not known"
        )
    length_s = float(commands.time_ns[-1] - commands.time_ns[0]) / 1e9
    if length_s > _MOST_S:
        raise ReplayError(
            f"{run.name}: expected commands for {_MOST_S:g} s at most, found {length_s:g} s"
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaggedPoses:
    """Poses to which the recorded commands lead the robot of a recording.

    Attributes:
        states: x, y [m] and heading [rad] at the time of each recorded pose, in double precision,
            shape (n, 3).
        gaps: Segments of time whose poses are missing. The robot is simulated through them.
        commands: Use of the recorded commands by the robot.
    """

    states: NDArray[np.float64]
    gaps: tuple[Gap, ...]
    commands: CommandUse


def drive_lagged(run: Run) -> LaggedPoses:
    """Drive the robot of a recording from its start with all of its commands.

    The scenario determines how each command reaches the robot, and the disturbances; its seed
    determines random values. The law and the sensing are not used.

    Raises:
        ReplayError: If the recording does not contain its whole scenario, its commands, or poses at
            the ticks from the start on.
        ScenarioError: If the scenario is wrong.
    """
    _require_whole(run)
    scenario, plant = restore_scenario(run), find_plant(run)
    drive, commands = DrivenPlant(scenario), list_plant_commands(run.commands)
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
    """Return the sensed poses, at given times, of a robot that commands drive from the origin.

    The plant, transport, disturbance, sensing and seed of the scenario are used. The scenario's
    start, law and limits are not used. Sensed poses are neither delayed nor lost: the result is
    sorted by the time of the pose.

    Args:
        scenario: Scenario with a robot model.
        commands: Commands as published, with times from 0 on [ns].
        time_ns: Times of the poses [ns], not decreasing, from 0 on, shape (n,).

    Returns:
        x, y [m] and heading [rad], shape (n, 3).

    Raises:
        ReplayError: If the scenario has no robot model.
        SimulationError: If the robot diverges.
    """
    if PLANTS[scenario.plant.kind].acts_in_steps:
        raise ReplayError(
            f"{scenario.name}: the plant is {scenario.plant.kind}, not a robot model (lagged)"
        )
    period_ns = scenario.plant.facts.period_ns
    origin = Start(x_m=0.0, y_m=0.0, heading_rad=0.0)
    sensing = replace(scenario.sensing, dropout_probability=0.0)
    scenario = replace(scenario, start=origin, sensing=sensing)
    drive, given = DrivenPlant(scenario), list_plant_commands(commands)
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
