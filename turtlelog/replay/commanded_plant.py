"""Recorded commands that drive a plant: alone, or through the robot model of the scenario."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import fit_line, format_short
from turtlelog.errors import ReplayError
from turtlelog.parts import NEVER_NS
from turtlelog.plants import find_plant
from turtlelog.plants.kinds import PLANTS, read_plant
from turtlelog.replay.differences import has_all_commands, has_ticks
from turtlelog.replay.recorded_motion import CommandUse, Gap
from turtlelog.run import CommandColumns, PoseColumns, Run
from turtlelog.scenario import LawChoice, Scenario, Start, flatten_scenario, restore_scenario
from turtlelog.simulate import loop
from turtlelog.simulate.loop_parts import DrawnEvents, list_streams
from turtlelog.simulate.plain_loop import PlainLoop, describe_runaway
from turtlelog.simulate.rows import SampleRow, TickRow

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
    drive = _DrivenPlant(scenario)
    given = replace(commands, time_ns=commands.time_ns - origin_ns)
    states = [*drive.follow(given, ticks)]
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

    `states` are x, y [m] and heading [rad] at the time of each recorded pose, shape (n, 3). The
    robot is simulated through the `gaps`, whose poses are missing.
    """

    states: NDArray[np.float64]
    gaps: tuple[Gap, ...]
    commands: CommandUse


