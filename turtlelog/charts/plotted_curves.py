"""Curves of plots over time: their kinds, states of a law, ranges, changes of a command."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, Literal

import numpy as np

from turtlelog.charts.curves import Command, Curve, Level, Values
from turtlelog.charts.many_runs import MANY
from turtlelog.charts.palette import FEW
from turtlelog.run import Run
from turtlelog.run.loops import COMMAND_WORDS, ControlLoop, Declaration

CurveKind = Literal[
    "run", "beside", "measured", "applied", "wanted", "shaped",
    "ideal", "aim", "sensed", "dropped_out", "outlier",
]  # fmt: skip
"""Kind of a curve.

`run` is the run's own signal, `beside` a second signal. `measured` is the robot's own measurement,
`applied` the plant's rate, `wanted` the law's command, `shaped` the shaped command. `ideal` is the
ideal loop, `aim` a moving reference. `sensed`, `dropped_out` (not received) and `outlier` are
points."""

POINTS: Final[frozenset[CurveKind]] = frozenset({"sensed", "dropped_out", "outlier"})
"""Kinds that are points without joining lines."""

OWN: Final[frozenset[CurveKind]] = frozenset({"run", "beside", "measured", "applied", "aim"})
"""Kinds that a plot's range must include. Theory and wanted commands may lie far outside."""

_MEASURED: Final = OWN - {"aim"}

COMPARED: Final[frozenset[CurveKind]] = frozenset({"run", "measured", "ideal", "aim"})
"""Kinds that are drawn for several runs in one plot."""

