"""The controller's side of the loop: its pose queue, its law, its blocking."""

from collections import deque

from turtlelog.errors import SimulationError
from turtlelog.laws import Law, Pose
from turtlelog.scenario import Scenario
from turtlelog.simulate.law_driver import LawDriver, Sample, Samples


class Controller:
    """Answers queued poses in order, one command each; a law that blocks lets poses pile up.

    Attributes:
        dropped: Poses that the full queue has pushed out so far.
        failure: Why the law gave no answer to a pose, None while it does.
    """

    __slots__ = (
        "_blocked",
        "_driver",
        "_period_ticks",
        "_poses",
        "_steps_per_tick",
        "_waits_for",
        "dropped",
        "failure",
    )

    def __init__(
        self,
        scenario: Scenario,
        law: Law,
        *,
        steps_per_tick: int = 1,
        step_budget_s: float | None = None,
    ) -> None:
        """Wait for `loop.start_backlog` poses before the first answer.

        A law blocks for ticks of the plant as it is; a finer clock makes several steps of each.
        """
        self._driver = LawDriver(scenario, law, step_budget_s=step_budget_s)
        self._period_ticks = scenario.loop.period_ticks
        self._steps_per_tick = steps_per_tick
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
        published: Samples = ()
        if self._blocked is not None:
            free_at_tick, blocked = self._blocked
            if tick < free_at_tick:
                return (), ()
            self._blocked = None
            published = (blocked,)
            if blocked.decision.stop_reason is not None:
                return (), published
        computed, answered = self._answer_waiting(tick, time_ns)
        return computed, published + answered

    def _answer_waiting(self, tick: int, time_ns: int) -> tuple[Samples, Samples]:
        """Answer the poses that wait, until the law blocks, ends or fails."""
        computed: Samples = ()
        published: Samples = ()
        while self._poses:
            pose_sequence, pose = self._poses.popleft()
            try:
                sample = self._driver.answer(time_ns, pose_sequence, pose)
            except SimulationError as err:
                self.failure = err
                break
            computed += (sample,)
            if sample.decision.blocks_ticks > 0:
                blocks_steps = sample.decision.blocks_ticks * self._steps_per_tick
                self._blocked = tick + blocks_steps, sample
                break
            published += (sample,)
            if sample.decision.stop_reason is not None:
                break
        return computed, published
