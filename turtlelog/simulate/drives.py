"""A plant and what moves it: the commands that arrive, and what pushes it."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final, Protocol

from turtlelog.errors import SimulationError
from turtlelog.plants import Plant, Turtle, round_to_float32
from turtlelog.plants.lagged import LaggedRobot
from turtlelog.scenario import Scenario
from turtlelog.simulate.law_driver import LARGEST_FLOAT
from turtlelog.simulate.random_streams import RandomStream
from turtlelog.simulate.transport import CommandQueue, TimedCommands

State = tuple[float, float, float, float, float]
"""x, y [m], heading [rad], magnitude of the velocity [m/s], turn rate [rad/s]."""

Push = tuple[float, float]
"""Speed [m/s] and turn rate [rad/s] that a disturbance adds."""

_NO_PUSH: Final = (0.0, 0.0)


class Body(Protocol):
    """What is moved."""

    @property
    def hit_wall(self) -> bool:
        """Whether the last step clamped the position to the world."""
        ...

    @property
    def state(self) -> State:
        """What a pose message holds, in double precision."""
        ...


class Drive(Protocol):
    """A plant that takes the commands that arrive."""

    @property
    def body(self) -> Body:
        """What is moved."""
        ...

    def step(self, tick: int) -> State:
        """Move up to the time of a tick and return the state then."""
        ...


class TurtleDrive:
    """A turtle that takes a command per step.

    Attributes:
        body: The turtle.
    """

    __slots__ = ("_commands", "body")

    def __init__(self, turtle: Turtle, commands: CommandQueue) -> None:
        self.body, self._commands = turtle, commands

    def step(self, tick: int) -> State:
        """Move for one step and return the state after it."""
        turtle, command = self.body, self._commands.take(tick)
        if command is not None:
            turtle.take_command(command.speed_m_s, command.turn_rate_rad_s)
        turtle.step()
        return turtle.state


class PushedTurtleDrive(TurtleDrive):
    """A turtle whose velocities a disturbance adds to; the watchdog stops only what it holds."""

    __slots__ = ("_disturbed", "_held", "_idle_ns", "_period_ns", "_watchdog_ns")

    def __init__(
        self, turtle: Turtle, commands: CommandQueue, plant: Plant, disturbed: "_Disturbed"
    ) -> None:
        """Take a turtle without a watchdog of its own, and that of its `plant`."""
        super().__init__(turtle, commands)
        self._period_ns, self._watchdog_ns = plant.period_ns, plant.watchdog_ns
        self._disturbed, self._held, self._idle_ns = disturbed, _NO_PUSH, 0

    def step(self, tick: int) -> State:
        """Move for one step and return the state after it."""
        turtle, command = self.body, self._commands.take(tick)
        if command is not None:
            self._held, self._idle_ns = (command.speed_m_s, command.turn_rate_rad_s), 0
        else:
            self._idle_ns += self._period_ns
        if self._idle_ns > self._watchdog_ns:
            self._held = _NO_PUSH
        (speed, turn_rate), time_ns = self._held, tick * self._period_ns
        push_speed, push_turn_rate = self._disturbed.find_push(tick, time_ns)
        turtle.take_command(speed + push_speed, turn_rate + push_turn_rate)
        turtle.step()
        return turtle.state


class LaggedDrive:
    """A robot to which commands come at any nanosecond, or one per period.

    Attributes:
        body: The robot.
    """

    __slots__ = ("_commands", "_disturbed", "_newest_only", "_period_ns", "_push", "body")

    def __init__(
        self, robot: LaggedRobot, commands: TimedCommands, scenario: Scenario, period_ns: int
    ) -> None:
        self.body, self._commands, self._period_ns = robot, commands, period_ns
        self._newest_only = scenario.loop.queue_policy == "newest"
        self._disturbed = _Disturbed(scenario, period_ns) if scenario.disturbance.acts else None
        self._push = _NO_PUSH

    def step(self, tick: int) -> State:
        """Move up to the time of a tick and return the state then."""
        (state,) = self.visit(tick, (tick * self._period_ns,))
        return state

    def visit(self, tick: int, times_ns: Sequence[int]) -> list[State]:
        """Move up to the time of a tick and return the states at times since the tick before."""
        robot, time_ns = self.body, tick * self._period_ns
        since_ns = time_ns - self._period_ns
        if self._newest_only:
            for arrival_ns, command in self._commands.list_arrived(time_ns):
                robot.take_command(arrival_ns, command.speed_m_s, command.turn_rate_rad_s)
        elif (taken := self._commands.take(tick)) is not None:
            robot.take_command(since_ns, taken.speed_m_s, taken.turn_rate_rad_s)
        if self._disturbed is not None and tick:
            for push_ns, push in self._disturbed.list_pushes(tick, since_ns, time_ns):
                if push != self._push:
                    robot.push(push_ns, *push)
                    self._push = push
        states = [self._move_to(at_ns) for at_ns in times_ns]
        robot.advance(time_ns)
        return states

    def _move_to(self, time_ns: int) -> State:
        self.body.advance(time_ns)
        state = self.body.state
        if not max(map(abs, state)) < LARGEST_FLOAT:
            raise SimulationError(
                f"the robot runs away: at {time_ns / 1e9:g} s x = {state[0]:g} m,"
                f" y = {state[1]:g} m, speed {state[3]:g} m/s, turn rate {state[4]:g} rad/s;"
                f" a pose holds numbers below {LARGEST_FLOAT:g}"
            )
        return state


class _Disturbed:
    """What a disturbance adds in each step of a plant."""

    __slots__ = ("_from_ns", "_noise", "_push", "_scales", "_to_ns")

    def __init__(self, scenario: Scenario, period_ns: int) -> None:
        found = scenario.disturbance
        self._from_ns = round(found.from_s * 1e9)
        self._to_ns = found.to_s if math.isinf(found.to_s) else round(found.to_s * 1e9)
        self._push = found.speed_m_s, found.turn_rate_rad_s
        # A velocity held for a step moves by its standard deviation times the step.
        root = math.sqrt(period_ns / 1e9)
        self._scales = found.noise_speed / root, found.noise_turn_rate / root
        self._noise = RandomStream(scenario.seed, "disturbance", width=2, kind="normal")

    def find_push(self, step: int, time_ns: int) -> Push:
        """Return what is added in a step of which a time tells whether it lies within."""
        if not self._from_ns <= time_ns < self._to_ns:
            return _NO_PUSH
        speed, turn_rate = self._push
        scale, turn_scale = self._scales
        if not (scale or turn_scale):
            return self._push
        noise, turn_noise = self._noise.draw(step)
        return speed + scale * noise, turn_rate + turn_scale * turn_noise

    def list_pushes(self, step: int, since_ns: int, until_ns: int) -> Iterator[tuple[int, Push]]:
        """Yield the pushes of a step, each with the time from which on it acts [ns]."""
        edges = (self._from_ns, self._to_ns)
        for time_ns in (since_ns, *(int(edge) for edge in edges if since_ns < edge < until_ns)):
            yield time_ns, self.find_push(step, time_ns)


def build_drive(scenario: Scenario, plant: Plant, commands: CommandQueue) -> Drive:
    """Return the plant of a scenario at its start."""
    start, is_rounded = scenario.start, scenario.start.precision == "float32"
    x_m, y_m, heading_rad = start.x_m, start.y_m, start.heading_rad
    if isinstance(commands, TimedCommands) and scenario.plant.kind == "lagged":
        if is_rounded:
            x_m, y_m, heading_rad = map(round_to_float32, (x_m, y_m, heading_rad))
        robot = LaggedRobot(scenario.plant, x_m=x_m, y_m=y_m, heading_rad=heading_rad)
        return LaggedDrive(robot, commands, scenario, plant.period_ns)
    is_pushed = scenario.disturbance.acts
    turtle = Turtle(
        x_m=x_m,
        y_m=y_m,
        heading_rad=heading_rad,
        is_rounded=is_rounded,
        plant=replace(plant, watchdog_ns=math.inf) if is_pushed else plant,
    )
    if not is_pushed:
        return TurtleDrive(turtle, commands)
    return PushedTurtleDrive(turtle, commands, plant, _Disturbed(scenario, plant.period_ns))
