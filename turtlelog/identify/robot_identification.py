"""A robot's dynamics from the commands and the motion of its runs."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Final

import numpy as np

from turtlelog.display import describe_count
from turtlelog.errors import IdentifyError
from turtlelog.identify.axis_fit import (
    DEAD_TIME,
    EXTRA,
    GAIN,
    LAG,
    TOTAL,
    AxisFit,
    fit_axis,
    fit_without_lag,
    measure_badness,
)
from turtlelog.identify.axis_motion import (
    AXES,
    LARGEST_DEAD_TIME_S,
    NAMES,
    UNITS,
    Axis,
    AxisMotion,
    count_steps,
    get_commands,
    read_axis_motion,
)
from turtlelog.identify.correlation import find_correlation_delay
from turtlelog.identify.held_response import Values
from turtlelog.identify.order_choice import choose_order
from turtlelog.identify.repeated_commands import find_repetition, tell_twin
from turtlelog.identify.robot_model import AxisModel, Estimate, RobotEvent, RobotModel
from turtlelog.identify.tick_delays import identify_ticks
from turtlelog.run import Run

_NORMAL_95: Final = 1.96
"""Standard deviations on either side that hold 95 % of normal noise."""

_DIFFERENT: Final = 3.0
"""Standard deviations by which two runs must differ to be called different: by chance in 0.3 % of
pairs."""

_FEWEST_STEPS: Final = 50
"""Fewest steps between poses from which noise can be told [1]: a second and a half at 30 Hz."""

MOST_STEPS: Final = 100_000
"""Steps that are used of each axis: half an hour at 50 Hz, in about 5 s. Of a longer log the first
part of each run; more would tell what no robot keeps for so long."""

_SHORT_LAG: Final = 2.0
"""A lag of so many steps between poses or less may as well be none."""

_OPPOSITE_EXPLAINS: Final = 0.5
"""Share of the variance that a gain below 0 must explain to be told, and below which one above 0
may be wrong: a robot that turns the wrong way explains nearly all, another robot's commands or an
echo of a period little."""

_OPPOSITE_CLEARLY: Final = 30.0
"""By how much it must lower twice the negative log-likelihood: by chance in 1 of a million robots,
were both signs as likely."""

_SUDDEN_S: Final = 0.1
"""Within this time a change of the command counts as one step [s]: a usual robot's delay."""

_SUDDEN_SHARE: Final = 0.05
"""Share of the range of commands that changes within that time, below which they are ramps: a ramp
over the range then takes more than 2 s, and shows no beginning."""

_OPPOSITE_WHY: Final[Mapping[Axis, str]] = MappingProxyType(
    {
        "speed": "its front and its back may be swapped",
        "turn_rate": "its left and its right motor may be swapped",
    }
)


def identify_robot(runs: Run | Sequence[Run]) -> RobotModel:
    """Return gain, dead time and lag of each axis of a robot, with intervals of 95 %.

    The steps between poses are compared with the response to the commands, which hold until the
    next one, in closed form; no pose is resampled. Several runs of one robot are fitted together,
    and what differs between them is told in the notes. Of turtlesim each pose tells the command
    that its tick took, and nothing is fitted.

    Raises:
        IdentifyError: Where there is no run.
    """
    runs = [runs] if isinstance(runs, Run) else [*runs]
    if not runs:
        raise IdentifyError("runs: expected at least one, found none")
    files = tuple(run.name for run in runs)
    exact = identify_ticks(runs)
    if exact is not None:
        return exact
    found = [_identify_axis(runs, axis) for axis in AXES]
    notes = [note for model, _ in found for note in _compare_runs(runs, model)]
    notes += [_note_stops(model) for model, _ in found if model.silent_stops_s]
    notes += [_note_part(model) for model, _ in found if model.steps < model.steps_in_all]
    return RobotModel(
        files=files,
        clock=runs[0].clock,
        speed=found[0][0],
        turn_rate=found[1][0],
        events=tuple(event for _, events in found for event in events),
        notes=tuple(notes),
    )


