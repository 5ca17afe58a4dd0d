"""Sentences that say why a metric differs between two runs, true for these runs only."""

import math
from collections.abc import Iterator, Sequence
from html import escape
from typing import Any, Final

from turtlelog.display import (
    describe_count,
    format_html,
    format_notebook,
    format_pair,
    format_short,
    join_words,
)
from turtlelog.explain.answer_words import write_joint_parts, write_missing
from turtlelog.explain.answers import (
    SAME,
    SEED,
    Change,
    DividedDifference,
    Side,
)
from turtlelog.explain.causes import NAMED
from turtlelog.explain.robot_log import CHANCE, COMMANDS, NOISE, ROBOT, TIMES, is_place
from turtlelog.identify.axis_motion import AXES, NAMES, UNITS
from turtlelog.run import LAW, describe_changes, describe_software, list_software_changes

_FEW: Final = 3
"""Largest number of changes that are all named, so that their contributions visibly add up."""

_TINY: Final = 1e-3
"""Share of the total below which a change appears only in the list, because no printed digit
changes."""

_DIGITS: Final = 4  # number of digits of the largest value; all other values have as many decimals

_FEWEST: Final = 2
"""Smallest number of digits of the largest contribution, even if it is much smaller than the
values."""

_MOST_DECIMALS: Final = 9

_PLURALS: Final = ("gains", "limits", "limits driving", "limits turning", COMMANDS)
_SPANS: Final = ("pause", "delay", "time span", "sampling period", "queue")
_CHANCE: Final = {
    SEED: "the seeds of these runs",
    NOISE: "different noise levels",
    TIMES: "the times at which poses are recorded",
}
"""Parts of a difference that are chance instead of causes."""

_WORDS: Final = {"law": "the law itself"}

_PARTS: Final = {
    "start": "They start from other poses",
    "robot": "Until then all commands are equal, so the cause lies outside the controller: in the"
    " transport of commands, in the robot, in what acts on it, or in the measurement of its poses",
    "sensor": "Until then the robot moves equally, so the cause lies in the sensor",
    "controller": "Until then the controller reads equal poses, so the cause lies in the"
    " controller: its code, its version or its state",
    "code": "Until then the controller reads equal poses, so the cause lies in the controller,"
    " whose code differs",
    "timing": "Until then all values are equal, so the cause lies in the timing",
    "end": "All that both contain is equal",
}
"""Meaning of the first difference between two runs, by the part that differs."""


def write_difference_sentences(
    found: DividedDifference, *, are_recorded: bool = True
) -> tuple[str, ...]:
    """Return sentences on the difference, its reasons, their dependences, and what else differs.

    `are_recorded`: whether both runs have recorded samples, which their scenarios can reproduce.
    """
    sides = (found.first, found.second)
    pairs = [(one.as_logged, one.resimulated) for one in sides]
    known = [(a, b) for a, b in pairs if a is not None and b is not None]
    sentences = [write_difference_headline(found)]
    if len(known) == 2 and any(abs(a - b) > SAME * abs(a) for a, b in known):
        first, second = (format_magnitude(found, value) for _, value in known)
        if found.unexplained is None:
            sentences.append(f"Simulated again it is {first} and {second}.")
        else:
            left = format_magnitude(found, abs(found.unexplained))
            sentences.append(
                f"The robots' models have {first} and {second}: {left} is not explained."
            )
    sentences += [*_write_departure(found), *_write_obstacle(found), *_write_dependences(found)]
    if found.idle:
        idle = join_words(found.idle)
        sentences.append(f"Different, but without effect on this metric: {idle}.")
    if found.contributions and all(side.basis == "recorded" for side in sides):
        basis = "The recorded scenarios reproduce all samples of both runs."
        sentences += [basis] * are_recorded
    else:
        identified = (side for side in sides if side.basis == "identified")
        sentences.append(" ".join(map(_write_identified, identified)))
    return tuple(filter(None, [*sentences, *_write_robot_basis(found)]))


