"""The table of runs: one row per run, with parameters and metrics as columns."""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import MISSING, fields, replace
from types import MappingProxyType
from typing import Any, Final

from turtlelog.compare.metric_table import get_cell, list_metric_units
from turtlelog.compare.ranking import Ranking, judge_runs
from turtlelog.compare.run_selection import (
    USUAL_OF_MOTION,
    choose_columns,
    has_one_gain,
    list_usual_metrics,
    name_runs,
    sort_runs,
)
from turtlelog.compare.run_summary import RunSummary
from turtlelog.compare.table import Cell, Column, Mark, Table
from turtlelog.display import describe_count, format_number, format_short, join_words
from turtlelog.errors import CompareError
from turtlelog.measure import Status, find_metric_kind, list_metrics
from turtlelog.run import Parameter
from turtlelog.run.loops import ControlLoop, Declaration

_MOST_DIFFERING: Final = 2
"""Largest number of columns for parameters that differ between runs."""

_MOST_NAMED: Final = 3
"""Largest number of other differing keys that the first line names."""

_MOST_HIDDEN: Final = 8
"""Largest number of further differing keys that are named below a table."""


def _list_summaries(summaries: object) -> list[RunSummary]:
    """Return the summaries of any iterable as a list."""
    listed: list[Any] = [*summaries] if isinstance(summaries, Iterable) else [summaries]
    for number, one in enumerate(listed):
        if not isinstance(one, RunSummary):
            name = f"summaries[{number}]"
            raise CompareError(f"{name}: expected what summarise_run returns, found {one!r:.60}")
    return listed


def tabulate_runs(
    summaries: Iterable[RunSummary],
    *,
    only: Sequence[str] = (),
    title: str = "",
    notes: Sequence[str] = (),
    ranking: Ranking | None = None,
    differing: int = _MOST_DIFFERING,
) -> Table:
    """Return a row for every run: its gains, and metrics with the best and the worst marked.

    The title names the best run. If the conditions of the runs differ, the title names the
    conditions, and nothing is marked: `judge_runs` decides.

    Args:
        summaries: Runs in the order of the rows.
        only: Metrics, patterns (`translate.*`) and parameters; empty: the default ones.
        title: Title instead of the number of runs.
        notes: Sentences below the table.
        ranking: Whether a run may be called the best. Default: as `judge_runs` decides.
        differing: Largest number of columns for other parameters that differ; the remaining ones
            are named below.

    Raises:
        CompareError: If `only` contains an unknown name.
    """
    summaries = _list_summaries(summaries)
    ranking = judge_runs(summaries) if ranking is None else ranking
    gains = _list_gain_columns(summaries)
    chosen = choose_columns(summaries, only or _list_usual(summaries))
    if not only:
        summaries = [_leave_out_goal(summary) for summary in summaries]
    others = _find_differing(summaries, ranking)
    shown = [*([] if only else others[:differing]), *chosen]
    units = {name: _list_units(summaries, name) for name in shown}
    names = name_runs(summaries)
    rows = tuple(
        (
            name,
            *(_get_gain(summary, column.title) for column in gains),
            *(_get_cell(summary, key, has_one_unit=len(units[key]) < 2) for key in shown),
        )
        for name, summary in zip(names, summaries, strict=True)
    )
    columns = (Column(title="run"), *gains, *(_head_column(name, units[name]) for name in shown))
    besides = [key for key in others if key not in ranking.keys]
    hidden = [key for key in besides[_MOST_NAMED:] if key not in shown]
    told = [f"More parameters that differ: {_list_first(hidden)}."] if hidden else []
    told += [
        f"{name} is not compared: loops of that name control signals of other units."
        for name in shown
        if len(units[name]) > 1
    ]
    marks = {name: mark_metric(summaries, name, ranking=ranking) for name in shown}
    head = title or describe_count(len(summaries), "run")
    varied = _describe_varied(summaries, gains, rows, ranking, besides)
    answer = ranking.describe() or _name_best(names, marks)
    unlocks = [] if only else list_unlocks(summaries)
    return Table(
        title=f"{head}{varied}{f': {answer}' if answer else ''}",
        columns=columns,
        rows=rows,
        notes=(*notes, *ranking.list_notes(names), *told, *unlocks),
        marks=MappingProxyType(
            {
                (row, index): mark
                for index, name in enumerate(shown, start=1 + len(gains))
                for row, mark in marks[name].items()
            }
        ),
    )