def _identify_axis(runs: Sequence[Run], axis: Axis) -> tuple[AxisModel, list[RobotEvent]]:
    reason = find_no_excitation(runs, axis)
    motions = [read_axis_motion(run, axis) for run in runs]
    steps = count_steps(motions)
    if steps > MOST_STEPS:
        share = MOST_STEPS / steps
        motions = [motion.take(slice(int(share * len(motion.moved)))) for motion in motions]
    if not reason and steps < _FEWEST_STEPS:
        reason = (
            f"expected at least {_FEWEST_STEPS} steps between poses at most 1 s apart while"
            f" commands act, found {steps}"
        )
    if reason:
        return refuse_axis(axis, reason), []
    try:
        fit = fit_axis(motions)
    except ValueError:
        opposite = _find_opposite(axis, motions, None)
        return opposite or refuse_axis(axis, "no motion follows the commands"), []
    fit = choose_order(fit)
    found = _describe(axis, fit, sum(_count_changes(run, axis) for run in runs))
    refused = _refuse_fit(axis, motions, fit, found)
    if refused is not None:
        return refused, []
    names = [run.name for run, motion in zip(runs, motions, strict=True) if len(motion.moved)]
    delay_s = find_correlation_delay(motions)
    waits_s = [stop.stop_s - stop.begin_s for motion in motions for stop in motion.stops]
    found = replace(
        found, correlation_delay_s=delay_s, steps_in_all=steps, silent_stops_s=tuple(waits_s)
    )
    return found, _list_events(names, axis, fit)


def _refuse_fit(
    axis: Axis, motions: Sequence[AxisMotion], fit: AxisFit, found: AxisModel
) -> AxisModel | None:
    """Refuse an axis that a fit does not tell, saying why; None where it does."""
    opposite = None
    reason = _find_doubt(found, fit)
    if reason or found.explained is None or found.explained < _OPPOSITE_EXPLAINS:
        opposite = _find_opposite(axis, motions, fit)
    repetition = None if reason or opposite else find_repetition(motions)
    if repetition is not None:
        reason, is_opposite = tell_twin(fit, *repetition)
        opposite = _find_opposite(axis, motions, None) if is_opposite else None
    return opposite or (refuse_axis(axis, reason) if reason else None)


def _find_opposite(
    axis: Axis, motions: Sequence[AxisMotion], fit: AxisFit | None
) -> AxisModel | None:
    """Refuse an axis that moves the wrong way round, saying so; None where it does not."""
    try:
        other = fit_axis([replace(motion, moved=-motion.moved) for motion in motions])
    except ValueError:
        return None
    found = _describe(axis, other, 0)
    explains = found.explained is not None and found.explained >= _OPPOSITE_EXPLAINS
    if not explains or _find_doubt(found, other):
        return None
    if fit is not None and measure_badness(fit) - measure_badness(other) < _OPPOSITE_CLEARLY:
        return None
    gain = found.gain
    told = "" if gain is None else f"{-gain.value:.3f} ({-gain.high:.3f} to {-gain.low:.3f})"
    dead_time_s, lag_s = other.parameters[[DEAD_TIME, LAG]].tolist()
    name, why = NAMES[axis], _OPPOSITE_WHY[axis]
    return AxisModel(
        axis=axis,
        status="not_identifiable",
        reason=(
            f"the {name} follows its commands with the opposite sign: gain {told}, dead time"
            f" {dead_time_s:.3f} s, lag {lag_s:.3f} s"
        ),
        advice=f"reverse the sign of the {name}, in the robot's driver or in the commands: {why}",
    )


def _note_stops(model: AxisModel) -> str:
    waits_s = model.silent_stops_s
    return (
        f"The {NAMES[model.axis]} stops by itself where no command comes,"
        f" {describe_count(len(waits_s), 'time')}: it is down to half {min(waits_s):.2f} to"
        f" {max(waits_s):.2f} s after the last command."
    )


def _note_part(model: AxisModel) -> str:
    return (
        f"The {NAMES[model.axis]} is identified from the first {model.steps} of"
        f" {model.steps_in_all} steps between poses."
    )


