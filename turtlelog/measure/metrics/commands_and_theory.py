"""Metrics of the held commands of a loop, and of the deviation of its response from theory.

A command is held from one row to the next. `time_s` and `values` have shape (n,), n >= 1, times not
decreasing; the last value is held until `end_s`. Commands of a burst share one time: all but the
last have no duration. Such commands count for variation, jumps and reversals, but not for effort,
saturation and slew rate, which need durations.

All three theories describe an integrator under proportional feedback with the gain of the run and
without a limit on the command. Each leads from the response's own initial value to its reference:

- ideal: dy/dt = Kp (r - y), so y = r + (y0 - r) exp(-Kp t);
- sampled: the command is held for a period T: y[k+1] = y[k] + Kp T (r - y[k]);
- delayed: each pose is answered d samples late: y[k+1] = y[k] + Kp T (r - y[k-d]), at rest before.

Between samples, a sampled loop moves along a line, because the command is held. The deviation is
the measured value minus the theory, which is linearly interpolated at the times of the response.
"""

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from turtlelog.measure.metric import (
    FOUND,
    REASONS,
    Found,
    Missing,
    Outcome,
    Result,
    Status,
    add_reason,
)
from turtlelog.measure.metric_kinds import curve_metric, loop_metric, read_meaning
from turtlelog.measure.reductions import (
    Values,
    count_beyond,
    find_largest,
    subtract_neighbours,
    sum_products,
)
from turtlelog.measure.response import CommandStretch, Response
from turtlelog.measure.run_context import MOST_TICKS, RunContext
from turtlelog.measure.step_response import compute_rms

OfCommands = Callable[[CommandStretch], Result]

COMMAND_METRICS: Final[dict[str, OfCommands]] = {}
"""Functions of the commands of a loop, or of all commands of a run, by the name of the metric."""


def _command_metric(
    name: str, unit: str, meaning: str = "", **more: Any
) -> Callable[[OfCommands], OfCommands]:
    def enter(compute: OfCommands) -> OfCommands:
        def compute_of_loop(_: RunContext, response: Response) -> Result:
            return compute(response.commands)

        loop_metric(name, unit, meaning or read_meaning(compute), **more)(compute_of_loop)
        COMMAND_METRICS[name] = compute
        return compute

    return enter


_LIMIT_UNKNOWN: Final = add_reason(Status.ABSENT, "the recording does not hold the limit")
_NO_LIMIT: Final = REASONS[_LIMIT_UNKNOWN]
_NO_WANTED: Final = Missing(Status.ABSENT, "the recording does not hold the unclipped command")
_ONE_TIME: Final = Missing(Status.TOO_SHORT, "all commands share one time")


@_command_metric("effort", "{command}^2/s", grows=True)
def measure_effort(commands: CommandStretch) -> Result:
    """Integral of the square of the {command} over time.

    This is the energy of the input signal [unit^2 s], the input term of the linear-quadratic cost
    (B. D. O. Anderson and J. B. Moore, Optimal Control).
    """
    return Found(sum_products(commands.held_s, commands.values, commands.values))


@_command_metric("total_variation", "{command}/s", grows=True)
def measure_total_variation(commands: CommandStretch) -> Result:
    """Sum of the magnitudes of all changes of the {command}.

    The sum is the measure TV of S. Skogestad, "Simple analytic rules for model reduction and PID
    controller tuning", J. Process Control 13 (2003).
    """
    return Found(float(np.abs(subtract_neighbours(commands.values)).sum()))


@_command_metric("largest_jump", "{command}/s", grows=True)
def measure_largest_jump(commands: CommandStretch) -> Result:
    """Largest change of the {command} from one sample to the next.

    The time of the metric is that after the change.
    """
    if len(commands.values) < 2:
        return Found(0.0, float(commands.time_s[0]))
    changes = np.abs(subtract_neighbours(commands.values))
    row = int(changes.argmax())
    return Found(float(changes[row]), float(commands.time_s[row + 1]))


@_command_metric("largest_slew_rate", "{command}/s^2", grows=True)
def measure_largest_slew_rate(commands: CommandStretch) -> Result:
    """Largest change of the {command} per time; samples with the same time count as one sample.

    A change is divided by the time from the previous row. The time of the metric is that after it.
    """
    time_s, values = commands.time_s, commands.values
    step_s, rows = subtract_neighbours(time_s), np.arange(len(time_s))
    if not step_s.all():
        rows = np.append(np.flatnonzero(step_s), len(values) - 1)
        values, step_s = values[rows], subtract_neighbours(time_s[rows])
    if not len(step_s):
        return _ONE_TIME
    rates = np.abs(subtract_neighbours(values)) / step_s
    row = int(rates.argmax())
    return Found(float(rates[row]), float(time_s[rows[row + 1]]))


@_command_metric("reversals", "1", nature="count", grows=True)
def measure_reversals(commands: CommandStretch) -> Result:
    """Number of times that the {command} changes its sign.

    Zeros in between are ignored.
    """
    turning = commands.values[commands.values != 0.0] > 0.0
    return Found(float(np.count_nonzero(turning[1:] != turning[:-1])))


@_command_metric("largest_wanted", "{command}/s", "Largest {command} before clipping.", grows=True)
def _measure_largest_wanted(commands: CommandStretch) -> Result:
    wanted = commands.wanted
    if wanted is None:
        return _NO_WANTED
    row = int(np.abs(wanted).argmax())
    return Found(abs(float(wanted[row])), float(commands.time_s[row]))


