"""An attribution in sentences, each of which is so."""

import math
from typing import Final

from turtlelog.display import join_words
from turtlelog.explain.attribution import (
    Attribution,
    SeedRange,
    Share,
    Together,
    ValueSet,
    is_clear,
)
from turtlelog.explain.mechanisms import RANDOM_EFFECTS

_NAMED: Final = 0.1
"""Of the sum of the shares' magnitudes: a mechanism with a larger share is named, and so is what
arises only together. A property is named beyond this part of the value."""

_MOST_TOGETHER: Final = 3
"""Sets that arise only together, in one sentence; of four mechanisms there are eleven."""

_SAME: Final = 1e-6
"""Of a value: a smaller difference between log and re-simulation goes without a word."""


def write_sentences(found: Attribution) -> tuple[str, ...]:
    """Return the value, what caused it, what it hangs on, and which property changes it alone."""
    sentences = [_write_value(found)]
    if found.without_value:
        sentences += [_write_missing(found)]
    elif found.withheld:
        sentences += [_write_withheld(found)]
    else:
        sentences += [_write_seeds(found), _write_cause(found), _write_starts(found)]
        sentences += [_write_unclear(found), _write_this_seed(found)]
        sentences += [*found.doubts, *(_write_alone(found, other) for other in found.others)]
    if found.left:
        sentences += [f"{_capitalise(join_words(found.left))} {_be(found.left)} left as built."]
    sentences += found.remarks
    return tuple(filter(None, sentences))


def _write_value(found: Attribution) -> str:
    logged, built = found.as_logged, found.as_built
    if logged is None and built is None:
        return f"{found.metric} has no value: {found.reason}."
    if logged is None:
        in_log = f", and none in the log: {found.reason}" if found.reason else ""
        return f"{found.metric} is {_format(found, built)}{' re-simulated' * bool(in_log)}{in_log}."
    if built is None:
        return (
            f"{found.metric} is {_format(found, logged)} in the log; re-simulated it has no value."
        )
    if abs(logged - built) <= _SAME * abs(built):
        return f"{found.metric} is {_format(found, built)}, in the log and re-simulated."
    if _format(found, logged) == _format(found, built):
        apart = _format(found, abs(logged - built))
        size = _format(found, logged)
        return f"{found.metric} is {size}, in the log and re-simulated; they differ by {apart}."
    return (
        f"{found.metric} is {_format(found, logged)} in the log, and {_format(found, built)}"
        " re-simulated."
    )


def _write_withheld(found: Attribution) -> str:
    return f"No shares: {found.withheld}."


def _write_missing(found: Attribution) -> str:
    if not found.with_value and found.without_all is None:
        return (
            f"Nor has it one without {join_words(found.mechanisms, 'or')}."
            if found.mechanisms
            else ""
        )
    parts = [
        f"{_name_set(found, case)} it has no value: {case.reason}" for case in found.without_value
    ]
    parts += [f"{_name_set(found, case)} it has one" for case in found.with_value]
    return _capitalise("; ".join(parts)) + ". So there are no shares."


def _name_set(found: Attribution, case: ValueSet) -> str:
    if not case.mechanisms:
        return f"without {join_words(found.mechanisms)}"
    alone = " alone" if len(found.mechanisms) > len(case.mechanisms) else ""
    return f"with {join_words(case.mechanisms)}{alone}"


def _write_cause(found: Attribution) -> str:
    if not found.mechanisms:
        return f"None of the effects is in this run: {join_words(found.effects)}."
    if not found.acting and found.seeds is not None and [*found.mechanisms] == _list_idle(found):
        return ""  # the sentence on seeds says so
    if not found.acting:
        return f"Without {join_words(found.mechanisms, 'or')} it is the same."
    largest = max(abs(share.share or 0.0) for share in found.shares)
    added = found.divided - (found.without_all or 0.0)
    if max(largest, abs(added)) <= found.grain.size:
        idle = _list_idle(found) if found.seeds is not None else []  # a sentence says so of these
        names = [name for name in found.mechanisms if name not in idle]
        together = " together change" if len(names) > 1 else " changes"
        return (
            f"{_capitalise(join_words(names))}{together} it by {_format(found, added)}:"
            f" next to nothing, no more than {_describe_grain(found)}."
        )
    parts = [_write_part(found, share) for share in _choose_named(found) if share.is_clear]
    parts = parts or ["no effect is told from chance"]
    nothing = ", next to nothing together" if abs(added) <= found.grain.size else ""
    return (
        f"{_capitalise(join_words(parts))}{_write_together(found)}{nothing};"
        f" without {join_words(found.acting)} it would be {_format(found, found.without_all)}"
        f"{_write_remainder(found)}."
    )


def _describe_grain(found: Attribution) -> str:
    return f"{found.grain.reason} ({_format(found, found.grain.size)})"


def _choose_named(found: Attribution) -> list[Share]:
    ordered = sorted(found.shares, key=lambda share: -abs(share.share or 0.0))
    return [share for share in ordered if abs(share.share or 0.0) > _NAMED * _sum_shares(found)]


def _sum_shares(found: Attribution) -> float:
    return math.fsum(abs(share.share or 0.0) for share in found.shares)


def _write_part(found: Attribution, share: Share) -> str:
    value = share.share or 0.0
    size = _format(found, abs(value), share.standard_error)
    return (
        f"{share.mechanism} adds {size}" if value > 0.0 else f"{share.mechanism} takes away {size}"
    )


