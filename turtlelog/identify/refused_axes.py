"""Causes why commands and motion do not identify an axis, and advice."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from turtlelog.display import describe_count
from turtlelog.identify.axis_fit import DEAD_TIME, LAG, AxisFit, NoGainError, fit_axis
from turtlelog.identify.axis_model import AxisModel, Estimate, Refusal, predict_axis
from turtlelog.identify.axis_motion import (
    AT_ONCE_S,
    LARGEST_DEAD_TIME_S,
    NAMES,
    OTHER,
    OVER_TIME,
    STANDING,
    UNITS,
    Axis,
    AxisMotion,
    find_repetition,
    get_commands,
    read_axis_motion,
)
from turtlelog.identify.fit_values import (
    cover_waiting,
    describe_fit,
    find_differing_parts,
)
from turtlelog.identify.held_response import COUPLED, Values
from turtlelog.identify.robot_model import find_reaching
from turtlelog.identify.robot_noise import LEAST_STEP
from turtlelog.log import UNREAD_COMMANDS
from turtlelog.measure.signals import find_no_commands
from turtlelog.run import Run, SourceKind, find_source_kind

_OPPOSITE_EXPLAINS: Final = 0.5
"""Smallest explained share of the variance for which a negative gain is reported; below it, a
positive gain may be wrong. A robot that turns the wrong way explains nearly all; another robot's
commands, or an echo of a period, explain little."""

_OPPOSITE_CLEARLY: Final = 30.0
"""Smallest advantage of the negative gain in twice the negative log-likelihood. If both signs were
equally likely, chance would reach it in 1 of a million robots."""

_SUDDEN_SHARE: Final = 0.05
"""Share of the range of commands that must change at once; slower changes are ramps. A
ramp over the range then takes more than 2 s, and shows no start."""

_FEWEST_MOVING: Final = 6
"""Smallest number of steps in which commands move the robot: up to five may be one jump, which
follows any command with some gain."""

_ENDLESS: Final = 10.0
"""Multiple of a value above which the end of its interval is not printed: it is as good as none,
and its digits are rounding."""

_ABSURD: Final = 1e9
"""Largest plausible command or step of a robot [m/s], [rad/s], [m] or [rad]: light needs 3 s for
it. Larger values come from bytes that are not numbers."""

_NEGLIGIBLE: Final = 1e-9
"""Value below which commands do not move a robot [m/s] or [rad/s]: a millimetre in twelve days."""

_OPPOSITE_WHY: Final[Mapping[Axis, str]] = {
    "speed": "its front and its back may be swapped",
    "turn_rate": "its left and its right motor may be swapped",
}

_SENTENCES: Final[Mapping[Refusal, str]] = {
    "no_commands": "no commands were recorded",
    "never_commanded": "the {name} is never commanded",
    "negligible": "the commanded {name} is at most {fastest:.2g} {unit}, which moves nothing",
    "constant": "the commanded {name} never changes",
    "ramps": (
        "the {name} is commanded in ramps: within {within_s:g} s it changes by at most {change:.2g}"
        " of {span:.2g} {unit}"
    ),
    "begun": (
        "earlier commands may act in the first {begun_s:.3g} s, and after that the commanded {name}"
        " does not change"
    ),
    "implausible": "the {what} reach {largest:.3g} {of_unit}, more than any robot does",
    "few_steps": (
        "expected at least {fewest} steps between poses at most 1 s apart while commands act, found"
        " {steps}"
    ),
    "no_gain": "{error}",
    "opposite": (
        "the {name} follows its commands with the opposite sign: gain {gain}, dead time"
        " {dead_time_s:.3f} s, lag {lag_s:.3f} s"
    ),
    "late": (
        "the best dead time is the largest that is tried, {most_s:g} s: commands and poses may have"
        " different clocks, or the commands change too slowly"
    ),
    "unexplained": (
        "the commands explain nothing of how the motion changes: are they this robot's, and of the"
        " clock of its poses?"
    ),
    "jump": "commands act in only {count} of {steps} between poses, which may be a jump",
    "wide": (
        "the interval of the {what}, {found.low:.3g} to {high}{of_unit}, is wider than its value of"
        " {found.value:.3g}{of_unit}"
    ),
    "repeated": (
        "the commands {how}, so gains of {own[0]:.3g} with a dead time of {own[1]:.3g} s and"
        " {other[0]:.3g} with {other[1]:.3g} s explain the motion alike"
    ),
    "at_bound": (
        "{every} positive command reaches the limit of {bound:.3g} {unit}, so that the gain of"
        " smaller ones is only known to be at least {least:.3g}; the total delay is {delay_s:.3f} s"
    ),
    "hidden": "no pose shows a change of the commanded {name}",
}

_FIRST: Final[Mapping[Refusal, str]] = {
    "no_commands": "record the topic of the commands beside the poses",
    "begun": "begin to record while the robot rests",
}
"""Advice before the test drive."""

_EARLY: Final = (
    "no delay fits best, and the intervals are wide: the motion may lead the commands, or noise"
    " hides the delay"
)
_UNDISTURBED: Final = ", while no emergency stop and no other program acts"
_ONE_CLOCK: Final = ", and record commands without delay, by the clock of the poses"


def refuse_axis(axis: Axis, refusal: Refusal, *, drive: str = "", **facts: Any) -> AxisModel:
    """Return an axis without values. `drive` completes the advised test drive."""
    advice = f"step the {NAMES[axis]} ten times for 2 s{drive}"
    if refusal in _FIRST:
        advice = f"{_FIRST[refusal]}, and {advice}"
    reason = _SENTENCES[refusal].format(name=NAMES[axis], unit=UNITS[axis], **facts)
    return AxisModel(
        axis=axis, status="not_identifiable", refusal=refusal, reason=reason, advice=advice
    )


def refuse_commands(runs: Sequence[Run], axis: Axis) -> AxisModel | None:
    """Return an axis without values if the commands cannot identify it; else None."""
    commands = [get_commands(run, axis) for run in runs]
    lacks_column = all(_lacks_column(run, axis) for run in runs)
    if lacks_column or not any(len(command) for command in commands):
        refused = refuse_axis(axis, "no_commands")
        return _ask_for_column(refused) if lacks_column else refused
    if not any(command.any() for command in commands):
        return refuse_axis(axis, "never_commanded")
    fastest = max(float(np.abs(command).max(initial=0.0)) for command in commands)
    if fastest < _NEGLIGIBLE:
        return refuse_axis(axis, "negligible", fastest=fastest)
    if not any(np.diff(command).any() for command in commands):
        return refuse_axis(axis, "constant")
    change = max(_find_sudden(run, axis) for run in runs)
    span = float(np.ptp(np.concatenate([*commands, np.zeros(1)])))
    if change < _SUDDEN_SHARE * span:
        return refuse_axis(axis, "ramps", within_s=AT_ONCE_S, change=change, span=span)
    return None


def _lacks_column(run: Run, axis: Axis) -> bool:
    """Return whether no column of a table is read as the commands of an axis, but may be one."""
    is_table = find_source_kind(run.source) is SourceKind.TABLE
    may_read = UNREAD_COMMANDS in run.notes or not len(run.commands)
    return is_table and may_read and find_no_commands(run, axis) is not None


def _ask_for_column(refused: AxisModel) -> AxisModel:
    return replace(
        refused,
        reason=f"no column of the table is read as the commanded {NAMES[refused.axis]}",
        advice=f"name that column with --column command_{refused.axis}=NAME",
    )


def refuse_begun(
    runs: Sequence[Run], motions: Sequence[AxisMotion], axis: Axis
) -> AxisModel | None:
    """Return an axis without values if no command changes in the steps that are used; else None."""
    # What is left is a motion that fades, as it does for any gain and dead time.
    used = [(run, one) for run, one in zip(runs, motions, strict=True) if len(one.moved)]
    if not used or any((one.commands.time_s[1:] >= one.time_s[0]).any() for _, one in used):
        return None
    begun_s = min(one.time_s[0] - run.poses.time_ns[0] / 1e9 for run, one in used)
    return refuse_axis(axis, "begun", begun_s=begun_s)


def refuse_implausible(
    runs: Sequence[Run], motions: Sequence[AxisMotion], axis: Axis
) -> AxisModel | None:
    """Return an axis without values if its commands or steps are implausible; else None."""
    unit = UNITS[axis]
    for what, of_unit, values in (
        ("commands", unit, [get_commands(run, axis) for run in runs]),
        ("steps between poses", unit.removesuffix("/s"), [motion.moved for motion in motions]),
    ):
        largest = max(float(np.abs(value).max(initial=0.0)) for value in values)
        if largest > _ABSURD:
            return refuse_axis(axis, "implausible", what=what, largest=largest, of_unit=of_unit)
    return None


def _find_sudden(run: Run, axis: Axis) -> float:
    command, time_ns = get_commands(run, axis), run.commands.time_ns
    if not len(command):
        return 0.0
    held = np.searchsorted(time_ns, time_ns - round(AT_ONCE_S * 1e9), side="right") - 1
    return float(np.abs(command - command[np.maximum(held, 0)]).max())


def refuse_fit(
    axis: Axis, motions: Sequence[AxisMotion], fit: AxisFit, found: AxisModel
) -> AxisModel | None:
    """Return an axis without values if a fit does not identify it, with the reason; else None."""
    refused = _doubt_fit(found, fit)
    explains = found.explained is not None and found.explained >= _OPPOSITE_EXPLAINS
    if (refused or not explains) and (opposite := refuse_opposite(axis, motions, fit)):
        return opposite
    if refused is None and (repetition := find_repetition(motions)):
        refused = _refuse_twin(axis, motions, fit, *repetition)
    if refused is None or not (found.gain and found.bound and _is_wide(found.gain)):
        return refused
    # Commands at the bound show no gain: any larger one leads there, too.
    most = found.bound.value / found.gain.value
    how = f"also to less than {most:.2g} {UNITS[axis]}"
    if found.bound_acts in COUPLED:
        how = f"while the {NAMES[OTHER[axis]]} rests"
    return replace(refused, advice=f"{refused.advice}, {how}")


def refuse_opposite(
    axis: Axis, motions: Sequence[AxisMotion], fit: AxisFit | None
) -> AxisModel | None:
    """Return an axis without values if the robot moves in the opposite direction; else None."""
    try:
        other = fit_axis([replace(motion, moved=-motion.moved) for motion in motions])
    except NoGainError:
        return None
    found = describe_fit(axis, other, 0)
    explains = found.explained is not None and found.explained >= _OPPOSITE_EXPLAINS
    if not explains or _doubt_fit(found, other):
        return None
    if fit is not None and fit.badness - other.badness < _OPPOSITE_CLEARLY:
        return None
    gain = found.gain
    told = "" if gain is None else f"{-gain.value:.3f} ({-gain.high:.3f} to {-gain.low:.3f})"
    dead_time_s, lag_s = other.parameters[[DEAD_TIME, LAG]].tolist()
    refused = refuse_axis(axis, "opposite", gain=told, dead_time_s=dead_time_s, lag_s=lag_s)
    how = f"reverse the sign of the {NAMES[axis]}, in the robot's driver or in the commands"
    return replace(refused, advice=f"{how}: {_OPPOSITE_WHY[axis]}")


def _doubt_fit(found: AxisModel, fit: AxisFit) -> AxisModel | None:
    """Return an axis without values if they are invalid. A delay within one step is well known."""
    if fit.parameters[DEAD_TIME] >= LARGEST_DEAD_TIME_S:
        return refuse_axis(found.axis, "late", most_s=LARGEST_DEAD_TIME_S)
    if found.explained is None or found.explained <= 0.0:
        return refuse_axis(found.axis, "unexplained")
    size = np.abs(fit.model.moved - fit.residual) / fit.model.duration_s
    moving = int(np.count_nonzero(size > STANDING * size.max()))
    if moving < _FEWEST_MOVING:
        count = describe_count(moving, "step")
        return refuse_axis(found.axis, "jump", count=count, steps=len(size))
    fine_s = float(np.median(fit.model.duration_s))
    refused = _refuse_wide(found, fine_s)
    if refused and not fit.parameters[[DEAD_TIME, LAG]].any():
        return replace(refused, reason=_EARLY, advice=f"{refused.advice}{_ONE_CLOCK}")
    if not (refused and found.doubts) or _refuse_wide(describe_fit(found.axis, fit, 0), fine_s):
        return refused
    return _refuse_differing(refused, find_differing_parts(found.axis, fit))


def _refuse_differing(refused: AxisModel, differing: Collection[str]) -> AxisModel:
    """Return an axis without values with the parts of the motion that differ as the reason."""
    if not differing:
        return refused
    told = f", as the response differs between {', and between '.join(differing)}"
    # No model has such a response, so that no drive shows its values, unless it was disturbed.
    advice = f"{refused.advice}{_UNDISTURBED}" if OVER_TIME in differing else ""
    return replace(refused, reason=f"{refused.reason}{told}", advice=advice)


def _refuse_wide(found: AxisModel, fine_s: float = 0.0, *, drive: str = "") -> AxisModel | None:
    """Return an axis without values if an interval is wider than its value; else None."""
    for what, value, fine in (
        ("gain", found.gain, 0.0),
        ("total delay", found.total_delay_s, fine_s),
    ):
        if value is not None and _is_wide(value, fine):
            most = _ENDLESS * value.value
            high = f"more than {most:.3g}" if value.high > most else f"{value.high:.3g}"
            unit = "" if value.unit == "1" else f" {value.unit}"
            facts = {"what": what, "found": value, "high": high, "of_unit": unit}
            return refuse_axis(found.axis, "wide", drive=drive, **facts)
    return None


def _is_wide(value: Estimate, fine: float = 0.0) -> bool:
    return value.high - value.low > max(value.value, fine)


_FEWEST_STEPS: Final = 50
"""Smallest number of steps that shows the noise: a second and a half at 30 Hz."""

_SPARSE_S: Final = 20.0 / _FEWEST_STEPS
"""Usual time between poses above which the suggested drive, ten times 2 s, has too few steps
[s]."""


def refuse_few_steps(runs: Sequence[Run], axis: Axis, steps: int) -> AxisModel | None:
    """Return an axis without values if too few steps show its noise; else None."""
    if steps >= _FEWEST_STEPS:
        return None
    refused = refuse_axis(axis, "few_steps", fewest=_FEWEST_STEPS, steps=steps)
    if all(_find_usual_step(run) > _SPARSE_S for run in runs):
        advice = f"record poses at most {_SPARSE_S:g} s apart, and {refused.advice}"
        refused = replace(refused, advice=advice)
    return refused


def _find_usual_step(run: Run) -> float:
    """Return the usual time between poses [s]; 0 for fewer than two poses."""
    steps_ns = np.diff(run.poses.time_ns)
    return float(np.median(steps_ns)) / 1e9 if len(steps_ns) else 0.0


_DIFFERS: Final = 0.25
"""Smallest difference of two models in a decisive step, as a share of the largest step."""

_FEWEST: Final = 3  # smallest number of decisive steps; fewer steps may be jumps

_BETTER: Final = 0.5
"""Largest error of the right model in these steps, as a share of the other model's error."""