Scale = Literal["linear", "log", "symlog"]
Column = Literal["turning", "moving"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveEntry:
    """A curve of a plot over time."""

    kind: CurveKind  # kind of the curve, which determines colour and dash
    read: Callable[[Run], Iterable[Curve]]  # curves of a run, several if the loop steps repeatedly
    label: str = ""  # label in a legend; a curve's own label has priority
    name: str = ""  # name that distinguishes the curves of a plot; empty for the run's own
    signal: str = ""  # signal whose characteristics are marked on the curve; empty for other curves


@dataclass(frozen=True, slots=True, kw_only=True)
class TimePlot:
    """A plot over time."""

    title: str  # title of the plot
    unit: str  # unit of the values; empty if no unit is declared
    curves: tuple[CurveEntry, ...]  # curves in the order of the legend
    list_levels: Callable[[Run], Iterable[Level]] = lambda _: ()  # level lines of a run
    is_log: bool = False  # whether there is also a logarithmic plot of the magnitudes
    scale: Scale = "linear"  # scale of the axis
    figure: str = ""  # print figure with the plot as a panel; it is created if it does not exist
    needs: str = "poses"  # data that a run must contain, by name in the table of needs
    loop: str = ""  # signal that a loop of a run must control; empty: any
    is_usual: bool = True  # whether a figure reports the plot as missing if no run has data for it
    pair: str = ""  # name of the plot that shows x and y together if there is little room
    place: tuple[Column, int] | None = None  # column and row in a large view; one place: tabs
    is_compared: bool = True  # whether a view of several runs contains the plot
    report: Literal["always", "moving", "never"] = "never"  # moving: if a reference moves
    command: Command | None = None  # command that the plot shows; None for any other signal
    is_filled: bool = False  # whether a single oscillation would fill the plot from end to end

    @property
    def label(self) -> str:
        """Title and unit."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlottedCurve:
    """A curve of a run in a plot."""

    entry: CurveEntry  # entry of the curve
    label: str  # label in the legend of a single run
    curve: Curve  # values of the curve

    @property
    def kind(self) -> CurveKind:
        """Kind of the curve."""
        return self.entry.kind


def list_plotted(
    run: Run, plot: TimePlot, kinds: frozenset[CurveKind] | None = None
) -> list[PlottedCurve]:
    """Return the curves of a run in a plot, of some kinds or of all.

    If a run has no curve of its own, no curves are returned: a reference alone is not shown. For a
    robot without recorded commands, the applied rates replace the commands.
    """

    def read(entries: Iterable[CurveEntry]) -> list[PlottedCurve]:
        return [
            PlottedCurve(entry=entry, label=curve.label or entry.label, curve=curve)
            for entry in entries
            for curve in entry.read(run)
        ]

    found = read(one for one in plot.curves if kinds is None or one.kind in kinds)
    if kinds is not None and not found:
        found = read(one for one in plot.curves if one.kind == "applied")
    return found if any(one.kind in _MEASURED for one in found) else []


def choose_kinds(number: int, count: int) -> frozenset[CurveKind] | None:
    """Return the kinds of curves for one of several runs in a plot; None for a single run: all.

    If there are many runs, only the first and the last have an ideal response, because all ideal
    responses would be a grey area.
    """
    if count == 1:
        return None
    return COMPARED - {"ideal"} if count > MANY and 0 < number < count - 1 else COMPARED


def list_own(run: Run, plot: TimePlot) -> list[Curve]:
    """Return the run's own curves in a plot, which the axis must include."""
    return [one.curve for one in list_plotted(run, plot, OWN)]


def has_own(run: Run, plot: TimePlot) -> bool:
    """Return whether a run has a curve of its own in a plot."""
    return any(True for one in plot.curves if one.kind in _MEASURED for _ in one.read(run))


def list_plot_levels(
    runs: Sequence[Run], plot: TimePlot, scale: Scale | None = None
) -> list[Level]:
    """Return the level lines of runs in a plot, in rising order without duplicates.

    On a logarithmic scale, which shows magnitudes, only the tolerances have lines; on other scales,
    all levels except the tolerances.
    """
    is_log = (scale or plot.scale) == "log"
    found = dict.fromkeys(level for run in runs for level in plot.list_levels(run))
    kept = [level for level in found if (level.kind == "tolerance") == is_log]
    return sorted(kept, key=lambda level: (level.value, level.label))


def leaves_out(count: int, plot: TimePlot) -> bool:
    """Return whether a plot of this many runs leaves out runs that never settle."""
    return count > MANY and plot.is_filled


_LEAST_MAGNITUDE: Final = 1e-100
"""Smallest magnitude on a logarithmic scale, far below an error's resolution and above 0."""


def take_magnitude(curve: Curve) -> Curve:
    """Return the magnitudes of a curve for a logarithmic scale, with gaps at zeros."""
    sizes = np.abs(curve.values)
    return replace(curve, values=np.where(sizes < _LEAST_MAGNITUDE, np.nan, sizes))


_MOST_APART: Final = 3  # views side by side; with more, each would be narrower than a legend

_LARGEST_RATIO: Final = 20.0
"""Largest ratio of magnitudes in one plot. Smaller curves, below a twentieth, look like zero."""

_MOST_TOGETHER: Final = len(FEW)  # curves in one plot; more curves would share hues


@dataclass(frozen=True, slots=True, kw_only=True)
class StateGroup:
    """States that belong together."""

    title: str  # title, such as `State lyapunov` or `States of the turn rate`
    names: tuple[str, ...]  # names of the states in the law's declaration
    units: tuple[str, ...]  # unit of each state in the law's declaration; empty without a unit
    command: str | None = None  # command to which the states belong; None for other states

    @property
    def label(self) -> str:
        """Title, with the unit if all states have the same unit."""
        return _add_unit(self.title, self.units[0] if len({*self.units}) == 1 else "")

    def label_state(self, name: str) -> str:
        """Return a state with its unit."""
        return _add_unit(name, self.units[self.names.index(name)])

    def can_share(self, names: Sequence[str], columns: Sequence[Values]) -> bool:
        """Return whether some of the states can share a plot, by their units and values."""
        units = {self.units[self.names.index(name)] for name in names}
        return len(units) <= 1 and are_comparable(columns)


def group_states(*declarations: Declaration) -> tuple[StateGroup, ...]:
    """Return the states of laws in groups: states of the turn rate, of the speed, then all others.

    A state belongs to a loop if the loop's name is a word in the state's name (`integral_rotate`).
    A state also belongs to a loop whose gain ends in its last word (`integral_angular` with
    `law.kp_angular`). If all loops of a state have the same command, the state belongs to this
    command. Each other state has its own view, while there are few views.
    """

    def belongs(state: str, loop: ControlLoop) -> bool:
        keys = (loop.gain, loop.integral_gain, loop.derivative_gain)
        gains = [key.rpartition(".")[2].split("_") for key in keys if key is not None]
        words = state.split("_")
        ends = [gain[-1] for gain in gains if len(gain) > 1]
        return loop.name.lower() in words or words[-1] in ends

    def group(title: str, names: Iterable[str], command: str | None = None) -> StateGroup:
        units = tuple(find_state_unit(name, declarations) for name in names)
        return StateGroup(title=title, names=tuple(names), units=units, command=command)

    of_command: dict[str, dict[str, None]] = {command: {} for command in COMMAND_WORDS}
    others: dict[str, None] = {}
    for declaration in declarations:
        for name in declaration.states:
            commands = {loop.command for loop in declaration.loops if belongs(name, loop)}
            of_one = of_command[commands.pop()] if len(commands) == 1 else others
            of_one[name] = None
    found = [
        group(f"States of the {COMMAND_WORDS[command]}", names, command)
        for command, names in of_command.items()
        if names
    ]
    if len(found) + len(others) > _MOST_APART and len(others) > 1:
        return (*found, group("States", others))
    return (*found, *(group(f"State {name}", [name]) for name in others))


def find_state_unit(name: str, declarations: Iterable[Declaration]) -> str:
    """Return the unit of a state; empty if no law declares a unit, or two laws differ."""
    units = {one.state_units.get(name, "") for one in declarations if name in one.states}
    return units.pop() if len(units) == 1 else ""


def are_comparable(columns: Sequence[Values]) -> bool:
    """Return whether curves can share a plot: few curves, none of which looks like zero."""
    if len(columns) > _MOST_TOGETHER:
        return False
    known = [np.abs(values[np.isfinite(values)]).max(initial=0.0) for values in columns]
    largest = [float(value) for value in known if value > 0.0]
    return not largest or max(largest) <= _LARGEST_RATIO * min(largest)


def _add_unit(title: str, unit: str) -> str:
    return f"{title} [{unit}]" if unit else title


HEADROOM: Final = 1.25  # end of a command's range, as a multiple of its most extreme value

_ROOM: Final = 0.08
"""Margin above and below measured values, as a share of their range, or else of the value."""

_LEAST_ROOM: Final = 1e-9
"""Smallest margin if all values are equal, in the plot's unit, because a range needs a height."""

_ROOM_AROUND_0: Final = 0.1
"""Margin if all values are 0, in the plot's unit; ticks of a smaller range are hard to read."""

_AT_REST: Final = 0.01
"""Share of a plot's height within which a curve rests: below a line's width in print at 40 mm."""

_LEAST_SIDE: Final = 0.15
"""Smallest part of a command's range on each side of 0, of its largest limit times `HEADROOM`."""


def label_time(runs: Sequence[Run]) -> str:
    """Return the label of a time axis. Time zero is the first sample, or the first row of a bag."""
    return f"time from the first {' or '.join(dict.fromkeys(run.first_row for run in runs))} [s]"


def find_plot_range(
    curves: Iterable[Values], levels: Sequence[Level]
) -> tuple[float, float] | None:
    """Return the range of a plot that includes curves and level lines, with a margin.

    For commands, the range ends slightly beyond their extremes, whether these are limits or not.
    The result is None if no value is known.
    """
    known = np.concatenate([*(values[np.isfinite(values)] for values in curves), np.empty(0)])
    if not len(known):
        return None
    low, high = float(known.min()), float(known.max())
    limits = [level.value for level in levels if level.kind == "limit"]
    if limits:
        least = _LEAST_SIDE * max(limits)
        return min(low, -least) * HEADROOM, max(high, least) * HEADROOM
    values = [low, high, *(level.value for level in levels)]
    low, high = min(values), max(values)
    room = _ROOM * (high - low)
    if not room:
        room = max(_ROOM * abs(high), _LEAST_ROOM) if high else _ROOM_AROUND_0
    return low - room, high + room


def find_rest(curves: Iterable[tuple[Values, Values]], height: float) -> float:
    """Return the time from which all curves stay within 1 % of a height of their last values [s].

    Each curve has its times [s] and values. A robot may move in a gap, so the rest of a curve
    begins after its gaps. Values are joined by lines, so it rests from the end of the last one.
    """
    ends_s = [0.0]
    for time_s, values in curves:
        known = np.flatnonzero(np.isfinite(values))
        if len(known):
            time_s, values = time_s[: known[-1] + 1], values[: known[-1] + 1]
            is_near = np.abs(values - values[-1]) <= _AT_REST * height
            for away in np.flatnonzero(~is_near)[-1:]:
                ends_s.append(float(time_s[away + bool(np.isfinite(values[away]))]))
    return max(ends_s)


_LARGE: Final = 0.2
"""Share of the largest change from which a change counts; noise and resolution are smaller."""

_LEAST_HELD_S: Final = 0.15
"""Time from which a held command is a level [s]; commands come at 10 Hz and more, with jitter."""

_MOST: Final = 60  # changes that are drawn, the largest changes; more would be a grey block


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandChange:
    """A change of a command in one direction, at once or over several commands."""

    begin_s: float  # time of the change's first command [s]
    half_s: float  # time at which the command passes the middle between its levels [s]
    end_s: float  # start of the next change, or end of the commands [s]
    before: float  # level from which it changes
    after: float  # level to which it changes

    def scale(self, values: Values, gain: float = 1.0) -> Values:
        """Return values as the completed fraction of the change: 0 before the change, 1 after.

        The motion of a robot with another gain than 1 has the gain after the change.
        """
        return (values - gain * self.before) / (self.after - self.before)


def find_command_changes(command: Curve) -> list[CommandChange]:
    """Return the large changes of a command in order of time.

    Successive commands in one direction are one change. A level that is held for longer than the
    change so far separates two changes.
    """
    values = np.concatenate([[0.0], command.values])
    rows = np.flatnonzero(np.diff(values) != 0.0)
    if not len(rows):
        return []
    signs, times_s = np.sign(np.diff(values)[rows]), command.time_s[rows]
    firsts = [0]
    for number in range(1, len(rows)):
        so_far_s = times_s[number - 1] - times_s[firsts[-1]]
        is_held = times_s[number] - times_s[number - 1] > max(so_far_s, _LEAST_HELD_S)
        if signs[number] != signs[number - 1] or is_held:
            firsts.append(number)
    found = []
    for first, after in pairwise([*firsts, len(rows)]):
        before, level = float(values[rows[first]]), float(values[rows[after - 1] + 1])
        own = values[rows[first:after] + 1]
        half = int(np.argmax((own - before) / (level - before) >= 0.5))
        change = CommandChange(
            begin_s=float(times_s[first]),
            half_s=float(times_s[first + half]),
            end_s=float(times_s[after] if after < len(rows) else command.time_s[-1]),
            before=before,
            after=level,
        )
        found.append(change)
    sizes = np.array([abs(one.after - one.before) for one in found])
    largest = np.argsort(-sizes, kind="stable")[:_MOST]
    return [found[row] for row in sorted(largest) if sizes[row] >= _LARGE * sizes.max()]
