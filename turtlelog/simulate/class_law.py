"""The law of a scenario, and laws that are classes, which are called pose by pose.

A law may answer with numpy numbers, integers, or a list that it changes later. Therefore every
answer is copied to plain numbers.
"""

import sys
from collections.abc import Mapping
from math import hypot, isfinite, isinf
from operator import index
from typing import Any, Final

from turtlelog import laws
from turtlelog.errors import SimulationError, TurtlelogError
from turtlelog.laws import Decision, Pose
from turtlelog.parts import LARGEST_FLOAT
from turtlelog.run.loops import Declaration
from turtlelog.run.paths import Path
from turtlelog.scenario import LawChoice, Scenario, resolve_law
from turtlelog.simulate.rows import COMMAND_FAILED, NUMBERS_FAILED, REFERENCE_FAILED, SampleRow
from turtlelog.simulate.step_budget import Step

_FAR_M: Final = 1e300
"""Distance up to which errors need no check [m]. Squares may overflow, but distances are finite."""

_MOST_TICKS: Final = 2**31 - 1  # longest block [ticks]: a year, whose nanoseconds fit into 64 bits

_FLOATS: Final = {float}


class ClassLaw:
    """Caller of a law, which checks the law's decision on each pose.

    Attributes:
        stops: Stop reasons of the law's runs so far; `stop` of a sample is an index into this list,
            from 1.
    """

    def __init__(
        self,
        law: laws.Law,
        declaration: Declaration,
        *,
        step: Step,
        goal: laws.Goal,
        path: Path | None,
        limits: tuple[float, float],
    ) -> None:
        """Store a law, its declaration, and the function that calls its `step`."""
        self._law, self._step, self._limits = law, step, limits
        self._goal = goal if declaration.uses_goal else None
        self._path = path
        self._phases = {name: number for number, name in enumerate(declaration.phase_names)}
        self._declared = tuple(declaration.phases)
        self._states = declaration.states
        self._has_reference = declaration.has_reference
        self._with_reference = frozenset(
            phase
            for loop in declaration.loops
            if loop.moves
            for phase in declaration.list_phases(loop.name)
        )
        self._ended: int | None = None
        self.stops: list[str] = []

    def decide(
        self,
        settings: Any,
        state: Any,
        rows: Any,
        row: Any,
        time_ns: int,
        xyh: tuple[float, float, float],
    ) -> tuple[float, float]:
        """Record the law's decision; return speed and turn rate. The loop calls this method."""
        del settings, state
        pose = Pose(*xyh)
        if row.sequence == 0:
            self._reset(pose)
        stdout, sys.stdout = sys.stdout, sys.stderr  # stdout is only for results
        try:
            found = self._step(time_ns, pose)
        finally:
            sys.stdout = stdout
        decision = _read_decision(found)
        row.phase = self._judge(decision)
        self._enter(row, decision)
        if self._states:
            rows.states[row.sequence] = decision.states
        return decision.speed_m_s, decision.turn_rate_rad_s

    def record(self, state: Any, rows: Any, number: int) -> bool:
        """Return whether all states are finite. The states are recorded already."""
        del state, rows, number
        return True

    def _reset(self, pose: Pose) -> None:
        with laws.print_to_stderr():
            take_limits = getattr(self._law, "take_limits", None)
            if take_limits is not None:
                take_limits(*self._limits)
            self._law.reset(pose, self._goal, self._path)

    def _enter(self, row: Any, decision: Decision) -> None:
        # Missing values stay NaN, and the loop computes them.
        if decision.bearing_rad is not None:
            row.bearing_rad = decision.bearing_rad
        if decision.heading_error_rad is not None:
            row.heading_error_rad = decision.heading_error_rad
        if decision.error_x_m is not None:
            row.error_x_m = decision.error_x_m
        if decision.error_y_m is not None:
            row.error_y_m = decision.error_y_m
        row.world_v_x_m_s, row.world_v_y_m_s = decision.world_v_x_m_s, decision.world_v_y_m_s
        row.blocks_ticks, row.ends_phase = decision.blocks_ticks, decision.ends_phase
        if decision.stop_reason is not None:
            self.stops.append(decision.stop_reason)
            row.stop = len(self.stops)
        if decision.reference is not None:
            row.reference_x_m, row.reference_y_m = decision.reference.x_m, decision.reference.y_m
            row.reference_heading_rad = decision.reference.heading_rad

    def _judge(self, decision: Decision) -> int:
        """Return the index of a decision's phase; refuse what cannot be executed or recorded."""
        speed, turn_rate = decision.speed_m_s, decision.turn_rate_rad_s
        phase = self._declared[0] if decision.phase is None else decision.phase
        if not (abs(speed) < LARGEST_FLOAT and abs(turn_rate) < LARGEST_FLOAT):
            raise SimulationError(_describe_command(speed, turn_rate))
        self._require_finite(decision)
        number = self._phases.get(phase)
        if number is None:
            known = ", ".join(self._declared)
            raise SimulationError(f"expected a phase of {known}, found {phase!r}")
        if self._states or decision.states:
            self._require_states(decision.states)
        self._require_reference(decision.reference, phase)
        reason = decision.stop_reason
        if reason is not None and not (isinstance(reason, str) and reason and reason.isprintable()):
            raise SimulationError(f"expected a stop_reason in words, found {reason!r:.60}")
        if number == self._ended:
            raise SimulationError(
                f"expected another phase than {phase}, which had ended, found it again"
            )
        self._ended = number if decision.ends_phase else None
        return number

    def _require_finite(self, decision: Decision) -> None:
        # A sum is finite if all its numbers are; missing ones are None.
        errors = (decision.bearing_rad or 0.0) + (decision.heading_error_rad or 0.0)
        errors += (decision.error_x_m or 0.0) + (decision.error_y_m or 0.0)
        if isfinite(errors + decision.world_v_x_m_s + decision.world_v_y_m_s):
            return
        world = isinf(decision.world_v_x_m_s) or isinf(decision.world_v_y_m_s)
        if world or (not isfinite(errors) and self._goal is not None):
            raise SimulationError(f"expected finite numbers, found {decision}")

    def _require_states(self, states: tuple[float, ...]) -> None:
        names = self._states
        if len(states) != len(names):
            listed = f"states {', '.join(names)}" if names else "no states, as declared"
            raise SimulationError(f"expected {listed}, found {len(states)} numbers")
        for name, value in zip(names, states, strict=True):
            if not isfinite(value):
                raise SimulationError(f"expected a finite number as state {name}, found {value}")

    def _require_reference(self, reference: Pose | None, phase: str) -> None:
        if reference is None:
            if phase in self._with_reference:
                raise SimulationError(f"no reference pose in phase {phase}, which had one before")
            return
        if not self._has_reference:
            raise SimulationError(
                "expected no reference pose, for no loop is declared with the reference"
                f" path or recorded, found {reference}"
            )
        if not isfinite(reference.x_m + reference.y_m + reference.heading_rad):
            raise SimulationError(f"expected a finite reference pose, found {reference}")