def drive_lagged(run: Run) -> LaggedPoses:
    """Drive the robot of a recording from its start with all of its commands.

    The scenario with its seed determines how each command reaches the robot, and the disturbances.
    The law and the sensing are not used.

    Raises:
        ReplayError: If the recording does not contain its whole scenario, its commands, or poses at
            the ticks from the start on.
    """
    _require_whole(run)
    scenario, plant = restore_scenario(run), find_plant(run)
    drive = _DrivenPlant(scenario)
    ticks = run.poses.time_ns // plant.period_ns
    states = np.empty((int(ticks[-1]) + 1, 3))
    for tick, state in enumerate(drive.follow(run.commands, len(states) - 1)):
        states[tick] = state[:3]
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

    The plant, transport, disturbance, sensing and seed of the scenario are used; its start, law and
    limits are not. Sensed poses are neither delayed nor lost. Times do not decrease, from 0 on; the
    poses are x, y [m] and heading [rad], shape (n, 3).

    Raises:
        ReplayError: If the scenario has no robot model.
    """
    if PLANTS[scenario.plant.kind].acts_in_steps:
        raise ReplayError(
            f"{scenario.name}: the plant is {scenario.plant.kind}, not a robot model (lagged)"
        )
    period_ns = scenario.plant.facts.period_ns
    origin = Start(x_m=0.0, y_m=0.0, heading_rad=0.0)
    sensing = replace(scenario.sensing, dropout_probability=0.0)
    scenario = replace(scenario, start=origin, sensing=sensing)
    drive = _DrivenPlant(scenario)
    states = [*drive.follow(commands, -(-int(time_ns[-1]) // period_ns), time_ns)]
    return np.array([drive.sense(number, state[:3]) for number, state in enumerate(states)])


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


_State = tuple[float, float, float, float, float]
"""_State: x, y [m], heading [rad], magnitude of the velocity [m/s], turn rate [rad/s]."""


class _DrivenPlant:
    """The plant of a scenario with transport, disturbances and sensing; `taken` commands so far."""

    def __init__(self, scenario: Scenario) -> None:
        """Start at the scenario's start, on the clock of its plant."""
        made = PlainLoop(replace(scenario, law=LawChoice()))
        self._settings, self._state, self._rows = made.settings, made.state, made.rows
        self._parts, self._now, self.taken = made.parts, made.now, 0
        # Separate numbers, because poses may be sensed after all ticks, with numbers of their own.
        drawn = DrawnEvents(scenario.seed, list_streams(scenario), ticks=True)
        self._sensed_rows = replace(made.rows, drawn_ticks=drawn)
        self._last = -1
        self._acts_in_steps = PLANTS[scenario.plant.kind].acts_in_steps

    def follow(
        self, commands: CommandColumns, ticks: int, time_ns: NDArray[np.int64] | None = None
    ) -> Iterator[_State]:
        """Yield the states at given times, or else at each tick, while commands drive the plant."""
        period_ns = self._settings.scene.period_ns
        ends_ns = np.arange(ticks + 1) * period_ns
        # A tick owns the time up to the next: what is published then leaves after its pose.
        puts = np.searchsorted(commands.time_ns, ends_ns + period_ns).tolist()
        columns = (commands.time_ns, commands.speed_m_s, commands.turn_rate_rad_s)
        given = [*zip(*(column.tolist() for column in columns), strict=True)]
        wanted_ns = np.zeros(0, np.int64) if time_ns is None else time_ns
        visits = np.searchsorted(wanted_ns, ends_ns, side="right").tolist()
        times, seen, put = wanted_ns.tolist(), 0, 0
        for tick, (visit, bound) in enumerate(zip(visits, puts, strict=True)):
            yield from self._visit(tick, times[seen:visit])
            if time_ns is None:
                yield self._parts.read(self._state.plant)
            for command in given[put:bound]:
                self._publish(tick, *command)
            seen, put = visit, bound

    def _publish(self, tick: int, time_ns: int, speed: float, turn_rate: float) -> None:
        """Publish a command in a tick, at a time [ns], with speed [m/s] and turn rate [rad/s]."""
        number = self._now.samples
        row = self._rows.samples[number] = SampleRow()
        row.sequence, row.published_ns = number, time_ns
        row.speed_m_s, row.turn_rate_rad_s = speed, turn_rate
        self._now.samples += 1
        loop.publish(self._settings, self._state, self._rows, self._parts, tick, number)

    def _visit(self, tick: int, times: list[int]) -> Iterator[_State]:
        """Yield the states at times since the previous tick; advance to the time of the tick."""
        settings, state, rows = self._settings, self._state, self._rows
        scene, until_ns = settings.scene, tick * settings.scene.period_ns
        since_ns = until_ns - scene.period_ns
        self._hold(tick, since_ns, until_ns)
        at_ns = since_ns
        is_pushed = scene.is_pushed and (tick > 0 or self._acts_in_steps)
        if is_pushed and self._acts_in_steps:
            at_ns = until_ns
        while is_pushed and at_ns <= until_ns:
            loop.push_at(settings, state, rows, self._parts, tick, at_ns)
            before_ns = at_ns
            at_ns = self._parts.next_push(settings, state, rows, tick, at_ns, NEVER_NS)
            while times and times[0] < min(at_ns, until_ns) and times[0] >= before_ns:
                yield self._move_to(times.pop(0))
            if self._acts_in_steps or at_ns >= until_ns:
                break
        for time_ns in times:
            yield self._move_to(time_ns)
        self._move_to(until_ns)

    def sense(self, number: int, pose: tuple[float, float, float]) -> tuple[float, float, float]:
        """Return the sensed pose for a pose, by its number."""
        row = TickRow(*pose)
        loop.sense(self._settings, self._state, self._sensed_rows, self._parts, row, number)
        return row.sensed_x_m, row.sensed_y_m, row.sensed_heading_rad

    def _hold(self, tick: int, since_ns: int, until_ns: int) -> None:
        """Pass arriving commands on to the plant."""
        settings, state, rows, parts = self._settings, self._state, self._rows, self._parts
        scene, now = settings.scene, self._now
        if scene.acts_on_arrival:
            first = now.commands_arrived
            loop.hold_arrived(settings, state, rows, parts, until_ns)
            numbers = range(first, now.commands_arrived)
            self.taken += sum(rows.samples[number].arrivals > 0 for number in numbers)
            return
        until = until_ns + scene.causal_ns if scene.is_timed else tick
        sample = loop.take(settings, now, rows, until)
        if sample >= 0:
            row = rows.samples[sample]
            parts.hold(settings, state.plant, rows, since_ns, row.speed_m_s, row.turn_rate_rad_s)
            # Commands keep their order, so duplicates are consecutive.
            self.taken += sample != self._last
            self._last = sample

    def _move_to(self, time_ns: int) -> _State:
        moves = self._parts.move(self._settings, self._state.plant, self._rows, time_ns)
        state: _State = self._parts.read(self._state.plant)
        if not moves:
            raise describe_runaway(time_ns, state)
        return state
