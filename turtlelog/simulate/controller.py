"""The controller's side of the loop: its pose queue, its law, its clipping, its blocking."""

from collections import deque
from math import copysign, hypot, isfinite
from operator import index
from typing import Final

import msgspec

from turtlelog.errors import SimulationError, describe_error
from turtlelog.laws import Decision, Goal, Law, Pose
from turtlelog.run import Phase
from turtlelog.scenario import Scenario

_ROTATE, _TRANSLATE, _DONE = Phase.ROTATE, Phase.TRANSLATE, Phase.DONE

_LARGEST: Final = 3.4e38
"""Applied velocities are published as 32-bit floats."""


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

    @property
    def row(self) -> tuple[float, ...]:
        """What is recorded of it, in the order of a ControlSample's fields."""
        decision = self.decision
        return (
            self.sequence,
            self.pose_sequence,
            decision.phase,
            decision.bearing_rad,
            decision.heading_error_rad,
            decision.error_x_m,
            decision.error_y_m,
            self.distance_m,
            decision.speed_m_s,
            decision.turn_rate_rad_s,
            self.speed_m_s,
            self.turn_rate_rad_s,
            decision.world_v_x_m_s,
            decision.world_v_y_m_s,
        )


Samples = tuple[Sample, ...]


class Controller:
    """Answers queued poses in order, one command each; a law that blocks lets poses pile up.

    Attributes:
        dropped: Poses that the full queue has pushed out so far.
    """

    __slots__ = (
        "_blocked",
        "_goal",
        "_law",
        "_law_kind",
        "_limits",
        "_period_ticks",
        "_poses",
        "_sequence",
        "_waits_for",
        "dropped",
    )

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
        computed: Samples = ()
        while self._poses:
            pose_sequence, pose = self._poses.popleft()
            sample = self._step(time_ns, pose_sequence, pose)
            computed += (sample,)
            if sample.decision.blocks_ticks > 0:
                self._blocked = tick + sample.decision.blocks_ticks, sample
                break
            published += (sample,)
            if sample.decision.stop_reason is not None:
                break
        return computed, published

    def _step(self, time_ns: int, pose_sequence: int, pose: Pose) -> Sample:
        sequence = self._sequence
        self._sequence += 1
        try:
            if sequence == 0:
                self._law.reset(pose, self._goal)
            decision = self._law.step(time_ns, pose)
            speed, turn_rate = decision.speed_m_s, decision.turn_rate_rad_s
            _require_sound(decision)
        except (Exception, SystemExit) as err:
            reason = str(err) if isinstance(err, SimulationError) else describe_error(err)
            raise SimulationError(f"law {self._law_kind}, sample {sequence}: {reason}") from err
        speed_limit, turn_limit = self._limits
        if not -speed_limit <= speed <= speed_limit:
            speed = copysign(speed_limit, speed)
        if not -turn_limit <= turn_rate <= turn_limit:
            turn_rate = copysign(turn_limit, turn_rate)
        return Sample(
            time_ns,
            sequence,
            pose_sequence,
            decision,
            speed,
            turn_rate,
            hypot(decision.error_x_m, decision.error_y_m),
        )


def _require_sound(decision: Decision) -> None:
    """Refuse a decision that cannot be carried out or recorded."""
    speed, turn_rate, phase = decision.speed_m_s, decision.turn_rate_rad_s, decision.phase
    numbers = decision.bearing_rad + decision.heading_error_rad
    numbers += decision.error_x_m + decision.error_y_m
    numbers += decision.world_v_x_m_s + decision.world_v_y_m_s
    if not isfinite(numbers):
        raise SimulationError(f"expected finite numbers, found {decision}")
    if not (-_LARGEST < speed < _LARGEST and -_LARGEST < turn_rate < _LARGEST):
        raise SimulationError(
            f"expected a finite command, found speed {speed} m/s, turn rate {turn_rate} rad/s"
        )
    if not (phase is _TRANSLATE or phase is _ROTATE or phase is _DONE):
        raise SimulationError(f"expected ROTATE, TRANSLATE or DONE, found phase {phase!r}")
    if index(decision.blocks_ticks) < 0:
        raise SimulationError(f"expected blocks_ticks >= 0, found {decision.blocks_ticks}")
    if decision.stop_reason is not None and not isinstance(decision.stop_reason, str):
        raise SimulationError(f"expected a stop_reason in words, found {decision.stop_reason!r}")
