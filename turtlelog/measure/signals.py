"""The signals of a run by name: one table for metrics, comparison and pictures."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from operator import attrgetter
from types import MappingProxyType
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from turtlelog import display
from turtlelog.errors import MeasureError, describe_unknown
from turtlelog.libraries import load_library
from turtlelog.measure.loop_segment import find_distance
from turtlelog.measure.metric import Missing, Status
from turtlelog.measure.reductions import Values, subtract_neighbours
from turtlelog.measure.references import (
    hold_samples,
    project_on_line,
    read_heading_reference,
    recall,
    trace_poses,
)
from turtlelog.run import PoseColumns, Run, require_run
from turtlelog.run.angles import subtract_headings, unwrap_headings
from turtlelog.run.columns import Rebuilding, rebuild_value
from turtlelog.run.loops import STATE_PATTERN, Declaration


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalKind:
    """Definition of a signal.

    Attributes:
        unit: `m`, `rad`, `m/s`, `rad/s` or `1`.
        source: Rows of the values. `pose`: one value per pose row. `sample`: one per sample.
            `command`: one per published command, for runs without samples. `sensed pose`: one per
            sensed pose that did not drop out.
        resampling: `line`: linear interpolation; `hold`: the last value is held.
        compared_as: `number`; `angle`: differences in [-pi, pi); `label`: equal (0) or not (1).
        meaning: One sentence.
        read: Function from a run to the values; None if the run lacks them.
    """

    unit: str
    source: Literal["pose", "sample", "command", "sensed pose"]
    resampling: Literal["line", "hold"]
    compared_as: Literal["number", "angle", "label"] = "number"
    meaning: str
    read: Callable[[Run], Values | None]

    def __repr__(self) -> str:
        return display.fit_line(f"<SignalKind [{self.unit}]: {self.meaning}>")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Signal:
    """One signal of one run.

    Attributes:
        name: Name of the signal in the table.
        kind: Kind of the signal.
        time_ns: Time [ns], shape (n,), not decreasing.
        values: Values in the kind's unit, shape (n,).
        start_ns: Time zero of its run [ns].
    """

    name: str
    kind: SignalKind
    time_ns: NDArray[np.int64]
    values: Values
    start_ns: int = 0

    @property
    def unit(self) -> str:
        """Unit of the values."""
        return self.kind.unit

    @property
    def time_s(self) -> Values:
        """Time from the first sample of the run [s], shape (n,)."""
        return (self.time_ns - self.start_ns) / 1e9

    def to_pandas(self) -> Any:
        """Return the values as a `pandas.Series` over the time from the first sample [s].

        The `attrs` contain the `unit`.

        Raises:
            LibraryError: If pandas is not installed; turtlelog does not install it.
        """
        pd = load_library("pandas")
        index = pd.Index(self.time_s, name="time_s")
        series = pd.Series(self.values, index=index, name=self.name)
        series.attrs = {"unit": self.unit}
        return series

    def __array__(self, dtype: Any = None, *, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.values, dtype=dtype, copy=copy)

    def __reduce__(self) -> Rebuilding:
        # The function that reads a run cannot be pickled, and is no longer needed.
        return rebuild_value(self, kind=replace(self.kind, read=_read_nothing))

    def __len__(self) -> int:
        return len(self.values)

    def __iter__(self) -> Iterator[np.float64]:
        return iter(self.values)

    def __getitem__(self, rows: Any) -> Any:
        """Return values by row, as for an array."""
        return self.values[rows]

    def __repr__(self) -> str:
        return display.fit_line(f"<Signal {self.name}: {self._describe()}>")

    def _describe(self) -> str:
        count = display.describe_count(len(self), "value")
        if not np.isfinite(self.values).any():
            return f"{count} in {self.unit}"
        values = (float(np.nanmin(self.values)), float(np.nanmax(self.values)))
        ends = (display.format_number(value, self.unit) for value in values)
        return f"{count} in {self.unit}, {' to '.join(ends)}"

    def _repr_html_(self) -> str:
        rows = np.unique(np.linspace(0, max(0, len(self) - 1), _MOST_SHOWN).astype(int))
        curve = self.values[rows] if len(self) else self.values
        picture = display.format_curve_svg(curve.tolist(), label=f"{self.name} over time")
        answer = f"{self.name}: {self._describe()}. {self.kind.meaning}"
        return display.format_notebook(answer, picture)


_MOST_SHOWN: Final = 400
"""Largest number of values of the curve in a notebook: with more, values are less than a pixel
apart."""


def _read_nothing(_: Run) -> None:
    """Return None, because a pickled signal has no access to other runs."""


def could_be_signal(name: str) -> bool:
    """Return whether a name is the name of a signal, or could name a state of a law."""
    return name in SIGNALS or re.fullmatch(STATE_PATTERN, name) is not None


def list_signal_units(declarations: Iterable[Declaration]) -> dict[str, str]:
    """Return the units of the signals and states of some laws by name, signals first."""
    kinds = (list_signals(declaration).items() for declaration in declarations)
    return {name: kind.unit for found in kinds for name, kind in found}


def read_signal(run: Run, name: str) -> Signal:
    """Return a signal of a run.

    Raises:
        MeasureError: If no signal has that name, or the run lacks it; the message says why.
    """
    signal = find_signal(run, name)
    if signal is None:
        why = explain_no_signal(run, name)
        raise MeasureError(f"{run.name}: has no signal {name}{why and f': {why}'}")
    return signal


def find_signal(run: Run, name: str) -> Signal | None:
    """Return a signal of a run; None if the run lacks it.

    Raises:
        MeasureError: If no signal has that name.
    """
    require_run(run)
    kinds = list_signals(run.declaration)
    if name not in kinds:
        raise MeasureError(describe_unknown("signal", name, kinds, place="turtlelog list signals"))
    is_commanded = name in COMMANDED and not len(run.samples)
    kind = COMMANDED[name] if is_commanded else kinds[name]
    if is_commanded and find_no_commands(run, name):
        return None
    values = kind.read(run)
    if values is None or not len(values):
        return None
    time_ns = _TIMES[kind.source](run)
    return Signal(name=name, kind=kind, time_ns=time_ns, values=values, start_ns=run.start_ns)


def explain_no_signal(run: Run, name: str) -> str:
    """Return the reason why a run lacks a signal; empty if the name is sufficient."""
    kind = list_signals(run.declaration).get(name)
    if kind is not None and kind.source == "pose" and not len(run.poses):
        return "the recording holds no poses"
    if name in COMMANDED and not len(run.samples) and (missing := find_no_commands(run, name)):
        return missing.reason
    if name in {"error_x", "error_y", "distance"}:
        return "the goal is not known"
    if name in {"measured_speed", "measured_turn_rate"}:
        return "the robot reports no rates"
    if kind is not None and kind.source == "sample" and not len(run.samples):
        return "no samples of a controller were read"
    return ""


_COLUMNS: Final = {"speed": "speed_m_s", "turn_rate": "turn_rate_rad_s"}


def find_no_commands(run: Run, axis: str) -> Missing | None:
    """Return the reason why a run has no commands of an axis; None if it has commands."""
    if len(run.commands) and f"commands.{_COLUMNS[axis]}" not in run.absent:
        return None
    of = f" of the {axis.replace('_', ' ')}" if len(run.commands) else ""
    return Missing(Status.ABSENT, f"the recording holds no commands{of}")


@lru_cache(maxsize=64)
def list_signals(declaration: Declaration) -> Mapping[str, SignalKind]:
    """Return every signal that runs of a law can contain, by name: `SIGNALS`, then its states."""
    states = {
        name: replace(
            _sample(declaration.state_units.get(name, "1"), f"State {name} of the law.", "states"),
            read=partial(_read_state, column=column),
        )
        for column, name in enumerate(declaration.states)
    }
    return MappingProxyType({**SIGNALS, **states})


def _read_state(run: Run, column: int) -> Values | None:
    return None if run.samples.states is None else run.samples.states[:, column]


def _read_track(run: Run, *, along: bool) -> Values | None:
    """Return a coordinate along or left of the path, or of the line from start to goal."""
    path = run.path
    if path is not None:
        return trace_poses(run, path)[0 if along else 1]
    line = run.goal_line
    return None if line is None else project_on_line(run.poses.xy_m, line, along=along)


def _read_sensed(run: Run, axis: int) -> Values | None:
    xy_m = run.poses.sensed_xy_m
    return None if xy_m is None else xy_m[~run.poses.dropped_out, axis]


def _read_sensed_heading(run: Run) -> Values | None:
    """Return the sensed heading within half a turn of the true one, so that noise adds no turn."""
    if run.poses.sensed_heading_rad is None:
        return None
    rows = ~run.poses.dropped_out
    sensed_rad, heading_rad = run.poses.sensed_heading_rad[rows], unwrap_headings(run.poses)[rows]
    return heading_rad + subtract_headings(sensed_rad, heading_rad)


_SIGN_S: Final = 0.5
"""Time over which the poses give the sign of a speed [s]: in it, noise of poses hardly adds."""

_FEWEST_POSES: Final = 10

_BACK: Final = 0.05
"""Smallest share of the reported way that leads back, and that leads ahead, if speeds have no sign.
Where all leads back, the heading may be turned."""

_DRIVEN: Final = 0.7
"""Smallest share of the reported way back that the poses show, and of the shown way that is
reported: noise shows less, or more."""


def sign_speeds(run: Run) -> Values | None:
    """Return the reported speeds with the sign of the motion, if they have none; else None."""
    return recall(run, "signed_speeds", lambda: _sign_speeds(run.poses))


def _sign_speeds(poses: PoseColumns) -> Values | None:
    speed_m_s, time_s = poses.measured_speed_m_s, poses.time_ns / 1e9
    if speed_m_s is None or len(poses) < _FEWEST_POSES or float(speed_m_s.min()) < 0.0:
        return None
    means_m_s = (speed_m_s[1:] + speed_m_s[:-1]) / 2.0
    driven_m = np.append(0.0, np.cumsum(means_m_s * subtract_neighbours(time_s)))
    x_m, y_m, way_m = (
        np.interp(time_s + _SIGN_S / 2.0, time_s, at)
        - np.interp(time_s - _SIGN_S / 2.0, time_s, at)
        for at in (*poses.xy_m.T, driven_m)
    )
    ahead_m = x_m * np.cos(poses.heading_rad) + y_m * np.sin(poses.heading_rad)
    is_back, whole_m = ahead_m < 0.0, float(way_m.sum())
    back_m = float(way_m[is_back].sum())
    if not _BACK * whole_m < back_m < (1.0 - _BACK) * whole_m:
        return None
    shown = -float(ahead_m[is_back].sum()) / back_m
    is_driven = _DRIVEN <= shown <= 1.0 / _DRIVEN
    return np.where(is_back, -speed_m_s, speed_m_s) if is_driven else None


_TIMES: Final[Mapping[str, Callable[[Run], NDArray[np.int64]]]] = MappingProxyType(
    {
        "pose": lambda run: run.poses.time_ns,
        "sample": lambda run: run.samples.time_ns,
        "command": lambda run: run.commands.time_ns,
        "sensed pose": lambda run: run.poses.time_ns[~run.poses.dropped_out],
    }
)
"""Times of a signal's values by its source."""