def _describe_command(speed: float, turn_rate: float) -> str:
    return (
        f"expected a finite command (below {LARGEST_FLOAT:g}),"
        f" found speed {speed} m/s, turn rate {turn_rate} rad/s"
    )


def _read_decision(found: Any) -> Decision:
    """Return the answer of a law as a `Decision` with numbers of Python, not of numpy."""
    if not isinstance(found, Decision):
        is_pair = isinstance(found, tuple | list) and len(found) == 2
        if not is_pair and getattr(found, "shape", None) != (2,):
            expected = "a Decision, or speed and turn rate"
            raise SimulationError(f"expected {expected}, found {found!r:.60}")
        found = Decision(speed_m_s=found[0], turn_rate_rad_s=found[1])
    # Most laws return plain floats, which are checked together: a sample takes 5 us in total.
    is_plain = (
        type(found.speed_m_s) is type(found.turn_rate_rad_s) is float
        and type(found.world_v_x_m_s) is type(found.world_v_y_m_s) is float
        and type(found.states) is tuple
        and (not found.states or {*map(type, found.states)} == _FLOATS)
        and found.reference is None
        and type(found.blocks_ticks) is int
        and found.blocks_ticks == 0
    )
    return found if is_plain and _has_plain_errors(found) else _convert_decision(found)


def _has_plain_errors(found: Decision) -> bool:
    """Return whether the errors are floats with a finite distance, or are all left out."""
    if found.bearing_rad is None:
        return found.heading_error_rad is found.error_x_m is found.error_y_m is None
    x_m, y_m = found.error_x_m, found.error_y_m
    return (
        type(found.bearing_rad) is type(found.heading_error_rad) is float
        and type(x_m) is type(y_m) is float
        and -_FAR_M < x_m < _FAR_M
        and -_FAR_M < y_m < _FAR_M
    )