def _list_first(keys: Sequence[str]) -> str:
    more = len(keys) - _MOST_HIDDEN
    return ", ".join(keys[:_MOST_HIDDEN]) + (f" and {more} more" if more > 0 else "")


_MOST_GAINS: Final = 6
"""Largest number of gains that the first line lists; of more gains, it gives the range."""


def _describe_varied(
    summaries: Sequence[RunSummary],
    gains: Sequence[Column],
    rows: Sequence[Sequence[Cell]],
    ranking: Ranking,
    besides: Sequence[str],
) -> str:
    """Return the varied keys with their values, and the other keys that differ."""
    shown = {
        column.title: [row[place] for row in rows] for place, column in enumerate(gains, start=1)
    }
    known = {key for one in summaries for key in one.declaration.list_gains()}
    for key in ranking.varied:
        if key not in known:
            shown[key] = [_get_parameter(one, key) for one in summaries]
    lists = {name: list(dict.fromkeys(cells)) for name, cells in shown.items()}
    lists = {name: values for name, values in lists.items() if len(values) > 1}
    varied = [f", {name} = {_list_values(values)}" for name, values in lists.items()]
    if besides:
        more = len(besides) - _MOST_NAMED
        keys = [*besides[:_MOST_NAMED], *([f"{more} more"] if more > 0 else [])]
        verb = "differs" if len(keys) == 1 else "differ"
        due = f" too, so not every difference is due to {join_words([*lists])}" if lists else ""
        varied.append(f" ({join_words(keys)} {verb}{due})")
    return "".join(varied)


def _list_values(values: Sequence[Cell]) -> str:
    known = [value for value in values if isinstance(value, int | float)]
    if len(values) > _MOST_GAINS and len(known) == len(values):
        return f"{format_number(min(known))} to {format_number(max(known))}"
    return ", ".join(
        format_number(value) if isinstance(value, float) else str(value or "none")
        for value in values
    )


def _name_best(names: Sequence[str], marks: Mapping[str, Mapping[int, Mark]]) -> str:
    """Return which run is the best in all compared metrics; empty if no run is marked."""
    best = {
        name: {row for row, mark in found.items() if mark == "best"}
        for name, found in marks.items()
        if found
    }
    if not best:
        return ""
    common = set.intersection(*best.values())
    if not common:
        return "no run is best at everything"
    what = next(iter(best)) if len(best) == 1 else "everything"
    who = join_words([names[row] for row in sorted(common)])
    return f"{who} {'is' if len(common) == 1 else 'are'} best at {what}"


def sort_by_column(
    summaries: Sequence[RunSummary], by: str, *, source: str = "sort"
) -> tuple[RunSummary, ...]:
    """Return the runs in rising order of a gain, by its column title; otherwise as `sort_runs`.

    Raises:
        CompareError: If no run has this column.
    """
    title = by.removeprefix("-")
    titles = [column.title for column in _list_gain_columns(summaries)]
    if title not in titles:
        if title == "Kp" and titles:
            raise CompareError(f"{source}: expected {' or '.join(titles)}, found {title!r}")
        return sort_runs(summaries, by, source=source)
    gains = [(_get_gain(found, title), found) for found in summaries]
    valued = [(gain, found) for gain, found in gains if isinstance(gain, int | float)]
    valued.sort(key=lambda pair: pair[0], reverse=by != title)
    rest = [found for gain, found in gains if not isinstance(gain, int | float)]
    return (*(found for _, found in valued), *rest)


