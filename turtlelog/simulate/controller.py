"""The controller's side of the loop: its pose queue, its law, its clipping, its blocking."""

from collections import deque
from math import hypot, isfinite

import msgspec

from turtlelog.errors import SimulationError
from turtlelog.laws import Decision, Goal, Law, Pose
from turtlelog.scenario import Scenario


class Sample(msgspec.Struct, frozen=True, gc=False):
    """One controller callback.

    Attributes:
        time_ns: Time of the tick at which the pose was answered [ns].
        sequence: Number of the sample, from 0.
        pose_sequence: Number of the pose that it read, from 0.
        decision: What the law decided.
        speed_m_s: Command after clipping [m/s].
        turn_rate_rad_s: Command after clipping [rad/s].
        distance_m: From the pose to the goal [m].
    """

    time_ns: int
    sequence: int
    pose_sequence: int
    decision: Decision
    speed_m_s: float
    turn_rate_rad_s: float
    distance_m: float


class Controller:
    """Answers queued poses in order, one command each; a law that blocks lets poses pile up.

    Attributes:
        dropped: Poses that the full queue has pushed out so far.
    """

    def __init__(self, scenario: Scenario, law: Law) -> None:
        """Wait for `loop.start_backlog` poses before the first answer."""
        self._law = law
        self._law_kind = scenario.law.kind
        self._goal = Goal(scenario.goal.x_m, scenario.goal.y_m, scenario.goal.heading_rad)
        self._limits = scenario.limits.speed_m_s, scenario.limits.turn_rate_rad_s
        self._period_ticks = scenario.loop.period_ticks
        self._waits_for = scenario.loop.start_backlog
        self._poses: deque[tuple[int, Pose]] = deque(maxlen=scenario.loop.pose_queue)
        self._sequence = 0
        self._blocked: tuple[int, Sample] | None = None
        self.dropped = 0

    def receive(self, tick: int, pose: Pose) -> None:
        """Queue the pose of a tick, every n-th of them."""
        if tick % self._period_ticks:
            return
        self.dropped += len(self._poses) == self._poses.maxlen
        self._poses.append((tick, pose))
        self._waits_for -= self._waits_for > 0

    def answer(self, tick: int, time_ns: int) -> tuple[list[Sample], list[Sample]]:
        """Return the samples computed in a tick, and those whose command goes out in it."""
        computed: list[Sample] = []
        published: list[Sample] = []
        if self._waits_for:
            return computed, published
        if self._blocked is not None:
            free_at_tick, blocked = self._blocked
            if tick < free_at_tick:
                return computed, published
            self._blocked = None
            published.append(blocked)
        while self._poses and not (published and published[-1].decision.stop_reason):
            sample = self._step(time_ns, *self._poses.popleft())
            computed.append(sample)
            if sample.decision.blocks_ticks > 0:
                self._blocked = tick + sample.decision.blocks_ticks, sample
                break
            published.append(sample)
        return computed, published

    def _step(self, time_ns: int, pose_sequence: int, pose: Pose) -> Sample:
        sequence = self._sequence
        try:
            if sequence == 0:
                self._law.reset(pose, self._goal)
            decision = self._law.step(time_ns, pose)
            wanted = decision.speed_m_s, decision.turn_rate_rad_s
            are_numbers = isfinite(wanted[0]) and isfinite(wanted[1])
        except Exception as err:
            raise SimulationError(
                f"law {self._law_kind}, sample {sequence}: {type(err).__name__}: {err}"
            ) from err
        if not are_numbers:
            raise SimulationError(
                f"law {self._law_kind}, sample {sequence}: expected finite commands, found {wanted}"
            )
        self._sequence = sequence + 1
        speed_limit, turn_limit = self._limits
        return Sample(
            time_ns,
            sequence,
            pose_sequence,
            decision,
            min(max(wanted[0], -speed_limit), speed_limit),
            min(max(wanted[1], -turn_limit), turn_limit),
            hypot(decision.error_x_m, decision.error_y_m),
        )
