"""Curves of a run for screen and print, with their levels, moving references and ideal responses.

Headings are in degrees. Long curves are thinned to rows that give the same picture.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from turtlelog.measure import find_first_stretch, find_signal, list_signals, read_reference
from turtlelog.measure.rates import measure_forward_steps
from turtlelog.measure.references import project_on_line
from turtlelog.plants import find_plant
from turtlelog.run import Run
from turtlelog.run.angles import subtract_headings
from turtlelog.run.loops import DONE, PAUSE, REFERENCE_WORDS, ControlLoop, find_disturbance
from turtlelog.theory import compute_step_response

Values = NDArray[np.float64]

REFERENCE: Final = REFERENCE_WORDS["recorded"]  # name of curves of a law's recorded reference

BEARING_NOW: Final = REFERENCE_WORDS["bearing_now"]
"""Name of the curve of the bearing from the present position."""

_NO_LIMIT: Final = 1e9
"""Speed [m/s], rate [rad/s] or tolerance that no robot reaches, so that it counts as infinite.

The line of such a limit is not drawn, because it would flatten every curve."""

MOST_POINTS: Final = 20_000
"""Number of points from which a curve is thinned: 3 for each of 6,666 segments.

A page 181 mm wide has 4,275 columns at 600 dpi."""

Command = Literal["speed", "turn_rate"]

SENSED_SIGNALS: Final = ("x", "y", "heading")  # signals that may have been sensed


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curve:
    """The values of one quantity of a run, or of its reference."""

    start_ns: int  # time of the first sample in the run's time [ns]
    time_ns: NDArray[np.int64]  # times in the run's time [ns], shape (n,)
    values: Values  # values in deg, m, m/s or rad/s, shape (n,); NaN for gaps
    holds: bool = False  # whether a value is held until the next value
    label: str = ""  # label for the legend, if it differs from the run's label

    @property
    def time_s(self) -> Values:
        """Times from the first sample [s], shape (n,)."""
        return np.asarray((self.time_ns - self.start_ns) / 1e9)


@dataclass(frozen=True, slots=True, kw_only=True)
class Level:
    """A constant reference of a signal."""

    label: str  # label for a legend
    value: float  # value in the unit of the signal; angles in deg
    kind: Literal["target", "zero", "limit", "tolerance"] = "target"


def read_curve(run: Run, signal_name: str) -> Curve | None:
    """Return a signal; None if the run does not have it, such as the state of another run's law.

    In addition to the named signals there are `world_velocity_x` and `world_velocity_y`: gain times
    error.
    """
    if signal_name.startswith("world_velocity_"):
        time_ns, velocity = run.samples.time_ns, run.samples.world_velocity_m_s
        known = np.zeros(0, bool) if velocity is None else np.isfinite(velocity).all(axis=1)
        if velocity is None or not known.any():
            return None
        values = velocity[known, "xy".index(signal_name[-1])]
        return Curve(start_ns=run.start_ns, time_ns=time_ns[known], values=values, holds=True)
    is_known = signal_name in list_signals(run.declaration)
    signal = find_signal(run, signal_name) if is_known else None
    if signal is None or not len(signal.values):
        return None
    return Curve(
        start_ns=run.start_ns,
        time_ns=signal.time_ns,
        values=np.degrees(signal.values) if signal.kind.unit == "rad" else signal.values,
        holds=signal.kind.resampling == "hold",
    )


def find_unit(run: Run, signal_name: str) -> str:
    """Return the unit of the values of `read_curve`: deg for an angle, else the signal's unit."""
    unit = list_signals(run.declaration)[signal_name].unit
    return "deg" if unit == "rad" else unit


def select_curve_rows(curve: Curve, rows: NDArray[np.int64]) -> Curve:
    """Return some rows of a curve."""
    return replace(curve, time_ns=curve.time_ns[rows], values=curve.values[rows])


