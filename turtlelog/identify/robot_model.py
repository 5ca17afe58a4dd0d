"""Values of a robot's dynamics with intervals and in words, or the reason why they are unknown."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any, Final, Literal, SupportsFloat

from turtlelog.display import NULL_IF_EMPTY, fit_line, format_html, format_notebook, join_words
from turtlelog.errors import IdentifyError
from turtlelog.identify.axis_motion import NAMES, Axis
from turtlelog.identify.held_response import Bound, Order, Structure
from turtlelog.run import Clock
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
            said += f" less friction of {_show(self.friction)}"
        if self.deadband is not None:
            said += f" above a deadband of {_show(self.deadband)}"
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
        + (f" up to its limit of {_show(axis.bound)}" if axis.bound else "")
        + (f" with a drift of {_show(axis.drift)}" if axis.drift else "")
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


def _show(value: Estimate) -> str:
    return f"{value.value:.3g} {value.unit}"


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
