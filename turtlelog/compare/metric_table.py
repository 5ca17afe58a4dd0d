"""The table of metrics: a row per metric, a column per run."""

from collections.abc import Collection, Mapping, Sequence

from turtlelog.compare.ids import list_units, order_ids
from turtlelog.compare.run_names import name_runs
from turtlelog.compare.table import Cell, Column, Table
from turtlelog.measure import MeasureSettings, Metric, measure_run
from turtlelog.run import Run


def tabulate_metrics(
    runs: Sequence[Run],
    settings: MeasureSettings | None = None,
    *,
    only: Collection[str] | None = None,
) -> Table:
    """Return metrics as rows and runs as columns; a status where there is no value.

    `only` names the metrics, by ids or patterns of them; otherwise every one is there.

    Raises:
        MeasureError: Where `only` names no metric.
    """
    measured = [measure_run(run, settings, only=only) for run in runs]
    return tabulate_measured(name_runs(runs), measured)


def tabulate_measured(
    names: Sequence[str], measured: Sequence[Mapping[str, Metric]], *, notes: Sequence[str] = ()
) -> Table:
    """Return runs that have been measured as `tabulate_metrics` does; at least one.

    Runs of several laws stand side by side; a cell is empty where a law has no such loop.

    Args:
        names: One for each run.
        measured: As `measure_run` returns them.
        notes: Sentences to stand below, before the reasons for what is missing.
    """
    ids = order_ids(name for metrics in measured for name in metrics)
    groups = [name.partition(".")[0] for name in ids]
    return Table(
        title="Metrics",
        columns=(
            Column(title="metric"),
            Column(title="unit"),
            *(Column(title=name) for name in names),
        ),
        rows=tuple(_build_row(name, [metrics.get(name) for metrics in measured]) for name in ids),
        notes=(*notes, *_list_reasons(measured)),
        breaks=tuple(row for row in range(1, len(ids)) if groups[row] != groups[row - 1]),
    )


def _build_row(name: str, found: Sequence[Metric | None]) -> tuple[Cell, ...]:
    units = list_units([metric for metric in found if metric is not None])
    has_one = len(units) == 1
    return (name, " or ".join(units), *(get_cell(metric, has_one_unit=has_one) for metric in found))


def _list_reasons(measured: Sequence[Mapping[str, Metric]]) -> tuple[str, ...]:
    """Return why values are missing, each reason once."""
    missing = [metric for metrics in measured for metric in metrics.values() if metric.reason]
    reasons = dict.fromkeys(f"{metric.status.value}: {metric.reason}." for metric in missing)
    return tuple(reasons)


def get_cell(metric: Metric | None, *, has_one_unit: bool) -> Cell:
    """Return a value, with its unit where the metric has several; or why there is none."""
    if metric is None:
        return None
    if metric.value is None:
        return metric.status.value
    return metric.value if has_one_unit else f"{metric.value:.5g} {metric.unit}"
