"""Steps of the commands sent to a robot, and the response of its measured rate.

Before a step, a command is held long enough for the robot to settle. After the step, another
command is held long enough for the response. Commands from a joystick or a ramp change with every
message and contain no steps. A response is judged by its own initial and final values: a robot that
drives at 0.9 times the commanded speed has no steady-state error here.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.measure.context import RunContext
from turtlelog.measure.metric import NO_COMMANDS, ONE_POSE, Found, Missing, Result, Status
from turtlelog.measure.metric_kinds import run_metric
from turtlelog.measure.outliers import compute_median
from turtlelog.measure.rates import SAME, Axis, HeldCommands, Rates
from turtlelog.measure.step_response import find_overshoot, find_rise, find_settling_time

Values = NDArray[np.float64]

HELD_BEFORE_S: Final = 0.5
HELD_AFTER_S: Final = 1.0
"""Time for which a command is held before and after a step [s]: five and ten time constants of 0.1
s, the usual value for small wheeled robots (a TurtleBot3: 0.07 to 0.09 s). This time is longer than
the 0.1 s between messages of a ramp."""

LEAST_STEP: Final = 0.1
"""Smallest step as a share of the run's largest command; noise hides smaller steps."""

_LONGEST_S: Final = 5.0
"""Longest time of a response that is evaluated [s]: later motion has another cause."""

_ANSWERED: Final = 0.5
"""Smallest share of a step that the robot must perform. A robot that performs less is blocked or
does not receive commands."""

_FEWEST: Final = 5
"""Smallest number of measured rates in the second after a step."""

_BAND: Final = 0.05
"""Smallest half-width of the settling band as a share of the response: odometry is noisier than the
2 % of a simulated loop."""

_WIDEST: Final = 0.2
"""Scatter as a share of the response above which settling and overshoot are not visible. Above
twice this share the rise is not visible either, because it is found by the first values beyond 10 %
and 90 %."""

_LONGEST_GAP_S: Final = 1.5 / _FEWEST
"""Longest time without a measured rate in the second after a step [s]: 1.5 times the usual time."""

_MARK: Final = 0.1
"""Largest quantisation step of a rate, as a share of the response, at which the rise is visible:
the rise begins at 10 %. For settling, the quantisation step must be within the band."""

_ROUNDING: Final = 1e-6
"""Share of a response below which two values are equal, because differences of positions are
rounded."""

