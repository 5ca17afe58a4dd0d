"""Recommended gains: exact gains for a wanted overshoot or phase margin, and published rules.

The published rules apply to continuous time. Half a sampling period T counts as dead time of the
hold, as Skogestad (2003) proposes. Each rule returns gains, or the reason why it does not apply.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

from turtlelog.errors import TheoryError
from turtlelog.theory import exact_gains as exact
from turtlelog.theory.exact_gains import LoopDesign
from turtlelog.theory.pid_stability import Margins, PidGains
from turtlelog.theory.process import (
    INTEGRATOR,
    Process,
    require_not_negative,
    require_period,
    require_positive,
)
from turtlelog.theory.step_motion import StepLimits, StepMotion

OVERSHOOT_PERCENT: Final = 5.0
"""Default of the wanted overshoot [% of the step]: the overshoot of a second-order loop with a
damping of 0.69, which stays within 5 % earliest."""

PHASE_MARGIN_RAD: Final = math.pi / 3.0
"""Default of the wanted phase margin: 60 deg, the cautious end of the usual 45 to 60 deg. Dead time
and time constant of a robot are known only to some ten percent."""

_EXACT: Final = "exact, of the sampled loop"

_GIVEN: Final = "given"


@dataclass(frozen=True, slots=True, kw_only=True)
class Recommendation:
    """Gains from one rule, or the reason why the rule gives none.

    Attributes:
        rule: `overshoot`, `phase-margin`, `simc`, `ziegler-nichols`, or `given`: gains in use.
        controller: `P`, `PI`, `PD`; for given gains also `PID`.
        source: Publication of the rule.
        gains: Gains of the controller; None if the rule gives no gains.
        reason: Reason why the rule gives no gains; empty if it gives gains.
        motion: Motion after a step, also between samples; None without gains, or if the loop is
            unstable or too slow to measure. With limits, of the worst step.
        margins: Stability margins; None without gains, or if the loop is unstable.
    """

    rule: str
    controller: str
    source: str
    gains: PidGains | None = None
    reason: str = ""
    motion: StepMotion | None = None
    margins: Margins | None = None


def recommend_gains(
    process: Process = INTEGRATOR,
    *,
    period_s: float,
    filter_s: float = 0.0,
    overshoot_percent: float | None = OVERSHOOT_PERCENT,
    phase_margin_rad: float | None = PHASE_MARGIN_RAD,
    limits: StepLimits | None = None,
) -> tuple[Recommendation, ...]:
    """Return gains of P, PI and PD for a heading or a position loop.

    Args:
        process: Plant that the command drives, with all dead time. Default: an integrator.
        period_s: Sampling period T [s].
        filter_s: Time constant of the derivative's filter [s]; 0: the difference of two samples
            without a filter.
        overshoot_percent: Wanted overshoot [% of the step], from 0 to below 100; None: any.
        phase_margin_rad: Wanted phase margin [rad], above 0 and below pi; None: any. Without this
            margin, the PD for an overshoot has a phase margin of 60 deg.
        limits: Limits of command and rate, with the largest step. The overshoot of all steps up to
            this size then meets the wish. Default: no limits.

    Returns:
        The exact gains for the wanted values, then those of published rules.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    design = LoopDesign(
        process=process,
        period_s=require_period(period_s),
        filter_s=require_not_negative("filter_s", filter_s),
        limits=limits,
    )
    margin_rad = PHASE_MARGIN_RAD if phase_margin_rad is None else phase_margin_rad
    margin_rad = require_positive("phase_margin_rad", margin_rad)
    if not margin_rad < math.pi:
        problem = f"expected less than pi, found {margin_rad!r}"
        raise TheoryError(problem, quantity="phase_margin_rad")
    rules: list[tuple[str, str, str, Callable[[], PidGains | str]]] = []
    if overshoot_percent is not None:
        percent = require_not_negative("overshoot_percent", overshoot_percent)
        if not percent < 100.0:
            problem = f"expected less than 100 %, found {percent!r}"
            raise TheoryError(problem, quantity="overshoot_percent")
        find_pd = partial(exact.find_pd_of_overshoot, margin_rad=margin_rad)
        rules += [
            ("overshoot", "P", _EXACT, partial(exact.find_p_of_overshoot, design, percent)),
            ("overshoot", "PI", _EXACT, partial(exact.find_pi_of_overshoot, design, percent)),
            ("overshoot", "PD", _EXACT, partial(find_pd, design, percent)),
        ]
    if phase_margin_rad is not None:
        rules += [
            ("phase-margin", "P", _EXACT, partial(exact.find_p_of_margin, design, margin_rad)),
            ("phase-margin", "PI", _EXACT, partial(exact.find_pi_of_margin, design, margin_rad)),
            ("phase-margin", "PD", _EXACT, partial(exact.find_pd_of_margin, design, margin_rad)),
        ]

    def halve_ultimate_gain() -> PidGains:  # which gives a gain margin of 2
        return PidGains(kp=0.5 * design.find_ultimate_gain())

    rules += [
        *(("simc", kind, _SKOGESTAD, partial(_compute_simc, design, kind)) for kind in _KINDS),
        ("ziegler-nichols", "P", _ZIEGLER_NICHOLS, halve_ultimate_gain),
    ]
    return tuple(_judge(design, *rule) for rule in rules)


