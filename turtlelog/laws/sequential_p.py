"""The paper's law: rotate on the spot, then translate, each with u = Kp e."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache
from math import nan
from typing import Annotated, Any, Final, Literal, get_args, get_origin, get_type_hints

from msgspec import Meta

from turtlelog.errors import LawError
from turtlelog.laws.base import TOLERANCE, Goal, LawPart, Row
from turtlelog.laws.sequential import (
    DISTANCE,
    SCHEDULED,
    STOPS,
    GainSchedule,
    SequentialNumbers,
    SequentialState,
    step,
)
from turtlelog.parts import ABSENT_BY_DEFAULT, MAY_BE_INFINITE
from turtlelog.run.loops import PAUSE, Cause, ControlLoop, Declaration
from turtlelog.run.paths import Path

ROTATE: Final = "rotate"
TRANSLATE: Final = "translate"
REORIENT: Final = "reorient"

DECLARATION: Final = Declaration(
    loops=(
        ControlLoop(
            name=ROTATE,
            signal="heading",
            command="turn_rate",
            reference="goal_bearing",
            gain="law.kp_angular",
        ),
        ControlLoop(
            name=TRANSLATE,
            signal="along_track",
            command="speed",
            reference="goal_distance",
            gain="law.kp_linear",
        ),
    ),
    # The pause stands second, as in recordings of format 1.
    phases={ROTATE: (ROTATE,), PAUSE: (), TRANSLATE: (TRANSLATE,)},
)
"""Declaration of a sequential law with constant gains and without reorientation."""


def declare_loops(
    base: Declaration, goal: Goal | None, schedule: GainSchedule | None, *, reorient: bool
) -> Declaration:
    """Return a sequential law's declaration, changed for a schedule and for `reorient`.

    A loop with a scheduled gain declares no gain, because its gain is not one number. With
    `reorient`, a third loop turns to the goal's heading, as the first loop turns to the bearing.
    """
    if schedule is None and not reorient:
        return base  # What it says has been judged once.
    loops = [_hide_gains(loop, schedule) for loop in base.loops]
    phases = dict(base.phases)
    if reorient:
        if goal is None or goal.heading_rad is None:
            expected = "a goal with a heading to turn to (goal.heading_rad)"
            raise LawError(f"law.reorient: needs {expected}")
        loops.append(replace(loops[0], name=REORIENT, reference="goal_heading"))
        phases[REORIENT] = (REORIENT,)
    return replace(base, loops=tuple(loops), phases=phases)


def _hide_gains(loop: ControlLoop, schedule: GainSchedule | None) -> ControlLoop:
    scheduled = () if schedule is None else schedule.gains
    keys = (loop.gain, loop.integral_gain, loop.derivative_gain)
    if not any(f"law.{name}" in keys for name in scheduled):
        return loop
    return replace(
        loop,
        gain=None,
        integral_gain=None,
        derivative_gain=None,
        derivative_filter=None,
        is_proportional=False,
    )


_CAUSES: Final = (
    Cause(
        name="pause",
        kind="effect",
        neutral={"law.pause_ticks": 0},
        meaning="no pause after the rotation",
    ),
    Cause(
        name="projection",
        kind="design",
        neutral={"law.projection": "heading"},
        meaning="projection on the current heading",
    ),
    Cause(
        name="wrap", kind="effect", neutral={"law.wrap_error": True}, meaning="the error wrapped"
    ),
    TOLERANCE,
)

_RULE: Final = {**ABSENT_BY_DEFAULT, **MAY_BE_INFINITE}
"""A time in a rule that ends a run; inf: the rule never ends the run."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SequentialPParameters:
    """Parameters of the sequential proportional law.

    Attributes:
        kp_angular: Gain of the heading loop [1/s].
        kp_linear: Gain of the position loop [1/s].
        heading_tolerance_rad: Largest heading error at which the rotation ends [rad].
        position_tolerance_m: Largest error of a coordinate at which the translation ends [m].
        projection: Direction on which the world velocity is projected: the goal `bearing`, as in
            the paper's program, or the current `heading`, as in the paper's equation 16.
        wrap_error: Whether the heading error is wrapped to [-pi, pi).
        pause_ticks: Ticks for which the controller sleeps after the rotation [16 ms each].
        timeout_s: Time after the first sample at which the translation ends [s]; inf: never.
        settled_within_m: Error of a coordinate below which the coordinate counts as settled [m].
        settled_for_s: Time for which coordinates must be settled before the translation ends [s];
            inf: never.
        standstill_samples: Number of consecutive samples at a standstill after which the
            translation ends.
        standstill_below: Unclipped speed below which a sample counts as a standstill [m/s].
        reorient: Whether the robot turns to the goal's heading after the translation, unless the
            timeout ends the translation. The goal must have a heading.
        schedule: Gain schedule, which replaces the constant gains; None: no schedule.
    """

    kp_angular: Annotated[float, Meta(gt=0)] = 1.0
    kp_linear: Annotated[float, Meta(gt=0)] = 1.0
    heading_tolerance_rad: Annotated[float, Meta(gt=0)] = 0.001
    position_tolerance_m: Annotated[float, Meta(gt=0)] = 0.001
    projection: Literal["bearing", "heading"] = "heading"
    wrap_error: bool = True
    pause_ticks: Annotated[int, Meta(ge=0, le=1_000_000)] = 0
    timeout_s: Annotated[float, Meta(gt=0)] = field(default=30.0, metadata=_RULE)
    settled_within_m: Annotated[float, Meta(ge=0)] = field(default=0.01, metadata=ABSENT_BY_DEFAULT)
    settled_for_s: Annotated[float, Meta(ge=0)] = field(default=5.0, metadata=_RULE)
    standstill_samples: Annotated[int, Meta(ge=0, le=1_000_000)] = field(
        default=100, metadata=ABSENT_BY_DEFAULT
    )
    standstill_below: Annotated[float, Meta(ge=0)] = field(
        default=0.001, metadata=ABSENT_BY_DEFAULT
    )
    reorient: bool = field(default=False, metadata=ABSENT_BY_DEFAULT)
    schedule: GainSchedule | None = field(default=None, metadata=ABSENT_BY_DEFAULT)


