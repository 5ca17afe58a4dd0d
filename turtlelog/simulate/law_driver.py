"""A law at work: it reads poses one by one, and its decisions become samples."""

import sys
from math import copysign, hypot, inf, isfinite, isinf, nan
from typing import Final

import msgspec

from turtlelog.errors import SimulationError, TurtlelogError
from turtlelog.laws import (
    LAWS,
    Decision,
    Goal,
    Law,
    Pose,
    declare_law,
    describe_law_error,
    find_law,
    print_to_stderr,
)
from turtlelog.loops import Declaration
from turtlelog.scenario import LawChoice, Scenario, resolve_law
from turtlelog.simulate.answers import complete_decision
from turtlelog.simulate.step_budget import (
    TIMED_BELOW_S,
    StepBudget,
    StepBudgetError,
    StepEnded,
    advise_budget,
    describe_excess,
)

LARGEST_FLOAT: Final = 3.4e38
"""Poses and applied velocities are published as 32-bit floats."""


class Sample(msgspec.Struct, frozen=True, gc=False):
    """One controller callback.

    Attributes:
        time_ns: Time of the tick at which the pose was answered [ns].
        sequence: Number of the sample, from 0.
        pose_sequence: Number of the pose that it read, from 0.
        decision: What the law decided, complete; without a goal its errors are NaN.
        phase: Index of the decision's phase in the declaration's `phase_names`.
        speed_m_s: Command after clipping [m/s].
        turn_rate_rad_s: Command after clipping [rad/s].
        distance_m: From the pose to the goal [m].
        published_ns: Time at which its command goes out: later where the law blocks [ns].
        shaped_speed_m_s: Command after shaping, before the limits [m/s]; NaN without shaping.
        shaped_turn_rate_rad_s: Likewise [rad/s].
    """

    time_ns: int
    sequence: int
    pose_sequence: int
    decision: Decision
    phase: int
    speed_m_s: float
    turn_rate_rad_s: float
    distance_m: float
    published_ns: int
    shaped_speed_m_s: float = nan
    shaped_turn_rate_rad_s: float = nan

    @property
    def row(self) -> tuple[float, ...]:
        """What is recorded of it, in the order of a ControlSample's fields."""
        decision = self.decision
        return (  # type: ignore[return-value]
            self.sequence,
            self.pose_sequence,
            self.phase,
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
    """Asks a law for its decision on each pose, checks it and clips it; knows no queue or delay.

    Attributes:
        declaration: What the law declares.
    """

    __slots__ = (
        "_asked_ns",
        "_budget_s",
        "_call",
        "_ended",
        "_first_phase",
        "_goal",
        "_has_more",
        "_kind",
        "_law",
        "_limits",
        "_path",
        "_phases",
        "_sequence",
        "_step",
        "_tick_ns",
        "_with_reference",
        "declaration",
    )

    def __init__(self, scenario: Scenario, law: Law, *, step_budget_s: float | None = None) -> None:
        """Take goal and limits from a scenario; the law begins at the first pose.

        With a budget a step that computes for longer by the clock fails with a StepBudgetError: a
        short one is measured here, of a longer one a `LimitedLoop` takes care.
        """
        self._law, self._kind = law, scenario.law.kind
        self._budget_s, self._asked_ns = inf if step_budget_s is None else step_budget_s, 0
        is_timed = self._budget_s < TIMED_BELOW_S
        self._call = StepBudget(law.step, self._budget_s) if is_timed else law.step
        self._step = self._call if type(law) in LAWS.values() else self._step_of_others
        goal, parameters = _build_goal(scenario), scenario.law.parameters
        self.declaration = declaration = declare_law(type(law), parameters, goal, scenario.path)
        self._path = scenario.path
        self._goal = goal if declaration.uses_goal else None
        self._limits = scenario.limits.speed_m_s, scenario.limits.turn_rate_rad_s
        self._phases = {name: number for number, name in enumerate(declaration.phase_names)}
        self._first_phase = declaration.phase_names[0]
        self._has_more = bool(declaration.states) or declaration.has_reference
        self._with_reference = frozenset(
            phase
            for loop in declaration.loops
            if loop.moves
            for phase in declaration.list_phases(loop.name)
        )
        self._tick_ns = scenario.plant.facts.period_ns
        self._sequence = 0
        self._ended: int | None = None

    def answer(self, time_ns: int, pose_sequence: int, pose: Pose) -> Sample:
        """Return the sample that a pose makes, with its command clipped.

        Raises:
            SimulationError: Where the law fails or answers with something that is no number.
        """
        sequence = self._sequence
        self._sequence += 1
        self._asked_ns = time_ns
        try:
            if sequence == 0:
                self._reset(pose)
            decision = self._step(time_ns, pose)
            try:
                phase = self._judge(decision)
            except TypeError:  # it leaves something out: found out where it costs nothing
                decision = complete_decision(decision, pose, self._goal, self._first_phase)
                phase = self._judge(decision)
        except KeyboardInterrupt:
            raise
        except (StepBudgetError, StepEnded) as err:
            budget_s, is_ended = self._budget_s, isinstance(err, StepEnded)
            ended = describe_excess(budget_s, budget_s, has_returned=False)
            what = ended if is_ended else str(err)
            raise StepBudgetError(self.describe_late(what)) from None
        except BaseException as err:
            reason = describe_law_error(err, type(self._law))
            raise SimulationError(f"law {self._kind}, sample {sequence}: {reason}") from err
        speed, turn_rate = decision.speed_m_s, decision.turn_rate_rad_s
        speed_limit, turn_limit = self._limits
        if not -speed_limit <= speed <= speed_limit:
            speed = copysign(speed_limit, speed)
        if not -turn_limit <= turn_rate <= turn_limit:
            turn_rate = copysign(turn_limit, turn_rate)
        distance = hypot(decision.error_x_m, decision.error_y_m)  # type: ignore[arg-type]
        blocks = decision.blocks_ticks
        published_ns = time_ns + blocks * self._tick_ns if blocks else time_ns
        return Sample(
            time_ns,
            sequence,
            pose_sequence,
            decision,
            phase,
            speed,
            turn_rate,
            distance,
            published_ns,
        )

    @property
    def asked(self) -> int:
        """How many poses the law was asked to answer."""
        return self._sequence

    def describe_late(self, what: str) -> str:
        """Return that the latest answer is late, and how a longer budget is set."""
        place = f"law {self._kind}, sample {self._sequence - 1}"
        advice = advise_budget(self._budget_s)
        return f"{place} {what}, at {self._asked_ns / 1e9:.3f} s; {advice}"

    def _reset(self, pose: Pose) -> None:
        with print_to_stderr():
            take_limits = getattr(self._law, "take_limits", None)
            if take_limits is not None:
                take_limits(*self._limits)
            self._law.reset(pose, self._goal, self._path)

    def _step_of_others(self, time_ns: int, pose: Pose) -> Decision:
        """Return the decision of a law that may print, complete and in plain numbers."""
        stdout, sys.stdout = sys.stdout, sys.stderr
        try:
            decision = self._call(time_ns, pose)
        finally:
            sys.stdout = stdout
        return complete_decision(decision, pose, self._goal, self._first_phase)

    def _judge(self, decision: Decision) -> int:
        """Return the number of a decision's phase; refuse what cannot be executed or recorded.

        Raises:
            TypeError: Where it leaves something out.
        """
        speed, turn_rate, phase = decision.speed_m_s, decision.turn_rate_rad_s, decision.phase
        # A sum of numbers is finite where all of them are.
        errors = decision.bearing_rad + decision.heading_error_rad  # type: ignore[operator]
        errors += decision.error_x_m + decision.error_y_m  # type: ignore[operator]
        if not (
            -LARGEST_FLOAT < speed < LARGEST_FLOAT and -LARGEST_FLOAT < turn_rate < LARGEST_FLOAT
        ):
            raise SimulationError(
                f"expected a finite command (below {LARGEST_FLOAT:g}),"
                f" found speed {speed} m/s, turn rate {turn_rate} rad/s"
            )
        if not isfinite(errors + decision.world_v_x_m_s + decision.world_v_y_m_s):
            self._require_finite(decision, errors)
        number = self._phases.get(phase)  # type: ignore[arg-type]
        if number is None:
            if phase is None:
                raise TypeError("phase")
            known = ", ".join(self.declaration.phases)
            raise SimulationError(f"expected a phase of {known}, found {phase!r}")
        if (
            decision.blocks_ticks != 0
            or decision.stop_reason is not None
            or decision.states
            or decision.reference is not None
            or self._has_more
        ):
            self._require_more(decision)
        if number == self._ended:
            raise SimulationError(
                f"expected another phase than {phase}, which had ended, found it again"
            )
        self._ended = number if decision.ends_phase else None
        return number

    def _require_finite(self, decision: Decision, errors: float) -> None:
        world = isinf(decision.world_v_x_m_s) or isinf(decision.world_v_y_m_s)
        if world or (not isfinite(errors) and self._goal is not None):
            raise SimulationError(f"expected finite numbers, found {decision}")

    def _require_more(self, decision: Decision) -> None:
        self._require_states(decision.states)
        self._require_reference(decision)
        reason = decision.stop_reason
        if reason is not None and not (isinstance(reason, str) and reason and reason.isprintable()):
            raise SimulationError(f"expected a stop_reason in words, found {reason!r:.60}")

    def _require_states(self, states: tuple[float, ...]) -> None:
        names = self.declaration.states
        if len(states) != len(names):
            listed = f"states {', '.join(names)}" if names else "no states, as declared"
            raise SimulationError(f"expected {listed}, found {len(states)} numbers")
        for name, value in zip(names, states, strict=True):
            if not isfinite(value):
                raise SimulationError(f"expected a finite number as state {name}, found {value}")

    def _require_reference(self, decision: Decision) -> None:
        reference = decision.reference
        if reference is None:
            if decision.phase in self._with_reference:
                phase = decision.phase
                raise SimulationError(f"expected a reference pose in phase {phase}, found none")
            return
        if not self.declaration.has_reference:
            raise SimulationError(
                "expected no reference pose, for no loop is declared with the reference"
                f" path or recorded, found {reference}"
            )
        if not isfinite(reference.x_m + reference.y_m + reference.heading_rad):
            raise SimulationError(f"expected a finite reference pose, found {reference}")


def build_law(choice: LawChoice) -> Law:
    """Return the law of a scenario with its parameters.

    Raises:
        SimulationError: Where it does not take them.
        ScenarioError: As `resolve_law`.
        LawError: Where there is no such law.
    """
    choice = resolve_law(choice)
    law = find_law(choice.kind)
    try:
        with print_to_stderr():
            return law(choice.parameters)
    except (TurtlelogError, KeyboardInterrupt):
        raise
    except BaseException as err:
        raise SimulationError(f"law {choice.kind}: {describe_law_error(err, law)}") from err


def declare_scenario(scenario: Scenario) -> Declaration:
    """Return what the law of a scenario declares; its code is loaded if need be.

    Raises:
        ScenarioError: As `resolve_law`.
        LawError: Where there is no such law, or its declaration is wrong.
    """
    choice = resolve_law(scenario.law)
    law = find_law(choice.kind)
    return declare_law(law, choice.parameters, _build_goal(scenario), scenario.path)


def _build_goal(scenario: Scenario) -> Goal:
    return Goal(scenario.goal.x_m, scenario.goal.y_m, scenario.goal.heading_rad)
