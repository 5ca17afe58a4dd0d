"""The sequential law with P, PI, PD or PID control in each of its loops."""

import math
from dataclasses import dataclass, field, replace as change
from typing import Annotated, Any, ClassVar, Final, Literal

from msgspec import Meta
from msgspec.structs import replace

from turtlelog.angles import wrap_angle
from turtlelog.laws.base import ABSENT_BY_DEFAULT, Decision, Goal, Pose
from turtlelog.laws.schedule import PIDGainSchedule
from turtlelog.laws.sequential_loops import DECLARATION, declare_loops
from turtlelog.laws.sequential_p import SequentialP, SequentialPParameters
from turtlelog.loops import ControlLoop, Declaration
from turtlelog.paths import Path

_STATES: Final = ("integral_angular", "derivative_angular", "integral_linear", "derivative_linear")

NonNegative = Annotated[float, Meta(ge=0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class SequentialPIDParameters(SequentialPParameters):
    """Parameters of the sequential PID law: those of `sequential-p`, and of what it adds.

    `clamping` is the default: limits clip most commands of these runs, so an integral that is left
    alone winds up, and of the two cures this one has no time constant to choose.

    Attributes:
        ki_angular: Integral gain of the heading loops [1/s^2]; 0: no integral.
        kd_angular: Derivative gain of the heading loops, on the measured turn rate [1]; 0: none.
        ki_linear: Integral gain of the position loop [1/s^2]; 0: no integral.
        kd_linear: Derivative gain of the position loop, on the measured speed [1]; 0: none.
        derivative_filter_s: Time constant of the derivative's first-order filter [s]; 0: a plain
            difference of two samples.
        anti_windup: What the integral does while its command is clipped. `none`: it goes on.
            `clamping`: it holds where the error would drive the command further beyond the limit.
            `back-calculation`: it tracks the clipped command.
        tracking_time_s: Time constant of `back-calculation` [s].
        schedule: Gains that change on the way and take the place of the constant ones; None: none.
    """

    ki_angular: NonNegative = 0.0
    kd_angular: NonNegative = 0.0
    ki_linear: NonNegative = 0.0
    kd_linear: NonNegative = 0.0
    derivative_filter_s: NonNegative = 0.0
    anti_windup: Literal["none", "clamping", "back-calculation"] = "clamping"
    tracking_time_s: Annotated[float, Meta(gt=0)] = 1.0
    schedule: PIDGainSchedule | None = field(default=None, metadata=ABSENT_BY_DEFAULT)


class SequentialPID(SequentialP):
    """Rotate to the goal bearing, then drive, each with u = P + I + D.

    P is the command of `sequential-p`. I and D as in Astrom and Wittenmark, Computer-Controlled
    Systems, chapter 8: I by forward Euler, D of the measurement by backward Euler. In every phase
    both begin at 0.
    """

    Parameters: ClassVar[type[SequentialPIDParameters]] = SequentialPIDParameters

    @classmethod
    def declare(cls, parameters: Any, goal: Goal | None, path: Path | None) -> Declaration:
        """Return the loops of `sequential-p` with the gains of this law, and its states.

        Raises:
            LawError: Where it is to reorient, and the goal has no heading.
        """
        del path
        rotate, translate = DECLARATION.loops
        loops = (
            _add_keys(rotate, "angular", parameters.ki_angular, parameters.kd_angular),
            _add_keys(translate, "linear", parameters.ki_linear, parameters.kd_linear),
        )
        base = change(DECLARATION, loops=loops, states=_STATES)
        return declare_loops(base, goal, parameters.schedule, reorient=parameters.reorient)

    def __init__(self, parameters: SequentialPIDParameters) -> None:
        """Take the parameters; until `take_limits` nothing is clipped."""
        super().__init__(parameters)
        scheduled = () if parameters.schedule is None else parameters.schedule.gains
        acting = [name for name, gain in self._gains.items() if gain or name in scheduled]
        self._turning = _Terms(parameters, has_integral="ki_angular" in acting)
        self._driving = _Terms(parameters, has_integral="ki_linear" in acting)
        # Not added where there are none: + 0.0 would make 0.0 of -0.0.
        self._turns_with_terms = bool({"ki_angular", "kd_angular"} & {*acting})
        self._drives_with_terms = bool({"ki_linear", "kd_linear"} & {*acting})
        self._adds_terms = self._turns_with_terms or self._drives_with_terms
        self._heading_before_rad = 0.0
        self._errors_before_m = (0.0, 0.0)
        self._begun: str | None = None
        self._states = (0.0, 0.0, 0.0, 0.0)

    def take_limits(self, speed_m_s: float, turn_rate_rad_s: float) -> None:
        """Take the limits at which the loop clips the commands."""
        self._driving.limit, self._turning.limit = speed_m_s, turn_rate_rad_s

    def reset(self, start: Pose, goal: Goal | None, path: Path | None) -> None:
        """Compute the goal bearing, once; forget the integrals."""
        super().reset(start, goal, path)
        self._begun = None

    def step(self, time_ns: int, pose: Pose) -> Decision:
        """Answer one pose."""
        self._states = (0.0, 0.0, 0.0, 0.0)
        return replace(super().step(time_ns, pose), states=self._states)

    def _add_turning(
        self, proportional: float, error_rad: float, time_ns: int, pose: Pose
    ) -> float:
        """Return the turn rate with integral and derivative."""
        if not self._turns_with_terms:
            return proportional
        terms, gains = self._turning, self._gains
        if self._begin_phase():
            terms.begin(time_ns)
        else:
            turned_rad = wrap_angle(pose.heading_rad - self._heading_before_rad)
            terms.advance(time_ns, turned_rad, gains["kd_angular"])
        self._heading_before_rad = pose.heading_rad
        self._states = terms.integral, terms.derivative, 0.0, 0.0
        return terms.add(proportional, error_rad, gains["ki_angular"])

    def _add_driving(
        self, proportional: float, errors_m: tuple[float, float], along_rad: float, time_ns: int
    ) -> float:
        """Return the speed with integral and derivative."""
        if not self._drives_with_terms:
            return proportional
        terms, gains = self._driving, self._gains
        (x_m, y_m), (cos, sin) = errors_m, (math.cos(along_rad), math.sin(along_rad))
        if self._begin_phase():
            terms.begin(time_ns)
        else:
            before_x_m, before_y_m = self._errors_before_m
            way_m = (before_x_m - x_m) * cos + (before_y_m - y_m) * sin
            terms.advance(time_ns, way_m, gains["kd_linear"])
        self._errors_before_m = errors_m
        self._states = 0.0, 0.0, terms.integral, terms.derivative
        return terms.add(proportional, x_m * cos + y_m * sin, gains["ki_linear"])

    def _begin_phase(self) -> bool:
        """Return whether this is the first command of the phase."""
        is_first = self._begun is not self._phase
        self._begun = self._phase
        return is_first


def _add_keys(loop: ControlLoop, axis: str, *gains: float) -> ControlLoop:
    """Return a loop of `sequential-p` with the keys of this law's gains."""
    return change(
        loop,
        integral_gain=f"law.ki_{axis}",
        derivative_gain=f"law.kd_{axis}",
        derivative_filter="law.derivative_filter_s",
        is_proportional=not any(gains),
    )


class _Terms:
    """Integral and derivative of one loop, as what they add to its command.

    Attributes:
        limit: Where the command is clipped; inf: nowhere.
        integral: What it adds to the command of this sample.
        derivative: Likewise.
    """

    __slots__ = (
        *("_filter_s", "_has_integral", "_last_ns", "_rate", "_rule", "_tracking_s"),
        *("derivative", "integral", "limit"),
    )

    def __init__(self, parameters: SequentialPIDParameters, *, has_integral: bool) -> None:
        self._filter_s = parameters.derivative_filter_s
        self._rule, self._tracking_s = parameters.anti_windup, parameters.tracking_time_s
        self._has_integral = has_integral
        self.limit = math.inf
        self.begin(0)

    def begin(self, time_ns: int) -> None:
        self.integral = self.derivative = 0.0
        self._rate = 0.0, 0.0
        self._last_ns = time_ns

    def advance(self, time_ns: int, moved: float, kd: float) -> None:
        """Go on to a sample before which the measurement has moved.

        Samples of a burst share one time: nothing is integrated, and the derivative holds.
        """
        step_s = (time_ns - self._last_ns) / 1e9
        self._last_ns = time_ns
        if step_s <= 0.0:
            return
        error_rate, excess = self._rate
        # No further back than to the limit, where a step is longer than the tracking time.
        back = min(step_s / self._tracking_s, 1.0)
        self.integral += step_s * error_rate - back * excess
        self.derivative = (self._filter_s * self.derivative - kd * moved) / (
            self._filter_s + step_s
        )

    def add(self, proportional: float, error: float, ki: float) -> float:
        """Return the command, and keep how the integral goes on from here."""
        command = proportional + self.integral + self.derivative
        if not self._has_integral:
            return command
        excess = command - min(max(command, -self.limit), self.limit)
        error_rate = ki * error
        if self._rule == "clamping" and excess * error_rate > 0.0:
            error_rate = 0.0
        self._rate = error_rate, excess if self._rule == "back-calculation" else 0.0
        return command
