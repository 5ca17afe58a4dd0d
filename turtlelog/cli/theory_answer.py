"""What `turtlelog theory` prints: recommended gains and limits first, then the loops."""

import shlex
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Final

import turtlelog as tl
from turtlelog.cli.output import fill_lines, find_width
from turtlelog.cli.theory_gains import Recommended, Wishes, tabulate_recommended
from turtlelog.cli.theory_loops import LoopAnswer, list_sources, tabulate_answers, tell_motion
from turtlelog.cli.theory_tables import describe_sampling, summarise_gains, tabulate_theory
from turtlelog.display import format_short, join_words

if TYPE_CHECKING:
    from turtlelog.compare import Table
    from turtlelog.theory import PidGains, Recommendation, SampledLoop

_MOST_COLUMNS: Final = 3
"""Loops beside each other: a line has no room for more."""

_IDEAL: Final = "without command limits"
"""What recommended gains hold for."""

_UNLIMITED: Final = "Commands are not clipped: limits change overshoot and settling time."


def format_integrator(
    loops: "list[SampledLoop]", recommended: Recommended, wishes: Wishes, *, shows_all: bool
) -> str:
    """Return the answer for P on 1/s.

    Args:
        loops: At each gain.
        recommended: Gains for that plant and dead time.
        wishes: What they shall give.
        shows_all: Show the plant, the ideal loop, limits at other dead times and published rules.
    """
    head = [
        *_list_recommended(
            recommended.found,
            "P",
            wishes,
            ideal=_IDEAL if loops[0].dead_time_ticks else f"{_IDEAL} or dead time",
        ),
        *summarise_gains(loops),
        describe_sampling(loops[0]),
    ]
    plant, ideal, sampled, limits = tabulate_theory(loops)
    tables = [tabulate_recommended(recommended, wishes, shows_all=shows_all), sampled]
    tables += [limits, ideal, plant] if shows_all else []
    more = "The plant, the ideal loop, limits at other dead times, published rules: --details"
    return _join(head, tables, [_UNLIMITED, *([] if shows_all else [more])])


def format_terms(
    answers: Sequence[LoopAnswer],
    recommended: Recommended,
    wishes: Wishes,
    *,
    controller: str,
    shows_all: bool,
) -> str:
    """Return the answer for a loop with more than P on 1/s, at each Kp.

    Args:
        answers: At each Kp.
        recommended: Gains for that plant and dead time.
        wishes: What they shall give.
        controller: That of the loop: P, PI, PD or PID.
        shows_all: Show published rules, and why rules give no gains.
    """
    head = [
        *_list_recommended(recommended.found, controller, wishes),
        *_list_stable(answers),
        *_list_motions(answers),
    ]
    parts = [answers[k : k + _MOST_COLUMNS] for k in range(0, len(answers), _MOST_COLUMNS)]
    loops = [tabulate_answers("The sampled loop", part) for part in parts]
    tables = [tabulate_recommended(recommended, wishes, shows_all=shows_all), *loops]
    more = [] if shows_all else ["Published rules, and why rules give no gains: --details"]
    return _join(head, tables, [_UNLIMITED, *more])


def format_file(
    name: str,
    word: str,
    answers: Sequence[LoopAnswer],
    groups: Sequence[Recommended],
    wishes: Wishes,
    *,
    shows_all: bool,
) -> str:
    """Return the answer for each loop of a scenario or a recording.

    Args:
        name: Of the scenario or the run.
        word: As it was given.
        answers: Of each loop.
        groups: Gains, for loops that are alike together.
        wishes: What they shall give.
        shows_all: Show published rules, and where values come from.
    """
    known = [one for one in answers if one.found]
    if not known:
        why = "no loop is declared" if not answers else "theory has no linear model of its loops"
        robot = "turtlelog identify BAG --scenario robot.toml, turtlelog theory robot.toml"
        hint = [] if answers else [f"Gains for a robot: {robot}"]
        return fill_lines([f"{name}: {why}.", *list_sources(answers), *hint])
    found = {
        loop: best
        for one in groups
        for loop in one.loops
        if (best := find_best(one.found, "P")) is not None
    }
    rest = [
        *list_sources(answers, shows_all=shows_all),
        _UNLIMITED,
        *_list_run(word, answers, found),
        *(
            []
            if shows_all
            else ["Poles and margins, published rules, sources of values: --details"]
        ),
    ]
    tables = [tabulate_recommended(one, wishes, shows_all=shows_all) for one in groups]
    tables += [tabulate_answers(f"The loops of {name}", answers)] if shows_all else []
    return _join([_conclude(name, found, wishes), *map(_describe_loop, known)], tables, rest)


