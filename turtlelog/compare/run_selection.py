"""Runs and columns of a table or picture: which ones, under which names, in which order."""

import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from itertools import count
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, TypeVar

from turtlelog import expressions
from turtlelog.compare.run_summary import TEXTS, RunSummary, complete_parameters, describe_run_end
from turtlelog.compare.table import Cell, Column, order_ids
from turtlelog.display import (
    cut_name,
    describe_count,
    describe_range,
    show_list,
    split_numbers,
)
from turtlelog.errors import CompareError, describe_unknown
from turtlelog.log import split_topic
from turtlelog.measure import (
    find_metric_kind,
    is_metric_pattern,
    list_essential_metrics,
    list_metrics,
)
from turtlelog.run import Parameter, Run
from turtlelog.run.loops import ControlLoop, Declaration
from turtlelog.run.stop_reasons import find_goal_end

_MOST_PARAMETERS: Final = 2

_LONGEST: Final = 24
"""Longest name in a text table [characters]."""

_TAIL: Final = 13
"""Number of last characters kept of a longer file name; dates and numbers are at the end."""

_MOST_TOLD: Final = 4
"""Largest number of long names given in full; with more, only the keys are given."""


def name_runs(runs: Sequence[Run | RunSummary]) -> tuple[str, ...]:
    """Return one name per run, in order, all different.

    Runs with the same name get the name of their file, or its path if the file names are equal too.
    Without files, the one or two parameters that differ are added (`paper Kp 4`). If this does not
    distinguish the runs, a number follows.
    """
    clashing: dict[str, list[int]] = {}
    for row, run in enumerate(runs):
        clashing.setdefault(run.name, []).append(row)
    names = [run.name for run in runs]
    for rows in clashing.values():
        for row, name in zip(rows, _tell_apart([runs[row] for row in rows]), strict=True):
            names[row] = name
    return _number(names)


def label_file(file: str | Path) -> str:
    """Return the name of a file without its folders; for FILE:TOPIC, with the topic."""
    path, topic = split_topic(file)
    name = path.name or str(file)
    return name if topic is None else f"{name}:{topic}"


def shorten_names(
    runs: Sequence[RunSummary], *, is_uniform: bool = False
) -> tuple[tuple[RunSummary, ...], list[str]]:
    """Return runs with names of at most 24 characters, and their original names.

    A run with a longer name gets the name of its file. A longer file name is cut in the middle. If
    names are uniform, and any run has the name of its file, all do.
    """
    names = name_runs(runs)
    long = [len(name) > _LONGEST for name in names]
    labels = [label_file(run.file) for run in runs if run.file]
    is_file = [one or name != run.name for one, name, run in zip(long, names, runs, strict=True)]
    is_mixed = is_uniform and any(is_file) and not all(is_file) and len({*labels}) == len(runs)
    long = [True] * len(runs) if is_mixed else long
    cut = [
        cut_name(label_file(run.file) if run.file else name, _LONGEST, tail=_TAIL)
        for run, name in zip(runs, names, strict=True)
    ]
    triples = zip(names, cut, long, strict=True)
    short = _number([brief if is_long else name for name, brief, is_long in triples])
    generated = {
        name: run.name
        for name, run, is_long in zip(short, runs, long, strict=True)
        if is_long and ("=" in run.name or (is_mixed and run.name not in name))
    }
    renamed = tuple(replace(run, name=name) for run, name in zip(runs, short, strict=True))
    return renamed, _describe_changes(generated)


def _describe_changes(generated: Mapping[str, str]) -> list[str]:
    """Return the keys that runs changed, by their shortened names."""
    if len(generated) <= _MOST_TOLD:
        return [f"{name}: {full}" for name, full in generated.items()]
    words = (word for full in generated.values() for word in full.split())
    keys = dict.fromkeys(word.partition("=")[0] for word in words if "=" in word)
    return [f"Keys that these runs changed: {', '.join(keys)}."]


def _tell_apart(runs: Sequence[Run | RunSummary]) -> list[str]:
    files = [run.file for run in runs if isinstance(run, RunSummary) and run.file]
    if len(files) == len(runs) > 1:
        counts = Counter(Path(file).name for file in {*files})
        return [file if counts[Path(file).name] > 1 else Path(file).name for file in files]
    names, differing = [], _find_differing(runs)
    for run in runs:
        known = _read_parameters(run)
        values = [f"{word} {_format(known.get(key))}" for key, word in differing.items()]
        names.append(" ".join([run.name, *values]))
    return names


