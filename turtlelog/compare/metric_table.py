"""The table of metrics: one row per metric, a few runs as columns, reasons for missing values."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import accumulate
from typing import Final

from turtlelog.compare.like_loops import group_ids
from turtlelog.compare.run_names import name_runs
from turtlelog.compare.table import Cell, Column, Table
from turtlelog.display import format_number, join_words
from turtlelog.measure import MeasureSettings, Metric, Status, measure_run
from turtlelog.run import Run
from turtlelog.run.loops import Declaration

_MOST_NAMED: Final = 3
"""Largest number of metrics named beside the reason for their missing values."""


def tabulate_metrics(
    runs: Sequence[Run],
    settings: MeasureSettings | None = None,
    *,
    only: Collection[str] | None = None,
) -> Table:
    """Return metrics as rows and runs as columns; a status if there is no value.

    `only` are ids or patterns of metrics; empty: all metrics.

    Raises:
        MeasureError: If `only` names no metric.
    """
    measured = [measure_run(run, settings, only=only) for run in runs]
    declarations = [run.declaration for run in runs]
    return tabulate_measured(name_runs(runs), measured, declarations=declarations)


def tabulate_measured(
    names: Sequence[str],
    measured: Sequence[Mapping[str, Metric]],
    *,
    declarations: Sequence[Declaration] = (),
) -> Table:
    """Return the table of `tabulate_metrics` for at least one measured run.

    Runs of several laws are columns of one table; a cell is empty if the law does not have the
    loop. Equivalent loops of different laws share a group of rows, metric by metric.

    Args:
        names: Name of each run.
        measured: Metrics as from `measure_run`.
        declarations: Declarations of their laws, which show equivalent loops.
    """
    groups = group_ids((name for metrics in measured for name in metrics), declarations)
    ids = [name for group in groups for name in group]
    return Table(
        title="Metrics",
        columns=(
            Column(title="metric"),
            Column(title="unit"),
            *(Column(title=name) for name in names),
        ),
        rows=tuple(_build_row(name, [metrics.get(name) for metrics in measured]) for name in ids),
        notes=list_reasons(measured),
        breaks=tuple(accumulate(map(len, groups[:-1]))),
    )


def _build_row(name: str, found: Sequence[Metric | None]) -> tuple[Cell, ...]:
    units = list_metric_units([metric for metric in found if metric is not None])
    has_one = len(units) == 1
    return (name, " or ".join(units), *(get_cell(metric, has_one_unit=has_one) for metric in found))


def list_reasons(measured: Iterable[Mapping[str, Metric]]) -> tuple[str, ...]:
    """Return the reasons for missing values without duplicates.

    If a status has several reasons, a cell does not show which one applies; then the reasons name
    the metrics.
    """
    named: dict[Status, dict[str, dict[str, None]]] = {}
    for metrics in measured:
        for name, metric in metrics.items():
            if metric.reason:
                reasons = named.setdefault(metric.status, {})
                reasons.setdefault(metric.reason, {})[name] = None
    return tuple(
        f"{status.value}{_name_some([*names]) if len(reasons) > 1 else ''}: {reason}."
        for status, reasons in named.items()
        for reason, names in reasons.items()
    )


def _name_some(names: Sequence[str]) -> str:
    rest = len(names) - _MOST_NAMED
    shown = names if rest < 2 else [*names[:_MOST_NAMED], f"{rest} more"]
    return f" ({join_words(shown)})"


def get_cell(metric: Metric | None, *, has_one_unit: bool) -> Cell:
    """Return a value, with a unit if the metric has several units, or why the value is missing."""
    if metric is None:
        return None
    if metric.value is None:
        return metric.status.value
    return metric.value if has_one_unit else format_number(metric.value, metric.unit)


def list_metric_units(metrics: Sequence[Metric]) -> list[str]:
    """Return the units of a metric's values; several if loops of the same name differ."""
    valued = [metric.unit for metric in metrics if metric.value is not None]
    return list(dict.fromkeys(valued or [metric.unit for metric in metrics][:1]))