def declare(parameters: Any, goal: Goal | None, path: Path | None) -> Declaration:
    """Return the loops, which act one after the other: two, or three with `reorient`.

    Raises:
        LawError: If the law must reorient and the goal has no heading.
    """
    del path
    return declare_loops(DECLARATION, goal, parameters.schedule, reorient=parameters.reorient)


def list_unused(parameters: Any) -> tuple[str, ...]:
    """Return `path`, and the goal's heading if the law does not turn to this heading at the end."""
    return ("path",) if parameters.reorient else ("path", "goal.heading_rad")


def prepare(parameters: Any) -> SequentialNumbers:
    """Return the keys of either sequential law as numbers."""
    kind: Any = type(parameters)
    values: dict[str, Any] = {
        name: getattr(parameters, name) if words is None else words.index(getattr(parameters, name))
        for name, words in _list_numbers(kind)
    }
    schedule = parameters.schedule
    if schedule is not None:
        values["entries"] = len(schedule.at)
        values["has_distances"] = schedule.over == DISTANCE
    return SequentialNumbers(**values)


@cache
def _list_numbers(keys: Any) -> tuple[tuple[str, tuple[str, ...] | None], ...]:
    """Return the keys that are numbers in both laws, each with its words if it has any."""
    hints = get_type_hints(keys)
    names = [one.name for one in fields(SequentialNumbers) if one.name in hints]
    return tuple(
        (name, get_args(hints[name]) if get_origin(hints[name]) is Literal else None)
        for name in names
    )


def build_table(parameters: Any) -> Sequence[Row]:
    """Return the rows of a schedule: distance or heading error, then the gains of `SCHEDULED`.

    Constant gains are NaN.
    """
    schedule = parameters.schedule
    if schedule is None:
        return ()
    entries = len(schedule.at)
    constant = (nan,) * entries
    gains = [getattr(schedule, name, None) or constant for name in SCHEDULED]
    return [*zip(schedule.at, *gains, strict=True)]


PART: Final = LawPart(
    name="sequential-p",
    meaning="Rotate to the goal bearing, then drive; the first callback only computes the bearing.",
    Parameters=SequentialPParameters,
    step=step,
    declare=declare,
    State=SequentialState,
    stops=STOPS,
    causes=_CAUSES,
    counts_samples=("standstill_samples",),
    list_unused=list_unused,
    prepare=prepare,
    Numbers=SequentialNumbers,
    build_table=build_table,
)

SequentialP: Final = PART
"""The sequential law as a Python class: `SequentialP(SequentialPParameters(...))` answers poses."""
