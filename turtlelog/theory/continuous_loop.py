"""The plant 1/s (an integrator of the command) and the ideal loop around it, Kp / (s + Kp).

Transfer functions are pairs of coefficients, highest power of s first, without common factors other
than powers of s. python-control computes the curves of theory's figures; the formulas here serve
measurement, without python-control and at uneven times.
"""

import math
from dataclasses import dataclass
from enum import Enum
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from turtlelog.arithmetic import SETTLING_BAND
from turtlelog.errors import TheoryError
from turtlelog.libraries import load_library
from turtlelog.theory.process import (
    require_array,
    require_even_times,
    require_gain,
    require_gains,
    require_level,
    require_positive,
    require_times,
)

PLANT: Final = ((1.0,), (1.0, 0.0))
"""Numerator and denominator of 1/s."""

PLANT_INPUTS: Final = ("impulse", "step", "ramp")
"""Inputs of the paper's figure 2: a unit impulse, 1 and t, with the transforms 1, 1/s and 1/s^2."""

SETTLING_TIME_CONSTANTS: Final = 4.0
"""Time constants in which an exponential settles, by the textbooks' rule: exp(-4) is 1.8 %."""

_DECAYED: Final = 750.0
"""Exponent from which exp(-x) counts as 0: exp(-750) is 0 in double precision, and no later product
overflows."""


class FinalValueStatus(Enum):
    """Whether a signal has a final value, and if not, why."""

    OK = "ok"
    UNBOUNDED = "unbounded"
    OSCILLATES = "oscillates"


@dataclass(frozen=True, slots=True, kw_only=True)
class FinalValue:
    """Final value of a signal by the final value theorem.

    Attributes:
        value: Limit for t to infinity; None if the signal has no limit.
        status: Whether the signal has a final value; if not, whether it is unbounded or
            oscillating.
        reason: Explanation in one sentence.
    """

    value: float | None
    status: FinalValueStatus
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class BiboVerdict:
    """Whether every bounded input gives a bounded output.

    Attributes:
        stable: Whether every bounded input gives a bounded output.
        reason: Explanation in one sentence.
    """

    stable: bool
    reason: str


def compute_plant_response(kind: str, time_s: ArrayLike) -> NDArray[np.float64]:
    """Return the response of 1/s to an impulse, step or ramp, from python-control (figure 2).

    Args:
        kind: One of `PLANT_INPUTS`.
        time_s: Times [s], shape (n,), from 0 in even steps, n at least 2.

    Returns:
        1, t or t^2 / 2, shape (n,).

    Raises:
        TheoryError: If `kind` is no such input, or times are not evenly spaced.
    """
    control, times = load_library("control"), require_even_times(time_s)
    _require_kind(kind)
    plant = control.tf(*PLANT)
    if kind == "impulse":
        response = control.impulse_response(plant, times)
    else:
        inputs = np.ones_like(times) if kind == "step" else times
        response = control.forced_response(plant, times, inputs)
    return np.asarray(response.outputs, dtype=np.float64)


def find_plant_final_value(kind: str) -> FinalValue:
    """Return the final value of the response of 1/s to an impulse, a step or a ramp.

    Raises:
        TheoryError: If `kind` is no such input.
    """
    _require_kind(kind)
    numerator, denominator = PLANT
    return find_final_value(numerator, (*denominator, *(0.0,) * PLANT_INPUTS.index(kind)))


