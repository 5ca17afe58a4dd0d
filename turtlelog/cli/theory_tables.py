"""P control of the plant 1/s, ideal and sampled, as tables and JSON."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import turtlelog as tl
from turtlelog.cli.output import build_table
from turtlelog.cli.theory_gains import RecommendedGains

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from turtlelog.compare import Table
    from turtlelog.theory import SampledLoop


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanePole:
    """A pole in the z plane."""

    re: float
    im: float


def build_poles(poles: "NDArray[np.complex128]") -> list[PlanePole]:
    """Return poles for JSON."""
    return [PlanePole(re=float(pole.real), im=float(pole.imag)) for pole in poles]


@dataclass(frozen=True, slots=True, kw_only=True)
class GainAnswer:
    """The ideal and the sampled loop at one gain; None for a number that does not exist."""

    kp: float
    tau_s: float
    settling_time_s: float
    exact_settling_time_s: float
    poles: list[PlanePole]
    stable: bool
    overshoots: bool
    damping_ratio: float | None
    overshoot_percent: float | None
    sampled_settling_time_s: float | None
    gain_margin: float
    phase_margin_rad: float | None
    delay_margin_ticks: float | None
    delay_margin_s: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class GainBounds:
    """The gains at which overshoot and instability begin, at a dead time."""

    dead_time_ticks: int
    overshoot_gain: float
    stability_gain: float


@dataclass(frozen=True, slots=True, kw_only=True)
class _Transfer:
    numerator: "Sequence[float]"
    denominator: "Sequence[float]"


@dataclass(frozen=True, slots=True, kw_only=True)
class _End:
    input: str
    value: float | None
    status: str
    reason: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantAnswer:
    """The plant 1/s: its stability, and the final values of its responses."""

    transfer_function: _Transfer
    bibo_stable: bool
    reason: str
    final_values: list[_End]


@dataclass(frozen=True, slots=True, kw_only=True)
class IntegratorAnswer:
    """P control of the plant 1/s."""

    period_s: float
    dead_time_ticks: int
    overshoot_gain: float
    stability_gain: float
    plant: PlantAnswer
    gains: list[GainAnswer]
    limits: list[GainBounds]
    recommended: list[RecommendedGains]
    kept_kp: float | None


def build_integrator(
    loops: "list[SampledLoop]", recommended: list[RecommendedGains], kept_kp: float | None
) -> IntegratorAnswer:
    """Return the answer for P on 1/s."""
    first = loops[0]
    overshoot_gain, stability_gain = _compute_limits(first.period_s, first.dead_time_ticks)
    limits = {ticks: _compute_limits(first.period_s, ticks) for ticks in _list_dead_times(first)}
    return IntegratorAnswer(
        period_s=first.period_s,
        dead_time_ticks=first.dead_time_ticks,
        overshoot_gain=overshoot_gain,
        stability_gain=stability_gain,
        plant=_build_plant(),
        gains=[_build_loop(loop) for loop in loops],
        limits=[
            GainBounds(dead_time_ticks=ticks, overshoot_gain=overshoot, stability_gain=stability)
            for ticks, (overshoot, stability) in limits.items()
        ],
        recommended=recommended,
        kept_kp=kept_kp,
    )


def _build_plant() -> PlantAnswer:
    verdict = tl.theory.judge_bibo(*tl.theory.PLANT)
    ends = [(kind, tl.theory.find_plant_final_value(kind)) for kind in tl.theory.PLANT_INPUTS]
    numerator, denominator = tl.theory.PLANT
    return PlantAnswer(
        transfer_function=_Transfer(numerator=numerator, denominator=denominator),
        bibo_stable=verdict.stable,
        reason=verdict.reason,
        final_values=[
            _End(input=kind, value=end.value, status=end.status.value, reason=end.reason)
            for kind, end in ends
        ],
    )


def _build_loop(loop: "SampledLoop") -> GainAnswer:
    return GainAnswer(
        kp=loop.kp,
        tau_s=tl.theory.compute_time_constant(loop.kp),
        settling_time_s=tl.theory.compute_settling_time(loop.kp),
        exact_settling_time_s=tl.theory.compute_exact_settling_time(loop.kp),
        poles=build_poles(loop.poles),
        stable=loop.stable,
        overshoots=loop.overshoots,
        damping_ratio=loop.damping_ratio,
        overshoot_percent=loop.overshoot_percent,
        sampled_settling_time_s=loop.settling_time_s,
        gain_margin=loop.gain_margin,
        phase_margin_rad=loop.phase_margin_rad,
        delay_margin_ticks=loop.delay_margin_ticks,
        delay_margin_s=loop.delay_margin_s,
    )


_LIMITS_UP_TO: Final = 8
_RESPONSES: Final = {"impulse": "1", "step": "t", "ramp": "t^2 / 2"}


def tabulate_theory(loops: "list[SampledLoop]") -> "list[Table]":
    """Return the plant, the ideal loop, the sampled loop and its limits as tables."""
    return [
        _tabulate_plant(),
        _tabulate_ideal(loops),
        _tabulate_loops(loops),
        _tabulate_limits(loops),
    ]


def _compute_limits(period_s: float, ticks: int) -> tuple[float, float]:
    """Return the gains [1/s] at which overshoot and instability begin."""
    overshoot = tl.theory.compute_overshoot_gain(period_s, ticks)
    return overshoot, tl.theory.compute_stability_gain(period_s, ticks)


def _list_dead_times(loop: "SampledLoop") -> list[int]:
    """Return the dead times [ticks] in a table of limits, including the dead time of the loop."""
    return sorted({*range(_LIMITS_UP_TO + 1), loop.dead_time_ticks})


def _tabulate_plant() -> "Table":
    ends = {kind: tl.theory.find_plant_final_value(kind) for kind in tl.theory.PLANT_INPUTS}
    endless = {
        end.reason: [kind for kind in ends if ends[kind].reason == end.reason]
        for end in ends.values()
        if end.value is None
    }
    verdict = tl.theory.judge_bibo(*tl.theory.PLANT)
    rows = (
        (kind, _RESPONSES[kind], end.status.value if end.value is None else f"{end.value:g}")
        for kind, end in ends.items()
    )
    notes = [f"BIBO stable: {_tell(verdict.stable)}; {verdict.reason}."]
    for reason, kinds in endless.items():
        notes.append(f"Final value theorem, {' and '.join(kinds)}: {reason}.")
    return build_table("The plant 1/s", ("input", "response", "final value"), rows, notes)


def _tabulate_ideal(loops: "list[SampledLoop]") -> "Table":
    rows = [
        (
            loop.kp,
            -loop.kp,
            tl.theory.compute_time_constant(loop.kp),
            tl.theory.compute_settling_time(loop.kp),
            tl.theory.compute_exact_settling_time(loop.kp),
        )
        for loop in loops
    ]
    heads = ("Kp [1/s]", "pole [1/s]", "tau [s]", "4 tau [s]", "ln 50 tau [s]")
    note = "It settles to 2 % in ln 50 tau = 3.91 tau; 4 tau is the rule. It never overshoots."
    return build_table("The ideal loop Kp / (s + Kp)", heads, rows, [note])


def _tabulate_loops(loops: "list[SampledLoop]") -> "Table":
    return tl.compare.Table(
        title=f"Sampled every {_tell_period(loops[0])}, dead time {_tell_dead_time(loops[0])}",
        columns=(
            tl.compare.Column(title="Kp", unit="1/s"),
            tl.compare.Column(title="slowest pole"),
            tl.compare.Column(title="damping", digits=3),
            tl.compare.Column(title="overshoots"),
            tl.compare.Column(title="settles in", unit="s", digits=3, lines=("settles", "in")),
            tl.compare.Column(title="gain margin", digits=2, lines=("gain", "margin")),
            tl.compare.Column(
                title="delay margin", unit="ticks", digits=1, lines=("delay", "margin")
            ),
            tl.compare.Column(title="stable"),
        ),
        rows=tuple(
            (
                loop.kp,
                tell_pole(loop.poles),
                loop.damping_ratio,
                _tell_overshoot(loop),
                loop.settling_time_s,
                loop.gain_margin,
                loop.delay_margin_ticks,
                _tell(loop.stable),
            )
            for loop in loops
        ),
    )


def _tabulate_limits(loops: "list[SampledLoop]") -> "Table":
    period_s = loops[0].period_s
    rows = [
        (ticks, 1e3 * ticks * period_s, *_compute_limits(period_s, ticks))
        for ticks in _list_dead_times(loops[0])
    ]
    return tl.compare.Table(
        title=f"Limits of the gain, sampled every {_tell_period(loops[0])}",
        columns=(
            tl.compare.Column(title="dead time d", unit="ticks"),
            tl.compare.Column(title="d T", unit="ms"),
            tl.compare.Column(title="no overshoot up to Kp", unit="1/s"),
            tl.compare.Column(title="stable below Kp", unit="1/s"),
        ),
        rows=tuple(rows),
        notes=(
            "Overshoot begins at Kp T = d^d / (d + 1)^(d + 1), instability at 2 sin(pi / (2 (2 d +"
            " 1))). A command that is clipped hides both while it is clipped.",
        ),
    )


def summarise_gains(loops: "list[SampledLoop]") -> list[str]:
    """Return the gains at which overshoot and instability begin, and where the given gains lie."""
    overshoot, stability = _compute_limits(loops[0].period_s, loops[0].dead_time_ticks)
    groups = {
        "no overshoot": [loop for loop in loops if loop.stable and not loop.overshoots],
        "overshoots, and settles": [loop for loop in loops if loop.stable and loop.overshoots],
        "unstable": [loop for loop in loops if not loop.stable],
    }
    verdicts = [
        f"Kp = {', '.join(f'{loop.kp:g}' for loop in group)}: {verdict}."
        for verdict, group in groups.items()
        if group
    ]
    limits = f"Overshoot begins above Kp = {overshoot:.4g} 1/s, instability at {stability:.4g} 1/s."
    return [limits, " ".join(verdicts)]


def describe_sampling(loop: "SampledLoop") -> str:
    """Return sampling period and dead time."""
    return f"Sampling period {_tell_period(loop)}, dead time {_tell_dead_time(loop)}."


def _tell_period(loop: "SampledLoop") -> str:
    return f"{1e3 * loop.period_s:.6g} ms"


def _tell_dead_time(loop: "SampledLoop") -> str:
    ticks = loop.dead_time_ticks
    return f"{ticks} tick{'' if ticks == 1 else 's'} ({1e3 * ticks * loop.period_s:.6g} ms)"


def tell_pole(poles: "NDArray[np.complex128]") -> str:
    """Return the first pole, which is the slowest, with its conjugate."""
    pole = complex(poles[0])
    if pole.imag == 0.0:
        return f"{pole.real:.4f}"
    return f"{pole.real:.4f} +- {abs(pole.imag):.4f}j"


def _tell_overshoot(loop: "SampledLoop") -> str:
    if not loop.stable:
        return "without end"
    if not loop.overshoots:
        return "no"
    percent = loop.overshoot_percent
    return "yes" if percent is None else f"by {percent:.2f} %"


def _tell(value: object) -> str:
    return "yes" if value else "no"