def measure_gains(
    gains: PidGains,
    process: Process = INTEGRATOR,
    *,
    period_s: float,
    limits: StepLimits | None = None,
) -> Recommendation:
    """Return the properties of given gains, in the same form as recommended ones.

    Args:
        gains: Gains of the controller.
        process: Plant that the command drives, with all dead time. Default: an integrator.
        period_s: Sampling period T [s].
        limits: Limits of command and rate, with the largest step. Default: no limits.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    design = LoopDesign(process=process, period_s=require_period(period_s), limits=limits)
    controller = f"P{'I' if gains.ki else ''}{'D' if gains.kd else ''}"
    return _judge(design, _GIVEN, controller, _GIVEN, lambda: gains)


def is_no_worse(given: Recommendation, best: Recommendation) -> bool:
    """Return whether given gains are as good as recommended ones.

    Given gains are as good if they have at most the overshoot, or at least the phase margin, of the
    recommended gains, and settle no later. Recommended gains rounded to three digits count as
    equal.

    Args:
        given: Gains in use.
        best: Recommended gains for an overshoot or a phase margin.
    """
    if given.margins is None or given.motion is None or best.motion is None:
        return False
    if given.gains is not None and best.gains is not None:
        ours, theirs = ((one.kp, one.ki, one.kd) for one in (given.gains, best.gains))
        pairs = zip(ours, theirs, strict=True)
        if all(math.isclose(one, other, rel_tol=_SAME_GAIN) for one, other in pairs):
            return True
    settles_s, best_settles_s = given.motion.settling_time_s, best.motion.settling_time_s
    if settles_s is None or (best_settles_s is not None and settles_s > best_settles_s + _EQUAL_S):
        return False
    if best.rule == "overshoot":
        most_percent = best.motion.overshoot_percent + _EQUAL_PERCENT
        return given.motion.overshoot_percent <= most_percent
    margin_rad = given.margins.phase_margin_rad
    least_rad = None if best.margins is None else best.margins.phase_margin_rad
    return margin_rad is None or (least_rad is not None and margin_rad >= least_rad - _EQUAL_RAD)


_EQUAL_S: Final = 1e-9
"""Rounding of a settling time, which is a whole number of periods [s]."""

_EQUAL_PERCENT: Final = 0.005
"""Half of the last printed digit of an overshoot [% of the step]."""

_EQUAL_RAD: Final = math.radians(0.05)
"""Half of the last printed digit of a phase margin [rad]."""

_SAME_GAIN: Final = 0.005
"""Largest change of a gain by rounding to three digits, as a share of the gain."""


def _judge(
    design: LoopDesign,
    rule: str,
    controller: str,
    source: str,
    compute: Callable[[], PidGains | str],
) -> Recommendation:
    """Return the gains of a rule, and the properties of their loop."""
    try:
        gains = compute()
        margins = None if isinstance(gains, str) else design.read_margins(gains)
    except TheoryError as err:  # gains outside what theory takes
        gains, margins = str(err), None
    if isinstance(gains, str):
        return Recommendation(rule=rule, controller=controller, source=source, reason=gains)
    must_rest = design.limits is not None and rule != _GIVEN
    motion = None if margins is None else design.measure(gains, must_rest=must_rest)
    if must_rest and motion and motion.settling_time_s is None:
        reason = "under the limits of acceleration, a step oscillates and does not settle"
        return Recommendation(rule=rule, controller=controller, source=source, reason=reason)
    return Recommendation(
        rule=rule,
        controller=controller,
        source=source,
        gains=gains,
        motion=motion,
        margins=margins,
    )


_SKOGESTAD: Final = (
    "S. Skogestad, Simple analytic rules for model reduction and PID controller tuning, Journal of"
    " Process Control 13 (2003) 291-309: tight control, tau_c = theta"
)
_ZIEGLER_NICHOLS: Final = (
    "J. G. Ziegler and N. B. Nichols, Optimum settings for automatic controllers, Transactions of"
    " the ASME 64 (1942) 759-768: half of the gain at which the loop oscillates without end"
)

_KINDS: Final = ("P", "PI", "PD")

_INTEGRAL: Final = 8.0
"""SIMC's tau_I = 4 (tau_c + theta) as a multiple of theta, for tau_c = theta."""


def _compute_simc(design: LoopDesign, kind: str) -> PidGains | str:
    """Return the gains of the SIMC rule, without integral: Kp = 1 / (K (tau_c + theta)).

    The tuning constant tau_c equals the dead time theta. By the half rule, half of the largest lag
    and all of the other lag count as dead time. Of PD the derivative time tau_D is the lag: the
    larger of two, plus half of the smaller one, whose other half is dead time. The paper recommends
    a derivative only if the lag exceeds the dead time.
    """
    theta_s, lag_s = _reduce(design, kept=int(kind == "PD"))
    kp = 0.5 / (design.process.gain * theta_s)
    if kind == "PD" and lag_s <= theta_s:
        found = f"{1e3 * lag_s:.4g} ms of lag and {1e3 * theta_s:.4g} ms of dead time with the hold"
        return f"the rule takes a derivative where the lag exceeds the dead time; here are {found}"
    return PidGains(kp=kp, ki=kp / (_INTEGRAL * theta_s) if kind == "PI" else 0.0, kd=kp * lag_s)


def _reduce(design: LoopDesign, *, kept: int) -> tuple[float, float]:
    """Return dead time theta and remaining lag [s] by the half rule; 0 if no lag remains."""
    process = design.process
    lags = sorted((process.lag_s, process.low_pass_s), reverse=True)
    left = [*lags[:kept], 0.0][0]
    half = 0.5 * lags[kept]
    theta_s = process.dead_time_s + 0.5 * design.period_s + half + sum(lags[kept + 1 :])
    return theta_s, left + half if kept else 0.0
