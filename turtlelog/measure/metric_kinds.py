"""Definition of a metric, and the registry that contains each metric function.

Each metric is one function; its decorator contains the unit and direction, and the meaning, which
is otherwise the first line of its docstring. A metric of a loop is written once and bound to each
declared loop of a law.

A metric of a curve or of a course is a function of numbers: it runs in ordinary Python for one run,
and compiled in the batch of `sweep`, for a million rows. Other metrics may use all of Python.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Any, Final, Literal

from turtlelog.display import fit_line
from turtlelog.measure.metric import (
    FOUND,
    REASONS,
    Found,
    Missing,
    Outcome,
    Result,
    Status,
    add_reason,
    read_outcome,
)
from turtlelog.measure.rates import Axis
from turtlelog.measure.response import Response
from turtlelog.measure.run_context import RunContext
from turtlelog.run.loops import COMMAND_WORDS, REFERENCE_WORDS, SIGNAL_WORDS, ControlLoop

Better = Literal["lower", "higher"] | None
Nature = Literal["error", "share", "count", "verdict"] | None
OfRun = Callable[[RunContext], Result]
OfLoop = Callable[[RunContext, Response], Result]
OfCurve = Callable[[Response], Outcome]
OfCourse = Callable[[RunContext], Outcome]

_CUT: Final = add_reason(Status.TOO_SHORT, "the run was cut in this phase")
_NO_STEP: Final = add_reason(Status.NO_STEP, "the phase begins at its reference")

_SMALLEST_STEP: Final = 1e-6
"""Smallest change that counts as a step [rad or m]; smaller changes are rounding of 32-bit
poses."""

_ANY_WORDS: Final = MappingProxyType(
    {"signal": "controlled signal", "goal": "reference", "command": "command"}
)


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricKind:
    """Definition of a metric.

    Attributes:
        unit: Unit of the value.
        compute: Function of a run context that returns the value or the reason why it is missing.
        meaning: One sentence for the user.
        better: `lower`, `higher`, or None if neither is better.
        floor: Value below which lower is no better: an overshoot of -2 % is no better than -1 %,
            because both mean no overshoot. None: no such value.
        grows: Whether the value can only grow during a run, like counts, sums of magnitudes and
            running maxima. Shares, means, percentiles, final values and values that need an
            estimated dead time may fall again.
        is_awaited: Whether the value is a time since the beginning of its loop or of the run.
        needs_poses: Whether the value is missing in a run without poses (a log of commands alone).
        needs_dead_time: Whether the value needs the dead time of the log, which is searched in a
            slow fit.
        nature: `error` for a difference from a reference, `share` for a part of a whole from 0 to
            1, `count`, `verdict` for 0 or 1; None for any other quantity.
        axis: Only axis of the robot that the value depends on; None: both, or those of a loop.
        numbers: The same metric as a function of a course, which can also be compiled; None: no
            such function.
    """

    unit: str
    compute: OfRun
    meaning: str
    better: Better = "lower"
    floor: float | None = None
    grows: bool = False
    is_awaited: bool = False
    needs_poses: bool = True
    needs_dead_time: bool = False
    nature: Nature = None
    axis: Axis | None = None
    numbers: OfCourse | None = None

    def compute_loss(self, value: float, reference: float) -> float:
        """Return how much worse a value is than a reference, in the metric's unit.

        The result is negative if the value is better, and 0 if both values are equal or below the
        floor. If neither direction is better, every change is a loss.
        """
        if self.better is None:
            return abs(value - reference)
        if self.floor is not None:
            value, reference = max(value, self.floor), max(reference, self.floor)
        return value - reference if self.better == "lower" else reference - value

    def __repr__(self) -> str:
        return fit_line(f"<MetricKind [{self.unit}]: {self.meaning}>")


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopMetricKind:
    """Definition of a loop metric before it is bound to a loop.

    Attributes:
        unit: Unit with placeholders `{value}` (deg or m), `{signal}` (rad or m) and `{command}`
            (rad or m).
        compute: Function of a run context and the loop's response.
        meaning: One sentence with placeholders `{signal}`, `{goal}` and `{command}`.
        traits: Properties shared with the metrics of a run.
        needs_whole: Whether the value is missing for a loop that the end of the recording cuts off.
            A sum or maximum over part of the loop would be wrong.
        applies: Function that returns whether a loop has this metric.
        needs_step: Whether the value is missing for a loop that starts at its reference.
        numbers: The same metric as a function of a curve, which can also be compiled; None: no such
            function.
    """

    unit: str
    compute: OfLoop
    meaning: str
    traits: dict[str, Any]
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
            if reason := refuse_curve(response, self.needs_whole, self.needs_step):
                return REASONS[reason]
            result = self.compute(context, response)
            if unit == "deg" and isinstance(result, Found):
                return Found(math.degrees(result.value), result.at_s)
            return result

        words = {
            "signal": SIGNAL_WORDS[loop.signal],
            "goal": REFERENCE_WORDS[loop.reference],
            "command": COMMAND_WORDS[loop.command],
        }
        return self._build(unit, compute, words)

    def describe(self) -> MetricKind:
        """Return the definition for any loop; the unit is `rad or m` if it depends on the loop."""

        def compute(_: RunContext) -> Result:
            return Missing(Status.NO_PHASE, "the law declares no such loop")

        return self._build(self.describe_unit(None), compute, _ANY_WORDS)

    def _build(self, unit: str, compute: OfRun, words: Mapping[str, str]) -> MetricKind:
        meaning = self.meaning.format_map(words)
        return MetricKind(unit=unit, compute=compute, meaning=meaning, **self.traits)

    def describe_unit(self, loop: ControlLoop | None) -> str:
        """Return the unit for a loop; for None, the unit of a heading or else of a length."""
        if loop is None:
            turn = self.unit.format(value="deg", signal="rad", command="rad")
            way = self.unit.format(value="m", signal="m", command="m")
            return turn if turn == way else f"{turn} or {way}"
        value, signal = ("deg", "rad") if loop.signal == "heading" else ("m", "m")
        command = "rad" if loop.command == "turn_rate" else "m"
        return self.unit.format(value=value, signal=signal, command=command)


def refuse_curve(curve: Any, needs_whole: bool, needs_step: bool) -> int:  # noqa: FBT001
    """Return the number of the reason why a curve lacks what a metric needs; `FOUND` if none."""
    if needs_whole and curve.was_cut:
        return _CUT
    is_step = not abs(curve.reference - curve.initial) <= _SMALLEST_STEP
    return _NO_STEP if needs_step and not is_step else FOUND


LOOP_METRICS: Final[dict[str, LoopMetricKind]] = {}
"""Metrics of a loop by name, in the order of display."""

RUN_METRICS: Final[dict[str, MetricKind]] = {}
"""Metrics of a whole run and of its end by id, in the order of display."""


def has_step(loop: ControlLoop) -> bool:
    """Return whether a loop answers a step. A loop with a moving reference does not."""
    return not loop.moves


def has_sides(loop: ControlLoop) -> bool:
    """Return whether a loop that answers a step can pass its reference. A distance cannot."""
    return has_step(loop) and loop.signal != "distance"


def read_meaning(compute: Callable[..., Any]) -> str:
    """Return the first line of a docstring: the meaning of a metric that its decorator lacks."""
    return (compute.__doc__ or "").partition("\n")[0]


def loop_metric(
    name: str,
    unit: str,
    meaning: str = "",
    *,
    needs_whole: bool = True,
    applies: Callable[[ControlLoop], bool] = lambda _: True,
    **traits: Any,
) -> Callable[[OfLoop], OfLoop]:
    """Enter a function in the registry as a metric of every loop to which it applies."""

    def enter(compute: OfLoop) -> OfLoop:
        LOOP_METRICS[name] = LoopMetricKind(
            unit=unit,
            compute=compute,
            meaning=meaning or read_meaning(compute),
            traits=traits,
            needs_whole=needs_whole,
            applies=applies,
        )
        return compute

    return enter


def curve_metric(
    name: str, unit: str, meaning: str = "", *, needs_step: bool = False, **more: Any
) -> Callable[[OfCurve], OfCurve]:
    """Enter a function of a curve, a `Response`, as a metric of every loop to which it applies.

    The function runs in ordinary Python and compiled. Further arguments are those of `loop_metric`.
    """

    def enter(numbers: OfCurve) -> OfCurve:
        enter_loop = loop_metric(name, unit, meaning or read_meaning(numbers), **more)
        enter_loop(lambda _, response: read_outcome(numbers(response)))
        kind = LOOP_METRICS[name]
        LOOP_METRICS[name] = replace(kind, needs_step=needs_step, numbers=numbers)
        return numbers

    return enter


step_metric = partial(curve_metric, needs_step=True, applies=has_step)
"""As `curve_metric`, for loops that answer a step."""


def run_metric(name: str, unit: str, meaning: str = "", **traits: Any) -> Callable[[OfRun], OfRun]:
    """Enter a function in the registry by its id, as a metric of the whole run or of its end."""

    def enter(compute: OfRun) -> OfRun:
        meant = meaning or read_meaning(compute)
        RUN_METRICS[name] = MetricKind(unit=unit, compute=compute, meaning=meant, **traits)
        return compute

    return enter


def course_metric(
    name: str, unit: str, meaning: str = "", **traits: Any
) -> Callable[[OfCourse], OfCourse]:
    """Enter a function of a course, a `RunContext`, by its id, as a metric of the run or its end.

    The function runs in ordinary Python and compiled.
    """

    def enter(numbers: OfCourse) -> OfCourse:
        meant = meaning or read_meaning(numbers)
        enter_run = run_metric(name, unit, meant, numbers=numbers, **traits)
        enter_run(lambda course: read_outcome(numbers(course)))
        return numbers

    return enter