def _write_together(found: Attribution) -> str:
    """Return what arises only when several act, in brackets; empty where that is little."""
    largest = sorted(found.together, key=lambda case: -abs(case.value))[:_MOST_TOGETHER]
    parts = [
        _write_case(found, case)
        for case in largest
        if abs(case.value) > _NAMED * _sum_shares(found)
        and is_clear(case.value, case.standard_error)
    ]
    return f" ({'; '.join(parts)})" if parts else ""


def _write_case(found: Attribution, case: Together) -> str:
    size = _format(found, abs(case.value), case.standard_error)
    names = join_words(case.mechanisms)
    if case.value > 0.0:
        both = "both" if len(case.mechanisms) == 2 else "all"
        return f"{size} of this arises only when {names} {both} act"
    return f"{names} together make {size} less than the sum of their parts"


def _write_seeds(found: Attribution) -> str:
    """Return what the value is with other seeds."""
    seeds = found.seeds
    if seeds is None:
        return ""
    if not seeds.varies:
        return _write_equal_seeds(found, seeds)
    of = f"{seeds.count} seeds"
    if seeds.used < seeds.count:
        of = f"{seeds.used} of {of} (with the others it has no value, or none without some effect)"
    mean = _format(found, seeds.mean, seeds.standard_error)
    low, high = _format(found, seeds.low), _format(found, seeds.high)
    # Values that round alike have no range that these digits show.
    within = f"lie between {low} and {high}"
    if low == high:
        within = f"span {_format(found, seeds.high - seeds.low)}"
    return (
        f"Each seed gives another value: over {of} the mean is {mean} (one standard error), and the"
        f" central 95 % {within}. The shares are of the mean."
    )


def _write_equal_seeds(found: Attribution, seeds: SeedRange) -> str:
    """Return that no seed changes the value, and which random effect therefore does not."""
    idle = _list_idle(found)
    if seeds.used < seeds.count:
        return f"The {seeds.used} of {seeds.count} seeds that give a value all give the same."
    if not idle:
        return f"All {seeds.count} seeds give the same value."
    return (
        f"The {idle[0]} does not change this metric."
        if len(idle) == 1
        else f"{_capitalise(join_words(idle))} do not change this metric."
    )


def _list_idle(found: Attribution) -> list[str]:
    """Return the random effects that change the value in no combination."""
    return [name for name in found.mechanisms if name in RANDOM_EFFECTS - {*found.acting}]


def _write_unclear(found: Attribution) -> str:
    """Return the shares that would be named if they were further from 0 than chance."""
    unclear = [share for share in _choose_named(found) if not share.is_clear]
    if found.seeds is None or not unclear:
        return ""
    parts = [
        f"{share.mechanism} ({_format(found, share.share, share.standard_error)})"
        for share in unclear
    ]
    return f"Chance alone may make the share of {join_words(parts)}."


def _write_this_seed(found: Attribution) -> str:
    value = found.this_seed
    if value is None or found.seeds is None or not found.seeds.varies:
        return ""
    size = _format(found, abs(value))
    does = "adds" if value >= 0.0 else "takes away"
    return f"The seed of this run {does} {size}: that is the rest."


def _write_starts(found: Attribution) -> str:
    starts = found.starts
    if starts is None:
        return ""
    within = f"{math.degrees(starts.within_rad):.3g} deg either way"
    where = f"over {starts.count} starts that span one sample's turn ({within})"
    low, high = _format(found, starts.low), _format(found, starts.high)
    missing = f"; {starts.without_value} of them have no value" if starts.without_value else ""
    if not starts.is_wide:
        span = f"is {low}" if low == high else f"is between {low} and {high}"
        return f"{_capitalise(where)} it {span}{missing}."
    names = [*starts.parts]
    parts = [
        f"{name}'s part of what {join_words(names)} add is between {low:.2g} and {high:.2g}"
        for name, (low, high) in [*starts.parts.items()][: len(names) - 1]
    ]
    return (
        f"It hangs on single samples: {where} it is between {low} and {high}"
        f"{''.join(f', and {part}' for part in parts)}{missing}."
    )


def _write_remainder(found: Attribution) -> str:
    """Return whether the tolerances leave as much, of the errors at the end that they bound."""
    is_bounded = found.metric in {"final.position_error", "final.heading_error"}
    if not is_bounded or found.without_all is None or found.without_all > found.grain.size:
        return ""
    return f", no more than {_describe_grain(found)}"


def _write_alone(found: Attribution, other: Share) -> str:
    built = found.divided
    without = f"Re-simulated without {other.mechanism} alone ({other.meaning})"
    if other.alone is None:
        return f"{without} it has no value: {other.ending}."
    change = abs(other.alone - built)
    if change <= found.grain.size or change <= _NAMED * abs(built):
        return ""
    if not is_clear(change, other.standard_error):
        return ""
    if other.ending:
        return f"{without} {other.ending}."
    mean = "" if found.seeds is None else " in the mean"
    direction = "higher" if other.alone > built else "lower"
    return f"{without} it would be {direction}{mean}: {_format(found, other.alone)}."


def _format(found: Attribution, value: float | None, standard_error: float | None = None) -> str:
    spread = f" +- {standard_error:.2g}" if standard_error else ""
    return f"{value or 0.0:.4g}{spread} {found.unit}".removesuffix(" 1")


def _be(words: "tuple[str, ...]") -> str:
    return "is" if len(words) == 1 else "are"


def _capitalise(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}"
