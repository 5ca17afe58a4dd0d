"""`turtlelog compare` of runs side by side: which is best at what."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import turtlelog as tl
from turtlelog.cli import console, options
from turtlelog.cli.metrics_answer import list_motion
from turtlelog.cli.work import watch_summaries
from turtlelog.display import describe_count, format_range, join_words
from turtlelog.errors import TurtlelogError
from turtlelog.run.stop_reasons import MAX_DURATION

if TYPE_CHECKING:
    from turtlelog.cli.compare import ChoiceOptions
    from turtlelog.compare import Ranking, RunSummary, Table

_LABELS: Final = {
    "final.position_error": "most accurate",
    "run.duration": "shortest",
    "settling_time": "settles first",
    "overshoot": "least overshoot",
    "final.heading_error": "best heading",
}
"""Descriptions of the best run by metric, in the order of display."""

_MOST_SAID: Final = 4
"""Largest number of metrics whose best runs are above the table."""

_MOST_NOTES: Final = 6
"""Largest number of notes on differences between runs; JSON contains all."""


def compare_across(
    paths: Sequence[Path],
    held: "Sequence[tl.Run] | None",
    choice: "ChoiceOptions",
    topics: options.ReadingOptions,
    *,
    jobs: int,
    kind: str,
) -> int:
    """Print runs side by side, and return the exit code. Runs in `held` are read already."""
    columns = choice.list_columns()
    only = None  # every metric
    if columns or kind != "json":
        needed = tl.compare.list_needed_metrics(
            columns, where=choice.where, sort=choice.sort, source="--where"
        )
        only = partial(list_compared, needed=needed, is_usual=not columns)
    summaries, errors = _summarise(paths, held, topics, only=only, jobs=jobs)
    code = console.print_errors(errors)
    # A single run is not compared with others.
    if not errors or len(summaries) > 1:
        _print_across(summaries, choice, kind, options.list_option_words(topics))
    return code


def _summarise(
    paths: Sequence[Path],
    held: "Sequence[tl.Run] | None",
    topics: options.ReadingOptions,
    *,
    only: "Callable[[tl.Run], Sequence[str]] | None",
    jobs: int,
) -> "tuple[tuple[RunSummary, ...], list[TurtlelogError]]":
    """Return run summaries, read one by one unless held, and the errors of unreadable files."""
    if held is not None:
        pairs = zip(held, paths, strict=True)
        return tuple(
            tl.summarise_run(
                run, file=str(path), metrics=tl.measure_run(run, only=only and only(run))
            )
            for run, path in pairs
        ), []
    errors: list[TurtlelogError] = []
    chosen = topics.build_choice()
    found = tl.compare.summarise_files(paths, only=only, topics=chosen, jobs=jobs)
    summaries = tuple(watch_summaries(found, len(paths), errors))
    return tl.compare.complete_summaries(summaries, topics=chosen), errors


def list_compared(run: "tl.Run", *, needed: tuple[str, ...], is_usual: bool) -> tuple[str, ...]:
    """Return the needed metrics, also those that the law of a run lacks, and the usual ones."""
    # The usual metrics of a third-party bag are known when it is read.
    return (*needed, *tl.compare.list_usual_of_run(run)) if is_usual else needed


def _print_across(
    summaries: "Sequence[RunSummary]", choice: "ChoiceOptions", kind: str, reading: Sequence[str]
) -> None:
    count, title = len(summaries), ""
    notes: tuple[str, ...] = ()
    if choice.where is not None:
        summaries, notes = tl.compare.select_runs(summaries, choice.where, source="--where")
        title = f"{len(summaries)} of {count} runs, where {choice.where}"
    if choice.sort is None:
        summaries = tl.compare.order_by_gain(summaries)
    else:
        from turtlelog.compare.run_selection import sort_by_column

        summaries = sort_by_column(summaries, choice.sort, source="--sort")
    only = tl.compare.choose_columns(summaries, choice.list_columns(), source="--metric")
    varied = options.split_names(choice.varied, "--varied") or []
    ranking = tl.compare.judge_runs(summaries, varied=varied, source="--varied")
    if kind == "json":
        console.print_json(_build_answer(summaries, only=only, notes=notes, ranking=ranking))
        return
    if kind == "txt":
        console.print_text(
            _format_across(summaries, ranking, only=only, title=title, notes=notes, reading=reading)
        )
        return
    table = tl.tabulate_runs(summaries, only=only, title=title, notes=notes, ranking=ranking)
    console.print_tables([table], kind)
    if kind == "csv":
        # CSV has no room for notes.
        for note in (*notes, *ranking.list_notes(tl.compare.name_runs(summaries))):
            console.print_note(note)


def _format_across(
    summaries: "Sequence[RunSummary]",
    ranking: "Ranking",
    *,
    only: Sequence[str],
    title: str,
    notes: Sequence[str],
    reading: Sequence[str],
) -> str:
    """Return the best run by each metric, then a row for every run."""
    summaries, changes = tl.compare.shorten_names(summaries, is_uniform=True)
    names = tl.compare.name_runs(summaries)
    keys = {key for one in summaries for key in one.parameters}
    keys -= {key for one in summaries for key in one.declaration.list_gains()}
    table = tl.tabulate_runs(
        summaries,
        only=only,
        title=title,
        ranking=ranking,
        differing=sum(key in keys for key in ranking.keys),
    )
    conditions = ranking.list_notes(names)
    told = [one for one in table.notes if one not in conditions]
    jumps = [text for one in summaries for text in list_motion(one, f" of {one.name}", ["jumps"])]
    told += jumps[:_MOST_NOTES]
    more = len(conditions) - _MOST_NOTES
    if more > 0:
        conditions = [*conditions[:_MOST_NOTES], f"{describe_count(more, 'more note')}: --json."]
    table, left_out = (table, []) if only else narrow_columns(table, summaries)
    table = replace(table, notes=(*list_cell_reasons(table, summaries), *changes, *told))
    above = [*notes, *conditions]
    reached = tl.compare.describe_reached(summaries) if ranking.is_fair else ""
    if reached and _is_shortest_missed(table, summaries):
        reached += "; the shortest run does not"
    title = f"{table.title}{_describe_alike(table, summaries, ranking)}."
    head = [*_name_best(table), title]
    head += [f"{reached[0].upper()}{reached[1:]}."] if reached else []
    following = [f"More metrics (--metric IDS): {', '.join(left_out)}."] if left_out else []
    following += _list_next(summaries, names, table, ranking, reading)
    return "\n".join(
        [
            console.fill_lines(head),
            *_list_best(table),
            *([console.fill_lines(above, indent=2)] if above else []),
            console.fit_body(console.cut_rows(table)),
            "",
            console.fill_lines(following),
        ]
    )


def _is_shortest_missed(table: "Table", summaries: "Sequence[RunSummary]") -> bool:
    """Return whether the shortest run does not reach the goal, but another run does."""
    ends = [one.goal_end for one in summaries]
    has_reached = [end is not None and end.verdict == "reached" for end in ends]
    return any(has_reached) and any(
        mark == "best" and table.columns[column].title == "run.duration" and not has_reached[row]
        for (row, column), mark in table.marks.items()
    )


def _describe_alike(table: "Table", summaries: "Sequence[RunSummary]", ranking: "Ranking") -> str:
    """Return why no run is best although runs may be ranked; empty if the title gives it."""
    if table.marks or not ranking.is_fair or len(table.rows) < 2:
        return ""
    ids = {name for one in summaries for name in one.metrics}
    columns = zip(table.columns, *table.rows, strict=True)
    is_alike = all(len({*cells}) == 1 for column, *cells in columns if column.title in ids)
    return f": {'all metrics shown are equal' if is_alike else 'no metric shown has a best value'}"


def list_cell_reasons(table: "Table", summaries: "Sequence[RunSummary]") -> list[str]:
    """Return the reasons of cells without a value."""
    titles = [column.title for column in table.columns]
    shown = [
        {
            name: summary.metrics[name]
            for name, cell in zip(titles, row, strict=True)
            if name in summary.metrics and summary.metrics[name].status == cell
        }
        for summary, row in zip(summaries, table.rows, strict=True)
    ]
    return [*tl.compare.list_reasons(shown)]


def narrow_columns(table: "Table", summaries: "Sequence[RunSummary]") -> "tuple[Table, list[str]]":
    """Return a table with the metrics that fit a line, and the ids of the others."""
    ids = {name for one in summaries for name in one.metrics}
    titles = [column.title for column in table.columns]
    ranks = [_rank(title) if title in ids else None for title in titles]
    narrow = tl.compare.narrow_table(table, console.find_width(), ranks)
    kept = {column.title for column in narrow.columns}
    return narrow, [title for title in titles if title not in kept]


def _rank(name: str) -> int:
    """Return the rank of a metric among those that decide which run is best."""
    keys = (name, name.rpartition(".")[2])
    return next((place for place, key in enumerate(_LABELS) if key in keys), len(_LABELS))


def _name_best(table: "Table") -> list[str]:
    rows = _rank_best(table)
    if not rows:
        return []
    label, who, name, value, _ = rows[0]
    return [f"{label.capitalize()}{_name_loop(name)}: {who}, {value}."]


def _list_best(table: "Table") -> list[str]:
    rows = _rank_best(table)
    with_ids = [(label, who, f"{name} {value}", worst) for label, who, name, value, worst in rows]
    lines = console.align_rows(with_ids)
    if not rows or rows[0][-1] in lines[0]:
        return lines
    return console.align_rows(
        [(label + _name_loop(name), who, value, worst) for label, who, name, value, worst in rows]
    )


def _rank_best(table: "Table") -> list[tuple[str, str, str, str, str]]:
    """Return description, best run, metric, value and worst run, by importance."""
    ranks = {place: _rank(table.columns[place].title) for place in {row[1] for row in table.marks}}
    marked = sorted(ranks, key=lambda place: (ranks[place], place))
    said = [place for place in marked if ranks[place] < len(_LABELS)]
    return [_describe_best(table, place) for place in (said or marked)[:_MOST_SAID]]


def _name_loop(name: str) -> str:
    loop = name.partition(".")[0]
    return "" if loop in {"final", "run"} else f" ({loop})"


def _describe_best(table: "Table", place: int) -> tuple[str, str, str, str, str]:
    """Return description, best run, metric, value and worst run of a column."""
    name, unit = table.columns[place].title, table.columns[place].unit
    (best, least), (worst, most) = (_find_end(table, place, mark) for mark in ("best", "worst"))
    keys = (name, name.rpartition(".")[2])
    other = f"best {keys[1].replace('_', ' ')}"
    label = next((words for key, words in _LABELS.items() if key in keys), other)
    kind = tl.measure.find_metric_kind(name)
    # A robot that stays short of its target has no overshoot, however far it stays short.
    is_none = kind is not None and kind.floor == 0.0 and least <= 0.0
    is_reached = math.isfinite(most)
    least_text, most_text = format_range(least, most if is_reached else least, unit)
    value = "none" if is_none else least_text
    most_text = most_text if is_reached else "never"
    return label, best, name, value, f"worst: {worst}, {most_text}"


def _find_end(table: "Table", place: int, mark: str) -> tuple[str, float]:
    """Return who has a mark, and the value; infinite if a loop never reaches it."""
    rows = [row for (row, column), found in table.marks.items() if (column, found) == (place, mark)]
    names = [str(table.rows[row][0]) for row in rows]
    who = join_words(names) if len(names) <= 2 else describe_count(len(names), "run")
    cell = table.rows[rows[0]][place] or 0.0
    return who, math.inf if isinstance(cell, str) else float(cell)


def _list_next(
    summaries: "Sequence[RunSummary]",
    names: Sequence[str],
    table: "Table",
    ranking: "Ranking",
    reading: Sequence[str],
) -> Iterator[str]:
    known = [one.key for one in ranking.differences if not one.is_unknown]
    if known:
        yield f"Varied on purpose? --varied {','.join(known[:_MOST_SAID])}"
    marks = table.marks.items()
    best, worst = (
        {table.columns[column].title: row for (row, column), mark in marks if mark == end}
        for end in ("best", "worst")
    )
    if worst:
        metric = min(worst, key=_rank)
        first, last = (summaries[rows[metric]] for rows in (best, worst))
        option = "" if metric == "final.position_error" else f" --metric {metric}"
        command = f"{console.name_explain(last.file, last.law, reading)}{option}"
        # `explain` needs samples of a controller, and finds effects: not gains, nor a cut.
        if last.is_lawless or _is_cut(first, last) or _differ_in_gains(first, last):
            files = console.quote_file(first.file, last.file, *reading)
            command = f"turtlelog compare {files} --why {metric}"
        yield f"Why is {names[worst[metric]]} worse? {command}"
    yield "For other columns: --metric IDS. For every metric: --json, or turtlelog metrics."


def _is_cut(first: "RunSummary", last: "RunSummary") -> bool:
    """Return whether only the second run was cut by its longest duration."""
    return first.stop_reason != MAX_DURATION == last.stop_reason


def _differ_in_gains(first: "RunSummary", last: "RunSummary") -> bool:
    """Return whether runs without any effect of the implementation differ in gains."""
    free = tl.scenario.flatten_scenario(tl.Scenario())
    gains = {*first.declaration.list_gains()}
    for one in (first, last):
        keys = one.parameters.keys() - gains - _IDLE_KEYS
        # A recording may contain more keys of its law and start than a scenario without them.
        keys = {key for key in keys if key in free or not key.startswith(("law.", "start."))}
        if not one.parameters or any(one.parameters[key] != free.get(key) for key in keys):
            return False
    return any(first.parameters.get(key) != last.parameters.get(key) for key in gains)


_IDLE_KEYS: Final = {"name", "seed", "max_duration_s", "goal.x_m", "goal.y_m"}
"""Keys of a scenario, apart from gains, that are no effects of the implementation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricBeside:
    """A metric of a run.

    Attributes:
        id: Id of the metric.
        value: Value in `unit`; None if `status` is not `ok`.
        unit: Unit of both values.
        status: Whether the metric has a value.
        reference: Value of the reference; None if the reference has no value.
        better: `lower`, `higher`, or None if neither is better.
    """

    id: str
    value: float | None
    unit: str
    status: str
    reference: float | None
    better: str | None


