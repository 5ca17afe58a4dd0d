"""The controller's side of the loop: its pose queue, its law, its blocking."""

from collections import deque
from typing import Final

from turtlelog.errors import SimulationError
from turtlelog.laws import Pose
from turtlelog.plants import Plant
from turtlelog.scenario import Scenario
from turtlelog.simulate.law_driver import LawDriver, Sample, Samples
from turtlelog.simulate.random_streams import RandomStream

_NEVER_NS: Final = 2**63
"""Later than any time of a run."""


class Controller:
    """Answers queued poses in order, one command each; a law that blocks lets poses pile up.

    Attributes:
        dropped: Poses that the full queue has pushed out so far.
        failure: Why the law gave no answer to a pose, None while it does.
    """

    __slots__ = (
        "_block",
        "_blocked",
        "_driver",
        "_period_ticks",
        "_poses",
        "_waits_for",
        "dropped",
        "failure",
    )

    def __init__(self, scenario: Scenario, driver: LawDriver, *, block: int = 1) -> None:
        """Wait for `loop.start_backlog` poses before the first answer.

        A law blocks for ticks of the plant as it is, which last `block` steps each: a finer clock
        makes several steps of each tick.
        """
        self._driver = driver
        self._period_ticks = scenario.loop.period_ticks
        self._block = block
        self._waits_for = scenario.loop.start_backlog
        self._poses: deque[tuple[int, Pose]] = deque(maxlen=scenario.loop.pose_queue)
        self._blocked: tuple[int, Sample] | None = None
        self.dropped = 0
        self.failure: SimulationError | None = None

    def receive(self, tick: int, pose: Pose) -> None:
        """Queue the pose of a tick, every n-th of them."""
        if tick % self._period_ticks:
            return
        self.dropped += len(self._poses) == self._poses.maxlen
        self._poses.append((tick, pose))
        if self._waits_for:
            self._waits_for -= 1

    def answer(self, tick: int, time_ns: int) -> tuple[Samples, Samples]:
        """Return the samples computed in a tick, and those whose command goes out in it."""
        if self._waits_for:
            return (), ()
        if self._blocked is None:
            return self._answer_waiting(tick, time_ns)
        free_at_tick, blocked = self._blocked
        if tick < free_at_tick:
            return (), ()
        self._blocked = None
        if blocked.decision.stop_reason is not None:
            return (), (blocked,)
        computed, answered = self._answer_waiting(tick, time_ns)
        return computed, (blocked, *answered)

    def _answer_waiting(self, now: int, time_ns: int) -> tuple[Samples, Samples]:
        """Answer the poses that wait, until the law blocks, ends or fails.

        `now` is the time in the unit in which it blocks.
        """
        computed: Samples = ()
        published: Samples = ()
        poses, answer = self._poses, self._driver.answer
        while poses:
            pose_sequence, pose = poses.popleft()
            try:
                sample = answer(time_ns, pose_sequence, pose)
            except SimulationError as err:
                self.failure = err
                break
            computed += (sample,)
            if sample.decision.blocks_ticks > 0:
                self._blocked = now + sample.decision.blocks_ticks * self._block, sample
                break
            published += (sample,)
            if sample.decision.stop_reason is not None:
                break
        return computed, published


