"""Recommended gains: exact gains for a wanted overshoot or phase margin, and published rules.

Let L1 be the open loop in z at Kp = 1, G the process and W the phase margin:

    P    overshoot     the smallest Kp whose motion overshoots by as much
    P    phase margin  Kp = 1 / |L1| where L1 has the phase W - pi
    PI   overshoot     Kp the largest of P without overshoot, then the smallest such Ki
    PI   phase margin  the largest Ki among C = exp(j (W - pi)) / G at all frequencies
    PD   phase margin  Kd puts the controller's zero on the pole of the slowest lag
    PD   overshoot     both at once: the first on the way from that PD to P

C = Kp + Ki T / (z - 1) gives one Kp and one Ki at each frequency. The largest Ki gives the smallest
integrated error, 1 / Ki, after a constant disturbance. K. J. Astrom, H. Panagopoulos and T.
Hagglund maximise Ki under another constraint (Automatica 34 (1998) 585-601). Kp + Kd / (Tf + T) (z
- 1) / (z - a) has its zero at e = exp(-T / tau) if Kd = Kp (Tf + T) (e - a) / (1 - e); this also
gives one Kp and one Kd at each frequency.

The published rules apply to continuous time. Half a sampling period T counts as dead time of the
hold, as Skogestad (2003) proposes.
"""

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import TheoryError
from turtlelog.theory.loop_design import (
    CLOSE_PERCENT,
    GAIN_STEP,
    TOO_SLOW,
    LoopDesign,
    find_first_gain,
    find_p_without_any_overshoot,
    solve_between,
)
from turtlelog.theory.pid_stability import (
    Margins,
    PidGains,
    evaluate_open_loop,
    find_maximum,
    find_sign_changes,
    list_angles,
)
from turtlelog.theory.process import (
    INTEGRATOR,
    Process,
    require_not_negative,
    require_period,
    require_positive,
)
from turtlelog.theory.step_motion import StepLimits, StepMotion

_Array = NDArray[np.float64]

OVERSHOOT_PERCENT: Final = 5.0
"""Default of the wanted overshoot [% of the step]: the overshoot of a second-order loop with a
damping of 0.69, which stays within 5 % earliest."""

PHASE_MARGIN_RAD: Final = math.pi / 3.0
"""Default of the wanted phase margin: 60 deg, the cautious end of the usual 45 to 60 deg. Dead time
and time constant of a robot are known only to some ten percent."""

_Compute = Callable[[], PidGains | str]
_Rule = tuple[str, str, str, _Compute]
"""Name of a rule, its kind of controller and its source, with its gains or why it gives none."""

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
            unstable, or too slow to measure with limits. With limits, of the worst step.
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
        limits: Limits of command and rate, with the largest step. The overshoot of all steps of
            `StepLimits.list_steps` then meets the wish; between two of them, 5 % apart in size, it
            may be larger by half. Default: no limits.

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
    _require_below("phase_margin_rad", margin_rad, math.pi)
    rules: list[_Rule] = []
    if overshoot_percent is not None:
        percent = require_not_negative("overshoot_percent", overshoot_percent)
        _require_below("overshoot_percent", percent, 100.0)
        rules += [
            ("overshoot", kind, _EXACT, partial(_search_steps, design, percent, find))
            for kind, find in (
                ("P", _find_p_of_overshoot),
                ("PI", _find_pi_of_overshoot),
                ("PD", partial(_find_pd_of_overshoot, margin_rad=margin_rad)),
            )
        ]
    if phase_margin_rad is not None:
        finds = _find_p_of_margin, _find_pi_of_margin, _find_pd_of_margin
        rules += [
            ("phase-margin", kind, _EXACT, partial(find, design, margin_rad))
            for kind, find in zip(_KINDS, finds, strict=True)
        ]
    return tuple(_judge(design, *rule) for rule in (*rules, *_list_published(design)))