def read_command(run: Run, command: Command) -> Curve | None:
    """Return the commands; None if the run has no commands."""
    table = run.samples if len(run.samples) else run.commands
    if not len(table):
        return None
    values = table.speed_m_s if command == "speed" else table.turn_rate_rad_s
    return Curve(start_ns=run.start_ns, time_ns=table.time_ns, values=values, holds=True)


def read_applied(run: Run, command: Command) -> Curve | None:
    """Return the applied `speed` or `turn_rate` of the plant; None if not recorded.

    The plant publishes the magnitude of the applied speed: negative where poses move backward.
    """
    poses = run.poses
    values = poses.speed_m_s if command == "speed" else poses.turn_rate_rad_s
    if values is None:
        return None
    if command == "speed":
        values = np.where(measure_forward_steps(poses) < 0.0, -abs(values), values)
    holds = find_plant(run).holds_rates
    return Curve(start_ns=run.start_ns, time_ns=poses.time_ns, values=values, holds=holds)


def read_sensed(run: Run, signal: str) -> Curve | None:
    """Return the `x`, `y` or `heading` that the controller read; None if it read the true pose."""
    return read_curve(run, f"sensed_{signal}") if signal in SENSED_SIGNALS else None


def find_disturbed_time(run: Run) -> tuple[float, float] | None:
    """Return start and end of the plant's disturbance within the run [s]; None without one."""
    if not len(run.poses):
        return None
    from_ns, to_ns = find_disturbance(run.parameters) or (0, 0)
    first_ns, last_ns = max(from_ns, int(run.poses.time_ns[0])), min(to_ns, run.end_ns)
    first_s, last_s = ((one - run.start_ns) / 1e9 for one in (first_ns, last_ns))
    return (first_s, last_s) if first_s < last_s else None


def list_loops(run: Run, signal: str) -> list[ControlLoop]:
    """Return the declared loops that control a signal.

    A loop of the distance to a recorded reference does not control the distance to the goal.
    """
    loops = [loop for loop in run.declaration.loops if loop.signal == signal]
    return [loop for loop in loops if not (loop.moves and signal == "distance")]


def list_levels(run: Run, signal: str) -> list[Level]:
    """Return the constant references of a signal.

    The levels are the references of its declared loops, and the goal for `x`, `y` and the
    along-track coordinate. If the loops of a run are unknown, the level is the goal's bearing from
    the start. Headings are shifted by the full turns that the robot made.
    """
    if signal in ("x", "y"):
        goal = run.goal_xy_m
        return [] if goal is None else [Level(label="goal", value=goal["xy".index(signal)])]
    levels = []
    for loop in list_loops(run, signal):
        value = None if loop.moves else read_reference(run, loop)
        if not isinstance(value, float):
            continue
        stretch, heading = find_first_stretch(run, loop), find_signal(run, "heading")
        if loop.reference == "goal_heading" and heading is not None and stretch:
            row = int(np.searchsorted(heading.time_ns, stretch[-1].end_ns))
            last = float(heading.values[min(row, len(heading.values) - 1)])
            value = _shift_turns(value, last)
        levels.append(Level(label=REFERENCE_WORDS[loop.reference], value=value))
    line = run.goal_line
    if line is not None and signal == "along_track" and line.length_m is not None:
        levels.append(Level(label="goal", value=line.length_m))
    if signal == "heading":
        levels = [replace(level, value=float(np.degrees(level.value))) for level in levels]
        bearing = None if run.goal_row else _read_goal_bearing(run)
        levels += [] if bearing is None else [Level(label=bearing.label, value=bearing.values[0])]
    return list(dict.fromkeys(levels))


def find_limits(run: Run, keys: Iterable[str]) -> list[float]:
    """Return the different values of limits or tolerances that can be reached, rising."""
    found = {run.parameters.get(key) for key in keys}
    return sorted(float(one) for one in found if isinstance(one, int | float) and is_limit(one))


def is_limit(value: float) -> bool:
    """Return whether a limit of speed [m/s] or rate [rad/s], or a tolerance, can be reached.

    In a scenario without a limit, its value is infinite or never reached.
    """
    return value < _NO_LIMIT


