"""Metrics of how closely a robot follows commands from any source, axis by axis.

Between two poses, the mean of the measured rate is compared with the mean of the held commands. A
time shift is therefore found to a fraction of a sample.

Steps of the commands have a response. Before a step, a command is held long enough for the robot to
settle; after it, another command is held long enough for the response. Commands from a joystick or
a ramp change with every message and contain no steps. A response is judged by its own initial and
final values: a robot that drives at 0.9 times the commanded speed has no steady-state error here.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.measure.metric import ONE_POSE, Found, Missing, Result, Status
from turtlelog.measure.metric_kinds import run_metric
from turtlelog.measure.pose_noise import find_dither_step
from turtlelog.measure.rates import AXES, NEAR, SAME, Axis, HeldCommands, Rates
from turtlelog.measure.reductions import Values, compute_median, subtract_neighbours, sum_products
from turtlelog.measure.run_context import MeasureSettings, RunContext
from turtlelog.measure.signals import find_no_commands
from turtlelog.measure.step_response import (
    RISE_BEGIN,
    RISE_END,
    find_overshoot,
    find_rise,
    find_settling_time,
)
from turtlelog.run import Run

EARLIEST_S: Final = -0.5
LATEST_S: Final = 2.0
"""Largest lag that is searched [s]: nobody drives by hand a robot that answers two seconds late. If
a robot answers before its command, the clocks differ."""

_FEWEST: Final = 20
"""Smallest number of intervals between poses that shows a lag."""

_FOLLOWS: Final = 0.5
"""Correlation of shifted commands and measured rate from which the robot counts as following [1];
the commands then explain a quarter of its motion. For 100 unrelated values, 0.3 is reached once in
400 times."""

_ALIKE: Final = 0.95
_VALLEY: Final = 0.9
"""Shares of the best correlation that define a second fit: another shift has at least the first
share, and shifts in between fall below the second share. Then the commands repeat."""

_MOST_INTERVALS: Final = 20_000
"""Largest number of intervals in which the lag is searched: a quarter of an hour at 20 Hz."""

_INSIDE_S: Final = 0.5
"""Smallest distance of a change of command from the ends of the data [s], equal to the earliest
searched lag."""

_FINE_S: Final = 1e-5
_FINE_COUNT: Final = 9
"""Resolution of a lag [s], and number of shifts that are tried at a time."""


def _on_axis(
    axis: Axis, compute: Callable[[Rates, HeldCommands], Result]
) -> Callable[[RunContext], Result]:
    def compute_on_axis(context: RunContext) -> Result:
        if missing := find_no_commands(context.run, axis):
            return missing
        rates, commands = context.get_rates(axis), context.get_commands(axis)
        if rates is None or commands is None:
            return ONE_POSE
        return compute(rates, commands)

    return compute_on_axis


def _select(rates: Rates, commands: HeldCommands) -> slice | None:
    """Return the intervals between the first and the last command; None if there are none."""
    first = int(np.searchsorted(rates.edges_s, commands.time_s[0]))
    last = int(np.searchsorted(rates.edges_s, commands.end_s, side="right")) - 1
    return slice(first, last) if last > first else None


_APART: Final = Missing(Status.TOO_SHORT, "no two poses between the first and the last command")


def _compute_rms(rates: Rates, commands: HeldCommands) -> Result:
    rows = _select(rates, commands)
    if rows is None:
        return _APART
    edges_s = rates.edges_s[rows.start : rows.stop + 1]
    is_seen = rates.is_seen[rows] & commands.find_known(edges_s)
    if not is_seen.any():
        return _APART
    step_s = subtract_neighbours(edges_s)
    off = rates.means[rows] - subtract_neighbours(commands.integrate(edges_s)) / step_s
    off, step_s = off[is_seen], step_s[is_seen]
    return Found(float(np.sqrt(sum_products(off, off, step_s) / step_s.sum())))


def _compute_lag(rates: Rates, commands: HeldCommands) -> Result:
    rows = _select(rates, commands)
    if rows is None:
        return _APART
    if np.count_nonzero(rates.is_seen[rows]) < _FEWEST:
        return Missing(Status.TOO_SHORT, f"fewer than {_FEWEST} poses while it is commanded")
    first_s = float(rates.edges_s[rows.start])
    if commands.before != commands.values[0]:
        # The rest before the first command shows when the robot starts.
        first_s -= LATEST_S
    first = int(np.searchsorted(rates.edges_s, first_s))
    rows = slice(first, min(rows.stop, first + _MOST_INTERVALS))
    edges_s = rates.edges_s[rows.start : rows.stop + 1]
    if not _has_change(commands, float(edges_s[0]), float(edges_s[-1])):
        reason = "the commands do not change: nothing shows how late the robot follows"
        return Missing(Status.UNDETERMINED, reason)
    is_seen = rates.is_seen[rows] & commands.find_known(edges_s)
    if np.count_nonzero(is_seen) < _FEWEST:
        return Missing(Status.TOO_SHORT, "commands are silent for most of the time")
    return find_lag(edges_s, rates.means[rows], commands, is_seen)


def _has_change(commands: HeldCommands, begin_s: float, end_s: float) -> bool:
    inside_s = np.array([begin_s + _INSIDE_S, end_s - _INSIDE_S])
    first, last = np.searchsorted(commands.time_s, inside_s, side="right")
    held = np.concatenate([[commands.before], commands.values])[first : last + 1]
    return len(held) > 0 and float(np.ptp(held)) > SAME


def find_lag(
    edges_s: Values, means: Values, commands: HeldCommands, is_seen: NDArray[np.bool_]
) -> Result:
    """Return the shift of the commands that fits the measured rates best [s], or why it is unknown.

    The best fit has the largest correlation, which is the least-squares fit of scaled and offset
    commands. For a first-order lag, the shift is the dead time plus ln 2 times the time constant:
    the time after which half of a step is done.
    """
    step_s = subtract_neighbours(edges_s)
    weights = np.where(is_seen, step_s, 0.0)
    weights /= weights.sum()
    done = means - np.dot(weights, means)
    weighted, size = weights * done, np.dot(weights, done * done)

    def correlate(shifts_s: Values) -> Values:
        """Return the correlation over time for each shift; 0 if either rate is constant."""
        ways = commands.integrate(edges_s - shifts_s[:, None])
        asked = (ways[:, 1:] - ways[:, :-1]) / step_s
        asked -= (asked @ weights)[:, None]
        sizes = np.sqrt((asked * asked) @ weights * size)
        return np.asarray((asked @ weighted) / np.where(sizes > 0.0, sizes, np.inf))

    usual_s = compute_median(step_s)
    count = int(np.ceil((LATEST_S - EARLIEST_S) / max(usual_s, 0.01))) + 1
    shifts_s = np.linspace(EARLIEST_S, LATEST_S, count)
    found = correlate(shifts_s)
    best = int(found.argmax())
    if not found[best] >= _FOLLOWS:
        reason = "the motion does not change as the commands do"
        if -float(found.min()) >= _FOLLOWS:
            reason = "the motion changes against the commands: the signs of one are reversed"
        return Missing(Status.UNDETERMINED, reason)
    if best in {0, count - 1}:
        reason = f"no shift from {EARLIEST_S:g} to {LATEST_S:g} s fits best"
        return Missing(Status.UNDETERMINED, reason)
    if _has_second(found, best):
        reason = "several shifts fit alike: the commands repeat themselves"
        return Missing(Status.UNDETERMINED, reason)
    around_s = shifts_s[best - 1 : best + 2]
    while float(np.ptp(around_s)) > _FINE_S:
        around_s = np.linspace(around_s[0], around_s[-1], _FINE_COUNT)
        best = min(max(int(correlate(around_s).argmax()), 1), _FINE_COUNT - 2)
        around_s = around_s[best - 1 : best + 2]
    return Found(float(around_s[1]))


def _has_second(found: Values, best: int) -> bool:
    for side in (found[best:], found[best::-1]):
        low = np.flatnonzero(side < _VALLEY * found[best])
        if len(low) and side[low[0] :].max() >= _ALIKE * found[best]:
            return True
    return False


for _axis, _unit in AXES.items():
    _words = _axis.replace("_", " ")
    run_metric(
        f"run.{_axis}_tracking_rms",
        _unit,
        f"Root of the mean square of measured minus published {_words} over the time with poses.",
        axis=_axis,
    )(_on_axis(_axis, _compute_rms))
    run_metric(
        f"run.{_axis}_lag",
        "s",
        f"Shift of the published {_words} in time that fits the measured one best.",
        floor=_FINE_S,
        axis=_axis,
    )(_on_axis(_axis, _compute_lag))


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

_FEWEST_RATES: Final = 5
"""Smallest number of measured rates in the second after a step."""

_BAND: Final = 0.05
"""Smallest half-width of the settling band as a share of the response: odometry is noisier than the
2 % of a simulated loop."""

_WIDEST: Final = 0.2
"""Scatter as a share of the response above which settling and overshoot are not visible. Above
twice this share the rise is not visible either, because it is found by the first values beyond 10 %
and 90 %."""

_LONGEST_GAP_S: Final = 1.5 / _FEWEST_RATES
"""Longest time without a measured rate in the second after a step [s]: 1.5 times the usual time."""

_MARK: Final = RISE_BEGIN
"""Largest quantisation step of a rate, as a share of the response, at which the rise is visible:
the level at which the rise begins. For settling, the quantisation step must be within the band."""

_ROUNDING: Final = 1e-6
"""Share of a response below which two values are equal, because differences of positions are
rounded."""

_SCATTER: Final = 3.0
"""Width of the scatter at the beginning and end of a response, in standard deviations."""


StepFigures = dict[str, float | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandStep:
    """A step of a command [m/s or rad/s], from its publication to the end of its hold [s]."""

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
    held_s = subtract_neighbours(np.append(starts_s, end_s))
    least = LEAST_STEP * float(np.abs(values).max(initial=0.0))
    is_step = (held_s[:-1] >= HELD_BEFORE_S - _GRAIN_S) & (held_s[1:] >= HELD_AFTER_S - _GRAIN_S)
    is_step &= (np.abs(subtract_neighbours(values)) >= max(least, SAME)) & (starts_s[1:] >= begin_s)
    is_step &= ~np.isin(starts_s[1:], commands.silences_s[:, 0])  # the robot stops at another time
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


def _measure_step(
    rates: Rates, step: CommandStep, band: float, finest: float
) -> StepFigures | None:
    """Return the figures of a rate's response to one step of its command; None without a response.

    `finest` is the resolution of the rates [m/s or rad/s].

    The settling time counts from the command. The overshoot is a fraction of the response [1]; 0
    within the band.
    """
    end_s = min(step.end_s, step.time_s + _LONGEST_S)
    time_s, values = rates.time_s, rates.values
    rows = slice(*np.searchsorted(time_s, [step.time_s, end_s]))
    earlier = slice(*np.searchsorted(time_s, [step.time_s - HELD_BEFORE_S / 2.0, step.time_s]))
    time_s, inside = time_s[rows], values[rows]
    settled = inside[np.searchsorted(time_s, end_s - (end_s - step.time_s) / 3.0) :]
    first_s = time_s[time_s <= step.time_s + HELD_AFTER_S]
    if len(settled) < 2 or np.diff(first_s, prepend=step.time_s).max(initial=0.0) > _LONGEST_GAP_S:
        return None
    before = values[earlier] if earlier.stop > earlier.start else inside[:1]
    initial = float(np.mean(before))
    final, scatter = float(np.mean(settled)), _SCATTER * float(np.std(settled))
    size = final - initial
    if size / (step.after - step.before) < _ANSWERED:
        return None
    # From the publication of the command on, when the robot has not reacted yet.
    time_s = np.concatenate([[step.time_s], time_s])
    inside = np.concatenate([[initial], inside])
    share, quantum = scatter / abs(size), _find_quantum(inside, initial, final) / abs(size)
    rise_begin_s, rise_end_s = find_rise(time_s, inside, initial, final)
    most = 2.0 * _WIDEST * abs(size)
    is_seen = scatter <= most and _SCATTER * float(np.std(before)) <= most and quantum <= _MARK
    is_seen &= finest <= _MARK * abs(size)
    figures: StepFigures = dict.fromkeys(_FIGURES)
    if is_seen and not math.isnan(rise_end_s):
        figures["rise_time"] = rise_end_s - rise_begin_s
        # A motion that has not settled adds to the first, noise of the poses to the second.
        spread = float(np.std(settled)), float(np.std(np.diff(settled))) / math.sqrt(2.0)
        noise = min(spread) / abs(size)
        until_s = end_s - (end_s - step.time_s) / 6.0 - rise_begin_s
        figures["rise_shortfall"] = _estimate_shortfall(rise_end_s - rise_begin_s, until_s, noise)
    if share > _WIDEST or quantum > max(band, _BAND):
        return figures
    band = max(band, _BAND, share)
    settled_s = find_settling_time(time_s, inside, initial, final, band)
    if not math.isnan(settled_s):
        figures["settling_time"] = settled_s - float(time_s[0])
    overshoot = find_overshoot(inside, initial, final)
    figures["overshoot"] = overshoot if overshoot > band else 0.0
    return figures


_FIGURES: Final = ("rise_time", "settling_time", "overshoot", "rise_shortfall")

_ROUNDS: Final = 5


def _estimate_shortfall(rise_s: float, until_s: float, noise: float) -> float:
    """Return by how much a rise time is too small [s], for the response of a first-order lag.

    The final value is that after `until_s`, when the robot may not have settled, and noise (a share
    of the response) goes beyond 90 % too early.
    """
    ratio = math.log(9.0)
    for _ in range(_ROUNDS):
        done = 1.0 - math.exp(-until_s * ratio / max(rise_s, 1e-9))
        end = RISE_END * done - noise
        ratio = math.log((1.0 - RISE_BEGIN * done) / (1.0 - max(end, 0.5)))
    return max(rise_s * (math.log(9.0) / ratio - 1.0), 0.0)


def _find_quantum(values: Values, initial: float, final: float) -> float:
    """Return the quantisation step of the levels that repeat in a response; 0 if no level repeats.

    A quantised value stays at a level for several samples and then steps to the next; a value that
    is only sampled never repeats.
    """
    low, high = sorted((initial, final))
    same = _ROUNDING * (high - low)
    between = np.sort(values[(values > low + same) & (values < high - same)])
    steps = subtract_neighbours(np.concatenate([[low], between, [high]]))
    levels = steps[steps > same]
    return float(levels.min(initial=high - low)) if len(levels) < len(steps) else 0.0


_NO_ANSWER: Final = Missing(
    Status.NOT_REACHED, "the robot does not do half of any step of its commands while it is held"
)
_NOT_SEEN: Final = Missing(
    Status.UNDETERMINED,
    "the measured rate scatters too far, or is too coarse, for the steps there are",
)


def _find_steps(context: RunContext, axis: Axis) -> list[CommandStep] | Missing:
    if missing := find_no_commands(context.run, axis):
        return missing
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


def _find_rate_resolution(context: RunContext, axis: Axis, rates: Rates) -> float:
    """Return the resolution of a robot's rates [m/s or rad/s]; 0 for a simulation."""
    poses = context.run.poses
    if poses.speed_m_s is not None:
        return 0.0
    reported = poses.measured_speed_m_s if axis == "speed" else poses.measured_turn_rate_rad_s
    if reported is not None:
        return find_dither_step(reported)
    from turtlelog.measure.pose_noise import find_pose_resolution  # simulations need none of it

    finest = find_pose_resolution(context.run)[axis == "turn_rate"]
    return finest / compute_median(subtract_neighbours(rates.edges_s))