def _refuse_twin(
    axis: Axis, motions: Sequence[AxisMotion], fit: AxisFit, shift_s: float, sign: int
) -> AxisModel | None:
    """Return an axis without values if the motion leaves a dead time ambiguous; else None."""
    gain, dead_time_s, lag_s, *extra = fit.parameters.tolist()
    count = int(LARGEST_DEAD_TIME_S / shift_s) + 1
    for number in range(-count, count + 1):
        other_s, its_sign = dead_time_s + number * shift_s, sign**number
        if not number or not 0.0 <= other_s < LARGEST_DEAD_TIME_S:
            continue
        ratio = _compare(fit, np.array([its_sign * gain, other_s, lag_s, *extra]))
        if ratio is not None and ratio <= _BETTER:
            continue
        how = f"repeat every {shift_s:.3g} s" + (" with the other sign" if sign < 0 else "")
        is_opposite = its_sign < 0 and ratio is not None and ratio >= 1.0 / _BETTER
        if is_opposite and (opposite := refuse_opposite(axis, motions, None)):
            return opposite
        own, other = (gain, dead_time_s), (its_sign * gain, other_s)
        return refuse_axis(axis, "repeated", how=how, own=own, other=other)
    return None


def _compare(fit: AxisFit, twin: Values) -> float | None:
    """Return the ratio of the residuals of a fit and its twin; None if they hardly differ."""
    moved = fit.model.moved
    one, other = (fit.model.linearise(parameters)[0] for parameters in (fit.parameters, twin))
    decide = np.abs(one - other) > _DIFFERS * float(np.abs(one).max())
    if np.count_nonzero(decide) < _FEWEST:
        return None
    left = [float(np.abs(moved - model)[decide].sum()) for model in (one, other)]
    return left[0] / max(left[1], np.finfo(float).tiny)