@curve_metric("saturated_share", "1", nature="share", needs_whole=False)
def _measure_saturated_share(curve: Response) -> Outcome:
    """Share of the samples whose {command} is at its limit."""
    # The time of the metric is that of the first such sample.
    if math.isnan(curve.limit):
        return math.nan, math.nan, _LIMIT_UNKNOWN
    count, first = count_beyond(curve.commands.values, curve.limit)
    at_s = curve.commands.time_s[first] if count > 0 else math.nan
    return count / len(curve.commands.values), at_s, FOUND


@_command_metric("saturated_time_share", "1", nature="share", needs_whole=False)
def _measure_saturated_time_share(commands: CommandStretch) -> Result:
    """Share of the time during which the {command} is at its limit."""
    # The time of the metric is that of the first such sample.
    saturated = commands.is_saturated
    if saturated is None:
        return _NO_LIMIT
    held_s = commands.held_s
    length_s = float(held_s.sum())
    if length_s <= 0.0:
        return _ONE_TIME
    share = min(sum_products(held_s, saturated) / length_s, 1.0)
    first_s = float(commands.time_s[saturated.argmax()]) if saturated.any() else None
    return Found(share, first_s)


@_command_metric("longest_saturation", "s", grows=True)
def measure_longest_saturation(commands: CommandStretch) -> Result:
    """Longest time for which the {command} is at its limit without a break.

    The time of the metric is the beginning.
    """
    saturated = commands.is_saturated
    if saturated is None:
        return _NO_LIMIT
    edges = np.flatnonzero(np.diff(saturated, prepend=False, append=False))
    starts, ends = edges[::2], edges[1::2]
    if not len(starts):
        return Found(0.0)
    until_s = np.concatenate([[0.0], np.cumsum(commands.held_s)])
    lengths_s = until_s[ends] - until_s[starts]
    longest = int(lengths_s.argmax())
    return Found(float(lengths_s[longest]), float(commands.time_s[starts[longest]]))


_MOST_SAMPLES: Final = 20_000_000

_SAMPLES_AT_ONCE: Final = Missing(Status.TOO_SHORT, "the samples share one time")


@loop_metric(
    "dead_time",
    "s",
    "Time from reading a pose until its {command} moves the turtle, less the plant's smallest"
    " delay.",
    needs_dead_time=True,
    needs_whole=False,
)
def _compute_dead_time(context: RunContext, response: Response) -> Result:
    """See `dead_time.find_dead_time`. The value is ticks times the time between poses."""
    ticks = context.find_dead_time_ticks(response.loop)
    if isinstance(ticks, Missing):
        return ticks
    return _SAMPLES_AT_ONCE if context.tick_s is None else Found(ticks * context.tick_s)


def _deviate_by(theory: str, figure: str) -> Callable[[RunContext, Response], Result]:
    def compute(context: RunContext, response: Response) -> Result:
        found = context.recall(
            (theory, response.loop.name), lambda: _deviate(theory, context, response)
        )
        if isinstance(found, Missing):
            return found
        if figure == "rms":
            return Found(compute_rms(response.step_s, found, None))
        largest, row = find_largest(found)
        return Found(largest, response.start_s + float(response.time_s[row]))

    return compute


def _deviate(theory: str, context: RunContext, response: Response) -> Values | Missing:
    from turtlelog.theory import compute_step_response  # only `metrics --all` needs these
    from turtlelog.theory.sampled_loop import LARGEST_DEVIATION, interpolate_sampled_response

    kp = response.loop.read_gain(context.run.parameters)
    if kp is None:
        return Missing(Status.ABSENT, "the recording does not hold the gain")
    if theory == "ideal":
        return response.values - compute_step_response(
            kp, response.time_s, initial=response.initial, reference=response.reference
        )
    period_s = context.loop_period_s
    if period_s is None:
        return _SAMPLES_AT_ONCE
    dead_time = _find_dead_time_samples(theory, context, response, period_s)
    if isinstance(dead_time, Missing):
        return dead_time
    predicted = interpolate_sampled_response(
        kp,
        response.time_s,
        period_s=period_s,
        dead_time_ticks=dead_time,
        initial=response.initial,
        reference=response.reference,
    )
    if predicted is None:
        limit = f"beyond {LARGEST_DEVIATION:g} steps before the phase ends"
        return Missing(Status.TOO_LARGE, f"theory's loop is unstable: {limit}")
    return response.values - predicted


def _find_dead_time_samples(
    theory: str, context: RunContext, response: Response, period_s: float
) -> int | Missing:
    """Return the dead time of a theory in samples: 0, the setting, or found in the run."""
    if response.time_s[-1] / period_s > _MOST_SAMPLES:
        return Missing(Status.TOO_LARGE, "the sampling period is too short")
    if theory == "sampled":
        return 0
    asked = context.settings.dead_time_ticks
    if asked is not None:
        return asked
    ticks = context.find_dead_time_ticks(response.loop)
    if isinstance(ticks, Missing) or context.tick_s is None:
        return ticks if isinstance(ticks, Missing) else _SAMPLES_AT_ONCE
    return min(round(ticks * context.tick_s / period_s), MOST_TICKS)


for _theory, _described in (
    ("ideal", "the ideal loop"),
    ("sampled", "the ideal loop with sampling"),
    ("delayed", "the ideal loop with sampling and dead time"),
):
    for _figure, _start in (("max", "Largest deviation"), ("rms", "RMS deviation")):
        loop_metric(
            f"{_theory}_deviation_{_figure}",
            "{value}",
            f"{_start} of the {{signal}} from {_described}, at the same gain.",
            # The dead time of the third theory is estimated from all rows.
            grows=_figure == "max" and _theory != "delayed",
            needs_dead_time=_theory == "delayed",
            needs_whole=False,
            applies=lambda loop: loop.has_theory and not loop.moves,
        )(_deviate_by(_theory, _figure))