def _require_below(quantity: str, value: float, most: float) -> None:
    if not value < most:
        end = "pi" if most == math.pi else f"{most:g} %"
        raise TheoryError(f"expected less than {end}, found {value!r}", quantity=quantity)


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
    recommended gains, and settle no later. Gains within 1 % of recommended ones count as equal.

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
        return given.motion.overshoot_percent <= best.motion.overshoot_percent + EQUAL_PERCENT
    margin_rad = given.margins.phase_margin_rad
    least_rad = None if best.margins is None else best.margins.phase_margin_rad
    return margin_rad is None or (least_rad is not None and margin_rad >= least_rad - _EQUAL_RAD)


_EQUAL_S: Final = 1e-9  # rounding of a settling time, which is a whole number of periods [s]
EQUAL_PERCENT: Final = 0.005  # half of the last printed digit of an overshoot [% of the step]
_EQUAL_RAD: Final = math.radians(0.05)  # half of the last printed digit of a phase margin [rad]

_SAME_GAIN: Final = 0.01
"""Largest change of a gain that counts as none, as a share of the gain: a tenth of what is known of
a robot's gain, and the rounding to two digits of all gains above 0.5."""


def _judge(
    design: LoopDesign, rule: str, controller: str, source: str, compute: _Compute
) -> Recommendation:
    """Return the gains of a rule, and the properties of their loop."""
    found = Recommendation(rule=rule, controller=controller, source=source)
    try:
        gains = compute()
        margins = None if isinstance(gains, str) else design.read_margins(gains)
    except TheoryError as err:  # gains outside what theory takes
        gains, margins = str(err), None
    if isinstance(gains, str):
        return replace(found, reason=gains)
    must_rest = design.limits is not None and rule != _GIVEN
    if must_rest and design.is_slow:
        return replace(found, reason=TOO_SLOW)
    motion = None if margins is None else design.measure(gains, must_rest=must_rest)
    if must_rest and motion and motion.settling_time_s is None:
        reason = "under the limits of acceleration, a step oscillates and does not settle"
        return replace(found, reason=reason)
    return replace(found, gains=gains, motion=motion, margins=margins)


_SKOGESTAD: Final = (
    "S. Skogestad, Simple analytic rules for model reduction and PID controller tuning, Journal of"
    " Process Control 13 (2003) 291-309: tight control, tau_c = theta"
)
_ZIEGLER_NICHOLS: Final = (
    "J. G. Ziegler and N. B. Nichols, Optimum settings for automatic controllers, Transactions of"
    " the ASME 64 (1942) 759-768: half of the gain at which the loop oscillates without end"
)

_KINDS: Final = ("P", "PI", "PD")

_INTEGRAL: Final = 8.0  # SIMC's tau_I = 4 (tau_c + theta) as a multiple of theta, for tau_c = theta


def _list_published(design: LoopDesign) -> list[_Rule]:
    def halve_ultimate_gain() -> PidGains:  # which gives a gain margin of 2
        return PidGains(kp=0.5 * design.find_ultimate_gain())

    return [
        *(("simc", kind, _SKOGESTAD, partial(_compute_simc, design, kind)) for kind in _KINDS),
        ("ziegler-nichols", "P", _ZIEGLER_NICHOLS, halve_ultimate_gain),
    ]


def _compute_simc(design: LoopDesign, kind: str) -> PidGains | str:
    """Return the gains of the SIMC rule, without integral: Kp = 1 / (K (tau_c + theta)).

    The tuning constant tau_c equals the dead time theta. By the half rule, half of the largest lag
    and all of the other lag count as dead time. Of PD the derivative time tau_D is the lag: the
    larger of two, plus half of the smaller one, whose other half is dead time. The paper recommends
    a derivative only if the lag exceeds the dead time. The rule knows no filter of the derivative:
    the loop keeps the one that it has, and is measured with it.
    """
    theta_s, lag_s = _reduce(design, kept=int(kind == "PD"))
    kp = 0.5 / (design.process.gain * theta_s)
    if kind == "PD" and lag_s <= theta_s:
        found = f"{1e3 * lag_s:.4g} ms of lag and {1e3 * theta_s:.4g} ms of dead time with the hold"
        return f"the rule takes a derivative where the lag exceeds the dead time; here are {found}"
    if kind == "PD":
        return PidGains(kp=kp, kd=kp * lag_s, filter_s=design.filter_s)
    return PidGains(kp=kp, ki=kp / (_INTEGRAL * theta_s) if kind == "PI" else 0.0)