class TimedController(Controller):
    """A controller to which poses come at any nanosecond; no pose overtakes another."""

    __slots__ = (
        "_arrivals",
        "_arrived_ns",
        "_delay_ns",
        "_end_ns",
        "_jitter",
        "_jitter_ns",
        "_period_ns",
    )

    def __init__(self, scenario: Scenario, driver: LawDriver, plant: Plant) -> None:
        """Wait for `loop.start_backlog` poses before the first answer."""
        super().__init__(scenario, driver, block=scenario.plant.facts.period_ns)
        sensing = scenario.sensing
        self._period_ns = plant.period_ns
        self._delay_ns, self._jitter_ns = round(sensing.delay_s * 1e9), sensing.jitter_s * 1e9
        self._jitter = RandomStream(scenario.seed, "sensing_jitter", kind="uniform")
        self._arrivals: deque[tuple[int, int, Pose]] = deque()
        self._arrived_ns = 0
        self._end_ns = round(scenario.max_duration_s * 1e9) + 1

    def receive(self, tick: int, pose: Pose) -> None:
        """Send the pose of a tick on its way."""
        arrival_ns = tick * self._period_ns + self._delay_ns
        if self._jitter_ns:
            arrival_ns += round(self._jitter_ns * self._jitter.draw(tick)[0])
        self._arrived_ns = arrival_ns = max(arrival_ns, self._arrived_ns)
        self._arrivals.append((arrival_ns, tick, pose))

    def answer(self, tick: int, time_ns: int) -> tuple[Samples, Samples]:
        """Return the samples computed in a tick, and those whose command goes out in it."""
        del tick
        computed: Samples = ()
        published: Samples = ()
        before_ns = min(time_ns + self._period_ns, self._end_ns)
        while (now_ns := self._find_next_ns()) < before_ns:
            self._deliver(now_ns)
            if self._blocked is not None:
                free_ns, sample = self._blocked
                if now_ns < free_ns:
                    continue
                self._blocked = None
                published += (sample,)
            if not (published and published[-1].decision.stop_reason) and not self._waits_for:
                answered, sent = self._answer_due(now_ns)
                computed += answered
                published += sent
            if self.failure is not None or (published and published[-1].decision.stop_reason):
                break
        return computed, published

    def _find_next_ns(self) -> int:
        """Return the time at which something happens next [ns]."""
        arrival_ns = self._arrivals[0][0] if self._arrivals else _NEVER_NS
        return arrival_ns if self._blocked is None else min(arrival_ns, self._blocked[0])

    def _deliver(self, now_ns: int) -> None:
        """Queue the poses that have come."""
        while self._arrivals and self._arrivals[0][0] <= now_ns:
            _, number, pose = self._arrivals.popleft()
            super().receive(number, pose)

    def _answer_due(self, now_ns: int) -> tuple[Samples, Samples]:
        return self._answer_waiting(now_ns, now_ns)


class TimerController(TimedController):
    """A controller that a timer asks for answers: each reads the newest pose that has come.

    The timer begins with the pose that is waited for. While the law blocks, one firing waits.
    """

    __slots__ = ("_fires_ns", "_is_due", "_newest", "_timer_ns")

    def __init__(
        self, scenario: Scenario, driver: LawDriver, plant: Plant, *, timer_ns: int
    ) -> None:
        """Fire every so often [ns]."""
        super().__init__(scenario, driver, plant)
        self._timer_ns, self._fires_ns, self._is_due = timer_ns, _NEVER_NS, False
        self._newest: tuple[int, Pose] | None = None

    def _find_next_ns(self) -> int:
        return min(super()._find_next_ns(), self._fires_ns)

    def _deliver(self, now_ns: int) -> None:
        """Take the newest pose that has come, and note whether the timer fires."""
        while self._arrivals and self._arrivals[0][0] <= now_ns:
            _, number, pose = self._arrivals.popleft()
            self._newest = number, pose
            if self._waits_for:
                self._waits_for -= 1
                self._fires_ns = _NEVER_NS if self._waits_for else now_ns
        if self._fires_ns == now_ns:
            self._is_due = True
            self._fires_ns += self._timer_ns

    def _answer_due(self, now_ns: int) -> tuple[Samples, Samples]:
        if not self._is_due or self._newest is None:
            return (), ()
        self._is_due = False
        self._poses.append(self._newest)
        return self._answer_waiting(now_ns, now_ns)


def build_controller(scenario: Scenario, driver: LawDriver, plant: Plant) -> Controller:
    """Return the controller of a scenario: by ticks, or by nanoseconds where need be."""
    if scenario.loop.period_s is not None:
        timer_ns = round(scenario.loop.period_s * 1e9)
        return TimerController(scenario, driver, plant, timer_ns=timer_ns)
    if scenario.sensing.delays_poses:
        return TimedController(scenario, driver, plant)
    return Controller(scenario, driver, block=plant.steps_per_tick)