def find_final_value(numerator: ArrayLike, denominator: ArrayLike) -> FinalValue:
    """Return the limit of a signal for t to infinity from its Laplace transform Y(s).

    By the final value theorem, this is the limit of s Y(s) for s to 0. The theorem applies only if
    all poles of s Y(s) lie in the open left half plane.

    Args:
        numerator: Numerator of Y(s), highest power first.
        denominator: Denominator of Y(s), highest power first.

    Raises:
        TheoryError: If the arguments are not coefficients, or the denominator is 0.
    """
    above, below = _cancel(_require_polynomial(numerator), _require_polynomial(denominator))
    if below[-1] == 0.0:
        below = below[:-1]
    else:
        above = np.append(above, 0.0)
    poles = np.roots(below)
    if (poles.real < 0.0).all():
        value = float(above[-1] / below[-1])
        reason = "all poles of s Y(s) lie in the open left half plane: the limit is s Y(s) at s = 0"
        return FinalValue(value=value, status=FinalValueStatus.OK, reason=reason)
    if (poles.real <= 0.0).all() and (poles != 0.0).all():
        reason = "s Y(s) has poles on the imaginary axis: the theorem does not apply"
        return FinalValue(value=None, status=FinalValueStatus.OSCILLATES, reason=reason)
    place = "at the origin" if (poles.real <= 0.0).all() else "in the right half plane"
    reason = f"s Y(s) has a pole {place}: the theorem does not apply, and the signal grows"
    return FinalValue(value=None, status=FinalValueStatus.UNBOUNDED, reason=reason)


def judge_bibo(numerator: ArrayLike, denominator: ArrayLike) -> BiboVerdict:
    """Return whether a transfer function is stable from bounded inputs to bounded outputs.

    The transfer function is stable if it is proper and all its poles lie in the open left half
    plane.

    Args:
        numerator: Coefficients of the numerator, highest power first.
        denominator: Coefficients of the denominator, highest power first.

    Raises:
        TheoryError: If the arguments are not coefficients, or the denominator is 0.
    """
    above, below = _cancel(_require_polynomial(numerator), _require_polynomial(denominator))
    poles = np.roots(below)
    if len(above) > len(below):
        return BiboVerdict(stable=False, reason="it differentiates: a fast input has no bound")
    if (poles.real < 0.0).all():
        return BiboVerdict(stable=True, reason="all poles lie in the open left half plane")
    if (poles == 0.0).any() and (poles.real <= 0.0).all():
        reason = "it has a pole at the origin: a bounded step gives an unbounded ramp"
        return BiboVerdict(stable=False, reason=reason)
    place = "on the imaginary axis" if (poles.real <= 0.0).all() else "in the right half plane"
    return BiboVerdict(stable=False, reason=f"it has a pole {place}: its own motion does not fade")


def compute_time_constant(kp: float) -> float:
    """Return tau = 1 / Kp [s] of the closed loop of an integrator with gain Kp [1/s].

    Raises:
        TheoryError: If the gain is not a positive number.
    """
    return 1.0 / require_gain(kp)


def compute_settling_time(kp: float) -> float:
    """Return 4 tau [s], the textbook rule for the 2 % settling time.

    Raises:
        TheoryError: If the gain is not a positive number.
    """
    return SETTLING_TIME_CONSTANTS * compute_time_constant(kp)


def compute_exact_settling_time(kp: float) -> float:
    """Return ln 50 tau [s] = 3.912 tau, the time at which exp(-t / tau) is 2 %.

    Raises:
        TheoryError: If the gain is not a positive number.
    """
    return math.log(1.0 / SETTLING_BAND) * compute_time_constant(kp)


def compute_saturated_settling_time(kp: float, *, step: float, limit: float) -> float:
    """Return the 2 % settling time [s] of the ideal loop whose command is clipped to a limit.

    While Kp e > limit, the error falls at the rate `limit`; then the error decays. Clipping ends at
    the error E = limit / Kp < step. The settling time is (step - E) / limit + tau ln(E / (0.02
    step)), or 0.98 step / limit if E is within 2 %.

    Args:
        kp: Gain [1/s].
        step: Distance to the reference, > 0, in m or rad.
        limit: Largest rate, > 0, in the same unit per second.

    Raises:
        TheoryError: If an argument is not a positive number.
    """
    tau_s = compute_time_constant(kp)
    step, limit = require_positive("step", step), require_positive("limit", limit)
    unclipped = limit * tau_s
    if unclipped >= step:
        return compute_exact_settling_time(kp)
    if unclipped <= SETTLING_BAND * step:
        return (1.0 - SETTLING_BAND) * step / limit
    return (step - unclipped) / limit + tau_s * math.log(unclipped / (SETTLING_BAND * step))


