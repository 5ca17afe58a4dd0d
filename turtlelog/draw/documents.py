"""Text next to the pictures: tables and the scenario, as Markdown."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Final

from turtlelog import compare
from turtlelog.compare.run_selection import name_runs
from turtlelog.display import describe_count
from turtlelog.draw.table_formats import format_markdown
from turtlelog.escapes import escape_markdown
from turtlelog.measure import Metric, find_first_stretch, list_essential_metrics, measure_run
from turtlelog.run import Parameter, Run
from turtlelog.run.loops import PAUSE

_HEADS: Final[Mapping[str, str]] = {"final": "At the end", "run": "The whole run"}


def document_run(run: Run, *, metrics: Mapping[str, Metric] | None = None) -> Mapping[str, str]:
    """Return the documents of one run by title: metrics, and the known part of the scenario.

    Args:
        run: Run to describe.
        metrics: Metrics of the run, if already measured.
    """
    metrics = measure_run(run) if metrics is None else metrics
    texts = {"Metrics": _list_metrics(run, metrics), "Scenario": _list_scenario(run)}
    return {title: "\n".join(lines) + "\n" for title, lines in texts.items()}


def document_runs(
    runs: Sequence[Run],
    *,
    metrics: Sequence[Mapping[str, Metric]] | None = None,
) -> Mapping[str, str]:
    """Return the documents of a comparison by title: table of runs, metrics, Table 1.

    The arguments are as in `document_run`, for several runs.
    """
    metrics = [measure_run(run) for run in runs] if metrics is None else metrics
    pairs = zip(runs, metrics, strict=True)
    summaries = [compare.summarise_run(run, metrics=measured) for run, measured in pairs]
    tables = {
        "Side by side": (_put_ends_first(compare.tabulate_runs(summaries)),),
        "Metrics": (
            compare.tabulate_measured(
                name_runs(runs),
                choose_essentials(runs, metrics),
                declarations=[run.declaration for run in runs],
            ),
        ),
        "Table 1": (compare.tabulate_whole_runs(runs), compare.tabulate_table1(runs)),
    }
    return {title: "\n".join(map(format_markdown, found)) for title, found in tables.items()}


def _put_ends_first(table: compare.Table) -> compare.Table:
    """Return a table with final errors next to the gains: pictures leave room for half of it."""
    titles = [column.title for column in table.columns]
    ends = [place for place, title in enumerate(titles) if title.startswith("final.")]
    first = next((place for place, title in enumerate(titles) if "." in title), len(titles))
    rest = [place for place in range(first, len(titles)) if place not in ends]
    order = [*range(first), *reversed(ends), *rest]
    return replace(
        table,
        columns=tuple(table.columns[place] for place in order),
        rows=tuple(tuple(row[place] for place in order) for row in table.rows),
        marks={(row, order.index(place)): mark for (row, place), mark in table.marks.items()},
    )


def choose_essentials(
    runs: Sequence[Run], metrics: Sequence[Mapping[str, Metric]]
) -> list[dict[str, Metric]]:
    """Return the metrics of each run to look at first; loop metrics only for declared loops."""
    ids = list_essential_metrics(*(run.declaration for run in runs))
    return [{name: known[name] for name in ids if name in known} for known in metrics]


def _list_metrics(run: Run, metrics: Mapping[str, Metric]) -> Iterable[str]:
    """Yield the lines of the metrics: a table for each group, and missing values below."""
    yield escape_markdown(run.name, starts_line=True)
    groups = groupby(metrics.values(), lambda metric: metric.id.partition(".")[0])
    tables = [(group, list(found)) for group, found in groups]
    if not len(run.samples):  # of a robot's recording, `metrics` lists all reasons
        missing = [one for one in metrics.values() if one.value is None]
        if missing:
            first, *others = dict.fromkeys(metric.reason for metric in missing)
            more = f", and {describe_count(len(others), 'other reason')}" if others else ""
            told = f"{describe_count(len(missing), 'metric')} without a value: {first}{more}."
            yield from ("", escape_markdown(told))
        held = [(group, [one for one in found if one.value is not None]) for group, found in tables]
        tables = [(group, found) for group, found in held if found]
    for group, listed in tables:
        known = [metric for metric in listed if metric.value is not None]
        yield from ("", f"**{_HEADS.get(group) or _head_loop(run, group)}**", "")
        if known:
            yield from ("| metric | value | unit | at [s] |", "| --- | ---: | --- | ---: |")
            yield from map(_format_metric, known)
        missing = [metric for metric in listed if metric.value is None]
        reasons = sorted({metric.reason for metric in missing})
        for reason in reasons:
            names = [_shorten(metric.id) for metric in missing if metric.reason == reason]
            yield from ("", f"No {', '.join(names)}: {escape_markdown(reason)}.")


def _head_loop(run: Run, name: str) -> str:
    """Return the heading of a loop's metrics, with a note if they include its pause."""
    loop = run.declaration.find_loop(name)
    stretch = [] if loop is None else find_first_stretch(run, loop)
    has_pause = any(span.phase == PAUSE for span in stretch)
    head = f"{name[0].upper()}{name[1:]}"
    return escape_markdown(f"{head}, its pause included" if has_pause else head)


def _format_metric(metric: Metric) -> str:
    value = compare.format_cell(metric.value, compare.Column(title=""))
    unit = "" if metric.unit == "1" else metric.unit
    at = "" if metric.at_s is None else f"{metric.at_s:.3f}"
    return f"| {_shorten(metric.id)} | {value} | {unit} | {at} |"


def _shorten(metric_id: str) -> str:
    return metric_id.partition(".")[2].replace("_", " ")


def _list_scenario(run: Run) -> Iterable[str]:
    """Yield the lines on a run and its scenario, a table for each section."""
    head = f"{run.name}: {run.source}, {run.stop_reason or 'end not recorded'}."
    yield escape_markdown(head, starts_line=True)
    sections = sorted(run.parameters.items(), key=lambda item: item[0].rpartition(".")[0])
    for section, values in groupby(sections, lambda item: item[0].rpartition(".")[0]):
        yield from _tabulate(section, values)
    yield from _tabulate("Notes of the importer", run.notes.items())
    if run.absent:
        yield from ("", escape_markdown(f"Not recorded: {', '.join(run.absent)}."))


def _tabulate(title: str, values: Iterable[tuple[str, Parameter]]) -> Iterable[str]:
    rows = [
        f"| {escape_markdown(key.rpartition('.')[2])} | {escape_markdown(str(value))} |"
        for key, value in values
    ]
    if rows:
        heading = [f"**{escape_markdown(title)}**", ""] if title else []
        yield from ("", *heading, "| key | value |", "| --- | --- |", *rows)
