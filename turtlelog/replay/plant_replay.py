"""Recorded commands that drive a plant: compared with the recording, or in any scenario."""

import math
from array import array
from collections.abc import Iterator
from dataclasses import astuple, dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import fit_line, format_short
from turtlelog.errors import ReplayError
from turtlelog.parts import NEVER_NS
from turtlelog.plants import TURTLESIM, Turtle, find_plant, read_plant
from turtlelog.plants.turtlesim import TICK_S
from turtlelog.replay.breaks_and_commands import (
    UNSIGNED_M_S,
    CommandUse,
    Gap,
    Jump,
    RecordedMotion,
    Velocity,
    find_breaks,
    list_gaps,
    place_commands,
    read_motion,
    require_driveable,
    require_whole,
)
from turtlelog.replay.differences import (
    Difference,
    Pairing,
    PlantStretch,
    PoseError,
    ReplayResult,
    SignalDifference,
    compare_pairing,
    find_earliest,
    find_pose_error,
)
from turtlelog.run import CommandColumns, PoseColumns, Run, SourceKind, require_run
from turtlelog.scenario import LawChoice, Scenario, Start, flatten_scenario, restore_scenario
from turtlelog.simulate import loop
from turtlelog.simulate.loop_parts import DrawnEvents, list_streams
from turtlelog.simulate.plain_loop import PlainLoop, describe_runaway
from turtlelog.simulate.rows import SampleRow, TickRow

_HALF_STEP_M: Final = 2.0**-21
"""Half a 32-bit step of a coordinate between 8 and 16 m, the coarsest step in this world [m]."""

_HALF_STEP_RAD: Final = 2.0**-23  # half a 32-bit step of a heading between 2 and 4 rad [rad]
_HALF_SHARE: Final = 2.0**-24  # half a 32-bit step of a velocity, as a share of the velocity
_RIGHT: Final = 1e-9  # accuracy of a robot model's position [m]


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class PlantReplay(ReplayResult):
    """Motion of the plant under the recorded commands, compared with the recording.

    Attributes:
        name: Name of the run.
        samples: Number of compared poses.
        max_abs_error: Largest difference over all segments.
        first_difference: Earliest difference of all segments; None if rounding explains all
            differences.
        stretches: Segments in order of time.
        jumps: Jumps in order of time.
        gaps: Gaps in order of time.
        commands: Use of the recorded commands.
        heading_bits: Precision of turtlesim's heading: 64 bits, or 32 as before Humble if only 32
            reproduce the poses within rounding.
    """

    name: str
    samples: int
    max_abs_error: PoseError
    first_difference: Difference | None
    stretches: tuple[PlantStretch, ...]
    jumps: tuple[Jump, ...]
    gaps: tuple[Gap, ...]
    commands: CommandUse
    heading_bits: int = 64

    @property
    def within_rounding(self) -> bool:
        """Whether rounding explains all differences in each segment."""
        return self.first_difference is None

    @property
    def of_rounding(self) -> float:
        """Largest difference of all segments as a multiple of its bound [1]."""
        return max(stretch.of_rounding for stretch in self.stretches)

    @property
    def signals(self) -> tuple[SignalDifference, ...]:
        """x, y and heading, segment by segment."""
        return tuple(found for stretch in self.stretches for found in stretch.signals)

    @property
    def others(self) -> tuple[Difference, ...]:
        """Differences that belong to no signal: always empty."""
        return ()


def replay_plant(run: Run) -> PlantReplay:
    """Drive the plant with the commands of a recording and compare the poses.

    For turtlesim, the applied velocities in the poses show in which tick each command was taken.
    After each jump or gap, the plant starts again from the recorded pose. Any other plant is driven
    from its start to the end; its scenario determines when a command arrives.

    Raises:
        ReplayError: If a run of turtlesim has no applied velocities, or its poses are not ticks;
            for any other plant, if the run lacks a part of its scenario, its start or commands.
    """
    require_run(run)
    if find_plant(run) != TURTLESIM:
        return _replay_scenario(run)
    motion = read_motion(run)
    jumps, gaps, starts = find_breaks(motion)
    velocities, is_recorded, use = place_commands(motion, run, frozenset(starts))
    bounds = [*map(slice, [0, *starts], [*starts, len(motion.time_ns)])]
    drive = partial(_replay_stretch, motion, velocities, is_recorded)
    stretches, heading_bits = tuple(drive(rows, keeps_32_bits=False) for rows in bounds), 64
    first = find_earliest(stretch.first_difference for stretch in stretches)
    if first is not None:
        old = tuple(drive(rows, keeps_32_bits=True) for rows in bounds)
        if all(stretch.within_rounding for stretch in old):
            stretches, heading_bits, first = old, 32, None
    errors = [astuple(stretch.max_abs_error) for stretch in stretches]
    x_m, y_m, heading_rad = np.max(errors, axis=0).tolist()
    return PlantReplay(
        name=run.name,
        samples=len(motion.time_ns),
        max_abs_error=PoseError(x_m=x_m, y_m=y_m, heading_rad=heading_rad),
        first_difference=first,
        stretches=stretches,
        jumps=jumps,
        gaps=gaps,
        commands=use,
        heading_bits=heading_bits,
    )


