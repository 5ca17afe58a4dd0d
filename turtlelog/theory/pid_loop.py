"""The sampled PID loop with a process, held between samples: poles, verdict, limits, margins.

The controller, as the law `sequential-pid` computes it, with e = r - y:

    u[k] = Kp e[k] + I[k] + D[k]
    I[k+1] = I[k] + Ki T e[k],  I[0] = 0
    D[k] = a D[k-1] - Kd / (Tf + T) (y[k] - y[k-1]),  a = Tf / (Tf + T),  D[0] = 0

The integral is a forward difference, so it acts one sample later. The derivative is that of the
measurement, a backward difference behind a filter of first order: K. J. Astrom and B. Wittenmark,
Computer-Controlled Systems, 3rd edition, chapter 8; K. J. Astrom and T. Hagglund, Advanced PID
Control, chapters 3 and 13. On an integrator, y[k+1] = y[k] + T u[k-d], the z transform of that
gives the characteristic polynomial

    z^d (z - 1)^2 (z - a) + Kp T (z - 1) (z - a) + Ki T^2 (z - a) + b (z - 1)^2

with b = Kd T / (Tf + T). Without an integral one factor z - 1 leaves it, without a derivative
z - a. What lag, part of a sample and low-pass add stands in `process` and `pid_stability`. P alone
on an integrator is the business of `sampled_loop`, whose numbers are returned here.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from turtlelog.errors import TheoryError
from turtlelog.theory.control_systems import build_open_loop
from turtlelog.theory.inputs import require_period, require_times
from turtlelog.theory.pid_gains import PidGains, build_shape
from turtlelog.theory.pid_margins import Margins, evaluate_open_loop, find_margins
from turtlelog.theory.pid_poles import find_poles
from turtlelog.theory.pid_response import measure_pid_step
from turtlelog.theory.pid_stability import LoopShape, find_stable_intervals, is_stable
from turtlelog.theory.process import INTEGRATOR, Process, sample_process
from turtlelog.theory.sampled_loop import (
    analyse_sampled_loop,
    compute_stability_gain,
)
from turtlelog.theory.sampled_poles import compute_sampled_locus, compute_sampled_poles


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PidLoop:
    """Properties of a sampled PID loop.

    Attributes:
        gains: Gains of the controller.
        period_s: Sampling period T [s].
        dead_time_ticks: Dead time beside that of the process [samples].
        process: Plant that the command drives.
        poles: Complex, in the z plane, largest magnitude first: d + 1 of P, one more with an
            integral, a derivative, a time constant, a low-pass or part of a sample of dead time
            each. If two poles meet, half their digits are known.
        stable: All poles lie inside the unit circle, farther from it than rounding reaches.
        stable_gains: Intervals of Kp [1/s] in which the loop is stable with its other gains as
            they are; () where there is none.
        overshoot_percent: Furthest sample beyond the reference after a step [% of the step]; None
            if it is unstable or slower than 500,000 samples (P alone: 2,000,000).
        settling_time_s: First sample after a step from which on it stays within 2 % [s]; None as
            before.
        margins: Stability margins; None if it is unstable.
    """

    gains: PidGains
    period_s: float
    dead_time_ticks: int
    process: Process
    poles: NDArray[np.complex128]
    stable: bool
    stable_gains: tuple[tuple[float, float], ...]
    overshoot_percent: float | None
    settling_time_s: float | None
    margins: Margins | None

    @property
    def dead_time_s(self) -> float:
        """All dead time [s]."""
        return self.dead_time_ticks * self.period_s + self.process.dead_time_s

    @property
    def largest_magnitude(self) -> float:
        """Magnitude of the slowest pole; 1 and above where the loop is unstable."""
        return float(abs(self.poles[0]))

    def to_control(self) -> Any:
        """Return the open loop as a `control.TransferFunction` in z; it is exact.

        `control.feedback` closes it. The derivative acts on the measurement, so what is closed
        answers the reference as this loop does with P and PI alone.

        Raises:
            LibraryError: python-control is not installed.
        """
        shape, _ = _prepare(self.gains, self.period_s, self.dead_time_ticks, self.process)
        return build_open_loop(shape, self.period_s)


def analyse_pid_loop(
    gains: PidGains,
    *,
    period_s: float,
    dead_time_ticks: int = 0,
    process: Process = INTEGRATOR,
) -> PidLoop:
    """Return what a PID loop does: poles, verdict, range of its gain, step response, margins.

    Args:
        gains: Gains of the controller.
        period_s: Sampling period T [s].
        dead_time_ticks: Dead time beside that of the process [samples], 0 to 1000 in all; with 1000
            it takes about half a second.
        process: Plant that the command drives; an integrator unless given.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    poles = compute_pid_poles(
        gains, period_s=period_s, dead_time_ticks=dead_time_ticks, process=process
    )
    shape, whole = _prepare(gains, period_s, dead_time_ticks, process)
    stable = _judge(shape, whole)
    overshoot_percent, settling_time_s = None, None
    if whole is not None:
        kp = gains.kp * process.gain
        known = analyse_sampled_loop(kp, period_s=period_s, dead_time_ticks=whole)
        overshoot_percent, settling_time_s = known.overshoot_percent, known.settling_time_s
    elif stable:
        overshoot_percent, settling_time_s = measure_pid_step(
            gains, poles, period_s=period_s, dead_time_ticks=dead_time_ticks, process=process
        )
    return PidLoop(
        gains=gains,
        period_s=float(period_s),
        dead_time_ticks=int(dead_time_ticks),
        process=process,
        poles=poles,
        stable=stable,
        stable_gains=find_stable_gains(
            gains, period_s=period_s, dead_time_ticks=dead_time_ticks, process=process
        ),
        overshoot_percent=overshoot_percent,
        settling_time_s=settling_time_s,
        margins=find_margins(shape, float(period_s)) if stable else None,
    )


