"""Text of `turtlelog theory`: recommended gains and limits first, then the loops."""

import math
import shlex
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

import turtlelog as tl
from turtlelog.cli.console import build_table, fill_lines, find_width
from turtlelog.cli.theory_gains import (
    ChosenGains,
    GainTrial,
    Recommended,
    WishOptions,
    compare_gains,
    show_gains,
    tabulate_recommended,
    tell_step,
)
from turtlelog.cli.theory_loops import (
    LoopAnswer,
    compute_limits,
    describe_plant,
    list_dead_times,
    list_motions,
    list_sources,
    tabulate_answers,
    tabulate_gains,
    tell_motion,
    tell_pole,
)
from turtlelog.display import describe_count, format_short, join_words

if TYPE_CHECKING:
    from turtlelog.theory import LoopModel, PidLoop, Recommendation, SampledLoop

_MOST_COLUMNS: Final = 3
"""Largest number of loops side by side in a table; more loops do not fit a line."""

_IDEAL: Final = "without command limits"
"""Condition of recommended gains."""
_LIMITED: Final = "with all limits of speed and acceleration"

_UNLIMITED: Final = "Theory leaves out command limits, which change overshoot and settling time."


def format_integrator(
    loops: "list[SampledLoop]", recommended: Recommended, wishes: WishOptions, *, shows_all: bool
) -> str:
    """Return the answer for P on 1/s."""
    ideal = _IDEAL if loops[0].dead_time_ticks else f"{_IDEAL} or dead time"
    head = [
        *_list_recommended(recommended, wishes, ideal=ideal),
        *_summarise_gains(loops),
        f"Sampling period {_tell_period(loops[0])}, dead time {_tell_dead_time(loops[0])}.",
    ]
    tables = [
        tabulate_recommended(recommended, wishes, shows_all=shows_all),
        _tabulate_loops(loops),
    ]
    if shows_all:
        tables += [_tabulate_limits(loops), _tabulate_ideal(loops), _tabulate_plant()]
    more = "The plant, the ideal loop, limits at other dead times, published rules: --details"
    return _join(head, tables, [_UNLIMITED, *([] if shows_all else [more])])


_RESPONSES: Final = {"impulse": "1", "step": "t", "ramp": "t^2 / 2"}


def _tabulate_plant() -> "tl.compare.Table":
    rows, endless = [], dict[str | None, list[str]]()
    for kind in tl.theory.PLANT_INPUTS:
        end = tl.theory.find_plant_final_value(kind)
        if end.value is None:
            endless.setdefault(end.reason, []).append(kind)
        shown = end.status.value if end.value is None else f"{end.value:g}"
        rows.append((kind, _RESPONSES[kind], shown))
    verdict = tl.theory.judge_bibo(*tl.theory.PLANT)
    notes = [f"BIBO stable: {_tell(verdict.stable)}; {verdict.reason}."]
    notes += [f"Final value theorem, {' and '.join(endless[one])}: {one}." for one in endless]
    return build_table("The plant 1/s", ("input", "response", "final value"), rows, notes)


def _tabulate_ideal(loops: "list[SampledLoop]") -> "tl.compare.Table":
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


def _tabulate_loops(loops: "list[SampledLoop]") -> "tl.compare.Table":
    column = tl.compare.Column
    heads = (
        *("Kp [1/s]", "slowest pole", column(title="damping", digits=3), "overshoots"),
        column(title="settles in", unit="s", digits=3, lines=("settles", "in")),
        column(title="gain margin", digits=2, lines=("gain", "margin")),
        column(title="delay margin", unit="s", digits=3, lines=("delay", "margin")),
        "stable",
    )
    rows = (
        (
            *(loop.kp, tell_pole(loop.poles), loop.damping_ratio, _tell_overshoot(loop)),
            *(loop.settling_time_s, loop.gain_margin, loop.delay_margin_s),
            _tell(loop.stable),
        )
        for loop in loops
    )
    title = f"Sampled every {_tell_period(loops[0])}, dead time {_tell_dead_time(loops[0])}"
    return build_table(title, heads, rows)


def _tabulate_limits(loops: "list[SampledLoop]") -> "tl.compare.Table":
    period_s = loops[0].period_s
    rows = [
        (ticks, 1e3 * ticks * period_s, *compute_limits(period_s, ticks))
        for ticks in list_dead_times(loops[0])
    ]
    note = (
        "Overshoot begins at Kp T = d^d / (d + 1)^(d + 1), instability at 2 sin(pi / (2 (2 d +"
        " 1))). A command that is clipped hides both while it is clipped."
    )
    heads = ("dead time d [ticks]", "d T [ms]", "no overshoot up to Kp [1/s]")
    title = f"Limits of the gain, sampled every {_tell_period(loops[0])}"
    return build_table(title, (*heads, "stable below Kp [1/s]"), rows, [note])