def find_no_excitation(runs: Sequence[Run], axis: Axis) -> str:
    """Return why the commands of some runs cannot tell an axis; empty where they can."""
    name = NAMES[axis]
    commands = [get_commands(run, axis) for run in runs]
    if not any(len(command) for command in commands):
        return "no commands were recorded"
    if not any(command.any() for command in commands):
        return f"the {name} is never commanded"
    if not any(np.diff(command).any() for command in commands):
        return f"the commanded {name} never changes"
    largest = max(_find_sudden(run, axis) for run in runs)
    both = np.concatenate([*commands, np.zeros(1)])
    span = float(np.ptp(both))
    if largest < _SUDDEN_SHARE * span:
        return (
            f"the {name} is commanded in ramps: within {_SUDDEN_S:g} s it changes by at most"
            f" {largest:.2g} of {span:.2g} {UNITS[axis]}"
        )
    return ""


def _find_sudden(run: Run, axis: Axis) -> float:
    """Return the largest change of a command within a short time."""
    command, time_ns = get_commands(run, axis), run.commands.time_ns
    if not len(command):
        return 0.0
    held = np.searchsorted(time_ns, time_ns - round(_SUDDEN_S * 1e9), side="right") - 1
    return float(np.abs(command - command[np.maximum(held, 0)]).max())


def refuse_axis(axis: Axis, reason: str) -> AxisModel:
    """Return an axis without values."""
    advice = f"step the {NAMES[axis]} ten times for 2 s"
    if reason.startswith("no commands"):
        advice = f"record the topic of the commands beside the poses, and {advice}"
    return AxisModel(axis=axis, status="not_identifiable", reason=reason, advice=advice)


def _find_doubt(found: AxisModel, fit: AxisFit) -> str:
    """Return why values that were fitted are none; a total delay within a step is well known."""
    if fit.parameters[DEAD_TIME] >= LARGEST_DEAD_TIME_S:
        return (
            f"no dead time up to {LARGEST_DEAD_TIME_S:g} s explains the motion: are commands and"
            " poses of one clock?"
        )
    if found.explained is None or found.explained <= 0.0:
        return (
            "the commands explain nothing of how the motion changes: are they this robot's, and of"
            " the clock of its poses?"
        )
    usual_s = float(np.median(fit.model.duration_s))
    for name, value, fine in (
        ("gain", found.gain, 0.0),
        ("total delay", found.total_delay_s, usual_s),
    ):
        if value is not None and value.high - value.low > max(value.value, fine):
            unit = "" if value.unit == "1" else f" {value.unit}"
            return (
                f"the interval of the {name}, {value.low:.3g} to {value.high:.3g}{unit}, is wider"
                f" than its value of {value.value:.3g}{unit}"
            )
    return ""


def _count_changes(run: Run, axis: Axis) -> int:
    return int(np.count_nonzero(np.diff(get_commands(run, axis), prepend=0.0)))


def _describe(axis: Axis, fit: AxisFit, changes: int) -> AxisModel:
    parameters, covariance = fit.parameters, fit.covariance
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    counted = ~fit.is_outlier
    moved, white = fit.model.moved[counted], fit.white[counted]
    left = float(np.sum(fit.residual[counted] ** 2))
    spread = float(np.sum((moved - moved.mean()) ** 2))
    kind = fit.model.kind
    product = limit = None
    if kind == "second_order":
        product = _estimate(float(parameters[EXTRA]), float(errors[EXTRA]), "s^2")
    if kind == "limited":
        limit = _estimate_limit(parameters, covariance, f"{UNITS[axis]}^2")
    total = _estimate(float(parameters[DEAD_TIME] + parameters[LAG]), float(errors[TOTAL]))
    dead_time, lag = _allow_no_lag(
        fit,
        _estimate(float(parameters[DEAD_TIME]), measure_dead_time_error(fit)),
        _estimate(float(parameters[LAG]), float(errors[LAG])),
    )
    # Neither is below 0, so neither is above their sum.
    return AxisModel(
        axis=axis,
        status="ok",
        model="second_order" if kind == "second_order" else "first_order",
        gain=_estimate(float(parameters[GAIN]), float(errors[GAIN]), "1"),
        dead_time_s=replace(dead_time, high=min(dead_time.high, total.high)),
        lag_s=replace(lag, high=min(lag.high, total.high)),
        total_delay_s=total,
        lag_product_s2=product,
        rate_limit=limit,
        explained=1.0 - left / spread if spread > 0.0 else None,
        whiteness=measure_whiteness(white),
        outliers=int(np.count_nonzero(fit.is_outlier)),
        steps=len(fit.residual),
        changes=changes,
    )