def _reduce(design: LoopDesign, *, kept: int) -> tuple[float, float]:
    """Return dead time theta and remaining lag [s] by the half rule; 0 if no lag remains."""
    process = design.process
    lags = sorted((process.lag_s, process.low_pass_s), reverse=True)
    left = [*lags[:kept], 0.0][0]
    half = 0.5 * lags[kept]
    theta_s = process.dead_time_s + 0.5 * design.period_s + half + sum(lags[kept + 1 :])
    return theta_s, left + half if kept else 0.0


_PARTS: Final = 8
"""Number of PD gains tried between the crossovers of P and of the PD that cancels the lag."""


def _search_steps(
    design: LoopDesign, percent: float, find: Callable[[LoopDesign, float], PidGains | str]
) -> PidGains | str:
    """Return gains with which no simulated step overshoots more, or the reason for absence."""
    while not isinstance(gains := find(design, percent), str):
        if (harder := design.add_worst_step(gains, percent)) is design:
            break
        design = harder
    return gains


def _find_p_of_overshoot(design: LoopDesign, percent: float) -> PidGains | str:
    """Return the P controller with an overshoot, or the reason why there is no such controller."""
    if design.is_slow:
        return TOO_SLOW
    start = find_p_without_any_overshoot(design)
    if percent == 0.0:
        return PidGains(kp=start)
    ends = start, GAIN_STEP * start
    kp = find_first_gain(
        lambda kp: design.measure_overshoot(PidGains(kp=kp)), *ends, percent, design.close
    )
    return PidGains(kp=kp)


def _find_pi_of_overshoot(design: LoopDesign, percent: float) -> PidGains | str:
    """Return the PI controller with an overshoot, or the reason why there is no such controller."""
    if percent == 0.0:
        return (
            "on a plant that integrates, an integral always overshoots: it comes to rest only when"
            " the errors have added up to 0"
        )
    if design.is_slow:
        return TOO_SLOW
    kp = find_p_without_any_overshoot(design)
    # Without lag and dead time an overshoot of 5 % takes Ki = 0.055 K Kp^2.
    start = 0.5 * percent / 100.0 * design.process.gain * kp * kp

    def measure(ki: float) -> float:
        return design.measure_overshoot(PidGains(kp=kp, ki=ki))

    ki = find_first_gain(measure, 0.0, start, percent, design.close)
    return PidGains(kp=kp, ki=ki)


def _find_pd_of_overshoot(design: LoopDesign, percent: float, margin_rad: float) -> PidGains | str:
    """Return the PD with an overshoot and a phase margin, or the reason for its absence."""
    whole = _find_pd_of_margin(design, margin_rad)
    alone = _find_p_of_margin(design, margin_rad)
    if isinstance(whole, str) or isinstance(alone, str):
        return whole if isinstance(whole, str) else alone
    if design.is_slow:
        return TOO_SLOW
    shape = design.build_shape(PidGains(kp=design.unit_gain))
    unit = PidGains(kp=1.0, kd=1.0, filter_s=design.filter_s)
    keep, rate = unit.weigh_derivative(design.period_s)

    def follow(angle: float) -> PidGains:
        """Return the only PD whose open loop has the phase margin at an angle w T."""
        z = cmath.exp(1j * angle)
        wanted = cmath.exp(1j * (margin_rad - math.pi)) / complex(evaluate_open_loop(shape, angle))
        difference = (z - 1.0) / (z - keep)
        weight = max(wanted.imag / difference.imag, 0.0)
        kp = design.unit_gain * (wanted.real - weight * difference.real)
        return PidGains(kp=kp, kd=design.unit_gain * weight / rate, filter_s=design.filter_s)

    def measure(angle: float) -> float:
        return design.measure_overshoot(follow(angle))

    words = f"with a phase margin of {math.degrees(margin_rad):g} deg PD"
    lowest, high = (design.find_crossover(gains) for gains in (alone, whole))
    value = measure(high)
    if value > percent + CLOSE_PERCENT:
        return f"{words} overshoots by {value:.3g} % even where Kd cancels the lag"
    for low in np.linspace(high, lowest, _PARTS + 1)[1:].tolist():
        below = measure(low)
        if below > percent + CLOSE_PERCENT:
            ends = (high, value), (low, below)
            gains = follow(solve_between(measure, *ends, percent, design.close))
            return gains if design.has_margin(gains, margin_rad) else _tell_no_margin(margin_rad)
        high, value = low, below
    return f"{words} overshoots less"


