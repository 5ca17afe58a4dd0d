"""A robot's dynamics: both axes, events, the answer in words, and what the log leaves open."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Final

import numpy as np

from turtlelog.display import fit_line, format_html, format_notebook, join_words
from turtlelog.identify.axis_model import LEAST_BELOW, AxisModel, Estimate, format_estimate
from turtlelog.identify.axis_motion import (
    NAMES,
    OTHER,
    RESTED_S,
    UNITS,
    Axis,
    find_rests,
    get_commands,
    read_axis_motion,
)
from turtlelog.identify.held_response import Values
from turtlelog.run import Clock, Run


@dataclass(frozen=True, slots=True, kw_only=True)
class TickDelays:
    """Delays of turtlesim: from a command's time to the pose that shows it.

    Attributes:
        shown: Number of commands visible in a pose: taken commands that changed the plant's
            command.
        commands: Number of all commands.
        least_s: Smallest delay [s].
        median_s: Median delay [s].
        largest_s: Largest delay [s].
    """

    shown: int
    commands: int
    least_s: float
    median_s: float
    largest_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotEvent:
    """A place in the log that no command explains.

    Attributes:
        file: Name of the run.
        axis: `speed` or `turn_rate`.
        time_s: Time of the pose after the event [s].
        size: Error of the step [m] or [rad].
        text: The event as one sentence.
    """

    file: str
    axis: Axis
    time_s: float
    size: float
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotModel:
    """A robot's dynamics, identified from its commands and its motion.

    Attributes:
        files: Names of the runs.
        clock: Clock that times the poses of the first run; None if there is only one clock.
        speed: Axis of the speed along the heading.
        turn_rate: Axis of the turn rate, counter-clockwise positive.
        tick_delays: Tick delays of turtlesim, whose poses show the tick of each command; None for
            other robots.
        events: Jumps of the motion, in order.
        notes: Further notes, in sentences.
    """

    files: tuple[str, ...]
    clock: Clock | None = None
    speed: AxisModel
    turn_rate: AxisModel
    tick_delays: TickDelays | None = None
    events: tuple[RobotEvent, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def axes(self) -> tuple[AxisModel, AxisModel]:
        """Both axes of the robot."""
        return self.speed, self.turn_rate

    @property
    def brackets(self) -> str:
        """Meaning of the values in brackets, in words."""
        return "95 % intervals" if self.tick_delays is None else "the least and the largest"

    def __repr__(self) -> str:
        known = [axis.axis for axis in self.axes if axis.is_known]
        return fit_line(
            f"<RobotModel of {', '.join(self.files)}: {' and '.join(known) or 'nothing'} known>"
        )

    def _repr_html_(self) -> str:
        rows = [(*list_model_values(axis), axis.reason) for axis in self.axes]
        answer = " ".join(write_robot_headline(self.axes, ", ".join(self.files)))
        doubts = [f"<p>{escape(doubt)}</p>" for axis in self.axes for doubt in axis.doubts]
        return format_notebook(answer, format_html(rows, heads=(*HEADS, "")), *doubts)


_WHOLE_MS: Final = 10.0
"""Width of an interval from which tenths of a millisecond are not printed [ms]."""

_DEGREES: Final = math.degrees(1.0)

_UNIT_FAULTS: Final[Mapping[Axis, tuple[tuple[float, str, str], ...]]] = {
    "speed": (
        (
            100.0,
            "positions of the poses are probably in cm",
            "x='NAME [cm]' --column y='NAME [cm]'",
        ),
        (
            1000.0,
            "positions of the poses are probably in mm",
            "x='NAME [mm]' --column y='NAME [mm]'",
        ),
        (0.01, "commanded speeds are probably in cm/s", "command_speed='NAME [cm/s]'"),
        (0.001, "commanded speeds are probably in mm/s", "command_speed='NAME [mm/s]'"),
    ),
    "turn_rate": (
        (_DEGREES, "headings of the poses are probably in deg", "heading='NAME [deg]'"),
        (
            1.0 / _DEGREES,
            "commanded turn rates are probably in deg/s",
            "command_turn_rate='NAME [deg/s]'",
        ),
    ),
}
"""Gain of a robot with a gain of 1 if a unit is wrong, the wrong unit, and the right column."""

_SOUND: Final = (0.5, 1.5)
"""Gains of usual robots [1]."""


def list_unit_faults(axes: Sequence[AxisModel]) -> list[str]:
    """Return sentences on gains that are probably those of another unit, with the right option."""
    return [
        f"The {what}, because the gain of the {NAMES[axis.axis]} is {axis.gain.value:.3g}. For a"
        f" table, add --column {column}, where NAME is the column."
        for axis in axes
        if axis.gain is not None
        for gain, what, column in _UNIT_FAULTS[axis.axis]
        if _SOUND[0] <= axis.gain.value / gain <= _SOUND[1]
    ]


def write_robot_headline(axes: Sequence[AxisModel], name: str) -> list[str]:
    """Return how each axis follows its commands as sentences: delays, gains, and doubts.

    A probably wrong unit comes first.

    Args:
        axes: Axes of the robot.
        name: Name of the run from which the robot was identified.
    """
    delays = [
        f"of {NAMES[axis.axis]} {format_delay(axis.total_delay_s).replace(' ', ' ms ', 1)}"
        for axis in axes
        if axis.total_delay_s is not None
    ]
    if not delays:
        return [f"{name}: no axis could be identified."]
    faults = " ".join(list_unit_faults(axes))
    said = [f"{name}: {faults[0].lower()}{faults[1:]}"] if faults else []
    total = f"total delay {', '.join(delays)}."
    said.append(f"T{total[1:]}" if said else f"{name}: {total}")
    gains = [
        f"{NAMES[axis.axis]} {axis.gain.value:.3f}{axis.exceptions}"
        + (f" up to its limit of {format_estimate(axis.bound)}" if axis.bound else "")
        + (f" with a drift of {format_estimate(axis.drift)}" if axis.drift else "")
        for axis in axes
        if axis.gain is not None
    ]
    if gains:
        said.append(f"Gain{'' if len(gains) == 1 else 's'}: {', '.join(gains)}.")
    said += [
        f"The {NAMES[axis.axis]} could not be identified." for axis in axes if not axis.is_known
    ]
    doubted = [_write_doubted(axis) for axis in axes if axis.is_known and axis.doubts]
    if doubted:
        said.append(f"In doubt: {join_words(doubted)}.")
    return said


def _write_doubted(axis: AxisModel) -> str:
    """Return a doubtful axis with the delay for the design of a controller, if it is known."""
    delay_s = axis.advised_delay_s
    if delay_s is None or not math.isfinite(delay_s):
        return NAMES[axis.axis]
    return f"{NAMES[axis.axis]} (plan with {1e3 * delay_s:.0f} ms)"


def format_gain(found: Estimate | None) -> str:
    """Return a gain with its interval as text; `-` if there is no gain."""
    return "-" if found is None else f"{found.value:.3f} ({found.low:.3f} to {found.high:.3f})"


def format_delay(found: Estimate | None, unit: str = "") -> str:
    """Return a delay in ms with a unit and its interval as text; `-` if there is no delay."""
    if found is None:
        return "-"
    value, low, high = (1e3 * number for number in (found.value, found.low, found.high))
    digits = 0 if high - low > _WHOLE_MS else 1
    return f"{value:.{digits}f}{unit} ({low:.{digits}f} to {high:.{digits}f})"


def list_model_values(axis: AxisModel) -> tuple[str, str, str, str]:
    """Return the name of an axis, its gain, dead time and time constant, with intervals."""
    dead_time, lag = format_delay(axis.dead_time_s), format_delay(axis.lag_s)
    return NAMES[axis.axis], format_gain(axis.gain), dead_time, lag


HEADS: Final = ("axis", "gain [1]", "dead time [ms]", "time constant [ms]")
"""Titles of the columns of `list_model_values`."""

_SAME_SIZE: Final = 0.05
"""Largest relative difference of commands of equal size. A smaller difference does not show whether
the gain varies."""

_MOSTLY: Final = 0.95
"""Share of an axis's commands beside one command of the other axis, above which no commands are
left to compare: less than a twentieth of the commands gives no interval of its own."""


def list_open_questions(runs: Sequence[Run], models: Sequence[AxisModel]) -> list[str]:
    """Return what the log does not show of known axes, as sentences."""
    notes = (_note_one_size, _note_one_beside, _note_backward, _note_drift)
    return [text for note in notes for model in models for text in note(runs, model)]


def _join_commands(runs: Sequence[Run], axis: Axis) -> Values:
    return np.concatenate([get_commands(run, axis) for run in runs])


def _note_one_size(runs: Sequence[Run], model: AxisModel) -> Iterator[str]:
    sizes = np.abs(_join_commands(runs, model.axis))
    moving, name = sizes[sizes > 0.0], NAMES[model.axis]
    if model.is_known and float(np.ptp(moving)) <= _SAME_SIZE * float(moving.max()):
        yield (
            f"All {name} commands have the same magnitude. The log does not show whether smaller"
            f" commands have the same gain, nor the largest {name}."
        )


def find_reaching(runs: Sequence[Run], model: AxisModel, sign: float) -> tuple[str, float] | None:
    """Return how many moving commands of one sign reach the bound, and the smallest of them.

    The result is None if enough commands stay below the bound to show their gain.
    """
    # A command that reaches the bound within its interval fits any larger gain as well. The way to
    # a bound of the rate shows the gain anyway.
    if model.gain is None or model.bound is None or model.bound_acts == "rate":
        return None
    sizes = sign * _join_commands(runs, model.axis)
    sizes = sizes[sizes > (0.0 if model.deadband is None else model.deadband.low)]
    gain = model.reverse_gain if sign < 0.0 and model.reverse_gain else model.gain
    friction = 0.0 if model.friction is None else model.friction.value
    reaches = gain.high * (sizes - friction) >= model.bound.low
    if not len(sizes) or np.mean(~reaches) >= LEAST_BELOW:
        return None
    return "every" if reaches.all() else "nearly every", float(sizes[reaches].min())


def _note_backward(runs: Sequence[Run], model: AxisModel) -> Iterator[str]:
    found = find_reaching(runs, model, -1.0)
    if found is not None and model.bound is not None:
        yield (
            f"{found[0].capitalize()} negative command of the {NAMES[model.axis]} reaches the limit"
            f" of {model.bound.value:.3g} {UNITS[model.axis]}. The log does not show whether the"
            " gain holds for smaller ones."
        )


def _note_drift(runs: Sequence[Run], model: AxisModel) -> Iterator[str]:
    """Yield a note if no rest shows the drift of a known axis."""
    if model.drift is None or model.dead_time_s is None or model.lag_s is None:
        return
    motions = [read_axis_motion(run, model.axis) for run in runs]
    rests = find_rests(motions, model.dead_time_s.value, model.lag_s.value)
    rested_s = float(np.concatenate([one.duration_s for one in motions])[rests].sum())
    rested_s += sum(one.rested[0] for one in motions)
    if rested_s < RESTED_S:
        yield (
            f"The robot never rests long enough in this log. The drift of the {NAMES[model.axis]}"
            " is the one that its motion beside commands shows, and may be different at rest."
        )


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
    if usual and np.mean(np.abs(beside - usual) <= _SAME_SIZE * usual) >= _MOSTLY:
        yield (
            f"Nearly all commands of the {NAMES[model.axis]} come together with a {NAMES[other]} of"
            f" {usual:.3g} {UNITS[other]}. The log does not show the gain of the"
            f" {NAMES[model.axis]} without this {NAMES[other]}."
        )
