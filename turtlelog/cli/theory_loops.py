"""Sampled loops of any kind as tables and JSON: from options, scenarios and recordings."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import turtlelog as tl
from turtlelog.cli.console import build_table, copy_fields
from turtlelog.cli.theory_gains import (
    Recommended,
    RecommendedGains,
    build_recommended,
    find_kept,
    take_fields,
    tell_step,
)
from turtlelog.display import join_words
from turtlelog.run.loops import SIGNAL_WORDS

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopAnswer:
    """Theory's answer for one loop.

    Attributes:
        title: Title above the loop's column.
        found: Values of the loop; None if the values are unknown.
        model: Model of a declared loop, with the sources of its values.
    """

    title: str
    found: "tl.theory.PidLoop | None"
    model: "tl.theory.LoopModel | None" = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanePole:
    """A pole in the z plane."""

    re: float
    im: float


def _build_poles(poles: "NDArray[np.complex128]") -> list[PlanePole]:
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
    loops: "list[tl.theory.SampledLoop]", recommended: Recommended
) -> IntegratorAnswer:
    """Return the answer for P on 1/s."""
    theory, first = tl.theory, loops[0]
    limits = {ticks: compute_limits(first.period_s, ticks) for ticks in list_dead_times(first)}
    overshoot_gain, stability_gain = limits[first.dead_time_ticks]
    verdict, (numerator, denominator) = theory.judge_bibo(*theory.PLANT), theory.PLANT
    ends = {kind: theory.find_plant_final_value(kind) for kind in theory.PLANT_INPUTS}
    return IntegratorAnswer(
        period_s=first.period_s,
        dead_time_ticks=first.dead_time_ticks,
        overshoot_gain=overshoot_gain,
        stability_gain=stability_gain,
        plant=PlantAnswer(
            transfer_function=_Transfer(numerator=numerator, denominator=denominator),
            bibo_stable=verdict.stable,
            reason=verdict.reason,
            final_values=[
                _End(input=kind, value=end.value, status=end.status.value, reason=end.reason)
                for kind, end in ends.items()
            ],
        ),
        gains=[
            copy_fields(
                GainAnswer,
                loop,
                tau_s=theory.compute_time_constant(loop.kp),
                settling_time_s=theory.compute_settling_time(loop.kp),
                exact_settling_time_s=theory.compute_exact_settling_time(loop.kp),
                poles=_build_poles(loop.poles),
                sampled_settling_time_s=loop.settling_time_s,
            )
            for loop in loops
        ],
        limits=[
            GainBounds(dead_time_ticks=ticks, overshoot_gain=overshoot, stability_gain=stability)
            for ticks, (overshoot, stability) in limits.items()
        ],
        recommended=build_recommended(recommended),
        kept_kp=find_kept(recommended),
    )


def compute_limits(period_s: float, ticks: int) -> tuple[float, float]:
    """Return the gains [1/s] at which overshoot and instability begin."""
    overshoot = tl.theory.compute_overshoot_gain(period_s, ticks)
    return overshoot, tl.theory.compute_stability_gain(period_s, ticks)


def list_dead_times(loop: "tl.theory.SampledLoop") -> list[int]:
    """Return the dead times [ticks] in a table of limits, including the dead time of the loop."""
    return sorted({*range(_LIMITS_UP_TO + 1), loop.dead_time_ticks})


def tell_pole(poles: "NDArray[np.complex128]") -> str:
    """Return the first pole, which is the slowest, with its conjugate."""
    pole = complex(poles[0])
    if pole.imag == 0.0:
        return f"{pole.real:.4f}"
    return f"{pole.real:.4f} +- {abs(pole.imag):.4f}j"


_LIMITS_UP_TO: Final = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class PidAnswer:
    """JSON entry of a sampled loop; None for a number that does not exist."""

    kp: float
    ki: float
    kd: float
    filter_s: float
    period_s: float
    dead_time_s: float
    process: "tl.theory.Process"
    tau_s: float
    settling_time_s: float
    poles: list[PlanePole]
    stable: bool
    stable_gains: "Sequence[tuple[float, float]]"
    overshoots: bool
    overshoot_percent: float | None
    sampled_settling_time_s: float | None
    gain_margin: float | None
    gain_reduction: float | None
    phase_margin_rad: float | None
    crossover_rad_s: float | None
    delay_margin_s: float | None


def build_pid_loop(loop: "tl.theory.PidLoop") -> PidAnswer:
    """Return a loop for JSON."""
    whole = loop.gains.kp * loop.process.gain
    return copy_fields(
        PidAnswer,
        loop,
        tau_s=tl.theory.compute_time_constant(whole),
        settling_time_s=tl.theory.compute_settling_time(whole),
        poles=_build_poles(loop.poles),
        overshoots=not loop.stable or _overshoots(loop),
        sampled_settling_time_s=loop.settling_time_s,
        **take_fields(loop.gains, "kp", "ki", "kd", "filter_s"),
        **take_fields(loop.margins, *_MARGINS),
    )


_MARGINS: Final = (
    *("gain_margin", "gain_reduction", "phase_margin_rad", "crossover_rad_s"),
    "delay_margin_s",
)


def tabulate_answers(title: str, answers: Sequence[LoopAnswer]) -> "tl.compare.Table":
    """Return a table with a column for each loop, without rows that are zero in all loops."""
    known = [answer.found for answer in answers if answer.found]
    rows = []
    for name, is_optional, write in _ROWS:
        cells = tuple("-" if one.found is None else write(one.found) for one in answers)
        if known and not (is_optional and set(cells) <= {"-", "0"}):
            rows.append((name, *cells))
    notes = [_AT_SAMPLES] if any(loop.moves_between for loop in known) else []
    return build_table(title, ("", *(answer.title for answer in answers)), rows, notes)


def tabulate_gains(answers: Sequence[LoopAnswer]) -> "tl.compare.Table":
    """Return a table with a row for each Kp; optional columns with only `-` or 0 are left out."""
    loops = [answer.found for answer in answers if answer.found]
    columns: dict[str, list[str | float | None]] = {}
    for name, is_optional, write in _ROWS:
        texts = [write(loop) for loop in loops]
        if name in _NOT_BESIDE or (is_optional and set(texts) <= {"-", "0"}):
            continue
        if write is _tell_overshoot:
            columns["overshoot [%]"] = [*map(_find_overshoot, loops)]
        else:
            columns[name] = [*map(_read_cell, texts)]
    where = ", at its samples" if any(loop.moves_between for loop in loops) else ""
    return build_table(f"The sampled loop{where}", columns, zip(*columns.values(), strict=True))


def describe_plant(loop: "tl.theory.PidLoop") -> str:
    """Return the values that are equal at every Kp: other gains, plant and timing."""
    said = []
    for name, is_optional, write in _ROWS:
        text = write(loop)
        if name in _OF_PLANT and not (is_optional and text == "0"):
            title, _, unit = name.removesuffix("]").partition(" [")
            said.append(f"{title} {text} {unit}".rstrip())
    told = ", ".join(said)
    return f"{told[0].upper()}{told[1:]}."


def _find_overshoot(loop: "tl.theory.PidLoop") -> str | float | None:
    if not loop.stable:
        return "no end"
    percent = loop.overshoot_percent
    return None if percent is None else round(percent, 2) if _overshoots(loop) else 0.0


def _read_cell(text: str) -> str | float:
    """Return a number from text, so that its column is aligned like numbers."""
    try:
        return float(text)
    except ValueError:
        return text


def list_sources(answers: Sequence[LoopAnswer], *, shows_all: bool = False) -> list[str]:
    """Return unknown loops, omitted settings, and sources of values."""
    notes = []
    for answer in answers:
        model = answer.model
        if model is None:
            continue
        of = f"{model.loop.name} ({SIGNAL_WORDS[model.loop.signal]})"
        if model.reason:
            notes.append(f"{of} is unknown: {model.reason}.")
            continue
        if model.unmeasured:
            notes.append(f"{of}: {model.unmeasured}. The dead time is from the scenario.")
        if shows_all:
            notes.append(f"{of}: {_tell_sources(model)}.")
        if shows_all and model.most_dead_time_s is not None:
            most = f"{1e3 * model.most_dead_time_s:.6g} ms"
            notes.append(
                f"{of}: the dead time is the least; {model.growth} may let it grow to {most}."
            )
        notes += _list_left_out(of, model, shows_all=shows_all)
    return notes


def _list_left_out(of: str, model: "tl.theory.LoopModel", *, shows_all: bool) -> Iterator[str]:
    """Yield the settings that the linear loop leaves out, or counts as something simpler."""
    if model.jitter_s:
        mean = f"{1e3 * model.jitter_s:.3g} ms"
        yield f"{of}: jitter counts as its mean delay, {mean}; its variation is left out."
    left_out = []
    for one in model.left_out:
        # A sentence on clipped commands covers the limit.
        is_said = one.key == model.loop.limit_key or model.allows_for(one.key)
        if not model.counts_as_delay(one.key) and (shows_all or not is_said):
            left_out.append(one)
    if left_out:
        is_late = any(one.key.startswith(_LATE) for one in left_out)
        said = ", ".join(one.describe() for one in left_out)
        but = ", which may make it unstable at smaller gains" if is_late else ""
        yield f"{of}: theory's linear loop leaves out {said}{but}."
    if shows_all and model.limits is not None:
        yield f"{of}: the table of loops is for small steps."


_LATE: Final = ("loop.late_", "loop.loss_", "loop.repeat_", "sensing.dropout_")
"""Beginnings of keys of random delays that theory leaves out."""


def list_motions(answers: Sequence[LoopAnswer]) -> Iterator[str]:
    """Yield the response of the loop at each Kp. Gains with similar responses share a sentence."""
    known = [(one.title.removeprefix("Kp = "), one.found) for one in answers if one.found]
    is_short = len(known) > _MOST_SAID
    groups: dict[object, list[tuple[str, tl.theory.PidLoop]]] = {}
    for kp, loop in known:
        kind = loop.stable, loop.overshoot_percent is None, _overshoots(loop)
        numbers = () if is_short else (_find_overshoot(loop), loop.settling_time_s)
        groups.setdefault((*kind, *numbers), []).append((kp, loop))
    for group in groups.values():
        motion = tell_motion(group[0][1], is_short=is_short)
        yield f"Kp = {', '.join(kp for kp, _ in group)}: {motion}."


_MOST_SAID: Final = 4
"""Largest number of gains with separate sentences."""


def tell_motion(loop: "tl.theory.PidLoop", *, is_short: bool = False) -> str:
    """Return whether a loop is stable and overshoots; with the numbers, unless it is short."""
    if not loop.stable:
        return "unstable"
    if loop.overshoot_percent is None:
        return "stable, but its slowest part hardly decays"
    where = " at the samples" if loop.moves_between else ""
    if is_short:
        return "stable, overshoots" if _overshoots(loop) else f"stable, no overshoot{where}"
    return f"stable, {tell_step(loop, where)}"


_AT_SAMPLES: Final = "Overshoot is at the samples; between samples the motion may go further."


def _tell_sources(model: "tl.theory.LoopModel") -> str:
    """Return the sources of values as text. Values from one source share an entry."""
    found: dict[str, list[str]] = {}
    for key, words in model.sources.items():
        found.setdefault(words, []).append(key.removesuffix("_s").replace("_", " "))
    return "; ".join(f"{join_words(names)} {words}" for words, names in found.items())


def _overshoots(loop: "tl.theory.PidLoop") -> bool:
    return loop.overshoot_percent is not None and loop.overshoot_percent >= tl.theory.EQUAL_PERCENT


def _tell_overshoot(loop: "tl.theory.PidLoop") -> str:
    if not loop.stable:
        return "without end"
    if loop.overshoot_percent is None:
        return "-"
    return f"by {loop.overshoot_percent:.2f} %" if _overshoots(loop) else "no"


def _tell_range(loop: "tl.theory.PidLoop") -> str:
    ranges = (
        f"below {high:.4g}" if low == 0.0 else f"{low:.4g} to {high:.4g}"
        for low, high in loop.stable_gains
    )
    return ", ".join(ranges) or "none"


def _tell_margin(name: str, form: str, factor: float = 1.0) -> "Callable[[tl.theory.PidLoop], str]":
    def write(loop: "tl.theory.PidLoop") -> str:
        value = getattr(loop.margins, name, None)
        return _tell_number(value if value is None else factor * value, form)

    return write


def _tell_number(value: float | None, form: str = ".6g") -> str:
    return "-" if value is None else format(value, form)


_OF_PLANT: Final = (
    *("Ki [1/s^2]", "Kd", "filter of D [ms]", "gain of the plant", "time constant [ms]"),
    *("low-pass [ms]", "period [ms]", "dead time [ms]"),
)
"""Rows that are equal at every Kp."""

_NOT_BESIDE: Final = (*_OF_PLANT, "stable", "stable for Kp [1/s]", "slowest pole")
"""Rows that a table of gains does not have. The sentences above contain them; poles are details."""

_ROWS: "Final[tuple[tuple[str, bool, Callable[[tl.theory.PidLoop], str]], ...]]" = (
    ("Kp [1/s]", False, lambda loop: _tell_number(loop.gains.kp)),
    ("Ki [1/s^2]", True, lambda loop: _tell_number(loop.gains.ki)),
    ("Kd", True, lambda loop: _tell_number(loop.gains.kd)),
    ("filter of D [ms]", True, lambda loop: _tell_number(1e3 * loop.gains.filter_s)),
    ("gain of the plant", False, lambda loop: _tell_number(loop.process.gain)),
    ("time constant [ms]", True, lambda loop: _tell_number(1e3 * loop.process.lag_s)),
    ("low-pass [ms]", True, lambda loop: _tell_number(1e3 * loop.process.low_pass_s)),
    ("period [ms]", False, lambda loop: _tell_number(1e3 * loop.period_s)),
    ("dead time [ms]", False, lambda loop: _tell_number(1e3 * loop.dead_time_s)),
    ("stable", False, lambda loop: "yes" if loop.stable else "no"),
    ("stable for Kp [1/s]", False, _tell_range),
    ("slowest pole", False, lambda loop: tell_pole(loop.poles)),
    ("overshoots", False, _tell_overshoot),
    ("settles in [s]", False, lambda loop: _tell_number(loop.settling_time_s, ".3f")),
    ("gain margin", False, _tell_margin("gain_margin", ".2f")),
    ("gain may fall to", True, _tell_margin("gain_reduction", ".3f")),
    ("phase margin [deg]", False, _tell_margin("phase_margin_rad", ".1f", 180.0 / math.pi)),
    ("delay margin [ms]", False, _tell_margin("delay_margin_s", ".4g", 1e3)),
)
"""Rows of the table: name, whether the row is left out if all loops have 0, and format."""
