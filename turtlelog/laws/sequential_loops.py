"""The loops of the sequential laws: rotate, translate, and if asked for reorient."""

from dataclasses import replace
from typing import Final

from turtlelog.errors import LawError
from turtlelog.laws.base import Goal
from turtlelog.laws.schedule import GainSchedule
from turtlelog.loops import PAUSE, ControlLoop, Declaration

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
"""What the sequential law declares, with constant gains and without reorientation."""


def declare_loops(
    base: Declaration, goal: Goal | None, schedule: GainSchedule | None, *, reorient: bool
) -> Declaration:
    """Return a sequential law's declaration, with what a schedule hides and `reorient` adds.

    Args:
        base: With constant gains, and without reorientation.
        goal: None: not known.
        schedule: Of a loop with a scheduled gain no gain is declared, as no number is its gain.
        reorient: Whether a third loop turns to the goal's heading, as the first to its bearing.

    Raises:
        LawError: Where the law is to reorient, and the goal has no heading.
    """
    if schedule is None and not reorient:
        return base  # What it says has been judged once.
    loops = [_hide_gains(loop, schedule) for loop in base.loops]
    phases = dict(base.phases)
    if reorient:
        if goal is None or goal.heading_rad is None:
            expected = "a goal with a heading to turn to (goal.heading_rad)"
            raise LawError(f"law.reorient: expected {expected}, found none")
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