def _find_answers(
    context: RunContext, axis: Axis, rates: Rates, steps: list[CommandStep]
) -> list[StepFigures]:
    """Return the figures of all steps that the robot answers."""

    def answer() -> list[StepFigures]:
        band, finest = context.settings.band, _find_rate_resolution(context, axis, rates)
        answers = (_measure_step(rates, step, band, finest) for step in steps)
        return [one for one in answers if one is not None]

    return context.recall(("answers", axis), answer)


def find_rise_shortfall(run: Run, axis: Axis) -> float:
    """Return by how much the rise time of an axis, which has one, is probably too small [s]."""
    context = RunContext(run, MeasureSettings())
    steps, rates = _find_steps(context, axis), context.get_rates(axis)
    if isinstance(steps, Missing) or rates is None:
        return 0.0
    figures = _find_answers(context, axis, rates, steps)
    known = [value for one in figures if (value := one["rise_shortfall"]) is not None]
    return compute_median(np.array(known)) if known else 0.0


def _take_median(axis: Axis, name: str, factor: float = 1.0) -> Callable[[RunContext], Result]:
    def compute(context: RunContext) -> Result:
        steps, rates = _find_steps(context, axis), context.get_rates(axis)
        if isinstance(steps, Missing) or rates is None:
            return steps if isinstance(steps, Missing) else ONE_POSE
        if not steps:
            held = f"no command is held for {HELD_AFTER_S:g} s"
            return Missing(Status.NO_STEP, f"{held} after one that was for {HELD_BEFORE_S:g} s")
        period_s = compute_median(subtract_neighbours(rates.edges_s))
        if period_s * _FEWEST_RATES > NEAR * HELD_AFTER_S:
            reason = f"poses at {1.0 / period_s:.3g} Hz, and it takes {_FEWEST_RATES} Hz"
            return Missing(Status.TOO_SHORT, reason)
        figures = _find_answers(context, axis, rates, steps)
        known = [value for one in figures if (value := one[name]) is not None]
        if not known:
            return _NOT_SEEN if figures else _NO_ANSWER
        return Found(compute_median(np.array(known)) * factor)

    return compute


for _axis, _unit in AXES.items():
    _words = _axis.replace("_", " ")
    run_metric(
        f"run.{_axis}_steps",
        "1",
        f"Number of steps of the published {_words}: constant for 0.5 s before and 1 s after.",
        better=None,
        nature="count",
        axis=_axis,
        needs_poses=False,
    )(_count_steps(_axis))
    run_metric(
        f"run.{_axis}_rise_time",
        "s",
        "Time from 10 % to 90 % of the answer to a step of the command; median of the steps.",
        axis=_axis,
    )(_take_median(_axis, "rise_time"))
    run_metric(
        f"run.{_axis}_settling_time",
        "s",
        "Time from the command until the measured rate stays within 5 % (or a wider `band`, or"
        " its scatter) of its final value; median of the steps.",
        axis=_axis,
    )(_take_median(_axis, "settling_time"))
    run_metric(
        f"run.{_axis}_overshoot",
        "%",
        "Furthest measured rate beyond its final value, as a share of the change; 0 within the"
        " band; median of the steps.",
        floor=0.0,
        axis=_axis,
    )(_take_median(_axis, "overshoot", 100.0))
