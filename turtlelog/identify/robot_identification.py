"""Identification of a robot's dynamics from commands and motion; for turtlesim tick by tick."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import describe_count
from turtlelog.errors import IdentifyError, ReplayError
from turtlelog.identify import refused_axes
from turtlelog.identify.axis_fit import NORMAL_95, AxisFit, NoGainError, fit_axis
from turtlelog.identify.axis_motion import (
    AXES,
    NAMES,
    OTHER,
    UNITS,
    Axis,
    count_steps,
    find_rests,
    get_commands,
    read_axis_motion,
)
from turtlelog.identify.fit_values import cover_parts, cover_rivals, cover_waiting, describe_fit
from turtlelog.identify.held_response import Values
from turtlelog.identify.robot_model import AxisModel, Estimate, RobotEvent, RobotModel, TickDelays
from turtlelog.identify.structure_choice import LEAST_BELOW, RESTED_S, choose_structure
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

_ALIKE: Final = 0.05
"""Largest relative difference of commands of equal size. A smaller difference does not show whether
the gain varies."""

_MOSTLY: Final = 0.95
"""Share of an axis's commands beside one command of the other axis, above which no commands are
left to compare: less than a twentieth of the commands gives no interval of its own."""

_JOINTLY: Final = 0.9
"""Share of the changes of an axis together with the other axis, above which its delay alone is
unknown: one change in ten does not outweigh the others."""

_FEWEST_STEPS: Final = 50
"""Smallest number of steps that shows the noise: a second and a half at 30 Hz."""

_SPARSE_S: Final = 20.0 / _FEWEST_STEPS
"""Usual time between poses above which the suggested drive, ten times 2 s, has too few steps
[s]."""

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
    (speed, speed_events), (turn_rate, turn_events) = (_identify_axis(runs, axis) for axis in AXES)
    models = _doubt_waiting(runs, speed, turn_rate), _doubt_waiting(runs, turn_rate, speed)
    notes = [doubt for model in models for doubt in model.doubts]
    notes += [
        f"{run.name} is {sideways}. Only the motion ahead or back is identified."
        for run in runs
        if (sideways := describe_sideways(run))
    ]
    for note in (_compare_runs, _note_one_size, _note_one_beside, _note_backward, _note_drift):
        notes += [text for model in models for text in note(runs, model)]
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
    notes += _note_travel(runs, models[0])
    pairs = zip(models, (speed_events, turn_events), strict=True)
    return RobotModel(
        files=files,
        clock=runs[0].clock,
        speed=models[0],
        turn_rate=models[1],
        events=tuple(event for model, events in pairs if model.is_known for event in events),
        notes=tuple(notes),
    )


def _note_travel(runs: Sequence[Run], speed: AxisModel) -> Iterator[str]:
    """Yield notes on runs whose speed is measured at an angle to the heading."""
    for run in runs if speed.is_known else ():
        if (found := find_travel_direction(run)) is not None:
            yield (
                f"In {run.name}, {found.describe()}. No sideways speed is commanded, so the heading"
                " is taken as measured at this angle, and the speed is that in the direction of"
                " travel."
            )


def _identify_axis(runs: Sequence[Run], axis: Axis) -> tuple[AxisModel, list[RobotEvent]]:
    reason = refused_axes.find_no_excitation(runs, axis)
    motions = [read_axis_motion(run, axis) for run in runs]
    steps, sparse = count_steps(motions), ""
    reason = reason or refused_axes.find_absurd(runs, motions, axis)
    if steps > MOST_STEPS:
        share = MOST_STEPS / steps
        motions = [motion.take(slice(int(share * len(motion.moved)))) for motion in motions]
    if not reason and steps < _FEWEST_STEPS:
        reason = (
            f"expected at least {_FEWEST_STEPS} steps between poses at most 1 s apart while"
            f" commands act, found {steps}"
        )
        if all(_find_usual_step(run) > _SPARSE_S for run in runs):
            sparse = f"record poses at most {_SPARSE_S:g} s apart"
    if reason:
        unknown = refused_axes.refuse_axis(axis, reason)
        return replace(unknown, advice=", and ".join(filter(None, (sparse, unknown.advice)))), []
    try:
        fit = fit_axis(motions)
    except NoGainError as err:
        opposite = refused_axes.find_opposite(axis, motions, None)
        return opposite or refused_axes.refuse_axis(axis, str(err)), []
    fit, rivals = choose_structure(fit)
    columns = [np.diff(get_commands(run, axis), prepend=0.0) for run in runs]
    changes = sum(int(np.count_nonzero(column)) for column in columns)
    found = cover_rivals(
        describe_fit(axis, fit, changes),
        fit.model.structure,
        [(rival.model.structure, describe_fit(axis, rival, changes)) for rival in rivals],
    )
    found = cover_parts(found, fit)
    refused = refused_axes.refuse_fit(axis, motions, fit, found)
    if refused is None and not _shows_gain(runs, found, 1.0):
        refused = _refuse_forward(runs, found)
    if refused is not None:
        return refused, []
    names = [run.name for run, motion in zip(runs, motions, strict=True) if len(motion.moved)]
    correlation_delay_s, correlation_reason = refused_axes.find_correlation_delay(motions)
    waits_s = [stop.stop_s - stop.begin_s for motion in motions for stop in motion.stops]
    found = replace(
        found,
        correlation_delay_s=correlation_delay_s,
        correlation_reason=correlation_reason,
        steps_in_all=steps,
        silent_stops_s=tuple(waits_s),
    )
    return found, _list_events(names, axis, fit)


def _find_usual_step(run: Run) -> float:
    """Return the usual time between poses [s]; 0 for fewer than two poses."""
    steps_ns = np.diff(run.poses.time_ns)
    return float(np.median(steps_ns)) / 1e9 if len(steps_ns) else 0.0


def _join_commands(runs: Sequence[Run], axis: Axis) -> Values:
    return np.concatenate([get_commands(run, axis) for run in runs])


def _note_one_size(runs: Sequence[Run], model: AxisModel) -> Iterator[str]:
    sizes = np.abs(_join_commands(runs, model.axis))
    moving, name = sizes[sizes > 0.0], NAMES[model.axis]
    if model.is_known and float(np.ptp(moving)) <= _ALIKE * float(moving.max()):
        yield (
            f"All {name} commands have the same magnitude. The log does not show whether smaller"
            f" commands have the same gain, nor the largest {name}."
        )


def _shows_gain(runs: Sequence[Run], model: AxisModel, sign: float) -> bool:
    """Return whether enough commands of one sign stay below the bound to show their gain."""
    sizes, reaches = _list_moving(runs, model, sign)
    return not len(sizes) or float(np.mean(~reaches)) >= LEAST_BELOW


def _list_moving(
    runs: Sequence[Run], model: AxisModel, sign: float
) -> tuple[Values, NDArray[np.bool_]]:
    """Return the magnitudes of moving commands of one sign, and whether they reach the bound."""
    # A command that reaches the bound within its interval fits any larger gain as well. The way to
    # a bound of the rate shows the gain anyway.
    sizes = sign * _join_commands(runs, model.axis)
    sizes = sizes[sizes > (0.0 if model.deadband is None else model.deadband.low)]
    if model.gain is None or model.bound is None or model.bound_acts == "rate":
        return sizes, np.zeros(len(sizes), dtype=bool)
    gain = model.reverse_gain if sign < 0.0 and model.reverse_gain else model.gain
    friction = 0.0 if model.friction is None else model.friction.value
    return sizes, np.asarray(gain.high * (sizes - friction) >= model.bound.low)


def _refuse_forward(runs: Sequence[Run], model: AxisModel) -> AxisModel:
    """Return an axis without values, because the motion shows only the gain of negative commands.

    The gain of positive ones may have any value above the bound divided by the smallest of them.
    """
    name, unit = NAMES[model.axis], UNITS[model.axis]
    sizes, reaches = _list_moving(runs, model, 1.0)
    smallest = float(sizes[reaches].min())
    bound, delay = (0.0 if one is None else one.value for one in (model.bound, model.total_delay_s))
    reason = (
        f"{_count_reaching(reaches)} positive command reaches the limit of {bound:.3g} {unit}, so"
        f" that the gain of smaller ones is only known to be at least {bound / smallest:.3g}; the"
        f" total delay is {delay:.3f} s"
    )
    advice = f"step the {name} ten times for 2 s, also to less than {smallest:.2g} {unit}"
    return replace(refused_axes.refuse_axis(model.axis, reason), advice=advice)


def _note_backward(runs: Sequence[Run], model: AxisModel) -> Iterator[str]:
    if not _shows_gain(runs, model, -1.0):
        bound = 0.0 if model.bound is None else model.bound.value
        every = _count_reaching(_list_moving(runs, model, -1.0)[1]).capitalize()
        yield (
            f"{every} negative command of the {NAMES[model.axis]} reaches the limit of {bound:.3g}"
            f" {UNITS[model.axis]}. The log does not show whether the gain holds for smaller ones."
        )


def _note_drift(runs: Sequence[Run], model: AxisModel) -> Iterator[str]:
    """Yield a note if no rest shows the drift of a known axis."""
    if model.drift is None or model.dead_time_s is None or model.lag_s is None:
        return
    motions = [read_axis_motion(run, model.axis) for run in runs]
    rests = find_rests(motions, model.dead_time_s.value, model.lag_s.value)
    rested_s = float(np.concatenate([one.duration_s for one in motions])[rests].sum())
    if rested_s < RESTED_S:
        yield (
            f"The robot never rests long enough in this log. The drift of the {NAMES[model.axis]}"
            " is the one that its motion beside commands shows, and may be different at rest."
        )


def _count_reaching(reaches: NDArray[np.bool_]) -> str:
    return "every" if reaches.all() else "nearly every"


def _note_one_beside(runs: Sequence[Run], model: AxisModel) -> Iterator[str]:
    """Yield a note if a known axis is only commanded beside one command of the other axis."""
    # Wheels that reach their limit together show only this one gain; other commands may have a
    # larger gain.
    other = OTHER[model.axis]
    own, beside = (np.abs(_join_commands(runs, axis)) for axis in (model.axis, other))
    beside = beside[own > 0.0]
    if not model.is_known or not len(beside):
        return
    usual = float(np.median(beside))
    if usual and np.mean(np.abs(beside - usual) <= _ALIKE * usual) >= _MOSTLY:
        yield (
            f"Nearly all commands of the {NAMES[model.axis]} come together with a {NAMES[other]} of"
            f" {usual:.3g} {UNITS[other]}. The log does not show the gain of the"
            f" {NAMES[model.axis]} without this {NAMES[other]}."
        )


def _doubt_waiting(runs: Sequence[Run], model: AxisModel, other: AxisModel) -> AxisModel:
    """Return an axis in doubt if it is slower than the other axis and never changes without it."""
    # Wheels whose acceleration is limited turn only after they have braked. Both axes share wheels,
    # motors and odometry, so nothing else delays one of them alone.
    delay, other_delay = model.total_delay_s, other.total_delay_s
    is_slower = delay is not None and (other_delay is None or delay.low > other_delay.high)
    if not is_slower or model.limit_acts == "at_wheels":
        return model
    joint = np.concatenate([read_axis_motion(run, model.axis).joint for run in runs])
    if np.mean(joint) < _JOINTLY:
        return model
    covered = cover_waiting(model, other)
    return refused_axes.refuse_wide(covered, f"while the {NAMES[other.axis]} rests") or covered


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
            events.append(RobotEvent(file=name, axis=axis, time_s=time_s, size=size))
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
    if find_plant(run) is not TURTLESIM:
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
        reason = f"no pose shows a change of the commanded {NAMES[axis]}"
        if not any(get_commands(run, axis).any() for run in runs):
            reason = f"the {NAMES[axis]} is never commanded"
        return refused_axes.refuse_axis(axis, reason)
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