def _summarise_gains(loops: "list[SampledLoop]") -> list[str]:
    """Return the gains at which overshoot and instability begin, and where the given gains lie."""
    overshoot, stability = compute_limits(loops[0].period_s, loops[0].dead_time_ticks)
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


def _tell_period(loop: "SampledLoop") -> str:
    return f"{1e3 * loop.period_s:.6g} ms"


def _tell_dead_time(loop: "SampledLoop") -> str:
    ticks = loop.dead_time_ticks
    return f"{describe_count(ticks, 'tick')} ({1e3 * ticks * loop.period_s:.6g} ms)"


def _tell_overshoot(loop: "SampledLoop") -> str:
    if not loop.stable:
        return "without end"
    if not loop.overshoots:
        return "no"
    percent = loop.overshoot_percent
    return "yes" if percent is None else f"by {percent:.2f} %"


def _tell(value: object) -> str:
    return "yes" if value else "no"


def format_terms(
    answers: Sequence[LoopAnswer], recommended: Recommended, wishes: WishOptions, *, shows_all: bool
) -> str:
    """Return the answer for a loop with more than P on 1/s, at each Kp."""
    known = [answer.found for answer in answers if answer.found]
    head = [
        *_list_recommended(recommended, wishes),
        *(f"{_tell_range(loop.stable_gains)}." for loop in known[:1]),
        *list_motions(answers),
        *map(describe_plant, known[:1]),
    ]
    tables = [
        tabulate_recommended(recommended, wishes, shows_all=shows_all),
        tabulate_gains(answers),
    ]
    for first in range(0, len(answers), _MOST_COLUMNS) if shows_all else ():
        tables.append(tabulate_answers("Loop by loop", answers[first : first + _MOST_COLUMNS]))
    more = [] if shows_all else ["Poles, published rules, and why rules give no gains: --details"]
    return _join(head, tables, [_UNLIMITED, *more])


def format_file(
    name: str,
    words: Sequence[str],
    answers: Sequence[LoopAnswer],
    chosen: ChosenGains,
    *,
    shows_all: bool,
) -> str:
    """Return the answer for each loop of a scenario or a recording."""
    known = [one for one in answers if one.found]
    if not known:
        why = "no loop is declared" if not answers else "theory has no linear model of its loops"
        robot = "turtlelog identify BAG --scenario robot.toml, turtlelog theory robot.toml"
        hint = [] if answers else [f"Gains for a robot: {robot}"]
        return fill_lines([f"{name}: {why}.", *list_sources(answers), *hint])
    wishes, groups, trials = chosen
    is_worse = bool(trials) and not trials[-1].is_better
    advice = [
        _Advice(
            loop,
            one.find_best(given.controller),
            given,
            one.find_missing(given.controller),
            is_kept=is_worse or one.keeps(given),
            is_limited=bool(one.steps),
        )
        for one in groups
        for loop, given in zip(one.loops, one.given, strict=True)
    ]
    rest = list_sources(answers, shows_all=shows_all)
    if trials and not is_worse:
        changes = (f"--set {key}={value:.3g}" for key, value in trials[-1].gains.items())
        rest.append(f"Try them: turtlelog run {shlex.join(words)} {' '.join(changes)}")
    rest += (
        [] if shows_all else ["Poles and margins, published rules, sources of values: --details"]
    )
    tables = [tabulate_recommended(one, wishes, shows_all=shows_all) for one in groups]
    grows = any(one.model and one.model.most_dead_time_s for one in known)
    title = f"The loops of {name}{', at the least dead time' if grows else ''}"
    tables += [tabulate_answers(title, answers)] if shows_all else []
    said: dict[str, list[str]] = {}
    for one in known:  # loops that are alike share a sentence
        said.setdefault(_describe_loop(one, advice), []).append(one.title)
    head = [f"{join_words(names)}: {text}" for text, names in said.items()]
    first = _conclude(name, advice, wishes, is_worse=is_worse)
    if not trials and any(one.best and not one.is_kept for one in advice):
        head.append("No run was simulated with these gains.")
    head = [*first, *_tell_trials(trials), *head, *_describe_clipping(known, advice)]
    return _join(head, tables, rest)


class _Advice(NamedTuple):
    """Recommended gains of a loop, and its own gains.

    Attributes:
        loop: Name of the loop.
        best: Recommended gains.
        given: Gains in use.
        missing: Wish that no gains of the controller in use fulfil.
        is_kept: Whether the gains in use need no change.
        is_limited: Whether the gains allow for limits of acceleration.
    """

    loop: str
    best: "Recommendation | None"
    given: "Recommendation"
    missing: "Recommendation | None"
    is_kept: bool
    is_limited: bool


