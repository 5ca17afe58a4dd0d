"""The signals of a run by name, and what the loops of a law should follow.

The table of signals is the one that metrics, comparison and pictures share. The reference of a
loop, at every pose:

| reference | of the signal heading | of the other signals |
|---|---|---|
| `goal_bearing` | direction of the line from start to goal | |
| `bearing_now` | bearing of the goal from the present position | |
| `goal_heading` | heading that the goal asks for | |
| `goal_distance` | | along-track: length of that line |
| `zero` | 0 | 0 |
| `path` | heading of the recorded pose | along-track: its arc length by time; cross-track: 0 |
| `recorded` | heading of the recorded pose | its projection on that line; distance: 0 |
"""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from types import MappingProxyType
from typing import Final, Literal
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from turtlelog.angles import subtract_headings
from turtlelog.display import NamedValues
from turtlelog.errors import MeasureError, suggest_names
from turtlelog.loops import STATE_PATTERN, ControlLoop, Declaration
from turtlelog.measure.path import trace_path
from turtlelog.paths import Path
from turtlelog.run import GoalLine, Run

Values = NDArray[np.float64]


def read_reference(run: Run, loop: ControlLoop) -> float | Values | None:
    """Return the reference of a loop [rad or m]: a number where it is constant.

    Otherwise one value per pose, shape (n,), that of a sample held until the next. None where the
    run does not hold it.
    """
    line, reference = run.goal_line, loop.reference
    if reference in {"path", "recorded"}:
        return _read_path(run, loop) if reference == "path" else _read_recorded(run, loop, line)
    match reference:
        case "goal_bearing":
            return None if line is None else line.bearing_rad
        case "goal_distance":
            return None if line is None else line.length_m
        case "goal_heading":
            return run.goal_heading_rad
        case "bearing_now":
            return _read_bearings(run)
    return 0.0


def read_heading_reference(run: Run) -> float | Values | None:
    """Return what the heading should be: the reference of the loop that acts, or acted last [rad].

    Before any acts, that of the first to act; where none ever does, of the first that is declared.
    A number where it is constant, else one value per pose. None without a loop of the heading.
    """
    declared = [loop for loop in run.declaration.loops if loop.signal == "heading"]
    loops = [(loop, read_reference(run, loop)) for loop in declared]
    known = [(loop, found) for loop, found in loops if found is not None]
    if not known:
        return None
    if len(known) == 1:
        return known[0][1]
    acting = find_acting(run, tuple(loop for loop, _ in known))
    rows = len(run.poses)
    columns = np.array([np.broadcast_to(found, (rows,)) for _, found in known])
    return np.asarray(columns[acting, np.arange(rows)])


def find_acting(run: Run, loops: tuple[ControlLoop, ...]) -> NDArray[np.int64]:
    """Return the index of the loop that acts at every pose, or acted last, shape (n,)."""
    names = run.phase_names
    of_phase = np.full(len(names), -1)
    for number, phase in enumerate(names):
        acts = run.declaration.phases.get(phase, ())
        found = [index for index, loop in enumerate(loops) if loop.name in acts]
        of_phase[number] = found[0] if found else -1
    of_sample = of_phase[run.samples.phase]
    acting = np.flatnonzero(of_sample >= 0)
    if not len(acting):
        return np.zeros(len(run.poses), dtype=np.int64)
    latest = _find_latest(run, acting)
    return np.asarray(of_sample[acting[latest]])


def hold_samples(run: Run, values: Values) -> Values:
    """Return what the last sample that read each pose, or one before, recorded, shape (n,)."""
    return np.asarray(values[_find_latest(run, np.arange(len(run.samples)))])


