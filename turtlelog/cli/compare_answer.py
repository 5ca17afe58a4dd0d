"""Text of `turtlelog compare`: the best run by each metric, or the distances from a reference."""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import turtlelog as tl
from turtlelog.cli import console
from turtlelog.display import describe_count, format_number, format_range, format_short, join_words

if TYPE_CHECKING:
    from turtlelog.cli.compare_reference import Compared
    from turtlelog.compare import (
        PathDeviation,
        Ranking,
        RobotComparison,
        RunSummary,
        Table,
    )

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

_LONGEST: Final = 24
"""Longest name of a recorded robot [characters]; a robot with a longer name is called by its
file."""

_MOST_RUNS: Final = 1
"""Largest number of runs whose signals are shown with a reference by default."""


def format_across(
    summaries: "Sequence[RunSummary]",
    ranking: "Ranking",
    *,
    only: Sequence[str],
    title: str,
    notes: Sequence[str],
) -> str:
    """Return the best run by each metric, then a row for every run."""
    summaries, changes = tl.compare.shorten_names(summaries)
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
    more = len(conditions) - _MOST_NOTES
    if more > 0:
        conditions = [*conditions[:_MOST_NOTES], f"{describe_count(more, 'more note')}: --json."]
    left_out: list[str] = []
    if not only:
        table, left_out = _narrow(table, summaries)
    table = replace(table, notes=(*_list_reasons(table, summaries), *changes, *told))
    above = [*notes, *conditions]
    reached = tl.compare.describe_reached(summaries) if ranking.is_fair else ""
    if reached and _is_shortest_missed(table, summaries):
        reached += "; the shortest run does not"
    title = f"{table.title}{_describe_alike(table, summaries, ranking)}."
    best = [*_name_best(table), title]
    return "\n".join(
        [
            console.fill_lines(
                [*best, *([f"{reached[0].upper()}{reached[1:]}."] if reached else [])]
            ),
            *_list_best(table),
            *([console.fill_lines(above, indent=2)] if above else []),
            console.fit_body(console.cut_rows(table)),
            "",
            console.fill_lines(
                [
                    *([f"More metrics (--metric IDS): {', '.join(left_out)}."] if left_out else []),
                    *_list_next(summaries, names, table, ranking),
                ]
            ),
        ]
    )


def _is_shortest_missed(table: "Table", summaries: "Sequence[RunSummary]") -> bool:
    """Return whether the shortest run does not reach the goal, but another run does."""
    ends = [one.goal_end for one in summaries]
    titles = [column.title for column in table.columns]
    shortest = [
        row
        for (row, column), mark in table.marks.items()
        if (titles[column], mark) == ("run.duration", "best")
    ]
    has_reached = [end is not None and end.verdict == "reached" for end in ends]
    return any(has_reached) and any(not has_reached[row] for row in shortest)


def _describe_alike(table: "Table", summaries: "Sequence[RunSummary]", ranking: "Ranking") -> str:
    """Return why no run is best although runs may be ranked; empty if the title gives it."""
    if table.marks or not ranking.is_fair or len(table.rows) < 2:
        return ""
    ids = {name for one in summaries for name in one.metrics}
    columns = zip(table.columns, *table.rows, strict=True)
    is_alike = all(len({*cells}) == 1 for column, *cells in columns if column.title in ids)
    return f": {'all metrics shown are equal' if is_alike else 'no metric shown has a best value'}"


def _list_reasons(table: "Table", summaries: "Sequence[RunSummary]") -> list[str]:
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


def _narrow(table: "Table", summaries: "Sequence[RunSummary]") -> "tuple[Table, list[str]]":
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
    """Return the best run by the most important metric, with its value; empty without one."""
    rows = _rank_best(table)
    if not rows:
        return []
    label, who, name, value, _ = rows[0]
    return [f"{label.capitalize()}{_name_loop(name)}: {who}, {value}."]


def _list_best(table: "Table") -> list[str]:
    """Return the best and worst runs by the most important metrics, one line each."""
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
    marked = [
        place
        for place, _ in enumerate(table.columns)
        if any(place == column for _, column in table.marks)
    ]
    marked.sort(key=lambda place: _rank(table.columns[place].title))
    said = [place for place in marked if _rank(table.columns[place].title) < len(_LABELS)]
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
    least_text, most_text = format_range(least, most, unit)
    value = "none" if is_none else least_text
    return label, best, name, value, f"worst: {worst}, {most_text}"


def _find_end(table: "Table", place: int, mark: str) -> tuple[str, float]:
    """Return the run with the best or worst value of a column, and the value."""
    rows = [row for (row, column), found in table.marks.items() if (column, found) == (place, mark)]
    names = [str(table.rows[row][0]) for row in rows]
    who = join_words(names) if len(names) <= 2 else describe_count(len(names), "run")
    return who, float(table.rows[rows[0]][place] or 0.0)


