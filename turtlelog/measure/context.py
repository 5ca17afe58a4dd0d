"""One run on its way through the table of metrics: what several of them need is computed once."""

import math
from collections.abc import Callable, Hashable
from dataclasses import replace
from functools import cached_property
from typing import Final, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from turtlelog.measure.dead_time import DeadTime, find_dead_time
from turtlelog.measure.measure_settings import MeasureSettings
from turtlelog.measure.metric import Missing, Status
from turtlelog.measure.outliers import compute_median
from turtlelog.measure.path import compute_path_distances, compute_path_length
from turtlelog.measure.rates import Axis, HeldCommands, Rates, read_held_commands, read_rates
from turtlelog.measure.references import read_heading_reference
from turtlelog.measure.response import Response, find_loop_samples, find_response
from turtlelog.measure.signals import Signal, find_signal
from turtlelog.run import Run, take_rows
from turtlelog.run.loops import ControlLoop

Values = NDArray[np.float64]
_Value = TypeVar("_Value")

_MOST_SAMPLES: Final = 20_000
"""As much of a loop's stretch as its dead time is looked for in: five minutes of ticks."""

_WHITE: Final = 0.5
"""The least whiteness of noise, whose own is 1: a lag leaves a curve, below 0.1."""


class RunContext:
    """A run, the settings it is measured with, and what has been computed of it so far.

    Attributes:
        run: What is measured.
        settings: What was chosen.
    """

    def __init__(self, run: Run, settings: MeasureSettings) -> None:
        self.run = run
        self.settings = settings
        self._known: dict[Hashable, object] = {}

    def recall(self, key: Hashable, compute: Callable[[], _Value]) -> _Value:
        """Return what was computed under a key, and compute it the first time."""
        if key not in self._known:
            self._known[key] = compute()
        return cast("_Value", self._known[key])

    def get_signal(self, name: str) -> Signal | None:
        """Return a signal of the run, None where the run does not hold it."""
        return self.recall(name, lambda: find_signal(self.run, name))

    def get_rates(self, axis: Axis) -> Rates | None:
        """Return how fast the robot moved along an axis; None for one pose."""
        return self.recall(("rates", axis), lambda: read_rates(self.run, axis))

    def get_commands(self, axis: Axis) -> HeldCommands | None:
        """Return what was commanded of an axis; None without commands, or for one pose."""
        rates = self.get_rates(axis)
        if len(self.run.poses) == 1:
            return None
        return self.recall(("commands", axis), lambda: read_held_commands(self.run, axis, rates))

    def get_response(self, loop: ControlLoop) -> Response | Missing:
        """Return how a loop answers its reference, or why there is no such thing."""
        return self.recall(
            loop, lambda: find_response(self.run, loop, self.get_signal(loop.signal), self.settings)
        )

    @cached_property
    def heading_reference_rad(self) -> float | Values | None:
        """What the heading should be, as `read_heading_reference`."""
        return read_heading_reference(self.run)

    @property
    def x_m(self) -> Values:
        """Of every pose [m]."""
        return self.run.poses.xy_m[:, 0]

    @property
    def y_m(self) -> Values:
        """Of every pose [m]."""
        return self.run.poses.xy_m[:, 1]

    @property
    def last_heading_rad(self) -> float:
        """Of the last pose, in [-pi, pi) [rad]."""
        return float(self.run.poses.heading_rad[-1])

    @property
    def goal(self) -> tuple[float, float, float]:
        """Where the robot should be: x, y [m] and heading [rad], NaN where it is not known."""
        x_m, y_m = self.run.goal_xy_m or (math.nan, math.nan)
        heading_rad = self.run.goal_heading_rad
        return x_m, y_m, math.nan if heading_rad is None else heading_rad

    @property
    def duration_s(self) -> float:
        """From the first sample, or else pose, to the last row [s]."""
        return self.run.duration_s

    @property
    def first_row(self) -> int:
        """The first pose at the first sample, which is time zero, or later; else the last."""
        first = int(np.searchsorted(self.run.poses.time_ns, self.run.start_ns))
        return min(first, len(self.run.poses) - 1)

    @property
    def last_pose_s(self) -> float:
        """Time of the last pose, from the first sample [s]."""
        return float(self.pose_time_s[-1])

    @property
    def last_cross_track_m(self) -> float:
        """Of the last pose, to the left of the line or path [m]; NaN where neither is known."""
        signal = self.get_signal("cross_track")
        return math.nan if signal is None else float(signal.values[-1])

    @property
    def is_robot(self) -> bool:
        """Whether nothing is known but poses and a goal."""
        run = self.run
        is_lawless = not run.declaration.loops and not len(run.samples)
        return is_lawless and run.goal_xy_m is not None

    @property
    def sample_count(self) -> int:
        """How many samples there are; commands where there are none."""
        return len(self._sample_time_ns)

    @property
    def memory(self) -> None:
        """Plain functions make the arrays that they need."""
        return

    @cached_property
    def pose_time_s(self) -> Values:
        """Times of the poses, from the first sample [s]."""
        return np.asarray((self.run.poses.time_ns - self.run.start_ns) / 1e9)

    @cached_property
    def sample_time_s(self) -> Values:
        """Times of the samples, from the first [s]; of the commands where there are no samples."""
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
        return np.diff(self._sample_time_ns) / 1e9

    @cached_property
    def pose_period_s(self) -> Values:
        """Time from each pose to the next [s]."""
        return np.diff(self.run.poses.time_ns) / 1e9

    @cached_property
    def tick_s(self) -> float | None:
        """Time from pose to pose that is most usual, their median [s]; None for one pose."""
        return compute_median(self.pose_period_s) if len(self.pose_period_s) else None

    @cached_property
    def loop_period_s(self) -> float | None:
        """Time from sample to sample that is most usual, bursts aside [s]; None where all are 0."""
        periods_s = self.sample_period_s[self.sample_period_s > 0.0]
        return compute_median(periods_s) if len(periods_s) else None

    @cached_property
    def path_length_m(self) -> float:
        """Length of the line through all poses [m]."""
        return compute_path_length(self.run.poses.xy_m)

    @cached_property
    def cross_track_m(self) -> Values:
        """Distance of every pose from the reference path, or to the left of the line to the goal.

        In m, empty where neither is known.
        """
        path_xy_m = self.settings.reference_path_xy_m
        if path_xy_m is not None:
            return compute_path_distances(self.run.poses.xy_m, path_xy_m)
        signal = self.get_signal("cross_track")
        return np.empty(0) if signal is None else signal.values

    def find_dead_time_ticks(self, loop: ControlLoop) -> int | Missing:
        """Return the dead time of a loop's commands [ticks], or why it cannot be found."""
        found = self.recall(("dead_time", loop), lambda: self._find_dead_time(loop))
        return found if isinstance(found, Missing) else found.ticks

    def _find_dead_time(self, loop: ControlLoop) -> DeadTime | Missing:
        found = find_dead_time(take_beginning(self.run, loop, _MOST_SAMPLES), loop, is_short=True)
        if isinstance(found, Missing) or found.whiteness > _WHITE:
            return found
        reason = (
            f"no single dead time explains the motion, {found.ticks} ticks are the nearest: what"
            " they leave is no noise, as where the robot has a lag"
        )
        return Missing(status=Status.UNDETERMINED, reason=reason)


_EARLIER_SAMPLES: Final = 1000
"""Samples before the stretch that are kept: more than can still wait in any queue."""


def take_beginning(run: Run, loop: ControlLoop, most_samples: int) -> Run:
    """Return a run with no more than that many samples of a loop, and few before it.

    A run that is no longer than that comes back as it is.
    """
    samples = run.samples
    if len(samples) <= most_samples:
        return run
    stretch = find_loop_samples(run, loop)
    first = 0 if stretch is None else stretch.start
    rows = slice(max(first - _EARLIER_SAMPLES, 0), first + most_samples)
    read = samples.pose_sequence[rows]
    poses = slice(int(read.min()), int(read.max()) + 1)
    kept = take_rows(samples, rows)
    return replace(
        run,
        poses=take_rows(run.poses, poses),
        samples=replace(kept, pose_sequence=np.asarray(read - poses.start)),
    )