def compute_closed_loop_response(kp: float, time_s: ArrayLike) -> NDArray[np.float64]:
    """Return the unit step response of Kp / (s + Kp), from python-control (figure 4).

    Args:
        kp: Gain [1/s].
        time_s: Times [s], shape (n,), from 0 in even steps, n at least 2.

    Raises:
        TheoryError: If the gain is not a positive number, or times are not evenly spaced.
    """
    control = load_library("control")
    kp, times = require_gain(kp), require_even_times(time_s)
    response = control.step_response(control.tf([kp], [1.0, kp]), times)
    return np.asarray(response.outputs, dtype=np.float64)


def compute_root_locus(kp: ArrayLike) -> NDArray[np.complex128]:
    """Return the closed loop's pole for gains from 0 up (figure 5): the root of D(s) + Kp N(s).

    Args:
        kp: Gains [1/s], shape (n,), none negative.

    Returns:
        Poles in the s plane [1/s], shape (n,): -Kp, from the plant's pole at 0 to the left.

    Raises:
        TheoryError: If a gain is negative or not a number.
    """
    numerator, denominator = map(np.array, PLANT)
    poles = [
        np.roots(np.polyadd(denominator, gain * numerator)) for gain in require_gains(kp).tolist()
    ]
    return np.asarray(poles, dtype=np.complex128).reshape(len(poles))


def compute_step_response(
    kp: float, time_s: ArrayLike, *, initial: float = 0.0, reference: float = 1.0
) -> NDArray[np.float64]:
    """Return the ideal loop's response to a step of its reference at time 0.

    y(t) = reference + (initial - reference) exp(-Kp t): the inverse Laplace transform of Kp / (s +
    Kp) 1 / s. Before time 0 the response is `initial`.

    Args:
        kp: Gain [1/s].
        time_s: Times [s], any shape.
        initial: Level before the step, in any unit.
        reference: Level after the step, in the same unit.

    Returns:
        Response in the same unit, in the shape of `time_s`.

    Raises:
        TheoryError: If the gain is not positive or a number is not finite.
    """
    kp, times = require_gain(kp), require_times(time_s)
    step = require_level("initial", initial) - require_level("reference", reference)
    return reference + step * np.exp(-kp * np.clip(times, 0.0, _DECAYED / kp))


def _require_kind(kind: str) -> None:
    if kind not in PLANT_INPUTS:
        raise TheoryError(f"input: expected one of {', '.join(PLANT_INPUTS)}, found {kind!r}")


def _require_polynomial(coefficients: Any) -> NDArray[np.float64]:
    found = np.atleast_1d(require_array("transfer function", "coefficients", coefficients))
    if found.ndim != 1 or not len(found):
        raise TheoryError(
            f"transfer function: expected a list of coefficients, found shape {found.shape}"
        )
    is_finite = np.isfinite(found)
    if not is_finite.all():
        index = int(np.argmin(is_finite))
        value = f"{found[index]} at index {index}"
        raise TheoryError(f"transfer function: expected finite coefficients, found {value}")
    return np.trim_zeros(found, "f")


def _cancel(
    numerator: NDArray[np.float64], denominator: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return numerator and denominator without common powers of s; 0 becomes 0 / 1."""
    if not len(denominator):
        raise TheoryError("transfer function: expected a denominator other than 0, found 0")
    if not len(numerator):
        return np.zeros(1), np.ones(1)
    while numerator[-1] == 0.0 and denominator[-1] == 0.0:
        numerator, denominator = numerator[:-1], denominator[:-1]
    return numerator, denominator
