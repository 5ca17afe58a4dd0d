"""An attribution in sentences that hold for the run."""

import math
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from html import escape
from typing import Final

from turtlelog.display import capitalise, format_html, format_notebook, join_words
from turtlelog.explain import answers
from turtlelog.explain.answers import (
    AttributedValue,
    Contribution,
    Together,
    ValueSet,
    is_clear,
)
from turtlelog.explain.causes import NAMED, RANDOM_EFFECTS
from turtlelog.explain.contributions import (
    ALIKE,
    choose_leading,
    choose_named,
    is_lowering,
    is_negligible,
    list_large,
    list_telling,
    sum_effects,
)

_COUNTS: Final = ("No", "One", "Two", "Three", "Four", "Five", "Six")
"""Numbers of effects in words. More than six effects take part only if the user chooses them."""


def write_sentences(found: AttributedValue) -> tuple[str, ...]:
    """Return sentences on the value, its causes, their dependences, and other causes of change."""
    parts = [f"{one.cause} {format_contribution(found, one)}" for one in choose_named(found)]
    causes = [f"{write_cause_head(found)}: {join_words(parts)}."] if parts else []
    return (_write_value(found), *write_leading(found), *causes, *write_reasons(found))


def write_headline(found: AttributedValue) -> str:
    """Return the value with its largest cause and contributions, or that no effect changes it.

    The re-simulation's value follows in brackets if it differs from the log's. Without
    contributions, the value stands alone.
    """
    values = (found.as_logged, found.resimulated)
    if found.without_value or found.withheld or None in values:
        return _write_value(found)
    sizes = [*dict.fromkeys(_format_value(found, one) for one in values)]
    again = f" ({sizes[1]} re-simulated)" if len(sizes) > 1 else ""
    if choose_named(found):
        main = _write_main(found)
    elif not found.acting:
        main = "no effect changes it"
    elif is_negligible(found):
        added = sum_effects(found)
        size, least = (_format_value(found, one) for one in (abs(added), found.resolution.size))
        lower = f"the effects lower it by {size}, within its resolution of {least}"
        main = f"effects add only {size}" if added >= 0.0 else lower
    else:
        main = "no effect is distinguishable from chance"
    mean = " in the mean" if found.seeds is not None else ""
    for one in choose_leading(found)[:1]:
        main = f"without {one.cause} {_format_value(found, one.alone)}{mean}; {main}"
    return f"{found.metric} is {sizes[0]}{again}: {main}"


def write_leading(found: AttributedValue) -> tuple[str, ...]:
    """Return the sentences on the other causes that change the value more than all effects."""
    return tuple(_write_alone(found, one) for one in choose_leading(found))


def _write_value(found: AttributedValue) -> str:
    logged, built = found.as_logged, found.resimulated
    if logged is None and built is None:
        return f"{found.metric} has no value: {found.reason}."
    if logged is None:
        in_log = f", and has no value in the log: {found.reason}" if found.reason else ""
        again = " re-simulated" * bool(in_log)
        return f"{found.metric} is {_format_value(found, built)}{again}{in_log}."
    size = _format_value(found, logged)
    if built is None:
        return f"{found.metric} is {size} in the log; re-simulated it has no value."
    if abs(logged - built) <= answers.SAME * abs(built):
        return f"{found.metric} is {size}, in the log and re-simulated."
    if size == _format_value(found, built):
        apart = _format_value(found, abs(logged - built))
        return f"{found.metric} is {size}, in the log and re-simulated; they differ by {apart}."
    return f"{found.metric} is {size} in the log, and {_format_value(found, built)} re-simulated."


