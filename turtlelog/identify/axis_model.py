"""The dynamics of one axis: values with intervals, and the rates that they predict."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal, SupportsFloat

import numpy as np

from turtlelog.display import NULL_IF_EMPTY
from turtlelog.errors import IdentifyError
from turtlelog.identify.axis_motion import Axis, AxisMotion, measure_axis_steps, read_axis_motion
from turtlelog.identify.held_response import Bound, HeldInput, Order, Structure, Values
from turtlelog.run import Run
from turtlelog.theory.process import Process, build_delayed


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A value and its 95 % interval. Comparisons with numbers use the value.

    Attributes:
        value: Most likely value.
        low: Lower end of the interval.
        high: Upper end of the interval.
        unit: Unit of the value and the interval.
    """

    value: float
    low: float
    high: float
    unit: str = field(default="s", repr=False)

    def __float__(self) -> float:
        return self.value

    def __lt__(self, other: SupportsFloat) -> bool:
        return self.value < float(other)

    def __le__(self, other: SupportsFloat) -> bool:
        return self.value <= float(other)

    def __gt__(self, other: SupportsFloat) -> bool:
        return self.value > float(other)

    def __ge__(self, other: SupportsFloat) -> bool:
        return self.value >= float(other)

    def __repr__(self) -> str:
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"<{self.value:.4g}{unit}, {self.low:.4g} to {self.high:.4g}>"


LimitPlace = Literal["", "before_lag", "within_lag", "at_wheels"]