def _find_p_of_margin(design: LoopDesign, margin_rad: float) -> PidGains | str:
    """Return the P controller with a phase margin, or the reason why there is none."""
    return _find_pd(design, 0.0, margin_rad)


def _find_pd_of_margin(design: LoopDesign, margin_rad: float) -> PidGains | str:
    """Return the PD with a phase margin whose Kd cancels the lag, or the reason for its absence."""
    ratio_s = design.find_lag_ratio()
    if ratio_s is not None:
        return _find_pd(design, ratio_s, margin_rad)
    if design.sampled.gaps:
        return "the derivative's filter is slower than the lag, so no Kd cancels it"
    return "there is no lag to cancel; of an integrator alone D only makes the gain smaller"


def _find_pi_of_margin(design: LoopDesign, margin_rad: float) -> PidGains | str:
    """Return the PI with a phase margin and the largest Ki, or the reason for its absence."""
    alone = _find_p_of_margin(design, margin_rad)
    if isinstance(alone, str):
        return alone
    shape = design.build_shape(PidGains(kp=design.unit_gain))

    def compute(angle: _Array) -> tuple[_Array, _Array]:
        """Return Kp divided by the unit gain, and Ki T divided by the unit gain."""
        wanted = cmath.exp(1j * (margin_rad - math.pi)) / evaluate_open_loop(shape, angle)
        integral = -2.0 * np.tan(0.5 * angle) * wanted.imag
        return wanted.real + 0.5 * integral, integral

    def compute_integral(angle: _Array) -> _Array:
        proportional, integral = compute(angle)
        return np.where(proportional > 0.0, integral, -1.0)

    # An integral takes phase away, so PI crosses over earlier than P alone.
    angle, _ = find_maximum(compute_integral, design.find_crossover(alone))
    proportional, integral = (float(value[0]) for value in compute(np.array([angle])))
    unit = design.unit_gain
    gains = PidGains(kp=unit * proportional, ki=unit * integral / design.period_s)
    return gains if design.has_margin(gains, margin_rad) else _tell_no_margin(margin_rad)


def _find_pd(design: LoopDesign, ratio_s: float, margin_rad: float) -> PidGains | str:
    """Return the largest P or PD with a phase margin and a Kd / Kp, or the reason for absence."""
    unit = PidGains(kp=design.unit_gain, kd=ratio_s * design.unit_gain, filter_s=design.filter_s)
    shape = design.build_shape(unit)
    turn = cmath.exp(1j * (math.pi - margin_rad))

    def read_imaginary(angle: _Array) -> _Array:
        return (turn * evaluate_open_loop(shape, angle)).imag

    for angle in find_sign_changes(read_imaginary, list_angles(shape)).tolist():
        value = turn * complex(evaluate_open_loop(shape, angle))
        if value.real > 0.0:
            kp = unit.kp / abs(value)
            gains = replace(unit, kp=kp, kd=ratio_s * kp)
            if design.has_margin(gains, margin_rad):
                return gains
    return _tell_no_margin(margin_rad)


def _tell_no_margin(margin_rad: float) -> str:
    if margin_rad >= 0.5 * math.pi:
        return "the integrator alone lags by 90 deg, so a phase margin is below 90 deg"
    return f"no gains have a phase margin of {math.degrees(margin_rad):g} deg"
