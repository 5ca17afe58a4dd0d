"""The argument of the metric functions: a run with the settings, and the values computed so far."""

import math
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final, Literal, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from turtlelog.arithmetic import SETTLING_BAND
from turtlelog.errors import MeasureError
from turtlelog.measure import rates
from turtlelog.measure.dead_time import find_dead_time
from turtlelog.measure.loop_segment import Aim, aim_at, find_row_from
from turtlelog.measure.metric import Missing
from turtlelog.measure.reductions import Values, compute_median, subtract_neighbours
from turtlelog.measure.references import (
    LastPose,
    compute_path_distances,
    read_heading_reference,
    read_reference,
)
from turtlelog.measure.response import Response, find_loop_samples, find_response
from turtlelog.measure.signals import Signal, find_signal
from turtlelog.run import Run, take_rows
from turtlelog.run.loops import ControlLoop, Declaration

if TYPE_CHECKING:
    from turtlelog.measure.pose_noise import WhiteNoise

_Value = TypeVar("_Value")

Target = float | Literal["reference", "last"]
"""Final value of a loop's step."""

MOST_TICKS: Final = 1000
"""Largest dead time for which the delayed ideal loop is computed [ticks]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasureSettings:
    """Settings of the metrics. Values of a loop are in rad (heading) or m.

    Attributes:
        band: Half-width of the settling band, as a fraction of the step, > 0 and < 1.
        initial: Start value of the step of a loop: None for the first value of its segment, a
            number, or a number by loop (`{"translate": 0.0}`).
        final: Final value of the step: `reference` (as the law declares), `last` (the last value of
            the segment), a number, or one of these by loop.
        reference_path_xy_m: Path for cross-track errors, a line through points in the world frame
            [m], shape (n, 2), n >= 2; None for the line from start to goal.
        goal_tolerance_m: Distance from the goal within which the robot has arrived [m], > 0; None
            for `band` times the initial distance.
        dead_time_ticks: Dead time of the delayed ideal loop, in samples of its period, 0 to 1000;
            None for the dead time found in the recording.

    Raises:
        MeasureError: If a setting is wrong; one line with the setting, the valid values and the
            given one.
    """

    band: float = SETTLING_BAND
    initial: float | Mapping[str, float] | None = None
    final: Target | Mapping[str, Target] = "reference"
    reference_path_xy_m: NDArray[np.float64] | None = None
    dead_time_ticks: int | None = None
    goal_tolerance_m: float | None = None

    def __post_init__(self) -> None:
        if not (_is_number(self.band) and 0.0 < self.band < 1.0):
            raise MeasureError(
                "band: must be a fraction of the step from 0 to 1, as 0.02 for 2 %, not"
                f" {self.band!r}"
            )
        _require_length(self.goal_tolerance_m)
        for value in _list_values(self.initial):
            if value is not None and not _is_number(value):
                raise MeasureError(f"initial: expected a number, found {value!r}")
        for value in _list_values(self.final):
            if value not in ("reference", "last") and not _is_number(value):
                raise MeasureError(
                    f"final: expected 'reference', 'last' or a number, found {value!r}"
                )
        ticks = self.dead_time_ticks
        if ticks is not None and not (isinstance(ticks, int) and 0 <= ticks <= MOST_TICKS):
            raise MeasureError(
                f"dead_time_ticks: expected a whole number from 0 to {MOST_TICKS}, found {ticks!r}"
            )
        if self.reference_path_xy_m is not None:
            path_xy_m = _require_path(self.reference_path_xy_m)
            object.__setattr__(self, "reference_path_xy_m", path_xy_m)

    def require_loops(self, declaration: Declaration) -> None:
        """Raise an error if a value is given for a loop that the law does not declare.

        Raises:
            MeasureError: If there is such a loop; the message lists the declared loops.
        """
        known = [loop.name for loop in declaration.loops]
        for name, value in (("initial", self.initial), ("final", self.final)):
            for loop in value if isinstance(value, Mapping) else ():
                if loop not in known:
                    listed = " or ".join(known) or "no loop, for the run declares none"
                    raise MeasureError(f"{name}: expected a loop {listed}, found {loop!r}")


def _require_length(near_m: float | None) -> None:
    if near_m is not None and not (_is_number(near_m) and near_m > 0.0):
        raise MeasureError(f"goal_tolerance_m: expected metres > 0, found {near_m!r}")


def _is_number(value: object) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and math.isfinite(cast("float", value))


def _list_values(value: object) -> list[object]:
    return list(value.values()) if isinstance(value, Mapping) else [value]


def _require_path(path_xy_m: NDArray[np.float64]) -> NDArray[np.float64]:
    try:
        path = np.array(path_xy_m, dtype=np.float64)
    except (TypeError, ValueError) as err:
        raise MeasureError("reference_path_xy_m: expected points, found something else") from err
    if path.ndim != 2 or path.shape[1] != 2 or len(path) < 2:
        raise MeasureError(
            f"reference_path_xy_m: expected two points or more, shape (n, 2), found {path.shape}"
        )
    if not np.isfinite(path).all():
        row = int((~np.isfinite(path)).any(axis=1).argmax())
        raise MeasureError(f"reference_path_xy_m[{row}]: expected finite numbers, found others")
    path.flags.writeable = False
    return path


class RunContext:
    """A run, the settings of its metrics, and the values computed so far."""

    memory: Final = None
    """Work arrays; None, because ordinary Python creates arrays as needed."""

    def __init__(self, run: Run, settings: MeasureSettings) -> None:
        self.run = run
        self.settings = settings
        self._known: dict[Hashable, object] = {}

    def recall(self, key: Hashable, compute: Callable[[], _Value]) -> _Value:
        """Return the value stored under a key; the first call computes the value."""
        if key not in self._known:
            self._known[key] = compute()
        return cast("_Value", self._known[key])

    def get_signal(self, name: str) -> Signal | None:
        """Return a signal of the run, or None if the run lacks it."""
        return self.recall(name, lambda: find_signal(self.run, name))

    def get_rates(self, axis: rates.Axis) -> rates.Rates | None:
        """Return the rate of the robot along an axis; None for a single pose."""
        return self.recall(
            ("rates", axis), lambda: rates.read_rates(self.run, axis, self.spaced_poses)
        )

    def get_commands(self, axis: rates.Axis) -> rates.HeldCommands | None:
        """Return the commands of an axis; None without commands, or for a single pose."""
        found = self.get_rates(axis)
        if len(self.run.poses) == 1:
            return None
        return self.recall(
            ("commands", axis), lambda: rates.read_held_commands(self.run, axis, found)
        )

    def get_response(self, loop: ControlLoop) -> Response | Missing:
        """Return the response of a loop to its reference, or the reason why there is none."""
        signal = self.get_signal(loop.signal)
        return self.recall(
            ("response", loop.name), lambda: find_response(self.run, loop, signal, self.settings)
        )

    @cached_property
    def spaced_poses(self) -> rates.SpacedPoses | None:
        """Poses far enough apart in time for differences; None for a single pose."""
        if len(self.run.poses) < 2:
            return None
        if self.run.poses.speed_m_s is not None:
            return rates.space_poses(self.run)
        from turtlelog.measure.breaks import find_jumps  # only poses of other robots jump

        return rates.space_poses(self.run, [jump.row for jump in find_jumps(self.run)])

    @cached_property
    def noise(self) -> "WhiteNoise | None":
        """Noise of the poses that are used for differences; None of a simulation."""
        if self.run.poses.speed_m_s is not None or self.spaced_poses is None:
            return None
        from turtlelog.measure.pose_noise import find_noise

        return find_noise(self.run, self.spaced_poses.rows)

    @cached_property
    def heading_reference_rad(self) -> float | Values | None:
        """Reference heading, as from `read_heading_reference`."""
        return read_heading_reference(self.run)

    @property
    def x_m(self) -> Values:
        """Coordinate x of every pose [m]."""
        return self.run.poses.xy_m[:, 0]

    @property
    def y_m(self) -> Values:
        """Coordinate y of every pose [m]."""
        return self.run.poses.xy_m[:, 1]

    @property
    def last_heading_rad(self) -> float:
        """Heading of the last pose, in [-pi, pi) [rad]."""
        return float(self.run.poses.heading_rad[-1])

    @cached_property
    def aim(self) -> Aim:
        """Goal, and the line to it from the start."""
        return aim_at(self.run.goal_line, self.run.goal_xy_m, self.run.goal_heading_rad)

    @property
    def last_pose(self) -> LastPose:
        """Last pose, with the last recorded reference of its heading."""
        x_m, y_m = map(float, self.run.poses.xy_m[-1])
        heading = self.get_signal("heading")
        assert heading is not None
        loops = [one for one in self.run.declaration.loops if one.signal == "heading"]
        found = (read_reference(self.run, loop) for loop in loops if loop.moves)
        recorded_rad = [float(one[-1]) for one in found if isinstance(one, np.ndarray)]
        return LastPose(
            x_m=x_m,
            y_m=y_m,
            heading_rad=self.last_heading_rad,
            unwrapped_rad=float(heading.values[-1]),
            reference_rad=recorded_rad[0] if recorded_rad else math.nan,
        )

    @property
    def goal(self) -> tuple[float, float, float]:
        """Goal: x, y [m] and heading [rad]; NaN if unknown."""
        x_m, y_m = self.run.goal_xy_m or (math.nan, math.nan)
        heading_rad = self.run.goal_heading_rad
        return x_m, y_m, math.nan if heading_rad is None else heading_rad

    @property
    def duration_s(self) -> float:
        """Time from the first sample, or first pose without samples, to the last row [s]."""
        return self.run.duration_s

    @property
    def first_row(self) -> int:
        """Row of the first pose at or after the first sample (time zero), or else the last row."""
        time_ns = self.run.poses.time_ns
        return find_row_from(time_ns, len(time_ns), self.run.start_ns)

    @property
    def goal_row(self) -> int:
        """Row of the pose from which the goal counts: when it was given, or else `first_row`."""
        return max(self.first_row, self.run.goal_row)

    @property
    def path_row(self) -> int:
        """Row from which the path or the line to the goal counts, as `goal_row`."""
        if self.settings.reference_path_xy_m is not None:
            return self.first_row
        return max(self.first_row, self.run.path_row)

    @property
    def last_pose_s(self) -> float:
        """Time of the last pose, from the first sample [s]."""
        return float(self.pose_time_s[-1])

    @property
    def last_cross_track_m(self) -> float:
        """Cross-track error of the last pose, positive to the left [m]; NaN if unknown."""
        signal = self.get_signal("cross_track")
        return math.nan if signal is None else float(signal.values[-1])

    @property
    def is_lawless_with_goal(self) -> bool:
        """Whether the controller is unknown, and the goal is known."""
        return self.run.is_lawless and self.run.goal_xy_m is not None

    @property
    def sample_count(self) -> int:
        """Number of samples; number of commands if there are no samples."""
        return len(self._sample_time_ns)

    @cached_property
    def pose_time_s(self) -> Values:
        """Times of the poses, from the first sample [s]."""
        return np.asarray((self.run.poses.time_ns - self.run.start_ns) / 1e9)

    @cached_property
    def sample_time_s(self) -> Values:
        """Times of samples from the first sample [s]; of commands if there are no samples."""
        return np.asarray((self._sample_time_ns - self.run.start_ns) / 1e9)

    @property
    def _sample_time_ns(self) -> NDArray[np.int64]:
        run = self.run
        return run.samples.time_ns if len(run.samples) else run.commands.time_ns

    @cached_property
    def command_time_s(self) -> Values:
        """Times at which commands were published, from the first sample [s]."""
        return np.asarray((self.run.commands.time_ns - self.run.start_ns) / 1e9)

    @cached_property
    def sample_period_s(self) -> Values:
        """Time from each sample to the next [s]."""
        return subtract_neighbours(self._sample_time_ns) / 1e9

    @cached_property
    def pose_period_s(self) -> Values:
        """Time from each pose to the next [s]."""
        return subtract_neighbours(self.run.poses.time_ns) / 1e9

    @cached_property
    def tick_s(self) -> float | None:
        """Median time between poses [s]; None for a single pose."""
        return compute_median(self.pose_period_s) if len(self.pose_period_s) else None

    @cached_property
    def loop_period_s(self) -> float | None:
        """Usual time between samples without bursts [s]; None if all times are 0."""
        periods_s = self.sample_period_s[self.sample_period_s > 0.0]
        return compute_median(periods_s) if len(periods_s) else None

    @cached_property
    def cross_track_m(self) -> Values:
        """Distance of every pose from the path, or to the left of the line to the goal [m].

        Empty if neither path nor line is known.
        """
        path_xy_m = self.settings.reference_path_xy_m
        if path_xy_m is not None:
            return compute_path_distances(self.run.poses.xy_m, path_xy_m)
        signal = self.get_signal("cross_track")
        return np.empty(0) if signal is None else signal.values

    def find_dead_time_ticks(self, loop: ControlLoop) -> int | Missing:
        """Return the dead time of a loop's commands [ticks], or the reason why it is unknown."""
        found = self.recall(
            ("dead_time", loop.name),
            lambda: find_dead_time(take_beginning(self.run, loop), loop, is_short=True),
        )
        return found if isinstance(found, Missing) else found.ticks


_MOST_SAMPLES: Final = 20_000
"""Largest number of samples of a loop in which its dead time is searched: five minutes of ticks."""


_EARLIER_SAMPLES: Final = 1000
"""Samples before the segment that are kept: more than can wait in any queue."""


def take_beginning(run: Run, loop: ControlLoop) -> Run:
    """Return the beginning of a run with at most 20,000 samples of a loop; or the whole run."""
    samples = run.samples
    if len(samples) <= _MOST_SAMPLES:
        return run
    stretch = find_loop_samples(run, loop)
    first = 0 if stretch is None else stretch.start
    rows = slice(max(first - _EARLIER_SAMPLES, 0), first + _MOST_SAMPLES)
    read = samples.pose_sequence[rows]
    poses = slice(int(read.min()), int(read.max()) + 1)
    kept = take_rows(samples, rows)
    return replace(
        run,
        poses=take_rows(run.poses, poses),
        samples=replace(kept, pose_sequence=np.asarray(read - poses.start)),
    )
