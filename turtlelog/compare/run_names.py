"""Names that distinguish runs in a table or picture, and the order of runs there."""

import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Final, TypeVar

from turtlelog.compare.run_summary import RunSummary, complete_parameters
from turtlelog.display import split_numbers
from turtlelog.log import split_topic
from turtlelog.run import Parameter, Run

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


def shorten_names(runs: Sequence[RunSummary]) -> tuple[tuple[RunSummary, ...], list[str]]:
    """Return runs with names of at most 24 characters, and their original names.

    A run with a longer name gets the name of its file. A longer file name is cut in the middle.
    """
    names = name_runs(runs)
    long = [len(name) > _LONGEST for name in names]
    short = _number(
        [
            _cut(label_file(run.file) if run.file else name) if is_long else name
            for run, name, is_long in zip(runs, names, long, strict=True)
        ]
    )
    generated = {
        name: run.name
        for name, run, is_long in zip(short, runs, long, strict=True)
        if is_long and "=" in run.name
    }
    renamed = tuple(replace(run, name=name) for run, name in zip(runs, short, strict=True))
    return renamed, _describe_changes(generated)


def _cut(name: str) -> str:
    if len(name) <= _LONGEST:
        return name
    return f"{name[: _LONGEST - _TAIL - 3]}...{name[-_TAIL:]}"


def _describe_changes(generated: Mapping[str, str]) -> list[str]:
    """Return the keys that runs changed, by their shortened names."""
    if len(generated) <= _MOST_TOLD:
        return [f"{name}: {full}" for name, full in generated.items()]
    words = (word for full in generated.values() for word in full.split())
    keys = dict.fromkeys(word.partition("=")[0] for word in words if "=" in word)
    return [f"Keys that these runs changed: {', '.join(keys)}."]


def _tell_apart(runs: Sequence[Run | RunSummary]) -> list[str]:
    """Return different names for runs with the same name."""
    files = [run.file for run in runs if isinstance(run, RunSummary) and run.file]
    if len(runs) == 1 or len(files) < len(runs):
        differing = _find_differing(runs)
        return [_add_parameters(run, differing) for run in runs]
    counts = Counter(Path(file).name for file in {*files})
    return [file if counts[Path(file).name] > 1 else Path(file).name for file in files]


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
    parameters = [_list_parameters(run) for run in runs]
    keys = dict.fromkeys(key for known in parameters for key in known if key != "name")
    return [key for key in keys if len({repr(known.get(key)) for known in parameters}) > 1]


def has_one_gain(run: Run | RunSummary) -> bool:
    """Return whether all loops that declare a gain have the same gain."""
    return len({run.parameters.get(key) for key in run.declaration.list_gains()}) == 1


def _add_parameters(run: Run | RunSummary, differing: Mapping[str, str]) -> str:
    known = _list_parameters(run)
    values = [f"{word} {_format(known.get(key))}" for key, word in differing.items()]
    return " ".join([run.name, *values])


def _list_parameters(run: Run | RunSummary) -> Mapping[str, Parameter]:
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
    known = [float(gain) if isinstance(gain, int | float) else math.inf for gain in gains]
    return tuple(known) if known else (math.inf,)
