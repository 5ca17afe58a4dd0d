"""Names that tell runs apart in one table or picture."""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import count
from typing import Final

from turtlelog.compare.summary import RunSummary
from turtlelog.run import Parameter, Run

_GAINS: Final = ["law.kp_angular", "law.kp_linear"]
_MOST_PARAMETERS: Final = 2


def name_runs(runs: Sequence[Run | RunSummary]) -> tuple[str, ...]:
    """Return one name per run, in order, no two alike.

    Names that clash get the one or two parameters that differ (`paper Kp 4`), and a number where
    these do not tell the runs apart.
    """
    clashing: dict[str, list[Run | RunSummary]] = {}
    for run in runs:
        clashing.setdefault(run.name, []).append(run)
    differing = {name: _find_differing(found) for name, found in clashing.items()}
    return _number([_add_parameters(run, differing[run.name]) for run in runs])


def _find_differing(runs: Sequence[Run | RunSummary]) -> dict[str, str]:
    """Return the parameters that tell runs apart, what to call them by key; empty if too many."""
    keys = sorted({key for run in runs for key in run.parameters})
    found = [key for key in keys if len({repr(run.parameters.get(key)) for run in runs}) > 1]
    if found == _GAINS and all(_has_one_gain(run) for run in runs):
        return {_GAINS[0]: "Kp"}
    if len(found) > _MOST_PARAMETERS:
        return {}
    words = {key: key.rpartition(".")[2] for key in found}
    return words if len(set(words.values())) == len(words) else {key: key for key in found}


def _has_one_gain(run: Run | RunSummary) -> bool:
    return len({run.parameters.get(key) for key in _GAINS}) == 1


def _add_parameters(run: Run | RunSummary, differing: Mapping[str, str]) -> str:
    values = [f"{word} {_format(run.parameters.get(key))}" for key, word in differing.items()]
    return " ".join([run.name, *values])


def _format(value: Parameter | None) -> str:
    return f"{value:g}" if isinstance(value, float) else "unknown" if value is None else str(value)


def _number(wanted: Sequence[str]) -> tuple[str, ...]:
    """Return names of which none stands twice: those that did have a number behind them."""
    counts = Counter(wanted)
    numbered = {name: _iterate_numbered(name, counts) for name in counts}
    return tuple(name if counts[name] == 1 else next(numbered[name]) for name in wanted)


def _iterate_numbered(name: str, taken: Collection[str]) -> Iterator[str]:
    return (found for number in count(1) if (found := f"{name} ({number})") not in taken)