def _convert_decision(found: Decision) -> Decision:
    error_x_m = _read_error("error_x_m", found.error_x_m)
    error_y_m = _read_error("error_y_m", found.error_y_m)
    if isinf(hypot(error_x_m or 0.0, error_y_m or 0.0)):
        raise SimulationError(f"error: expected a finite distance, found {error_x_m}, {error_y_m}")
    if found.phase is not None and not isinstance(found.phase, str):
        raise SimulationError(f"phase: expected its name, found {found.phase!r:.60}")
    return Decision(
        speed_m_s=_read_number("speed_m_s", found.speed_m_s),
        turn_rate_rad_s=_read_number("turn_rate_rad_s", found.turn_rate_rad_s),
        phase=found.phase,
        bearing_rad=_read_error("bearing_rad", found.bearing_rad),
        heading_error_rad=_read_error("heading_error_rad", found.heading_error_rad),
        error_x_m=error_x_m,
        error_y_m=error_y_m,
        world_v_x_m_s=_read_number("world_v_x_m_s", found.world_v_x_m_s),
        world_v_y_m_s=_read_number("world_v_y_m_s", found.world_v_y_m_s),
        states=_read_states(found.states),
        reference=_read_pose(found.reference),
        blocks_ticks=_read_ticks(found.blocks_ticks),
        ends_phase=bool(found.ends_phase),
        stop_reason=found.stop_reason,
    )


def _read_number(name: str, value: Any) -> float:
    """Return a number of any type as a float. An array with one element is not a number."""
    if type(value) is float:
        return value
    try:
        if hasattr(value, "__float__") and not getattr(value, "shape", ()):
            return float(value)
    except (ValueError, OverflowError):
        pass
    raise SimulationError(f"{name}: expected a number, found {value!r:.60}")


def _read_error(name: str, value: Any) -> float | None:
    if value is None:
        return None
    number = _read_number(name, value)
    if isinf(number):
        raise SimulationError(f"{name}: expected a finite number, found {number}")
    return number


def _read_states(states: Any) -> tuple[float, ...]:
    if isinstance(states, str) or not hasattr(states, "__iter__"):
        raise SimulationError(f"states: expected a tuple of numbers, found {states!r:.60}")
    return tuple([_read_number(f"states[{place}]", value) for place, value in enumerate(states)])


def _read_pose(reference: Any) -> Pose | None:
    if reference is None:
        return None
    try:
        found = [(name, getattr(reference, name)) for name in Pose.__struct_fields__]
    except AttributeError as err:
        raise SimulationError(f"reference: expected a Pose, found {reference!r:.60}") from err
    return Pose(*(_read_number(f"reference.{name}", value) for name, value in found))


def _read_ticks(value: Any) -> int:
    if hasattr(value, "__index__") and 0 <= value <= _MOST_TICKS:
        return index(value)
    expected = f"a whole number from 0 to {_MOST_TICKS}"
    raise SimulationError(f"blocks_ticks: expected {expected}, found {value!r:.60}")


def is_built_in(law: laws.AnyLaw) -> bool:
    """Return whether a law is one of turtlelog's."""
    return law in laws.LAWS.values()


def build_law(choice: LawChoice) -> Any:
    """Return the law of a scenario with its parameters.

    Raises:
        SimulationError: If the law rejects its parameters.
        ScenarioError: If `resolve_law` raises it.
        LawError: If there is no such law.
    """
    choice = resolve_law(choice)
    law = laws.find_law(choice.kind)
    try:
        with laws.print_to_stderr():
            return law(choice.parameters)
    except (TurtlelogError, KeyboardInterrupt):
        raise
    except BaseException as err:
        raise SimulationError(f"law {choice.kind}: {laws.describe_law_error(err, law)}") from err


def declare_scenario(scenario: Scenario) -> Declaration:
    """Return the declaration of a scenario's law; its code is loaded if necessary.

    Raises:
        ScenarioError: If `resolve_law` raises it.
        LawError: If there is no such law, or its declaration is wrong.
    """
    choice = resolve_law(scenario.law)
    law = laws.find_law(choice.kind)
    return laws.declare_law(law, choice.parameters, build_goal(scenario), scenario.path)


def build_goal(scenario: Scenario) -> laws.Goal:
    """Return the goal of a scenario."""
    return laws.Goal(scenario.goal.x_m, scenario.goal.y_m, scenario.goal.heading_rad)


def describe_numbers(failure: int, row: SampleRow, states: Mapping[str, float]) -> str:
    """Return a sentence on a failure of a sample, a kind of `rows`; `states` are the sample's."""
    if failure == COMMAND_FAILED:
        return _describe_command(row.wanted_speed_m_s, row.wanted_turn_rate_rad_s)
    if failure == REFERENCE_FAILED:
        pose = Pose(row.reference_x_m, row.reference_y_m, row.reference_heading_rad)
        return f"expected a finite reference pose, found {pose}"
    if failure == NUMBERS_FAILED:
        names = ["bearing_rad", "heading_error_rad", "error_x_m", "error_y_m", "distance_m"]
        names += ["world_v_x_m_s", "world_v_y_m_s"]
        values = {name: getattr(row, name) for name in names}
        bad = {name: value for name, value in values.items() if isinf(value)} or values
        listed = ", ".join(f"{name} {value}" for name, value in bad.items())
        return f"expected finite numbers, found {listed}"
    name, value = next(one for one in states.items() if not isfinite(one[1]))
    return f"expected a finite number as state {name}, found {value}"
