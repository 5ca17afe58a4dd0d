"""The open loop of a sampled PID loop on the unit circle: its frequency response and margins.

At the frequency w it is L(exp(j w T)), with the hold, the part of a sample of dead time and the
controller as the program computes it in it: no approximation up to pi / T, above which nothing is
new. Its margins are read where it crosses the unit circle and the negative real axis.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from turtlelog.theory.pid_stability import (
    LoopShape,
    compute_phase,
    find_angle,
    find_crossovers,
    find_sign_changes,
    list_angles,
)

_LARGEST_FACTOR: Final = 1e12
"""And one over it the smallest: beyond them is rounding, where L is 0 at pi, or grows without bound
towards 0 with a phase that goes to -180 deg."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Margins:
    """Stability margins of a loop.

    Attributes:
        gain_margin: Least factor above 1 on all gains at once that makes it unstable; None if none
            does.
        gain_reduction: Largest factor below 1 that does; None if none does.
        gain_frequency_rad_s: Frequency at which the open loop has the phase -180 deg for
            `gain_margin` [rad/s], None likewise.
        phase_margin_rad: Least phase that may be lost where the open loop's magnitude is 1 [rad];
            None if it is 1 nowhere.
        crossover_rad_s: Frequency of the phase margin [rad/s], None likewise.
        delay_margin_ticks: Dead time that may be added [samples]: as many whole ticks as it holds
            keep the loop stable. None likewise.
    """

    gain_margin: float | None
    gain_reduction: float | None
    gain_frequency_rad_s: float | None
    phase_margin_rad: float | None
    crossover_rad_s: float | None
    delay_margin_ticks: float | None


def evaluate_open_loop(shape: LoopShape, angle: ArrayLike) -> NDArray[np.complex128]:
    """Return L at angles w T above 0 and up to pi, in the shape of `angle`."""
    angles = np.asarray(angle, dtype=np.float64)
    sine = np.sin(0.5 * angles)
    from_one = -2.0 * sine * sine + 1j * np.sin(angles)  # z - 1, whose digits z has lost near 1
    z = np.exp(1j * angles)
    c0, c1, c2 = shape.numerator
    found = c0 + from_one * (c1 + from_one * c2)
    found = found * (1.0 + shape.ahead * from_one + shape.behind * (1.0 / z - 1.0))
    found = found / from_one**shape.integrators * z**-shape.delay
    if shape.a is not None:
        found = found / (from_one + (1.0 - shape.a))
    for gap in shape.gaps:
        found = found * gap / (from_one + gap)
    return np.asarray(found, dtype=np.complex128)


def find_margins(shape: LoopShape, period_s: float) -> Margins:
    """Return the margins of a loop that is stable."""
    found = [(math.pi + compute_phase(shape, x), find_angle(x)) for x in find_crossovers(shape)]
    phases = [(phase % (2.0 * math.pi), angle) for phase, angle in found]
    phase, crossover = min(phases, default=(None, None))
    factors = _list_factors(shape)
    above = min(((factor, angle) for factor, angle in factors if factor > 1.0), default=None)
    return Margins(
        gain_margin=None if above is None else above[0],
        gain_reduction=max((factor for factor, _ in factors if factor < 1.0), default=None),
        gain_frequency_rad_s=None if above is None else above[1] / period_s,
        phase_margin_rad=phase,
        crossover_rad_s=None if crossover is None else crossover / period_s,
        delay_margin_ticks=min((phase / angle for phase, angle in phases), default=None),
    )


def _list_factors(shape: LoopShape) -> list[tuple[float, float]]:
    """Return each factor that brings L to -1 somewhere, and the angle w T where it does."""

    def read_imaginary(angle: NDArray[np.float64]) -> NDArray[np.float64]:
        return evaluate_open_loop(shape, angle).imag

    angles = np.append(find_sign_changes(read_imaginary, list_angles(shape)), math.pi)
    values = evaluate_open_loop(shape, angles).real
    kept = (values > -_LARGEST_FACTOR) & (values < -1.0 / _LARGEST_FACTOR)
    return list(zip((-1.0 / values[kept]).tolist(), angles[kept].tolist(), strict=True))