def write_cause_head(found: AttributedValue) -> str:
    """Return how many effects and design parameters cause the value, as the title of a list."""
    named = choose_named(found)
    sizes = [one.size for one in named]
    count = _COUNTS[len(named)] if len(named) < len(_COUNTS) else str(len(named))
    left = max(found.resolution.size, NAMED * abs(found.divided))
    is_whole = min(sizes) > 0.0 and abs(found.without_all or 0.0) <= left
    does = "cause" if is_whole else "change"
    many, effects = "s" * (len(named) > 1), [one for one in named if one.cause in found.effects]
    kinds = "effects and design parameters" if effects else f"design parameter{many}"
    if len(effects) == len(named):
        kinds = f"effect{many} of the implementation"
    head = f"{count} {kinds} {does}{'s' * (len(named) == 1)} it"
    if found.seeds is not None:
        return f"{head} in the mean over seeds"
    # Other start headings divide the value otherwise.
    here = " in this run" if _is_wide(found) else ""
    if _need_each_other(found, named):
        return f"{head} together{here}"
    is_alike = len(named) > 1 and 0.0 < max(sizes) <= ALIKE * min(sizes)
    return f"{head}, in about equal parts{here}" if is_alike else head


def _need_each_other(found: AttributedValue, named: list[Contribution]) -> bool:
    """Return whether more than half of what the named causes add arises only if all act.

    This half is divided equally by definition, so equal parts say nothing about the causes.
    """
    names = {one.cause for one in named}
    joint = sum(case.value for case in found.together if {*case.causes} == names)
    added = sum(one.size for one in named)
    return len(names) > 1 and math.copysign(joint, joint * added) > 0.5 * abs(added)


def _is_wide(found: AttributedValue) -> bool:
    return found.starts is not None and found.starts.is_wide


def _write_main(found: AttributedValue) -> str:
    """Return the largest contributions; for causes that mostly act together, only their total."""
    named = choose_named(found)
    largest = abs(named[0].size)
    main = [one for one in named if largest <= ALIKE * abs(one.size)]
    label = "mainly " if len(main) < len(named) else ""
    mean = " in the mean over seeds" if found.seeds is not None else ""
    added = math.fsum(one.size for one in named)
    if added > 0.0 and len(named) == len(found.acting) and _need_each_other(found, named):
        # Parts of what only arises together would read as if each cause alone added its part.
        names = join_words([one.cause for one in named])
        return f"{names} add {_format_value(found, added)}{mean}"
    parts = ", ".join(f"{one.cause} {format_contribution(found, one)}" for one in main)
    return f"{label}{parts}{mean}"


def format_contribution(found: AttributedValue, one: Contribution) -> str:
    """Return a contribution with its sign, its unit and its standard error, if any."""
    value = one.size
    return f"{'+' if value >= 0.0 else ''}{_format_value(found, value, one.standard_error)}"


def write_reasons(found: AttributedValue) -> tuple[str, ...]:
    """Return the total of the causes, their dependences, and what else changes the value."""
    if found.without_value:
        names = join_words(found.causes, "or")
        never = f"It has no value without {names} either." if found.causes else ""
        is_never = not found.with_value and found.without_all is None
        known = {name: name for name in found.causes}
        nothing = f"without {join_words(found.causes)}"
        missing = write_missing(found.without_value, found.with_value, known, nothing)
        sentences = [never if is_never else missing]
    elif found.withheld:
        sentences = [f"No contributions: {found.withheld}."]
    else:
        # Parts that other samples would change must not be read as facts about the robot.
        last = [_write_together(found), _write_starts(found)]
        last = last[::-1] if _is_wide(found) else last
        sentences = [_write_seeds(found), _write_rest(found), *last, _write_unclear(found)]
        if found.this_seed is not None and found.seeds is not None and found.seeds.varies:
            size = _format_value(found, abs(found.this_seed))
            where = f"{'above' if found.this_seed >= 0.0 else 'below'} the mean over the seeds"
            sentences += [f"With this run's seed, the value is {size} {where}."]
        sentences += [*found.doubts, *_write_others(found)]
    if found.left:
        be = "is" if len(found.left) == 1 else "are"
        sentences += [f"{capitalise(join_words(found.left))} {be} left as recorded."]
    sentences += found.remarks
    return tuple(filter(None, sentences))


