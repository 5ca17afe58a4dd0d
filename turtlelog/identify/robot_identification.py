"""Identification of a robot's dynamics from commands and motion; for turtlesim tick by tick.

A second estimate uses no model: the delay with the largest correlation of commands and motion. A
flat correlation gives no single delay. Therefore the result is a range: the delays that explain the
motion as well as the best delay, within the differences between parts of the log.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlelog.display import describe_count
from turtlelog.errors import IdentifyError, ReplayError
from turtlelog.identify import refused_axes
from turtlelog.identify.axis_fit import NORMAL_95, AxisFit, NoGainError, count_steps, fit_axis
from turtlelog.identify.axis_model import AxisModel, Estimate, has_sure_wheels
from turtlelog.identify.axis_motion import (
    AXES,
    MEMORY_S,
    NAMES,
    Axis,
    AxisMotion,
    find_repetition,
    get_commands,
    read_axis_motion,
)
from turtlelog.identify.fit_values import cover_parts, cover_rivals, describe_fit
from turtlelog.identify.held_response import Values
from turtlelog.identify.robot_model import (
    RobotEvent,
    RobotModel,
    TickDelays,
    list_open_questions,
    list_unit_faults,
)
from turtlelog.identify.structure_choice import choose_structure
from turtlelog.measure.pose_quality import describe_sideways, find_travel_direction
from turtlelog.plants import TURTLESIM, find_plant
from turtlelog.plants.turtlesim import TICK_S
from turtlelog.replay.breaks_and_commands import (
    find_breaks,
    follow_commands,
    place_commands,
    read_motion,
)
from turtlelog.run import Run, list_runs

_DIFFERENT: Final = 3.0
"""Standard deviations by which two runs must differ: by chance in 0.3 % of pairs."""


MOST_STEPS: Final = 100_000
"""Largest number of steps of each axis that are used: half an hour at 50 Hz, in about 5 s. Of a
longer log, the first part of each run is used, because the robot may change over a longer time."""


def identify_robot(runs: Run | Iterable[Run]) -> RobotModel:
    """Return gain, dead time and time constant of each axis of a robot, with 95 % intervals.

    The steps between poses are compared with the closed-form response to the commands under
    zero-order hold; no pose is resampled. Several runs of one robot are fitted together, and the
    notes name differences between them. For turtlesim, each pose shows the command that its tick
    used, and nothing is fitted.

    Raises:
        IdentifyError: If there is no run, or a run has no poses.
    """
    runs = list_runs(runs)
    if not runs:
        raise IdentifyError("runs: must not be empty")
    for run in runs:
        if not len(run.poses):
            raise IdentifyError(f"{run.name}: the recording holds no poses, only commands")
    files = tuple(run.name for run in runs)
    exact = _identify_ticks(runs)
    if exact is not None:
        return exact
    pairs = [_identify_axis(runs, axis) for axis in AXES]
    for row, other in enumerate(pairs[::-1]):
        if refused_axes.contradicts_wheels(runs, pairs[row][0], other[0]):
            pairs[row] = _identify_axis(runs, AXES[row], tries_wheels=False)
    (speed, speed_events), (turn_rate, turn_events) = pairs
    doubt = refused_axes.doubt_waiting
    models = doubt(runs, speed, turn_rate), doubt(runs, turn_rate, speed)
    notes = list_unit_faults(models)
    notes += [doubt for model in models for doubt in model.doubts]
    notes += [
        f"{run.name} is {sideways}. Only the motion ahead or back is identified."
        for run in runs
        if (sideways := describe_sideways(run))
    ]
    notes += [text for model in models for text in _compare_runs(runs, model)]
    notes += list_open_questions(runs, models)
    notes += [
        f"The {NAMES[model.axis]} stops by itself where no command comes,"
        f" {describe_count(len(waits_s), 'time')}: it is down to half {min(waits_s):.2f} to"
        f" {max(waits_s):.2f} s after the last command."
        for model in models
        if (waits_s := model.silent_stops_s)
    ]
    notes += [
        f"The {NAMES[model.axis]} is identified from the first {model.steps} of"
        f" {model.steps_in_all} steps between poses."
        for model in models
        if model.steps < model.steps_in_all
    ]
    notes += [
        f"In {run.name}, {found.describe()}. No sideways speed is commanded, so the heading is"
        " taken as measured at this angle, and the speed is that in the direction of travel."
        for run in runs
        if models[0].is_known and (found := find_travel_direction(run)) is not None
    ]
    told = zip(models, (speed_events, turn_events), strict=True)
    return RobotModel(
        files=files,
        clock=runs[0].clock,
        speed=models[0],
        turn_rate=models[1],
        events=tuple(event for model, events in told if model.is_known for event in events),
        notes=tuple(notes),
    )


def _identify_axis(
    runs: Sequence[Run], axis: Axis, *, tries_wheels: bool = True
) -> tuple[AxisModel, list[RobotEvent]]:
    motions = [read_axis_motion(run, axis) for run in runs]
    steps = count_steps(motions)
    refused = refused_axes.refuse_commands(runs, axis)
    refused = refused or refused_axes.refuse_begun(runs, motions, axis)
    refused = refused or refused_axes.refuse_implausible(runs, motions, axis)
    refused = refused or refused_axes.refuse_few_steps(runs, axis, steps)
    if refused is not None:
        return refused, []
    if steps > MOST_STEPS:
        share = MOST_STEPS / steps
        motions = [motion.take(slice(int(share * len(motion.moved)))) for motion in motions]
    try:
        fit = fit_axis(motions)
    except NoGainError as err:
        opposite = refused_axes.refuse_opposite(axis, motions, None)
        return opposite or refused_axes.refuse_axis(axis, "no_gain", error=err), []
    fit, rivals = choose_structure(fit, tries_wheels=tries_wheels)
    columns = [np.diff(get_commands(run, axis), prepend=0.0) for run in runs]
    changes = sum(int(np.count_nonzero(column)) for column in columns)
    found = cover_rivals(
        describe_fit(axis, fit, changes),
        fit.model.structure,
        [(rival.model.structure, describe_fit(axis, rival, changes)) for rival in rivals],
    )
    found = cover_parts(found, fit)
    if not has_sure_wheels(found):
        return _identify_axis(runs, axis, tries_wheels=False)
    refused = refused_axes.refuse_fit(axis, motions, fit, found)
    refused = refused or refused_axes.refuse_forward(runs, found)
    if refused is not None:
        return refused, []
    names = [run.name for run, motion in zip(runs, motions, strict=True) if len(motion.moved)]
    correlation_delay_s, correlation_reason = find_correlation_delay(motions)
    waits_s = [stop.stop_s - stop.begin_s for motion in motions for stop in motion.seen_stops]
    found = replace(
        found,
        correlation_delay_s=correlation_delay_s,
        correlation_reason=correlation_reason,
        steps_in_all=steps,
        silent_stops_s=tuple(waits_s),
    )
    return found, _list_events(names, axis, fit)


_TOLD: Final = 1e-3
"""Smallest outlier that is told, as a share of the largest step. Without noise, rounding and the
time of a command make outliers far below it."""


def _list_events(names: Sequence[str], axis: Axis, fit: AxisFit) -> list[RobotEvent]:
    events, begin = [], 0
    for name, motion in zip(names, fit.model.motions, strict=True):
        end = begin + len(motion.moved)
        least = _TOLD * float(np.abs(motion.moved).max(initial=0.0))
        for step in np.flatnonzero(fit.is_outlier[begin:end]).tolist():
            time_s = float(motion.time_s[motion.first[step] + 1])
            size = float(fit.residual[begin + step])
            if abs(size) < least:
                continue
            what, unit = ("way", "m") if axis == "speed" else ("turn", "rad")
            told = (
                f"{name}: the {what} from the pose before to the one at {time_s:.3f} s is off by"
                f" {size:.3g} {unit}"
            )
            events.append(RobotEvent(file=name, axis=axis, time_s=time_s, size=size, text=told))
        begin = end
    return events


def _compare_runs(runs: Sequence[Run], together: AxisModel) -> list[str]:
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
    for field in ("gain", "dead_time_s", "lag_s", "total_delay_s", "drift"):
        one, other = getattr(alone, field), getattr(together, field)
        if one is None or other is None:
            continue
        # The interval of all runs may be wider because of their differences, but never less
        # certain.
        half = one.high - one.value
        error = float(np.hypot(half, min(half, other.high - other.value))) / NORMAL_95
        if abs(one.value - other.value) > _DIFFERENT * error:
            what = field.removesuffix("_s").replace("_", " ")
            told.append(f"{what} {_tell(one)} instead of {_tell(other)}")
    if not told:
        return []
    return [f"{name} differs from all runs together in the {NAMES[alone.axis]}: {', '.join(told)}."]


def _tell(value: Estimate) -> str:
    unit = "" if value.unit == "1" else f" {value.unit}"
    return f"{value.value:.3g} ({value.low:.3g} to {value.high:.3g}){unit}"


_COARSE_S, _FINE_S = 0.05, 0.005
"""Distances of tried delays [s]: first over the whole range, then near the best delay and the
ends."""

_MOST_STEPS: Final = 20_000

_PART_S: Final = 1.0
"""Length of parts of the log that count as independent [s]: a usual time constant has faded."""

_FEWEST_PARTS: Final = 8  # smallest number of parts whose scatter is meaningful
_CHANCE: Final = 0.05  # probability that the range does not contain the true best delay

_NEAR: Final = 0.6
"""Factor of Student's t from which a delay is worse than the best. The excess residual grows with
the square of the distance, its scatter with the distance. Therefore half of t is sufficient near
the best delay. The rest is for distant delays: 96.9 % of 391 ranges contained the truth."""


def find_correlation_delay(motions: Sequence[AxisMotion]) -> tuple[Estimate | None, str]:
    """Return the delay of the motion after the commands, as the best value and a range [s].

    Commands are averaged over each step between poses, so that nothing is resampled.

    Returns:
        The delay and an empty text. If the correlation shows no delay, None and a sentence with the
        reason.
    """
    motions = [motion for motion in motions if len(motion.moved)]
    most = _MOST_STEPS // max(len(motions), 1)
    misfit = _Misfit([motion.take(slice(most)) for motion in motions])
    if misfit.parts < _FEWEST_PARTS:
        return None, (
            "the log is too short for a correlation of commands and motion, which needs"
            f" {_FEWEST_PARTS * _PART_S:g} s of motion"
        )
    if repetition := find_repetition(motions):
        shift_s, sign = repetition
        # Commands that repeat with opposite sign repeat equally after twice that time.
        period_s = shift_s if sign > 0 else 2.0 * shift_s
        return None, (
            f"the correlation of commands and motion says nothing: the commands repeat every"
            f" {period_s:.3g} s, and delays so far apart correlate alike"
        )
    coarse = np.arange(0.0, MEMORY_S, _COARSE_S)
    near_s = float(coarse[np.argmin([misfit.measure(delay_s) for delay_s in coarse.tolist()])])
    fine = np.arange(max(near_s - _COARSE_S, 0.0), near_s + _COARSE_S, _FINE_S)
    best_s = float(fine[np.argmin([misfit.measure(delay_s) for delay_s in fine.tolist()])])
    if not misfit.is_worse(None, best_s):
        return None, "commands and motion do not clearly correlate"
    alike = [
        delay_s for delay_s in (*coarse.tolist(), best_s) if not misfit.is_worse(delay_s, best_s)
    ]
    low_s, high_s = (
        _find_end(lambda delay_s: misfit.is_worse(delay_s, best_s), end_s, step_s)
        for end_s, step_s in ((min(alike), -_FINE_S), (max(alike), _FINE_S))
    )
    usual_s = float(np.median(misfit.duration_s))
    if high_s - low_s > max(best_s, usual_s):
        return None, (
            "the correlation of commands and motion says nothing: it does not tell delays from"
            f" {1e3 * low_s:.0f} to {1e3 * high_s:.0f} ms apart"
        )
    return Estimate(value=best_s, low=low_s, high=high_s), ""


def _find_end(is_worse: Callable[[float], bool], begin_s: float, step_s: float) -> float:
    end_s = begin_s
    while 0.0 < end_s < MEMORY_S and abs(end_s - begin_s) < _COARSE_S:
        end_s += step_s
        if is_worse(end_s):
            break
    return max(end_s, 0.0)


class _Misfit:
    """Residual of the steps' rates for delayed commands, each with the best gain and offset.

    The residual is smallest at the delay with the largest correlation.
    """

    def __init__(self, motions: Sequence[AxisMotion]) -> None:
        self._motions = motions
        self.duration_s = np.concatenate([motion.duration_s for motion in motions])
        rate = np.concatenate([motion.moved for motion in motions]) / self.duration_s
        # Clipped, so that a single jump does not decide.
        rate = np.clip(rate, *np.quantile(rate, [0.01, 0.99]))
        self._rate = rate - rate.mean()
        counts = [int(motion.duration_s.sum() / _PART_S) for motion in motions]
        first = np.cumsum([0, *counts])
        # The rest at the end of a run belongs to its last part.
        parts = [
            begin + np.minimum(np.cumsum(motion.duration_s) // _PART_S, max(count, 1) - 1)
            for begin, count, motion in zip(first.tolist(), counts, motions, strict=False)
        ]
        self._part = np.unique(np.concatenate(parts), return_inverse=True)[1]
        self.parts = sum(counts)
        self._squares: dict[float, Values] = {}

    def measure(self, delay_s: float) -> float:
        """Return the residual sum of squares for a delay."""
        return float(self._list_squares(delay_s).sum())

    def is_worse(self, delay_s: float | None, best_s: float) -> bool:
        """Return whether a delay is significantly worse; None stands for no commands.

        The excess is summed over parts of the log, whose scatter shows its uncertainty.
        """
        more = self._list_squares(delay_s) - self._list_squares(best_s)
        sums = np.bincount(self._part, weights=more)
        error = float(np.std(sums, ddof=1)) * float(np.sqrt(len(sums)))
        most = float(scipy.special.stdtrit(len(sums) - 1, 1.0 - 0.5 * _CHANCE))
        return float(sums.sum()) > _NEAR * most * error

    def _list_squares(self, delay_s: float | None) -> Values:
        if delay_s is None:
            return np.asarray(self._rate**2)
        if delay_s in self._squares:
            return self._squares[delay_s]
        ways = []
        for motion in self._motions:
            way = motion.commands.place(motion.time_s - delay_s).way
            ways.append(way[motion.first + 1] - way[motion.first])
        asked = np.concatenate(ways) / self.duration_s
        asked -= asked.mean()
        size, along = float(asked @ asked), float(asked @ self._rate)
        # A motion against the commands is not a correlation.
        gain = along / size if size > 0.0 and along > 0.0 else 0.0
        self._squares[delay_s] = (self._rate - gain * asked) ** 2
        return self._squares[delay_s]


_MOST_UNEXPLAINED: Final = 0.05
"""Largest share of moving ticks without an explaining command. Above this share, poses or commands
are not turtlesim's. A recorder that starts late misses only the first command."""