def _conclude(name: str, found: "dict[str, Recommendation]", wishes: Wishes) -> str:
    """Return the recommended gain of each loop."""
    if not found:
        return f"{name}: theory has no recommended gains."
    gains = [
        f"{format_short(best.gains.kp)} 1/s ({loop})" for loop, best in found.items() if best.gains
    ]
    wish = wishes.describe(next(iter(found.values())).rule)
    return f"{name}: recommended Kp for {wish}, {_IDEAL}: {', '.join(gains)}."


def _describe_loop(answer: LoopAnswer) -> str:
    """Return how a known loop answers at its own gain, and where it is stable."""
    loop = answer.found
    if loop is None:
        return ""
    kp = f"Kp = {format_short(loop.gains.kp)} 1/s"
    return f"{answer.title}: {kp}: {tell_motion(loop)}; stable for Kp {_show_range(answer)}."


def _join(head: Sequence[str], tables: "Sequence[Table]", rest: Sequence[str]) -> str:
    shown = [_narrow(table) for table in tables if table.rows]
    texts = [tl.draw.format_table(table, width=find_width()).strip("\n") for table in shown]
    return "\n\n".join([fill_lines(head), *texts, fill_lines(rest)])


def _narrow(table: "Table") -> "Table":
    """Return a table whose least important columns give room to the others."""
    ranks = [0 if column.title in {"damping", "stable"} else None for column in table.columns]
    return tl.compare.narrow_table(table, find_width(), ranks)


def find_best(found: "Sequence[Recommendation]", controller: str) -> "Recommendation | None":
    """Return the first gains of a controller for what is wanted; None without such gains."""
    return next((one for one in found if one.gains and one.controller == controller), None)


def _list_recommended(
    found: "Sequence[Recommendation]", controller: str, wishes: Wishes, *, ideal: str = _IDEAL
) -> Iterator[str]:
    """Yield the recommended gains of a controller, or of P; else why there are none."""
    best = find_best(found, controller) or find_best(found, "P")
    if best is None or best.gains is None:
        reasons = dict.fromkeys(one.reason for one in found if one.reason)
        yield f"No gains are recommended: {next(iter(reasons), 'no rule gives any')}."
        return
    yield (
        f"Recommended {ideal}: {best.controller} with {_show_gains(best.gains)} for"
        f" {wishes.describe(best.rule)}."
    )


def _show_gains(gains: "PidGains") -> str:
    said = [f"Kp = {format_short(gains.kp)} 1/s"]
    said += [f"Ki = {format_short(gains.ki)} 1/s^2"] if gains.ki else []
    said += [f"Kd = {format_short(gains.kd)}"] if gains.kd else []
    return join_words(said)


def _list_stable(answers: Sequence[LoopAnswer]) -> Iterator[str]:
    """Yield for which Kp the loop is stable, which the other gains decide."""
    if answers and answers[0].found:
        yield f"Stable for Kp {_show_range(answers[0])}."


def _list_motions(answers: Sequence[LoopAnswer]) -> Iterator[str]:
    """Yield how the loop answers at each Kp; of many those together that answer alike."""
    known = [(one.title.removeprefix("Kp = "), one.found) for one in answers if one.found]
    groups: dict[str, list[str]] = {}
    for kp, found in known:
        motion = tell_motion(found)
        alike = (
            motion
            if len(known) <= _MOST_SAID
            else ", ".join(motion.split(" by ")[0].split(", ")[:2])
        )
        groups.setdefault(alike, []).append(kp)
    for motion, gains in groups.items():
        yield f"Kp = {', '.join(gains)}: {motion}."


_MOST_SAID: Final = 4
"""Gains of which each has its own sentence."""


def _show_range(answer: LoopAnswer) -> str:
    found = answer.found
    if found is None or not found.stable_gains:
        return "of no value"
    return " and ".join(
        f"below {format_short(high)} 1/s"
        if low == 0.0
        else f"from {format_short(low)} to {format_short(high)} 1/s"
        for low, high in found.stable_gains
    )


def _list_run(
    word: str, answers: Sequence[LoopAnswer], found: "dict[str, Recommendation]"
) -> Iterator[str]:
    """Yield the command that tries the recommended gains."""
    keys = {one.title: one.model.loop.gain for one in answers if one.model}
    words = [
        f"--set {keys[loop]}={best.gains.kp:.3g}"
        for loop, best in found.items()
        if best.gains and keys[loop]
    ]
    if words:
        yield f"Try them: turtlelog run {shlex.quote(word)} {' '.join(words)}"