def _write_rest(found: AttributedValue) -> str:
    """Return the value without the effects, or a sentence that they change it little."""
    if not found.causes:
        return "No effect of the implementation is in this run."
    if not found.acting and found.seeds is not None and [*found.causes] == _list_idle(found):
        return ""  # the sentence on seeds contains it
    if not found.acting:
        return f"Without {join_words(found.causes, 'or')} it is the same."
    added = sum_effects(found)
    if is_negligible(found):
        idle = _list_idle(found) if found.seeds is not None else []  # named in another sentence
        names = [name for name in found.causes if name not in idle]
        change = "change" if len(names) > 1 else "changes"
        who = f"Together, {join_words(names)}" if len(names) > 1 else capitalise(names[0])
        return (
            f"{who} {change} it by {_format_value(found, added)}. This is within the resolution of"
            f" {_describe_resolution(found)}."
        )
    whole = f"without {_name_acting(found)} {{}}{_format_value(found, found.without_all)}"
    single = _write_singles(found)
    without = f"{single}, {whole.format('')}" if single else whole.format("it would be ")
    cancel = ""
    if abs(added) <= found.resolution.size:
        cancel = f" Together they change it by not more than {_describe_resolution(found)}."
    chance = "" if choose_named(found) else "No effect is distinguishable from chance. "
    other_end = _write_other_ends(found)
    return f"{chance}{capitalise(without)}{_write_bound(found)}.{other_end}{cancel}"


def _write_other_ends(found: AttributedValue) -> str:
    """Return without which effects a phase ends that does not end with them, or never ends."""
    ends: dict[str, list[str]] = {}
    for one in found.contributions:
        if one.ending and one.cause in found.acting:
            ends.setdefault(one.ending, []).append(one.cause)
    only = " alone" if len(found.acting) > 1 else ""
    return "".join(f" Without {join_words(who, 'or')}{only}, {end}." for end, who in ends.items())


def _name_acting(found: AttributedValue) -> str:
    """Return the names of the acting causes, or `both` if the list has just named them."""
    if len(found.acting) == 2 == len(choose_named(found)):
        return "both"
    return join_words(found.acting)


def _describe_resolution(found: AttributedValue) -> str:
    return f"{_format_value(found, found.resolution.size)} ({found.resolution.reason})"


def _write_bound(found: AttributedValue) -> str:
    """Return whether the tolerances allow the value, for final errors with such a bound."""
    is_bounded = found.metric in {"final.position_error", "final.heading_error"}
    is_bounded = is_bounded and "tolerance" not in found.causes
    if not is_bounded or found.without_all is None or found.without_all > found.resolution.size:
        return ""
    if found.resolution.is_tolerance:
        return f"; the tolerances alone allow {_format_value(found, found.resolution.size)}"
    return f", not more than {_describe_resolution(found)}"


def _write_together(found: AttributedValue) -> str:
    """Return the part that arises only if several causes act together; empty if it is small."""
    if not found.acting or is_negligible(found):
        return ""
    sizes = {one.cause: one.size for one in found.contributions}
    return write_joint_parts(found.together, sizes, {}, partial(_format_value, found))


def _write_singles(found: AttributedValue) -> str:
    """Return the value without each of two causes; empty if chance or others take part."""
    alone = {one.cause: one.alone for one in found.contributions if one.cause in found.acting}
    is_pair = len(alone) == 2 == len(choose_named(found))
    if found.seeds is not None or not is_pair or None in alone.values():
        return ""
    (first, value), (second, other) = alone.items()
    return (
        f"without {first} it would be {_format_value(found, value)},"
        f" without {second} {_format_value(found, other)}"
    )


def _write_seeds(found: AttributedValue) -> str:
    seeds = found.seeds
    if seeds is None:
        return ""
    if not seeds.varies:
        idle = _list_idle(found)
        if seeds.used < seeds.count:
            return f"The {seeds.used} of {seeds.count} seeds that give a value all give the same."
        if not idle:
            return f"All {seeds.count} seeds give the same value."
        them = f"The {idle[0]} does" if len(idle) == 1 else f"{capitalise(join_words(idle))} do"
        return f"{them} not change this metric."
    of = f"{seeds.count} seeds"
    if seeds.used < seeds.count:
        of = f"{seeds.used} of {of} (with the others it has no value, or none without some effect)"
    mean = _format_value(found, seeds.mean, seeds.standard_error)
    low, high = _format_value(found, seeds.low), _format_value(found, seeds.high)
    # Values that round to equal digits have no range that these digits show.
    within = f"lie between {low} and {high}"
    if low == high:
        within = f"span {_format_value(found, seeds.high - seeds.low)}"
    return (
        f"The value depends on the random seed. Over {of} its mean is {mean} (one standard error),"
        f" and the central 95 % {within}. Contributions are means over the seeds."
    )


