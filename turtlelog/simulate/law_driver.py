"""A law at work: it reads poses one by one, and its decisions become samples."""

from math import copysign, hypot, isfinite
from operator import index
from typing import Final

import msgspec

from turtlelog.errors import SimulationError, TurtlelogError, describe_error
from turtlelog.laws import Decision, Goal, Law, Pose, find_law
from turtlelog.run import Phase
from turtlelog.scenario import LawChoice, Scenario, resolve_law

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


class LawDriver:
    """Asks a law for its decision on each pose, checks it and clips it; knows no queue or delay."""

    __slots__ = ("_ended", "_goal", "_kind", "_law", "_limits", "_sequence")

    def __init__(self, scenario: Scenario, law: Law) -> None:
        """Take goal and limits from a scenario; the law begins at the first pose."""
        self._law, self._kind = law, scenario.law.kind
        self._goal = Goal(scenario.goal.x_m, scenario.goal.y_m, scenario.goal.heading_rad)
        self._limits = scenario.limits.speed_m_s, scenario.limits.turn_rate_rad_s
        self._sequence = 0
        self._ended: Phase | None = None

    def answer(self, time_ns: int, pose_sequence: int, pose: Pose) -> Sample:
        """Return the sample that a pose makes, with its command clipped.

        Raises:
            SimulationError: Where the law fails or answers with something that is no number.
        """
        sequence = self._sequence
        self._sequence += 1
        try:
            if sequence == 0:
                self._law.reset(pose, self._goal)
            decision = self._law.step(time_ns, pose)
            speed, turn_rate = decision.speed_m_s, decision.turn_rate_rad_s
            _require_sound(decision)
            self._follow_phase(decision)
        except (Exception, SystemExit) as err:
            reason = str(err) if isinstance(err, SimulationError) else describe_error(err)
            raise SimulationError(f"law {self._kind}, sample {sequence}: {reason}") from err
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

    def _follow_phase(self, decision: Decision) -> None:
        if decision.phase is self._ended:
            name = decision.phase.name
            raise SimulationError(
                f"expected another phase than {name}, which had ended, found it again"
            )
        self._ended = decision.phase if decision.ends_phase else None


def build_law(choice: LawChoice) -> Law:
    """Return the law of a scenario with its parameters.

    Raises:
        SimulationError: Where it does not take them.
        ScenarioError: As `resolve_law`.
        LawError: Where there is no such law.
    """
    choice = resolve_law(choice)
    try:
        return find_law(choice.kind)(choice.parameters)
    except TurtlelogError:
        raise
    except (Exception, SystemExit) as err:
        raise SimulationError(f"law {choice.kind}: {describe_error(err)}") from err


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