_Shown = tuple[NDArray[np.int64], Values]
"""Rows of the commands of a run that poses show, in order, and the time from each command to the
first pose that shows it [s]."""


def _identify_ticks(runs: Sequence[Run]) -> RobotModel | None:
    """Return the delay of each command in turtlesim; None for other robots or without commands."""
    found = [_list_delays(run) for run in runs]
    known = [shown for shown in found if shown is not None]
    if len(known) < len(runs):
        return None
    delays_s = np.concatenate([delays_s for _, delays_s in known])
    if not len(delays_s):
        return None
    delays = TickDelays(
        shown=len(delays_s),
        commands=sum(len(run.commands) for run in runs),
        least_s=float(delays_s.min()),
        median_s=float(np.median(delays_s)),
        largest_s=float(delays_s.max()),
    )
    return RobotModel(
        files=tuple(run.name for run in runs),
        clock=runs[0].clock,
        speed=_describe(runs, "speed", known),
        turn_rate=_describe(runs, "turn_rate", known),
        tick_delays=delays,
        notes=(
            "Exact: turtlesim moves by the command of a tick, whole and at once. The dead time is"
            " from the time of a command to the beginning of the tick that moves by it; the pose at"
            f" its end, {1e3 * TICK_S:.0f} ms later, shows it. The value is the median of the"
            " commands that change the axis.",
        ),
    )