def _list_idle(found: AttributedValue) -> list[str]:
    """Return the random effects that never change the value, in any combination."""
    return [name for name in found.causes if name in RANDOM_EFFECTS - {*found.acting}]


def _write_unclear(found: AttributedValue) -> str:
    unclear = [one for one in list_large(found) if not one.is_clear]
    if found.seeds is None or not unclear:
        return ""
    parts = [
        f"{one.cause} ({_format_value(found, one.size, one.standard_error)})" for one in unclear
    ]
    return f"The contribution of {join_words(parts)} may be chance."


def _write_starts(found: AttributedValue) -> str:
    starts = found.starts
    if starts is None:
        return ""
    within = f"{math.degrees(starts.within_rad):.3g} deg"
    where = f"or {starts.count} start headings within +-{within} it is"
    missing = f"; {starts.without_value} of them have no value" if starts.without_value else ""
    span = _format_span(found, starts.low, starts.high)
    if not starts.is_wide:
        return f"F{where} {span}{missing}."
    rest = ""
    if starts.without_all is not None:
        rest = f", without {_name_acting(found)} {_format_span(found, *starts.without_all)}"
    # Each cause's part of the total; the last part follows from the others.
    names = [part.cause for part in starts.parts]
    parts = [
        f"{part.cause} contributes {100.0 * part.low:.2g} to {100.0 * part.high:.2g} %"
        for part in starts.parts[:-1]
    ]
    total = f"of the total that {join_words(names)} add."
    divided = f" {capitalise(join_words(parts))} {total}" if parts else ""
    return f"It depends on single samples: f{where} {span}{rest}{missing}.{divided}"


def _format_span(found: AttributedValue, low: float, high: float) -> str:
    least, most = f"{low:.4g}", _format_value(found, high)
    return most if _format_value(found, low) == most else f"{least} to {most}"


def _write_others(found: AttributedValue) -> list[str]:
    """Return the causes that change the value alone, except those that lower a large value."""
    telling, leading = list_telling(found), choose_leading(found)
    lowering = [one for one in telling if is_lowering(found, one)]
    rest = [one for one in telling if one not in leading and one not in lowering]
    told = [_write_alone(found, one) for one in rest]
    if not lowering:
        return told
    mean = "" if found.seeds is None else " in the mean"
    names = join_words([one.cause for one in lowering])
    each = [f"without {one.cause} ({_format_value(found, one.alone)})" for one in lowering]
    larger = f"The value is larger{mean} {join_words(each)}"
    if len(lowering) == 1:
        larger = f"Without it the value is larger{mean}: {_format_value(found, lowering[0].alone)}"
    return [f"Not a cause: {names}. {larger}.", *told]


def _write_alone(found: AttributedValue, one: Contribution) -> str:
    kind = "Effect apart" if one.cause in found.effects else "Design parameter"
    mean = "" if found.seeds is None else " in the mean"
    without = f"{kind}: {one.cause}. Without it ({one.meaning})"
    if one.alone is None:
        return f"{without} there is no value: {one.ending}."
    if one.ending:
        return f"{without}, {one.ending}."
    return f"{without} the value is {_format_value(found, one.alone)}{mean}."


def _format_value(
    found: AttributedValue, value: float | None, standard_error: float | None = None
) -> str:
    """Return a value with four digits, the metric's unit, and a given standard error."""
    spread = f" +- {standard_error:.2g}" if standard_error else ""
    return f"{value or 0.0:.4g}{spread} {found.unit}".removesuffix(" 1")


_MOST_TOGETHER: Final = 3
"""Largest number of joint parts in one sentence; four causes have eleven joint parts."""