def _find_differing(runs: Sequence[Run | RunSummary]) -> dict[str, str]:
    """Return the parameters that distinguish runs, with short names by key; empty if too many."""
    found = sorted(list_differing(runs))
    gains = {key for run in runs for key in run.declaration.list_gains()}
    if len(found) > 1 and gains == {*found} and all(has_one_gain(run) for run in runs):
        return {found[0]: "Kp"}
    if len(found) > _MOST_PARAMETERS:
        return {}
    words = {key: key.rpartition(".")[2] for key in found}
    return words if len(set(words.values())) == len(words) else {key: key for key in found}


def list_differing(runs: Sequence[Run | RunSummary]) -> list[str]:
    """Return the scenario keys that differ between runs, without the names of the scenarios.

    A missing key counts as equal to its default if files omit this default.
    """
    parameters = [_read_parameters(run) for run in runs]
    keys = dict.fromkeys(key for known in parameters for key in known if key != "name")
    return [key for key in keys if len({repr(known.get(key)) for known in parameters}) > 1]


def has_one_gain(run: Run | RunSummary) -> bool:
    """Return whether all loops that declare a gain have the same gain."""
    return len({run.parameters.get(key) for key in run.declaration.list_gains()}) == 1


def _read_parameters(run: Run | RunSummary) -> Mapping[str, Parameter]:
    return run.parameters if isinstance(run, RunSummary) else complete_parameters(run)


def _format(value: Parameter | None) -> str:
    return f"{value:g}" if isinstance(value, float) else "unknown" if value is None else str(value)


def _number(wanted: Sequence[str]) -> tuple[str, ...]:
    """Return names without duplicates: duplicates get a number."""
    counts = Counter(wanted)
    numbered = {name: _iterate_numbered(name, counts) for name in counts}
    return tuple(name if counts[name] == 1 else next(numbered[name]) for name in wanted)


def _iterate_numbered(name: str, taken: Collection[str]) -> Iterator[str]:
    return (found for number in count(1) if (found := f"{name} ({number})") not in taken)


AnyRun = TypeVar("AnyRun", Run, RunSummary)


def order_by_gain(runs: Sequence[AnyRun]) -> tuple[AnyRun, ...]:
    """Return runs sorted by the gains that their laws declare, the gain of the speed first.

    Runs with equal gains are in the natural order of their names (`run2` before `run10`); runs with
    the same name keep their order. Runs without gains come last.
    """
    return tuple(sorted(runs, key=lambda run: (_get_gains(run), split_numbers(run.name))))


def _get_gains(run: Run | RunSummary) -> tuple[float, ...]:
    gains = [run.parameters.get(key) for key in run.declaration.list_gains()]
    known = (float(gain) if isinstance(gain, int | float) else math.inf for gain in gains)
    return tuple(known) or (math.inf,)


def select_runs(
    summaries: Sequence[RunSummary], where: str, *, source: str = "where"
) -> tuple[tuple[RunSummary, ...], tuple[str, ...]]:
    """Return the runs for which an expression is true, and notes on runs without its values.

    Args:
        summaries: Runs to choose from.
        where: Expression over parameters, metric ids, `name`, `source` and `stop_reason`:
            `law.kp_linear >= 2 and run.duration < 20`.
        source: Beginning of error lines.

    Raises:
        ExpressionError: If the expression does not parse, or contains a name that no run has.
        CompareError: If the expression is not a condition.
    """
    expression = expressions.parse_expression(where, source=source)
    others = (name for name in expression.names if find_metric_kind(name) is not None)
    known = dict.fromkeys([*_list_names(summaries), *others])
    chosen, lacking = [], {}
    for summary in summaries:
        values = {name: summary.find_value(name) for name in known.keys() & expression.names}
        truth = expressions.evaluate_expression(expression, {**known, **values})
        if truth is None:
            lacking[summary.file or summary.name] = _describe_lack(summary, values)
        elif not isinstance(truth, bool):
            raise CompareError(f"{source}: expected a condition, found {truth!r}")
        elif truth:
            chosen.append(summary)
    notes = [f"{run} is left out: {lack}." for run, lack in lacking.items()]
    if len(notes) > _MOST_NOTES:
        more = len(notes) - _MOST_NOTES
        notes = [*notes[:_MOST_NOTES], f"{more} more are left out for lack of values."]
    return tuple(chosen), tuple(notes)


def sort_runs(
    summaries: Sequence[RunSummary], by: str, *, source: str = "sort"
) -> tuple[RunSummary, ...]:
    """Return the runs in rising order of a metric, parameter, `name`, `source` or `stop_reason`.

    Runs without a value come last; runs with equal values keep their order.

    Args:
        summaries: Runs to sort.
        by: Sort key; with a leading minus, in falling order.
        source: Beginning of error lines.

    Raises:
        CompareError: If no run has the sort key.
    """
    name = by.removeprefix("-")
    if find_metric_kind(name) is None:
        _require_name(name, _list_names(summaries), source)
    values = [found.find_value(name) for found in summaries]
    return _sort(summaries, values, reverse=by != name)