_SCATTER: Final = 3.0
"""Width of the scatter at the end of a response, in standard deviations."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StepFigures:
    """Figures of a rate's response to one step of its command; None if an event is missing.

    Attributes:
        rise_time_s: Time from 10 % to 90 % of the response [s].
        settling_time_s: Time from the command until the rate stays in the band around its final
            value [s].
        overshoot: Overshoot beyond the final value, as a fraction of the response [1]; 0 within the
            band.
    """

    rise_time_s: float | None
    settling_time_s: float | None
    overshoot: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandStep:
    """A step of a command.

    Attributes:
        time_s: Publication time, from time zero of the run [s].
        end_s: End of the command's hold [s].
        before: Command before the step [m/s or rad/s].
        after: Command after the step [m/s or rad/s].
    """

    time_s: float
    end_s: float
    before: float
    after: float


def find_command_steps(commands: HeldCommands, begin_s: float, end_s: float) -> list[CommandStep]:
    """Return the steps of an axis between the first pose and the last pose or command, in order.

    The last command is held until the last message, because its true duration is unknown.
    """
    end_s = min(end_s, commands.end_s)
    starts_s = np.concatenate([[min(begin_s, commands.time_s[0])], commands.time_s])
    values = np.concatenate([[commands.before], commands.values])
    is_new = (np.abs(np.diff(values, prepend=np.inf)) > SAME) & (starts_s <= end_s)
    starts_s, values = starts_s[is_new], values[is_new]
    held_s = np.diff(np.append(starts_s, end_s))
    least = LEAST_STEP * float(np.abs(values).max(initial=0.0))
    is_step = (held_s[:-1] >= HELD_BEFORE_S - _GRAIN_S) & (held_s[1:] >= HELD_AFTER_S - _GRAIN_S)
    is_step &= (np.abs(np.diff(values)) >= max(least, SAME)) & (starts_s[1:] >= begin_s)
    return [
        CommandStep(
            time_s=float(starts_s[row + 1]),
            end_s=float(starts_s[row + 1] + held_s[row + 1]),
            before=float(values[row]),
            after=float(values[row + 1]),
        )
        for row in np.flatnonzero(is_step)
    ]


_GRAIN_S: Final = 1e-6
"""Rounding of times [s]: a command held for 499,999,999 ns is held for half a second."""


def measure_command_steps(
    rates: Rates, steps: list[CommandStep], band: float
) -> Iterator[StepFigures]:
    """Yield the response of the robot to each step that it answers."""
    for step in steps:
        found = _measure_step(rates, step, band)
        if found is not None:
            yield found


def _measure_step(rates: Rates, step: CommandStep, band: float) -> StepFigures | None:
    end_s = min(step.end_s, step.time_s + _LONGEST_S)
    time_s, values = rates.time_s, rates.values
    rows = slice(*np.searchsorted(time_s, [step.time_s, end_s]))
    earlier = slice(*np.searchsorted(time_s, [step.time_s - HELD_BEFORE_S / 2.0, step.time_s]))
    time_s, inside = time_s[rows], values[rows]
    settled = inside[np.searchsorted(time_s, end_s - (end_s - step.time_s) / 3.0) :]
    first_s = time_s[time_s <= step.time_s + HELD_AFTER_S]
    if len(settled) < 2 or np.diff(first_s, prepend=step.time_s).max(initial=0.0) > _LONGEST_GAP_S:
        return None
    initial = float(np.mean(values[earlier])) if earlier.stop > earlier.start else float(inside[0])
    final, scatter = float(np.mean(settled)), _SCATTER * float(np.std(settled))
    size = final - initial
    if size / (step.after - step.before) < _ANSWERED:
        return None
    # From the publication of the command on, when the robot has not reacted yet.
    time_s = np.concatenate([[step.time_s], time_s])
    inside = np.concatenate([[initial], inside])
    share, quantum = scatter / abs(size), _find_quantum(inside, initial, final) / abs(size)
    rise_begin_s, rise_end_s = find_rise(time_s, inside, initial, final)
    is_seen = share <= 2.0 * _WIDEST and quantum <= _MARK
    rise_s = None if math.isnan(rise_end_s) or not is_seen else rise_end_s - rise_begin_s
    if share > _WIDEST or quantum > max(band, _BAND):
        return StepFigures(rise_time_s=rise_s, settling_time_s=None, overshoot=None)
    band = max(band, _BAND, share)
    settled_s = find_settling_time(time_s, inside, initial, final, band)
    overshoot = find_overshoot(inside, initial, final)
    return StepFigures(
        rise_time_s=rise_s,
        settling_time_s=None if math.isnan(settled_s) else settled_s - float(time_s[0]),
        overshoot=overshoot if overshoot > band else 0.0,
    )


def _find_quantum(values: Values, initial: float, final: float) -> float:
    """Return the quantisation step of the levels that repeat in a response; 0 if no level repeats.

    A quantised value stays at a level for several samples and then steps to the next; a value that
    is only sampled never repeats.
    """
    low, high = sorted((initial, final))
    same = _ROUNDING * (high - low)
    between = np.sort(values[(values > low + same) & (values < high - same)])
    steps = np.diff(np.concatenate([[low], between, [high]]))
    levels = steps[steps > same]
    return float(levels.min(initial=high - low)) if len(levels) < len(steps) else 0.0


_NO_STEPS: Final = Missing(
    status=Status.NO_STEP,
    reason=f"no command is held for {HELD_AFTER_S:g} s after one that was for {HELD_BEFORE_S:g} s",
)
_NO_ANSWER: Final = Missing(
    status=Status.NOT_REACHED,
    reason="the robot does not do half of any step of its commands while it is held",
)
_NOT_SEEN: Final = Missing(
    status=Status.UNDETERMINED, reason="the measured rate scatters too far for the steps there are"
)


def _find_steps(context: RunContext, axis: Axis) -> list[CommandStep] | Missing:
    if not len(context.run.commands):
        return NO_COMMANDS
    commands = context.get_commands(axis)
    if commands is None:
        return ONE_POSE
    time_s = context.pose_time_s if len(context.pose_time_s) else context.command_time_s
    begin_s, end_s = float(time_s[0]), float(time_s[-1])
    return context.recall(("steps", axis), lambda: find_command_steps(commands, begin_s, end_s))


def _count_steps(axis: Axis) -> Callable[[RunContext], Result]:
    def count(context: RunContext) -> Result:
        steps = _find_steps(context, axis)
        return steps if isinstance(steps, Missing) else Found(float(len(steps)))

    return count


def _take_median(axis: Axis, name: str, factor: float = 1.0) -> Callable[[RunContext], Result]:
    """Return a metric that is the median of one figure over all answered steps."""

    def compute(context: RunContext) -> Result:
        steps, rates = _find_steps(context, axis), context.get_rates(axis)
        if isinstance(steps, Missing) or rates is None:
            return steps if isinstance(steps, Missing) else ONE_POSE
        if not steps:
            return _NO_STEPS
        period_s = compute_median(np.diff(rates.edges_s))
        if period_s * _FEWEST > HELD_AFTER_S:
            reason = f"poses at {1.0 / period_s:.3g} Hz, and it takes {_FEWEST} Hz"
            return Missing(status=Status.TOO_SHORT, reason=reason)
        band = context.settings.band
        figures = context.recall(
            ("answers", axis), lambda: list(measure_command_steps(rates, steps, band))
        )
        found = [getattr(one, name) for one in figures]
        known = [value for value in found if value is not None]
        if not known:
            return _NOT_SEEN if figures else _NO_ANSWER
        return Found(compute_median(np.array(known)) * factor)

    return compute


for _axis, _unit in (("speed", "m/s"), ("turn_rate", "rad/s")):
    _name: Axis = "speed" if _axis == "speed" else "turn_rate"
    _words = _axis.replace("_", " ")
    run_metric(
        f"run.{_axis}_steps",
        "1",
        f"Number of steps of the published {_words}: constant for 0.5 s before and 1 s after.",
        better=None,
        needs_poses=False,
    )(_count_steps(_name))
    run_metric(
        f"run.{_axis}_rise_time",
        "s",
        "Time from 10 % to 90 % of the answer to a step of the command; median of the steps.",
    )(_take_median(_name, "rise_time_s"))
    run_metric(
        f"run.{_axis}_settling_time",
        "s",
        "Time from the command until the measured rate stays within 5 % (or a wider `band`, or"
        " its scatter) of its final value; median of the steps.",
    )(_take_median(_name, "settling_time_s"))
    run_metric(
        f"run.{_axis}_overshoot",
        "%",
        "Furthest measured rate beyond its final value, as a share of the change; 0 within the"
        " band; median of the steps.",
        floor=0.0,
    )(_take_median(_name, "overshoot", 100.0))
