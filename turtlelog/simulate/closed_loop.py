"""The closed loop: plant, queues and controller, one tick at a time."""

from collections import deque
from collections.abc import Iterator
from struct import Struct
from typing import Final

import msgspec

from turtlelog.laws import Pose
from turtlelog.plants import TURTLESIM, Plant, Turtle
from turtlelog.run import Event
from turtlelog.scenario import Scenario, resolve_scenario
from turtlelog.simulate.controller import Controller
from turtlelog.simulate.law_driver import Sample, Samples, build_law
from turtlelog.simulate.step_budget import STEP_BUDGET, StepBudgetError

_POSE: Final = Struct("<5f")
"""How turtlesim publishes x, y, heading, speed and turn rate: as 32-bit floats."""


LAW_FAILED: Final = "law_failed"
"""Stop reason of a run whose law gave no answer."""


class Tick(msgspec.Struct, frozen=True, gc=False):
    """What one plant step brought.

    Attributes:
        time_ns: Simulated time [ns].
        pose: The pose as published.
        speed_m_s: Magnitude of the applied velocity [m/s].
        turn_rate_rad_s: Applied turn rate [rad/s].
        computed: Samples whose pose was answered in this tick, in order.
        published: Samples whose command went out in this tick, in order.
        events: What else happened.
        stop_reason: Why this tick is the last one, None while it is not.
        sensed: The pose as it is sensed, None where it is the pose itself or drops out.
    """

    time_ns: int
    pose: Pose
    speed_m_s: float
    turn_rate_rad_s: float
    computed: Samples
    published: Samples
    events: tuple[Event, ...]
    stop_reason: str | None
    sensed: Pose | None = None


def iterate_ticks(
    scenario: Scenario, plant: Plant = TURTLESIM, *, step_budget_s: float | None = None
) -> Iterator[Tick]:
    """Yield the ticks of a closed loop until the law is done or `max_duration_s` has passed.

    Ticks are steps of the plant, one per period; what the scenario counts in ticks as well.

    Args:
        scenario: What to simulate.
        plant: On whose clock.
        step_budget_s: How long the law may compute for one answer [s]; None: as long as it takes.

    Raises:
        SimulationError: Where the law fails or answers with something that is no number; after the
            tick in which it does, whose stop reason is `law_failed`, or `step_budget` where it
            computed for too long.
    """
    scenario = resolve_scenario(scenario)
    loop = scenario.loop
    turtle = Turtle(
        x_m=scenario.start.x_m,
        y_m=scenario.start.y_m,
        heading_rad=scenario.start.heading_rad,
        is_rounded=scenario.start.precision == "float32",
        plant=plant,
    )
    controller = Controller(
        scenario,
        build_law(scenario.law),
        steps_per_tick=plant.steps_per_tick,
        step_budget_s=step_budget_s,
    )
    commands = CommandQueue(
        depth=loop.command_queue,
        newest_only=loop.queue_policy == "newest",
        delay_ticks=loop.transport_delay_ticks,
    )
    watch = _EventWatch(turtle, controller, commands)
    exact = loop.pose_precision == "float64"
    period_ns = plant.period_ns
    last_tick = round(scenario.max_duration_s * 1e9) // period_ns
    pack_floats, round_floats = _POSE.pack, _POSE.unpack
    stop_reason: str | None = None
    for tick in range(last_tick + 1):
        time_ns = tick * period_ns
        command = commands.take(tick)
        if command is not None:
            turtle.take_command(command.speed_m_s, command.turn_rate_rad_s)
        turtle.step()
        state = turtle.state
        x_m, y_m, heading_rad, speed, turn_rate = round_floats(pack_floats(*state))
        pose = Pose(*state[:3]) if exact else Pose(x_m, y_m, heading_rad)
        controller.receive(tick, pose)
        computed, published = controller.answer(tick, time_ns)
        for sample in published:
            commands.put(tick, sample)
            stop_reason = sample.decision.stop_reason
        failure = controller.failure
        if failure is not None:
            is_late = isinstance(failure, StepBudgetError)
            stop_reason = STEP_BUDGET if is_late else LAW_FAILED
        if stop_reason is None and tick == last_tick:
            stop_reason = "max_duration"
        yield Tick(
            time_ns,
            pose,
            speed,
            turn_rate,
            computed,
            published,
            watch.find_events(time_ns, stop_reason, answered=bool(computed)),
            stop_reason,
        )
        if failure is not None:
            raise failure
        if stop_reason is not None:
            return


class CommandQueue:
    """Commands on their way to the plant: in transport, then in a queue that keeps the newest.

    Attributes:
        dropped: Commands that the full queue has pushed out so far.
    """

    __slots__ = ("_delay_ticks", "_newest_only", "_queue", "_transport", "dropped")

    def __init__(self, *, depth: int, newest_only: bool, delay_ticks: int) -> None:
        """Keep `depth` commands; with `newest_only` a take empties the queue."""
        self._queue: deque[Sample] = deque(maxlen=depth)
        self._transport: deque[tuple[int, Sample]] = deque()
        self._newest_only = newest_only
        self._delay_ticks = delay_ticks
        self.dropped = 0

    def put(self, tick: int, command: Sample) -> None:
        """Publish a command at the end of a tick."""
        if self._delay_ticks:
            self._transport.append((tick + self._delay_ticks, command))
        else:
            self._append(command)

    def take(self, tick: int) -> Sample | None:
        """Return the command that a step begins with, None where none has arrived."""
        while self._transport and self._transport[0][0] < tick:
            self._append(self._transport.popleft()[1])
        if not self._queue:
            return None
        if not self._newest_only:
            return self._queue.popleft()
        newest = self._queue.pop()
        self._queue.clear()
        return newest

    def _append(self, command: Sample) -> None:
        full = len(self._queue) == self._queue.maxlen
        self.dropped += full and not self._newest_only
        self._queue.append(command)


class _EventWatch:
    """Turns what changed since the last tick into events."""

    def __init__(self, turtle: Turtle, controller: Controller, commands: CommandQueue) -> None:
        self._turtle, self._controller, self._commands = turtle, controller, commands
        self._was_at_wall = False
        self._lost_poses = self._lost_commands = 0

    def find_events(
        self, time_ns: int, stop_reason: str | None, *, answered: bool
    ) -> tuple[Event, ...]:
        at_wall = self._turtle.hit_wall
        # What a blocked controller misses becomes one event, told when it is back.
        lost_poses = (self._controller.dropped - self._lost_poses) if answered else 0
        lost_commands = self._commands.dropped - self._lost_commands
        hit_wall = at_wall and not self._was_at_wall
        self._was_at_wall = at_wall
        if not (hit_wall or lost_poses or lost_commands or stop_reason):
            return ()
        self._lost_poses += lost_poses
        self._lost_commands += lost_commands
        x_m, y_m, *_ = self._turtle.state
        found = {
            "wall_hit": hit_wall
            and f"The turtle hit the wall at x = {x_m:.3f} m, y = {y_m:.3f} m.",
            "poses_dropped": lost_poses and f"The controller's queue dropped {lost_poses} poses.",
            "commands_dropped": lost_commands
            and f"The plant's queue dropped {lost_commands} commands.",
            "stop": stop_reason and self._describe_stop(stop_reason),
        }
        return tuple(
            Event(time_ns=time_ns, kind=kind, text=text) for kind, text in found.items() if text
        )

    def _describe_stop(self, stop_reason: str) -> str:
        failure = self._controller.failure
        because = "" if failure is None else f": {failure}"
        return f"The run ended: {stop_reason.replace('_', ' ')}{because}."