def list_aims(run: Run, signal: str) -> list[Curve]:
    """Return the references that change with time: of `x`, `y` and the signals of loops.

    Recorded references come from the samples. Headings are shifted by full turns to the headings of
    the robot.
    """
    found = [_read_recorded(run, signal), _read_arcs(run) if signal == "along_track" else None]
    if any(loop.reference == "bearing_now" for loop in list_loops(run, signal)):
        found.append(_read_bearings(run))
    if signal == "heading" and run.goal_row:
        found.append(_read_goal_bearing(run))
    return [aim for aim in found if aim is not None and np.isfinite(aim.values).any()]


def read_distance_to_reference(run: Run) -> Curve | None:
    """Return the distance to a recorded reference at each sample [m], the signal of such a loop."""
    samples, xy_m, loops = run.samples, run.samples.reference_xy_m, run.declaration.loops
    if xy_m is None or not any(loop.moves and loop.signal == "distance" for loop in loops):
        return None
    away_m = xy_m - run.poses.xy_m[samples.pose_sequence]
    return Curve(start_ns=run.start_ns, time_ns=samples.time_ns, values=np.hypot(*away_m.T))


def find_end_of_turn(run: Run) -> int | None:
    """Return when heading loops first stop acting [ns]; None if they act last, or never did."""
    loops = list_loops(run, "heading")
    names = {loop.name for loop in loops}
    phases = [name for name in run.declaration.phases if name not in (PAUSE, DONE)]
    if not phases or names & set(run.declaration.phases[phases[-1]]):
        return None
    for loop in loops:
        own = [span.end_ns for span in find_first_stretch(run, loop) if span.phase != PAUSE]
        if own:
            return own[-1]
    return None