def _replay_stretch(
    motion: RecordedMotion,
    velocities: tuple[Velocity, ...],
    is_recorded: NDArray[np.bool_],
    rows: slice,
    *,
    keeps_32_bits: bool,
) -> PlantStretch:
    """Replay a segment. In some ticks the recorded velocity replaces a command."""
    first, after = rows.start, rows.stop
    (x_m, y_m), heading_rad = motion.xy_m[first].tolist(), float(motion.heading_rad[first])
    turtle = Turtle(x_m=x_m, y_m=y_m, heading_rad=heading_rad, keeps_32_bits=keeps_32_bits)
    states = array("d", turtle.state[:3])
    driven_m = 0.0
    for forward, left, turn_rate in velocities[first + 1 : after]:
        # Taken anew in every tick: when the plant's own watchdog fires depends on the wall clock,
        # and the recorded velocities tell it.
        turtle.take_command(forward, turn_rate, left)
        turtle.step()
        states.extend(turtle.state[:3])
        driven_m += math.hypot(forward, left) * TICK_S
    # A recorded velocity is off by half a 32-bit step, which adds up over the ticks that use it. It
    # has no sign, and a slow one is taken as forward.
    recorded = is_recorded[first + 1 : after]
    ticks, speeds_m_s = int(recorded.sum()), motion.speed_m_s[first + 1 : after][recorded]
    unsigned_m = 2.0 * TICK_S * float(speeds_m_s[speeds_m_s < UNSIGNED_M_S].sum())
    within = motion.speed_m_s[first:after], np.abs(motion.turn_rate_rad_s[first:after])
    off_m, off_rad = (_HALF_SHARE * TICK_S * ticks * float(values.max()) for values in within)
    # A heading of 32 bits is published whole, and nothing of it is lost.
    lost_rad = 0.0 if keeps_32_bits and not ticks else 2.0 * _HALF_STEP_RAD
    rounding_rad = lost_rad + off_rad
    start_rad = max(rounding_rad - _HALF_STEP_RAD, 0.0)
    return _compare_stretch(
        motion.time_ns[first:after],
        recorded=np.column_stack([motion.xy_m, motion.heading_rad])[first:after],
        states=np.frombuffer(states).reshape(-1, 3),
        rounding_m=3.0 * _HALF_STEP_M + off_m + unsigned_m + driven_m * start_rad,
        rounding_rad=rounding_rad,
    )


def _replay_scenario(run: Run) -> PlantReplay:
    """Drive the plant of a recording from its start with all of its commands, through all gaps.

    The scenario with its seed determines how each command reaches the plant, and the disturbances.
    The law and the sensing are not used.
    """
    require_whole(run)
    drive, poses = _DrivenPlant(restore_scenario(run)), run.poses
    ticks = poses.time_ns // find_plant(run).period_ns
    states = np.empty((int(ticks[-1]) + 1, 3))
    for tick, state in enumerate(drive.follow(run.commands, len(states) - 1)):
        states[tick] = state[:3]
    farthest_m, apart = float(np.abs(poses.xy_m).max()), np.diff(ticks)
    stretch = _compare_stretch(
        poses.time_ns,
        recorded=np.column_stack([poses.xy_m, poses.heading_rad]),
        states=states[ticks],
        rounding_m=max(float(np.spacing(np.float32(farthest_m))), _RIGHT),
        rounding_rad=2.0 * _HALF_STEP_RAD,
    )
    return PlantReplay(
        name=run.name,
        samples=len(poses),
        max_abs_error=stretch.max_abs_error,
        first_difference=stretch.first_difference,
        stretches=(stretch,),
        jumps=(),
        gaps=list_gaps(poses.time_ns, apart, apart > 1),
        commands=CommandUse(taken=drive.taken, unseen=len(run.commands) - drive.taken),
    )


