"""The table across gains: rows runs, columns metrics, the best and the worst marked."""

import math
from collections.abc import Sequence
from types import MappingProxyType
from typing import Final

from turtlelog.compare.names import name_runs
from turtlelog.compare.summary import RunSummary, choose_columns
from turtlelog.compare.table import Cell, Column, Mark, Table
from turtlelog.measure import METRICS

USUAL_METRICS: Final = (
    "rotate.settling_time",
    "rotate.overshoot",
    "final.heading_error",
    "final.position_error",
    "run.duration",
)
"""What tells runs of a law apart at a glance."""


def tabulate_runs(
    summaries: Sequence[RunSummary],
    *,
    only: Sequence[str] = (),
    title: str = "",
    notes: Sequence[str] = (),
) -> Table:
    """Return a row for every run: its gains, and metrics with the best and the worst marked.

    Args:
        summaries: In the order of the rows.
        only: Metrics, patterns of them (`translate.*`) and parameters; none: the usual ones.
        title: Instead of how many runs there are.
        notes: Sentences to stand below.

    Raises:
        CompareError: Where `only` names what there is not.
    """
    gains = _find_gains(summaries)
    chosen = choose_columns(summaries, only or USUAL_METRICS)
    differing = [] if only else _find_differing(summaries)
    shown = [*differing[:_MOST_DIFFERING], *chosen]
    rows = tuple(
        (
            name,
            *(_get_cell(summary, key) for key in gains.values()),
            *(_get_cell(summary, key) for key in shown),
        )
        for name, summary in zip(name_runs(summaries), summaries, strict=True)
    )
    columns = (
        Column(title="run"),
        *(Column(title=title, unit="1/s") for title in gains),
        *map(_head_column, shown),
    )
    hidden = differing[_MOST_DIFFERING:]
    told = [f"More parameters that differ: {', '.join(hidden)}."] if hidden else []
    return Table(
        title=title or f"{len(summaries)} runs",
        columns=columns,
        rows=rows,
        notes=(*notes, *told),
        marks=MappingProxyType(
            {
                (row, index): mark
                for index, name in enumerate(shown, start=1 + len(gains))
                for row, mark in mark_metric(summaries, name).items()
            }
        ),
    )


def mark_metric(summaries: Sequence[RunSummary], name: str) -> dict[int, Mark]:
    """Return which runs are the best and the worst in a metric; none where all are alike."""
    kind = METRICS.get(name)
    better = kind.better if kind else None
    values = (
        {row: found.metrics[name].value for row, found in enumerate(summaries)} if better else {}
    )
    # Values below the floor of a metric are equally good.
    floor = -math.inf if kind is None or kind.floor is None else kind.floor
    known = {row: max(value, floor) for row, value in values.items() if value is not None}
    low, high = min(known.values(), default=0.0), max(known.values(), default=0.0)
    if low == high:
        return {}
    best, worst = (low, high) if better == "lower" else (high, low)
    marks: dict[int, Mark] = {row: "best" for row, value in known.items() if value == best}
    return marks | {row: "worst" for row, value in known.items() if value == worst}


_MOST_DIFFERING: Final = 2
_GAINS: Final = ("law.kp_angular", "law.kp_linear")
_SHOWN: Final = frozenset({*_GAINS, "name"})


def _find_gains(summaries: Sequence[RunSummary]) -> dict[str, str]:
    """Return the columns of gains by title: one where both loops always have the same."""
    pairs = [[found.parameters.get(key) for key in _GAINS] for found in summaries]
    if not any(gain is not None for pair in pairs for gain in pair):
        return {}
    if all(one == other for one, other in pairs):
        return {"Kp": _GAINS[1]}
    return {"Kp turn": _GAINS[0], "Kp drive": _GAINS[1]}


def _find_differing(summaries: Sequence[RunSummary]) -> list[str]:
    """Return the other parameters in which the runs differ; one that is not known does not."""
    values: dict[str, set[str]] = {}
    for summary in summaries:
        for key, value in summary.parameters.items():
            values.setdefault(key, set()).add(repr(value))
    return [key for key, found in values.items() if len(found) > 1 and key not in _SHOWN]


def _head_column(name: str) -> Column:
    unit = METRICS[name].unit if name in METRICS else ""
    lines = tuple(name.replace(".", "_").split("_"))
    return Column(title=name, unit="" if unit == "1" else unit, lines=lines)


def _get_cell(summary: RunSummary, name: str) -> Cell:
    metric = summary.metrics.get(name)
    if metric is None:
        value = summary.parameters.get(name)
        return str(value).lower() if isinstance(value, bool | list) else value
    return metric.status.value if metric.value is None else metric.value