def _read_error(run: Run, axis: int) -> Values | None:
    return None if run.goal_xy_m is None else run.goal_xy_m[axis] - run.poses.xy_m[:, axis]


def _read_distance(run: Run) -> Values | None:
    if run.goal_xy_m is None:
        return None
    x_m, y_m = run.poses.xy_m.T
    return np.asarray(find_distance(x_m, y_m, *run.goal_xy_m))


def _read_heading_error(run: Run) -> Values | None:
    reference = read_heading_reference(run)
    if reference is not None:
        return subtract_headings(reference, run.poses.heading_rad)
    # The samples of an unknown controller do not tell whether it still updates its error.
    recorded = None if "declaration" in run.absent else run.samples.heading_error_rad
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


def _sensed(unit: str, meaning: str, read: Callable[[Run], Values | None]) -> SignalKind:
    """Return the kind of a signal that is held until the next pose arrives at the controller."""
    return replace(_pose(unit, meaning, read), source="sensed pose", resampling="hold")


def _applied(unit: str, meaning: str, column: str) -> SignalKind:
    return replace(_pose(unit, meaning, attrgetter(f"poses.{column}")), resampling="hold")


def _sample(unit: str, meaning: str, column: str) -> SignalKind:
    read = attrgetter(f"samples.{column}")
    return SignalKind(unit=unit, source="sample", resampling="hold", meaning=meaning, read=read)