def _compare_stretch(
    time_ns: NDArray[np.int64],
    *,
    recorded: NDArray[np.float64],
    states: NDArray[np.float64],
    rounding_m: float,
    rounding_rad: float,
) -> PlantStretch:
    replayed = states
    if (recorded == recorded.astype(np.float32)).all():  # otherwise published in double precision
        replayed = states.astype(np.float32).astype(np.float64)
    x, y, heading = zip(recorded.T, replayed.T, strict=True)
    turn = Pairing("heading", "rad", time_ns, *heading, "angle")
    signals = (
        compare_pairing(Pairing("x", "m", time_ns, *x), tolerance=rounding_m),
        compare_pairing(Pairing("y", "m", time_ns, *y), tolerance=rounding_m),
        compare_pairing(turn, tolerance=rounding_rad),
    )
    return PlantStretch(
        start_ns=int(time_ns[0]),
        end_ns=int(time_ns[-1]),
        ticks=len(time_ns) - 1,
        max_abs_error=find_pose_error(signals),
        signals=signals,
        rounding_m=rounding_m,
        rounding_rad=rounding_rad,
    )


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
    plant, commands = read_plant(parameters), run.commands
    require_driveable(run)
    origin_ns, last_ns = commands.time_ns[[0, -1]].tolist()
    end_ns = last_ns - origin_ns
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
        source=SourceKind.REPLAY.describe(run.name),
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
    plant = scenario.plant.facts
    if plant.acts_in_steps:
        raise ReplayError(f"{scenario.name}: the plant is {plant.name}, not a robot model (lagged)")
    origin = Start(x_m=0.0, y_m=0.0, heading_rad=0.0)
    sensing = replace(scenario.sensing, dropout_probability=0.0)
    scenario = replace(scenario, start=origin, sensing=sensing)
    drive = _DrivenPlant(scenario)
    states = [*drive.follow(commands, -(-int(time_ns[-1]) // plant.period_ns), time_ns)]
    return np.array([drive.sense(number, state[:3]) for number, state in enumerate(states)])


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
        self._acts_in_steps = scenario.plant.facts.acts_in_steps

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
        held = self._settings, self._state, self._rows, self._parts
        for tick, (visit, bound) in enumerate(zip(visits, puts, strict=True)):
            yield from self._visit(tick, times[seen:visit])
            if time_ns is None:
                yield self._parts.read(self._state.plant)
            for command in given[put:bound]:
                number = self._now.samples
                row = self._rows.samples[number] = SampleRow()
                row.sequence = number
                row.published_ns, row.speed_m_s, row.turn_rate_rad_s = command
                self._now.samples += 1
                loop.send_command(*held, tick, number)
            seen, put = visit, bound

    def _visit(self, tick: int, times: list[int]) -> Iterator[_State]:
        """Yield the states at times since the previous tick; advance to the time of the tick."""
        settings, state, rows = self._settings, self._state, self._rows
        scene, until_ns = settings.scene, tick * settings.scene.period_ns
        since_ns = until_ns - scene.period_ns
        self._hold(tick, since_ns, until_ns)
        is_pushed = scene.is_pushed and (tick > 0 or self._acts_in_steps)
        at_ns = until_ns if is_pushed and self._acts_in_steps else since_ns
        while is_pushed and at_ns <= until_ns:
            loop.disturb_at(settings, state, rows, self._parts, tick, at_ns)
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
        loop.sense_pose(self._settings, self._state, self._sensed_rows, self._parts, row, number)
        return row.sensed_x_m, row.sensed_y_m, row.sensed_heading_rad

    def _hold(self, tick: int, since_ns: int, until_ns: int) -> None:
        """Pass arriving commands on to the plant."""
        settings, state, rows, parts = self._settings, self._state, self._rows, self._parts
        scene, now = settings.scene, self._now
        if scene.acts_on_arrival:
            first = now.commands_arrived
            loop.hold_arrived_commands(settings, state, rows, parts, until_ns)
            numbers = range(first, now.commands_arrived)
            self.taken += sum(rows.samples[number].arrivals > 0 for number in numbers)
            return
        until = until_ns + scene.causal_ns if scene.is_timed else tick
        sample = loop.take_command(settings, now, rows, until)
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