def _write_dependences(found: DividedDifference) -> Iterator[str]:
    """Yield what the contributions depend on: starts, each other, seeds, orders and effects."""
    if found.starts is not None and found.starts.is_wide:
        within = f"{math.degrees(found.starts.within_rad):.3g} deg"
        spans = []
        for span in (found.starts.first, found.starts.second):
            least, most = (format_magnitude(found, end) for end in span)
            spans.append(most if least == most else f"{least} to {most}")
        yield (
            "The difference depends on single samples. For"
            f" {found.starts.count} start headings within +-{within}, {found.metric} is"
            f" {spans[0]} in the first run and {spans[1]} in the second."
        )
    yield _write_together(found)
    if found.contributions and not _list_divided(found):
        yield "No setting differs but the seed of the random effects."
    if found.orders is not None and found.contributions:
        orders = f"{found.orders} orders of the changes were sampled"
        yield f"{orders}: each contribution has a standard error."
    unclear = [
        name_change(one) for one in found.contributions if one.standard_error and not one.is_clear
    ]
    if unclear:
        yield f"May be chance: what {join_words(unclear)} {'adds' if len(unclear) == 1 else 'add'}."
    large = [one for one in found.effects if abs(one.shift) > found.resolution.size]
    parts = [
        f"{format_magnitude(found, abs(one.shift))} {'more' if one.shift >= 0.0 else 'less'} from"
        f" the {one.cause}"
        for one in large[:_FEW]
    ]
    if parts:
        head = "By effect instead of by setting (turtlelog explain), the second run has"
        yield f"{head} {join_words(parts)}."


def _write_identified(side: Side) -> str:
    unknown = f" Not identified, so taken as equal: {join_words(side.unknown)}."
    reason, _, _ = side.note.partition(":")
    return (
        f"The scenario of {side.name} is identified from its samples: {reason}."
        f" It {'reproduces all samples' if side.is_exact else 'does not reproduce every sample'}."
        f"{unknown if side.unknown else ''}"
    )


def write_difference_headline(found: DividedDifference) -> str:
    """Return both values, and how much each change adds to the first value or subtracts from it."""
    first, second = found.first, found.second
    if first.as_logged is None or second.as_logged is None:
        return f"{found.metric}: {_write_side(found, first)}; {_write_side(found, second)}."
    apart = second.as_logged - first.as_logged
    sizes = [format_magnitude(found, one) for one in (first.as_logged, second.as_logged)]
    if abs(apart) <= SAME * max(abs(first.as_logged), abs(second.as_logged)):
        moves = f"is {sizes[0]} in both runs"
    else:
        is_alike = sizes[0] == sizes[1]  # in the digits that are printed
        end = f"by {format_short(abs(apart), found.unit)}" if is_alike else f"to {sizes[1]}"
        moves = f"{'rose' if apart > 0.0 else 'fell'} from {sizes[0]} {end}"
    if _is_negligible(found) and found.contributions:
        size = f"{format_magnitude(found, found.resolution.size)} ({found.resolution.reason})"
        return f"{found.metric} {moves}: no change adds more than the resolution, {size}."
    least = _TINY * _sum(found.contributions)
    chance = [
        f"{_CHANCE[one.name]} {_write_move(found, one.size, is_many=True)}"
        for one in found.contributions
        if _is_chance(found, one) and (one.name == SEED or _is_large(one, least))
    ]
    told = "; ".join(filter(None, (_write_parts(found), *chance)))
    return f"{found.metric} {moves}{f': {told}' if told else ''}."


def _write_parts(found: DividedDifference) -> str:
    """Return the contributions of the changes; those not in the headline are added up."""
    parts = [
        f"{name_change(one)} {_write_move(found, one.size, is_many=_is_plural(one))}"
        for one in choose_told(found)
    ]
    if found.unexplained is not None:
        return join_words(parts) or ("no cause is certain" if found.contributions else "")
    rest = [one for one in _list_divided(found) if one not in choose_told(found)]
    size = math.fsum(one.size for one in rest)
    if parts and abs(size) > _TINY * _sum(_list_divided(found)):
        parts.append(f"{len(rest)} other changes together {_write_move(found, size, is_many=True)}")
    told = join_words(parts) if len(parts) > 2 else ", ".join(parts)
    return f"in the mean over {found.seeds} seeds {told}" if told and found.seeds > 1 else told


def _is_plural(one: Change) -> bool:
    return one.name in _PLURALS or (is_place(one.keys) and len(one.keys) > 1)


def _list_divided(found: DividedDifference) -> list[Change]:
    return [one for one in found.contributions if not _is_chance(found, one)]


def _is_chance(found: DividedDifference, one: Change) -> bool:
    """Return whether a change is due to chance. Noise that a scenario sets is a cause instead."""
    return one.name == SEED or (found.unexplained is not None and one.name in CHANCE)


def _write_side(found: DividedDifference, side: Side) -> str:
    if side.as_logged is None:
        return f"{side.name} has no value ({side.reason})"
    return f"{side.name} has {format_magnitude(found, side.as_logged)}"