def write_missing(
    without: Iterable[ValueSet], having: Iterable[ValueSet], names: Mapping[str, str], nothing: str
) -> str:
    """Return the sets that leave a metric without a value, and those that give it one, in words.

    `names` are the words for all causes, and `nothing` those for a run without them.
    """

    def name_set(case: ValueSet) -> str:
        words = join_words([names.get(name, name) for name in case.causes])
        words += " alone" * (len(case.causes) < len(names))
        return f"with {words}" if case.causes else nothing

    parts = [f"{name_set(case)} it has no value: {case.reason}" for case in without]
    parts += [f"{name_set(case)} it has a value" for case in having]
    return capitalise("; ".join(parts)) + ". Therefore there are no contributions."


def write_joint_parts(
    together: Iterable[Together],
    sizes: Mapping[str, float],
    names: Mapping[str, str],
    format_size: Callable[[float, float | None], str],
) -> str:
    """Return the parts that arise only if several causes act, if clear and not small.

    `sizes` are the contributions, `names` other words for causes.
    """
    together = [*together]
    sentences, total = [], math.fsum(map(abs, sizes.values()))
    for case in sorted(together, key=lambda case: -abs(case.value))[:_MOST_TOGETHER]:
        if abs(case.value) <= NAMED * total or not is_clear(case.value, case.standard_error):
            continue
        of = [names.get(name, name) for name in case.causes]
        sentences.append(
            _write_joint_part(case, of, _sum_apart(case, sizes, together), format_size)
        )
    return " ".join(sentences)


def _sum_apart(case: Together, sizes: Mapping[str, float], together: Iterable[Together]) -> float:
    """Return what the causes of a joint part add without it, alone and in smaller groups.

    Each joint part is divided equally among the contributions of its causes.
    """
    inside = {*case.causes}
    found = [sizes.get(name, 0.0) for name in case.causes]
    for one in together:
        shared = len(inside & {*one.causes})
        found.append(-one.value * shared / len(one.causes))
        if one != case and inside >= {*one.causes}:
            found.append(one.value)
    return math.fsum(found)


def _write_joint_part(
    case: Together,
    of: list[str],
    apart_size: float,
    format_size: Callable[[float, float | None], str],
) -> str:
    """Return how a joint part changes what the causes add without it."""
    is_pair = len(of) == 2
    size = format_size(abs(case.value), case.standard_error)
    them, both = capitalise(join_words(of)), "both" if is_pair else "all of them"
    is_small = abs(apart_size) <= NAMED * abs(case.value)  # alone they change little or nothing
    change = _name_change(case.value if is_small else apart_size)
    if is_small or case.value * apart_size > 0.0:
        return f"{them} act together: {size} of what they {change} arises only if {both} act."
    pair = " alone plus ".join(of)
    apart = f"{pair} alone" if is_pair else "their parts, alone and in smaller groups"
    whole = apart_size + case.value
    if whole * apart_size < 0.0:
        before, after = (format_size(abs(one), None) for one in (apart_size, whole))
        return (
            f"{them} act together: {apart} would {change} {before},"
            f" but {both} together {_name_change(whole)} {after}."
        )
    return f"{them} overlap: together they {change} {size} less than {apart}."


def _name_change(size: float) -> str:
    return "add" if size >= 0.0 else "take away"


class Attribution(AttributedValue):  # noqa: D101 (the fields are those of the value)
    __doc__, __slots__ = AttributedValue.__doc__, ()

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "sentences", write_sentences(self))

    def _repr_html_(self) -> str:
        unit, changing = self.unit, self.changing
        heads = ["cause", f"contribution [{unit}]", f"without it alone [{unit}]", "means"]
        rows: list[list[object]] = [
            [one.cause, one.contribution, one.alone, one.ending or one.meaning] for one in changing
        ]
        if self.seeds is not None:
            heads.insert(2, f"s.e. [{unit}]")
            for row, one in zip(rows, changing, strict=True):
                row.insert(2, one.standard_error)
            if self.contributions and self.seeds.varies:
                row = [answers.THIS_SEED, self.this_seed, None, None, answers.THIS_SEED_MEANS]
                rows.insert(sum(one.contribution is not None for one in changing), row)
        rest = [f"<p>{escape(text)}</p>" for text in self.sentences[1:]]
        return format_notebook(write_headline(self), format_html(rows, heads=heads), *rest)