def compute_pid_poles(
    gains: PidGains,
    *,
    period_s: float,
    dead_time_ticks: int = 0,
    process: Process = INTEGRATOR,
) -> NDArray[np.complex128]:
    """Return the poles of a closed PID loop in the z plane, largest magnitude first.

    If two poles meet, as every root of a polynomial they are known to half the digits, about 1e-8.
    The verdict of `is_pid_stable` does not depend on them.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    shape, whole = _prepare(gains, period_s, dead_time_ticks, process)
    if whole is None:
        return find_poles(shape)
    return compute_sampled_poles(gains.kp * process.gain, period_s=period_s, dead_time_ticks=whole)


def compute_pid_locus(
    gains: PidGains,
    kp: Sequence[float],
    *,
    period_s: float,
    dead_time_ticks: int = 0,
    process: Process = INTEGRATOR,
) -> NDArray[np.complex128]:
    """Return the poles of a closed PID loop at several Kp, its other gains held, in one row.

    Each as `compute_pid_poles` returns it, much faster of P on an integrator.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    _, whole = _prepare(gains, period_s, dead_time_ticks, process)
    if whole is not None:
        own = [gain * process.gain for gain in kp]
        return compute_sampled_locus(own, period_s=period_s, dead_time_ticks=whole).ravel()
    settings: dict[str, Any] = {"dead_time_ticks": dead_time_ticks, "process": process}
    found = [compute_pid_poles(replace(gains, kp=k), period_s=period_s, **settings) for k in kp]
    return np.concatenate(found)


def is_pid_stable(
    gains: PidGains,
    *,
    period_s: float,
    dead_time_ticks: int = 0,
    process: Process = INTEGRATOR,
) -> bool:
    """Return whether all poles of a closed PID loop lie inside the unit circle.

    They are counted by the argument principle, which is as good at 1000 ticks as at none. At the
    limit itself, and so near to it that rounding could decide (1e-10), the answer is False.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    return _judge(*_prepare(gains, period_s, dead_time_ticks, process))


def find_stable_gains(
    gains: PidGains,
    *,
    period_s: float,
    dead_time_ticks: int = 0,
    process: Process = INTEGRATOR,
) -> tuple[tuple[float, float], ...]:
    """Return the intervals of Kp [1/s] in which a loop is stable, its other gains held.

    P and PD begin at 0. An integral needs some Kp beside it, so PI and PID begin above 0; too much
    of it and there is no interval left. The ends themselves are unstable.

    Args:
        gains: Gains of the controller; its own Kp does not count.
        period_s: Sampling period T [s].
        dead_time_ticks: Dead time beside that of the process [samples], 0 to 1000 in all.
        process: Plant that the command drives; an integrator unless given.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    period_s = require_period(period_s)
    per_gain = period_s * process.gain
    gains = gains if gains.is_proportional else replace(gains, kp=1.0 / per_gain)
    held, whole = _prepare(gains, period_s, dead_time_ticks, process)
    if whole is not None:
        return ((0.0, compute_stability_gain(period_s, whole) / process.gain),)
    found = find_stable_intervals(lambda p: replace(held, p=p), held)
    return tuple((low / per_gain, high / per_gain) for low, high in found)


def compute_open_loop(
    gains: PidGains,
    frequency_rad_s: ArrayLike,
    *,
    period_s: float,
    dead_time_ticks: int = 0,
    process: Process = INTEGRATOR,
) -> NDArray[np.complex128]:
    """Return the frequency response of the open loop, in the shape of the frequencies.

    Args:
        gains: Gains of the controller.
        frequency_rad_s: Frequencies [rad/s], above 0 and up to pi / T.
        period_s: Sampling period T [s].
        dead_time_ticks: Dead time beside that of the process [samples], 0 to 1000 in all.
        process: Plant that the command drives; an integrator unless given.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    shape, _ = _prepare(gains, period_s, dead_time_ticks, process)
    angle = require_times(frequency_rad_s) * period_s
    if not ((angle > 0.0) & (angle <= np.pi * (1.0 + 1e-12))).all():
        raise TheoryError("frequency_rad_s: expected frequencies above 0 and up to pi / T")
    return evaluate_open_loop(shape, angle)


def _prepare(
    gains: PidGains, period_s: float, dead_time_ticks: int, process: Process
) -> tuple[LoopShape, int | None]:
    """Return a loop, and its dead time [samples] where it is P on an integrator."""
    sampled = sample_process(process, period_s, dead_time_ticks)
    is_known = gains.is_proportional and sampled.is_integrator
    return build_shape(gains, sampled, period_s), sampled.whole if is_known else None


def _judge(shape: LoopShape, whole: int | None) -> bool:
    if whole is None:
        return is_stable(shape)
    return compute_stability_gain(1.0, whole) / shape.p > 1.0
