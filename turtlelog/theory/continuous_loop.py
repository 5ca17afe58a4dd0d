"""The plant 1/s: a command is a rate, the output its integral.

Transfer functions are pairs of coefficients, highest power of s first, without common factors
other than powers of s.
"""

from dataclasses import dataclass
from enum import Enum
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from turtlelog.errors import TheoryError
from turtlelog.theory.inputs import require_times

PLANT: Final = ((1.0,), (1.0, 0.0))
"""Numerator and denominator of 1/s."""

PLANT_INPUTS: Final = ("impulse", "step", "ramp")
"""Inputs of the paper's figure 2: a unit impulse, 1 and t, with the transforms 1, 1/s and 1/s^2."""


class FinalValueStatus(Enum):
    """Whether a signal has a final value."""

    OK = "ok"
    UNBOUNDED = "unbounded"
    OSCILLATES = "oscillates"


@dataclass(frozen=True, slots=True, kw_only=True)
class FinalValue:
    """Where a signal ends, as far as the final value theorem can tell.

    Attributes:
        value: Limit for t to infinity; None where there is none.
        status: Why there is none.
        reason: One sentence.
    """

    value: float | None
    status: FinalValueStatus
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class BiboVerdict:
    """Whether every bounded input gives a bounded output.

    Attributes:
        stable: It does.
        reason: One sentence.
    """

    stable: bool
    reason: str


def compute_plant_response(kind: str, time_s: ArrayLike) -> NDArray[np.float64]:
    """Return the response of 1/s to an impulse, a step or a ramp, by python-control (figure 2).

    Args:
        kind: One of `PLANT_INPUTS`.
        time_s: Times [s], shape (n,), from 0 in even steps, n at least 2.

    Returns:
        1, t or t^2 / 2, shape (n,).

    Raises:
        TheoryError: Where there is no such input, or times are not even.
    """
    control, times = load_control(), require_even_times(time_s)
    _require_kind(kind)
    plant = control.tf(*PLANT)
    if kind == "impulse":
        response = control.impulse_response(plant, times)
    else:
        inputs = np.ones_like(times) if kind == "step" else times
        response = control.forced_response(plant, times, inputs)
    return np.asarray(response.outputs, dtype=np.float64)


def find_plant_final_value(kind: str) -> FinalValue:
    """Return where the response of 1/s to an impulse, a step or a ramp ends."""
    _require_kind(kind)
    numerator, denominator = PLANT
    return find_final_value(numerator, (*denominator, *(0.0,) * PLANT_INPUTS.index(kind)))


def find_final_value(numerator: ArrayLike, denominator: ArrayLike) -> FinalValue:
    """Return the limit of a signal for t to infinity from its Laplace transform Y(s).

    The final value theorem: it is the limit of s Y(s) for s to 0, if all poles of s Y(s) lie in
    the open left half plane. Where one does not, the theorem does not apply.

    Args:
        numerator: Of Y(s), highest power first.
        denominator: Of Y(s), highest power first.

    Raises:
        TheoryError: Where these are no coefficients, or the denominator is 0.
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
    """Say whether a transfer function is stable from bounded inputs to bounded outputs.

    It is, where it is proper and all its poles lie in the open left half plane.

    Args:
        numerator: Highest power first.
        denominator: Highest power first.

    Raises:
        TheoryError: Where these are no coefficients, or the denominator is 0.
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


def load_control() -> Any:
    """Return python-control, which is loaded only where it is needed.

    Raises:
        TheoryError: Where it is not installed.
    """
    try:
        import control
    except ImportError as err:
        raise TheoryError("python-control: expected `pip install control`, found none") from err
    return control


def require_even_times(time_s: ArrayLike) -> NDArray[np.float64]:
    """Return times [s] that python-control can simulate over."""
    times = require_times(time_s)
    if times.ndim != 1 or len(times) < 2 or times[0] != 0.0:
        raise TheoryError("time_s: expected at least 2 times from 0 on, found others")
    steps = np.diff(times)
    if not steps.min() > 0.0 or not np.allclose(steps, steps[0], rtol=1e-6, atol=0.0):
        raise TheoryError("time_s: expected even steps forward, found uneven ones")
    return times


def _require_kind(kind: str) -> None:
    if kind not in PLANT_INPUTS:
        raise TheoryError(f"input: expected one of {', '.join(PLANT_INPUTS)}, found {kind!r}")


def _require_polynomial(coefficients: Any) -> NDArray[np.float64]:
    try:
        found = np.atleast_1d(np.asarray(coefficients, dtype=np.float64))
    except (TypeError, ValueError) as err:
        raise TheoryError(f"transfer function: expected coefficients, found {err}") from err
    if found.ndim != 1 or not len(found) or not np.isfinite(found).all():
        raise TheoryError("transfer function: expected finite coefficients, found others")
    return np.trim_zeros(found, "f")


def _cancel(
    numerator: NDArray[np.float64], denominator: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return both without their common powers of s; 0 is 0 / 1."""
    if not len(denominator):
        raise TheoryError("transfer function: expected a denominator other than 0, found 0")
    if not len(numerator):
        return np.zeros(1), np.ones(1)
    while numerator[-1] == 0.0 and denominator[-1] == 0.0:
        numerator, denominator = numerator[:-1], denominator[:-1]
    return numerator, denominator
