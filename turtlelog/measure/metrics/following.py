"""Metrics of how closely a robot follows commands from any source, axis by axis.

Between two poses, the mean of the measured rate is compared with the mean of the held commands. A
time shift is therefore found to a fraction of a sample.
"""

from collections.abc import Callable
from typing import Final

import numpy as np

from turtlelog.measure.context import RunContext
from turtlelog.measure.metric import NO_COMMANDS, ONE_POSE, Found, Missing, Result, Status
from turtlelog.measure.metric_kinds import run_metric
from turtlelog.measure.outliers import compute_median
from turtlelog.measure.rates import SAME, Axis, HeldCommands, Rates, Values
from turtlelog.measure.reductions import sum_products

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

_STEADY: Final = Missing(
    status=Status.UNDETERMINED,
    reason="the commands do not change: nothing shows how late the robot follows",
)

_FINE_S: Final = 1e-5
_FINE_COUNT: Final = 9
"""Resolution of a lag [s], and number of shifts that are tried at a time."""


def _on_axis(
    axis: Axis, compute: Callable[[Rates, HeldCommands], Result]
) -> Callable[[RunContext], Result]:
    def compute_on_axis(context: RunContext) -> Result:
        if not len(context.run.commands):
            return NO_COMMANDS
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


_APART: Final = Missing(
    status=Status.TOO_SHORT, reason="no two poses between the first and the last command"
)


def _compute_rms(rates: Rates, commands: HeldCommands) -> Result:
    rows = _select(rates, commands)
    if rows is None:
        return _APART
    edges_s = rates.edges_s[rows.start : rows.stop + 1]
    step_s = np.diff(edges_s)
    off = rates.means[rows] - np.diff(commands.integrate(edges_s)) / step_s
    return Found(float(np.sqrt(sum_products(off, off, step_s) / step_s.sum())))


def _compute_lag(rates: Rates, commands: HeldCommands) -> Result:
    rows = _select(rates, commands)
    if rows is None:
        return _APART
    if rows.stop - rows.start < _FEWEST:
        reason = f"fewer than {_FEWEST} poses while it is commanded"
        return Missing(status=Status.TOO_SHORT, reason=reason)
    first_s = float(rates.edges_s[rows.start])
    if commands.before != commands.values[0]:
        # The rest before the first command shows when the robot starts.
        first_s -= LATEST_S
    first = int(np.searchsorted(rates.edges_s, first_s))
    rows = slice(first, min(rows.stop, first + _MOST_INTERVALS))
    edges_s = rates.edges_s[rows.start : rows.stop + 1]
    if not _has_change(commands, float(edges_s[0]), float(edges_s[-1])):
        return _STEADY
    return find_lag(edges_s, rates.means[rows], commands)


def _has_change(commands: HeldCommands, begin_s: float, end_s: float) -> bool:
    """Return whether the command changes with enough time before and after."""
    inside_s = np.array([begin_s + _INSIDE_S, end_s - _INSIDE_S])
    first, last = np.searchsorted(commands.time_s, inside_s, side="right")
    held = np.concatenate([[commands.before], commands.values])[first : last + 1]
    return len(held) > 0 and float(np.ptp(held)) > SAME


def find_lag(edges_s: Values, means: Values, commands: HeldCommands) -> Result:
    """Return the shift of the commands that fits the measured rates best [s], or why it is unknown.

    The best fit has the largest correlation, which is the least-squares fit of scaled and offset
    commands. For a first-order lag, the shift is the dead time plus ln 2 times the time constant:
    the time after which half of a step is done.
    """
    step_s = np.diff(edges_s)

    def correlate(shifts_s: Values) -> Values:
        asked = np.diff(commands.integrate(edges_s - shifts_s[:, None])) / step_s
        return _correlate(asked, means, step_s)

    usual_s = compute_median(step_s)
    count = int(np.ceil((LATEST_S - EARLIEST_S) / max(usual_s, 0.01))) + 1
    shifts_s = np.linspace(EARLIEST_S, LATEST_S, count)
    found = correlate(shifts_s)
    best = int(found.argmax())
    if not found[best] >= _FOLLOWS:
        reason = "the motion does not change as the commands do"
        if -float(found.min()) >= _FOLLOWS:
            reason = "the motion changes against the commands: the signs of one are reversed"
        return Missing(status=Status.UNDETERMINED, reason=reason)
    if best in {0, count - 1}:
        reason = f"no shift from {EARLIEST_S:g} to {LATEST_S:g} s fits best"
        return Missing(status=Status.UNDETERMINED, reason=reason)
    if _has_second(found, best):
        reason = "several shifts fit alike: the commands repeat themselves"
        return Missing(status=Status.UNDETERMINED, reason=reason)
    around_s = shifts_s[best - 1 : best + 2]
    while float(np.ptp(around_s)) > _FINE_S:
        around_s = np.linspace(around_s[0], around_s[-1], _FINE_COUNT)
        best = min(max(int(correlate(around_s).argmax()), 1), _FINE_COUNT - 2)
        around_s = around_s[best - 1 : best + 2]
    return Found(float(around_s[1]))


def _correlate(asked: Values, done: Values, step_s: Values) -> Values:
    """Return the correlation over time of rows with a column; 0 if either is constant."""
    weights = step_s / step_s.sum()
    asked, done = asked - (asked @ weights)[:, None], done - np.dot(weights, done)
    size = np.sqrt((asked * asked) @ weights * np.dot(weights, done * done))
    return np.asarray((asked @ (weights * done)) / np.where(size > 0.0, size, np.inf))


def _has_second(found: Values, best: int) -> bool:
    """Return whether a second, separate shift fits equally well."""
    for side in (found[best:], found[best::-1]):
        low = np.flatnonzero(side < _VALLEY * found[best])
        if len(low) and side[low[0] :].max() >= _ALIKE * found[best]:
            return True
    return False


for _axis, _unit in (("speed", "m/s"), ("turn_rate", "rad/s")):
    _name: Axis = "speed" if _axis == "speed" else "turn_rate"
    _words = _axis.replace("_", " ")
    run_metric(
        f"run.{_axis}_tracking_rms",
        _unit,
        f"Root of the mean square over time of measured minus published {_words}.",
    )(_on_axis(_name, _compute_rms))
    run_metric(
        f"run.{_axis}_lag",
        "s",
        f"Shift of the published {_words} in time that fits the measured one best.",
        floor=0.0,
    )(_on_axis(_name, _compute_lag))
