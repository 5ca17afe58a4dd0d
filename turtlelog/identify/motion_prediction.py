"""The rates of a robot's model for recorded commands, compared with the robot's own rates."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from turtlelog.errors import IdentifyError
from turtlelog.identify.axis_motion import Axis, AxisMotion, measure_axis_steps, read_axis_motion
from turtlelog.identify.held_response import HeldInput, Values
from turtlelog.identify.robot_model import AxisModel
from turtlelog.run import Run

_JOINED_S: Final = 0.1
"""Time over which rates are averaged for display [s]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AxisTraces:
    """Rates of an axis over time; each is the mean over several steps between poses.

    Attributes:
        axis: Name of the axis.
        time_s: Middle of the steps of each mean [s], shape (n,).
        commanded: Mean commanded rate in these steps, without delay [m/s or rad/s].
        measured: Measured rate in these steps.
        modelled: Rate of the model in these steps.
    """

    axis: Axis
    time_s: Values
    commanded: Values
    measured: Values
    modelled: Values

    @property
    def residual(self) -> Values:
        """Measured minus modelled rate."""
        return self.measured - self.modelled


def trace_axis(model: AxisModel, run: Run) -> AxisTraces:
    """Return the commanded, measured and modelled rates of an axis.

    Raises:
        IdentifyError: If the axis of the model is unknown.
    """
    time_s, moved, _ = measure_axis_steps(run.poses, model.axis)
    modelled, _ = predict_axis(model, run, time_s)
    return join_rates(
        model.axis, read_axis_motion(run, model.axis), time_s, moved, np.diff(modelled)
    )


def join_rates(
    axis: Axis, motion: AxisMotion, time_s: Values, moved: Values, modelled: Values
) -> AxisTraces:
    """Return the rates of an axis from displacements in steps between times [s], shape (n,).

    Steps are joined up to a tenth of a second; in shorter steps the noise of poses hides the rate.

    Args:
        axis: Name of the axis.
        motion: Motion whose commands are shown.
        time_s: Time of the poses [s], shape (n + 1,).
        moved: Distance or turn of the robot in each step [m] or [rad], shape (n,).
        modelled: Distance or turn of the model in each step [m] or [rad].
    """
    rows = np.flatnonzero(np.diff(np.floor(time_s / _JOINED_S), prepend=-np.inf))
    rows = rows if len(rows) > 1 else np.array([0, len(time_s) - 1])
    at_s = time_s[rows]
    duration_s = np.diff(at_s)

    def find_rates(steps: Values) -> Values:
        return np.asarray(np.diff(np.concatenate([[0.0], np.cumsum(steps)])[rows]) / duration_s)

    return AxisTraces(
        axis=axis,
        time_s=at_s[:-1] + 0.5 * duration_s,
        commanded=np.diff(motion.commands.place(at_s).way) / duration_s,
        measured=find_rates(moved),
        modelled=find_rates(modelled),
    )


def predict_axis(model: AxisModel, run: Run, time_s: Values) -> tuple[Values, Values]:
    """Return the displacement or turn since the first time, and the rate, of a model.

    Raises:
        IdentifyError: If the axis of the model is unknown.
    """
    motion = read_axis_motion(run, model.axis)
    return predict_response(model, motion.commands, time_s, motion.beside)


def predict_response(
    model: AxisModel, commands: HeldInput, time_s: Values, beside: HeldInput | None
) -> tuple[Values, Values]:
    """Return displacement or turn, and rate, of a model for commands of both axes.

    Raises:
        IdentifyError: If the axis of the model is unknown.
    """
    gain, dead_time_s, lag_s = model.gain, model.dead_time_s, model.lag_s
    if gain is None or dead_time_s is None or lag_s is None:
        raise IdentifyError(f"{model.axis}: not identified: {model.reason}")
    response = model.structure.respond(commands, lag_s.value, model.extras, beside)
    way, rate = response.evaluate(response.place(time_s - dead_time_s.value))
    return gain.value * (way - way[:1]), gain.value * rate