SIGNALS: Final[Mapping[str, SignalKind]] = display.NamedValues(
    "signal",
    {
        "x": _pose("m", "Coordinate x in the world frame.", lambda run: run.poses.xy_m[:, 0]),
        "y": _pose("m", "Coordinate y in the world frame.", lambda run: run.poses.xy_m[:, 1]),
        "heading": _pose(
            "rad",
            "Heading, counter-clockwise from the x axis, without jumps at a full turn.",
            lambda run: unwrap_headings(run.poses),
        ),
        "speed": _sample("m/s", "Commanded speed along the heading, after clipping.", "speed_m_s"),
        "turn_rate": _sample("rad/s", "Commanded turn rate, after clipping.", "turn_rate_rad_s"),
        "wanted_speed": _sample("m/s", "Commanded speed before clipping.", "wanted_speed_m_s"),
        "wanted_turn_rate": _sample(
            "rad/s", "Commanded turn rate before clipping.", "wanted_turn_rate_rad_s"
        ),
        "shaped_speed": _sample(
            "m/s", "Commanded speed after shaping, before the limits.", "shaped_speed_m_s"
        ),
        "shaped_turn_rate": _sample(
            "rad/s",
            "Commanded turn rate after shaping, before the limits.",
            "shaped_turn_rate_rad_s",
        ),
        "applied_speed": _applied(
            "m/s",
            "Magnitude of the speed that the plant integrated, including a disturbance.",
            "speed_m_s",
        ),
        "applied_turn_rate": _applied(
            "rad/s",
            "Turn rate that the plant integrated, including a disturbance.",
            "turn_rate_rad_s",
        ),
        "measured_speed": _applied(
            "m/s", "Forward speed that the robot reports, negative backward.", "measured_speed_m_s"
        ),
        "measured_turn_rate": _applied(
            "rad/s", "Turn rate that the robot reports.", "measured_turn_rate_rad_s"
        ),
        "sensed_x": _sensed(
            "m", "Coordinate x that the controller reads.", lambda run: _read_sensed(run, 0)
        ),
        "sensed_y": _sensed(
            "m", "Coordinate y that the controller reads.", lambda run: _read_sensed(run, 1)
        ),
        "sensed_heading": _sensed(
            "rad",
            "Heading that the controller reads, within half a turn of the signal `heading`.",
            _read_sensed_heading,
        ),
        **{
            f"error_{axis}": _pose(
                "m",
                f"Coordinate {axis} of goal minus position, in the world frame.",
                partial(_read_error, axis=column),
            )
            for column, axis in enumerate("xy")
        },
        "distance": _pose("m", "Distance to the goal.", _read_distance),
        "heading_error": _pose(
            "rad",
            "Reference heading minus heading while a heading loop acts, in [-pi, pi); without such"
            " a loop, the error that a known law recorded.",
            _read_heading_error,
        ),
        "along_track": _pose(
            "m",
            "Distance from the start along the line from start to goal; where the law tracks a"
            " path, the arc length of its nearest point.",
            lambda run: _read_track(run, along=True),
        ),
        "cross_track": _pose(
            "m",
            "Distance from the line from start to goal, or from the path that the law tracks;"
            " positive to the left.",
            lambda run: _read_track(run, along=False),
        ),
        "phase": SignalKind(
            unit="1",
            source="sample",
            resampling="hold",
            compared_as="label",
            meaning="Index of the sample's phase among the phases that the law declares.",
            read=lambda run: run.samples.phase.astype(np.float64),
        ),
    },
)
"""Every signal by name."""

COMMANDED: Final[Mapping[str, SignalKind]] = MappingProxyType(
    {
        name: replace(SIGNALS[name], source="command", read=attrgetter(f"commands.{column}"))
        for name, column in _COLUMNS.items()
    }
)
"""Signals of a run without samples: the published commands, from the first command on."""