def _conclude(
    name: str, advice: Sequence[_Advice], wishes: WishOptions, *, is_worse: bool
) -> Iterator[str]:
    """Yield the recommended gains of each loop, the gains to keep, and what both are for."""
    changed = _list_gains([(one.loop, one.best) for one in advice if not one.is_kept])
    kept = _list_gains([(one.loop, one.given) for one in advice if one.is_kept])
    if not any(one.best for one in advice):
        unmet = next((one.missing for one in advice if one.missing), None)
        yield f"{name}: {_tell_missing(unmet, wishes)}."
        return
    told = [f"recommended {changed}"] if changed else []
    told += [f"keep {kept}"] if kept else []
    advised = [one for one in advice if one.is_kept or one.best]
    missing = [one.loop for one in advice if one not in advised]
    told += [f"no gains for {join_words(missing)}"] if missing else []
    if is_worse:
        told = [f"theory knows no better gains for the whole run than {kept}"]
    lost: dict[str, list[str]] = {}
    for one in advised:
        if one.missing:
            lost.setdefault(_name_missing(one.missing, wishes), []).append(one.loop)
    told += [f"{text} ({join_words(loops)})" for text, loops in lost.items()]
    yield f"{name}: {'; '.join(told)}."
    limited = [one.loop for one in advised if one.is_limited]
    ideal = [one.loop for one in advised if not one.is_limited]
    where = _LIMITED if limited else _IDEAL
    if limited and ideal:
        where = f"{_IDEAL} ({join_words(ideal)}), {_LIMITED} ({join_words(limited)})"
    wished: dict[str, list[str]] = {}
    for one in advised:
        if one.best:
            wish = wishes.describe(one.best.rule)
            bound = _BOUNDS.get(one.best.rule, "") if one.is_kept and not is_worse else ""
            wished.setdefault(f"{bound}{wish}", []).append(one.loop)
    said = [
        wish if len(wished) == 1 else f"{wish} ({join_words(loops)})"
        for wish, loops in wished.items()
    ]
    start = "Theory's gains are" if is_worse else "This is"
    yield f"{start} for {join_words(said)}, {where}."


def _tell_trials(trials: Sequence[GainTrial]) -> Iterator[str]:
    """Yield how the simulated runs with recommended and with present gains ended."""
    for one in trials:
        gains = join_words([f"{key} = {value:.3g}" for key, value in one.gains.items()])
        yield f"With {gains} the simulated run {one.ending}."
    for one in trials[-1:]:
        yield f"With the present gains it {one.present_ending}."
        if one.seed is not None:
            yield f"These are single runs with random effects (seed {one.seed}): others may differ."
    if not all(one.is_better for one in trials):
        yield "Theory's gains are for a step of one loop, without phases that end by tolerances."


_BOUNDS: Final = {"overshoot": "at most ", "phase-margin": "at least "}
"""Words before a wish that gains in use meet."""


def _list_gains(loops: "Sequence[tuple[str, Recommendation | None]]") -> str:
    """Return gains with their loops: `Kp = 4 1/s (rotate and translate)`."""
    found: dict[str, list[str]] = {}
    for loop, one in loops:
        if one and one.gains:
            found.setdefault(show_gains(one.gains), []).append(loop)
    return ", ".join(f"{gains} ({join_words(names)})" for gains, names in found.items())


def _describe_loop(answer: LoopAnswer, advice: Sequence[_Advice]) -> str:
    """Return the effect of recommended gains, or a loop's response and its stability limits."""
    loop = answer.found
    if loop is None:
        return ""
    if answer.model and answer.model.oscillates:
        return (
            f"{show_gains(loop.gains)}: the robot oscillates. Theory has a longer dead time in"
            " place of that, so it knows neither the step response nor a limit of stability."
        )
    own = next((one for one in advice if one.loop == answer.title), None)
    compared = compare_gains(own.best, own.given) if own and own.best and not own.is_kept else ""
    most_s = answer.model.most_dead_time_s if answer.model else None
    if own and own.given.margins is None and loop.stable and most_s is not None:
        compared = (
            f"{show_gains(loop.gains)} is stable at a dead time of {1e3 * loop.dead_time_s:.6g} ms,"
            f" unstable at {1e3 * most_s:.6g} ms. The dead time changes between them, so theory"
            " does not decide"
        )
    said = compared.rstrip(".") or f"{show_gains(loop.gains)}: {_tell_given(loop, own)}"
    where = " in small steps" if own and own.is_limited else ""
    return f"{said}; {_show_late_range(loop, answer.model, where)}."


def _tell_given(loop: "PidLoop", own: _Advice | None) -> str:
    if own is not None and own.is_limited and own.given.motion is None:
        return f"{tell_motion(loop)} in small steps"
    if own is None or not (own.is_kept or own.is_limited) or own.given.motion is None:
        return tell_motion(loop)
    rests = own.given.motion.settling_time_s is not None
    return f"{tell_step(own.given.motion)}{'' if rests else ', does not settle'}"


