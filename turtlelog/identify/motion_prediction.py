"""Where a robot's model leads with recorded commands, against where the robot went."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from turtlelog.angles import subtract_headings, wrap_angle
from turtlelog.errors import IdentifyError
from turtlelog.identify.axis_motion import Axis, get_commands, measure_steps, read_axis_motion
from turtlelog.identify.held_response import LaggedResponse, Values, limit_changes
from turtlelog.identify.robot_model import AxisModel, RobotModel
from turtlelog.run import Run

HORIZONS_S: Final = (1.0, 5.0)
"""For how long a motion is predicted before it is anchored anew [s]."""


_JOINED_S: Final = 0.1
"""Over what rates are averaged to be shown [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PredictionError:
    """How far the model is off after a time, over many beginnings.

    Attributes:
        horizon_s: That time [s].
        count: Beginnings, one right after the other.
        median_m: Median distance between predicted and recorded position [m].
        largest_m: The largest [m].
        median_rad: Median difference of the headings [rad].
        largest_rad: The largest [rad].
    """

    horizon_s: float
    count: int
    median_m: float
    largest_m: float
    median_rad: float
    largest_rad: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AxisTraces:
    """Rates of an axis over time, each the mean over some steps between poses.

    Attributes:
        axis: Which.
        time_s: Middle of these steps [s], shape (n,).
        commanded: What the commands ask for meanwhile [m/s] or [rad/s], without any delay.
        measured: How fast the robot was.
        modelled: How fast the model is.
    """

    axis: Axis
    time_s: Values
    commanded: Values
    measured: Values
    modelled: Values

    @property
    def residual(self) -> Values:
        """Measured less modelled."""
        return self.measured - self.modelled


def trace_axis(model: AxisModel, run: Run) -> AxisTraces:
    """Return what was commanded, measured and modelled of an axis.

    Steps are joined up to a tenth of a second: the noise of poses hides the rate of shorter ones.

    Raises:
        IdentifyError: Where the model does not know the axis.
    """
    time_s, moved, _ = measure_steps(run.poses, model.axis)
    rows = np.flatnonzero(np.diff(np.floor(time_s / _JOINED_S), prepend=-np.inf))
    rows = rows if len(rows) > 1 else np.array([0, len(time_s) - 1])
    way = np.concatenate([[0.0], np.cumsum(moved)])[rows]
    time_s = time_s[rows]
    asked = read_axis_motion(run, model.axis).commands.place(time_s).way
    modelled, _ = predict_axis(model, run, time_s)
    duration_s = np.diff(time_s)
    return AxisTraces(
        axis=model.axis,
        time_s=time_s[:-1] + 0.5 * duration_s,
        commanded=np.diff(asked) / duration_s,
        measured=np.diff(way) / duration_s,
        modelled=np.diff(modelled) / duration_s,
    )


def predict_axis(model: AxisModel, run: Run, time_s: Values) -> tuple[Values, Values]:
    """Return the way or turn from the first of some times on, and the rate, as a model has them.

    Raises:
        IdentifyError: Where the model does not know the axis.
    """
    gain, dead_time_s, lag_s = model.gain, model.dead_time_s, model.lag_s
    if gain is None or dead_time_s is None or lag_s is None:
        raise IdentifyError(f"{model.axis}: expected a model of it, found none: {model.reason}")
    commands = read_axis_motion(run, model.axis).commands
    if model.rate_limit is not None:
        commands = limit_changes(commands, gain.value / model.rate_limit.value)
    product_s2 = 0.0 if model.lag_product_s2 is None else model.lag_product_s2.value
    response = LaggedResponse(commands, lag_s.value, product_s2)
    way, rate = response.evaluate(response.place(time_s - dead_time_s.value))
    return gain.value * (way - way[:1]), gain.value * rate


def measure_prediction(
    model: RobotModel, run: Run, horizons_s: Sequence[float] = HORIZONS_S
) -> tuple[PredictionError, ...]:
    """Return how well a model predicts the motion of a run, anchored anew after each horizon.

    Use a run, or a part of one, that the model was not fitted to. The commands from before each
    beginning are known to the model. An axis that is never commanded stands still.

    Raises:
        IdentifyError: Where an axis that is commanded is not known, or the run is too short.
    """
    time_s = run.poses.time_ns / 1e9
    heading_rad = run.poses.heading_rad
    way_m, turn_rad = (
        predict_axis(axis, run, time_s)[0]
        if axis.is_known or get_commands(run, axis.axis).any()
        else np.zeros(len(time_s))
        for axis in model.axes
    )
    step_m, step_rad = np.diff(way_m), np.diff(turn_rad)
    middle_rad = turn_rad[:-1] + 0.5 * step_rad
    chord_m = step_m * np.sinc(step_rad / (2.0 * np.pi))
    x_m, y_m = (
        np.concatenate([[0.0], np.cumsum(chord_m * along(middle_rad))])
        for along in (np.cos, np.sin)
    )
    found = []
    for horizon_s in horizons_s:
        begins = np.searchsorted(time_s, np.arange(time_s[0], time_s[-1] - horizon_s, horizon_s))
        if not len(begins):
            length_s = time_s[-1] - time_s[0]
            raise IdentifyError(
                f"{run.name}: expected more than {horizon_s:g} s to predict, found {length_s:.3g} s"
            )
        ends = np.searchsorted(time_s, time_s[begins] + horizon_s, side="right") - 1
        turned_rad = heading_rad[begins] - turn_rad[begins]
        ahead_m, aside_m = x_m[ends] - x_m[begins], y_m[ends] - y_m[begins]
        cosine, sine = np.cos(turned_rad), np.sin(turned_rad)
        moved_m = run.poses.xy_m[ends] - run.poses.xy_m[begins]
        off_m = np.hypot(
            moved_m[:, 0] - (cosine * ahead_m - sine * aside_m),
            moved_m[:, 1] - (sine * ahead_m + cosine * aside_m),
        )
        predicted_rad = wrap_angle(turned_rad + turn_rad[ends])
        off_rad = np.abs(subtract_headings(heading_rad[ends], predicted_rad))
        found.append(
            PredictionError(
                horizon_s=horizon_s,
                count=len(begins),
                median_m=float(np.median(off_m)),
                largest_m=float(off_m.max()),
                median_rad=float(np.median(off_rad)),
                largest_rad=float(off_rad.max()),
            )
        )
    return tuple(found)