Refusal = Literal[
    "no_commands", "never_commanded", "negligible", "constant", "ramps", "begun",
    "implausible", "few_steps", "no_gain", "opposite", "late", "unexplained", "jump", "wide",
    "repeated", "at_bound", "hidden",
]  # fmt: skip
"""Cause why an axis has no values; `refused_axes` has the sentence of each."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisModel:
    """One axis: rate = gain exp(-dead_time s) / (lag s + 1), with commands under zero-order hold.

    An estimate is None if the motion does not show it.

    Attributes:
        axis: `speed` or `turn_rate`.
        status: Whether the values of the axis are known.
        refusal: Cause why the values are unknown.
        reason: The same in a sentence.
        advice: Test drive that would identify the values; empty if no drive would.
        model: Model of the response; `second_order`: rate = gain exp(-dead_time s) / (product s^2 +
            lag s + 1).
        gain: Steady-state rate per command [1].
        dead_time_s: Time from a command until the rate begins to follow [s].
        lag_s: Time constant of the response [s]; for second order, the sum of both time constants.
        total_delay_s: Sum of dead time and time constant, which is known better than either [s].
        lag_product_s2: Product of both time constants for second order [s^2].
        rate_limit: Largest acceleration [m/s^2] or [rad/s^2].
        limit_acts: Place of the limit: before the low-pass, within its loop, or at the wheels,
            which both axes share.
        rate_limit_beside: Change of the other axis's command that alone reaches the limit of the
            wheels [m/s^2] or [rad/s^2]; `rate_limit` then is that without the other axis.
        jerk_time_s: Time in which the acceleration reaches its limit before the low-pass [s].
        bound: Largest rate [m/s] or [rad/s].
        bound_acts: Limited quantity: the `command`, the `rate`, or the wheels, which both axes
            share. A larger command is then `scaled` on both axes, `clipped` at each wheel,
            `yielding` to the other axis, or `reduced` by it.
        bound_beside: Command of the other axis that alone reaches the limit of the wheels [m/s] or
            [rad/s]; `bound` then is that without the other axis.
        deadband: Largest command that moves nothing [m/s] or [rad/s].
        reverse_gain: Gain of negative commands, if it differs [1].
        friction: Part of every command's magnitude that has no effect [m/s] or [rad/s]. The gain
            applies to the rest.
        drift: Rate at a command of 0 [m/s] or [rad/s], added to the response to every command.
        explained: Fraction of the variance of the steps about one constant speed that the model
            explains.
        whiteness: Mean square of the changes of the residuals divided by twice their mean square,
            without the noise of poses: 1 for noise, near 0 for a curve.
        outliers: Number of steps whose residual exceeds the noise, left out.
        correlation_delay_s: Delay with the largest correlation of commands and motion [s], with the
            range of delays that the correlation cannot distinguish.
        correlation_reason: Reason why the correlation shows no delay.
        steps: Number of steps between poses that were used.
        steps_in_all: Number of steps in which commands act.
        changes: Number of changes of the command.
        doubts: Reasons other than noise for wider intervals, in sentences.
        silent_stops_s: Times from the last command to half of the rate [s], if the robot stops by
            itself.
    """

    axis: Axis
    status: Literal["ok", "not_identifiable"]
    refusal: Refusal | None = None
    reason: str = field(default="", metadata=NULL_IF_EMPTY)
    advice: str = field(default="", metadata=NULL_IF_EMPTY)
    model: Literal["first_order", "second_order"] = "first_order"
    gain: Estimate | None = None
    dead_time_s: Estimate | None = None
    lag_s: Estimate | None = None
    total_delay_s: Estimate | None = None
    lag_product_s2: Estimate | None = None
    rate_limit: Estimate | None = None
    limit_acts: LimitPlace = field(default="", metadata=NULL_IF_EMPTY)
    rate_limit_beside: Estimate | None = None
    jerk_time_s: Estimate | None = None
    bound: Estimate | None = None
    bound_acts: Bound = field(default="", metadata=NULL_IF_EMPTY)
    bound_beside: Estimate | None = None
    deadband: Estimate | None = None
    reverse_gain: Estimate | None = None
    friction: Estimate | None = None
    drift: Estimate | None = None
    explained: float | None = None
    whiteness: float | None = None
    outliers: int = 0
    correlation_delay_s: Estimate | None = None
    correlation_reason: str = field(default="", metadata=NULL_IF_EMPTY)
    steps: int = 0
    steps_in_all: int = 0
    changes: int = 0
    doubts: tuple[str, ...] = ()
    silent_stops_s: tuple[float, ...] = ()

    def to_control(self, pade_order: int = 4) -> Any:
        """Return the axis as a `control.TransferFunction`, from command to rate.

        Limits and a deadband are nonlinear and left out. So is a drift, which is no response.

        Args:
            pade_order: Pade order of the rational function that approximates the dead time; 0: no
                dead time.

        Raises:
            IdentifyError: If the axis is unknown.
            TheoryError: If the order is negative.
            LibraryError: If python-control is not installed.
        """
        gain, dead_time_s, lag_s = self._require_known()
        product = 0.0 if self.lag_product_s2 is None else self.lag_product_s2.value
        return build_delayed([gain], (product, lag_s, 1.0), dead_time_s, pade_order)

    def to_process(self) -> Process:
        """Return the axis as a process of `theory`: a delayed rate, integrated.

        For second order, the time constant is the sum of both time constants. Limits, a deadband
        and a drift are left out.

        Raises:
            IdentifyError: If the axis is unknown.
            TheoryError: If the gain is not positive.
        """
        gain, dead_time_s, lag_s = self._require_known()
        return Process(gain=gain, dead_time_s=dead_time_s, lag_s=lag_s)

    def _require_known(self) -> tuple[float, float, float]:
        if self.gain is None or self.dead_time_s is None or self.lag_s is None:
            raise IdentifyError(f"{self.axis}: {self.reason or 'it is not known'}")
        return self.gain.value, self.dead_time_s.value, self.lag_s.value

    @property
    def advised_delay_s(self) -> float | None:
        """Total delay for the design of a controller [s]; if in doubt, the longest delay."""
        return self._take_advised(self.total_delay_s)

    @property
    def oscillation_delay_s(self) -> float:
        """Delay that stands for the oscillation of a second-order model in a first-order one [s].

        With this delay, P control with 5 % overshoot gets the gain that the second-order model
        allows, or up to a tenth less: 0.5 product^1.5 / lag^2 fits damping ratios from 0.3 to 1. A
        dead time reduces the gain anyway, so that a smaller delay is enough.
        """
        product, lag = self.lag_product_s2, self.lag_s
        if product is None or lag is None or product.value <= 0.25 * lag.value**2:
            return 0.0
        return 0.5 * product.value * math.sqrt(product.value) / lag.value**2

    @property
    def advised_gain(self) -> float | None:
        """Gain for the design of a controller [1]; if in doubt, the largest gain."""
        return self._take_advised(self.gain)

    @property
    def advised_reverse_gain(self) -> float | None:
        """Gain of negative commands for the design of a controller, if it differs [1]."""
        return self._take_advised(self.reverse_gain)

    def _take_advised(self, found: Estimate | None) -> float | None:
        if found is None:
            return None
        return found.high if self.doubts else found.value

    @property
    def structure(self) -> Structure:
        """Names of the axis's further parameters."""
        order: Order = "second_order" if self.model == "second_order" else "first_order"
        if self.limit_acts:
            order = ORDERS[self.limit_acts]
        if self.jerk_time_s is not None:
            order = "limited_softly"
        return Structure(
            order=order,
            bound=self.bound_acts,
            has_reverse=self.reverse_gain is not None,
            has_friction=self.friction is not None,
            deadband=0.0 if self.deadband is None else self.deadband.low,
            has_drift=self.drift is not None,
        )

    @property
    def extras(self) -> list[float]:
        """Values of the further parameters, as fractions of the gain."""
        gain = math.nan if self.gain is None else self.gain.value
        found = []
        for key, relation, _ in (FURTHER[name] for name in self.structure.names):
            if (one := getattr(self, key)) is not None:
                of_gain = gain if relation in {"product", "quotient"} else 1.0
                is_inverse = relation in {"reciprocal", "quotient"}
                found.append(of_gain / one.value if is_inverse else one.value / of_gain)
        return found

    @property
    def is_known(self) -> bool:
        """Whether gain, dead time and time constant have values."""
        return self.status == "ok"

    @property
    def exceptions(self) -> str:
        """Commands to which the gain does not apply, for the end of a clause; empty if none."""
        said = ""
        if self.reverse_gain is not None:
            said += f" (backwards {self.reverse_gain.value:.3g} times the command)"
        if self.friction is not None:
            said += f" less friction of {format_estimate(self.friction)}"
        if self.deadband is not None:
            said += f" above a deadband of {format_estimate(self.deadband)}"
        return said

    @property
    def is_idle(self) -> bool:
        """Whether the axis is never commanded, so that its values are not needed."""
        return self.refusal == "never_commanded"