def mark_metric(
    summaries: Sequence[RunSummary], name: str, *, ranking: Ranking | None = None
) -> dict[int, Mark]:
    """Return which runs are the best and the worst in a metric; empty if all print alike.

    The result is also empty if loops of the same name control signals with different units, or if
    runs may not be ranked.

    Args:
        summaries: Runs to mark.
        name: Id of the metric.
        ranking: Whether the runs may be ranked, if already known.
    """
    if not (judge_runs(summaries) if ranking is None else ranking).is_fair:
        return {}
    kind = find_metric_kind(name)
    better = kind.better if kind and len(_list_units(summaries, name)) < 2 else None
    found = [summary.find_metric(name) if better else None for summary in summaries]
    values = {row: metric.value for row, metric in enumerate(found) if metric is not None}
    # Values below the floor of a metric are equally good.
    floor = -math.inf if kind is None or kind.floor is None else kind.floor
    known = {row: max(value, floor) for row, value in values.items() if value is not None}
    low, high = min(known.values(), default=0.0), max(known.values(), default=0.0)
    # Values that the answer prints alike are equally good: nobody reads a difference between them.
    unit = _list_units(summaries, name)[0] if known else ""
    if format_short(low, unit) == format_short(high, unit):
        return {}
    best, worst = (low, high) if better == "lower" else (high, low)
    marks: dict[int, Mark] = {row: "best" for row, value in known.items() if value == best}
    return marks | {row: "worst" for row, value in known.items() if value == worst}


def _list_usual(summaries: Sequence[RunSummary]) -> tuple[str, ...]:
    """Return the default metrics; with third-party bags, only metrics that some run has."""
    laws = [found.declaration for found in summaries if not found.is_lawless]
    if len(laws) == len(summaries):
        return list_usual_metrics(*laws)
    usual = [*(list_usual_metrics(*laws) if laws else ()), *USUAL_OF_MOTION]
    return drop_absent(summaries, dict.fromkeys(usual))


def drop_absent(summaries: Sequence[RunSummary], ids: Collection[str]) -> tuple[str, ...]:
    """Return the metrics for which at least one run has the data.

    If every run has a law, all metrics are returned, so that tables do not depend on the data.
    """
    if not any(found.is_lawless for found in summaries):
        return tuple(ids)
    held = {
        name
        for found in summaries
        for name, metric in found.metrics.items()
        if metric.status is not Status.ABSENT
    }
    return tuple(name for name in ids if name in held)


def list_unlocks(summaries: Sequence[RunSummary]) -> list[str]:
    """Return which inputs would add metrics, if all runs are third-party bags without them."""
    if not summaries or not all(found.is_lawless for found in summaries):
        return []
    return [
        f"No {unlock}."
        for lack, unlock in UNLOCKS.items()
        if all(lack in one.lacks and can_unlock(lack, one.lacks) for one in summaries)
    ]


def can_unlock(lack: str, lacks: Sequence[str]) -> bool:
    """Return whether adding a missing input would help: a goal needs poses."""
    return lack != "goal" or "poses" not in lacks


UNLOCKS: Final = MappingProxyType(
    {
        "poses": "poses: a recorded Odometry, PoseStamped or /tf adds the path, measured rates and"
        " how the robot follows its commands",
        "commands": "commands: a recorded Twist or TwistStamped (--command-topic TOPIC) adds lags,"
        " tracking errors and steps",
        "goal": "goal: --goal X,Y adds final.position_error and run.time_to_goal",
        "samples": "samples of a controller: only recordings of turtlelog have them, and with them"
        " metrics of loops",
    }
)
"""Inputs that a bag may lack, by `HOLDINGS`, and what adds the metrics that need them."""

_AT_GOAL: Final = ("final.heading_error", "final.position_error")
_COMMAND_WORDS: Final = MappingProxyType({"turn_rate": "turn", "speed": "drive"})


def _leave_out_goal(summary: RunSummary) -> RunSummary:
    """Return a run without errors at a goal if its law uses none: other runs have another goal."""
    if summary.declaration.uses_goal:
        return summary
    kept = {name: found for name, found in summary.metrics.items() if name not in _AT_GOAL}
    return replace(summary, metrics=kept)


