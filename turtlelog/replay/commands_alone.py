"""Commands that were recorded without poses, driven through a plant: where they lead."""

import math
from dataclasses import dataclass

import numpy as np

from turtlelog.display import fit_line, format_short
from turtlelog.errors import ReplayError
from turtlelog.plants.kinds import read_plant
from turtlelog.run import PoseColumns, Run
from turtlelog.scenario import Scenario, flatten_scenario
from turtlelog.simulate.driven import DrivenPlant, State, list_commands

_MOST_S = 3600.0
"""Time that is driven at most [s], as of a replay in closed loop."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandReplay:
    """Motion of a plant that recorded commands drive.

    Attributes:
        name: Name of the run that holds the commands.
        plant: Kind of the plant.
        run: The commands with the poses of the plant.
        path_length_m: Length of its path [m].
        taken: Commands that the plant took.
        wall_s: Time at which it first met a wall of its world, from the first command [s]; None:
            never.
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
    """Drive a plant with the commands of a run, each at its time from the first command.

    The plant is driven to the last command; one that stops by itself when commands stay out, until
    it has stopped.

    Args:
        run: Run with commands; its poses are not used.
        scenario: Its plant, start, transport and disturbance act; its law, limits and sensing play
            no part. None: turtlesim from where it spawns.

    Raises:
        ReplayError: If there are no commands, sideways ones, or they last too long.
        SimulationError: If the plant runs away.
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
    given = [(at_ns - origin_ns, speed, rate) for at_ns, speed, rate in list_commands(commands)]
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