def _sort(
    summaries: Sequence[RunSummary], values: Sequence[Any], *, reverse: bool
) -> tuple[RunSummary, ...]:
    """Return runs in the order of their values, numbers before texts, and None last."""
    pairs = [(one, found) for one, found in zip(values, summaries, strict=True) if one is not None]
    pairs.sort(
        key=lambda pair: (0, pair[0]) if isinstance(pair[0], int | float) else (1, str(pair[0])),
        reverse=reverse,
    )
    rest = [found for one, found in zip(values, summaries, strict=True) if one is None]
    return (*(found for _, found in pairs), *rest)


def sort_by_column(
    summaries: Sequence[RunSummary], by: str, *, source: str = "sort"
) -> tuple[RunSummary, ...]:
    """Return the runs in rising order of a gain, by its column title; otherwise as `sort_runs`.

    Raises:
        CompareError: If no run has this column.
    """
    title = by.removeprefix("-")
    titles = [column.title for column in list_gain_columns(summaries)]
    if title not in titles:
        if title == "Kp" and titles:
            raise CompareError(f"{source}: expected {' or '.join(titles)}, found {title!r}")
        return sort_runs(summaries, by, source=source)
    gains = [get_gain(found, title) for found in summaries]
    numbers = [gain if isinstance(gain, int | float) else None for gain in gains]
    return _sort(summaries, numbers, reverse=by != title)


def list_gain_columns(summaries: Sequence[RunSummary]) -> list[Column]:
    """Return the gain columns: one column if all loops of each run have the same gain."""
    known = [
        found
        for found in summaries
        if any(found.parameters.get(key) is not None for key in found.declaration.list_gains())
    ]
    is_one = all(map(has_one_gain, known))
    units: dict[str, list[str]] = {}
    for found in known:
        for title, loop in _title_gains(found.declaration).items():
            units.setdefault("Kp" if is_one else title, []).append(loop.gain_unit)
    return [
        Column(title=title, unit=found[0] if len({*found}) == 1 else "")
        for title, found in units.items()
    ]


def _title_gains(declaration: Declaration) -> dict[str, ControlLoop]:
    """Return the loops with a gain by column title: `Kp turn`, or the loop's own name."""
    loops = [loop for loop in declaration.loops if loop.gain is not None]
    keys = {(loop.command, loop.gain) for loop in loops}
    counts = {word: sum(command == word for command, _ in keys) for word in _COMMAND_WORDS}
    return {
        f"Kp {_COMMAND_WORDS[loop.command] if counts[loop.command] == 1 else loop.name}": loop
        for loop in loops
    }


def get_gain(summary: RunSummary, title: str) -> Cell:
    """Return the gain in a column of `list_gain_columns`; None if the run has none."""
    if title == "Kp":
        gains = summary.declaration.list_gains()
        return get_parameter(summary, gains[0]) if gains else None
    loop = _title_gains(summary.declaration).get(title)
    return None if loop is None or loop.gain is None else get_parameter(summary, loop.gain)


def get_parameter(summary: RunSummary, name: str) -> Cell:
    """Return a parameter as a cell of a table."""
    value = summary.parameters.get(name)
    if isinstance(value, list):
        return show_list(value)
    return str(value).lower() if isinstance(value, bool) else value


_COMMAND_WORDS: Final = MappingProxyType({"turn_rate": "turn", "speed": "drive"})


def choose_columns(
    summaries: Sequence[RunSummary], only: Sequence[str], *, source: str = "only"
) -> tuple[str, ...]:
    """Return the metrics and parameters that names and patterns (`translate.*`) select.

    A full name selects a metric also if none of the runs has its loop. A pattern that matches only
    loops of other laws selects nothing.

    Raises:
        CompareError: If a name or pattern is invalid, or all together select nothing.
    """
    parameters, metrics = _list_parameters(summaries), _list_ids(summaries)
    chosen: dict[str, None] = {}
    for pattern in only:
        found = [name for name in metrics if fnmatchcase(name, pattern)]
        found += [pattern] if pattern in parameters else []
        if not found and find_metric_kind(pattern) is not None:
            found = [pattern]
        if not found and not is_metric_pattern(pattern):
            _require_name(pattern, [*metrics, *parameters], source)
        chosen |= dict.fromkeys(found)
    if only and not chosen:
        asked = ", ".join(only)
        raise CompareError(f"{source}: these runs have no metric {asked}")
    return tuple(chosen)