def _find_latest(run: Run, samples: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return which of some samples was the last to read each pose or one before, shape (n,)."""
    read = np.maximum.accumulate(run.samples.pose_sequence[samples])
    latest = np.searchsorted(read, np.arange(len(run.poses)), side="right") - 1
    return np.asarray(np.maximum(latest, 0))


def _read_bearings(run: Run) -> Values | None:
    if run.goal_xy_m is None:
        return None
    ahead_m, left_m = (
        goal - column for goal, column in zip(run.goal_xy_m, run.poses.xy_m.T, strict=True)
    )
    return np.asarray(np.arctan2(left_m, ahead_m))


def _read_recorded(run: Run, loop: ControlLoop, line: GoalLine | None) -> float | Values | None:
    xy_m, heading_rad = run.samples.reference_xy_m, run.samples.reference_heading_rad
    if xy_m is None or heading_rad is None:
        return None
    if loop.signal == "distance":
        return 0.0
    if loop.signal == "heading":
        return hold_reference(run, heading_rad)
    held_xy_m = None if line is None else hold_reference(run, xy_m)
    if held_xy_m is None or line is None:
        return None
    return project_on_line(held_xy_m, line, along=loop.signal == "along_track")


def _read_path(run: Run, loop: ControlLoop) -> Values | None:
    """Return what the path asks for at every pose; an arc length only where time belongs to it."""
    path = run.path
    if path is None:
        return None
    if loop.signal == "cross_track":
        return np.zeros(len(run.poses))
    if loop.signal == "heading":
        return hold_reference(run, run.samples.reference_heading_rad)
    return None if path.speed_m_s is None else _trace_reference(run, path)


def _trace_reference(run: Run, path: Path) -> Values | None:
    """Return the arc length of the recorded reference at every pose [m]."""
    held_xy_m = hold_reference(run, run.samples.reference_xy_m)
    if held_xy_m is None:
        return None
    first_m = _find_first_arc(run, path)
    return _recall(run, "reference", lambda: trace_path(path, held_xy_m, first_m or 0.0))[0]


def _trace_poses(run: Run, path: Path) -> tuple[Values, Values]:
    """Return the arc length of the point nearest to every pose, and the distance from there [m]."""
    due_m = None if path.speed_m_s is None else _trace_reference(run, path)
    first_m = _find_first_arc(run, path)
    return _recall(run, "poses", lambda: trace_path(path, run.poses.xy_m, first_m, due_m))


def _find_first_arc(run: Run, path: Path) -> float | None:
    """Return the arc length of the first reference where the first sample is lost [m].

    None where it is not: then the robot still has to come to the path.
    """
    samples = run.samples
    if samples.reference_xy_m is None or not len(samples) or samples.sequence[0] == 0:
        return None
    assert samples.reference_heading_rad is not None
    x_m, y_m = map(float, samples.reference_xy_m[0])
    return path.find_point((x_m, y_m, float(samples.reference_heading_rad[0])))


_TRACES: Final[WeakKeyDictionary[Run, dict[str, tuple[Values, Values]]]] = WeakKeyDictionary()
"""Where poses and references of a run are on its path, found row by row, while the run is kept."""


def _recall(
    run: Run, what: str, trace: Callable[[], tuple[Values, Values]]
) -> tuple[Values, Values]:
    known = _TRACES.setdefault(run, {})
    if what not in known:
        known[what] = trace()
    return known[what]


def hold_reference(run: Run, column: Values | None) -> Values | None:
    """Return the part of the recorded reference pose that holds at each pose, None without one."""
    if column is None:
        return None
    rows = np.flatnonzero(np.isfinite(column if column.ndim == 1 else column[:, 0]))
    return np.asarray(column[rows[_find_latest(run, rows)]]) if len(rows) else None


def read_controlled_distance(run: Run) -> Values | None:
    """Return the distance of every pose to the recorded reference pose [m]."""
    held_xy_m = hold_reference(run, run.samples.reference_xy_m)
    if held_xy_m is None:
        return None
    away_m = held_xy_m - run.poses.xy_m
    return np.asarray(np.hypot(away_m[:, 0], away_m[:, 1]))


def project_on_line(xy_m: Values, line: GoalLine, *, along: bool) -> Values:
    """Return the coordinate of points along, or to the left of, the line from start to goal [m]."""
    # As frames.rotate_to_turtle, for the one of the two that is asked for.
    x_m, y_m = (column - start for column, start in zip(xy_m.T, line.start_xy_m, strict=True))
    cos, sin = np.cos(line.bearing_rad), np.sin(line.bearing_rad)
    return np.asarray(x_m * cos + y_m * sin if along else y_m * cos - x_m * sin)


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalKind:
    """What a signal is.

    Attributes:
        unit: `m`, `rad`, `m/s`, `rad/s` or `1`.
        source: `pose`: one value per pose row; `sample`: one per sample.
        resampling: `line` between values, or `hold` of the last one.
        compared_as: `number`; `angle`: differences in [-pi, pi); `label`: equal (0) or not (1).
        meaning: One sentence.
        read: From a run to the values, None where the run does not hold them.
    """

    unit: str
    source: Literal["pose", "sample"]
    resampling: Literal["line", "hold"]
    compared_as: Literal["number", "angle", "label"] = "number"
    meaning: str
    read: Callable[[Run], Values | None]

    def __repr__(self) -> str:
        return f"<SignalKind [{self.unit}]: {self.meaning}>"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Signal:
    """One signal of one run.

    Attributes:
        name: Its name in the table.
        kind: What it is.
        time_ns: Time [ns], shape (n,), not decreasing.
        values: In the kind's unit, shape (n,).
    """

    name: str
    kind: SignalKind
    time_ns: NDArray[np.int64]
    values: Values

    def __repr__(self) -> str:
        return f"<Signal {self.name}: {len(self.values)} values in {self.kind.unit}>"


def could_be_signal(name: str) -> bool:
    """Return whether a name is that of a signal, or could be that of some law's state."""
    return name in SIGNALS or re.fullmatch(STATE_PATTERN, name) is not None


def list_signal_units(declarations: Iterable[Declaration]) -> dict[str, str]:
    """Return the units of the signals and states of some laws by name, signals first."""
    return {
        name: kind.unit
        for declaration in declarations
        for name, kind in list_signals(declaration).items()
    }


def read_signal(run: Run, name: str) -> Signal | None:
    """Return a signal of a run, None where the run does not hold it.

    Raises:
        MeasureError: Where no signal has that name.
    """
    kinds = list_signals(run.declaration)
    if name not in kinds:
        raise MeasureError(f"signal {name!r}: expected {suggest_names(name, kinds)}")
    kind = kinds[name]
    values = kind.read(run)
    if values is None or (kind.source == "sample" and not len(run.samples)):
        return None
    time_ns = run.poses.time_ns if kind.source == "pose" else run.samples.time_ns
    return Signal(name=name, kind=kind, time_ns=time_ns, values=values)


@lru_cache(maxsize=64)
def list_signals(declaration: Declaration) -> Mapping[str, SignalKind]:
    """Return every signal that runs of a law can hold, by name: `SIGNALS`, then its states."""
    states = {
        name: _sample("1", f"State {name} of the law.", partial(_read_state, column=column))
        for column, name in enumerate(declaration.states)
    }
    return MappingProxyType({**SIGNALS, **states})


def _read_state(run: Run, column: int) -> Values | None:
    return None if run.samples.states is None else run.samples.states[:, column]


def _read_track(run: Run, *, along: bool) -> Values | None:
    """Return a coordinate along, or left of, the path or the line from first pose read to goal."""
    path = run.path
    if path is not None:
        return _trace_poses(run, path)[0 if along else 1]
    line = run.goal_line
    return None if line is None else project_on_line(run.poses.xy_m, line, along=along)


def _read_heading(run: Run) -> Values:
    """Return the heading counted through full turns."""
    heading_rad = run.poses.heading_rad
    jumps = np.abs(np.diff(heading_rad)) > np.pi
    return np.unwrap(heading_rad) if jumps.any() else heading_rad


def _read_error(run: Run, axis: int) -> Values | None:
    return None if run.goal_xy_m is None else run.goal_xy_m[axis] - run.poses.xy_m[:, axis]


def _read_distance(run: Run) -> Values | None:
    if run.goal_xy_m is None:
        return None
    x_m, y_m = (goal - column for goal, column in zip(run.goal_xy_m, run.poses.xy_m.T, strict=True))
    return np.asarray(np.hypot(x_m, y_m))


def _read_heading_error(run: Run) -> Values | None:
    reference = read_heading_reference(run)
    if reference is not None:
        return subtract_headings(reference, run.poses.heading_rad)
    recorded = run.samples.heading_error_rad
    return None if recorded is None or not len(recorded) else hold_samples(run, recorded)


def _pose(unit: str, meaning: str, read: Callable[[Run], Values | None]) -> SignalKind:
    return SignalKind(
        unit=unit,
        source="pose",
        resampling="line",
        compared_as="angle" if unit == "rad" else "number",
        meaning=meaning,
        read=read,
    )


def _sample(unit: str, meaning: str, read: Callable[[Run], Values | None]) -> SignalKind:
    return SignalKind(unit=unit, source="sample", resampling="hold", meaning=meaning, read=read)


SIGNALS: Final[Mapping[str, SignalKind]] = NamedValues(
    "signal",
    {
        "x": _pose("m", "Position in the world frame.", lambda run: run.poses.xy_m[:, 0]),
        "y": _pose("m", "Position in the world frame.", lambda run: run.poses.xy_m[:, 1]),
        "heading": _pose(
            "rad",
            "Counter-clockwise from +x, without jumps at a full turn.",
            _read_heading,
        ),
        "speed": _sample(
            "m/s",
            "Commanded speed along the heading, after clipping.",
            lambda run: run.samples.speed_m_s,
        ),
        "turn_rate": _sample(
            "rad/s", "Commanded turn rate, after clipping.", lambda run: run.samples.turn_rate_rad_s
        ),
        "wanted_speed": _sample(
            "m/s", "Commanded speed before clipping.", lambda run: run.samples.wanted_speed_m_s
        ),
        "wanted_turn_rate": _sample(
            "rad/s",
            "Commanded turn rate before clipping.",
            lambda run: run.samples.wanted_turn_rate_rad_s,
        ),
        "error_x": _pose(
            "m", "Goal minus position in the world frame.", lambda run: _read_error(run, 0)
        ),
        "error_y": _pose(
            "m", "Goal minus position in the world frame.", lambda run: _read_error(run, 1)
        ),
        "distance": _pose("m", "Distance to the goal.", _read_distance),
        "heading_error": _pose(
            "rad",
            "Reference of the heading loop that acts minus heading, in [-pi, pi); without such a"
            " loop, what the law recorded.",
            _read_heading_error,
        ),
        "along_track": _pose(
            "m",
            "Along the line from start to goal, from the start; where the law tracks a path, the"
            " arc length of its nearest point.",
            lambda run: _read_track(run, along=True),
        ),
        "cross_track": _pose(
            "m",
            "To the left of the line from start to goal, or of the path that the law tracks.",
            lambda run: _read_track(run, along=False),
        ),
        "phase": SignalKind(
            unit="1",
            source="sample",
            resampling="hold",
            compared_as="label",
            meaning="Index of the sample's phase among those that its law declares.",
            read=lambda run: run.samples.phase.astype(np.float64),
        ),
    },
)
"""Every signal by name."""