def _describe_clipping(known: Sequence[LoopAnswer], advice: Sequence[_Advice]) -> list[str]:
    """Return the errors from which limits clip commands, at the gains of the answer."""
    chosen = {one.loop: one.given if one.is_kept else one.best for one in advice}
    sizes = []
    for one in known:
        best = chosen.get(one.title)
        gains = None if best is None else best.gains
        if one.model is None or math.isinf(one.model.limit) or one.model.limits is not None:
            continue
        if gains is None or gains.ki or gains.kd:
            return [_UNLIMITED]
        if gains.kp:
            unit = "rad" if one.model.loop.command == "turn_rate" else "m"
            sizes.append(f"{format_short(one.model.limit / gains.kp, unit)} ({one.title})")
    if not sizes:
        return []
    are_kept = all(one.is_kept for one in advice)
    start = "Commands are" if are_kept else "At the recommended gains, commands are"
    return [
        f"{start} clipped for errors above {join_words(sizes)}, which changes overshoot and"
        " settling time."
    ]


def _join(head: Sequence[str], tables: "Sequence[tl.compare.Table]", rest: Sequence[str]) -> str:
    shown = [_narrow(table) for table in tables if table.rows]
    texts = [tl.draw.format_table(table, width=find_width()).strip("\n") for table in shown]
    return "\n\n".join([fill_lines(head), *texts, fill_lines(rest)])


def _narrow(table: "tl.compare.Table") -> "tl.compare.Table":
    ranks = [0 if column.title in {"damping", "stable"} else None for column in table.columns]
    return tl.compare.narrow_table(table, find_width(), ranks)


def _list_recommended(
    recommended: Recommended, wishes: WishOptions, *, ideal: str = _IDEAL
) -> Iterator[str]:
    """Yield whether given gains need a change, and recommended gains, or why there are none."""
    (given,) = recommended.given
    best = recommended.find_best(given.controller)
    missing = recommended.find_missing(given.controller)
    if best is None or best.gains is None:
        told = _tell_missing(missing, wishes)
        yield f"{told[:1].upper()}{told[1:]}."
        return
    wish = wishes.describe(best.rule)
    if given.gains and recommended.keeps(given):
        yield f"{ideal.capitalize()}, {show_gains(given.gains)} needs no change."
        yield f"Step response: {tell_step(given.motion)}."
        yield f"{show_gains(best.gains)} for {wish} is no better: {tell_step(best.motion)}."
        return
    because = f", because {_name_missing(missing, wishes)}" if missing else ""
    yield f"Recommended {ideal}: {best.controller} with {show_gains(best.gains)}{because}."
    if missing:
        yield f"{missing.reason[:1].upper()}{missing.reason[1:]}."
    yield f"This is for {wish}."
    compared = compare_gains(best, given)
    yield f"{compared[:1].upper()}{compared[1:]}"


def _name_missing(missing: "Recommendation", wishes: WishOptions) -> str:
    return f"theory finds no {missing.controller} for {wishes.describe(missing.rule)}"


def _tell_missing(missing: "Recommendation | None", wishes: WishOptions) -> str:
    """Return that no gains fulfil the wish, with the reason."""
    if missing is None:
        return "no gains are recommended: no rule gives any"
    return f"no gains are recommended for {wishes.describe(missing.rule)}: {missing.reason}"


def _show_late_range(loop: "PidLoop", model: "LoopModel | None", where: str) -> str:
    """Return the range of Kp that is stable at the most dead time and at those below it."""
    if model is None or model.most_dead_time_s is None:
        told = _tell_range(loop.stable_gains, where)
        return f"{told[:1].lower()}{told[1:]}"
    gains, settings = model.require()
    least_s, latest = settings["process"].dead_time_s, model.require_latest()
    stable = tl.theory.find_lasting_gains(gains, least_dead_time_s=least_s, **latest)
    is_at_most = stable == tl.theory.find_stable_gains(gains, **latest)
    most = f"{1e3 * model.most_dead_time_s:.6g} ms"
    late = f"the most dead time, {most}" if is_at_most else f"dead times up to {most}"
    told = _tell_range(stable, where)
    return f"{told[:1].lower()}{told[1:]} at {late}"


def _tell_range(ranges: "Sequence[tuple[float, float]]", where: str = "") -> str:
    """Return the gains at which a loop is stable, as a sentence."""
    written = [
        f"below {high:.4g} 1/s" if low == 0.0 else f"from {low:.4g} to {high:.4g} 1/s"
        for low, high in ranges
    ]
    if not written:
        return f"Unstable{where} at every Kp"
    return f"Stable{where} for Kp {' and '.join(written)}"