def choose_rows(
    values: Values, most: int = MOST_POINTS, *, always: NDArray[np.int64] | None = None
) -> NDArray[np.int64] | None:
    """Return the rows of a curve to draw, about `most`; None if all rows are few enough.

    The rows of the values, shape (n,) or (n, columns), are split into equal segments. In each
    segment, the first row and the rows of the minimum and maximum of every column are kept, and
    also the very last row and the rows in `always`. NaN is neither a minimum nor a maximum. The
    first NaN of a segment is kept too, so that no line is drawn across a gap.
    """
    columns = values.reshape(len(values), -1)
    if len(columns) <= most:
        return None
    is_nan = np.isnan(columns)
    gaps = np.flatnonzero(is_nan.any(axis=0))
    length = -(-len(columns) // max(1, most // (2 * columns.shape[1] + len(gaps) + 1)))
    stays = np.zeros(len(columns), dtype=bool)
    stays[::length], stays[-1] = True, True
    stays[[] if always is None else always] = True
    for number, column in enumerate(columns.T):
        for fill, find in ((np.inf, np.argmin), (-np.inf, np.argmax)):
            known = np.where(is_nan[:, number], fill, column) if number in gaps else column
            stays[_find_in_stretches(known, length, find)] = True
    for gap in is_nan.T[gaps]:
        stays[_find_in_stretches(gap, length, np.argmax)] = True
    return np.flatnonzero(stays)


def _read_recorded(run: Run, signal: str) -> Curve | None:
    samples = run.samples
    xy_m, heading_rad = samples.reference_xy_m, samples.reference_heading_rad
    if xy_m is None or heading_rad is None:
        return None
    if signal in ("x", "y"):
        values = xy_m[:, "xy".index(signal)]
    elif signal == "heading":
        values = _bring_near(run, heading_rad, samples.pose_sequence)
    elif signal in ("along_track", "cross_track") and run.goal_line is not None:
        if not any(loop.reference == "recorded" for loop in list_loops(run, signal)):
            return None
        values = project_on_line(xy_m, run.goal_line, along=signal == "along_track")
    else:
        return None
    return _hold_reference(run, samples.time_ns, values)


def _hold_reference(run: Run, time_ns: NDArray[np.int64], values: Values) -> Curve:
    return Curve(start_ns=run.start_ns, time_ns=time_ns, values=values, holds=True, label=REFERENCE)


def _read_arcs(run: Run) -> Curve | None:
    loops = [loop for loop in list_loops(run, "along_track") if loop.reference == "path"]
    values = read_reference(run, loops[0]) if loops else None
    if not isinstance(values, np.ndarray):
        return None
    return _hold_reference(run, run.poses.time_ns, values)


def _read_bearings(run: Run) -> Curve | None:
    """Return the bearing from the present position, while a loop with this reference acts."""
    loops = [loop for loop in list_loops(run, "heading") if loop.reference == "bearing_now"]
    bearings = read_reference(run, loops[0])
    if not isinstance(bearings, np.ndarray):
        return None
    own = {phase for loop in loops for phase in run.declaration.list_phases(loop.name)}
    time_ns = run.poses.time_ns
    acts = np.zeros(len(time_ns), dtype=bool)
    for span in run.find_phase_spans():
        if span.phase in own:
            first, last = np.searchsorted(time_ns, [span.start_ns, span.end_ns])
            acts[first : last + 1] = True
    near = _bring_near(run, bearings, np.arange(len(time_ns)))
    values = np.where(acts, near, np.nan)
    return Curve(start_ns=run.start_ns, time_ns=time_ns, values=values, label=BEARING_NOW)


def _read_goal_bearing(run: Run) -> Curve | None:
    """Return the bearing of the goal from when it was given [deg], if no loop is declared."""
    line, headings = run.goal_line, find_signal(run, "heading")
    if line is None or headings is None or run.declaration.loops:
        return None
    time_ns = run.poses.time_ns[run.goal_row :]
    bearing_rad = _shift_turns(line.bearing_rad, float(np.median(headings.values[run.goal_row :])))
    values = np.full(len(time_ns), np.degrees(bearing_rad))
    return Curve(start_ns=run.start_ns, time_ns=time_ns, values=values, label="goal bearing")


def _shift_turns(heading_rad: float, near_rad: float) -> float:
    """Return a heading shifted by full turns to be nearest to another one [rad]."""
    return heading_rad + round((near_rad - heading_rad) / (2.0 * np.pi)) * 2.0 * np.pi


def _bring_near(run: Run, heading_rad: Values, rows: NDArray[np.int64]) -> Values:
    """Return headings [deg] shifted by full turns to be nearest to those of some poses."""
    signal = find_signal(run, "heading")
    measured = run.poses.heading_rad if signal is None else signal.values
    return np.degrees(measured[rows] + subtract_headings(heading_rad, measured[rows]))


def _find_in_stretches(
    values: NDArray[Any], length: int, find: Callable[..., Any]
) -> NDArray[np.int64]:
    """Return the row in each segment of a length that argmin or argmax finds, first of equals."""
    whole = len(values) // length * length
    rows = find(values[:whole].reshape(-1, length), axis=1)
    last = [find(values[whole:])] if whole < len(values) else []
    return np.arange(0, len(values), length) + np.append(rows, last).astype(np.int64)


def read_along_error(run: Run) -> Curve | None:
    """Return the robot's distance behind its moving reference along the track, at every pose [m].

    The result is None if no loop follows a reference along the track, or the path has no speed.
    """
    loops = [loop for loop in list_loops(run, "along_track") if loop.moves]
    along = find_signal(run, "along_track")
    reference = read_reference(run, loops[0]) if loops else None
    if along is None or not isinstance(reference, np.ndarray):
        return None
    values = reference - along.values
    return Curve(start_ns=run.start_ns, time_ns=along.time_ns, values=values)


_DRIVEN_BY: Final[Mapping[str, tuple[str, ...]]] = {
    **dict.fromkeys(("heading", "heading_error"), ("heading",)),
    **dict.fromkeys(("x", "y", "error_x", "error_y", "along_track"), ("along_track",)),
    **dict.fromkeys(("world_velocity_x", "world_velocity_y"), ("along_track",)),
    "distance": ("along_track", "distance"),
}
"""Signals of the loops that determine a curve's ideal response; along the line, all are equal."""

_ERRORS: Final = frozenset(
    {"heading_error", "error_x", "error_y", "distance", "world_velocity_x", "world_velocity_y"}
)


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopStep:
    """The step of a loop that theory can model.

    A heading's reference is shifted by full turns so that it is nearest to the value at the end.
    """

    loop: ControlLoop  # loop of the step
    kp: float  # proportional gain [1/s]
    start_ns: int  # start of the loop's first segment, in the run's time [ns]
    end_ns: int  # end of this segment with its pause [ns]
    initial: float  # value of the signal at the start of the segment [deg or m]
    reference: float  # reference of the signal [deg or m]

    def respond(
        self, time_s: ArrayLike, *, initial: float | None = None, target: float | None = None
    ) -> Values:
        """Return the ideal response at times from the start of the segment [s], shape (n,).

        `initial` and `target` belong to another signal that the loop drives, and have its unit.
        """
        return compute_step_response(
            self.kp,
            time_s,
            initial=self.initial if initial is None else initial,
            reference=self.reference if target is None else target,
        )


def find_steps(run: Run, signal_name: str) -> Iterator[LoopStep]:
    """Yield declared loops' steps with constant reference and known gain that theory can model."""
    signal = find_signal(run, signal_name)
    for loop in list_loops(run, signal_name):
        if loop.moves or not loop.has_theory:
            continue
        kp, stretch = loop.read_gain(run.parameters), find_first_stretch(run, loop)
        reference = read_reference(run, loop)
        if signal is None or kp is None or not stretch or not isinstance(reference, float):
            continue
        start_ns, end_ns = stretch[0].start_ns, stretch[-1].end_ns
        rows = np.searchsorted(signal.time_ns, [start_ns, end_ns])
        initial, last = signal.values[np.minimum(rows, len(signal.values) - 1)].tolist()
        if signal.kind.unit == "rad":
            reference += round((last - reference) / (2.0 * np.pi)) * 2.0 * np.pi
            initial, reference = float(np.degrees(initial)), float(np.degrees(reference))
        yield LoopStep(
            loop=loop, kp=kp, start_ns=start_ns, end_ns=end_ns, initial=initial, reference=reference
        )


def compute_ideals(run: Run, signal_name: str) -> list[Curve]:
    """Return the ideal responses of a signal for loops with the same gains.

    Each response starts with the value and time of its loop. There is none if no loop of theory
    drives the signal, the reference moves, or the gain or the goal is unknown.
    """
    measured = read_curve(run, signal_name)
    final = 0.0 if signal_name in _ERRORS else None
    if signal_name in ("x", "y") and run.goal_xy_m is not None:
        final = run.goal_xy_m["xy".index(signal_name)]
    if measured is None or (signal_name in ("x", "y") and final is None):
        return []
    found = []
    for step in (step for one in _DRIVEN_BY.get(signal_name, ()) for step in find_steps(run, one)):
        # An along-track loop brings others to their final values only if its aim is the goal.
        is_elsewhere = step.loop.signal == "along_track" != signal_name
        start_s = (step.start_ns - run.start_ns) / 1e9
        after = measured.time_s >= start_s
        if (is_elsewhere and step.loop.reference != "goal_distance") or not after.any():
            continue
        initial = float(measured.values[after][0])
        values = step.respond(measured.time_s[after] - start_s, initial=initial, target=final)
        found.append(Curve(start_ns=run.start_ns, time_ns=measured.time_ns[after], values=values))
    return found


def lack_samples(runs: Sequence[Run]) -> bool:
    """Return whether no run has samples of a controller: only poses, and at most commands."""
    return not any(len(run.samples) for run in runs)