def choose_told(found: DividedDifference) -> list[Change]:
    """Return the changes that the first line names: all relevant ones, or the largest of many."""
    divided = _list_divided(found)
    if found.unexplained is not None:
        return [one for one in divided if _is_large(one, _TINY * _sum(divided))]
    if len(divided) <= _FEW:
        tiny = _TINY * _sum(divided)
        return [one for one in divided if abs(one.size) > tiny]
    least = NAMED * _sum(divided)
    told = [one for one in divided if _is_large(one, least)]
    return divided if len(told) == len(divided) - 1 else told


def _sum(changes: Sequence[Change]) -> float:
    return math.fsum(abs(one.size) for one in changes)


def _is_large(one: Change, least: float) -> bool:
    return abs(one.size) > least and one.is_clear


def _write_move(found: DividedDifference, size: float, *, is_many: bool) -> str:
    verb, end = ("add", "") if size >= 0.0 else ("take", " away")
    return f"{verb}{'' if is_many else 's'} {format_magnitude(found, abs(size))}{end}"


def format_change(found: DividedDifference, one: Change) -> str:
    """Return a contribution with its sign, its unit and its standard error, if any."""
    if one.low is not None and one.high is not None:
        low, high = (format_magnitude(found, end) for end in (one.low, one.high))
        spread = f" ({low} to {high})"
    else:
        spread = f" +- {one.standard_error:.2g}" if one.standard_error else ""
    return f"{'+' if one.size >= 0.0 else ''}{format_magnitude(found, one.size)}{spread}"


def name_change(one: Change) -> str:
    """Return a group of settings in words: `the gains`, `the shorter pause`, or its key."""
    if one.keys[0].partition(".")[0] in AXES:  # `dead time turning (70 -> 110 ms)`
        for key, before, after in zip(one.keys, one.first, one.second, strict=False):
            if before != after and not isinstance(before or after, str):
                return f"the robot's {one.name} ({_format_pair(key, before, after)})"
        return f"the robot's {one.name}"
    if one.name in _WORDS:
        return _WORDS[one.name]
    if "." in one.name:
        return one.name
    change = ""
    before, after = ((*values, 0)[0] or 0 for values in (one.first, one.second))
    is_span = len(one.keys) == 1 and one.name in _SPANS
    if is_span and not isinstance(before or after, str):  # a policy is not longer than another
        change = "longer " if after > before else "shorter "
        if not (before and after):
            change = "" if after else "missing "
    return f"the {change}{one.name}"


def _is_negligible(found: DividedDifference) -> bool:
    sizes = [abs(one.size) for one in found.contributions]
    return max([*sizes, abs(found.difference or 0.0)]) <= found.resolution.size


def format_magnitude(found: DividedDifference, value: float) -> str:
    """Return a value with its unit, with as many decimals as all values of the answer."""
    text = f"{value:.{_count_decimals(found)}f}"
    if not float(text):
        text = f"{value:.1g}" if value else "0"
    return f"{text} {found.unit}".removesuffix(" 1")


def _count_decimals(found: DividedDifference) -> int:
    """Return the decimals that show four digits of the largest value, or two of a contribution."""
    sides = (found.first.as_logged, found.second.as_logged)
    sizes = [one.contribution for one in found.contributions]
    decimals = [
        digits - 1 - math.floor(math.log10(largest))
        for digits, values in ((_DIGITS, (*sides, *sizes)), (_FEWEST, sizes))
        if (largest := max((abs(one) for one in values if one is not None), default=0.0))
    ]
    return min(max([*decimals, 0]), _MOST_DECIMALS)


def _write_obstacle(found: DividedDifference) -> list[str]:
    if found.without_value:
        words = {one.name: name_change(one) for one in found.changes}
        sets = (found.without_value, found.with_value)
        return [write_missing(*sets, words, "without all changes")]
    if not found.withheld:
        return []
    if found.has_same_settings:
        alike = [side.name for side in (found.first, found.second) if side.basis == "recorded"]
        return [f"Simulated again, that scenario reproduces {one} alone." for one in alike] or [
            f"That scenario is not known to reproduce either run: {found.withheld}."
        ]
    names = [name_change(one) for one in found.changes]
    who = "robots" if found.first.basis == ROBOT else "runs"
    differ = f" The {who} differ in {join_words(names)}." if names else ""
    others = list_software_changes(found.first.simulated_by, found.second.simulated_by)
    if any(one.name == "law" for one in found.changes):
        others = tuple(one for one in others if one.name != LAW)
    software = f" The software differs, too: {describe_changes(others)}." if others else ""
    return [f"Why is not known: {found.withheld}.{differ}{software}"]