ORDERS: Final[Mapping[str, Order]] = {
    "before_lag": "limited_before",
    "within_lag": "limited_within",
    "at_wheels": "limited_wheels",
}
"""Order of a model by the place of its limit."""


FURTHER: Final = {
    "product": ("lag_product_s2", "itself", "s^2"),
    "slowness": ("rate_limit", "quotient", "{own}^2"),
    "jerk_time": ("jerk_time_s", "itself", "s"),
    "slowness_beside": ("rate_limit_beside", "reciprocal", "{other}^2"),
    "tightness": ("bound", "quotient", "{own}"),
    "coupling": ("bound_beside", "reciprocal", "{other}"),
    "reverse": ("reverse_gain", "product", "1"),
    "friction": ("friction", "itself", "{own}"),
    "drift": ("drift", "product", "{own}"),
}
"""Field of each further parameter of a structure; the relation of its value to the parameter
(`quotient`: gain by parameter; `product`: gain times parameter); and its unit, by the units of the
rates of its own axis and the other one."""

LEAST_BELOW: Final = 0.02
"""Share of the time with commands in which commands must stay below a bound: two messages gave a
robot that drives at its bound a gain of four. Of random steps, more than a tenth stay below."""

_SHOWN_S: Final = 0.1  # time over which rates are averaged for display [s]


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
    motion = read_axis_motion(run, model.axis)
    return join_rates(model.axis, motion, time_s, moved, np.diff(modelled))


def join_rates(
    axis: Axis, motion: AxisMotion, time_s: Values, moved: Values, modelled: Values
) -> AxisTraces:
    """Return the rates of an axis from displacements in steps between times [s], shape (n,).

    Steps are joined up to a tenth of a second; in shorter steps the noise of poses hides the rate.
    `moved` and `modelled` are the distances or turns of robot and model in each step [m] or [rad].
    """
    rows = np.flatnonzero(np.diff(np.floor(time_s / _SHOWN_S), prepend=-np.inf))
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
    """Return displacement or turn, and rate, of a model for commands; IdentifyError if unknown."""
    gain, dead_time_s, lag_s = model.gain, model.dead_time_s, model.lag_s
    if gain is None or dead_time_s is None or lag_s is None:
        raise IdentifyError(f"{model.axis}: not identified: {model.reason}")
    response = model.structure.respond(commands, lag_s.value, model.extras, beside)
    way, rate = response.evaluate(response.place(time_s - dead_time_s.value))
    return gain.value * (way - way[:1]), gain.value * rate


def format_estimate(value: Estimate) -> str:
    """Return a value with its unit as text."""
    return f"{value.value:.3g} {value.unit}"


def has_sure_wheels(found: AxisModel) -> bool:
    """Return whether the intervals of a limit of the wheels' acceleration, if any, are finite."""
    limits = (found.rate_limit, found.rate_limit_beside)
    return found.limit_acts != "at_wheels" or all(
        one is not None and one.low > 0.0 and np.isfinite(one.high) for one in limits
    )