def measure_dead_time_error(fit: AxisFit) -> float:
    """Return the standard error of the dead time: total delay less lag [s]."""
    of_delays = fit.covariance[np.ix_([TOTAL, LAG], [TOTAL, LAG])]
    signs = np.array([1.0, -1.0])
    return float(np.sqrt(max(signs @ of_delays @ signs, 0.0)))


def _allow_no_lag(fit: AxisFit, dead_time: Estimate, lag: Estimate) -> tuple[Estimate, Estimate]:
    """Widen intervals to a lag of 0 where that fits as well.

    A lag that is short against the steps shows in those steps only in which the command switches:
    its errors are not normal, and the cost tells more than its curvature does.
    """
    short_s = _SHORT_LAG * float(np.median(fit.model.duration_s))
    if fit.model.kind != "first_order" or lag.low <= 0.0 or lag.value > short_s:
        return dead_time, lag
    without = fit_without_lag(fit)
    if without.cost - fit.cost > _NORMAL_95**2 * fit.dispersion:
        return dead_time, lag
    error = float(np.sqrt(without.covariance[TOTAL, TOTAL]))
    high = float(without.parameters[DEAD_TIME]) + _NORMAL_95 * error
    return replace(dead_time, high=max(dead_time.high, high)), replace(lag, low=0.0)


def _estimate(value: float, error: float, unit: str = "s") -> Estimate:
    """Return a value that is not below 0 with its interval."""
    half = _NORMAL_95 * error
    return Estimate(value=value, low=max(value - half, 0.0), high=value + half, unit=unit)


def _estimate_limit(parameters: Values, covariance: Values, unit: str) -> Estimate:
    """Return the largest change of the rate: the gain by the time that a unit takes."""
    gain, slowness = float(parameters[GAIN]), float(parameters[EXTRA])
    slope = np.array([1.0 / slowness, -gain / slowness**2])
    rows = np.ix_([GAIN, EXTRA], [GAIN, EXTRA])
    error = float(np.sqrt(max(slope @ covariance[rows] @ slope, 0.0)))
    return _estimate(gain / slowness, error, unit)


def measure_whiteness(white: Values) -> float | None:
    """Return the mean square of the changes by twice the mean square: 1 for noise."""
    squares = float(np.mean(white**2))
    return float(np.mean(np.diff(white) ** 2)) / (2.0 * squares) if squares > 0.0 else None


def _list_events(names: Sequence[str], axis: Axis, fit: AxisFit) -> list[RobotEvent]:
    """Return the outliers of a fit, as events of the runs that they are in."""
    events, begin = [], 0
    for name, motion in zip(names, fit.model.motions, strict=True):
        end = begin + len(motion.moved)
        for step in np.flatnonzero(fit.is_outlier[begin:end]).tolist():
            time_s = float(motion.time_s[motion.first[step] + 1])
            size = float(fit.residual[begin + step])
            events.append(RobotEvent(file=name, axis=axis, time_s=time_s, size=size))
        begin = end
    return events


def _compare_runs(runs: Sequence[Run], together: AxisModel) -> list[str]:
    """Return what one run says otherwise than all of them together, in sentences."""
    if len(runs) < 2 or not together.is_known:
        return []
    notes = []
    for run in runs:
        alone = _identify_axis([run], together.axis)[0]
        if alone.is_known:
            notes += _tell_differences(run.name, alone, together)
    return notes


def _tell_differences(name: str, alone: AxisModel, together: AxisModel) -> list[str]:
    told = []
    for field in ("gain", "dead_time_s", "lag_s", "total_delay_s"):
        one, other = getattr(alone, field), getattr(together, field)
        half = [estimate.high - estimate.value for estimate in (one, other)]
        error = float(np.hypot(*half)) / _NORMAL_95
        if abs(one.value - other.value) > _DIFFERENT * error:
            what = field.removesuffix("_s").replace("_", " ")
            told.append(f"{what} {_tell(one)} instead of {_tell(other)}")
    if not told:
        return []
    return [f"{name} differs from all runs together in the {NAMES[alone.axis]}: {', '.join(told)}."]


def _tell(value: Estimate) -> str:
    unit = "" if value.unit == "1" else f" {value.unit}"
    return f"{value.value:.3g} ({value.low:.3g} to {value.high:.3g}){unit}"