def take_metric(metric: "tl.Metric", reference: float | None = None) -> dict[str, Any]:
    """Return the fields of `MetricBeside`."""
    kind = tl.measure.find_metric_kind(metric.id)
    return {
        "id": metric.id,
        "value": metric.value,
        "unit": metric.unit,
        "status": metric.status.value,
        "reference": reference,
        "better": None if kind is None else kind.better,
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class _MarkedMetric(MetricBeside):
    mark: "tl.compare.Mark | None"


@dataclass(frozen=True, slots=True, kw_only=True)
class _RunBeside:
    """A run next to other runs, without a reference and therefore without signals."""

    file: str
    name: str
    overlap_s: None = None
    parameters: "Mapping[str, tl.run.Parameter]"
    signals: tuple[()] = ()
    metrics: list[_MarkedMetric]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Difference:
    condition: str
    key: str
    values: tuple[Any, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Unknown:
    condition: str
    runs: list[str]


@dataclass(frozen=True, slots=True, kw_only=True)
class _RankingAnswer:
    """Whether a run may be called the best, with varied keys, differing and unknown conditions."""

    is_fair: bool
    reason: str | None
    varied: tuple[str, ...]
    differences: list[_Difference]
    unknown: list[_Unknown]


@dataclass(frozen=True, slots=True, kw_only=True)
class _AcrossAnswer:
    """Runs next to each other, with marks on their metrics."""

    reference: None = None
    alignment: None = None
    notes: tuple[str, ...]
    ranking: _RankingAnswer
    runs: list[_RunBeside]


def _build_answer(
    summaries: "Sequence[RunSummary]",
    *,
    only: Sequence[str],
    notes: tuple[str, ...],
    ranking: "Ranking",
) -> _AcrossAnswer:
    ids = list(tl.measure.list_metrics(*(found.declaration for found in summaries)))
    if only:
        chosen = tl.compare.choose_columns(summaries, only)
        ids = [
            name for name in chosen if any(one.find_metric(name) is not None for one in summaries)
        ]
    marks = {name: tl.compare.mark_metric(summaries, name, ranking=ranking) for name in ids}
    parameters = tl.compare.order_parameters(summaries, ranking)
    names = tl.compare.name_runs(summaries)
    runs = [
        _RunBeside(
            file=summary.file,
            name=name,
            parameters=parameters[row],
            metrics=[
                _MarkedMetric(**take_metric(metric), mark=marks[metric.id].get(row))
                for metric in map(summary.find_metric, ids)
                if metric is not None
            ],
        )
        for row, (name, summary) in enumerate(zip(names, summaries, strict=True))
    ]
    judged = _RankingAnswer(
        is_fair=ranking.is_fair,
        reason=ranking.describe() or None,
        varied=ranking.varied,
        differences=[console.copy_fields(_Difference, found) for found in ranking.differences],
        unknown=[
            _Unknown(condition=condition, runs=[names[row] for row in rows])
            for condition, rows in ranking.unknown.items()
        ],
    )
    return _AcrossAnswer(notes=notes, ranking=judged, runs=runs)
