"""What a metric is, and the registry that its function enters itself in.

One function per metric, with its meaning, unit and direction beside it in the decorator. A metric
of a loop is written once and bound to each loop that a law declares.

A metric of a curve or of a course is a function of numbers: it runs plain on a run, and compiled in
the batch of `sweep`, for a million rows. Others may use all of Python.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import degrees
from types import MappingProxyType
from typing import Final, Literal, TypedDict, TypeVar, Unpack

from turtlelog.display import fit_line
from turtlelog.measure.context import RunContext
from turtlelog.measure.metric import (
    REASONS,
    Found,
    Missing,
    Outcome,
    Result,
    Status,
    add_reason,
    read_outcome,
)
from turtlelog.measure.response import Response
from turtlelog.run.loops import COMMAND_WORDS, REFERENCE_WORDS, SIGNAL_WORDS, ControlLoop

Better = Literal["lower", "higher"] | None
OfRun = Callable[[RunContext], Result]
OfLoop = Callable[[RunContext, Response], Result]
_OfRun = TypeVar("_OfRun", bound=OfRun)

OfCurve = Callable[[Response], Outcome]
OfCourse = Callable[[RunContext], Outcome]
_OfCurve = TypeVar("_OfCurve", bound=OfCurve)
_OfCourse = TypeVar("_OfCourse", bound=OfCourse)

CUT: Final = add_reason(Status.TOO_SHORT, "the run was cut in this phase")
NO_STEP: Final = add_reason(Status.NO_STEP, "the phase begins at its reference")

SMALLEST_STEP: Final = 1e-6
"""What counts as a step [rad or m]: poses are published with 32 bits, so less is their rounding."""

_ANY_WORDS: Final = MappingProxyType(
    {"signal": "controlled signal", "goal": "reference", "command": "command"}
)


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricKind:
    """Definition of a metric.

    Attributes:
        unit: Unit of its value.
        compute: Function from a run, read once, to the value or the reason why there is none.
        meaning: One sentence.
        better: `lower`, `higher`, or None if neither is better.
        floor: Value below which nothing is gained, if lower is better: an overshoot of -2 % is no
            better than one of -1 %, for both are none. None: there is no such value.
        grows: Whether it only grows while a run goes on, as counts, sums of magnitudes and the
            largest so far do: what comes later takes nothing away. Shares, means, percentiles, what
            is taken at the end, and what rests on a dead time that is estimated from all rows may
            fall again.
        is_awaited: Whether it is a time since the beginning of its loop, or of the run.
        needs_poses: Whether a run without poses, a log of commands alone, has no value.
        numbers: The same of a course, compiled too; None: there is no such function.
    """

    unit: str
    compute: OfRun
    meaning: str
    better: Better = "lower"
    floor: float | None = None
    grows: bool = False
    is_awaited: bool = False
    needs_poses: bool = True
    numbers: OfCourse | None = None

    def compute_loss(self, value: float, reference: float) -> float:
        """Return by how much a value is worse than a reference, in the metric's unit.

        Negative where it is better, 0 where both are equal or under the floor. If the metric has no
        better direction, every change is a loss.
        """
        if self.better is None:
            return abs(value - reference)
        if self.floor is not None:
            value, reference = max(value, self.floor), max(reference, self.floor)
        return value - reference if self.better == "lower" else reference - value

    def __repr__(self) -> str:
        return fit_line(f"<MetricKind [{self.unit}]: {self.meaning}>")


class Traits(TypedDict, total=False):
    """What a decorator says of a metric, as in `MetricKind`."""

    better: Better
    floor: float | None
    grows: bool
    is_awaited: bool
    needs_poses: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopMetricKind:
    """What a metric of a loop is, before it is known of which loop.

    Attributes:
        unit: With `{value}` (deg or m), `{signal}` (rad or m) and `{command}` (rad or m) in it.
        compute: From a run and the loop's response.
        meaning: One sentence, with `{signal}`, `{goal}` and `{command}` in it.
        traits: What it has in common with the metrics of a run.
        needs_whole: Whether a loop that the end of the recording cuts has no value: a sum over half
            of it, or the largest so far, is not its own.
        applies: Of which loops there is such a metric.
        needs_step: Whether a loop that begins at its reference has no value.
        numbers: The same of a curve, compiled too; None: there is no such function.
    """

    unit: str
    compute: OfLoop
    meaning: str
    traits: Traits
    needs_whole: bool
    applies: Callable[[ControlLoop], bool]
    needs_step: bool = False
    numbers: OfCurve | None = None

    def bind(self, loop: ControlLoop) -> MetricKind:
        """Return the metric of one loop."""
        unit = self.describe_unit(loop)

        def compute(context: RunContext) -> Result:
            response = context.get_response(loop)
            if isinstance(response, Missing):
                return response
            if self.needs_whole and response.was_cut:
                return REASONS[CUT]
            if self.needs_step and abs(response.reference - response.initial) <= SMALLEST_STEP:
                return REASONS[NO_STEP]
            result = self.compute(context, response)
            if unit == "deg" and isinstance(result, Found):
                return Found(degrees(result.value), result.at_s)
            return result

        words = {
            "signal": SIGNAL_WORDS[loop.signal],
            "goal": REFERENCE_WORDS[loop.reference],
            "command": COMMAND_WORDS[loop.command],
        }
        return self._build(unit, compute, words)

    def describe(self) -> MetricKind:
        """Return what the metric of any loop is; its unit says `rad or m` where it depends."""

        def compute(_: RunContext) -> Result:
            return Missing(status=Status.NO_PHASE, reason="the law declares no such loop")

        return self._build(self.describe_unit(None), compute, _ANY_WORDS)

    def _build(self, unit: str, compute: OfRun, words: Mapping[str, str]) -> MetricKind:
        meaning = self.meaning.format_map(words)
        return MetricKind(unit=unit, compute=compute, meaning=meaning, **self.traits)

    def describe_unit(self, loop: ControlLoop | None) -> str:
        """Return the unit for a loop; of none, of a heading or else of a way."""
        if loop is None:
            turn, way = ("deg", "rad", "rad"), ("m", "m", "m")
            units = [self._fill(turn), self._fill(way)]
            return units[0] if units[0] == units[1] else " or ".join(units)
        is_angle, is_turn = loop.signal == "heading", loop.command == "turn_rate"
        words = ("deg" if is_angle else "m", "rad" if is_angle else "m", "rad" if is_turn else "m")
        return self._fill(words)

    def _fill(self, words: tuple[str, str, str]) -> str:
        return self.unit.format_map(dict(zip(("value", "signal", "command"), words, strict=True)))


LOOP_METRICS: Final[dict[str, LoopMetricKind]] = {}
"""The metrics of a loop by name, in the order in which they are shown."""

RUN_METRICS: Final[dict[str, MetricKind]] = {}
"""The metrics of a whole run and of its end by id, in the order in which they are shown."""


def has_step(loop: ControlLoop) -> bool:
    """Whether a loop answers a step: one whose reference the law moves follows instead."""
    return not loop.moves


def has_sides(loop: ControlLoop) -> bool:
    """Whether a loop that answers a step can pass its reference: a distance cannot."""
    return has_step(loop) and loop.signal != "distance"


def loop_metric(
    name: str,
    unit: str,
    meaning: str,
    *,
    needs_whole: bool = True,
    applies: Callable[[ControlLoop], bool] = lambda _: True,
    **traits: Unpack[Traits],
) -> Callable[[OfLoop], OfLoop]:
    """Enter a function in the registry as a metric of every loop, or those it applies to."""

    def enter(compute: OfLoop) -> OfLoop:
        LOOP_METRICS[name] = LoopMetricKind(
            unit=unit,
            compute=compute,
            meaning=meaning,
            traits=traits,
            needs_whole=needs_whole,
            applies=applies,
        )
        return compute

    return enter


def curve_metric(
    name: str,
    unit: str,
    meaning: str,
    *,
    needs_whole: bool = True,
    needs_step: bool = False,
    applies: Callable[[ControlLoop], bool] = lambda _: True,
    **traits: Unpack[Traits],
) -> Callable[[_OfCurve], _OfCurve]:
    """Enter a function of numbers as a metric of every loop, or those it applies to.

    It runs plain and compiled: what it reads of a curve are fields of `Response`.
    """

    def enter(numbers: _OfCurve) -> _OfCurve:
        LOOP_METRICS[name] = LoopMetricKind(
            unit=unit,
            compute=lambda _, response: read_outcome(numbers(response)),
            meaning=meaning,
            traits=traits,
            needs_whole=needs_whole,
            applies=applies,
            needs_step=needs_step,
            numbers=numbers,
        )
        return numbers

    return enter


def run_metric(
    name: str, unit: str, meaning: str, **traits: Unpack[Traits]
) -> Callable[[_OfRun], _OfRun]:
    """Enter a function in the registry as a metric of the whole run, or of its end, by its id."""

    def enter(compute: _OfRun) -> _OfRun:
        RUN_METRICS[name] = MetricKind(unit=unit, compute=compute, meaning=meaning, **traits)
        return compute

    return enter


def course_metric(
    name: str, unit: str, meaning: str, **traits: Unpack[Traits]
) -> Callable[[_OfCourse], _OfCourse]:
    """Enter a function of numbers as a metric of the whole run, or of its end, by its id.

    It runs plain and compiled: what it reads of a course are fields of `RunContext`.
    """

    def enter(numbers: _OfCourse) -> _OfCourse:
        RUN_METRICS[name] = MetricKind(
            unit=unit,
            compute=lambda course: read_outcome(numbers(course)),
            meaning=meaning,
            numbers=numbers,
            **traits,
        )
        return numbers

    return enter
