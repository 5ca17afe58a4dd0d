"""Why the commands and the motion of some runs do not tell an axis, and what would."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Final

import numpy as np

from turtlelog.identify.axis_fit import (
    DEAD_TIME,
    LAG,
    AxisFit,
    NoGainError,
    fit_axis,
    measure_badness,
)
from turtlelog.identify.axis_motion import (
    LARGEST_DEAD_TIME_S,
    NAMES,
    UNITS,
    Axis,
    AxisMotion,
    get_commands,
)
from turtlelog.identify.axis_values import describe_fit
from turtlelog.identify.repeated_commands import find_repetition, tell_twin
from turtlelog.identify.robot_model import AxisModel
from turtlelog.run import Run

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

_ABSURD: Final = 1e9
"""Commands and steps above this are no robot's [m/s], [rad/s], [m] or [rad]: light takes 3 s so
far. They come from bytes that are no number."""

_NEGLIGIBLE: Final = 1e-9
"""Commands below this move no robot [m/s] or [rad/s]: a millimetre in twelve days."""

_OPPOSITE_WHY: Final[Mapping[Axis, str]] = MappingProxyType(
    {
        "speed": "its front and its back may be swapped",
        "turn_rate": "its left and its right motor may be swapped",
    }
)


def find_no_excitation(runs: Sequence[Run], axis: Axis) -> str:
    """Return why the commands of some runs cannot tell an axis; empty where they can."""
    name = NAMES[axis]
    commands = [get_commands(run, axis) for run in runs]
    if not any(len(command) for command in commands):
        return "no commands were recorded"
    if not any(command.any() for command in commands):
        return f"the {name} is never commanded"
    fastest = max(float(np.abs(command).max(initial=0.0)) for command in commands)
    if fastest < _NEGLIGIBLE:
        return f"the commanded {name} is at most {fastest:.2g} {UNITS[axis]}, which moves nothing"
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


def find_absurd(runs: Sequence[Run], motions: Sequence[AxisMotion], axis: Axis) -> str:
    """Return what of an axis is larger than a robot can be; empty where nothing is."""
    unit = UNITS[axis]
    columns = (
        ("commands", unit, [get_commands(run, axis) for run in runs]),
        ("steps between poses", unit.removesuffix("/s"), [motion.moved for motion in motions]),
    )
    for what, its_unit, values in columns:
        largest = max((float(np.abs(value).max()) for value in values if len(value)), default=0.0)
        if largest > _ABSURD:
            return f"the {what} reach {largest:.3g} {its_unit}, more than any robot does"
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


def refuse_fit(
    axis: Axis, motions: Sequence[AxisMotion], fit: AxisFit, found: AxisModel
) -> AxisModel | None:
    """Refuse an axis that a fit does not tell, saying why; None where it does."""
    opposite = None
    reason = _find_doubt(found, fit)
    if reason or found.explained is None or found.explained < _OPPOSITE_EXPLAINS:
        opposite = find_opposite(axis, motions, fit)
    repetition = None if reason or opposite else find_repetition(motions)
    if repetition is not None:
        reason, is_opposite = tell_twin(fit, *repetition)
        opposite = find_opposite(axis, motions, None) if is_opposite else None
    return opposite or (refuse_axis(axis, reason) if reason else None)


def find_opposite(
    axis: Axis, motions: Sequence[AxisMotion], fit: AxisFit | None
) -> AxisModel | None:
    """Refuse an axis that moves the wrong way round, saying so; None where it does not."""
    try:
        other = fit_axis([replace(motion, moved=-motion.moved) for motion in motions])
    except NoGainError:
        return None
    found = describe_fit(axis, other, 0)
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
