"""The sampled loop: y[k+1] = y[k] + Kp T (r - y[k-d]), an integrator held between samples.

T is the sampling period, d the dead time in samples. Its poles are the roots of
z^(d+1) - z^d + Kp T (`sampled_poles`). Its open loop is Kp T / (z^d (z - 1)), with the magnitude
Kp T / (2 sin(w T / 2)) and the phase -(pi / 2 + (d + 1/2) w T) at the frequency w.
"""

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.libraries import load_library
from turtlelog.theory.inputs import (
    require_count,
    require_dead_time,
    require_gain,
    require_level,
    require_period,
)
from turtlelog.theory.sampled_poles import compute_meeting_gain, compute_sampled_poles

LARGEST_DEVIATION: Final = 1e9
"""Size at which the response of an unstable loop is stopped, in steps from the reference."""

_NEGLIGIBLE_DEVIATION: Final = 1e-20
"""In steps from the reference: far below the last digit of a double near 1, 2e-16."""

_ROUNDING: Final = 1e-9
"""More than adding the reference to a response can change, as a share of it."""

_LONGEST: Final = 2_000_000
"""In samples, of the response that overshoot and settling time are read from: 16 MB as doubles, and
8.9 h at turtlesim's tick of 16 ms."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SampledLoop:
    """Properties of the sampled loop at one gain.

    Attributes:
        kp: Gain [1/s].
        period_s: Sampling period T [s].
        dead_time_ticks: d [samples].
        poles: Shape (d + 1,), complex, in the z plane, largest magnitude first.
        stable: All poles lie inside the unit circle.
        overshoots: The slowest poles have left the positive real axis.
        damping_ratio: Damping ratio of the slowest pole: 1 on the positive real axis, negative
            where unstable.
        overshoot_percent: Furthest sample beyond the reference after a step [% of the step]; None
            if it is unstable or slower than 2,000,000 samples.
        settling_time_s: First sample after a step from which on it stays within 2 % [s]; None as
            before.
        gain_margin: Factor on Kp that makes it unstable; below 1 it is.
        phase_margin_rad: Phase above -pi where the open loop's magnitude is 1 [rad]; None if Kp T >
            2, whose magnitude is nowhere as small as 1.
        delay_margin_ticks: Dead time that may be added, phase margin over crossover frequency
            [samples]: as many whole ticks as it holds keep the loop stable. None as before.
    """

    kp: float
    period_s: float
    dead_time_ticks: int
    poles: NDArray[np.complex128]
    stable: bool
    overshoots: bool
    damping_ratio: float
    overshoot_percent: float | None
    settling_time_s: float | None
    gain_margin: float
    phase_margin_rad: float | None
    delay_margin_ticks: float | None

    @property
    def delay_margin_s(self) -> float | None:
        """The delay margin in seconds."""
        ticks = self.delay_margin_ticks
        return None if ticks is None else ticks * self.period_s

    def to_control(self) -> Any:
        """Return the open loop as a `control.TransferFunction` in z, Kp T / (z^d (z - 1)).

        It is exact. `control.feedback` closes it.

        Raises:
            LibraryError: python-control is not installed.
        """
        poles = [1.0, -1.0, *[0.0] * self.dead_time_ticks]
        return load_library("control").tf([self.kp * self.period_s], poles, self.period_s)


def compute_overshoot_gain(period_s: float, dead_time_ticks: int = 0) -> float:
    """Return the largest Kp [1/s] without overshoot: d^d / (d + 1)^(d + 1) / T, 1 / T for d = 0.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    return compute_meeting_gain(require_dead_time(dead_time_ticks)) / require_period(period_s)


def compute_stability_gain(period_s: float, dead_time_ticks: int = 0) -> float:
    """Return the Kp [1/s] from which the loop is unstable: 2 sin(pi / (2 (2 d + 1))) / T.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    return _compute_stability_loop_gain(require_dead_time(dead_time_ticks)) / require_period(
        period_s
    )


def analyse_sampled_loop(kp: float, *, period_s: float, dead_time_ticks: int = 0) -> SampledLoop:
    """Return what the sampled loop does at a gain: poles, margins, overshoot, settling time.

    Args:
        kp: Gain [1/s].
        period_s: Sampling period T [s].
        dead_time_ticks: d [samples], 0 to 1000.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    poles = compute_sampled_poles(kp, period_s=period_s, dead_time_ticks=dead_time_ticks)
    loop_gain = kp * period_s
    gain_margin = _compute_stability_loop_gain(dead_time_ticks) / loop_gain
    phase_margin_rad, delay_margin_ticks = _compute_margins(loop_gain, dead_time_ticks)
    overshoot_percent, settling_ticks = _measure_step(poles, loop_gain, dead_time_ticks)
    return SampledLoop(
        kp=float(kp),
        period_s=float(period_s),
        dead_time_ticks=int(dead_time_ticks),
        poles=poles,
        stable=gain_margin > 1.0,
        overshoots=loop_gain > compute_meeting_gain(dead_time_ticks),
        damping_ratio=_compute_damping_ratio(poles[0]),
        overshoot_percent=overshoot_percent,
        settling_time_s=None if settling_ticks is None else settling_ticks * float(period_s),
        gain_margin=gain_margin,
        phase_margin_rad=phase_margin_rad,
        delay_margin_ticks=delay_margin_ticks,
    )