def list_usual_of_run(run: Run | RunSummary) -> tuple[str, ...]:
    """Return the ids of the metrics that characterise a run."""
    return USUAL_OF_MOTION if run.is_lawless else list_usual_metrics(run.declaration)


def list_usual_metrics(*declarations: Declaration) -> tuple[str, ...]:
    """Return the ids of the metrics that characterise runs of these laws.

    They describe the final state and the response of the loops that turn the robot; for laws
    without such loops, of all loops. For laws without a goal, the distance driven is included.
    """
    chosen: dict[str, None] = {}
    for declaration in declarations:
        turning = [loop.name for loop in declaration.loops if loop.command == "turn_rate"]
        loops = turning or [loop.name for loop in declaration.loops]
        essential = list_essential_metrics(declaration)
        usual = (f"{loop}.{name}" for loop in loops for name in _USUAL_OF_LOOP)
        chosen |= dict.fromkeys(name for name in usual if name in essential)
    is_free = bool(declarations) and not any(one.uses_goal for one in declarations)
    of_run = _USUAL_WITHOUT_GOAL if is_free else _USUAL_OF_RUN
    return order_ids([*chosen, *of_run], declarations)


def list_needed_metrics(
    columns: Sequence[str] = (),
    *,
    where: str | None = None,
    sort: str | None = None,
    source: str = "where",
) -> tuple[str, ...]:
    """Return ids and patterns of the metrics that a table across runs needs.

    Other metrics are not measured; the law of a run decides which of these the run has.

    Args:
        columns: Columns as for `choose_columns`; empty: the default ones.
        where: Expression as for `select_runs`.
        sort: Sort key as for `sort_runs`.
        source: Beginning of error lines.

    Raises:
        ExpressionError: If `where` does not parse; the meaning of its names is not checked.
    """
    named = [] if where is None else list(expressions.parse_expression(where, source=source).names)
    named += [] if sort is None else [sort.removeprefix("-")]
    wanted = dict.fromkeys([*(columns or _USUAL_PATTERNS), *named])
    return tuple(name for name in wanted if is_metric_pattern(name))


_MOST_NOTES: Final = 5
_USUAL_OF_LOOP: Final = ("settling_time", "overshoot", "rms_error")
_USUAL_OF_RUN: Final = ("final.heading_error", "final.position_error", "run.duration")
_USUAL_WITHOUT_GOAL: Final = ("run.duration", "run.path_length", "run.turn_rate_effort")

USUAL_OF_MOTION: Final = (
    *("final.position_error", "run.duration", "run.path_length", "run.measured_speed_max"),
    *("run.speed_lag", "run.turn_rate_lag"),
)
"""Default metrics of runs with an unknown law."""

_USUAL_PATTERNS: Final = (*(f"*.{name}" for name in _USUAL_OF_LOOP), *_USUAL_OF_RUN)
"""Patterns of the default metrics for any law, before the runs are read."""


def _list_ids(summaries: Sequence[RunSummary]) -> list[str]:
    return list(list_metrics(*(found.declaration for found in summaries)))


def _list_parameters(summaries: Sequence[RunSummary]) -> list[str]:
    return list(dict.fromkeys(name for found in summaries for name in found.parameters))


def _list_names(summaries: Sequence[RunSummary]) -> list[str]:
    return [*TEXTS, *_list_ids(summaries), *_list_parameters(summaries)]


def _require_name(name: str, known: Sequence[str], source: str) -> None:
    if name not in known:
        problem = describe_unknown("metric or parameter", name, known)
        raise CompareError(f"{source}: {problem}")


def _describe_lack(summary: RunSummary, values: Mapping[str, Any]) -> str:
    missing = {name: summary.find_metric(name) for name in sorted(values) if values[name] is None}
    lacks = [
        f"{name} is {'not known' if metric is None else metric.status.value}"
        for name, metric in missing.items()
    ]
    return ", ".join(lacks) or "the expression has no value"


def describe_runs(runs: Sequence[Run]) -> str:
    """Return how a run ended, or for several runs the range of their distances from the goal."""
    names = name_runs(runs)
    if len(runs) == 1:
        return f"{names[0]}: {describe_run_end(runs[0])}."
    ends = [(find_goal_end(run), name) for run, name in zip(runs, names, strict=True)]
    errors = [(end.error_m, name) for end, name in ends if end is not None]
    if len(errors) == len(runs):
        return f"{len(runs)} runs end {describe_range(errors, 'm')} from the goal."
    lengths = [(run.duration_s, name) for run, name in zip(runs, names, strict=True)]
    return f"{describe_count(len(runs), 'run')} last {describe_range(lengths, 's')}."
