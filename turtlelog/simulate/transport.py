"""Commands on their way from the controller to the plant: in transport, then in a queue."""

from collections import deque
from collections.abc import Iterator

from turtlelog.plants import Plant
from turtlelog.scenario import Scenario
from turtlelog.simulate.law_driver import Sample
from turtlelog.simulate.random_streams import RandomStream


class LossCount:
    """Counts what is lost by stretches, for an event each would fill a log."""

    __slots__ = ("_count", "_finished", "_since_ns")

    def __init__(self) -> None:
        self._since_ns = self._count = 0
        self._finished: tuple[int, int] | None = None

    def add(self, time_ns: int) -> None:
        """Count one that is lost at a time [ns]."""
        self._since_ns = self._since_ns if self._count else time_ns
        self._count += 1

    def end_stretch(self) -> None:
        """Note that something came through."""
        if not self._count:
            return
        since_ns, count = self._finished or (self._since_ns, 0)
        self._finished = since_ns, count + self._count
        self._count = 0

    def take_finished(self) -> tuple[int, int] | None:
        """Return since when [ns] and how many were lost, once a stretch is over, else None."""
        finished, self._finished = self._finished, None
        return finished


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
        if self._transport:
            self._receive(tick)
        if not self._queue:
            return None
        if not self._newest_only:
            return self._queue.popleft()
        newest = self._queue.pop()
        self._queue.clear()
        return newest

    def _receive(self, tick: int) -> None:
        """Queue the commands that have arrived before a step."""
        while self._transport and self._transport[0][0] < tick:
            self._append(self._transport.popleft()[1])

    def _append(self, command: Sample) -> None:
        full = len(self._queue) == self._queue.maxlen
        self.dropped += full and not self._newest_only
        self._queue.append(command)


class TimedCommands(CommandQueue):
    """Commands that each travel for a time of their own, in nanoseconds; some are lost or repeated.

    No command overtakes another: one that is late holds up those behind it. A repeated command
    arrives twice at one time.

    Attributes:
        lost: Commands that never arrive.
        pushed_out: Commands that the full queue has pushed out.
    """

    __slots__ = (
        "_arrived_ns",
        "_causal_ns",
        "_delay_ns",
        "_jitter",
        "_jitter_ns",
        "_late",
        "_late_ns",
        "_late_probability",
        "_loss",
        "_loss_probability",
        "_period_ns",
        "_repeat",
        "_repeat_probability",
        "lost",
        "pushed_out",
    )

    def __init__(self, scenario: Scenario, plant: Plant) -> None:
        """Draw what becomes of each command by the number of its sample."""
        loop, seed = scenario.loop, scenario.seed
        super().__init__(
            depth=loop.command_queue, newest_only=loop.queue_policy == "newest", delay_ticks=0
        )
        self._period_ns = plant.period_ns
        self._causal_ns = find_causal_ns(scenario, plant)
        self._delay_ns = loop.transport_delay_ticks * plant.period_ns
        self._delay_ns += round(loop.transport_delay_s * 1e9)
        self._jitter_ns, self._late_ns = loop.jitter_s * 1e9, round(loop.late_s * 1e9)
        self._loss_probability = loop.loss_probability
        self._repeat_probability = loop.repeat_probability
        self._late_probability = loop.late_probability
        self._jitter = RandomStream(seed, "transport_jitter", kind="uniform")
        self._loss = RandomStream(seed, "loss", kind="uniform")
        self._repeat = RandomStream(seed, "repeat", kind="uniform")
        self._late = RandomStream(seed, "late", kind="uniform")
        self._arrived_ns = 0
        self.lost, self.pushed_out = LossCount(), LossCount()

    def put(self, tick: int, command: Sample) -> None:
        """Publish a command, of whatever time in a tick."""
        del tick
        number, published_ns = command.sequence, command.published_ns
        if self._loss_probability and self._loss.draw(number)[0] < self._loss_probability:
            self.lost.add(published_ns)
            return
        self.lost.end_stretch()
        arrival_ns = published_ns + self._delay_ns
        if self._jitter_ns:
            arrival_ns += round(self._jitter_ns * self._jitter.draw(number)[0])
        if self._late_probability and self._late.draw(number)[0] < self._late_probability:
            arrival_ns += self._late_ns
        self._arrived_ns = arrival_ns = max(arrival_ns, self._arrived_ns)
        self._transport.append((arrival_ns, command))
        if self._repeat_probability and self._repeat.draw(number)[0] < self._repeat_probability:
            self._transport.append((arrival_ns, command))

    def take(self, tick: int) -> Sample | None:
        """Return the command that a step begins with, None where none has arrived."""
        self._receive(tick)
        if len(self._queue) < (self._queue.maxlen or 0):
            self.pushed_out.end_stretch()
        return super().take(tick)

    def _receive(self, tick: int) -> None:
        until_ns = tick * self._period_ns + self._causal_ns
        while self._transport and self._transport[0][0] < until_ns:
            arrival_ns, command = self._transport.popleft()
            dropped = self.dropped
            self._append(command)
            if self.dropped > dropped:
                self.pushed_out.add(arrival_ns)

    def list_arrived(self, until_ns: int) -> Iterator[tuple[int, Sample]]:
        """Yield the commands that arrive before a time, past the queue, with their times [ns]."""
        while self._transport and self._transport[0][0] < until_ns:
            yield self._transport.popleft()


def find_causal_ns(scenario: Scenario, plant: Plant) -> int:
    """Return how long after a pose a command that arrives is still taken for its step [ns].

    turtlesim applies what it takes to the time since its last pose. A robot cannot: what it takes
    for a period has arrived by its begin.
    """
    return 0 if scenario.plant.kind == "turtlesim" else 1 - plant.period_ns


def needs_time(scenario: Scenario) -> bool:
    """Whether commands travel for nanoseconds of their own, not for whole ticks."""
    loop = scenario.loop
    return bool(
        scenario.plant.kind != "turtlesim"
        or loop.trigger == "timer"
        or scenario.sensing.delays_poses
        or loop.transport_delay_s
        or loop.jitter_s
        or loop.loss_probability
        or loop.repeat_probability
        or loop.late_probability
    )


def build_commands(scenario: Scenario, plant: Plant) -> CommandQueue:
    """Return what lies between controller and plant: in ticks, or in nanoseconds where need be."""
    loop = scenario.loop
    if needs_time(scenario):
        return TimedCommands(scenario, plant)
    return CommandQueue(
        depth=loop.command_queue,
        newest_only=loop.queue_policy == "newest",
        delay_ticks=loop.transport_delay_ticks,
    )