def _list_next(
    summaries: "Sequence[RunSummary]", names: Sequence[str], table: "Table", ranking: "Ranking"
) -> Iterator[str]:
    """Yield the next commands to type."""
    known = [one.key for one in ranking.differences if not one.is_unknown]
    if known:
        yield f"Varied on purpose? --varied {','.join(known[:_MOST_SAID])}"
    worst = {
        table.columns[column].title: row
        for (row, column), mark in table.marks.items()
        if mark == "worst"
    }
    if worst:
        metric = min(worst, key=_rank)
        row = worst[metric]
        option = "" if metric == "final.position_error" else f" --metric {metric}"
        command = console.name_explain(summaries[row].file, summaries[row].law)
        yield f"Why is {names[row]} worse? {command}{option}"
    yield "For other columns: --metric IDS. For every metric: --json, or turtlelog metrics."


def format_reference(
    first: "RunSummary",
    found: "Sequence[Compared]",
    *,
    shows_signals: bool,
) -> str:
    """Return the distances of runs from a reference's path, then metrics and signals."""
    summaries, changes = tl.compare.shorten_names([first, *(one.summary for one in found)])
    reference, *names = tl.compare.name_runs(summaries)
    errors = dict(zip(names, (one.path_error for one in found), strict=True))
    ranking = tl.compare.judge_runs(summaries)
    across, _ = _narrow(tl.tabulate_runs(summaries, ranking=ranking, differing=0), summaries)
    told = [f"{ranking.describe().capitalize()}."] if ranking.differences else []
    reasons = _list_reasons(across, summaries)
    across = replace(across, notes=(*reasons, *changes, *told))
    comparisons = [one.comparison for one in found]
    signals = tl.compare.tabulate_differences(comparisons, names=names, reference=reference)
    parts = [console.fit_body(across)]
    if shows_signals or len(found) <= _MOST_RUNS:
        parts.append(f"\n{signals.title}\n" + console.fit_body(replace(signals, notes=())))
    else:
        parts.append("\nThe largest difference of every signal: --details")
    return "\n".join(
        [
            console.fill_lines(list_errors(errors, reference)),
            *parts,
            "",
            console.fill_lines(signals.notes),
            "Verdicts with tolerances: turtlelog check --init " + console.quote_file(first.file),
        ]
    )


def _show(value_m: float) -> str:
    return format_number(round(value_m, 9), "m")  # smaller values are rounding


def list_errors(errors: "Mapping[str, PathDeviation]", reference: str) -> Iterator[str]:
    """Yield the run furthest from the reference's path, then the distance of each run."""
    name, worst = max(errors.items(), key=lambda one: one[1].largest_m)
    at = f"by at most {_show(worst.largest_m)}, at {worst.largest_at_s:.2f} s"
    is_on = round(worst.largest_m, 9) == 0.0
    if len(errors) == 1:
        yield (
            f"{name} stays on the path of {reference}, within 1e-9 m."
            if is_on
            else f"{name} departs from the path of {reference} {at}."
        )
    else:
        head = f"{len(errors)} runs beside {reference}"
        yield (
            f"{head}: all stay on its path, within 1e-9 m."
            if is_on
            else f"{head}: {name} departs most from its path, {at}."
        )
    for name, error in errors.items():
        if not round(error.largest_apart_m, 9):
            continue
        path = f"up to {_show(error.largest_m)} from the path, RMS {_show(error.rms_m)}; "
        apart = f"at equal times up to {_show(error.largest_apart_m)} apart"
        yield f"{name}: {path if len(errors) > 1 else ''}{apart}, RMS {_show(error.rms_apart_m)}."


def format_robots(found: "Sequence[RobotComparison]", files: Sequence[str], scenario: str) -> str:
    """Return the distances of recorded robots from a simulated one, their meaning, and a table."""
    found = [
        one if len(one.name) <= _LONGEST else replace(one, name=tl.compare.label_file(file))
        for one, file in zip(found, files, strict=True)
    ]
    table = tl.compare.tabulate_robots(found)
    heads = []
    for one in found:
        said = []
        for band in (band for band in one.bands if band.quantity == "position"):
            simulated = band.simulated_median
            beside = "" if simulated is None else f" (simulated {format_short(simulated, 'm')})"
            said.append(f"{format_short(band.median, 'm')}{beside} after {band.horizon_s:g} s")
        head = f"{one.name} beside the scenario {one.scenario}"
        heads.append(f"{head}: median position error {join_words(said)}.")
    if len(found) > 1:
        heads.insert(0, f"{len(found)} recorded robots beside the scenario {found[0].scenario}:")
    # The sentences contain the number of errors outside of the band.
    ranks = [0 if column.title in {"above", "below"} else None for column in table.columns]
    seeds = found[0].seeds
    means = (
        f"Each motion is simulated with {seeds} seeds." if seeds else "The scenario has no noise."
    )
    return "\n".join(
        [
            console.fill_lines([*heads, *table.notes], indent=2),
            console.fit_body(
                replace(tl.compare.narrow_table(table, console.find_width(), ranks), notes=())
            ),
            "",
            console.fill_lines(
                [
                    f"The simulated robot is driven with the recorded commands. {means}",
                    f"Curves: turtlelog compare {shlex.join([files[0], scenario])} --plot FILE.pdf",
                ]
            ),
        ]
    )
