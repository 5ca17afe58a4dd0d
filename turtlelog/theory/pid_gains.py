"""The gains of a P, PI, PD or PID controller, and its loop with a process as `LoopShape`."""

from dataclasses import dataclass
from typing import Final

from turtlelog.errors import TheoryError
from turtlelog.theory.inputs import require_gain, require_not_negative, require_period
from turtlelog.theory.pid_stability import LoopShape
from turtlelog.theory.process import SampledProcess

_SMALLEST_LOOP_GAIN: Final = 1e-9
_LARGEST_LOOP_GAIN: Final = 1e9
"""Of K Kp T, K Ki T^2 and K Kd T / (Tf + T), of all but P on an integrator: their squares and
fourth powers keep their digits. No stable loop comes near the upper end."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PidGains:
    """Gains of a P, PI, PD or PID controller.

    Attributes:
        kp: Proportional gain [1/s].
        ki: Integral gain [1/s^2]; 0: no integral.
        kd: Derivative gain [1]; 0: no derivative.
        filter_s: Time constant Tf of the derivative's filter [s]; 0: a plain difference.

    Raises:
        TheoryError: If a gain is not finite, negative, or Kp not positive.
    """

    kp: float
    ki: float = 0.0
    kd: float = 0.0
    filter_s: float = 0.0

    def __post_init__(self) -> None:
        require_gain(self.kp)
        for name in ("ki", "kd", "filter_s"):
            require_not_negative(name, getattr(self, name))

    @property
    def is_proportional(self) -> bool:
        """Whether it is P alone."""
        return self.ki == 0.0 and self.kd == 0.0

    def weigh_derivative(self, period_s: float) -> tuple[float, float]:
        """Return a = Tf / (Tf + T) and Kd / (Tf + T) [1/s]."""
        whole_s = self.filter_s + period_s
        return self.filter_s / whole_s, self.kd / whole_s


def build_shape(gains: PidGains, sampled: SampledProcess, period_s: float) -> LoopShape:
    """Return a loop without units.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    period_s = require_period(period_s)
    keep, rate = gains.weigh_derivative(period_s)
    p, i, b = gains.kp * period_s, gains.ki * period_s * period_s, rate * period_s
    p, i, b = p * sampled.gain, i * sampled.gain, b * sampled.gain
    if not (gains.is_proportional and sampled.is_integrator):
        _require_loop_gain("Kp T", p, lowest=_SMALLEST_LOOP_GAIN)
        _require_loop_gain("Ki T^2", i, lowest=0.0)
        _require_loop_gain("Kd T / (Tf + T)", b, lowest=0.0)
    return LoopShape(
        p=p,
        i=i,
        b=b,
        a=keep if gains.kd > 0.0 else None,
        delay=sampled.delay,
        gaps=sampled.gaps,
        ahead=sampled.ahead,
        behind=sampled.behind,
    )


def _require_loop_gain(name: str, value: float, *, lowest: float) -> None:
    if not lowest <= value <= _LARGEST_LOOP_GAIN:
        expected = f"a loop gain from {lowest:g} to {_LARGEST_LOOP_GAIN:g}"
        raise TheoryError(f"{name}: expected {expected}, found {value!r}")