def _write_together(found: DividedDifference) -> str:
    if not found.contributions or _is_negligible(found):
        return ""
    names = {one.name: name_change(one) for one in found.contributions}
    sizes = {one.name: one.size for one in _list_divided(found)}
    return write_joint_parts(
        found.together, sizes, names, lambda value, _: format_magnitude(found, value)
    )


def _write_departure(found: DividedDifference) -> list[str]:
    one = found.departure
    if not found.has_same_settings:
        return []
    if one is None:
        return ["The runs are equal: no setting differs, and no sample."]
    codes = [side.simulated_by.get(LAW) for side in (found.first, found.second)]
    has_other_code = None not in codes and codes[0] != codes[1]
    values = join_words(format_pair(one.first, one.second, one.unit), "then")
    samples = describe_count(one.samples, "equal sample")
    return [
        f"{_write_software(found)} The runs depart at {one.time_s:.3f} s, after {samples}, in"
        f" {one.signal.replace('_', ' ')}: {values}.",
        f"{_PARTS['code' if one.part == 'controller' and has_other_code else one.part]}.",
    ]


def _write_software(found: DividedDifference) -> str:
    first, second = found.first.simulated_by, found.second.simulated_by
    silent = [side.name for side in (found.first, found.second) if not side.simulated_by]
    if silent:
        names = f"{join_words(silent)} {'does' if len(silent) == 1 else 'do'} not name"
        return f"No setting differs, and {names} the versions used."
    changes = list_software_changes(first, second)
    if [one.name for one in changes] == [LAW]:
        return "No setting differs, but the code of the law does."
    if changes:
        return f"No setting differs, but the software does: {describe_changes(changes)}."
    code = ", by the same code of the law" if LAW in first else ""
    return f"No setting differs: both ran with {describe_software(first)}{code}."


_MS: Final = ("dead_time_s", "lag_s")  # fields of values that are printed in milliseconds

_AFTER: Final = {"gain": "", "reverse_gain": " backwards", "rate_limit": "/s"}
"""Text after a value: instead of the axis's unit, or after this unit."""


def _format_pair(key: str, before: Any, after: Any) -> str:
    axis, _, name = key.partition(".")
    of_axis = UNITS["speed" if axis == "speed" else "turn_rate"]
    factor, unit = (1e3, " ms") if name in _MS else (1.0, f" {of_axis}")
    unit = _AFTER[name] if name.endswith("gain") else unit + _AFTER.get(name, "")
    for digits in (3, 4, 5, 6):  # as many as show that they differ
        shown = ["none" if one is None else f"{factor * one:.{digits}g}" for one in (before, after)]
        if shown[0] != shown[1]:
            break
    if after is None:
        return f"{shown[0]}{unit} -> none"
    return f"{' -> '.join(shown)}{unit}"


def write_side_notes(found: DividedDifference) -> list[str]:
    """Return what is to know of each robot's log: that its law is known, that its poses jump."""
    sides = [side for side in (found.first, found.second) if side.basis == ROBOT]
    return [f"{side.name}: {side.note}." for side in sides if side.note]


def _write_robot_basis(found: DividedDifference) -> list[str]:
    """Return the basis of the contributions of two robots' parts; empty for simulated runs."""
    sides = [side for side in (found.first, found.second) if side.basis == ROBOT]
    said = write_side_notes(found)
    for side in sides:
        if side.unknown:
            names = join_words([NAMES[axis] for axis in AXES if axis in side.unknown])
            told = f"{side.name} has no commands of the {names}"
            said.append(f"{told}, so the other robot's is taken for it.")
    if not sides or not found.contributions:
        return said
    answers = any(one.name == COMMANDS and one.is_clear for one in found.contributions)
    return [
        *(["Why the commands differ is not in the logs: they may answer the robot."] * answers),
        "Each robot's model is driven with the recorded commands. Intervals are 95 %, from"
        f" {found.seeds} draws of the identified parameters and the noise.",
        *said,
    ]


class ExplainedDifference(DividedDifference):  # noqa: D101 (the fields are those of the value)
    __doc__, __slots__ = DividedDifference.__doc__, ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "sentences", write_difference_sentences(self))

    def _repr_html_(self) -> str:
        heads = ["settings", f"contribution [{self.unit}]", "first run", "second run"]
        rows: list[list[object]] = []
        for one in self.contributions:
            pairs = (zip(one.keys, values, strict=False) for values in (one.first, one.second))
            texts = (", ".join(f"{key} = {value}" for key, value in pair) for pair in pairs)
            rows.append([one.name, one.contribution, *texts])
        table = format_html(rows, heads=heads) if rows else ""
        rest = [f"<p>{escape(text)}</p>" for text in self.sentences[1:]]
        return format_notebook(self.sentences[0], table, *rest)