def refuse_forward(runs: Sequence[Run], model: AxisModel) -> AxisModel | None:
    """Return an axis without values if the motion shows only the gain of negative commands.

    The gain of positive ones may have any value above the bound divided by the smallest of them.
    """
    found = find_reaching(runs, model, 1.0)
    if found is None:
        return None
    every, smallest = found
    bound, delay = (0.0 if one is None else one.value for one in (model.bound, model.total_delay_s))
    return refuse_axis(
        model.axis,
        "at_bound",
        drive=f", also to less than {smallest:.2g} {UNITS[model.axis]}",
        every=every,
        bound=bound,
        least=bound / smallest,
        delay_s=delay,
    )


def doubt_waiting(runs: Sequence[Run], model: AxisModel, other: AxisModel) -> AxisModel:
    """Return an axis in doubt if it may wait for the other axis; without values if that is all."""
    covered = cover_waiting(runs, model, other)
    if covered is model:
        return model
    return _refuse_wide(covered, drive=f", while the {NAMES[other.axis]} rests") or covered


_CONTRADICTS: Final = 15.0
"""Increase of twice the negative log-likelihood of the other axis from which it has no limit of the
wheels: by chance in 1 of 10,000 robots."""


def contradicts_wheels(runs: Sequence[Run], found: AxisModel, other: AxisModel) -> bool:
    """Return whether the other axis clearly lacks a limit of the wheels' acceleration.

    For example, the turn rate of a car is in proportion to its speed, which looks like this limit.
    """
    own, beside = found.rate_limit, found.rate_limit_beside
    if own is None or beside is None or found.gain is None or other.gain is None:
        return False
    if other.limit_acts:
        return False
    # The same limit, as the other axis would show it.
    shared = replace(
        other,
        limit_acts="at_wheels",
        rate_limit=Estimate(value=other.gain.value * beside.value, low=0.0, high=np.inf),
        rate_limit_beside=Estimate(value=own.value / found.gain.value, low=0.0, high=np.inf),
        lag_product_s2=None,
        bound=None,
        bound_beside=None,
        deadband=None,
        reverse_gain=None,
        friction=None,
        drift=None,
        bound_acts="",
        model="first_order",
    )
    squares, steps = np.zeros(2), 0
    for run in runs:
        motion = read_axis_motion(run, other.axis)
        for row, model in enumerate((other, shared)):
            way, _ = predict_axis(model, run, motion.time_s)
            off = motion.moved - (way[motion.first + 1] - way[motion.first])
            squares[row] += float(off @ off)
        steps += len(motion.moved)
    return bool(steps * np.log(squares[1] / max(squares[0], LEAST_STEP**2)) > _CONTRADICTS)