def _list_gain_columns(summaries: Sequence[RunSummary]) -> list[Column]:
    """Return the gain columns: one column if all loops of each run have the same gain."""
    known = [
        found
        for found in summaries
        if any(found.parameters.get(key) is not None for key in found.declaration.list_gains())
    ]
    if not known:
        return []
    if all(has_one_gain(found) for found in known):
        loops = [loop for found in known for loop in _title_gains(found.declaration).values()]
        return [_head_gain("Kp", [loop.gain_unit for loop in loops])]
    titled: dict[str, list[str]] = {}
    for found in known:
        for title, loop in _title_gains(found.declaration).items():
            titled.setdefault(title, []).append(loop.gain_unit)
    return [_head_gain(title, units) for title, units in titled.items()]


def _head_gain(title: str, units: Sequence[str]) -> Column:
    return Column(title=title, unit=units[0] if len({*units}) == 1 else "")


def _title_gains(declaration: Declaration) -> dict[str, ControlLoop]:
    """Return the loops with a gain by column title: `Kp turn`, or the loop's own name."""
    loops = [loop for loop in declaration.loops if loop.gain is not None]
    keys = {(loop.command, loop.gain) for loop in loops}
    counts = {word: sum(command == word for command, _ in keys) for word in _COMMAND_WORDS}
    return {
        f"Kp {_COMMAND_WORDS[loop.command] if counts[loop.command] == 1 else loop.name}": loop
        for loop in loops
    }


def _get_gain(summary: RunSummary, title: str) -> Cell:
    if title == "Kp":
        gains = summary.declaration.list_gains()
        return _get_parameter(summary, gains[0]) if gains else None
    loop = _title_gains(summary.declaration).get(title)
    return None if loop is None or loop.gain is None else _get_parameter(summary, loop.gain)


def _find_differing(summaries: Sequence[RunSummary], ranking: Ranking) -> list[str]:
    """Return the other parameters that differ between runs. Unknown parameters do not differ.

    Intentionally varied parameters come first, then those that prevent a ranking.
    """
    shown = {"name", *(key for found in summaries for key in found.declaration.list_gains())}
    values: dict[str, set[str]] = {}
    for summary in summaries:
        for key, value in summary.parameters.items():
            values.setdefault(key, set()).add(repr(value))
    whole = [found for found in summaries if found.conditions and found.conditions.is_whole]
    for key, default in _list_defaults(values).items():
        if any(key not in found.parameters for found in whole):
            values[key].add(repr(default))
    differing = [key for key, found in values.items() if len(found) > 1 and key not in shown]
    first = [key for key in ranking.keys if key in differing]
    return list(dict.fromkeys([*first, *differing]))


def _list_defaults(keys: Collection[str]) -> dict[str, object]:
    """Return the defaults of the keys that a whole scenario omits without the effect."""
    from turtlelog.effects import EFFECTS

    return {
        key: found.default
        for effect in EFFECTS
        for table, values in effect.tables.items()
        for found in fields(values)
        if (key := f"{table}.{found.name}") in keys and found.default is not MISSING
    }


def order_parameters(
    summaries: Sequence[RunSummary], ranking: Ranking
) -> list[dict[str, Parameter]]:
    """Return the parameters of each run: the varied ones, others that differ, and the rest."""
    first = [*ranking.varied, *_find_differing(summaries, ranking)]
    return [
        {
            key: found.parameters[key]
            for key in dict.fromkeys([*first, *found.parameters])
            if key in found.parameters
        }
        for found in summaries
    ]


def _list_units(summaries: Sequence[RunSummary], name: str) -> list[str]:
    """Return the units of a metric in some runs; empty for a parameter."""
    found = [summary.find_metric(name) for summary in summaries]
    return list_metric_units([metric for metric in found if metric is not None])


def _head_column(name: str, units: Sequence[str]) -> Column:
    lines = tuple(name.replace(".", "_").split("_"))
    has_unit = len(units) == 1 and units[0] != "1"
    return Column(title=name, unit=units[0] if has_unit else "", lines=lines)


def _get_cell(summary: RunSummary, name: str, *, has_one_unit: bool) -> Cell:
    if name in summary.parameters and name not in list_metrics(summary.declaration):
        return _get_parameter(summary, name)
    return get_cell(summary.metrics.get(name), has_one_unit=has_one_unit)


def _get_parameter(summary: RunSummary, name: str) -> Cell:
    value = summary.parameters.get(name)
    return str(value).lower() if isinstance(value, bool | list) else value
