"""`turtlelog theory`: what the ideal loop and the sampled loop should do."""

from typing import TYPE_CHECKING, Any, Final

import turtlelog as tl
from turtlelog.cli.options import Json, Whole
from turtlelog.cli.output import format_table, print_json, print_text
from turtlelog.cli.theory_tables import compute_limits, list_dead_times, tabulate_theory
from turtlelog.errors import UsageError

if TYPE_CHECKING:
    from turtlelog import SampledLoop

_MOST_GAINS: Final = 100


def theory(
    *,
    kp: str = "1,2,4,10",
    period: float = 0.016,
    dead_time: Whole = 0,
    json: Json = False,
) -> None:
    """Say what theory expects of an integrator under proportional feedback.

    The plant 1/s, the ideal loop Kp / (s + Kp), and the sampled loop with dead
    time: poles, overshoot, settling times, margins, and the gains at which
    overshoot and instability begin. Commands are not clipped. The paper's
    programs had 4 or 5 ticks of dead time while rotating, 6 while translating.

    Example: turtlelog theory --kp 1,2,4,10 --dead-time 6

    Args:
        kp: Gains [1/s], at most 100, with commas between.
        period: Sampling period [s]; turtlesim's tick by default.
        dead_time: Dead time [ticks], 0 to 1000; 0 is the least possible.
        json: Print one JSON object instead of tables.
    """
    gains = _parse_gains(kp)
    loops = [
        tl.analyse_sampled_loop(gain, period_s=period, dead_time_ticks=dead_time) for gain in gains
    ]
    if json:
        print_json(_describe(loops))
        return
    print_text("\n".join(map(format_table, tabulate_theory(loops))))


def _parse_gains(text: str) -> list[float]:
    try:
        gains = [float(word) for word in text.split(",")]
    except ValueError as err:
        raise UsageError(f"--kp: expected gains as in 1,2,4,10, found {text[:60]!r}") from err
    if len(gains) > _MOST_GAINS:
        raise UsageError(f"--kp: expected at most {_MOST_GAINS} gains, found {len(gains)}")
    return gains


def _describe(loops: "list[SampledLoop]") -> dict[str, Any]:
    first = loops[0]
    overshoot_gain, stability_gain = compute_limits(first.period_s, first.dead_time_ticks)
    limits = [(ticks, *compute_limits(first.period_s, ticks)) for ticks in list_dead_times(first)]
    return {
        "period_s": first.period_s,
        "dead_time_ticks": first.dead_time_ticks,
        "overshoot_gain": overshoot_gain,
        "stability_gain": stability_gain,
        "plant": _describe_plant(),
        "gains": [_describe_loop(loop) for loop in loops],
        "limits": [
            {"dead_time_ticks": ticks, "overshoot_gain": overshoot, "stability_gain": stability}
            for ticks, overshoot, stability in limits
        ],
    }


def _describe_plant() -> dict[str, Any]:
    verdict = tl.judge_bibo(*tl.PLANT)
    ends = [(kind, tl.find_plant_final_value(kind)) for kind in tl.PLANT_INPUTS]
    return {
        "transfer_function": {"numerator": tl.PLANT[0], "denominator": tl.PLANT[1]},
        "bibo_stable": verdict.stable,
        "reason": verdict.reason,
        "final_values": [
            {"input": kind, "value": end.value, "status": end.status.value, "reason": end.reason}
            for kind, end in ends
        ],
    }


def _describe_loop(loop: "SampledLoop") -> dict[str, Any]:
    return {
        "kp": loop.kp,
        "tau_s": tl.compute_time_constant(loop.kp),
        "settling_time_s": tl.compute_settling_time(loop.kp),
        "exact_settling_time_s": tl.compute_exact_settling_time(loop.kp),
        "poles": [{"re": float(pole.real), "im": float(pole.imag)} for pole in loop.poles],
        "stable": loop.stable,
        "overshoots": loop.overshoots,
        "damping_ratio": loop.damping_ratio,
        "overshoot_percent": loop.overshoot_percent,
        "sampled_settling_time_s": loop.settling_time_s,
        "gain_margin": loop.gain_margin,
        "phase_margin_rad": loop.phase_margin_rad,
        "delay_margin_ticks": loop.delay_margin_ticks,
        "delay_margin_s": loop.delay_margin_s,
    }