def compute_sampled_step_response(
    kp: float,
    count: int,
    *,
    period_s: float,
    dead_time_ticks: int = 0,
    initial: float = 0.0,
    reference: float = 1.0,
) -> NDArray[np.float64]:
    """Return the sampled loop's response to a step of its reference at sample 0, unclipped.

    y[k+1] = y[k] + Kp T (reference - y[k-d]), at rest before: the command that answers sample 0
    first moves the plant between samples d and d + 1, so y[0] to y[d] are `initial`.

    An unstable loop is stopped: from the first sample further than 1e9 steps from the reference
    on, the response stays at that distance, on that side. Less than 1e-20 steps count as none.

    Args:
        kp: Gain [1/s].
        count: Number of samples, at least 1.
        period_s: Sampling period T [s].
        dead_time_ticks: d [samples], 0 to 1000.
        initial: Level before the step, in any unit.
        reference: Level that is asked for, in the same unit.

    Returns:
        The response in that unit at the times 0, T, 2 T ..., shape (count,).

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    loop_gain = require_gain(kp) * require_period(period_s)
    step = require_level("initial", initial) - require_level("reference", reference)
    deviation = _compute_deviation(
        loop_gain, require_count(count), require_dead_time(dead_time_ticks)
    )
    return reference + step * deviation


def interpolate_sampled_response(
    kp: float,
    time_s: NDArray[np.float64],
    *,
    period_s: float,
    dead_time_ticks: int,
    initial: float,
    reference: float,
) -> NDArray[np.float64] | None:
    """Return the sampled loop's response at times from the step [s], shape (n,), rising.

    Its samples are at 0, T, 2 T ... and it moves along a line between them. None if the loop is
    unstable and goes beyond `LARGEST_DEVIATION` before the last of the times. The arguments are
    those of `compute_sampled_step_response`.
    """
    count = int(np.ceil(time_s[-1] / period_s)) + 2
    values = compute_sampled_step_response(
        kp,
        count,
        period_s=period_s,
        dead_time_ticks=dead_time_ticks,
        initial=initial,
        reference=reference,
    )
    # Where theory stops an unstable loop, what follows is no response of that loop.
    furthest = np.abs(values[:-1] - reference).max()
    if furthest > (1.0 - _ROUNDING) * LARGEST_DEVIATION * abs(reference - initial) > 0.0:
        return None
    return np.interp(time_s, np.arange(count) * period_s, values)


def _compute_stability_loop_gain(dead_time_ticks: int) -> float:
    """Return Kp T = 2 sin(pi / (2 (2 d + 1))), where the slowest poles cross the unit circle.

    There r = 1, so d theta and (d + 1) theta add up to pi, and Kp T = |1 - exp(j theta)|.
    """
    return 2.0 * math.sin(math.pi / (2 * (2 * dead_time_ticks + 1)))


def _compute_margins(loop_gain: float, d: int) -> tuple[float | None, float | None]:
    """Return phase margin [rad] and delay margin [samples]."""
    if loop_gain > 2.0:
        return None, None
    crossover = 2.0 * math.asin(0.5 * loop_gain)
    phase_margin_rad = 0.5 * math.pi - (d + 0.5) * crossover
    return phase_margin_rad, 0.5 * math.pi / crossover - (d + 0.5)


def _compute_damping_ratio(pole: complex) -> float:
    """Return -Re s / |s| of s = log z / T."""
    if pole in {0.0, 1.0}:
        return 1.0
    exponent = np.log(complex(pole))
    return float(-exponent.real / abs(exponent))


def _measure_step(
    poles: NDArray[np.complex128], loop_gain: float, d: int
) -> tuple[float | None, int | None]:
    """Return overshoot [%] and 2 % settling time [samples] of the step response itself."""
    # A pole at 0, which has no logarithm, counts as one of 1e-3: 0.1 % is left after one sample.
    decay = -math.log(max(abs(poles[0]), 1e-3)) if abs(poles[0]) < 1.0 else 0.0
    # exp(-12) of the slowest pole is left after so many samples, far below 2 %.
    if decay * _LONGEST < 12.0:
        return None, None
    count = 10 * (d + 1) + math.ceil(12.0 / decay)
    error = 1.0 - compute_sampled_step_response(loop_gain, count, period_s=1.0, dead_time_ticks=d)
    if np.abs(error).max() >= LARGEST_DEVIATION:
        return None, None
    outside = np.flatnonzero(np.abs(error) > 0.02)
    return max(0.0, -100.0 * float(error.min())), int(outside[-1]) + 1


def _compute_deviation(loop_gain: float, count: int, dead_time_ticks: int) -> NDArray[np.float64]:
    """Return e[k+1] = e[k] - Kp T e[k-d] from e[0] = 1 and e[k] = 0 before it, shape (count,).

    Each round doubles what is known. By superposition the samples that follow sample n are the
    sum of this same response, once for every sample that the recursion still remembers at n:
    scaled by e[n] and starting there, and scaled by -Kp T e[n-j] and starting d + 1 - j later.
    """
    deviation = np.ones(max(count, dead_time_ticks + 2))
    deviation[dead_time_ticks + 1] -= loop_gain
    known = dead_time_ticks + 2
    stop = _find_stop(deviation[:known])
    while known < count and stop is None:
        remembered = deviation[known - 1 - dead_time_ticks : known]
        if np.abs(remembered).max() < _NEGLIGIBLE_DEVIATION:
            deviation[known:] = 0.0
            break
        kernel = np.concatenate((remembered[-1:], -loop_gain * remembered[:-1]))
        new = deviation[known : 2 * known - 1]
        new[:] = np.convolve(deviation[:known], kernel)[1 : len(new) + 1]
        known += len(new)
        stop = _find_stop(deviation[:known])
    if stop is not None:
        deviation[stop:] = np.copysign(LARGEST_DEVIATION, deviation[stop])
    return deviation[:count]


def _find_stop(deviation: NDArray[np.float64]) -> int | None:
    """Return the first sample that is too far away, None if there is none."""
    beyond = np.abs(deviation) > LARGEST_DEVIATION
    return int(np.argmax(beyond)) if beyond.any() else None
