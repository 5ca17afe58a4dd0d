"""Established rules for the gains of a process that integrates, as published.

They are written for continuous time. T / 2 of the hold counts as dead time, as Skogestad (2003)
proposes. Each returns gains, or the reason why it does not apply.
"""

from collections.abc import Callable
from typing import Final

from turtlelog.theory.exact_gains import LoopDesign
from turtlelog.theory.pid_stability import PidGains

SKOGESTAD: Final = (
    "S. Skogestad, Simple analytic rules for model reduction and PID controller tuning, Journal of"
    " Process Control 13 (2003) 291-309: tight control, tau_c = theta"
)
ZIEGLER_NICHOLS: Final = (
    "J. G. Ziegler and N. B. Nichols, Optimum settings for automatic controllers, Transactions of"
    " the ASME 64 (1942) 759-768: half of the gain at which the loop oscillates without end"
)

_INTEGRAL: Final = 8.0
"""SIMC's tau_I = 4 (tau_c + theta) in theta, for tau_c = theta."""

Rule = Callable[[LoopDesign], PidGains | str]


def compute_simc_p(design: LoopDesign) -> PidGains:
    """Return SIMC without its integral: Kp = 1 / (K (tau_c + theta)), tau_c = theta.

    The half rule makes dead time of half the largest lag and of all of the other.
    """
    theta_s, _ = _reduce(design, kept=0)
    return PidGains(kp=0.5 / (design.process.gain * theta_s))


def compute_simc_pi(design: LoopDesign) -> PidGains:
    """Return SIMC for an integrator with dead time: its Kp, and tau_I = 4 (tau_c + theta)."""
    kp = compute_simc_p(design).kp
    theta_s, _ = _reduce(design, kept=0)
    return PidGains(kp=kp, ki=kp / (_INTEGRAL * theta_s))


def compute_simc_pd(design: LoopDesign) -> PidGains | str:
    """Return SIMC for an integrator with lag and dead time, without its integral: tau_D = the lag.

    The larger of two lags is kept. Half of the other adds to it, half to the dead time. The paper
    asks for a derivative only where the lag exceeds the dead time.
    """
    theta_s, lag_s = _reduce(design, kept=1)
    if lag_s <= theta_s:
        found = f"{1e3 * lag_s:.4g} ms of lag and {1e3 * theta_s:.4g} ms of dead time with the hold"
        return f"the rule takes a derivative where the lag exceeds the dead time; here are {found}"
    kp = 0.5 / (design.process.gain * theta_s)
    return PidGains(kp=kp, kd=kp * lag_s)


def compute_ziegler_nichols_p(design: LoopDesign) -> PidGains:
    """Return half of the ultimate gain, so that the gain margin is 2."""
    return PidGains(kp=0.5 * design.find_ultimate_gain())


RULES: Final[tuple[tuple[tuple[str, str, str], Rule], ...]] = (
    (("simc", "P", SKOGESTAD), compute_simc_p),
    (("simc", "PI", SKOGESTAD), compute_simc_pi),
    (("simc", "PD", SKOGESTAD), compute_simc_pd),
    (("ziegler-nichols", "P", ZIEGLER_NICHOLS), compute_ziegler_nichols_p),
)
"""Name, controller, source and function of each."""


def _reduce(design: LoopDesign, *, kept: int) -> tuple[float, float]:
    """Return dead time theta and the lag that is kept [s], 0 where none is, by the half rule."""
    process = design.process
    lags = sorted((process.lag_s, process.low_pass_s), reverse=True)
    left = [*lags[:kept], 0.0][0]
    half = 0.5 * lags[kept]
    theta_s = process.dead_time_s + 0.5 * design.period_s + half + sum(lags[kept + 1 :])
    return theta_s, left + half if kept else 0.0