def _list_delays(run: Run) -> _Shown | None:
    """Return the commands visible in poses, with their delays; None if ticks are unknown."""
    if find_plant(run) != TURTLESIM:
        return None
    try:
        motion = read_motion(run)
    except ReplayError:
        return None
    starts = find_breaks(motion)[2]
    *_, use = place_commands(motion, run, frozenset(starts))
    moving = np.count_nonzero((motion.speed_m_s != 0.0) | (motion.turn_rate_rad_s != 0.0))
    if use.unexplained_ticks > _MOST_UNEXPLAINED * moving:
        return None
    commands, poses = follow_commands(run).T
    delays_s = (motion.time_ns[poses] - run.commands.time_ns[commands]) / 1e9
    return commands, np.asarray(delays_s)


def _describe(runs: Sequence[Run], axis: Axis, shown: Sequence[_Shown]) -> AxisModel:
    dead_times = []
    for run, (commands, delays_s) in zip(runs, shown, strict=True):
        changes = np.diff(get_commands(run, axis)[commands], prepend=0.0) != 0.0
        # A real turtlesim takes a command at the end of a tick, and uses it for the whole tick.
        dead_times.append(np.maximum(delays_s[changes] - TICK_S, 0.0))
    dead_times_s = np.concatenate(dead_times)
    if not len(dead_times_s):
        is_driven = any(get_commands(run, axis).any() for run in runs)
        return refused_axes.refuse_axis(axis, "hidden" if is_driven else "never_commanded")
    poses = sum(len(run.poses) for run in runs)
    delay = Estimate(
        value=float(np.median(dead_times_s)),
        low=float(dead_times_s.min()),
        high=float(dead_times_s.max()),
    )
    return AxisModel(
        axis=axis,
        status="ok",
        gain=Estimate(value=1.0, low=1.0, high=1.0, unit="1"),
        dead_time_s=delay,
        lag_s=Estimate(value=0.0, low=0.0, high=0.0),
        total_delay_s=delay,
        steps=poses,
        steps_in_all=poses,
        changes=sum(int(np.count_nonzero(np.diff(get_commands(run, axis)))) for run in runs),
    )
